"""One robot goes about and touches nothing."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base.settings import NOT_NEGATIVE, POSITIVE
from usarmjx.models.types.robot import Mount, RobotSpec
from usarmjx.train.envs.recipe import Arenas, spec_of
from usarmjx.train.envs.task import StepResult, Task, TaskView
from usarmjx.train.tasks.clearance import clearance
from usarmjx.train.tasks.team import first_kind, ranges


class WanderMemory(struct.PyTreeNode, kw_only=True):
    """The task's memory of an episode.

    Attributes:
        visited: Squares that the robot's origin has been in (squares along x, squares along y).
    """

    visited: jax.Array


@dataclass(frozen=True, kw_only=True)
class Wander(Task):
    """Go about and touch nothing.

    Observation: the robot's range readings, see `ranges`.

    Action: each key of DRIVE, as a share of what the robot can do.

    Reward: 1 for every square of `square` that the robot's origin is in at the end of a step for the first
    time, that of the start excepted; less `price` on contact.

    Score: the number of those squares. A contact ends the episode: the robot's box is within `touch` of an
    obstacle, see `clearance`.

    Attributes:
        robot: Class of the robot, or its description.
        ranges: Types of range sensors; the first of them that the robot has is read.
        square: Side of a square [m]; the first one begins at the lowest corner of the arena's extent.
        touch: Distance from an obstacle that counts as contact [m].
        price: Price of a contact.
    """

    about: ClassVar[str] = "One robot goes about and touches nothing."

    arena: Arenas = "maze"
    episode_steps: int = 300
    robot: str | RobotSpec = "P2AT"
    ranges: tuple[str, ...] = ("Sonar", "RangeScanner", "IR")
    square: Annotated[float, POSITIVE] = 1.2
    touch: Annotated[float, NOT_NEGATIVE] = 0.01
    price: float = 5.0

    @property
    def robots(self) -> tuple[str | RobotSpec, ...]:
        """The one robot."""
        return (self.robot,)

    @property
    def equipment(self) -> tuple[str | Mount, ...]:
        """The sensors that are read, unless `sensors` says otherwise."""
        kind = first_kind(spec_of(self.robot), self.ranges)
        return self.sensors if self.sensors is not None else () if kind is None else (kind,)

    def start(self, view: TaskView, key: jax.Array) -> WanderMemory:
        """Nothing but the start's square is visited."""
        del key
        (x0, x1), (y0, y1) = view.scene.arena.extent
        # Rounding must not add a square to an extent that is a whole number of them.
        squares = [max(1, int(np.ceil((b - a) / self.square - 1e-6))) for a, b in ((x0, x1), (y0, y1))]
        none = jnp.zeros(squares, bool)
        return WanderMemory(visited=self._visit(view, none)[0])

    def _visit(self, view: TaskView, visited: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return the squares with the present one visited, and whether it was new ()."""
        low = np.array(view.scene.arena.extent, np.float32)[:, 0]
        # Not a plain cast, which rounds towards zero: a robot just outside would be in square 0.
        square = jnp.floor((view.robots(0).pos[0, :2] - low) / self.square).astype(jnp.int32)
        inside = (square >= 0).all() & (square < np.array(visited.shape)).all()
        i, j = square
        # Beyond the extent a negative index reads another square; `new` is False then and nothing is written.
        new = inside & ~visited[i, j]
        return visited.at[i, j].set(visited[i, j] | new), new

    def observe(self, view: TaskView, memory: WanderMemory) -> tuple[jax.Array, ...]:
        """Ranges."""
        del memory
        return (ranges(view, 0, self.ranges),)

    def privileged(self, view: TaskView, memory: WanderMemory) -> jax.Array:
        """Clearance, at most 1 m, speed [m/s] (3,) and turning rate [rad/s]."""
        del memory
        robot = view.robots(0)
        near = jnp.minimum(clearance(view)[0], 1.0)
        return jnp.concatenate([near, robot.linear[0], robot.angular[0, 2:]])

    def evaluate(self, view: TaskView, memory: WanderMemory) -> StepResult:
        """New squares and contacts."""
        visited, new = self._visit(view, memory.visited)
        near = clearance(view)[0][0]
        touched = near <= self.touch
        return StepResult(
            memory=WanderMemory(visited=visited),
            reward=((new - self.price * touched)[None],),
            terminated=touched,
            # The square of the start is no merit.
            score=visited.sum() - 1.0,
            metrics={"touched": touched, "clearance": near},
        )
