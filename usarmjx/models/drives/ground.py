"""Drives of ground vehicles whose wheels do not steer, and of things that do not move."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.models.drives.base import Drive, JointControl, VehicleType


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
