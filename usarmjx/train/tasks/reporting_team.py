"""Common parts of tasks whose score counts reports to the base of a team."""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.settings import SHARE
from usarmjx.train.envs.task import TaskView
from usarmjx.train.tasks.goal_team import GoalTeam, Progress
from usarmjx.train.tasks.team import TeamMemory


@dataclass(frozen=True, kw_only=True)
class ReportingTeam(GoalTeam):
    """Tell a base about things: each counts once the base has it on its map.

    Score, over the n steps of an episode and the m things of a world: a thing that comes to the base in step
    k pays 100 / m times 1 - `haste` (k - 1) / n; less `price` for every contact.

    Reward: the points that a step adds to the score. All robots share the points for things equally, except
    the share `found`: it goes to the robots that saw the thing themselves, whoever reported it.

    Attributes:
        found: Share of the reward for reports that goes to those that saw what is reported.
    """

    part: ClassVar[str] = "reported"
    """Name of the share of the things that the base has, and of its part of the score."""

    found: Annotated[float, SHARE] = 0.0

    @abstractmethod
    def things(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return which things there are in a world (things,)."""

    @abstractmethod
    def at_base(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return which things the base's map shows now (things,)."""

    @abstractmethod
    def sighted(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return which agents have seen which things themselves (agents, things)."""

    def nothing(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return the things that the base has at the start (things,)."""
        return self.things(view, memory) & self.at_base(view, memory)

    def progress(self, view: TaskView, memory: TeamMemory, worth: jax.Array) -> Progress:
        """Things that come to the base."""
        before, things = memory.extra.achieved, self.things(view, memory)
        number = jnp.maximum(things.sum(), 1)
        has = before | (things & self.at_base(view, memory))
        news, point = has & ~before, 100.0 * worth / number
        return Progress(
            achieved=has,
            points=point * news.sum(),
            reward=point * self.shares(view, memory, news),
            metrics={self.part: has.sum() / number},
        )

    def shares(self, view: TaskView, memory: TeamMemory, news: jax.Array) -> jax.Array:
        """Return how many things that come to the base (things,) count for each slot (robots,)."""
        equal = jnp.full(view.scene.num_robots, news.sum() / len(self.agents(view.scene)))
        if not self.found:
            return equal
        return (1 - self.found) * equal + self.found * self.finders(view, memory, news)

    def finders(self, view: TaskView, memory: TeamMemory, news: jax.Array) -> jax.Array:
        """Return how many of the things that came to the base (things,) each slot has found (robots,).

        The robots that saw a thing themselves share it equally; if there are none, all agents do. Robots that
        report it get nothing for that: else it would pay to wait beside the base and pass on the maps of
        others.
        """
        agents, has = self.agents(view.scene), self.sighted(view, memory)
        has = (has | ~has.any(0)) & news
        parts = (has / jnp.maximum(has.sum(0), 1)).reshape(len(agents), -1).sum(1)
        return jnp.zeros(view.scene.num_robots).at[agents].set(parts)

    def score_parts(self, series: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Points for reports, and the contacts'."""
        return {self.part: 100.0 * self.paid(series[self.part]), **super().score_parts(series)}

    @property
    def most_points(self) -> dict[str, float]:
        """The score if the base had all at the start."""
        return {self.part: 100.0, **super().most_points}
