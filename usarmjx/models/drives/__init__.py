"""How robots are driven: one module per kind of locomotion.

A `Drive` says which keys of DRIVE there are, and turns a setpoint into targets of joints or a force on the
chassis. All of it takes leading axes, and runs on NumPy and, traced, on JAX: see `usarmjx.base.backend`.
`fluid` is what air and water do to those that fly and dive. Begin with `base.Drive` and `ground`.
"""

from usarmjx.models.drives.ackermann import Ackermann, Wheel
from usarmjx.models.drives.base import DRY_DEPTH, Drive, JointControl, VehicleType
from usarmjx.models.drives.fluid import Underwater
from usarmjx.models.drives.flying import Blimp, RotaryWing
from usarmjx.models.drives.ground import NoDrive, OmniDrive, SkidSteer, Tracks

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
]
