"""From commands to actuators: what one robot's motors are told for one control step."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cache
from typing import NamedTuple

import jax
import numpy as np
from flax import struct

from usarmjx.base.arrays import Array, ArrayLike
from usarmjx.base.backend import named_scope, on_numpy, xp
from usarmjx.base.errors import UnknownNameError
from usarmjx.base.rotations import mat_from_quat, matvec
from usarmjx.base.transforms import GRAVITY
from usarmjx.models.compile.kinematic_tree import KinematicTree
from usarmjx.models.compile.parts import joint_names, parts_of
from usarmjx.models.compile.servos import Servos, actuated_servos
from usarmjx.models.drives.base import RobotState
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
    wanted = servos.stiffness * act - hold * (servos.stiffness * pos + servos.damping * vel)
    most = servos.stiffness * np.maximum(servos.windup_limit, servos.brake_limit)
    exerted = xp.clip(wanted, -most, most)
    places = np.zeros((len(plan.actuated), len(plan.parts) - 1), np.float32)
    places[np.arange(len(plan.actuated)), plan.actuated] = 1.0
    return exerted @ places


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
        torque: What each joint shall exert, no more than its motor can [N m or N] (..., actuators).
        speed: Top speed of each joint [rad/s or m/s] (..., actuators).
        joints: The joints and what their servos did (..., actuators).
        period: Of a control step [s].

    Returns:
        ctrl: Inputs of the pulling actuators.
        hold: Inputs of the holding ones: 0 where the joint exerts exactly the torque.
        act: Activations of the pulling ones.
    """
    sign, bound = xp.sign(torque), xp.abs(torque)
    room = speed - sign * joints.vel
    # Whatever hangs on a joint, it has the inertia of its motor at least.
    exact = bound * period <= servos.armature * room
    even = joints.pos + servos.lead * joints.vel
    # This much takes a joint that carries nothing just to its top speed.
    fit = servos.damping * room
    now = sign * servos.stiffness * (joints.act - even)
    # More than this share of it per step would make a bare motor overshoot: so it is critically damped.
    share = xp.minimum(0.25 * servos.damping * period / servos.armature, 1.0)
    force = xp.where(joints.held, now + share * fit, fit)
    # What is at rest need not begin with nothing; from half its top speed on a joint is on its way.
    start = servos.damping * (2.0 * room - speed)
    force = xp.maximum(force, xp.where(start > 0.0, start, -bound))
    force = sign * xp.clip(force, -bound, bound)
    ctrl = xp.where(exact, 0.0, xp.clip(joints.vel, -speed, speed))
    act = xp.where(exact, torque, force) / servos.stiffness + xp.where(exact, 0.0, even)
    return ctrl, xp.where(exact, 0.0, 1.0), act


SURGE_SHARE = 0.6
"""Chosen: a P2DX has four fifths of the acceleration of its plain torque, and its wheels grip at walls."""
FLIP_TIME = 3.0
"""How long DRIVE {Flip True} rights a robot [s] (KRobot.uc: FlipTime)."""
MIN_UPRIGHT_COS = np.cos(np.radians(10.0))
"""A robot that leans less than this needs no righting."""
FLIP_RATE = 2.5
"""About how fast a robot is righted [rad/s]."""


class ControlMode(IntEnum):
    """Control modes of a joint, with the wire's numbers (manual 9.4)."""

    POSITION = 0
    VELOCITY = 1
    TORQUE = 2


class RobotCommand(struct.PyTreeNode, kw_only=True):
    """What a robot is told to do until told otherwise.

    Attributes:
        target: Wanted position [rad or m], velocity [rad/s or m/s] or torque [N m or N] of each joint
            (joints,).
        mode: `ControlMode` of each joint (joints,).
        setpoint: What each key of the robot's DRIVE was last set to [rad/s, m/s or rad] (keys,).
        flip_until: Control step until which it is being righted ().
        light: Whether the headlight is on ().
    """

    target: Array
    mode: Array
    setpoint: Array
    flip_until: Array
    light: Array


class DriveConditions(struct.PyTreeNode, kw_only=True):
    """What decides what a robot's command does.

    Attributes:
        step: Control steps since the last reset ().
        powered: Whether its battery lasts ().
        depth: How far its origin is below the surface of water [m] (); `drives.DRY_DEPTH` outside.
        torque: Factor on what its motors can exert (); None: 1.
        speed: Factor on how fast they turn (); None: 1.
        hold: Inputs that its holding actuators had in the step before (actuators,); None: 1.
    """

    step: Array
    powered: Array
    depth: Array
    torque: Array | None = None
    speed: Array | None = None
    hold: Array | None = None


class ActuatorInputs(struct.PyTreeNode, kw_only=True):
    """What the engine needs for one robot.

    Attributes:
        ctrl: Inputs of the pulling actuators: velocities of the servos' targets (actuators,).
        hold: Inputs of the holding actuators: 1, or 0 where a joint exerts exactly the torque it was told
            (actuators,).
        act: Activations of the pulling ones: the servos' targets (actuators,).
        wrench: Force [N] and torque [N m] on the chassis, world axes (6,).
        refused: How many commanded numbers were not finite ().
    """

    ctrl: Array
    hold: Array
    act: Array
    wrench: Array
    refused: Array


def idle_command(robot: RobotSpec) -> RobotCommand:
    """Return the command of a robot that has not been told anything: wheels braked, other joints held."""
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
        command: What it was told so far; arrays may have leading axes.
        values: Numbers for some of `robot.drive.keys`, or of its `other_keys` [rad/s, m/s or rad]; clipped to
            what it can do.

    Raises:
        UnknownNameError: A key that this drive does not have; lists those it has.
    """
    drive, setpoint = robot.drive, command.setpoint
    values = drive.to_own_keys(values, setpoint)
    check_drive_keys(robot, values)
    for key, value in values.items():
        place = drive.keys.index(key)
        here = np.arange(len(drive.keys)) == place
        value = xp.asarray(value, xp.float32)[..., None]
        setpoint = xp.where(here, xp.clip(value, -drive.limits, drive.limits), setpoint)
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
    """Return a command with joints told where to go, how fast to move or what to exert.

    Args:
        plan: Body plan of the robot class.
        command: What it was told so far; arrays may have leading axes.
        targets: Joint names and positions [rad or m], velocities [rad/s or m/s] or torques [N m or N] (...).
        mode: What the numbers are.

    Raises:
        UnknownNameError: A joint that these robots do not have; lists those they have.
    """
    target, modes = command.target, command.mode
    for name, value in targets.items():
        joint = plan.joint_index(name)
        if joint is None:
            known = ", ".join(plan.parts[1:])
            raise UnknownNameError(f"{plan.robot.name} has no joint {name!r}; it has: {known}")
        here = np.arange(len(plan.parts) - 1) == joint
        target = xp.where(here, xp.asarray(value, xp.float32)[..., None], target)
        modes = xp.where(here, int(mode), modes).astype(xp.int32)
    return command.replace(target=target, mode=modes)


@dataclass(frozen=True, kw_only=True)
class CommandUpdate:
    """What robots of one class are told anew; what is not named stays as it was. Numbers are broadcast.

    Attributes:
        drive: Numbers for keys of DRIVE [rad/s, m/s or rad] (...,).
        joints: Joint names and positions [rad or m], velocities [rad/s or m/s] or torques [N m or N] (...,).
        mode: What the numbers of `joints` are.
        light: Whether the headlight shall be on (...,).
        flip_until: Control step until which they shall be righted (...,).
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
    """Return the next command: the one way to tell a robot, whoever tells it.

    Args:
        plan: Body plan of the robot class.
        command: What the robots were told so far; arrays may have leading axes (...,).
        update: What they are told anew.
        where: Which of them are told it (...,); None: all.

    Raises:
        UnknownNameError: A key of DRIVE or a joint that they do not have; lists those they have.
    """
    shape, told = command.target.shape[:-1], command

    def each(values: Mapping[str, ArrayLike]) -> dict[str, Array]:
        return {name: xp.broadcast_to(value, shape) for name, value in values.items()}

    if update.drive:
        told = set_drive(plan.robot, told, each(update.drive))
    if update.joints:
        told = move_joints(plan, told, each(update.joints), update.mode)
    if update.light is not None:
        told = told.replace(light=xp.broadcast_to(xp.asarray(update.light, bool), shape))
    if update.flip_until is not None:
        told = told.replace(flip_until=xp.broadcast_to(xp.asarray(update.flip_until, xp.int32), shape))
    if where is None:
        return told

    def chosen(new: Array, old: Array) -> Array:
        return xp.where(where.reshape(*shape, *[1] * (new.ndim - len(shape))), new, old)

    return jax.tree.map(chosen, told, command)


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
        command: What the robots are told; all arguments may have leading axes (...,), the same ones.
        state: Where they are.
        act: Activations of their pulling actuators (..., actuators).
        conditions: What else decides.
        period: Of a control step [s].
    """
    drive, powered = plan.robot.drive, conditions.powered[..., None]
    target = xp.where(powered, command.target, 0.0)
    mode = xp.where(powered, command.mode, int(ControlMode.VELOCITY))
    setpoint = xp.where(powered, command.setpoint, 0.0)
    finite, sound = xp.isfinite(target), xp.isfinite(setpoint)
    target, setpoint = xp.where(finite, target, 0.0), xp.where(sound, setpoint, 0.0)
    ctrl, hold, new_act = _servo(plan, (target, mode), state, act, period, conditions)
    # A key of a drive that aims joints has reached their targets already.
    refused = (~finite).sum(-1) + (0 if drive.joint_controls else (~sound).sum(-1))
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
        wrench = drive.passive_wrench(state, conditions.depth) + xp.where(powered[..., None], own, 0.0)
    flips = powered & (conditions.step < flip_until)
    if drive.is_wheeled and not (on_numpy() and not flips.any()):
        wrench = wrench + xp.where(flips[..., None], righting_wrench(plan, state, period), 0.0)
    return xp.asarray(wrench, xp.float32)


def _servo(
    plan: KinematicTree,
    told: tuple[Array, Array],
    state: RobotState,
    act: Array,
    period: float,
    conditions: DriveConditions,
) -> tuple[Array, Array, Array]:
    """Return the inputs and activations of a robot's actuators (`ActuatorInputs`).

    At the end of its range a joint in torque mode is held there for as long as the torque pushes outward.
    """
    here, servos = actuated_servos(plan)
    q, v, target, mode = (x[..., here] for x in (state.joint_pos, state.joint_vel, *told))
    speed, torque, windup_limit = servos.speed, servos.torque, servos.windup_limit
    stands = (mode == ControlMode.VELOCITY) & (target == 0.0) & servos.has_brake
    if servos.stall_limit.any():
        slow = xp.clip(1.0 - xp.abs(v) / STALL_SPEED, 0.0, 1.0)
        windup_limit = windup_limit + slow * servos.stall_limit
    if servos.has_brake.any():
        windup_limit = xp.where(stands, servos.brake_limit, windup_limit)
    if conditions.torque is not None:
        share = conditions.torque[..., None]
        torque, windup_limit = torque * share, windup_limit * share
    if conditions.speed is not None:
        share = conditions.speed[..., None]
        speed, target = speed * share, xp.where(mode == ControlMode.VELOCITY, target * share, target)
    low, high = servos.low, servos.high
    even = q + servos.lead * v
    held = xp.ones_like(act, dtype=bool) if conditions.hold is None else conditions.hold > 0.0
    # A joint that nothing held has no target to go on from: it begins where it is.
    aim = xp.clip(xp.where(held, act, even), even - windup_limit, even + windup_limit)
    wanted = xp.where(mode == ControlMode.POSITION, (target - aim) / period, target)
    rate = xp.clip(wanted, -speed, speed)
    ctrl, hold = xp.clip(rate, (low - aim) / period, (high - aim) / period), xp.ones_like(aim)
    if servos.stall_limit.any():
        # Within a step a target gets no farther ahead than that either: the joint's own limit is higher.
        # It goes along with the wheel, or there would be little torque left; not all the way, or a wheel
        # against a wall would spin.
        lag, ahead = windup_limit + (aim - even), windup_limit - (aim - even)
        along = SURGE_SHARE * servos.surge * (servos.lead + period / 2)
        bounded = xp.clip(ctrl, v - lag / period - along, v + ahead / period + along)
        ctrl = xp.where(servos.stall_limit > 0.0, bounded, ctrl)
    if servos.has_brake.any():
        # As long as that cannot turn it back within the step, a brake exerts exactly what it can.
        slips = stands & (xp.abs(v) * servos.armature > servos.brake_limit * servos.stiffness * period)
        ctrl, hold = xp.where(slips, 0.0, ctrl), xp.where(slips, 0.0, hold)
        aim = xp.where(slips, -xp.sign(v) * servos.brake_limit, aim)
    forced = mode == ControlMode.TORQUE
    if on_numpy() and not forced.any():
        return ctrl, hold, aim
    outward = ((q > high) & (target > 0)) | ((q < low) & (target < 0))
    free = forced & ~outward
    # Towards the end of its range it slows down, to get halfway there in every step.
    way = xp.maximum(xp.where(target > 0.0, high - q, q - low), 0.0)
    top, bounded = xp.minimum(speed, 0.5 * way / period), xp.clip(target, -torque, torque)
    driven = torque_inputs(servos, bounded, top, Joints(q, v, act, held), period)
    ctrl = xp.where(free, driven[0], xp.where(forced, 0.0, ctrl))
    act = xp.where(free, driven[2], xp.where(forced, xp.clip(q, low, high), aim))
    return ctrl, xp.where(free, driven[1], hold), act


def righting_wrench(plan: KinematicTree, state: RobotState, period: float) -> Array:
    """Return the wrench (..., 6) that turns robots' wheels down again: a damped torque about the tilt axis.

    The torque is twice what tips a box of the robot's dimensions over its edge, so it rolls over its own.
    """
    mat = mat_from_quat(state.quat)
    up = mat[..., 2]
    axis = xp.cross(up, np.array([0.0, 0.0, 1.0], np.float32))
    # Upside down every axis is as good: roll about the robot's own length.
    axis = xp.where(up[..., 2:] < -0.9, mat[..., 0], axis)
    axis = axis / xp.maximum(xp.linalg.norm(axis, axis=-1, keepdims=True), 1e-6)
    spin = matvec(mat, state.angular)
    square = np.square(np.array(plan.robot.dimensions, np.float32))
    across = ((1.0 - matvec(mat.mT, axis) ** 2) * square).sum(-1, keepdims=True)
    strength = plan.mass * GRAVITY * xp.sqrt(across)
    # A torque is held for a control step, in which a small robot (a box of its dimensions) turns far: it is
    # never pushed back, and damped by no more than what takes a quarter of its spin in one step.
    push = xp.clip(1.0 - (spin * axis).sum(-1, keepdims=True) / FLIP_RATE, 0.0, 1.0)
    damping = xp.minimum(strength / FLIP_RATE, 0.25 * plan.mass * across / 12 / period)
    torque = strength * push * axis - damping * spin
    wrench = xp.concatenate([xp.zeros_like(torque), torque], -1)
    return xp.where(up[..., 2:] < MIN_UPRIGHT_COS, wrench, 0.0)
