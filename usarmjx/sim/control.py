"""From commands to actuators: the motor inputs of one robot for one control step."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cache
from typing import NamedTuple

import jax
import numpy as np
from flax import struct

from usarmjx.base.backend import Array, ArrayLike, known_all, known_none, named_scope, xp
from usarmjx.base.errors import UnknownNameError
from usarmjx.base.nodes import Node
from usarmjx.base.rotations import mat_from_quat, matvec, up_from_quat
from usarmjx.base.transforms import GRAVITY
from usarmjx.models.compile.kinematic_tree import KinematicTree, Servos, actuated_servos
from usarmjx.models.compile.parts import joint_names, parts_of
from usarmjx.models.drives.base import RobotState
from usarmjx.models.drives.ground import SkidSteer, YieldingSkidSteer
from usarmjx.models.types.robot import STALL_SPEED, RobotSpec


def joint_efforts(plan: KinematicTree, state: RobotState, act: Array, hold: Array) -> Array:
    """Return the torque or force that acts on each joint [N m or N] (..., joints); 0 without a motor.

    Args:
        plan: Body plan of the robot class.
        state: The robots; all arguments have the same leading axes (...,).
        act: Activations of their pulling actuators (..., actuators).
        hold: Inputs of their holding actuators (..., actuators).
    """
    here, servos = actuated_servos(plan)
    pos, vel = state.joint_pos[..., here], state.joint_vel[..., here]
    # Both actuators of a joint together: the pulling one exerts stiffness * act, the holding one takes spring
    # and damper off it.
    unclipped = servos.stiffness * act - hold * (servos.stiffness * pos + servos.damping * vel)
    limit = _most_efforts(servos)
    effort = xp.clip(unclipped, -limit, limit)
    # A product instead of `.at[].add`: NumPy has no such call, and scatters are slow on GPUs.
    return effort @ _joints_of_actuators(plan)


@cache
def _most_efforts(servos: Servos) -> np.ndarray:
    """Return the largest effort of each servo [N m or N] (actuators,)."""
    return servos.stiffness * np.maximum(servos.windup_limit, servos.brake_limit)


@cache
def _joints_of_actuators(plan: KinematicTree) -> np.ndarray:
    """Return 1 where an actuator moves a joint, else 0 (actuators, joints)."""
    # Part 0 is the chassis, which has no joint.
    scatter = np.zeros((len(plan.actuated), len(plan.parts) - 1), np.float32)
    scatter[np.arange(len(plan.actuated)), plan.actuated] = 1.0
    return scatter


class Joints(NamedTuple):
    """Joints with a motor, and what their servos did in the step before (..., actuators).

    Attributes:
        pos: Positions [rad or m].
        vel: Velocities [rad/s or m/s].
        act: Activations of the pulling actuators [rad or m].
        held: Whether the holding actuators held them.
    """

    pos: Array
    vel: Array
    act: Array
    held: Array


def torque_inputs(
    servos: Servos, torque: Array, speed: Array, joints: Joints, period: float
) -> tuple[Array, Array, Array]:
    """Return the inputs and activations of actuators that carry out torque orders (`ActuatorInputs`).

    Args:
        servos: Constants of the servos (actuators,).
        torque: Commanded torque of each joint, no more than its motor can [N m or N] (..., actuators).
        speed: Top speed of each joint [rad/s or m/s] (..., actuators).
        joints: The joints and what their servos did (..., actuators).
        period: Length of a control step [s].

    Returns:
        ctrl: Inputs of the pulling actuators.
        hold: Inputs of the holding ones: 0 where the joint exerts exactly the torque.
        act: Activations of the pulling ones.
    """
    sign, bound = xp.sign(torque), xp.abs(torque)
    margin = speed - sign * joints.vel
    # A joint has the inertia of its motor at least, whatever load hangs on it: a torque that cannot take the
    # bare motor past its top speed within a step may act in full.
    exact = bound * period <= servos.armature * margin
    # At this target spring and damper of the servo cancel: stiffness (act - pos) - damping vel is 0.
    equilibrium = joints.pos + servos.lead * joints.vel
    # This much takes a joint that carries nothing just to its top speed.
    settled_force = servos.damping * margin
    present_force = sign * servos.stiffness * (joints.act - equilibrium)
    # More than this share of it per step would make a bare motor overshoot: so it is critically damped.
    correction = xp.minimum(0.25 * servos.damping * period / servos.armature, 1.0)
    force = xp.where(joints.held, present_force + correction * settled_force, settled_force)
    # A joint at rest starts with some force at once; above half its top speed it counts as on its way.
    initial_force = servos.damping * (2.0 * margin - speed)
    force = xp.maximum(force, xp.where(initial_force > 0.0, initial_force, -bound))
    force = sign * xp.clip(force, -bound, bound)
    # In full the holding actuators are off, and the activation alone exerts stiffness * act.
    ctrl = xp.where(exact, 0.0, xp.clip(joints.vel, -speed, speed))
    act = xp.where(exact, torque, force) / servos.stiffness + xp.where(exact, 0.0, equilibrium)
    return ctrl, xp.where(exact, 0.0, 1.0), act


SURGE_SHARE = 0.6
"""Chosen: a P2DX has four fifths of the acceleration of its plain torque, and its wheels grip at walls."""
FLIP_TIME = 3.0
"""Time that DRIVE {Flip True} takes to right a robot [s] (KRobot.uc: FlipTime)."""
MIN_UPRIGHT_COS = np.cos(np.radians(10.0))
"""A robot that leans less than this needs no righting."""
MIN_TYRES_COS = 0.5
"""Cosine of the lean up to which a robot stands on its tyres."""
MAX_TURNING = 1.5
"""Largest difference of both sides' spins that counts for tyres, over the commanded one: wheels hop."""
FLIP_RATE = 2.5
"""About how fast a robot is righted [rad/s]."""
NEAREST_SIDE = 0.05
"""Sine of the roll from which an overturned robot rolls back over the side that it leans to."""
STEEP_NOSE = 0.9
"""Sine of the pitch from which a robot stands on its nose or tail: then it is pitched down."""
CARRIED_SHARE, CARRIED_RATE = 0.9, 0.5
"""Share of a robot's weight that is carried while it is righted, and from which spin on [rad/s]."""
STEADYING = 0.9
"""Share of its spin about other axes that is taken away in a control step meanwhile."""
MIN_INERTIA = 1e-9
"""Least inertia about the axis: there is none where the axis has no length [kg m2]."""
DRIFT_DAMPING = 0.5
"""Share of a robot's drift that is taken away in a control step while it is righted."""


class ControlMode(IntEnum):
    """Control modes of a joint, with the wire's numbers (manual 9.4)."""

    POSITION = 0
    VELOCITY = 1
    TORQUE = 2


POSITION, VELOCITY, TORQUE = (int(mode) for mode in ControlMode)
"""Their numbers: looking up a member of an enumeration takes as long as an operation on a small array."""


class RobotCommand(Node, kw_only=True):
    """Command that a robot carries out until the next one.

    Attributes:
        target: Wanted position [rad or m], velocity [rad/s or m/s] or torque [N m or N] of each joint
            (joints,).
        mode: `ControlMode` of each joint (joints,).
        setpoint: Last value of each key of the robot's DRIVE [rad/s, m/s or rad] (keys,).
        flip_until: Control step until which it is being righted ().
        light: Whether the headlight is on ().
    """

    target: Array
    mode: Array
    setpoint: Array
    flip_until: Array
    light: Array


class DriveConditions(Node, kw_only=True):
    """Conditions that decide on the effect of a robot's command.

    Attributes:
        step: Control steps since the last reset ().
        powered: Whether its battery lasts ().
        depth: Depth of its origin below the surface of water [m] (); `drives.DRY_DEPTH` outside.
        torque: Factor on what its motors can exert (); None: 1.
        speed: Factor on how fast they turn (); None: 1.
        hold: Inputs that its holding actuators had in the step before (actuators,); None: 1.
        stiffness: Share of gains and torque that its joints' servos exert (actuators,); None: 1.
        solved: Whether the engine solves for what the servos' torques do. Otherwise it limits accelerations
            itself, by what was measured with these torques.
    """

    step: Array
    powered: Array
    depth: Array
    torque: Array | None = None
    speed: Array | None = None
    hold: Array | None = None
    stiffness: Array | None = None
    solved: bool = struct.field(pytree_node=False, default=True)


class ActuatorInputs(Node, kw_only=True):
    """Inputs of the engine for one robot.

    Attributes:
        ctrl: Inputs of the pulling actuators: velocities of the servos' targets (actuators,).
        hold: Inputs of the holding actuators: 1, the servo's stiffness, or 0 where a joint exerts exactly the
            commanded torque (actuators,).
        act: Activations of the pulling ones: the servos' targets, times their stiffness (actuators,).
        wrench: Force [N] and torque [N m] on the chassis, world axes (6,).
        refused: Number of commanded values that were not finite ().
    """

    ctrl: Array
    hold: Array
    act: Array
    wrench: Array
    refused: Array


def idle_command(robot: RobotSpec) -> RobotCommand:
    """Return the command of a robot before its first one: wheels braked, other joints held."""
    parts = parts_of(robot)
    modes = [ControlMode.VELOCITY if part.is_wheel else ControlMode.POSITION for part in parts]
    return RobotCommand(
        target=xp.zeros(len(parts)),
        mode=xp.array(modes, xp.int32).reshape(len(parts)),
        setpoint=xp.zeros(len(robot.drive.keys)),
        flip_until=xp.zeros((), xp.int32),
        light=xp.zeros((), bool),
    )


@cache
def _driven_joints(robot: RobotSpec) -> tuple[np.ndarray, np.ndarray]:
    """Return per joint whether the drive moves it, and the row of `Drive.targets` that does."""
    names = joint_names(robot)
    mask, row = np.zeros(len(names), bool), np.zeros(len(names), int)
    for i, aim in enumerate(robot.drive.joint_controls):
        joint = names.index(aim.joint)
        mask[joint], row[joint] = True, i
    # Undriven joints keep row 0, which `set_drive` gathers and masks out again.
    return mask, row


def check_drive_keys(robot: RobotSpec, keys: Iterable[str]) -> None:
    """Refuse keys that a robot's DRIVE does not have.

    Raises:
        UnknownNameError: Names them and those it has.
    """
    bad = [key for key in keys if key not in robot.drive.keys]
    if bad:
        known = ", ".join(robot.drive.keys) or "none"
        raise UnknownNameError(f"{robot.name}'s DRIVE has no key {', '.join(bad)}; it has: {known}")


def set_drive(robot: RobotSpec, command: RobotCommand, values: Mapping[str, ArrayLike]) -> RobotCommand:
    """Return a command with keys of DRIVE set; the other keys keep what they were last set to.

    Args:
        robot: The robot class.
        command: Its command so far; arrays may have leading axes.
        values: Numbers for some of `robot.drive.keys`, or of its `other_keys` [rad/s, m/s or rad]; clipped to
            what it can do.

    Raises:
        UnknownNameError: A key that this drive does not have; lists those it has.
    """
    drive, setpoint = robot.drive, command.setpoint
    # Before the check: `other_keys` are names that only the conversion knows.
    values = drive.to_own_keys(values, setpoint)
    check_drive_keys(robot, values)
    for key, value in values.items():
        index = drive.keys.index(key)
        at_key = np.arange(len(drive.keys)) == index
        # By masks and not by indexing: the same line runs on NumPy and on traced arrays, with any leading
        # axes.
        value = xp.asarray(value, xp.float32)[..., None]
        setpoint = xp.where(at_key, xp.clip(value, -drive.limits, drive.limits), setpoint)
    mask, row = _driven_joints(robot)
    command = command.replace(setpoint=setpoint)
    if not mask.any():
        return command
    target, mode = drive.targets(setpoint)[..., row], drive.control_modes(setpoint)[..., row]
    return command.replace(
        target=xp.where(mask, target, command.target).astype(xp.float32),
        mode=xp.where(mask, mode, command.mode).astype(xp.int32),
    )


def move_joints(
    plan: KinematicTree,
    command: RobotCommand,
    targets: Mapping[str, ArrayLike],
    mode: ControlMode,
) -> RobotCommand:
    """Return a command with other targets of joints: positions, velocities or torques.

    Args:
        plan: Body plan of the robot class.
        command: Its command so far; arrays may have leading axes.
        targets: Joint names and positions [rad or m], velocities [rad/s or m/s] or torques [N m or N] (...).
        mode: Control mode of the targets.

    Raises:
        UnknownNameError: A joint that these robots do not have; lists those they have.
    """
    target, modes = command.target, command.mode
    for name, value in targets.items():
        joint = plan.joint_index(name)
        if joint is None:
            known = ", ".join(plan.parts[1:])
            raise UnknownNameError(f"{plan.robot.name} has no joint {name!r}; it has: {known}")
        # By a mask, on which leading axes of commands and values broadcast alike.
        at_joint = np.arange(len(plan.parts) - 1) == joint
        target = xp.where(at_joint, xp.asarray(value, xp.float32)[..., None], target)
        modes = xp.where(at_joint, int(mode), modes).astype(xp.int32)
    return command.replace(target=target, mode=modes)


@dataclass(frozen=True, kw_only=True)
class CommandUpdate:
    """Changes of the command of robots of one class; other setpoints stay. Numbers are broadcast.

    Attributes:
        drive: Numbers for keys of DRIVE [rad/s, m/s or rad] (...,).
        joints: Joint names and positions [rad or m], velocities [rad/s or m/s] or torques [N m or N] (...,).
        mode: Control mode of `joints`.
        light: Whether the headlight is to be on (...,).
        flip_until: Control step until which they are righted (...,).
    """

    drive: Mapping[str, ArrayLike] = field(default_factory=dict[str, ArrayLike])
    joints: Mapping[str, ArrayLike] = field(default_factory=dict[str, ArrayLike])
    mode: ControlMode = ControlMode.POSITION
    light: ArrayLike | None = None
    flip_until: ArrayLike | None = None


def update_command(
    plan: KinematicTree,
    command: RobotCommand,
    update: CommandUpdate,
    where: Array | None = None,
) -> RobotCommand:
    """Return the next command. Every command to a robot, from any caller, passes through here.

    Args:
        plan: Body plan of the robot class.
        command: The robots' command so far; arrays may have leading axes (...,).
        update: The changes.
        where: Mask of the robots that receive them (...,); None: all.

    Raises:
        UnknownNameError: A key of DRIVE or a joint that they do not have; lists those they have.
    """
    shape, updated = command.target.shape[:-1], command

    def broadcast(values: Mapping[str, ArrayLike]) -> dict[str, Array]:
        return {name: xp.broadcast_to(value, shape) for name, value in values.items()}

    if update.drive:
        updated = set_drive(plan.robot, updated, broadcast(update.drive))
    if update.joints:
        updated = move_joints(plan, updated, broadcast(update.joints), update.mode)
    if update.light is not None:
        updated = updated.replace(light=xp.broadcast_to(xp.asarray(update.light, bool), shape))
    if update.flip_until is not None:
        updated = updated.replace(flip_until=xp.broadcast_to(xp.asarray(update.flip_until, xp.int32), shape))
    if where is None:
        return updated

    def select(new: Array, old: Array) -> Array:
        # Fields have different numbers of trailing axes; the mask has the leading ones alone.
        return xp.where(where.reshape(*shape, *[1] * (new.ndim - len(shape))), new, old)

    return jax.tree.map(select, updated, command)


@named_scope("actuation")
def compute_actuation(
    plan: KinematicTree,
    command: RobotCommand,
    state: RobotState,
    act: Array,
    conditions: DriveConditions,
    period: float,
) -> ActuatorInputs:
    """Return actuator inputs of robots of one class for a control step of `period` [s].

    Speeds are clamped to what the joints can do, positions to their ranges; a number that is not finite
    counts as zero and is reported, so that it reaches neither the solver nor another world. A robot without
    power brakes its joints and exerts nothing (KRobot.uc).

    Args:
        plan: Body plan of the robot class.
        command: The robots' command; all arguments may have leading axes (...,), the same ones.
        state: Their state.
        act: Activations of their pulling actuators (..., actuators).
        conditions: Battery, water and other conditions.
        period: Length of a control step [s].
    """
    drive, powered = plan.robot.drive, conditions.powered[..., None]
    target, mode, setpoint = command.target, command.mode, command.setpoint
    if not known_all(powered):
        target = xp.where(powered, target, 0.0)
        # Velocity zero is what brakes: position mode would drive arms to zero.
        mode = xp.where(powered, mode, VELOCITY)
        setpoint = xp.where(powered, setpoint, 0.0)
    finite, sound = xp.isfinite(target), xp.isfinite(setpoint)
    if known_all(finite) and known_all(sound):
        refused = xp.zeros(powered.shape[:-1], xp.int32)
    else:
        # Before any arithmetic: `clip` keeps NaN, and one NaN would spread over the world's solver.
        target, setpoint = xp.where(finite, target, 0.0), xp.where(sound, setpoint, 0.0)
        # A drive that aims joints has its setpoints in their targets already: they would count twice.
        refused = (~finite).sum(-1) + (0 if drive.joint_controls else (~sound).sum(-1))
    ctrl, hold, new_act = _soft_servo(plan, (target, mode), state, act, period, conditions)
    return ActuatorInputs(
        ctrl=ctrl,
        hold=hold,
        act=new_act,
        wrench=_wrench(plan, command.flip_until, setpoint, state, conditions, period),
        refused=refused.astype(xp.int32),
    )


def _wrench(
    plan: KinematicTree,
    flip_until: Array,
    setpoint: Array,
    state: RobotState,
    conditions: DriveConditions,
    period: float,
) -> Array:
    """Return force and torque on the chassis, by the drive and by what rights a robot (..., 6)."""
    drive, powered = plan.robot.drive, conditions.powered
    wrench = xp.zeros((*powered.shape, 6))
    if drive.applies_wrench:
        if conditions.speed is not None:
            setpoint = setpoint * conditions.speed[..., None]
        own = drive.wrench(setpoint, state, conditions.depth)
        # Drag and buoyancy act without power, too.
        wrench = drive.passive_wrench(state, conditions.depth) + xp.where(powered[..., None], own, 0.0)
    # Without a command there is none: at rest that is a third of the time of all inputs.
    if isinstance(drive, YieldingSkidSteer) and not known_none(setpoint):
        wrench = wrench + _tyre_wrench(plan, drive, setpoint, state)
    if drive.is_wheeled:
        # Counts wrap around, so an idle 0 comes to lie ahead again: only the time of one righting counts.
        remaining = xp.asarray(flip_until) - conditions.step
        ahead = remaining > 0
        if not known_none(ahead):
            flips = powered & ahead & (remaining <= round(FLIP_TIME / period))
            if not known_none(flips):
                # Skipped on the host while nobody is righted, which is nearly always; traced code always
                # computes it.
                righting = righting_wrench(plan, state, period)
                wrench = wrench + xp.where(flips[..., None], righting, 0.0)
    return xp.asarray(wrench, xp.float32)


@cache
def _wheels_of_sides(plan: KinematicTree) -> tuple[np.ndarray, np.ndarray]:
    """Return the joints of the left and right wheels of a skid-steered robot."""
    drive = plan.robot.drive
    assert isinstance(drive, SkidSteer)
    left, right = (
        np.array([plan.joint_index(name) for name in names]) for names in (drive.left, drive.right)
    )
    return left, right


def _tyre_wrench(plan: KinematicTree, drive: YieldingSkidSteer, setpoint: Array, state: RobotState) -> Array:
    """Return the wrench (..., 6) that makes up for sideways friction which tyres lack; none on its side.

    Wheels that an obstacle or a slope slows down on one side do not count: only a turn that is commanded.
    """
    left, right = (state.joint_vel[..., wheels].sum(-1) / len(wheels) for wheels in _wheels_of_sides(plan))
    most = MAX_TURNING * drive.turning(setpoint[..., 1] - setpoint[..., 0])
    # Between 0 and the commanded turn, on whichever side of 0 that is.
    turning = xp.clip(right - left, xp.minimum(most, 0.0), xp.maximum(most, 0.0))
    up = up_from_quat(state.quat)
    torque = xp.where(up[..., 2] > MIN_TYRES_COS, drive.yaw_torque(turning, state.angular[..., 2]), 0.0)
    return xp.concatenate([xp.zeros_like(up), torque[..., None] * up], -1)


def _scaled(values: Array, factor: Array | None) -> Array:
    """Return values of a robot's joints (..., actuators) times a factor of the robot (...,)."""
    return values if factor is None else values * factor[..., None]


def _soft_servo(
    plan: KinematicTree,
    targets: tuple[Array, Array],
    state: RobotState,
    act: Array,
    period: float,
    conditions: DriveConditions,
) -> tuple[Array, Array, Array]:
    """As `_servo`, with the stiffness of its servos; torques that are ordered are exerted in full."""
    share = conditions.stiffness
    if share is None:
        return _servo(plan, targets, state, act, period, conditions)
    before = xp.ones_like(act) if conditions.hold is None else conditions.hold
    # Activations were stored with the share of the step before (`ref * share` below): the servo goes on from
    # the target itself.
    act = xp.where(before > 0.0, act / xp.where(before > 0.0, before, 1.0), act)
    servos = _servo(plan, targets, state, act, period, conditions)
    share = xp.where(targets[1][..., plan.actuated] == TORQUE, 1.0, share)
    ctrl, hold, ref = (one * share for one in servos)
    return ctrl, hold, ref


@cache
def _surge_speeds(servos: Servos, period: float) -> np.ndarray:
    """Return how much faster than its joint a servo's target may move within a control step (actuators,)."""
    return SURGE_SHARE * servos.surge * (servos.lead + period / 2)


def _windup_limit(servos: Servos, vel: Array, brakes: Array | None) -> Array:
    """Return how far targets may be ahead of joints at their speeds, and at the brakes (..., actuators)."""
    limit = servos.windup_limit
    if servos.stalls:
        slow = xp.clip(1.0 - xp.abs(vel) / STALL_SPEED, 0.0, 1.0)
        limit = limit + slow * servos.stall_limit
    return limit if brakes is None else xp.where(brakes, servos.brake_limit, limit)


def _servo(
    plan: KinematicTree,
    targets: tuple[Array, Array],
    state: RobotState,
    act: Array,
    period: float,
    conditions: DriveConditions,
) -> tuple[Array, Array, Array]:
    """Return the inputs and activations of a robot's actuators (`ActuatorInputs`).

    At the end of its range a joint in torque mode is held there for as long as the torque pushes outward.
    """
    actuated, servos = actuated_servos(plan)
    q, v, target, mode = (x[..., actuated] for x in (state.joint_pos, state.joint_vel, *targets))
    speed, low, high, where, clip = servos.speed, servos.low, servos.high, xp.where, xp.clip
    brakes = (mode == VELOCITY) & (target == 0.0) & servos.has_brake if servos.brakes else None
    limits = servos.torque, _windup_limit(servos, v, brakes)
    # The servo's pull is its stiffness times its lead over the joint: a weaker motor has a shorter lead.
    torque, windup_limit = (_scaled(one, conditions.torque) for one in limits)
    if conditions.speed is not None:
        speed = _scaled(speed, conditions.speed)
        target = where(mode == VELOCITY, _scaled(target, conditions.speed), target)
    # At this target spring and damper of the servo cancel at the present speed.
    balance = q + servos.lead * v
    held = xp.ones_like(act, dtype=bool) if conditions.hold is None else conditions.hold > 0.0
    # A joint that nothing held has no target to go on from: it begins where it is.
    ref = act if known_all(held) else where(held, act, balance)
    ref = clip(ref, balance - windup_limit, balance + windup_limit)
    positions = mode == POSITION
    rate = target if known_none(positions) else where(positions, (target - ref) / period, target)
    rate = clip(rate, -speed, speed)
    # The activation integrates ctrl over the step: bounds of the target are bounds of ctrl, over the period.
    ctrl = clip(rate, (low - ref) / period, (high - ref) / period)
    hold = xp.ones_like(ref)
    if servos.stalls and conditions.solved:
        # Within a step a target gets no farther ahead than that either: the joint's own limit is higher.
        # It goes along with the wheel, or there would be little torque left; not all the way, or a wheel
        # against a wall would spin.
        led, surge = ref - balance, _surge_speeds(servos, period)
        lag, ahead = windup_limit + led, windup_limit - led
        bounded = clip(ctrl, v - lag / period - surge, v + ahead / period + surge)
        ctrl = where(servos.stall_limit > 0.0, bounded, ctrl)
    if brakes is not None:
        # As long as that cannot turn it back within the step, a brake exerts exactly what it can.
        slips = brakes & (xp.abs(v) * servos.armature > servos.brake_limit * servos.stiffness * period)
        ctrl, hold = xp.where(slips, 0.0, ctrl), xp.where(slips, 0.0, hold)
        ref = xp.where(slips, -xp.sign(v) * servos.brake_limit, ref)
    torque_mode = mode == TORQUE
    if known_none(torque_mode):
        return ctrl, hold, ref
    # MuJoCo's joint limits are soft: a lasting torque would push the joint past its range.
    outward = ((q > high) & (target > 0)) | ((q < low) & (target < 0))
    free = torque_mode & ~outward
    # Towards the end of its range it slows down, to get halfway there in every step.
    room = xp.maximum(xp.where(target > 0.0, high - q, q - low), 0.0)
    top, bounded = xp.minimum(speed, 0.5 * room / period), xp.clip(target, -torque, torque)
    driven = torque_inputs(servos, bounded, top, Joints(q, v, act, held), period)
    ctrl = xp.where(free, driven[0], xp.where(torque_mode, 0.0, ctrl))
    act = xp.where(free, driven[2], xp.where(torque_mode, xp.clip(q, low, high), ref))
    return ctrl, xp.where(free, driven[1], hold), act


def righting_wrench(plan: KinematicTree, state: RobotState, period: float) -> Array:
    """Return the wrench (..., 6) that turns robots' wheels down again, so that heading and place stay.

    A damped torque takes away the roll and then the pitch, so that the nose points where it did. It is twice
    what tips a box of the robot's dimensions over its edge. While it turns, a force carries most of its
    weight and damps its drift, or the robot would roll away over its edge.
    """
    mat = mat_from_quat(state.quat)
    # In the robot's own axes, in which its dimensions and its inertia apply.
    axis, spin = matvec(mat.mT, _righting_axis(mat)), state.angular
    squared_size = np.square(np.array(plan.robot.dimensions, np.float32))
    # Squared size across the axis: each dimension counts by the sine of its angle to the axis.
    squared_width = ((1.0 - axis**2) * squared_size).sum(-1, keepdims=True)
    strength = plan.mass * GRAVITY * xp.sqrt(squared_width)
    inertia_about_axis = xp.maximum((axis * matvec(plan.inertia, axis)).sum(-1, keepdims=True), MIN_INERTIA)
    # A torque is held for a control step, in which a small robot turns far: it is never pushed back, and
    # damped by no more than what takes a quarter of its spin in one step.
    along = (spin * axis).sum(-1, keepdims=True)
    drive = xp.clip(1.0 - along / FLIP_RATE, 0.0, 1.0) * strength / inertia_about_axis
    damping = xp.minimum(strength / FLIP_RATE / inertia_about_axis, 0.25 / period)
    # Spin about other axes, which the ground causes, would turn the nose: most of it is taken away.
    aside = spin - along * axis
    change = (drive - damping * along) * axis - STEADYING / period * aside
    # Euler's equation: the second term cancels the gyroscopic torque, which would tip the spin over.
    torque = matvec(plan.inertia, change) + xp.cross(spin, matvec(plan.inertia, spin))
    # Its drift is damped as fast as a force that is held for a control step can do it.
    drift = state.linear * np.array([1.0, 1.0, 0.0], np.float32)
    turns = xp.clip(xp.linalg.norm(spin, axis=-1, keepdims=True) / CARRIED_RATE, 0.0, 1.0)
    carried = turns * np.array([0.0, 0.0, CARRIED_SHARE * GRAVITY], np.float32)
    force = plan.mass * (carried - DRIFT_DAMPING / period * drift)
    # The engine lets it act on the centre of the chassis: there alone it would turn the robot.
    lever = np.subtract(plan.centre_of_mass, plan.chassis_centre).astype(np.float32)
    arm = matvec(mat, xp.broadcast_to(lever, spin.shape))
    wrench = xp.concatenate([force, matvec(mat, torque) + xp.cross(arm, force)], -1)
    return xp.where(mat[..., 2:, 2] < MIN_UPRIGHT_COS, wrench, 0.0)


def _righting_axis(mat: Array) -> Array:
    """Return the axes (..., 3), in the world's, about which robots turn upright, of their matrices."""
    nose, up = mat[..., 0], mat[..., 2]  # columns are the robot's axes in the world's
    # The axis of the shortest rotation from the robot's own up to the world's.
    axis = xp.cross(up, np.array([0.0, 0.0, 1.0], np.float32))
    side = xp.where((axis * nose).sum(-1, keepdims=True) < -NEAREST_SIDE, -1.0, 1.0)
    # First the roll, then the pitch: about an axis in between the nose would turn aside.
    roll, pitch = (
        xp.arctan2(xp.abs(mat[..., 2:, 1]), up[..., 2:]),
        xp.arcsin(xp.clip(nose[..., 2:], -1.0, 1.0)),
    )
    rolled = (up[..., 2:] < 0.0) | (roll > xp.abs(pitch))
    axis = xp.where(rolled & (xp.abs(nose[..., 2:]) < STEEP_NOSE), side * nose, axis)
    # Upright and exactly overturned robots have an axis of length 0.
    return axis / xp.maximum(xp.linalg.norm(axis, axis=-1, keepdims=True), 1e-6)
