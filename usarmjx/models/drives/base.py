"""What a drive is: what the keys of DRIVE mean for one kind of robot (manual 9.4).

A drive keeps a setpoint, one number per key. It turns it into targets of the robot's joints when a command
comes (`aim`), into a force on the chassis at every control step (`wrench`), or both.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from flax import struct

from usarmjx.base.arrays import Array, ArrayLike
from usarmjx.base.backend import xp


class RobotState(struct.PyTreeNode, kw_only=True):
    """Where a robot is and how it moves.

    Attributes:
        pos: Chassis origin in the world [m] (3,).
        quat: Chassis orientation, w first (4,).
        linear: Velocity of the chassis origin, world axes [m/s] (3,).
        angular: Angular velocity, chassis axes [rad/s] (3,).
        joint_pos: Joint positions in the order of `models.build.parts.parts_of` [rad or m] (joints,).
        joint_vel: Joint velocities [rad/s or m/s] (joints,).
    """

    pos: Array
    quat: Array
    linear: Array
    angular: Array
    joint_pos: Array
    joint_vel: Array


VehicleType = Literal["GroundVehicle", "LeggedRobot", "NauticVehicle", "AerialVehicle"]
DRY_DEPTH = -1e3
"""Depth of what is not in water [m]."""


@dataclass(frozen=True, kw_only=True)
class JointControl:
    """What a drive asks of one joint: which, in which control order, and from which row of numbers.

    Attributes:
        joint: Name of the joint.
        mode: 0 for a position, 1 for a velocity, 2 for a torque.
    """

    joint: str
    mode: int = 1


class Drive(ABC):
    """How DRIVE moves a robot. Subclasses are frozen dataclasses with the figures."""

    is_wheeled: ClassVar[bool] = False
    """Whether it stands on wheels or tracks, so that DRIVE {Flip} means something to it."""

    @property
    def vehicle(self) -> VehicleType:
        """The type that STA, GEO and CONF report."""
        return "GroundVehicle"

    @property
    @abstractmethod
    def steering(self) -> str:
        """The SteeringType that CONF reports."""

    @property
    def full_scale(self) -> dict[str, float]:
        """The keys of DRIVE and what 100 means for each when Normalized (rad/s, m/s or rad)."""
        return {}

    @property
    def other_keys(self) -> dict[str, float]:
        """Keys that DRIVE takes beside its own and `in_own_keys` puts in terms of those, as `full_scale`."""
        return {}

    def in_own_keys(self, values: Mapping[str, ArrayLike], setpoint: Array) -> Mapping[str, ArrayLike]:
        """Return what is set (...,) by the drive's own keys, where some of it was told by `other_keys`.

        Args:
            values: Numbers by keys (...,).
            setpoint: What each of the own keys was last set to (..., keys).
        """
        del setpoint
        return values

    @property
    def joint_controls(self) -> tuple[JointControl, ...]:
        """The joints that it moves."""
        return ()

    def targets(self, setpoint: Array) -> Array:
        """Return the targets of `joint_controls` (..., aims) for a setpoint (..., keys)."""
        del setpoint
        raise NotImplementedError

    def control_modes(self, setpoint: Array) -> Array:
        """Return the orders (..., aims) for a setpoint (..., keys): those that `joint_controls` name."""
        del setpoint
        return np.array([aim.mode for aim in self.joint_controls], np.int32)

    @property
    def pushes(self) -> bool:
        """Whether it moves robots by a force on the chassis, as those that fly or dive."""
        return type(self).wrench is not Drive.wrench

    def wrench(self, setpoint: Array, state: RobotState, depth: Array) -> Array:
        """Return force [N] and torque [N m] on the chassis, world axes (..., 6), of powered robots.

        Args:
            setpoint: One number per key, finite and within `full_scale` (..., keys).
            state: The robots; leading axes (...,).
            depth: How far their origins are below the surface of water [m] (...,); `DRY_DEPTH` outside.
        """
        del setpoint, depth
        return xp.zeros((*state.pos.shape[:-1], 6))

    def passive_wrench(self, state: RobotState, depth: Array) -> Array:
        """Return what acts on the chassis with or without power: buoyancy and drag (..., 6).

        Only drives that push have it.
        """
        del depth
        return xp.zeros((*state.pos.shape[:-1], 6))

    def steering_angles(self, joints: Mapping[str, float], setpoint: Array) -> dict[str, float]:
        """Return what STA reports of rudders and steered wheels, by the fields of `RobotStatus` [rad].

        Args:
            joints: Positions of the robot's joints by name [rad or m].
            setpoint: One number per key (keys,).
        """
        del joints, setpoint
        return {}

    @property
    def max_speed(self) -> float:
        """What CONF reports as MaxSpeed of a ground vehicle [rad/s]."""
        return 0.0

    @property
    def max_steering(self) -> tuple[float, float]:
        """The largest steering angles of front and rear wheels [rad] (CONF)."""
        return (0.0, 0.0)

    @property
    @abstractmethod
    def top_speed(self) -> float:
        """About how fast it can go [m/s]; a robot far beyond this is a fault of the physics."""

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys of DRIVE, in the order of a setpoint."""
        return tuple(self.full_scale)

    @property
    def limits(self) -> np.ndarray:
        """Largest absolute value of each key (keys,)."""
        return np.array(list(self.full_scale.values()), np.float32)
