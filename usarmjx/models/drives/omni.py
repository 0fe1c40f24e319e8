"""The drive of robots whose wheels each have a speed and an angle of their own (manual 9.4, 12.18)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.models.drives.ackermann import Wheel
from usarmjx.models.drives.base import Drive, JointControl


@dataclass(frozen=True, kw_only=True)
class OmniDrive(Drive):
    """Wheels that are told their speeds and angles one by one, by their numbers.

    DRIVE's {WheelNumber i} {WheelSpeed v} {WheelSteer a} are the keys WheelSpeed<i> and WheelSteer<i>. Which
    of them go together is the client's business: wheels at odds skid.

    Attributes:
        wheels: Wheels in the order of their numbers; passive ones may be left out behind the last driven one.
        max_spin: Highest speed of the powered wheels [rad/s].
        radius: Of the powered wheels [m].
        max_steer: Largest angle of the steered wheels [rad] (MaxSteerAngle).
    """

    is_wheeled: ClassVar[bool] = True

    wheels: tuple[Wheel, ...]
    max_spin: float
    radius: float
    max_steer: float

    @property
    def steering(self) -> str:
        """The SteeringType that CONF reports."""
        return "OmniDrive"

    @property
    def full_scale(self) -> dict[str, float]:
        """Speed [rad/s] and angle [rad] of each wheel that has them."""
        full: dict[str, float] = {}
        for number, wheel in enumerate(self.wheels):
            if wheel.powered:
                full[f"WheelSpeed{number}"] = self.max_spin
            if wheel.steer:
                full[f"WheelSteer{number}"] = self.max_steer
        return full

    @property
    def joint_controls(self) -> tuple[JointControl, ...]:
        """One joint for each key."""
        aims: list[JointControl] = []
        for wheel in self.wheels:
            aims += [JointControl(joint=wheel.joint)] * wheel.powered
            aims += [JointControl(joint=wheel.steer, mode=0)] * bool(wheel.steer)
        return tuple(aims)

    def targets(self, setpoint: Array) -> Array:
        """The keys are the targets."""
        return setpoint

    def steering_angles(self, joints: Mapping[str, float], setpoint: Array) -> dict[str, float]:
        """Return the mean measured angles of the steered wheels before and behind the middle [rad].

        STA has room for no more; chosen, as the manual does not say what it reports of such robots.
        """
        angles: dict[str, float] = {}
        for field, sign in (("front_steer", 1), ("rear_steer", -1)):
            steered = [joints[wheel.steer] for wheel in self.wheels if wheel.steer and sign * wheel.x > 0]
            angles[field] = float(np.mean(steered)) if steered else 0.0
        return angles

    @property
    def max_speed(self) -> float:
        """Highest speed of the powered wheels [rad/s]."""
        return self.max_spin

    @property
    def max_steering(self) -> tuple[float, float]:
        """The largest angle, before and behind the middle [rad]."""
        return (self.max_steer, self.max_steer)

    @property
    def top_speed(self) -> float:
        """What the wheels make of their highest speed [m/s]."""
        return self.max_spin * self.radius
