"""Point cloud scanner of USARSim's later versions.

After RotatingPointCloudScanner.uc (`hrnr/robocup-usarsim`), whose sweep begins lower by half of its angle.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.base.settings import POSITIVE, Setting
from usarmjx.models.types.robot import HALF_TURN, TURN
from usarmjx.sensors.base import SENSORS, SensorInput, SensorSettings, vectorized
from usarmjx.sensors.ranging import MAX_BEAMS
from usarmjx.sensors.swept import SweptScanner


@dataclass(frozen=True)
class PointCloudSettings(SensorSettings):
    """Keys of `[USARSensor.RotatingPointCloudScanner]`, with the values of the later DefaultUSAR.ini.

    Attributes:
        scan_interval: Time between two rows of points [s].
        max_range: Length of the beams [m].
        number_of_beams: Number of beams of a row.
        h_field_of_view: Angle from the first beam of a row to the last [rad].
        v_field_of_view: Angle that a sweep turns by, upwards [rad].
        spin_rate: Duration of a sweep [s].
    """

    with_time_stamp: bool = True
    scan_interval: float = 0.2
    max_range: Annotated[float, POSITIVE] = 40.0
    number_of_beams: Annotated[int, Setting(ge=2, le=MAX_BEAMS)] = 256
    h_field_of_view: Annotated[float, TURN] = 2.094395
    v_field_of_view: Annotated[float, HALF_TURN] = 0.785398
    spin_rate: Annotated[float, POSITIVE] = 1.0

    @property
    def rows(self) -> int:
        """Number of rows of a sweep."""
        return max(1, round(self.spin_rate / self.scan_interval)) if self.scan_interval else 1


def row_directions(settings: PointCloudSettings, row: Array) -> Array:
    """Return the unit directions of a row about the x axis, from left to right (..., beams, 3).

    Args:
        settings: Settings of the scanner.
        row: Number of the row (...).
    """
    wide, high = settings.h_field_of_view, settings.v_field_of_view
    left = np.linspace(wide / 2, -wide / 2, settings.number_of_beams, dtype=np.float32)
    up = high * (xp.asarray(row, xp.float32) / settings.rows - 0.5)[..., None]
    # The row lies in a plane, which is pitched: the beams at its ends rise less than the one in its middle.
    return xp.stack(
        xp.broadcast_arrays(np.cos(left) * xp.cos(up), np.sin(left), np.cos(left) * xp.sin(up)), -1
    )


@dataclass(frozen=True, eq=False)
class PointCloud(SweptScanner):
    """Scanner whose plane is pitched; value: points of a row in its own axes [m] (beams, 3).

    Its memory is the number of the next row. A beam that meets nothing ends at MaxRange.
    """

    kind = "PCL"
    settings_class = PointCloudSettings

    def directions(self, part: Array) -> Array:
        """Return the beams of a row, in the mount's axes."""
        return row_directions(self.settings[0], part)

    @vectorized
    def read(self, inputs: SensorInput, memory: Array, key: Array) -> tuple[Array, Array]:
        """Measure a row."""
        del key
        far = xp.minimum(inputs.hits.distance, self.max_distance)
        points = far[..., None] * row_directions(self.settings[0], memory)
        return (memory + 1) % self.settings[0].rows, points


SENSORS.add(PointCloud.kind, PointCloud)
