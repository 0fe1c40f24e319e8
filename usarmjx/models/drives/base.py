"""The interface of drives: the meaning of the keys of DRIVE for one kind of robot (manual 9.4).

A drive keeps a setpoint, one number per key. It converts it to targets of the robot's joints when a command
comes (`targets`), to a force on the chassis at every control step (`wrench`), or both.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from usarmjx.base.backend import Array, ArrayLike, xp
from usarmjx.base.nodes import Node


class RobotState(Node, kw_only=True):
    """Pose and velocities of robots.

    Attributes:
        pos: Chassis origin in the world [m] (3,).
        quat: Chassis orientation, w first (4,).
        linear: Velocity of the chassis origin, world axes [m/s] (3,).
        angular: Angular velocity, chassis axes [rad/s] (3,).
        joint_pos: Joint positions in the order of `models.compile.parts.parts_of` [rad or m] (joints,).
        joint_vel: Joint velocities [rad/s or m/s] (joints,).
    """

    pos: Array
    quat: Array
    linear: Array
    angular: Array
    joint_pos: Array
    joint_vel: Array


VehicleType = Literal["GroundVehicle", "LeggedRobot", "NauticVehicle", "AerialVehicle"]
"""Vehicle types that STA, GEO and CONF report."""
DRY_DEPTH = -1e3
"""Depth of a robot outside water [m]."""


@dataclass(frozen=True, kw_only=True)
class JointControl:
    """The joint of one target of a drive, and its control mode.

    Attributes:
        joint: Name of the joint.
        mode: 0 for a position, 1 for a velocity, 2 for a torque.
    """

    joint: str
    mode: int = 1


class Drive(ABC):
    """Locomotion of a robot class. Subclasses are frozen dataclasses with the parameters."""

    is_wheeled: ClassVar[bool] = False
    """Whether the robot stands on wheels or tracks, so that DRIVE {Flip} applies."""

    @property
    def vehicle(self) -> VehicleType:
        """The vehicle type that STA, GEO and CONF report."""
        return "GroundVehicle"

    @property
    @abstractmethod
    def steering(self) -> str:
        """The SteeringType that CONF reports."""

    @property
    def full_scale(self) -> dict[str, float]:
        """Keys of DRIVE, each with its value at 100 when Normalized [rad/s, m/s or rad]."""
        return {}

    @property
    def other_keys(self) -> dict[str, float]:
        """Further keys of DRIVE with their full scale, which `to_own_keys` converts to the drive's own."""
        return {}

    def to_own_keys(self, values: Mapping[str, ArrayLike], setpoint: Array) -> Mapping[str, ArrayLike]:
        """Return values (...,) by the drive's own keys, after conversion of `other_keys`.

        Args:
            values: Numbers by keys (...,).
            setpoint: Present value of each of the own keys (..., keys).
        """
        del setpoint
        return values

    @property
    def joint_controls(self) -> tuple[JointControl, ...]:
        """Joints that the drive moves."""
        return ()

    def targets(self, setpoint: Array) -> Array:
        """Return the targets of `joint_controls` (..., joints) for a setpoint (..., keys)."""
        del setpoint
        raise NotImplementedError

    def control_modes(self, setpoint: Array) -> Array:
        """Return the control modes (..., joints) for a setpoint (..., keys): those of `joint_controls`."""
        del setpoint
        return np.array([control.mode for control in self.joint_controls], np.int32)

    @property
    def applies_wrench(self) -> bool:
        """Whether it moves robots by a force on the chassis, as drives that fly or dive."""
        # By the class: subclasses with an own `wrench` need no flag beside it, which could disagree.
        return type(self).wrench is not Drive.wrench

    def wrench(self, setpoint: Array, state: RobotState, depth: Array) -> Array:
        """Return force [N] and torque [N m] on the chassis, world axes (..., 6), of powered robots.

        Args:
            setpoint: One number per key, finite and within `full_scale` (..., keys).
            state: The robots; leading axes (...,).
            depth: Depth of their origins below the surface of water [m] (...,); `DRY_DEPTH` outside.
        """
        del setpoint, depth
        return xp.zeros((*state.pos.shape[:-1], 6))

    def passive_wrench(self, state: RobotState, depth: Array) -> Array:
        """Return the wrench on the chassis with or without power: buoyancy and drag (..., 6).

        Only drives with a `wrench` of their own have one.
        """
        del depth
        return xp.zeros((*state.pos.shape[:-1], 6))

    def steering_angles(self, joints: Mapping[str, float], setpoint: Array) -> dict[str, float]:
        """Return the angles of rudders and steered wheels for STA, by the fields of `RobotStatus` [rad].

        Args:
            joints: Positions of the robot's joints by name [rad or m].
            setpoint: One number per key (keys,).
        """
        del joints, setpoint
        return {}

    @property
    def max_speed(self) -> float:
        """MaxSpeed of a ground vehicle in CONF [rad/s]."""
        return 0.0

    @property
    def max_steering(self) -> tuple[float, float]:
        """Largest steering angles of front and rear wheels [rad] (CONF)."""
        return (0.0, 0.0)

    @property
    @abstractmethod
    def top_speed(self) -> float:
        """Approximate top speed [m/s]; a robot far beyond it is a fault of the physics."""

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys of DRIVE, in the order of a setpoint."""
        return tuple(self.full_scale)

    @property
    def limits(self) -> np.ndarray:
        """Largest absolute value of each key (keys,)."""
        # Single precision as on the device: NumPy's doubles would make the host's results differ from JAX's.
        return np.array(list(self.full_scale.values()), np.float32)


WHEEL_SPEED, WHEEL_STEER = "WheelSpeed", "WheelSteer"
"""Prefixes of OmniDrive's numbered keys."""
ANGLES = frozenset({"FrontSteer", "RearSteer", "Rudder", "SternPlane", "XZAngle"})
"""Keys that are angles, not speeds."""
TURN_SHARE = 0.5
"""Share of their speed with which tracked robots make a full turn."""


def can_climb(keys: Mapping[str, float]) -> bool:
    """Return whether a robot with these keys of DRIVE moves up and down."""
    return bool({"AltitudeVelocity", "XZAngle", "SternPlane"} & keys.keys())


def drive_values(
    keys: Mapping[str, float], ahead: float = 0.0, left: float = 0.0, up: float = 0.0, speed: float = 1.0
) -> dict[str, float]:
    """Return values of the keys of DRIVE for a direction.

    Args:
        keys: The keys that a robot has and the largest value of each, as `Drive.full_scale`.
        ahead: Speed ahead, as a share of `speed` [-1, 1].
        left: Turn to the left [-1, 1].
        up: Speed up, for robots that fly or dive [-1, 1].
        speed: Share of the largest speeds that is used [0, 1].
    """
    shares = {
        "Left": ahead - TURN_SHARE * left,
        "Right": ahead + TURN_SHARE * left,
        "Speed": ahead,
        "FrontSteer": left,
        "RearSteer": -left,
        "LinearVelocity": ahead,
        # Signs are the manual's: positive turns right here and for Rudder, left for TailPropeller (12.21.3).
        "RotationalVelocity": -left,
        "AltitudeVelocity": up,
        "Propeller": ahead,
        "Rudder": -left,
        "SternPlane": up,
        # A blimp's thrusters push along their bar: rising alone needs their speed too.
        "ThrustPropeller": ahead if ahead or not up else abs(up),
        "TailPropeller": left,
        # Backwards the speed along the bar is negative, which turns its angle around.
        "XZAngle": (1.0 if ahead >= 0 else -1.0) * up * (0.5 if ahead else 1.0),
    }
    wheels = sorted(key for key in keys if key.startswith(WHEEL_STEER))
    values: dict[str, float] = {}
    for key, most in keys.items():
        share, is_angle = shares.get(key, 0.0), key in ANGLES or key in wheels
        if key.startswith(WHEEL_SPEED):
            share = ahead if ahead or not left else 0.5
        elif is_angle and key in wheels:  # the first one steers, the others the other way
            share = 0.25 * (left if key == wheels[0] else -left)
        values[key] = max(-1.0, min(1.0, share)) * most * (1.0 if is_angle else speed)
    return values
