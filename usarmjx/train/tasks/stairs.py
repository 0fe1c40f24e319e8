"""A tracked robot climbs a flight of stairs, with the help of its flippers if it has some."""

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base.errors import UsageError
from usarmjx.base.rotations import mat_from_quat
from usarmjx.base.settings import AT_LEAST_ONE, NOT_NEGATIVE, POSITIVE
from usarmjx.models.drives import SkidSteer
from usarmjx.models.robots.kit import ENCODER_AXIS
from usarmjx.models.types.arena import START_ELEVATION, ArenaSpec, StartPose, start_tag
from usarmjx.models.types.robot import Mount, RobotSpec, options
from usarmjx.models.types.shapes import Shape
from usarmjx.sim.actions import Actions, JointAction
from usarmjx.sim.scene import Scene
from usarmjx.train.envs.recipe import spec_of
from usarmjx.train.envs.task import StepResult, Task, TaskView, drive_all
from usarmjx.train.tasks.drive_to_goal import goal_observation

WIDTH, PLATFORM = 2.4, 4.0
"""Of the stairs, and how far the platform at their top reaches [m]."""
DEPTH, STARTS = 0.8, 32
"""Distance of the goal from the platform's edge [m]; number of start poses."""
MAX_FLIPPER_ANGLE = 1.2
"""Flippers go so far up and down [rad]."""
TICK = 0.01
"""Of the encoders [rad]."""
FAN = options(
    MaxRange=2.0,
    MinRange=0.02,
    Resolution=0.2,
    ScanFov=1.4,
    ScanInterval=0.1,
    Noise=0.01,
    bPitch=True,
    bYaw=False,
)
"""8 beams in the upright plane through the robot's middle, from 40 degrees down to 40 up."""
BEAMS, REACH = 8, 2.0
FRONT, REAR = ("FRFlipper", "FLFlipper"), ("RRFlipper", "RLFlipper")


class StairsMemory(struct.PyTreeNode, kw_only=True):
    """The task's memory of an episode.

    Attributes:
        start_height: Height of the origin at the start [m] ().
        distance: From the origin to the goal [m] ().
        best: Largest share of the height that was gained ().
    """

    start_height: jax.Array
    distance: jax.Array
    best: jax.Array


@dataclass(frozen=True, kw_only=True)
class Stairs(Task):
    """Climb the stairs.

    The stairs begin at x = 0 and lead along x to a platform. The robot starts 0.6 to 1.0 m before them on
    the ground, up to 0.1 m and 0.15 rad askew.

    Observation, all by the INS, encoders and a scanner: the goal in the plane, see
    `drive_to_goal.goal_observation`; how much higher it is (1: 1 m); roll, and how far the nose is up [rad];
    how far front and rear flippers are up (1: 1.2 rad; not of robots without them); 8 ranges of a fan from 40
    degrees down to 40 up (1: 2 m).

    Action: the left and the right track, as shares of what they can do; front and rear flippers, from 1.2 rad
    down to 1.2 up (not of robots without them).

    Score: 90 times the largest share of the stairs' height by which the robot's origin was higher than at the
    start, at most 1; and 10 on arrival, when that share counts as 1.

    Reward: metres by which the origin came nearer to the goal in space, `bonus` on arrival, less `haste`,
    less `price` for a fall.

    The episode ends with a fall (its up axis more than 72.5 degrees off, cosine 0.3), and on arrival: the
    origin is 0.4 m beyond the edge of the last step, within 0.05 m of its height over the ground at the start
    plus that of the stairs, and its up axis less than 18 degrees off (cosine 0.95).

    Attributes:
        robot: Class of the robot, on tracks or on wheels that skid.
        steps: Number of steps of the stairs.
        rise: Height of a step [m].
        going: Depth of a step [m]. 0.18 by 0.257 makes 35 degrees.
        bonus: Reward on arrival.
        haste: Price of a step of time.
        price: Price of a fall.
        seed: Seed of the start poses.
    """

    about: ClassVar[str] = "A tracked robot climbs stairs."
    needs_solver: ClassVar[str] = "flippers that lift"

    repeat: int = 5
    episode_steps: int = 200
    robot: str | RobotSpec = "Kenaf"
    steps: Annotated[int, AT_LEAST_ONE] = 6
    rise: Annotated[float, POSITIVE] = 0.18
    going: Annotated[float, POSITIVE] = 0.257
    bonus: float = 2.0
    haste: float = 0.01
    price: float = 2.0
    seed: Annotated[int, NOT_NEGATIVE] = 0

    @property
    def robots(self) -> tuple[RobotSpec, ...]:
        """The robot, with the sensors that are read."""
        spec = spec_of(self.robot)
        if not isinstance(spec.drive, SkidSteer):
            raise UsageError(f"a {spec.name} on stairs: expected tracks, or wheels that skid")
        own = next((mount.at for mount in spec.sensors if mount.kind == "RangeScanner"), None)
        # Descriptions have z down, so this is above the top.
        top = (0.2 * spec.dimensions[0], 0.0, spec.origin_height - spec.dimensions[2] - 0.05)
        sensors = [
            Mount(kind="INS", name="INS", options=options(Sigma=0.01, ScanInterval=0.1)),
            Mount(kind="RangeScanner", name="Fan", at=own or top, options=FAN),
        ]
        if self._flippers(spec):
            turn = options(Resolution=TICK, Noise=0.0)
            sensors += [
                Mount(kind="Encoder", name=f"EC{part}", parent=part, direction=ENCODER_AXIS, options=turn)
                for part in (FRONT[0], REAR[0])
            ]
        return (replace(spec, sensors=tuple(sensors)),)

    @staticmethod
    def _flippers(spec: RobotSpec) -> bool:
        return {*FRONT, *REAR} <= {part.name for part in spec.parts}

    @property
    def height(self) -> float:
        """Of the platform [m]."""
        return self.steps * self.rise

    @property
    def edge(self) -> float:
        """Position of the last step's edge along x [m]."""
        return (self.steps - 1) * self.going

    @property
    def goal(self) -> np.ndarray:
        """Goal: x, y and height of the ground there [m] (3,)."""
        return np.array([self.edge + DEPTH, 0.0, self.height], np.float32)

    @property
    def arenas(self) -> ArenaSpec:
        """The stairs."""
        reach = [self.going] * (self.steps - 1) + [PLATFORM]
        shapes = [
            Shape(
                kind="box",
                size=(deep / 2, WIDTH / 2, self.rise * (i + 1) / 2),
                at=(self.going * i + deep / 2, 0.0, self.rise * (i + 1) / 2),
                surface="ground",
            )
            for i, deep in enumerate(reach)
        ]
        # The front, not the origin, starts 0.6 to 1.0 m before the first step.
        front = spec_of(self.robot).dimensions[0] / 2
        draw = np.random.default_rng(self.seed)
        places = draw.uniform((-1.0, -0.1, -0.15), (-0.6, 0.1, 0.15), (STARTS, 3)).round(3)
        starts = [
            StartPose(tag=start_tag(i), at=(float(x) - front, float(y), START_ELEVATION), yaw=float(yaw))
            for i, (x, y, yaw) in enumerate(places)
        ]
        return ArenaSpec(
            name="DM-Stairs",
            about="A flight of stairs.",
            shapes=tuple(shapes),
            starts=tuple(starts),
            extent=((-3.0, self.edge + PLATFORM), (-3.0, 3.0)),
        )

    def action_sizes(self, scene: Scene) -> tuple[int, ...]:
        """Tracks and flippers."""
        return (4 if self._flippers(scene.groups[0].robot) else 2,)

    def act(self, view: TaskView, memory: StairsMemory, actions: tuple[jax.Array, ...]) -> Actions:
        """Tracks and flippers: up is a negative angle in front, a positive one behind (manual 12.23)."""
        robot, action = view.scene.groups[0].robot, actions[0]
        drive = {0: drive_all(robot, action[:, :2])}
        if not self._flippers(robot):
            return Actions(drive=drive)
        front, rear = -MAX_FLIPPER_ANGLE * action[:, 2], MAX_FLIPPER_ANGLE * action[:, 3]
        targets = {**dict.fromkeys(FRONT, front), **dict.fromkeys(REAR, rear)}
        return Actions(drive=drive, joint_actions=(JointAction(group=0, targets=targets),))

    def start(self, view: TaskView, key: jax.Array) -> StairsMemory:
        """Nothing is gained."""
        del key
        pos = view.robots(0).pos[0]
        return StairsMemory(start_height=pos[2], distance=self._distance(pos, pos[2]), best=jnp.zeros(()))

    def _distance(self, pos: jax.Array, start_height: jax.Array) -> jax.Array:
        return jnp.linalg.norm(self.goal + start_height * np.array([0, 0, 1], np.float32) - pos)

    def observe(self, view: TaskView, memory: StairsMemory) -> tuple[jax.Array, ...]:
        """Goal, attitude, flippers and ranges."""
        pose = view.sensor(0, "INS")[0]
        # The INS knows where it starts, and so the height of the ground there.
        rise = self.height + memory.start_height - pose[2]
        # A positive pitch turns the nose down.
        seen = [goal_observation(pose, jnp.asarray(self.goal[:2])), jnp.stack([rise, pose[3], -pose[4]])]
        if self._flippers(view.scene.groups[0].robot):
            # Encoders that look to the left: their sign is the other one.
            seen.append(
                view.sensor(0, "Encoder")[0] * TICK / MAX_FLIPPER_ANGLE * np.array([1.0, -1.0], np.float32)
            )
        seen.append(jnp.clip(view.sensor(0, "RangeScanner")[0] / REACH, 0.0, 1.0))
        return (jnp.concatenate(seen)[None],)

    def privileged(self, view: TaskView, memory: StairsMemory) -> jax.Array:
        """The way to the goal [m] (3,), the up axis (3,) and the velocity [m/s] (3,)."""
        robot = view.robots(0)
        way = self.goal + memory.start_height * np.array([0, 0, 1], np.float32) - robot.pos[0]
        return jnp.concatenate([way, mat_from_quat(robot.quat[0])[:, 2], robot.linear[0]])

    def evaluate(self, view: TaskView, memory: StairsMemory) -> StepResult:
        """Height, arrival and falls."""
        robot = view.robots(0)
        pos, up = robot.pos[0], mat_from_quat(robot.quat[0])[2, 2]
        gained = pos[2] - memory.start_height
        distance = self._distance(pos, memory.start_height)
        level = jnp.abs(gained - self.height) < 0.05
        # By height as well: a robot that has climbed something else beside the goal has not arrived.
        there = level & (up > 0.95) & (pos[0] > self.edge + 0.4)
        fallen = up < 0.3
        best = jnp.maximum(memory.best, jnp.clip(gained / self.height, 0.0, 1.0))
        best = jnp.where(there, 1.0, best)
        reward = memory.distance - distance + self.bonus * there - self.haste - self.price * fallen
        return StepResult(
            memory=memory.replace(distance=distance, best=best),
            reward=(reward[None],),
            terminated=there | fallen,
            score=90.0 * best + 10.0 * there,
            metrics={"arrived": there, "fallen": fallen, "gained": gained},
        )
