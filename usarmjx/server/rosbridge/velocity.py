"""Twist as DRIVE: speeds in ROS's axes [m/s, rad/s] as the keys of a robot's drive."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from usarmjx.base.errors import UsageError
from usarmjx.models.drives.ackermann import Ackermann
from usarmjx.models.drives.base import Drive
from usarmjx.models.drives.flying import Blimp, RotaryWing
from usarmjx.models.drives.ground import SkidSteer
from usarmjx.models.drives.omni import OmniDrive
from usarmjx.models.spec.robot import RobotSpec

STANDS = 1e-6
"""Slower than this is standing [m/s]."""


class Velocity(NamedTuple):
    """How a robot shall move.

    Attributes:
        ahead: [m/s]
        left: [m/s]
        up: [m/s]
        turn: To the left [rad/s].
    """

    ahead: float
    left: float
    up: float
    turn: float


def read_twist(message: object) -> Velocity:
    """Return what a Twist says; what it leaves out is 0. Roll and pitch rates are not looked at.

    Raises:
        UsageError: It is no Twist, or a number is not finite.
    """
    parts = [_part(message, name) for name in ("linear", "angular")]
    linear, angular = ([_number(part, axis) for axis in "xyz"] for part in parts)
    return Velocity(linear[0], linear[1], linear[2], angular[2])


def _part(message: object, name: str) -> Mapping[str, Any]:
    part = message.get(name, {}) if isinstance(message, dict) else None
    if not isinstance(part, dict):
        raise UsageError("a geometry_msgs/Twist has linear and angular, of x, y and z each")
    return part


def _number(part: Mapping[str, Any], axis: str) -> float:
    value = part.get(axis, 0.0)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < math.inf:
        raise UsageError(f"{axis} of a geometry_msgs/Twist is {str(value)[:20]!r}, expected a finite number")
    return float(value)


def can_follow(drive: Drive) -> bool:
    """Return whether a drive knows what to do with a Twist."""
    return isinstance(drive, SkidSteer | Ackermann | OmniDrive | RotaryWing | Blimp)


def drive_keys(robot: RobotSpec, velocity: Velocity) -> dict[str, float]:
    """Return the keys of DRIVE that make a robot move so, as far as its drive can; more is cut off later.

    Raises:
        UsageError: Its drive cannot follow a Twist.
    """
    drive = robot.drive
    if isinstance(drive, SkidSteer):
        half = velocity.turn * (drive.lever or robot.wheel_separation) / 2
        sides = velocity.ahead - half, velocity.ahead + half
        return {"Left": sides[0] / drive.radius, "Right": sides[1] / drive.radius}
    if isinstance(drive, Ackermann):
        return _car_keys(drive, velocity)
    if isinstance(drive, OmniDrive):
        return _wheel_keys(drive, velocity)
    if isinstance(drive, RotaryWing | Blimp):
        return {
            "AltitudeVelocity": velocity.up,
            "LinearVelocity": velocity.ahead,
            "LateralVelocity": -velocity.left,
            "RotationalVelocity": -velocity.turn,
        }
    raise UsageError(f"a {robot.name} has no drive that follows a geometry_msgs/Twist")


def _car_keys(drive: Ackermann, velocity: Velocity) -> dict[str, float]:
    """Return speed and angle of the bicycle that turns alike; a car that stands cannot turn."""
    moves = abs(velocity.ahead) > STANDS
    angle = math.atan(velocity.turn / velocity.ahead * drive.wheel_base) if moves else 0.0
    front = max(-drive.max_front_steer, min(drive.max_front_steer, angle))
    return {"Speed": velocity.ahead / drive.radius, "FrontSteer": front, "RearSteer": 0.0}


def _wheel_keys(drive: OmniDrive, velocity: Velocity) -> dict[str, float]:
    """Return speed and angle of every wheel, along the way that the floor under it is to pass."""
    keys: dict[str, float] = {}
    for number, wheel in enumerate(drive.wheels):
        ahead = velocity.ahead + velocity.turn * wheel.y  # y is to the right
        left = velocity.left + velocity.turn * wheel.x
        angle, speed = 0.0, ahead
        if wheel.steer:
            sign = -1.0 if ahead < 0 else 1.0
            speed = sign * math.hypot(ahead, left)
            angle = math.atan2(sign * left, sign * ahead)
            keys[f"WheelSteer{number}"] = max(-drive.max_steer, min(drive.max_steer, angle))
        if wheel.powered:
            keys[f"WheelSpeed{number}"] = speed / drive.radius
    return keys
