"""A chain of robots that choose goals carries the radio of a base as far into a building as it can."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.settings import NOT_NEGATIVE
from usarmjx.train.envs.task import TaskView
from usarmjx.train.tasks.goal_team import GoalTeam, Progress
from usarmjx.train.tasks.relay_chain import (
    RelayChainState,
    chain_now,
    depth_points,
    first_chain,
    power_margins,
)
from usarmjx.train.tasks.team import TeamMemory

DEEP = 0.95
"""Depth from which an oracle wants to be."""


@dataclass(frozen=True, kw_only=True)
class RelayBase(GoalTeam):
    """Keep the base connected while the front robot goes as far as it can, by choosing goals.

    See `GoalTeam` for goals, actions and observations. The third goal is to stay where the robot is, in place
    of the second robot. Links are observed as the power received above the cutoff (1: 20 dB), 0 without a
    link. For an oracle the deepest twentieth of the building is a frontier. `hint` is 0: a reward for new
    squares draws robots out of the chain.

    Score: 100 times the mean over all steps of the depth of the deepest robot that reaches the base at that
    moment, see `RelayChain`; less `price` for every contact.

    Reward: the points that a step adds to the score, shared equally.
    """

    about: ClassVar[str] = "Robots choose goals to carry the radio of a base into a building."
    holds: ClassVar[bool] = True

    hint: Annotated[float, NOT_NEGATIVE] = 0.0

    def nothing(self, view: TaskView, memory: TeamMemory) -> RelayChainState:
        """Return the depths of the building."""
        return first_chain(view, memory, self.arena_grid(view.scene))

    def progress(self, view: TaskView, memory: TeamMemory, worth: jax.Array) -> Progress:
        """Depth of the chain."""
        del worth
        scene, agents = view.scene, self.agents(view.scene)
        chain, depths = chain_now(view, memory.extra.achieved, self.arena_grid(scene))
        reach = jnp.where(chain.linked, depths, 0.0).max()
        points = 100.0 * reach / self.episode_steps
        return Progress(
            achieved=chain,
            points=points,
            reward=jnp.full(scene.num_robots, points / len(agents)),
            metrics={"reach": reach, "deepest": depths.max(), "connected": chain.linked[agents].mean()},
        )

    def signals(self, view: TaskView) -> jax.Array:
        """Return the powers above the cutoff of links (robots, robots)."""
        if view.world.links is None:
            return super().signals(view)
        return jnp.where(super().signals(view), jnp.maximum(power_margins(view), 0.0), 0.0)

    def targets(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return the deepest squares (i, j)."""
        del view
        return self.unfound(memory)

    def unfound(self, memory: TeamMemory) -> jax.Array:
        """Return the deepest squares (i, j)."""
        return memory.reachable & (memory.extra.achieved.depth > DEEP)

    def wanted(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return how deep the building is (i, j)."""
        del view
        return memory.extra.achieved.depth

    def score_parts(self, series: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Points for depth, and the contacts'."""
        return {"depth": depth_points(series, self.episode_steps), **super().score_parts(series)}

    @property
    def most_points(self) -> dict[str, float]:
        """The score if the deepest square were reached from the start."""
        return {"depth": 100.0, **super().most_points}
