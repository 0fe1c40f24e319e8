"""The arenas that ship with usarmjx."""

from usarmjx.base.registry import Registry
from usarmjx.models.arenas.arda import ARDA
from usarmjx.models.arenas.factory import FACTORY
from usarmjx.models.arenas.field import FIELD
from usarmjx.models.arenas.orange import ORANGE
from usarmjx.models.arenas.outdoor import OUTDOOR
from usarmjx.models.arenas.pool import POOL
from usarmjx.models.arenas.red import RED
from usarmjx.models.arenas.soccer import SOCCER
from usarmjx.models.arenas.yellow import YELLOW
from usarmjx.models.spec.arena import ArenaSpec

ARENAS: Registry[ArenaSpec] = Registry("arena")
for _spec in (YELLOW, ORANGE, RED, FIELD, POOL, FACTORY, OUTDOOR, SOCCER, ARDA):
    ARENAS.add(_spec.name, _spec, aliases=_spec.aliases)
