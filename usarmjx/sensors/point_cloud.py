"""Point cloud scanner of USARSim's later versions.

After RotatingPointCloudScanner.uc (`hrnr/robocup-usarsim`), whose sweep begins lower by half of its angle.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.base.rotations import matvec
from usarmjx.base.settings import POSITIVE, Setting
from usarmjx.models.compile.kinematic_tree import BodyPoses
from usarmjx.models.types.settings import HALF_TURN, TURN
from usarmjx.sensors.base import SENSORS, Sensor, SensorInput, SensorSettings, vectorized
from usarmjx.sensors.ranging import MAX_BEAMS


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
class PointCloud(Sensor):
    """Scanner whose plane is pitched; value: points of a row in its own axes [m] (beams, 3).

    Its memory is the number of the next row. A beam that meets nothing ends at MaxRange.
    """

    kind = "PCL"
    settings_class = PointCloudSettings
    steers_rays = True

    @property
    def max_distance(self) -> float:
        """MaxRange [m]."""
        return self.settings[0].max_range

    def rays(self, bodies: BodyPoses) -> tuple[Array, Array]:
        """Return the beams of the first row."""
        return self.steered_rays(bodies, np.int32(0))

    def steered_rays(self, bodies: BodyPoses, memory: Array | np.int32) -> tuple[Array, Array]:
        """Return the beams of the next row."""
        pos, mat = self.mount_poses(bodies)
        along = matvec(mat[0], row_directions(self.settings[0], xp.asarray(memory)))
        return xp.broadcast_to(pos[0], along.shape), along

    def init_memory(self, inputs: SensorInput, key: Array) -> Array:
        """Begin with the lowest row."""
        del key
        return xp.zeros_like(xp.asarray(inputs.clock.step, xp.int32))

    @vectorized
    def read(self, inputs: SensorInput, memory: Array, key: Array) -> tuple[Array, Array]:
        """Measure a row."""
        del key
        far = xp.minimum(inputs.hits.distance, self.max_distance)
        points = far[..., None] * row_directions(self.settings[0], memory)
        return (memory + 1) % self.settings[0].rows, points


SENSORS.add(PointCloud.kind, PointCloud)
