"""Generated arenas: mazes, buildings, rubble, step fields, ramps, collapsed buildings.

The same kind, size, difficulty and seed give the same arena on every machine and in every version:
`base.random.RandomStream` is our own generator, and the order of draws must not change. `kinds` defines the
kinds with their limits and draws walls on the grid of `plan`, `obstacles` fills cells, `arena` places the
rest. Begin with `arena.generate`.
"""

from usarmjx.models.generate.arena import generate, generate_many
from usarmjx.models.generate.kinds import KINDS, Budget, Difficulty, budget

__all__ = ["KINDS", "Budget", "Difficulty", "budget", "generate", "generate_many"]
