"""Pose in which a robot class stands: contacts, springs and servos carry its weight, so nothing moves."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import mujoco
import numpy as np

from usarmjx.base.backend import Array, xp
from usarmjx.base.rotations import parts, quat_times
from usarmjx.models.compile.compose import RobotIndex, add_robot, index_robot, new_spec
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of, lowest_point
from usarmjx.models.compile.parts import parts_of
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.randomization import (
    DomainRandomization,
    RandomizedValues,
    Range,
    is_randomized,
)
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.robot import RobotSpec

START_GAP = 0.002
"""Robots that fly or dive, or cannot stand, start this far above the floor: none starts inside it [m]."""
SETTLING_STEPS, MEAN_STEPS = 600, 100
"""Steps of the reference's physics in which a robot settles: three seconds, as springs of cars and knees of
legs need two. Its pose is the mean over the last half second, as the solver's residual lets it tremble."""
MAX_SINKING, MAX_TILT = 0.005, 0.05
"""A robot whose chassis moves farther [m] or tilts more [rad] than this does not stand by itself."""
HELD = 1e9
"""Inertia of a chassis that stays where it is [kg, kg m2]."""
SINGLE = 1e-6
"""Resolution of heights in single precision [m]."""
MAX_LEAN = 0.5
"""A robot that leans farther on wheels of another size has fallen over: it starts level [rad]."""
GROUND = ArenaSpec(name="ground", starts=(), extent=((-2, 2), (-2, 2)))
"""Level ground on which robots settle."""
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
"""Orientation of a chassis that does not tilt."""
WHEEL_KNOTS, MASS_KNOTS = 9, 3
"""Entries over a range. Between wheels of 0.8 and 1.25 the tilt of a robot with a caster is interpolated to
1.4e-5 rad; springs are linear."""
ALWAYS = (1.0, 1.0)
"""Range of what does not vary."""


@dataclass(frozen=True, eq=False)
class Stance:
    """Pose in which robots of a class rest on level ground, heading along x.

    Attributes:
        height: Height of the chassis' origin above the ground [m].
        tilt: Orientation of the chassis, of yaw 0 (4,).
        joints: Positions of the joints in the order of `parts_of`; wheels are at 0 [rad or m] (joints,).
        sinking: Depth of the lowest point below the ground, rounded up; 0: they do not stand [m].
    """

    height: float
    tilt: np.ndarray
    joints: np.ndarray
    sinking: float

    def tilted(self, quat: Array) -> np.ndarray:
        """Return an orientation (4,) with the tilt."""
        return np.stack(quat_times(parts(np.asarray(quat, float)), parts(self.tilt)))


@cache
def stance_of(robot: RobotSpec) -> Stance:
    """Return the pose in which robots of a class stand: contacts, springs and servos give way to weight.

    Those that fly, dive or cannot stand are level, `START_GAP` above the ground; their servos give way, too.
    """
    (model, index), clearance = _on_ground(robot), kinematic_tree_of(robot).clearance
    if not robot.drive.applies_wrench:
        # Settled by the physics instead of computed: contacts, springs and servos all give way at once.
        rest = _settled(model, index, GROUND.floor + clearance)
        height, tilt = float(rest[2]) - GROUND.floor, _without_yaw(rest[3:7])
        # Of small tilts the vector part of a quaternion is half the angle.
        if abs(height - clearance) < MAX_SINKING and 2 * math.hypot(*tilt[1:3]) < MAX_TILT:
            joints = _without_wheels(robot, rest[7:])
            solid = np.isin(model.geom_bodyid, index.body_ids)
            low = _lowest_point(model, index, np.array([0.0, 0.0, height, *tilt]), joints, solid)
            return Stance(height, tilt, joints, math.ceil(max(0.0, -low) / SINGLE) * SINGLE)
    model.dof_armature[index.root_dofadr : index.root_dofadr + 6] = HELD  # its joints feel their weight
    rest = _settled(model, index, GROUND.floor + clearance + START_GAP)
    return Stance(clearance + START_GAP, LEVEL, _without_wheels(robot, rest[7:]), 0.0)


@cache
def varied_stance(robot: RobotSpec, wheel: float, mass: float) -> Stance:
    """Return the pose in which robots of a class stand whose wheels and chassis are not those of the class.

    Those that cannot stand, or fall over, start level, as far above the ground as on their own wheels.

    Args:
        robot: The class.
        wheel: Factor on the radius of its wheels.
        mass: Factor on the mass of its chassis.
    """
    usual, (model, index) = stance_of(robot), _on_ground(robot)
    # The first body is the chassis, which is no part.
    rolls = [body for body, part in zip(index.body_ids[1:], parts_of(robot), strict=True) if part.is_wheel]
    resize_wheels(model, np.isin(model.geom_bodyid, rolls), wheel)
    chassis = index.body_ids[0]
    model.body_mass[chassis] *= mass
    model.body_inertia[chassis] *= mass
    # Derived constants such as `body_subtreemass` still belong to the old mass.
    mujoco.mj_setConst(model, mujoco.MjData(model))
    touches = (model.geom_contype | model.geom_conaffinity) != 0
    solid = touches & np.isin(model.geom_bodyid, index.body_ids)
    root = np.array([0.0, 0.0, 0.0, *LEVEL])
    low = _lowest_point(model, index, root, np.zeros(len(index.qposadr)), solid)
    if usual.sinking > 0:
        rest = _settled(model, index, GROUND.floor - low)
        height, tilt = float(rest[2]) - GROUND.floor, _without_yaw(rest[3:7])
        if 2 * math.hypot(*tilt[1:3]) < MAX_LEAN:
            return Stance(height, tilt, _without_wheels(robot, rest[7:]), usual.sinking)
    # Such a robot has no stance to compare with: only its lowest point is lifted or lowered.
    before = _lowest_point(*_on_ground(robot), root, np.zeros(len(index.qposadr)), solid)
    return Stance(usual.height + before - low, usual.tilt, usual.joints, usual.sinking)


def resize_wheels(model: mujoco.MjModel, geoms: np.ndarray, factor: float) -> None:
    """Change the radius of a model's masked cylinders (ngeom,) by a factor."""
    # The bounding volume hierarchy has the compiled sizes, so all geom pairs are tested.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_MIDPHASE
    model.geom_size[geoms, 0] *= factor
    # Radius in x and y only: the width stays.
    model.geom_aabb[geoms, 3:5] *= factor
    model.geom_rbound[geoms] = np.linalg.norm(model.geom_size[geoms, :2], axis=-1)


def _on_ground(robot: RobotSpec) -> tuple[mujoco.MjModel, RobotIndex]:
    """Return the model of a robot alone on level ground, and its place in it."""
    spec = new_spec(GROUND, Physics())
    add_robot(spec, robot, "", (0.0, 0.0, 0.0))
    model = spec.compile()
    return model, index_robot(model, robot, "")


def _settled(model: mujoco.MjModel, index: RobotIndex, height: float) -> np.ndarray:
    """Return pose and joints (7 + joints,) of a robot that settles, started level at a height [m]."""
    data = mujoco.MjData(model)
    root = slice(index.root_qposadr, index.root_qposadr + 7)
    # Without its holding actuators a robot's servos would be slack.
    data.ctrl[list(index.hold_actuator_ids)] = 1.0
    data.qpos[root] = 0.0, 0.0, height, 1.0, 0.0, 0.0, 0.0
    total, own = np.zeros(model.nq), [*range(model.nq)[root], *index.qposadr]
    for step in range(SETTLING_STEPS):
        mujoco.mj_step(model, data)
        # Quaternions may be averaged here: they differ by trembling alone.
        total += data.qpos * (step >= SETTLING_STEPS - MEAN_STEPS)
    return total[own] / MEAN_STEPS


def _without_yaw(quat: np.ndarray) -> np.ndarray:
    """Return an orientation of little tilt (4,) turned about the vertical to yaw 0."""
    # Heading alone, reversed: its product with the orientation leaves the tilt.
    back = quat * (1.0, 0.0, 0.0, -1.0)
    w, x, y, _ = quat_times(parts(back), parts(quat))
    turned = np.array([w, x, y, -x * y / w])  # yaw 0 is x y + w z = 0
    return turned / np.linalg.norm(turned)


def _without_wheels(robot: RobotSpec, joints: np.ndarray) -> np.ndarray:
    return np.where([part.is_wheel for part in parts_of(robot)], 0.0, joints)


def _lowest_point(
    model: mujoco.MjModel, index: RobotIndex, root: np.ndarray, joints: np.ndarray, solid: np.ndarray
) -> float:
    """Return the height of the lowest point of masked geoms (ngeom,) in a pose (7,) with joints (n,) [m]."""
    data = mujoco.MjData(model)
    data.qpos[index.root_qposadr : index.root_qposadr + 7] = root
    data.qpos[list(index.qposadr)] = joints
    mujoco.mj_kinematics(model, data)
    return lowest_point(model, data, solid)


def standing_height(robot: RobotSpec) -> float:
    """Return the height above level ground of the chassis' origin of a robot that stands [m].

    It is less than the height at which the robot just touches: contacts give way, by 0.1 mm for most classes.
    """
    return stance_of(robot).height


@dataclass(frozen=True, eq=False)
class VariedStances:
    """Stances of robots of one class.

    Attributes:
        lift: Changes of the standing height [m] (n,).
        tilt: Orientations of the chassis, of yaw 0 (n, 4).
        joints: Positions of the joints, see `Stance` (n, joints).
    """

    lift: Array
    tilt: Array
    joints: Array


def stances_in(
    vary: DomainRandomization | None,
    varied: RandomizedValues | None,
    robot: RobotSpec,
    slots: Sequence[int] | np.ndarray,
) -> VariedStances | None:
    """Return the stances of robots of a class in one world; None: all have that of the class.

    Args:
        vary: The ranges.
        varied: The world's values.
        robot: The class.
        slots: The robots (n,).
    """
    if vary is None or varied is None or not is_randomized(vary, robot):
        return None
    wheel, mass = vary.wheel, vary.mass
    if wheel is None and mass is None:
        return None
    table, one = _table_of(robot, wheel or ALWAYS, mass or ALWAYS), xp.ones(len(slots))
    where = np.asarray(slots)
    numbers = _interpolated(
        table,
        _place(wheel, WHEEL_KNOTS, one if varied.wheel is None else varied.wheel[where]),
        _place(mass, MASS_KNOTS, one if varied.mass is None else varied.mass[where]),
    )
    # Between two unit quaternions the interpolated one is a little short.
    tilt = numbers[:, 1:5] / xp.sqrt((numbers[:, 1:5] ** 2).sum(-1, keepdims=True))
    return VariedStances(lift=numbers[:, 0], tilt=tilt, joints=numbers[:, 5:])


@cache
def _table_of(robot: RobotSpec, wheel: Range, mass: Range) -> np.ndarray:
    """Return lift, tilt and joints by wheel and mass (WHEEL_KNOTS, MASS_KNOTS, 5 + joints)."""
    usual = stance_of(robot).height

    # A range that does not vary has the same value at all knots.
    @cache
    def row(factor: float, load: float) -> np.ndarray:
        stance = varied_stance(robot, factor, load)
        return np.array([stance.height - usual, *stance.tilt, *stance.joints], np.float32)

    loads = np.linspace(*mass, MASS_KNOTS).tolist()
    factors = np.linspace(*wheel, WHEEL_KNOTS).tolist()
    return np.array([[row(factor, load) for load in loads] for factor in factors])


def _place(span: Range | None, knots: int, value: Array) -> tuple[Array, Array]:
    """Return the entries below values (n,) in a range, and their shares of the way to the next (n, 1)."""
    low, high = span or ALWAYS
    # The bound is for a range of a single value, in which any entry is right.
    place = xp.clip((value - low) / max((high - low) / (knots - 1), 1e-9), 0.0, knots - 1.0)
    # The end of the range belongs to its last interval.
    below = xp.clip(xp.floor(place), 0.0, knots - 2.0)
    return below.astype(xp.int32), (place - below)[:, None]


def _interpolated(table: np.ndarray, wheel: tuple[Array, Array], mass: tuple[Array, Array]) -> Array:
    """Return entries of a table between four of its own (n, numbers)."""
    known = xp.asarray(table)
    (row, along), (column, across) = wheel, mass

    def in_row(row: Array) -> Array:
        return known[row, column] * (1.0 - across) + known[row, column + 1] * across

    return in_row(row) * (1.0 - along) + in_row(row + 1) * along
