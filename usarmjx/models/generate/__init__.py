"""Generated arenas: mazes, buildings, rubble, step fields, ramps, collapsed buildings."""

from usarmjx.models.generate.arena import generate, generate_many
from usarmjx.models.generate.difficulty import Difficulty
from usarmjx.models.generate.kinds import KINDS, Budget, budget

__all__ = ["KINDS", "Budget", "Difficulty", "budget", "generate", "generate_many"]
