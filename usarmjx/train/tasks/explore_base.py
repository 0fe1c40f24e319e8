"""A team explores a building for its base: what counts has to get there."""

from dataclasses import dataclass
from typing import ClassVar

import jax

from usarmjx.train.envs.task import TaskView
from usarmjx.train.mapping.maps import FREE, UNKNOWN
from usarmjx.train.tasks.goal_team import KnownMaps
from usarmjx.train.tasks.reporting_team import ReportingTeam
from usarmjx.train.tasks.team import TeamMemory, station_slot


@dataclass(frozen=True, kw_only=True)
class ExploreBase(ReportingTeam):
    """Explore a building for a base: a square counts once the base has it on its map.

    See `GoalTeam` for goals, actions and observations, `ReportingTeam` for score and reward. The things are
    the squares of the building; a robot has seen a square if its own scans show it to be free. For an oracle
    every square that is not on its map is a frontier.
    """

    about: ClassVar[str] = "A team explores a building for its base."
    part: ClassVar[str] = "mapped"

    def ends(self, known: KnownMaps) -> jax.Array:
        """Return the frontiers of each robot (robots, i, j)."""
        ends = super().ends(known)
        return ends & (known.squares == UNKNOWN) if self.oracle else ends

    def things(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return the squares of the building (i, j)."""
        del view
        return memory.reachable

    def at_base(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return the squares that are free on the base's map (i, j)."""
        return memory.belief.squares[station_slot(view.scene)] == FREE

    def sighted(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return the squares that each agent's own scans show to be free (agents, i, j)."""
        return memory.belief.evidence[self.agents(view.scene)] < 0

    def wanted(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return what the base has (i, j)."""
        del view
        return memory.extra.achieved
