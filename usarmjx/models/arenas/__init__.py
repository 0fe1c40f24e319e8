"""The arenas that ship with usarmjx, one module each; `ARENAS` finds them by name or alias.

What several of them are built of is in `elements`, `pieces`, `debris`, `pipes`, `step_fields`, `targets`,
`hall` and `floorplan`, what they look like in `finishes`; `lanes` has single elements between walls. Begin
with `yellow`. Arenas are measured, drawn and trained on: to move a wall changes results of others, and the
tests of each arena say what it must offer (slopes, ways, hidden victims).
"""

from usarmjx.base.registry import Registry
from usarmjx.models.arenas.arda import ARDA
from usarmjx.models.arenas.factory import FACTORY
from usarmjx.models.arenas.field import FIELD
from usarmjx.models.arenas.orange import ORANGE
from usarmjx.models.arenas.orange_2025 import ORANGE_2025
from usarmjx.models.arenas.outdoor import OUTDOOR
from usarmjx.models.arenas.pool import POOL
from usarmjx.models.arenas.red import RED
from usarmjx.models.arenas.red_2025 import RED_2025
from usarmjx.models.arenas.soccer import SOCCER
from usarmjx.models.arenas.yellow import YELLOW
from usarmjx.models.arenas.yellow_2025 import YELLOW_2025
from usarmjx.models.types.arena import ArenaSpec

__all__ = ["ARENAS"]

ARENAS: Registry[ArenaSpec] = Registry("arena")
_TODAY = (YELLOW_2025, ORANGE_2025, RED_2025)
for _spec in (YELLOW, ORANGE, RED, FIELD, POOL, FACTORY, OUTDOOR, SOCCER, ARDA, *_TODAY):
    ARENAS.add(_spec.name, _spec, aliases=_spec.aliases)
