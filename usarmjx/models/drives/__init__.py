"""Drives of robots: one module per kind of locomotion.

A `Drive` defines its keys of DRIVE, and converts a setpoint to joint targets or to a force on the chassis.
All of it takes leading axes, and runs on NumPy and, traced, on JAX: see `usarmjx.base.backend`. `fluid` has
buoyancy and drag for robots that fly or dive. Begin with `base.Drive` and `ground`.
"""

from usarmjx.models.drives.base import DRY_DEPTH, Drive, JointControl, VehicleType
from usarmjx.models.drives.fluid import Underwater
from usarmjx.models.drives.flying import Blimp, RotaryWing
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
