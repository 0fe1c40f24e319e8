"""The arenas that ship with usarmjx."""

from usarmjx.models.arena_spec import ArenaSpec
from usarmjx.models.arenas.field import FIELD
from usarmjx.models.arenas.pool import POOL
from usarmjx.models.arenas.yellow import YELLOW
from usarmjx.registry import Registry

ARENAS: Registry[ArenaSpec] = Registry("arena")
for _spec in (YELLOW, FIELD, POOL):
    ARENAS.add(_spec.name, _spec, aliases=_spec.aliases)
