"""The packaged arenas, one module each; `ARENAS` finds them by name or alias.

`elements`, `pieces`, `league_hall` and `floorplan` have the parts that several of them share; `lanes` has
single elements between walls. Begin with `yellow`. Arenas are benchmarks: moving a wall changes results that
others have measured, and the tests of each arena list its required features (slopes, ways, hidden victims).
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
"""Packaged arenas by name or alias."""
_TODAY = (YELLOW_2025, ORANGE_2025, RED_2025)
for _spec in (YELLOW, ORANGE, RED, FIELD, POOL, FACTORY, OUTDOOR, SOCCER, ARDA, *_TODAY):
    ARENAS.add(_spec.name, _spec, aliases=_spec.aliases)
