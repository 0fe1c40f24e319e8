"""Drive of tracked vehicles whose tracks run over wheels of several sizes."""

from dataclasses import dataclass

import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.models.drives.ground import SkidSteer


@dataclass(frozen=True, kw_only=True)
class Tracks(SkidSteer):
    """Tracks, each a row of wheels (manual 12.10.2): the wheels of a side all have the speed of its belt.

    `radius` is that of the wheel whose speed DRIVE sets; a wheel of half that radius turns twice as fast.

    Attributes:
        ratios: Speed of each wheel, left ones first, over the speed that DRIVE sets.
    """

    ratios: tuple[float, ...]

    def targets(self, setpoint: Array) -> Array:
        """Every wheel's surface is as fast as its side's belt."""
        return super().targets(setpoint) * np.array(self.ratios, np.float32)
