"""Bodies of engine `planar`: fixed, loose and hinged bodies, joint servos, and robots as rigid footprints."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct

from usarmjx.base.backend import Array, set_rows
from usarmjx.base.compilation import materialize
from usarmjx.base.errors import UnsupportedFeatureError
from usarmjx.base.rotations import mat_from_quat, matmul, parts, quat_times
from usarmjx.engines.planar.drives import RollingGroup, rolling_groups
from usarmjx.engines.planar.footprints import Footprints
from usarmjx.engines.planar.responses import check_robot
from usarmjx.models.compile.compose import RobotIndex, add_robot
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.compile.randomization import DomainRandomization, RandomizedValues
from usarmjx.models.compile.reachability import STEP_SHARE
from usarmjx.models.compile.standing import stance_of, stances_in, standing_height
from usarmjx.models.types.robot import HOLD_SUFFIX, RobotSpec

FREE_JOINT, HINGE_JOINT = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_HINGE)
"""MuJoCo joint types of movable bodies."""


@dataclass(frozen=True, eq=False)
class FixedBodies:
    """Bodies other than robots, which stay at their qpos.

    Attributes:
        pos: Origins of all bodies of the model at the reference pose [m] (nbody, 3).
        mat: Their orientations (nbody, 3, 3).
        free: Loose bodies (n,).
        free_qpos: Their indices in qpos (n, 7).
        hinged: Bodies on a hinge (n,).
        hinge_qpos: Indices of their angles in qpos (n,).
        axis: Hinge axes, in the body's frame (n, 3).
    """

    pos: np.ndarray
    mat: np.ndarray
    free: np.ndarray
    free_qpos: np.ndarray
    hinged: np.ndarray
    hinge_qpos: np.ndarray
    axis: np.ndarray

    @property
    def movable(self) -> np.ndarray:
        """Bodies that can leave the reference pose (n,)."""
        return np.concatenate([self.free, self.hinged])

    def poses(self, qpos: Array) -> tuple[Array, Array]:
        """Return origins (nbody, 3) and orientations (nbody, 3, 3); robots at the reference pose."""
        pos, mat = jnp.asarray(self.pos, jnp.float32), jnp.asarray(self.mat, jnp.float32)
        if len(self.free):
            here = qpos[self.free_qpos]
            pos = set_rows(pos, (self.free, here[:, :3]))
            mat = set_rows(mat, (self.free, mat_from_quat(here[:, 3:])))
        if len(self.hinged):
            half = qpos[self.hinge_qpos][:, None] / 2
            turn = mat_from_quat(jnp.concatenate([jnp.cos(half), jnp.sin(half) * self.axis], -1))
            # On the right: hinges turn about axes of their own bodies.
            mat = set_rows(mat, (self.hinged, matmul(mat[self.hinged], turn)))
        return pos, mat


def fixed_bodies(model: mujoco.MjModel, robot_bodies: set[int]) -> FixedBodies:
    """Return the bodies of a model that are not part of a robot.

    Raises:
        UnsupportedFeatureError: A body has a joint that this engine does not support.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    joints = [j for j in range(model.njnt) if int(model.jnt_bodyid[j]) not in robot_bodies]
    free = [j for j in joints if model.jnt_type[j] == FREE_JOINT]
    hinges = [j for j in joints if model.jnt_type[j] == HINGE_JOINT]
    unsupported = set(joints) - set(free) - set(hinges)
    # A hinge is supported only at its body's origin and on a child of the world.
    unsupported |= {
        j for j in hinges if np.any(model.jnt_pos[j]) or model.body_parentid[model.jnt_bodyid[j]] != 0
    }
    if unsupported:
        names = ", ".join(repr(model.joint(j).name) for j in sorted(unsupported)[:4])
        raise UnsupportedFeatureError(
            f"engine 'planar' cannot run this scene: joints {names}: beside robots it knows "
            "bodies that are fixed, that lie loose, or that turn on one hinge"
        )
    return FixedBodies(
        pos=data.xpos.copy(),
        mat=data.xmat.reshape(-1, 3, 3).copy(),
        free=model.jnt_bodyid[free],
        free_qpos=model.jnt_qposadr[free][:, None] + np.arange(7),
        hinged=model.jnt_bodyid[hinges],
        hinge_qpos=model.jnt_qposadr[hinges],
        axis=model.jnt_axis[hinges],
    )


@dataclass(frozen=True, eq=False)
class PlanarServos:
    """Servos of a model, see `models.compile.compose`.

    Attributes:
        pull: Position actuators, which pull towards a target (n,).
        hold: Hold actuators of the same joints (n,).
        act: Indices of the targets in act (n,).
        qpos: Indices of the joints in qpos (n,).
        qvel: Indices of the joints in qvel (n,).
        lag: Time by which a moving joint trails its target: damping over stiffness [s] (n,).
        low: Lower joint limits (n,).
        high: Upper joint limits (n,).
        droop: Distance by which robots' weight moves joints from their targets, that of `stance_of` (n,).
        geared_qpos: Pairs of joints of which the first follows the second, indices in qpos (pairs, 2).
        geared_qvel: The same, indices in qvel (pairs, 2).
        gears: Offset and ratio of each pair's first position to its second (pairs, 2).
    """

    pull: np.ndarray
    hold: np.ndarray
    act: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    lag: np.ndarray
    low: np.ndarray
    high: np.ndarray
    droop: np.ndarray
    geared_qpos: np.ndarray
    geared_qvel: np.ndarray
    gears: np.ndarray


def servos_of(model: mujoco.MjModel, robots: Sequence[tuple[RobotSpec, RobotIndex]] = ()) -> PlanarServos:
    """Return the servos of a model, which give way under the weight of these robots as when they stand."""
    droop = np.zeros(model.nq)
    for robot, index in robots:
        droop[list(index.qposadr)] = stance_of(robot).joints
    names = [model.actuator(i).name for i in range(model.nu)]
    holds = [i for i, name in enumerate(names) if name.endswith(HOLD_SUFFIX)]
    pulls = [names.index(names[i].removesuffix(HOLD_SUFFIX)) for i in holds]
    joints = model.actuator_trnid[pulls, 0].astype(int)
    gains = model.actuator_biasprm[holds], model.actuator_gainprm[holds]
    # Hold actuators have an affine gain: ctrl times (-stiffness q - damping v).
    damping, stiffness = -gains[1][:, 2], -gains[1][:, 1]
    limited = model.jnt_limited[joints].astype(bool)
    gears = model.eq_type == mujoco.mjtEq.mjEQ_JOINT
    # An equality of joints is a polynomial in the second one: of its coefficients only offset and ratio are
    # used.
    pairs = np.stack([model.eq_obj1id[gears], model.eq_obj2id[gears]], -1).astype(int).reshape(-1, 2)
    return PlanarServos(
        pull=np.array(pulls, int),
        hold=np.array(holds, int),
        act=model.actuator_actadr[pulls].astype(int),
        qpos=model.jnt_qposadr[joints].astype(int),
        qvel=model.jnt_dofadr[joints].astype(int),
        # A servo without stiffness never follows: the bound makes its lag huge instead of infinite.
        lag=damping / np.maximum(stiffness, 1e-9),
        # MuJoCo has a range of zeros for joints without limits.
        low=np.where(limited, model.jnt_range[joints, 0], -np.inf),
        high=np.where(limited, model.jnt_range[joints, 1], np.inf),
        droop=droop[model.jnt_qposadr[joints]],
        geared_qpos=model.jnt_qposadr[pairs].astype(int),
        geared_qvel=model.jnt_dofadr[pairs].astype(int),
        gears=model.eq_data[gears, :2].astype(np.float32).reshape(-1, 2),
    )


def move_joints(servos: PlanarServos, state: Any, ctrl: Array, act: Array, dt: float) -> Any:  # noqa: ANN401
    """Return the state of one world after its joints have followed their targets.

    The target moves at the speed of `ctrl`; the joint follows as a servo with stiffness and damping under a
    constant load does, by the exact solution. A joint in torque mode stays.

    Args:
        servos: The servos.
        state: State with qpos (nq,), qvel (nv,) and act (na,).
        ctrl: Inputs (nu,).
        act: Activations at the beginning (na,).
        dt: Time step [s].
    """
    speed, aim = ctrl[servos.pull], act[servos.act]
    # Without damping the joint would jump to its target at an infinite speed.
    before, lag = state.qpos[servos.qpos], jnp.maximum(jnp.asarray(servos.lag), 1e-4)
    behind = aim + servos.droop - before
    # Exact solution of lag * q' = target - q for a target that moves at constant speed.
    later = speed * lag + (behind - speed * lag) * jnp.exp(-dt / lag)
    after = jnp.clip(aim + servos.droop + speed * dt - later, servos.low, servos.high)
    held = ctrl[servos.hold] > 0
    after = jnp.where(held, after, before)
    # The derivative of the exact solution at the end of the step.
    rate = jnp.where(held, later / lag, 0.0)
    qpos, qvel = set_rows(state.qpos, (servos.qpos, after)), set_rows(state.qvel, (servos.qvel, rate))
    if len(servos.geared_qpos):
        offset, ratio = servos.gears.T
        first, second = servos.geared_qpos.T
        qpos = set_rows(qpos, (first, offset + ratio * qpos[second]))
        first, second = servos.geared_qvel.T
        qvel = set_rows(qvel, (first, ratio * qvel[second]))
    return state.replace(qpos=qpos, qvel=qvel, act=set_rows(act, (servos.act, aim + speed * dt)))


class Motion(struct.PyTreeNode, kw_only=True):
    """Poses and velocities of robots.

    Attributes:
        pos: Chassis origins [m] (robots, 3).
        quat: Orientations (robots, 4).
        linear: Velocities, world axes [m/s] (robots, 3).
        angular: Angular velocities, chassis axes [rad/s] (robots, 3).
    """

    pos: Array
    quat: Array
    linear: Array
    angular: Array

    @property
    def unit(self) -> tuple[Array, ...]:
        """Components of the normalised orientations (robots,) each."""
        w, x, y, z = parts(self.quat)
        size = jnp.sqrt(w * w + x * x + y * y + z * z)
        return w / size, x / size, y / size, z / size

    @property
    def yaw(self) -> Array:
        """Headings [rad] (robots,)."""
        w, x, y, z = self.unit
        return jnp.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))


@dataclass(frozen=True, eq=False)
class PlanarRobots:
    """Robots of a model, by slot.

    Attributes:
        specs: Their classes.
        root_qpos: Indices of the chassis in qpos (robots, 7).
        root_dof: Indices of the chassis in qvel (robots, 6).
        chassis: Body ids of the chassis (robots,).
        flies: Which robots fly or dive (robots,).
        rolling: Rolling robots, by class.
        half: Half length and width of the footprints [m] (robots, 2).
        offset: Centres of the footprints on the chassis [m] (robots, 2).
        clearance: Height of the origins above the ground [m] (robots,).
        tilt: Orientations on level ground, of yaw 0 (robots, 4).
        height: Heights of the robots [m] (robots,).
        step: Highest step that each climbs [m] (robots,).
        mass: Masses [kg] (robots,).
        centre: Centres of mass on the chassis [m] (robots, 3).
        inertia: Inertia about these [kg m^2] (robots, 3, 3).
        inverse_inertia: Its inverse (robots, 3, 3).
    """

    specs: tuple[RobotSpec, ...]
    root_qpos: np.ndarray
    root_dof: np.ndarray
    chassis: np.ndarray
    flies: np.ndarray
    rolling: tuple[RollingGroup, ...]
    half: np.ndarray
    offset: np.ndarray
    clearance: Array
    tilt: Array
    height: Array
    step: np.ndarray
    mass: np.ndarray
    centre: np.ndarray
    inertia: np.ndarray
    inverse_inertia: np.ndarray

    @property
    def count(self) -> int:
        """Number of robots."""
        return len(self.chassis)

    def varied(self, vary: DomainRandomization | None, values: RandomizedValues | None) -> "PlanarRobots":
        """Return the robots as they stand in one world; these, if all stand as their classes do.

        Args:
            vary: The ranges.
            values: The world's values.
        """
        robots = self
        for robot in dict.fromkeys(self.specs):
            members = np.flatnonzero([spec is robot for spec in self.specs])
            # By class, because a stance is computed from the class's geometry.
            own = stances_in(vary, values, robot, members)
            if own is not None:
                lift = set_rows(jnp.zeros(self.count, jnp.float32), (members, own.lift))
                robots = replace(
                    robots,
                    clearance=robots.clearance + lift,
                    height=robots.height + lift,
                    tilt=set_rows(jnp.asarray(robots.tilt), (members, own.tilt)),
                )
        return robots

    def without_tilt(self, motion: "Motion") -> "Motion":
        """Return the robots' motion with the orientations that they would have without their own tilt."""
        # An orientation is heading times tilt: the conjugate on the right takes the tilt off.
        w, x, y, z = parts(self.tilt)
        return motion.replace(quat=jnp.stack(quat_times(parts(motion.quat), (w, -x, -y, -z)), -1))

    def motion(self, state: Any) -> Motion:  # noqa: ANN401 - a state with qpos and qvel
        """Return the motion of the robots of one world."""
        root = [state.qpos[places] for places in self.root_qpos.T]
        speed = [state.qvel[places] for places in self.root_dof.T]
        vectors = root[:3], root[3:], speed[:3], speed[3:]
        pos, quat, linear, angular = (jnp.stack(numbers, -1) for numbers in vectors)
        return Motion(pos=pos, quat=quat, linear=linear, angular=angular)

    def write(self, state: Any, motion: Motion) -> Any:  # noqa: ANN401 - a state with qpos and qvel
        """Return the state of one world with its robots' motion replaced."""
        # The motion is written to two arrays: unmaterialised, XLA computes it once for each number there.
        motion = materialize(motion)
        root = jnp.concatenate([motion.pos, motion.quat], -1)
        speed = jnp.concatenate([motion.linear, motion.angular], -1)
        return state.replace(
            qpos=set_rows(state.qpos, (self.root_qpos, root)),
            qvel=set_rows(state.qvel, (self.root_dof, speed)),
        )

    def choose(self, flown: Motion, rolled: Motion) -> Motion:
        """Select one motion for flying robots and another for the rest."""
        if not self.flies.any():
            return rolled
        return jax.tree.map(lambda a, b: jnp.where(self.flies[:, None], a, b), flown, rolled)

    def footprints(self, motion: Motion) -> Footprints:
        """Return the robots' footprints."""
        yaw = motion.yaw
        # A tilted robot counts as level: its footprint does not shrink on slopes.
        low = motion.pos[:, 2] - self.clearance
        return Footprints(
            pos=motion.pos[:, :2] + rotate_by_yaw(self.offset, yaw),
            yaw=yaw,
            half=jnp.asarray(self.half, jnp.float32),
            low=low,
            high=low + self.height,
            step=jnp.asarray(self.step, jnp.float32),
            mass=jnp.asarray(self.mass, jnp.float32),
        )


def rotate_by_yaw(vector: Array, yaw: Array) -> Array:
    """Rotate vectors (n, 2) by yaw angles (n,), from robot axes to world axes."""
    x, y, cos, sin = vector[:, 0], vector[:, 1], jnp.cos(yaw), jnp.sin(yaw)
    return jnp.stack([x * cos - y * sin, x * sin + y * cos], -1)


def _clearance(robot: RobotSpec) -> float:
    """Return the height at which a robot stands, or may fly at least, above the ground [m]."""
    return kinematic_tree_of(robot).clearance if robot.drive.applies_wrench else standing_height(robot)


def robots_of(model: mujoco.MjModel, robots: Sequence[tuple[RobotSpec, RobotIndex]]) -> PlanarRobots:
    """Return the robots of a model.

    Raises:
        UnsupportedFeatureError: A robot cannot be moved by this engine.
    """
    for robot, _ in robots:
        check_robot(robot)
    chassis = np.array([index.body_ids[0] for _, index in robots], int)
    # Reshaped, as without robots the array has one axis only.
    boxes = np.array([footprint_box(robot) for robot, _ in robots]).reshape(-1, 2, 3)
    turn = np.zeros((len(chassis), 9))
    for row, body in zip(turn, chassis, strict=True):
        mujoco.mju_quat2Mat(row, model.body_iquat[body])
    axes = turn.reshape(-1, 3, 3)
    # MuJoCo has principal moments in axes of their own: R diag(I) R^T is the inertia in the chassis' axes.
    inertia = axes @ (model.body_inertia[chassis][:, :, None] * axes.transpose(0, 2, 1))
    return PlanarRobots(
        specs=tuple(robot for robot, _ in robots),
        root_qpos=np.array([index.root_qposadr + np.arange(7) for _, index in robots], int).reshape(-1, 7),
        root_dof=np.array([index.root_dofadr + np.arange(6) for _, index in robots], int).reshape(-1, 6),
        chassis=chassis,
        flies=np.array([robot.drive.applies_wrench for robot, _ in robots], bool),
        rolling=rolling_groups(model, list(robots)),
        half=(boxes[:, 1] - boxes[:, 0])[:, :2] / 2,
        offset=(boxes[:, 1] + boxes[:, 0])[:, :2] / 2,
        clearance=np.array([_clearance(robot) for robot, _ in robots]),
        tilt=np.array([stance_of(robot).tilt for robot, _ in robots], np.float32).reshape(-1, 4),
        height=(boxes[:, 1] - boxes[:, 0])[:, 2],
        step=np.array([STEP_SHARE * robot.wheel_radius for robot, _ in robots]),
        # Everything that hangs on the chassis is pushed along with it.
        mass=model.body_subtreemass[chassis],
        centre=model.body_ipos[chassis],
        inertia=inertia,
        inverse_inertia=np.linalg.inv(inertia) if len(chassis) else inertia,
    )


@cache
def footprint_box(robot: RobotSpec) -> np.ndarray:
    """Return the bounding box of a robot's colliding geoms at rest, on its chassis: two corners (2, 3)."""
    spec = mujoco.MjSpec()
    add_robot(spec, robot, "", (0.0, 0.0, 0.0))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    # Visual geoms and sensors that stick out do not count.
    touches = np.flatnonzero((model.geom_contype != 0) | (model.geom_conaffinity != 0))
    corners: list[np.ndarray] = []
    for geom in touches.tolist():
        middle, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        mat = data.geom_xmat[geom].reshape(3, 3)
        centre, reach = data.geom_xpos[geom] + mat @ middle, np.abs(mat) @ half
        corners += [centre - reach, centre + reach]
    box = np.array(corners)
    return np.stack([box.min(0), box.max(0)])
