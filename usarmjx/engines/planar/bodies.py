"""The robots of a model as this engine sees them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.base.backend import set_rows
from usarmjx.base.components import parts
from usarmjx.base.fusion import kept_on_gpu
from usarmjx.engines.planar.drives import RollingGroup, rolling_groups
from usarmjx.engines.planar.footprints import Footprints
from usarmjx.engines.planar.responses import check_robot
from usarmjx.models.build.body_plan import kinematic_tree_of
from usarmjx.models.build.compose import add_robot
from usarmjx.models.build.layout import RobotIndex
from usarmjx.models.build.reach import STEP_SHARE
from usarmjx.models.spec.robot import RobotSpec


class Motion(struct.PyTreeNode, kw_only=True):
    """Where robots are and how they move.

    Attributes:
        pos: Chassis origins [m] (robots, 3).
        quat: Orientations (robots, 4).
        linear: Velocities, world axes [m/s] (robots, 3).
        angular: Rates of turn, chassis axes [rad/s] (robots, 3).
    """

    pos: Array
    quat: Array
    linear: Array
    angular: Array

    @property
    def unit(self) -> tuple[Array, ...]:
        """The numbers of their orientations, normalised (robots,) each."""
        w, x, y, z = parts(self.quat)
        size = jnp.sqrt(w * w + x * x + y * y + z * z)
        return w / size, x / size, y / size, z / size

    @property
    def yaw(self) -> Array:
        """Which way they head on the plan [rad] (robots,)."""
        w, x, y, z = self.unit
        return jnp.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))


@dataclass(frozen=True, eq=False)
class PlanarRobots:
    """The robots of a model, in the order of their slots.

    Attributes:
        root_qpos: Where in qpos they are (robots, 7).
        root_dof: Where in qvel (robots, 6).
        chassis: Body ids of the chassis (robots,).
        flies: Which fly or dive (robots,).
        rolling: Those that roll, by class.
        half: Half length and width of their footprints [m] (robots, 2).
        offset: Middles of the footprints on the chassis [m] (robots, 2).
        clearance: Height of the origins above what they stand on [m] (robots,).
        height: Of the robots [m] (robots,).
        step: How high a step they get onto [m] (robots,).
        mass: [kg] (robots,).
        centre: Centres of mass on the chassis [m] (robots, 3).
        inertia: About these [kg m^2] (robots, 3, 3).
        inverse_inertia: Its inverse (robots, 3, 3).
    """

    root_qpos: np.ndarray
    root_dof: np.ndarray
    chassis: np.ndarray
    flies: np.ndarray
    rolling: tuple[RollingGroup, ...]
    half: np.ndarray
    offset: np.ndarray
    clearance: np.ndarray
    height: np.ndarray
    step: np.ndarray
    mass: np.ndarray
    centre: np.ndarray
    inertia: np.ndarray
    inverse_inertia: np.ndarray

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.chassis)

    def motion(self, state: Any) -> Motion:  # noqa: ANN401 - a state with qpos and qvel
        """Return where the robots of one world are."""
        root = [state.qpos[places] for places in self.root_qpos.T]
        speed = [state.qvel[places] for places in self.root_dof.T]
        vectors = root[:3], root[3:], speed[:3], speed[3:]
        pos, quat, linear, angular = (jnp.stack(numbers, -1) for numbers in vectors)
        return Motion(pos=pos, quat=quat, linear=linear, angular=angular)

    def written(self, state: Any, motion: Motion) -> Any:  # noqa: ANN401 - a state with qpos and qvel
        """Return the state of one world with its robots elsewhere."""
        motion = kept_on_gpu(motion)
        root = jnp.concatenate([motion.pos, motion.quat], -1)
        speed = jnp.concatenate([motion.linear, motion.angular], -1)
        return state.replace(
            qpos=set_rows(state.qpos, (self.root_qpos, root)),
            qvel=set_rows(state.qvel, (self.root_dof, speed)),
        )

    def choose(self, flown: Motion, rolled: Motion) -> Motion:
        """Return what flies from one motion and the others from another."""
        if not self.flies.any():
            return rolled
        return jax.tree.map(lambda a, b: jnp.where(self.flies[:, None], a, b), flown, rolled)

    def footprints(self, motion: Motion) -> Footprints:
        """Return what robots take up on the plan."""
        yaw = motion.yaw
        low = motion.pos[:, 2] - self.clearance
        return Footprints(
            pos=motion.pos[:, :2] + on_plan(self.offset, yaw),
            yaw=yaw,
            half=jnp.asarray(self.half, jnp.float32),
            low=low,
            high=low + self.height,
            step=jnp.asarray(self.step, jnp.float32),
            mass=jnp.asarray(self.mass, jnp.float32),
        )


def on_plan(vector: Array, yaw: Array) -> Array:
    """Return vectors (n, 2) of robots that head somewhere (n,), in the axes of the plan."""
    x, y, cos, sin = vector[:, 0], vector[:, 1], jnp.cos(yaw), jnp.sin(yaw)
    return jnp.stack([x * cos - y * sin, x * sin + y * cos], -1)


def robots_of(model: mujoco.MjModel, robots: Sequence[tuple[RobotSpec, RobotIndex]]) -> PlanarRobots:
    """Return the robots of a model.

    Raises:
        UnsupportedFeatureError: One that this engine cannot move.
    """
    for robot, _ in robots:
        check_robot(robot)
    chassis = np.array([index.body_ids[0] for _, index in robots], int)
    boxes = np.array([footprint_of(robot) for robot, _ in robots]).reshape(-1, 2, 3)
    turn = np.zeros((len(chassis), 9))
    for row, body in zip(turn, chassis, strict=True):
        mujoco.mju_quat2Mat(row, model.body_iquat[body])
    axes = turn.reshape(-1, 3, 3)
    inertia = axes @ (model.body_inertia[chassis][:, :, None] * axes.transpose(0, 2, 1))
    plans = [kinematic_tree_of(robot) for robot, _ in robots]
    return PlanarRobots(
        root_qpos=np.array([index.root_qposadr + np.arange(7) for _, index in robots], int).reshape(-1, 7),
        root_dof=np.array([index.root_dofadr + np.arange(6) for _, index in robots], int).reshape(-1, 6),
        chassis=chassis,
        flies=np.array([robot.drive.pushes for robot, _ in robots], bool),
        rolling=rolling_groups(model, list(robots)),
        half=(boxes[:, 1] - boxes[:, 0])[:, :2] / 2,
        offset=(boxes[:, 1] + boxes[:, 0])[:, :2] / 2,
        clearance=np.array([plan.clearance for plan in plans]),
        height=(boxes[:, 1] - boxes[:, 0])[:, 2],
        step=np.array([STEP_SHARE * robot.wheel_radius for robot, _ in robots]),
        mass=model.body_subtreemass[chassis],
        centre=model.body_ipos[chassis],
        inertia=inertia,
        inverse_inertia=np.linalg.inv(inertia) if len(chassis) else inertia,
    )


@cache
def footprint_of(robot: RobotSpec) -> np.ndarray:
    """Return the box around all of a robot at rest that touches, on its chassis: extreme corners (2, 3)."""
    spec = mujoco.MjSpec()
    add_robot(spec, robot, "", (0.0, 0.0, 0.0))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    touches = np.flatnonzero((model.geom_contype != 0) | (model.geom_conaffinity != 0))
    corners: list[np.ndarray] = []
    for geom in touches.tolist():
        middle, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        mat = data.geom_xmat[geom].reshape(3, 3)
        centre, reach = data.geom_xpos[geom] + mat @ middle, np.abs(mat) @ half
        corners += [centre - reach, centre + reach]
    box = np.array(corners)
    return np.stack([box.min(0), box.max(0)])
