"""How a joint carries out a torque order: with that torque, up to its top speed.

A constant torque knows no speed, and many motors are far stronger than the light parts they move: a P2AT's
pan motor at full torque takes its camera to a hundred times its MaxSpeed within one control step. So a joint
exerts exactly what it was told for as long as that cannot make it too fast within a control step. Otherwise
its servo is a speed governor bounded by the torque: it begins with what takes the joint to its top speed
against the servo's damping, and adds to that as long as the joint is slower. What is stuck is soon pushed
with all of the torque, what is free approaches its top speed.
"""

from typing import NamedTuple

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.models.build.servos import Servos


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
