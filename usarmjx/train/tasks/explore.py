"""A team explores a building."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.settings import AT_LEAST_ONE, SHARE
from usarmjx.models.types.robot import RobotSpec
from usarmjx.train.envs.task import StepResult, TaskView
from usarmjx.train.mapping.maps import FREE
from usarmjx.train.tasks.equip import mapping_robot
from usarmjx.train.tasks.team import TeamMemory, TeamTask, coverage


@dataclass(frozen=True, kw_only=True)
class Explore(TeamTask):
    """See as much of a building as possible, as early as possible, and let the others know.

    Observation and action: see `TeamTask`.

    Score, over the n steps of an episode:
    - 50 times the mean over all steps of the share of the building that the team has explored;
    - 50 times the mean over all steps and robots of the share of it that is on a robot's map;
      both for a `haste` of 1; with less, the share at the end counts the more, see `TeamTask`;
    - less `price` for every contact.
    The building is the squares of 0.3 m whose middles a robot of class `passing` gets to. Such a square is
    explored once the scanner of any robot has truly seen it to be free (`maps.classify_scan`, drawn from
    where the scanner truly is), and on a robot's map once that says that it is free, by its own scanner or by
    what others sent. A contact is counted when a robot comes as near as `touch` to an obstacle (`clearance`).

    Reward: the points that a step adds to the final score. A square explored in step k of n adds 50 times
    the `worth` of (n - k + 1) / n over the number of squares: all robots share the part `share` equally, and
    the robot that saw the square gets the rest. All robots share the points for maps equally. Robots that
    touch something pay for their contacts. All rewards of an episode add up to its score less the points for
    the first scans.

    Attributes:
        robot: Class of the robots, or their description.
        count: Number of robots.
        share: Share of the reward for a find that goes to all robots alike.
    """

    about: ClassVar[str] = "A team explores a building."

    episode_steps: int = 200
    robot: str | RobotSpec = "P2AT"
    count: Annotated[int, AT_LEAST_ONE] = 4
    share: Annotated[float, SHARE] = 0.5

    @property
    def robots(self) -> tuple[RobotSpec, ...]:
        """The team."""
        return (mapping_robot(self.robot),) * self.count

    def start(self, view: TaskView, key: jax.Array) -> TeamMemory:
        """The maps have the contents of the first scans."""
        memory = super().start(view, key)
        return memory.replace(extra=memory.reachable & (memory.belief.squares == FREE))

    def evaluate(self, view: TaskView, memory: TeamMemory) -> StepResult:
        """Explored squares, mapped squares and contacts."""
        steps, scene = self.episode_steps, view.scene
        worth = self.worth((steps - memory.step) / steps)  # this step's number is one more
        first = 50.0 * (coverage(memory) + on_maps(memory))
        memory, credit, begun = self.advance(view, memory)
        before, memory = (
            on_maps(memory),
            memory.replace(extra=memory.extra | (memory.reachable & (memory.belief.squares == FREE))),
        )
        found = 50.0 * worth * ((1 - self.share) * credit + self.share * credit.mean())
        learned = 50.0 * worth * (on_maps(memory) - before) / scene.num_robots
        reward = found + learned - self.price * begun
        # `start` returns no score: the points for the first scans come with the first step.
        score = memory.score + jnp.where(memory.step == memory.skipped + 1, first, 0.0) + reward.sum()
        memory = memory.replace(score=score)
        return StepResult(
            memory=memory,
            reward=self.per_group(scene, reward),
            terminated=jnp.zeros((), bool),
            score=score,
            metrics={**self.metrics(memory), "known": on_maps(memory)},
        )

    def score_parts(self, series: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Points for what is explored and for what is known, and the contacts'."""
        names = {"explored": 50.0, "known": 50.0}
        found = {name: points * self.paid(series[name]) for name, points in names.items()}
        return {**found, **super().score_parts(series)}

    @property
    def most_points(self) -> dict[str, float]:
        """50 each, if all were explored and known at the start."""
        return {"explored": 50.0, "known": 50.0, **super().most_points}


def on_maps(memory: TeamMemory) -> jax.Array:
    """Return the share of the building that is on a map, on average over the robots ()."""
    # Where no square can be reached the share is 0, not NaN.
    squares = jnp.maximum(memory.reachable.sum(), 1)
    return memory.extra.sum((1, 2)).mean() / squares
