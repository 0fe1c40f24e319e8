"""From commands to actuators: what one robot's motors are told for one control step."""

from dataclasses import dataclass
from enum import IntEnum
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.models.compose import LINK_DAMPING, LINK_STIFFNESS
from usarmjx.models.plan import BodyPlan, RobotState
from usarmjx.models.spec import RobotSpec
from usarmjx.rotations import mat_from_quat

GRAVITY = 9.81
FLIP_TIME = 3.0
"""How long DRIVE {Flip True} rights a robot [s] (KRobot.uc: FlipTime)."""
UPRIGHT = np.cos(np.radians(10.0))
"""A robot that leans less than this needs no righting."""


class Order(IntEnum):
    """Control modes of a joint, with the wire's numbers (manual 9.4)."""

    POSITION = 0
    VELOCITY = 1


class Command(struct.PyTreeNode, kw_only=True):
    """What a robot is told to do until told otherwise.

    Attributes:
        target: Wanted position [rad or m] or velocity [rad/s or m/s] of each joint (joints,).
        order: `Order` of each joint (joints,).
        flip_until: Until when it is being righted [s] ().
        light: Whether the headlight is on ().
    """

    target: jax.Array
    order: jax.Array
    flip_until: jax.Array
    light: jax.Array


class Drive(struct.PyTreeNode, kw_only=True):
    """What the engine needs for one robot.

    Attributes:
        ctrl: Actuator inputs: velocities of the servos' targets (joints,).
        act: Actuator activations: the servos' targets (joints,).
        wrench: Force [N] and torque [N m] on the chassis, world axes (6,).
        refused: How many commanded numbers were not finite ().
    """

    ctrl: jax.Array
    act: jax.Array
    wrench: jax.Array
    refused: jax.Array


@dataclass(frozen=True, eq=False)
class Servos:
    """Constants of a robot's joint servos, wheels first (joints,)."""

    speed: np.ndarray
    low: np.ndarray
    high: np.ndarray
    slack: np.ndarray

    @property
    def count(self) -> int:
        """Number of joints."""
        return len(self.speed)


@cache
def servos_of(robot: RobotSpec) -> Servos:
    """Return the servo constants of a robot class.

    A servo's target may run ahead of its joint by `slack`, just far enough to exert its full torque at
    full speed: without the bound a stalled wheel would have to unwind first.
    """
    drive = robot.drive
    links = [link for package in robot.packages for link in package.links]
    free = [link.min_range > link.max_range for link in links]
    wheels = len(robot.wheels)
    speed = np.array([drive.max_speed] * wheels + [link.max_speed for link in links])
    torque = np.array([drive.torque] * wheels + [link.max_torque for link in links])
    stiffness = np.array([drive.stiffness] * wheels + [LINK_STIFFNESS] * len(links))
    damping = np.array([drive.damping] * wheels + [LINK_DAMPING] * len(links))
    low = [-np.inf] * wheels + [-np.inf if f else link.min_range for f, link in zip(free, links, strict=True)]
    high = [np.inf] * wheels + [np.inf if f else link.max_range for f, link in zip(free, links, strict=True)]
    return Servos(
        speed=speed.astype(np.float32),
        low=np.array(low, np.float32),
        high=np.array(high, np.float32),
        slack=((torque + damping * speed) / stiffness).astype(np.float32),
    )


def idle(robot: RobotSpec) -> Command:
    """Return the command of a robot that has not been told anything: wheels braked, links held."""
    count, wheels = servos_of(robot).count, len(robot.wheels)
    order = np.full(count, Order.POSITION, np.int32)
    order[:wheels] = Order.VELOCITY
    return Command(
        target=jnp.zeros(count), order=jnp.asarray(order), flip_until=jnp.zeros(()), light=jnp.zeros((), bool)
    )


def wheel_speeds(robot: RobotSpec, left: jax.Array, right: jax.Array) -> jax.Array:
    """Return the speeds of all wheels [rad/s] (..., wheels) for both sides' speeds (...)."""
    sides = [left if wheel.side == "left" else right for wheel in robot.wheels]
    return jnp.stack(jnp.broadcast_arrays(*sides), -1)


def drive(
    plan: BodyPlan, command: Command, state: RobotState, act: jax.Array, time: jax.Array, period: float
) -> Drive:
    """Return one robot's actuator inputs for a control step of `period` [s].

    Speeds are clamped to what the joints can do, positions to their ranges; a number that is not finite
    counts as zero and is reported, so that it reaches neither the solver nor another world.
    """
    servos = servos_of(plan.robot)
    finite = jnp.isfinite(command.target)
    target = jnp.where(finite, command.target, 0.0)
    act = jnp.clip(act, state.joint_pos - servos.slack, state.joint_pos + servos.slack)
    wanted = jnp.where(command.order == Order.POSITION, (target - act) / period, target)
    rate = jnp.clip(wanted, -servos.speed, servos.speed)
    ctrl = jnp.clip(rate, (servos.low - act) / period, (servos.high - act) / period)
    wrench = jnp.where(time < command.flip_until, righting(plan.robot, state), 0.0)
    return Drive(ctrl=ctrl, act=act, wrench=wrench, refused=(~finite).sum())


def righting(robot: RobotSpec, state: RobotState) -> jax.Array:
    """Return the wrench (6,) that turns a robot's wheels down again: a damped torque about its tilt axis.

    The torque is twice what tips the robot over its longer half, so it rolls over its own edge.
    """
    mat = mat_from_quat(state.quat)
    up = mat[:, 2]
    axis = jnp.cross(up, jnp.array([0.0, 0.0, 1.0]))
    # Upside down every axis is as good: roll about the robot's own length.
    axis = jnp.where(up[2] < -0.9, mat[:, 0], axis)
    axis = axis / jnp.maximum(jnp.linalg.norm(axis), 1e-6)
    strength = robot.mass * GRAVITY * robot.dimensions[0]
    torque = strength * (axis - (mat @ state.angular) / 2.5)  # settles near 2.5 rad/s
    return jnp.where(up[2] < UPRIGHT, jnp.concatenate([jnp.zeros(3), torque]), 0.0)
