"""Servos of robots' joints, as arrays."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from usarmjx.models.compile.kinematic_tree import KinematicTree
from usarmjx.models.compile.parts import parts_of
from usarmjx.models.types.robot import Motor, RobotSpec


@dataclass(frozen=True, eq=False)
class Servos:
    """Constants of a robot's joint servos (joints,); joints without a motor have zeros and ones.

    Attributes:
        speed: Highest speed.
        torque: Highest torque.
        stiffness: Gain on the position.
        damping: Gain on the velocity.
        armature: Inertia of the motor.
        low: Lowest position.
        high: Highest position.
        lead: Distance of a servo's target ahead of its joint per joint speed, without torque.
        windup_limit: Further distance of the target, just enough for full torque. Without the bound a stalled
            wheel would have to unwind first, and a braked one would roll back.
        brake_limit: The same for a joint at commanded speed 0.
        has_brake: Whether the braking torque differs from the driving torque.
        stall_limit: Additional distance at standstill.
        surge: Acceleration by its torque of a joint with a stall torque and its share of the robot [rad/s^2].
    """

    speed: np.ndarray
    torque: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    armature: np.ndarray
    low: np.ndarray
    high: np.ndarray
    lead: np.ndarray
    windup_limit: np.ndarray
    surge: np.ndarray
    brake_limit: np.ndarray
    has_brake: np.ndarray
    stall_limit: np.ndarray


@cache
def servos_of(robot: RobotSpec) -> Servos:
    """Return the servo constants of a robot class."""
    parts = parts_of(robot)
    no_motor = Motor(max_speed=0.0, torque=0.0, stiffness=1.0, damping=0.0, armature=1.0)
    motors = [part.motor or no_motor for part in parts]
    limits = [part.limits or (-np.inf, np.inf) for part in parts]

    def row(values: list[float]) -> np.ndarray:
        return np.array(values, np.float32)

    return Servos(
        speed=row([m.max_speed for m in motors]),
        torque=row([m.torque for m in motors]),
        stiffness=row([m.stiffness for m in motors]),
        damping=row([m.damping for m in motors]),
        armature=row([m.armature for m in motors]),
        low=row([low for low, _ in limits]),
        high=row([high for _, high in limits]),
        lead=row([m.damping / m.stiffness for m in motors]),
        windup_limit=row([m.torque / m.stiffness for m in motors]),
        brake_limit=row([(m.torque if m.brake is None else m.brake) / m.stiffness for m in motors]),
        stall_limit=row([((m.stall_torque or m.torque) - m.torque) / m.stiffness for m in motors]),
        surge=row([_surge(robot, m, motors) for m in motors]),
        has_brake=np.array([m.brake is not None for m in motors], bool),
    )


def _surge(robot: RobotSpec, motor: Motor, motors: list[Motor]) -> float:
    if motor.stall_torque is None:
        return 0.0
    share = robot.mass / sum(one.stall_torque is not None for one in motors)
    return motor.torque / (motor.armature + share * robot.wheel_radius**2)


@cache
def actuated_servos(tree: KinematicTree) -> tuple[np.ndarray | slice, Servos]:
    """Return the joints of a robot class with a motor, and the constants of these alone (actuators,)."""
    servos, here = servos_of(tree.robot), tree.actuated
    own = Servos(**{name: values[here] for name, values in vars(servos).items()})
    # A slice where all joints have a motor: it saves a gather at every step.
    return slice(None) if len(here) == len(servos.speed) else here, own
