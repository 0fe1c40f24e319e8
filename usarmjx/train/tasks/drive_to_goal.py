"""One robot drives to a goal: the first task, for any class of robot that has a drive."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import jax
import jax.numpy as jnp
from flax import struct

from usarmjx.base.settings import NOT_NEGATIVE, POSITIVE, Setting
from usarmjx.models.types.robot import Mount, RobotSpec
from usarmjx.train.envs.recipe import spec_of
from usarmjx.train.envs.task import StepResult, Task, TaskView
from usarmjx.train.tasks.team import first_kind, ranges

MAX_GOAL_DISTANCE = 10.0
"""A goal farther away than this is seen at this distance [m]."""


class GoalMemory(struct.PyTreeNode, kw_only=True):
    """The task's memory of an episode.

    Attributes:
        goal: Goal [m] (2,).
        distance: Distance of the robot's origin from there [m] ().
    """

    goal: jax.Array
    distance: jax.Array


@dataclass(frozen=True, kw_only=True)
class DriveToGoal(Task):
    """Drive to a goal in the plane that is drawn for each episode from the arena's start poses.

    Observation: the goal as the pose sensor has it - cosine and sine of its bearing, its distance as a share
    of 10 m and of 1 m, both at most 1 - then the robot's range readings, see `ranges`.

    Action: each key of DRIVE, as a share of what the robot can do.

    Reward: metres by which the robot's origin came nearer to the goal, `bonus` on arrival, less `haste`.

    Score: 1 once the robot's origin has been within `radius` of the goal, in the plane; else 0. With that
    the episode ends.

    Attributes:
        robot: Class of the robot, or its description.
        pose: Sensor that gives the robot's pose: INS or GroundTruth.
        ranges: Types of range sensors; the first of them that the robot has is read.
        radius: Distance at which the goal is reached [m].
        nearest: Smallest distance of a goal from the start, where the arena has such goals [m].
        bonus: Reward on arrival.
        haste: Price of a step.
    """

    about: ClassVar[str] = "One robot drives to a place."

    robot: str | RobotSpec = "P2AT"
    pose: Annotated[str, Setting(choices=("INS", "GroundTruth"))] = "INS"
    ranges: tuple[str, ...] = ("Sonar", "RangeScanner", "IR")
    radius: Annotated[float, POSITIVE] = 0.5
    nearest: Annotated[float, NOT_NEGATIVE] = 2.0
    bonus: float = 2.0
    haste: float = 0.02

    @property
    def robots(self) -> tuple[str | RobotSpec, ...]:
        """The one robot."""
        return (self.robot,)

    @property
    def equipment(self) -> tuple[str | Mount, ...]:
        """The sensors that are read, unless `sensors` says otherwise."""
        if self.sensors is not None:
            return self.sensors
        kind = first_kind(spec_of(self.robot), self.ranges)
        return (self.pose,) if kind is None else (self.pose, kind)

    def start(self, view: TaskView, key: jax.Array) -> GoalMemory:
        """Draw a goal."""
        here = view.robots(0).pos[0, :2]
        positions = view.starts[:, :2]
        away = jnp.linalg.norm(positions - here, axis=-1)
        # In an arena smaller than `nearest` the farthest start pose is the goal.
        far = away >= jnp.minimum(self.nearest, away.max())
        # A draw among the far ones; `choice` would need to know how many there are while tracing.
        goal = positions[jnp.argmax(jnp.where(far, jax.random.uniform(key, far.shape), -1.0))]
        return GoalMemory(goal=goal, distance=jnp.linalg.norm(goal - here))

    def observe(self, view: TaskView, memory: GoalMemory) -> tuple[jax.Array, ...]:
        """Goal and ranges."""
        pose = view.sensor(0, self.pose)[0]
        return (
            jnp.concatenate([goal_observation(pose, memory.goal)[None], ranges(view, 0, self.ranges)], -1),
        )

    def privileged(self, view: TaskView, memory: GoalMemory) -> jax.Array:
        """The way to the goal as it is [m] (2,), and the robot's speed [m/s] (3,) and turning rate."""
        robot = view.robots(0)
        return jnp.concatenate([memory.goal - robot.pos[0, :2], robot.linear[0], robot.angular[0, 2:]])

    def evaluate(self, view: TaskView, memory: GoalMemory) -> StepResult:
        """Progress and arrival."""
        distance = jnp.linalg.norm(memory.goal - view.robots(0).pos[0, :2])
        there = distance <= self.radius
        reward = memory.distance - distance + self.bonus * there - self.haste
        return StepResult(
            memory=memory.replace(distance=distance),
            reward=(reward[None],),
            terminated=there,
            score=there.astype(jnp.float32),
            metrics={"distance": distance},
        )


def goal_observation(pose: jax.Array, goal: jax.Array) -> jax.Array:
    """Return how a robot at a pose (6,) observes a goal (2,): cosine and sine, far and near distance (4,)."""
    way, yaw = goal - pose[:2], pose[5]
    distance = jnp.linalg.norm(way)
    # On the goal itself there is no direction: 0, not NaN.
    ahead, left = way / jnp.maximum(distance, 1e-6)
    cos, sin = jnp.cos(yaw), jnp.sin(yaw)
    return jnp.stack(
        [
            # The way in the robot's axes is the cosine and the sine of the bearing.
            ahead * cos + left * sin,
            left * cos - ahead * sin,
            jnp.minimum(distance / MAX_GOAL_DISTANCE, 1.0),
            jnp.minimum(distance, 1.0),
        ]
    )
