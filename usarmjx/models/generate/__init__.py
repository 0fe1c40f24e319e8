"""Generated arenas: mazes, buildings, rubble, step fields, ramps, collapsed buildings.

Same kind, size, difficulty and seed, same arena, on every machine and in every version: `draw` is our own,
and the order of draws may not change. `layouts` draws walls on the grid of `plan`, `structures` and
`contents` fill its cells, `kinds` says how much each kind makes at most. Begin with `arena.generate`.
"""

from usarmjx.models.generate.arena import generate, generate_many
from usarmjx.models.generate.difficulty import Difficulty
from usarmjx.models.generate.kinds import KINDS, Budget, budget

__all__ = ["KINDS", "Budget", "Difficulty", "budget", "generate", "generate_many"]
