"""Drives of ground vehicles whose wheels do not steer, and of things that do not move."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.models.drives.ackermann import Wheel
from usarmjx.models.drives.base import Drive, JointControl, VehicleType


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


@dataclass(frozen=True, kw_only=True)
class SkidSteer(Drive):
    """Left and right wheels or tracks driven against each other (also two wheels and a caster).

    Attributes:
        left: Names of the left wheels' joints.
        right: Names of the right wheels' joints.
        max_spin: Highest wheel speed [rad/s].
        radius: Of the wheels [m].
        max_turn: Highest turning rate that its controller asks for [rad/s].
        lever: What the difference of both sides' speeds over the turning rate comes to [m]: the distance of
            two wheels; more where wheels skid.
    """

    is_wheeled: ClassVar[bool] = True

    left: tuple[str, ...]
    right: tuple[str, ...]
    max_spin: float
    radius: float
    max_turn: float = math.inf
    lever: float = 0.0

    @property
    def steering(self) -> str:
        """The SteeringType that CONF reports."""
        return "SkidSteered"

    @property
    def full_scale(self) -> dict[str, float]:
        """Wheel speeds of both sides [rad/s]."""
        return {"Left": self.max_spin, "Right": self.max_spin}

    @property
    def joint_controls(self) -> tuple[JointControl, ...]:
        """All wheels."""
        return tuple(JointControl(joint=name) for name in (*self.left, *self.right))

    def targets(self, setpoint: Array) -> Array:
        """Every wheel turns as fast as its side; what turns it too fast is taken from both sides alike."""
        if self.lever and math.isfinite(self.max_turn):
            most = self.max_turn * self.lever / self.radius
            over = setpoint[..., 1] - setpoint[..., 0]
            # A side that is no number leaves the other as it is.
            over = xp.where(xp.isfinite(over), (over - xp.clip(over, -most, most)) / 2, 0.0)
            setpoint = xp.stack([setpoint[..., 0] + over, setpoint[..., 1] - over], -1)
        return setpoint[..., np.repeat([0, 1], [len(self.left), len(self.right)])]

    @property
    def max_speed(self) -> float:
        """Highest wheel speed [rad/s]."""
        return self.max_spin

    @property
    def top_speed(self) -> float:
        """What the wheels make of their highest speed [m/s]."""
        return self.max_spin * self.radius


@dataclass(frozen=True, kw_only=True)
class NoDrive(Drive):
    """What is moved joint by joint (legs), or not at all (a base station).

    Attributes:
        kind: The vehicle type that it reports.
        steering_type: What CONF reports: TwoLegs, FourLegs, or nothing that moves it.
    """

    kind: VehicleType = "GroundVehicle"
    steering_type: str = "None"

    @property
    def vehicle(self) -> VehicleType:
        """The type that STA, GEO and CONF report."""
        return self.kind

    @property
    def steering(self) -> str:
        """The SteeringType that CONF reports."""
        return self.steering_type

    @property
    def top_speed(self) -> float:
        """It does not go far by itself [m/s]."""
        return 0.5


@dataclass(frozen=True, kw_only=True)
class Tracks(SkidSteer):
    """Tracks, each a row of wheels (manual 12.10.2): the wheels of a side all have the speed of its belt.

    `radius` is that of the wheel whose speed DRIVE sets; a wheel of half that radius turns twice as fast.

    Attributes:
        ratios: Speed of each wheel, left ones first, over the speed that DRIVE sets.
    """

    ratios: tuple[float, ...]

    def targets(self, setpoint: Array) -> Array:
        """Every wheel's surface is as fast as its side's belt."""
        return super().targets(setpoint) * np.array(self.ratios, np.float32)
