"""Drives of ground vehicles: skid-steered wheels, tracks, cars, single wheels, and robots without a drive."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from math import tan
from typing import ClassVar

import numpy as np

from usarmjx.base.backend import Array, xp
from usarmjx.models.drives.base import Drive, JointControl, VehicleType

POSITION_MODE, VELOCITY_MODE, TORQUE_MODE = 0, 1, 2
"""Control modes of a joint (manual 9.4), equal to those of `control.ControlMode`, one layer up."""


@dataclass(frozen=True, kw_only=True)
class Wheel:
    """A wheel of a drive that steers or sets wheel speeds.

    Attributes:
        joint: Name of the spin joint.
        steer: Name of the steering joint, positive to the left; empty: none.
        x: Position on the chassis, forward [m].
        y: Position on the chassis, to the right [m].
        powered: Whether it has a motor.
        brakes: Whether it has a brake; powered wheels brake anyway.
    """

    joint: str
    steer: str = ""
    x: float
    y: float
    powered: bool = False
    brakes: bool = False


@dataclass(frozen=True, kw_only=True)
class Ackermann(Drive):
    """Front, and perhaps rear, wheels that steer so that the axles of all wheels meet in one turning centre.

    FrontSteer and RearSteer are the angles of single wheels in the middle of the foremost and the rearmost
    axle (the equivalent bicycle), positive to the left. Equal angles make a crab, opposite ones turn about a
    point beside the robot's middle.

    Attributes:
        wheels: All wheels.
        max_spin: Highest speed of the powered wheels [rad/s].
        radius: Radius of the powered wheels [m].
        max_front_steer: Largest FrontSteer [rad].
        max_rear_steer: Largest RearSteer [rad]; 0 if the rear wheels do not steer.
    """

    is_wheeled: ClassVar[bool] = True

    wheels: tuple[Wheel, ...]
    max_spin: float
    radius: float
    max_front_steer: float
    max_rear_steer: float = 0.0

    @property
    def steering(self) -> str:
        """The SteeringType that CONF reports (manual 9.3's spelling)."""
        return "AckermanSteered"

    @property
    def full_scale(self) -> dict[str, float]:
        """Speed of the powered wheels [rad/s], angles of both axles [rad]."""
        return {
            "Speed": self.max_spin,
            "FrontSteer": self.max_front_steer,
            "RearSteer": self.max_rear_steer,
        }

    @property
    def joint_controls(self) -> tuple[JointControl, ...]:
        """The powered wheels, the wheels that only brake, then the steering joints."""
        spins = [JointControl(joint=wheel.joint) for wheel in self.wheels if wheel.powered]
        brakes = [
            JointControl(joint=wheel.joint, mode=TORQUE_MODE) for wheel in self.wheels if _only_brakes(wheel)
        ]
        turns = [JointControl(joint=wheel.steer, mode=POSITION_MODE) for wheel in self.wheels if wheel.steer]
        return (*spins, *brakes, *turns)

    def control_modes(self, setpoint: Array) -> Array:
        """Return the control modes (..., joints): wheels that only brake are held at Speed 0, else free."""
        modes = np.array([aim.mode for aim in self.joint_controls], np.int32)
        # Exactly 0 is the command to stop: a slow crawl must not lock the passive wheels.
        stands = (setpoint[..., 0:1] == 0.0) & (modes == TORQUE_MODE)
        return xp.where(stands, VELOCITY_MODE, modes)

    @property
    def wheel_base(self) -> float:
        """Distance of the foremost and the rearmost axle [m]."""
        return float(np.ptp([wheel.x for wheel in self.wheels]))

    def targets(self, setpoint: Array) -> Array:
        """Return speeds of the powered wheels, zeros for wheels that only brake, and steering angles.

        The speed of a wheel is proportional to its distance from the turning centre; Speed is that of the
        middle of the powered wheels. If the outermost wheel would exceed its limit, all are slowed alike.
        """
        speed, front, rear = (setpoint[..., i : i + 1] for i in range(3))
        powered = _wheel_positions([wheel for wheel in self.wheels if wheel.powered])
        steered = _wheel_positions([wheel for wheel in self.wheels if wheel.steer])
        middle = powered.mean(1, keepdims=True)
        pace = xp.hypot(*self._heading(powered, front, rear))
        spin = speed * pace / xp.hypot(*self._heading(middle, front, rear))
        # In a bend the outermost wheel has the longest way.
        fastest = xp.max(xp.abs(spin), axis=-1, keepdims=True)
        # All alike, so that the turning centre stays where it is.
        spin = spin * (self.max_spin / xp.maximum(fastest, self.max_spin))
        ahead, left = self._heading(steered, front, rear)
        # A torque of 0 while they roll, a speed of 0 while they are held: the same number in both modes.
        still = xp.zeros((*spin.shape[:-1], sum(map(_only_brakes, self.wheels))), spin.dtype)
        return xp.concatenate([spin, still, xp.arctan2(left, ahead)], -1)

    def _heading(self, positions: np.ndarray, front: Array, rear: Array) -> tuple[Array, Array]:
        """Return the directions of motion of points of the chassis (2, points), ahead and left (..., points).

        The length is their distance from the turning centre over that of the robot's middle line, which stays
        finite on a straight course.
        """
        x, y = positions
        # The bicycle's two steering angles fix the turning centre; its curvature is 0 on a straight course.
        curvature = (xp.tan(front) - xp.tan(rear)) / self.wheel_base
        # FrontSteer is the angle of the foremost axle: the course of other points follows from there.
        behind = x - max(wheel.x for wheel in self.wheels)
        return 1.0 + curvature * y, xp.tan(front) + curvature * behind

    def steering_angles(self, joints: Mapping[str, float], setpoint: Array) -> dict[str, float]:
        """Return FrontSteer and RearSteer equivalent to the measured angles of the wheels [rad].

        A wheel of angle a at y turns with the angle c of its axle's middle: tan c = tan a (1 + y / r) for a
        turning radius r. The mean of that over both axles' wheels gives r, then the angles.
        """
        along = [wheel.x for wheel in self.wheels]
        front, rear = self._axle(joints, max(along)), self._axle(joints, min(along))
        curvature = (front[0] - rear[0]) / (self.wheel_base - front[1] + rear[1])
        angles = [float(np.arctan(tangent + curvature * lever)) for tangent, lever in (front, rear)]
        return {"front_steer": angles[0], "rear_steer": angles[1]}

    def _axle(self, joints: Mapping[str, float], axle_x: float) -> tuple[float, float]:
        """Return the means of tan a and of y tan a over the wheels at that x."""
        # Exactly: `axle_x` is one of the wheels' own numbers.
        axle = [wheel for wheel in self.wheels if wheel.x == axle_x]
        tangents = [tan(joints[wheel.steer]) if wheel.steer else 0.0 for wheel in axle]
        levers = [wheel.y * tangent for wheel, tangent in zip(axle, tangents, strict=True)]
        return float(np.mean(tangents)), float(np.mean(levers))

    @property
    def max_speed(self) -> float:
        """Highest speed of the powered wheels [rad/s]."""
        return self.max_spin

    @property
    def max_steering(self) -> tuple[float, float]:
        """Largest FrontSteer and RearSteer [rad]."""
        return (self.max_front_steer, self.max_rear_steer)

    @property
    def top_speed(self) -> float:
        """Speed at the highest wheel speed [m/s]."""
        return self.max_spin * self.radius


def _only_brakes(wheel: Wheel) -> bool:
    return wheel.brakes and not wheel.powered


def _wheel_positions(wheels: list[Wheel]) -> np.ndarray:
    return np.array([(wheel.x, wheel.y) for wheel in wheels], np.float32).T


YIELD_RATE = 0.05
"""Turning rate at which tyres yield by half of what they do at high rates [rad/s]."""
EASE_BAND = 0.5
"""Excess of the turning rate over that of the wheels at which tyres no longer yield [rad/s]."""
MAX_EASE = 1.5
"""Largest yaw torque of yielding tyres, over their `ease`."""


@dataclass(frozen=True, kw_only=True)
class OmniDrive(Drive):
    """Wheels with individual speeds and angles, by their numbers.

    DRIVE's {WheelNumber i} {WheelSpeed v} {WheelSteer a} are the keys WheelSpeed<i> and WheelSteer<i>. Their
    coordination is left to the client: contradictory wheels skid.

    Attributes:
        wheels: Wheels in the order of their numbers; passive ones after the last driven one may be left out.
        max_spin: Highest speed of the powered wheels [rad/s].
        radius: Radius of the powered wheels [m].
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
        controls: list[JointControl] = []
        for wheel in self.wheels:
            controls += [JointControl(joint=wheel.joint)] * wheel.powered
            controls += [JointControl(joint=wheel.steer, mode=0)] * bool(wheel.steer)
        return tuple(controls)

    def targets(self, setpoint: Array) -> Array:
        """Return the setpoint: the keys are the targets."""
        return setpoint

    def steering_angles(self, joints: Mapping[str, float], setpoint: Array) -> dict[str, float]:
        """Return the mean measured angles of the steered wheels before and behind the middle [rad].

        STA has room for no more; chosen, as the manual does not define its report for such robots.
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
        """Largest angle, before and behind the middle [rad]."""
        return (self.max_steer, self.max_steer)

    @property
    def top_speed(self) -> float:
        """Speed at the highest wheel speed [m/s]."""
        return self.max_spin * self.radius


@dataclass(frozen=True, kw_only=True)
class SkidSteer(Drive):
    """Left and right wheels or tracks driven against each other (also two wheels and a caster).

    Attributes:
        left: Names of the left wheels' joints.
        right: Names of the right wheels' joints.
        max_spin: Highest wheel speed [rad/s].
        radius: Radius of the wheels [m].
        max_turn: Highest turning rate of its controller [rad/s].
        lever: Difference of both sides' speeds over the turning rate [m]: the distance of two wheels; more
            where wheels skid.
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
        """All wheels, left ones first."""
        return tuple(JointControl(joint=name) for name in (*self.left, *self.right))

    def targets(self, setpoint: Array) -> Array:
        """Return the wheels' speeds, those of their sides; both sides give up the excess over `max_turn`."""
        if self.limits_turning:
            over = setpoint[..., 1] - setpoint[..., 0]
            # A NaN on one side must not spread to the other.
            over = xp.where(xp.isfinite(over), (over - self.turning(over)) / 2, 0.0)
            setpoint = xp.stack([setpoint[..., 0] + over, setpoint[..., 1] - over], -1)
        # A constant index: NumPy makes it at trace time, and XLA sees one gather.
        return setpoint[..., np.repeat([0, 1], [len(self.left), len(self.right)])]

    @property
    def limits_turning(self) -> bool:
        """Whether its controller limits the turning rate."""
        return self.lever > 0.0 and math.isfinite(self.max_turn)

    def turning(self, difference: Array) -> Array:
        """Return the commanded difference of speeds, right less left, within `max_turn` [rad/s] (...,)."""
        if not self.limits_turning:
            return difference
        # The sides of a robot of that lever differ by turning rate times lever over ground, and by that over
        # the radius in rad/s.
        most = self.max_turn * self.lever / self.radius
        return xp.clip(difference, -most, most)

    @property
    def max_speed(self) -> float:
        """Highest wheel speed [rad/s]."""
        return self.max_spin

    @property
    def top_speed(self) -> float:
        """Speed at the highest wheel speed [m/s]."""
        return self.max_spin * self.radius


@dataclass(frozen=True, kw_only=True)
class YieldingSkidSteer(SkidSteer):
    """Skid-steered wheels on tyres that resist sliding sideways less than sliding ahead.

    MuJoCo's contacts have one friction coefficient for both directions. A yaw torque on the chassis makes up
    for the part of it that such tyres do not have: up to it, the robot turns at the rate of its `lever`.

    Attributes:
        ease: Sideways friction that the tyres lack, as a yaw torque [N m].
    """

    ease: float

    def yaw_torque(self, difference: Array, rate: Array) -> Array:
        """Return the torque to the left [N m] (...,): none against the wheels, and none faster than they say.

        Args:
            difference: Spin of the right wheels less that of the left ones [rad/s] (...,).
            rate: Turning rate to the left [rad/s] (...,).
        """
        wanted = difference * (self.radius / self.lever)
        # Friction does not depend on speed; close to standstill its direction would change at every step.
        torque = self.ease * (wanted / (xp.abs(wanted) + YIELD_RATE) + (wanted - rate) / EASE_BAND)
        # Times the sign, a torque with the wheels is positive, and the limits cut off what is against them.
        return xp.sign(wanted) * xp.clip(torque * xp.sign(wanted), 0.0, MAX_EASE * self.ease)


@dataclass(frozen=True, kw_only=True)
class NoDrive(Drive):
    """A robot without DRIVE: moved joint by joint (legs), or not at all (a base station).

    Attributes:
        kind: The vehicle type that it reports.
        steering_type: SteeringType in CONF: TwoLegs, FourLegs, or None.
    """

    kind: VehicleType = "GroundVehicle"
    steering_type: str = "None"

    @property
    def vehicle(self) -> VehicleType:
        """The vehicle type that STA, GEO and CONF report."""
        return self.kind

    @property
    def steering(self) -> str:
        """The SteeringType that CONF reports."""
        return self.steering_type

    @property
    def top_speed(self) -> float:
        """Bound on the speed of a robot that legs or other joints push [m/s]."""
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
        """Return the wheels' speeds, at which their surfaces have the speed of their side's belt."""
        return super().targets(setpoint) * np.array(self.ratios, np.float32)
