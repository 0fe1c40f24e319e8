"""How robots are driven: one module per kind of locomotion."""

from usarmjx.models.drives.ackermann import Ackermann, Wheel
from usarmjx.models.drives.base import DRY_DEPTH, Drive, JointControl, VehicleType
from usarmjx.models.drives.flying import Blimp, RotaryWing
from usarmjx.models.drives.ground import NoDrive, SkidSteer
from usarmjx.models.drives.omni import OmniDrive
from usarmjx.models.drives.tracks import Tracks
from usarmjx.models.drives.underwater import Underwater

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
