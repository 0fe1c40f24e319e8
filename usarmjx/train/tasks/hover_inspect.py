"""A robot with rotors flies through windows and looks at points."""

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base.errors import UsageError
from usarmjx.base.rotations import mat_from_quat
from usarmjx.base.settings import AT_LEAST_ONE, NOT_NEGATIVE, POSITIVE, Setting
from usarmjx.models.arenas.pieces import block
from usarmjx.models.drives import RotaryWing
from usarmjx.models.types.arena import START_ELEVATION, ArenaSpec, StartPose, start_tag
from usarmjx.models.types.robot import Mount, RobotSpec, options
from usarmjx.models.types.shapes import Shape
from usarmjx.sim.actions import Actions
from usarmjx.sim.scene import Scene
from usarmjx.train.envs.recipe import spec_of
from usarmjx.train.envs.task import StepResult, Task, TaskView, drive_keys
from usarmjx.train.tasks.clearance import NO_OBSTACLE, box_distance, obstacle_boxes, robot_boxes

LONG, WIDE, HIGH, THICK = 5.0, 5.0, 3.0, 0.1
"""Length along x, width and height of each room, and thickness of walls [m]."""
WINDOW = 1.4
"""Width and height of the windows [m], those of the factory."""
WINDOW_CENTRES = ((0.8, 1.3), (-0.9, 1.7), (0.3, 1.1), (-0.5, 1.5))
"""y and height of the middles of the windows [m], of one wall after the other."""
PASSED_DISTANCE = 0.9
"""So far behind its wall a window has been flown through [m]."""
SPEED_SCALE, TURN_RATE_SCALE = 1.5, 1.5708
"""Speeds [m/s] and turning rate [rad/s] of an action of 1."""
POSITION_SCALE = 5.0
"""Distance observed as 1 [m]."""
SENSORS = (
    Mount(kind="GroundTruth", name="GroundTruth", options=options(ScanInterval=0.1, Weight=0.0)),
    Mount(
        kind="RangeScanner",
        name="Around",
        options=options(
            MaxRange=POSITION_SCALE,
            MinRange=0.02,
            Resolution=0.5236,
            ScanFov=5.76,
            ScanInterval=0.1,
            Noise=0.01,
            Weight=0.1,
        ),
    ),
)
"""Its pose, and 12 beams around it."""


class InspectMemory(struct.PyTreeNode, kw_only=True):
    """The task's memory of an episode.

    Attributes:
        points: Points to look at [m] (points, 3).
        inspected_count: Number of them that it has looked at ().
        dwell_steps: For how many steps it has looked at the present one ().
        target: Target of its flight [m] (3,).
        distance: Its distance from there [m] ().
    """

    points: jax.Array
    inspected_count: jax.Array
    dwell_steps: jax.Array
    target: jax.Array
    distance: jax.Array


@dataclass(frozen=True, kw_only=True)
class HoverInspect(Task):
    """Look at a point in each room, one after the other.

    The rooms stand in a row along x, 5 m long and wide and 3 m high, without a roof, the middle of the first
    one at the origin; from each to the next leads a window of 1.4 m by 1.4 m. In each room a point is drawn
    for each episode: on the left or right wall, within 0.8 m of its middle, 0.5 to 2 m high.

    Observation: x forward, y left (level) and z up of the present point; then of the window to fly through, 0
    if there is none (1: 5 m each); whether there is one; sine and cosine of the yaw; roll and pitch [rad];
    height (1: 5 m); for what share of `dwell` it has looked; 12 ranges around it (1: 5 m). Its pose is that
    of GroundTruth. A window is to be flown through until the robot's origin is 0.9 m beyond its wall.

    Action: up, forward, to the right (1: 1.5 m/s), turn clockwise (1: 90 degrees/s).

    A point counts as looked at when for `dwell` steps in a row the robot's origin is in the same room, within
    `near` of it, and the robot's x axis, along which its camera looks, is off it by at most `view`. (Rooms
    hide nothing that is in them.) Then the next room's is the present one.

    Score: 100 times the share of the points that were looked at.

    Reward: metres by which the origin came nearer to where it should go, which is the point or 0.9 m beyond
    the window's middle; `bonus` for each point; less `haste`; less `price` for touching.

    The episode ends when all are looked at; when the robot's box is within `touch` of a wall
    (`wall_clearance`); when its origin is higher than the walls.

    Attributes:
        robot: Class of the robot, one with rotors.
        rooms: Number of rooms.
        dwell: Steps in a row for which the robot looks at a point.
        near: Largest distance from which a point counts as looked at [m].
        view: Half of the angle within which a point counts as looked at [rad].
        touch: Distance from a wall that counts as contact [m].
        bonus: Reward for a point.
        haste: Price of a step.
        price: Price of contact, and of leaving.
    """

    about: ClassVar[str] = "A robot flies through windows and looks at points."

    repeat: int = 10
    episode_steps: int = 250
    robot: str | RobotSpec = "AirRobot"
    # One room more than `WINDOW_CENTRES` has windows.
    rooms: Annotated[int, Setting(ge=1, le=5)] = 3
    dwell: Annotated[int, AT_LEAST_ONE] = 5
    near: Annotated[float, POSITIVE] = 2.0
    view: Annotated[float, POSITIVE] = 0.35
    touch: Annotated[float, NOT_NEGATIVE] = 0.01
    bonus: float = 2.0
    haste: float = 0.01
    price: float = 3.0

    @property
    def robots(self) -> tuple[RobotSpec, ...]:
        """The robot, with the sensors that are read."""
        spec = spec_of(self.robot)
        if not isinstance(spec.drive, RotaryWing):
            raise UsageError(f"a {spec.name} in the air: expected a robot with rotors")
        return (replace(spec, sensors=SENSORS),)

    @property
    def windows(self) -> np.ndarray:
        """Middles of the windows [m] (walls, 3)."""
        rows = [(LONG * (k + 0.5), y, z) for k, (y, z) in enumerate(WINDOW_CENTRES[: self.rooms - 1])]
        return np.array(rows, np.float32).reshape(-1, 3)

    @property
    def arenas(self) -> ArenaSpec:
        """The rooms; the robot starts in the first one."""
        last, side = LONG * (self.rooms - 0.5), (WIDE + THICK) / 2
        # Rooms reach from -LONG / 2 to `last`; walls at the ends stand outside of that.
        middle, length = (last - LONG / 2) / 2, LONG * self.rooms + 2 * THICK
        walls = [block((middle, y), (length, THICK, HIGH), surface="wall") for y in (-side, side)]
        ends = (-LONG / 2 - THICK / 2, last + THICK / 2)
        walls += [block((x, 0.0), (THICK, WIDE, HIGH), surface="wall") for x in ends]
        for x, y, z in self.windows.tolist():
            walls += _wall_with_window(x, y, z)
        # Always the same ones: the arena is built several times and must not differ.
        draw = np.random.default_rng(0)
        places = draw.uniform((-1.2, -1.5, -np.pi), (0.8, 1.5, np.pi), (32, 3)).round(3)
        return ArenaSpec(
            name="DM-Windows",
            about="Rooms in a row with windows between them.",
            shapes=tuple(walls),
            starts=tuple(
                StartPose(tag=start_tag(i), at=(float(x), float(y), START_ELEVATION), yaw=float(yaw))
                for i, (x, y, yaw) in enumerate(places)
            ),
            extent=((-LONG / 2 - 0.5, last + 0.5), (-side - 0.5, side + 0.5)),
        )

    def action_sizes(self, scene: Scene) -> tuple[int, ...]:
        """Up, forward, right, clockwise."""
        return (4,)

    def act(self, view: TaskView, memory: InspectMemory, actions: tuple[jax.Array, ...]) -> Actions:
        """Speeds."""
        # In the order of `RotaryWing.full_scale`: up, forward, to the right, clockwise.
        most = (SPEED_SCALE, SPEED_SCALE, SPEED_SCALE, TURN_RATE_SCALE)
        keys = drive_keys(view.scene.groups[0].robot)
        return Actions(drive={0: {key: most[i] * actions[0][:, i] for i, key in enumerate(keys)}})

    def start(self, view: TaskView, key: jax.Array) -> InspectMemory:
        """Draw the points."""
        along, side, up = jax.random.split(key, 3)
        n = self.rooms
        points = jnp.stack(
            [
                LONG * jnp.arange(n) + jax.random.uniform(along, (n,), minval=-0.8, maxval=0.8),
                WIDE / 2 * jnp.where(jax.random.bernoulli(side, shape=(n,)), 1.0, -1.0),
                jax.random.uniform(up, (n,), minval=0.5, maxval=2.0),
            ],
            -1,
        )
        pos = view.robots(0).pos[0]
        zero = jnp.zeros((), jnp.int32)
        aim = self._aim(pos, points[0])
        return InspectMemory(
            points=points,
            inspected_count=zero,
            dwell_steps=zero,
            target=aim,
            distance=jnp.linalg.norm(aim - pos),
        )

    def next_window(self, pos: jax.Array, point: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Return the window (3,) to fly through from a position to a point, which way (), if there is one ().

        The way is 1 along x, or -1; it is the nearest of the windows between them.
        """
        if self.rooms == 1:
            return jnp.zeros(3), jnp.zeros(()), jnp.zeros((), bool)
        windows = jnp.asarray(self.windows)
        side = jnp.sign(point[0] - windows[:, 0])
        passed = (pos[0] - windows[:, 0]) * side
        there = passed < PASSED_DISTANCE
        # The nearest one that is not yet passed, and not one that is farther than the point.
        first = jnp.argmin(jnp.where(there, -passed, jnp.inf))
        return windows[first], side[first], there.any()

    def _aim(self, pos: jax.Array, point: jax.Array) -> jax.Array:
        window, side, there = self.next_window(pos, point)
        return jnp.where(there, window + side * PASSED_DISTANCE * np.array([1, 0, 0], np.float32), point)

    def _present(self, memory: InspectMemory) -> jax.Array:
        # The last one stays after all were looked at: the index would be beyond it.
        return memory.points[jnp.minimum(memory.inspected_count, self.rooms - 1)]

    def observe(self, view: TaskView, memory: InspectMemory) -> tuple[jax.Array, ...]:
        """Point, window, attitude and ranges."""
        pose, point = view.sensor(0, "GroundTruth")[0], self._present(memory)
        window, _, there = self.next_window(pose[:3], point)
        cos, sin = jnp.cos(pose[5]), jnp.sin(pose[5])

        def seen(position: jax.Array) -> jax.Array:
            x, y, z = position - pose[:3]
            return jnp.stack([x * cos + y * sin, y * cos - x * sin, z]) / POSITION_SCALE

        body = jnp.stack(
            [there, sin, cos, pose[3], pose[4], pose[2] / POSITION_SCALE, memory.dwell_steps / self.dwell]
        )
        ranges = jnp.clip(view.sensor(0, "RangeScanner")[0] / POSITION_SCALE, 0.0, 1.0)
        return (jnp.concatenate([seen(point), there * seen(window), body, ranges])[None],)

    def privileged(self, view: TaskView, memory: InspectMemory) -> jax.Array:
        """The way to where it should go [m] (3,), velocities [m/s], [rad/s] (3,) each, clearance to 1 m."""
        robot = view.robots(0)
        near = jnp.minimum(wall_clearance(view), 1.0)[None]
        return jnp.concatenate([memory.target - robot.pos[0], robot.linear[0], robot.angular[0], near])

    def evaluate(self, view: TaskView, memory: InspectMemory) -> StepResult:
        """Looking, progress and touching."""
        robot, point = view.robots(0), self._present(memory)
        pos, axis = robot.pos[0], mat_from_quat(robot.quat[0])[:, 0]
        gap = point - pos
        far = jnp.linalg.norm(gap)
        # Without a division, as the robot may be at the point.
        ahead = jnp.dot(gap, axis) >= np.cos(self.view) * far
        # Rooms stand in a row of equal lengths, so the rounded share is a room's number.
        same = jnp.round(pos[0] / LONG) == jnp.round(point[0] / LONG)
        held = jnp.where(ahead & same & (far <= self.near), memory.dwell_steps + 1, 0)
        found = held >= self.dwell
        seen = memory.inspected_count + found
        # Rooms have no roof: a robot above the walls could pass by the windows.
        touched = (wall_clearance(view) <= self.touch) | (pos[2] > HIGH)
        # By the target before it changes: the way to the next point is no loss.
        nearer = memory.distance - jnp.linalg.norm(memory.target - pos)
        reward = nearer + self.bonus * found - self.haste - self.price * touched
        memory = memory.replace(inspected_count=seen, dwell_steps=jnp.where(found, 0, held))
        aim = self._aim(pos, self._present(memory))
        return StepResult(
            memory=memory.replace(target=aim, distance=jnp.linalg.norm(aim - pos)),
            reward=(reward[None],),
            terminated=touched | (seen == self.rooms),
            score=100.0 * seen / self.rooms,
            metrics={"touched": touched, "looks": held > 0, "distance": far},
        )


def wall_clearance(view: TaskView) -> jax.Array:
    """Return how far the robot's upright box is from walls beside it, 0 where they overlap [m] ()."""
    one, walls = jax.tree.map(lambda rows: rows[0], robot_boxes(view, 0)), obstacle_boxes(view)
    # A piece of wall below or above the box, as at a window, is not beside it.
    beside = (walls.high > one.low) & (walls.low < one.high)
    return jnp.where(beside, box_distance(one, walls), NO_OBSTACLE).min()


def _wall_with_window(x: float, y: float, z: float) -> list[Shape]:
    """Return the four pieces of a wall around a window whose middle is there."""
    low, high, half = y - WINDOW / 2, y + WINDOW / 2, WIDE / 2
    sides = [((-half, low), HIGH, 0.0), ((high, half), HIGH, 0.0)]
    sides += [((low, high), z - WINDOW / 2, 0.0), ((low, high), HIGH - z - WINDOW / 2, z + WINDOW / 2)]
    return [
        block((x, (a + b) / 2), (THICK, b - a, tall), z=foot, surface="wall") for (a, b), tall, foot in sides
    ]
