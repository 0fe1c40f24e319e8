"""How robots are driven: one module per kind of locomotion."""

from usarmjx.models.drives.base import DRY, Aim, Drive, Vehicle
from usarmjx.models.drives.ground import NoDrive, SkidSteer
from usarmjx.models.drives.tracks import Tracks

__all__ = ["DRY", "Aim", "Drive", "NoDrive", "SkidSteer", "Tracks", "Vehicle"]
