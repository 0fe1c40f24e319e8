"""Drives of robots: `ground` for wheels and tracks, `fluid` for what flies or dives.

A `Drive` defines its keys of DRIVE, and converts a setpoint to joint targets or to a force on the chassis.
All of it takes leading axes, and runs on NumPy and, traced, on JAX: see `usarmjx.base.backend`.
Begin with `base.Drive` and `ground`.
"""

from usarmjx.models.drives.base import DRY_DEPTH, Drive, JointControl, VehicleType
from usarmjx.models.drives.fluid import Blimp, RotaryWing, Underwater
from usarmjx.models.drives.ground import (
    Ackermann,
    NoDrive,
    OmniDrive,
    SkidSteer,
    Tracks,
    Wheel,
    YieldingSkidSteer,
)

__all__ = [
    "DRY_DEPTH",
    "Ackermann",
    "Blimp",
    "Drive",
    "JointControl",
    "NoDrive",
    "OmniDrive",
    "RotaryWing",
    "SkidSteer",
    "Tracks",
    "Underwater",
    "VehicleType",
    "Wheel",
    "YieldingSkidSteer",
]
