"""The drive of cars: wheels that steer about one common turning centre (manual 9.4, 12.5 to 12.8)."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import tan
from typing import ClassVar

import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.models.drives.base import Drive, JointControl

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
        fastest = xp.max(xp.abs(spin), axis=-1, keepdims=True)
        spin = spin * (self.max_spin / xp.maximum(fastest, self.max_spin))
        ahead, left = self._heading(steered, front, rear)
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
