"""The packaged arenas, one module each; `ARENAS` finds them by name or alias.

Every public `ArenaSpec` of a module here is registered: a new arena is one file. `pieces` and
`league_hall` have the parts that several of them share; `lanes` has single elements between
walls. Begin with `yellow`. Arenas are benchmarks: moving a wall changes results that others have measured,
and the tests of each arena list its required features (slopes, ways, hidden victims).
"""

import sys

from usarmjx.base.registry import Registry, values_in
from usarmjx.models.types.arena import ArenaSpec

__all__ = ["ARENAS"]

ARENAS: Registry[ArenaSpec] = Registry("arena")
"""Packaged arenas by name or alias."""
for _spec in values_in(sys.modules[__name__], ArenaSpec):
    ARENAS.add(_spec.name, _spec, aliases=_spec.aliases)
