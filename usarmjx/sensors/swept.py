"""Scanners that measure their sweep part by part: the depth camera and the point cloud scanner.

Both are USARSim's later versions', after KinectDepth.uc and RotatingPointCloudScanner.uc
(`hrnr/robocup-usarsim`). A SCAN starts a depth picture, whose horizontal strips are measured one after the
other from the bottom to the top. The point cloud of the original begins lower by half of its sweep.
"""

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from usarmjx.base.backend import Array, xp
from usarmjx.base.rotations import matvec
from usarmjx.base.settings import NOT_NEGATIVE, POSITIVE, Parameters, Setting
from usarmjx.models.compile.kinematic_tree import BodyPoses
from usarmjx.models.types.robot import ANGLE_STEP, HALF_TURN, TURN
from usarmjx.sensors.base import SENSORS, Sensor, SensorInput, SensorSettings, vectorized
from usarmjx.sensors.ranging import MAX_BEAMS, beam_count, beam_count_problem


@dataclass(frozen=True, eq=False)
class SweptScanner(Sensor):
    """Scanner of a single mount; its memory is the number of the next part of its sweep."""

    steers_rays = True

    @property
    def max_distance(self) -> float:
        """MaxRange [m]."""
        return self.settings[0].max_range

    @abstractmethod
    def directions(self, part: Array) -> Array:
        """Return the unit directions of a part (...) of the sweep, in the mount's axes (..., rays, 3)."""

    def rays(self, bodies: BodyPoses) -> tuple[Array, Array]:
        """Return the beams of the first part."""
        return self.steered_rays(bodies, np.int32(0))

    def steered_rays(self, bodies: BodyPoses, memory: Array | np.int32) -> tuple[Array, Array]:
        """Return the beams of the next part."""
        pos, mat = self.mount_poses(bodies)
        along = matvec(mat[0], self.directions(xp.asarray(memory)))
        return xp.broadcast_to(pos[0], along.shape), along

    def init_memory(self, inputs: SensorInput, key: Array) -> Array:
        """Begin with the first part."""
        del key
        return xp.zeros_like(xp.asarray(inputs.clock.step, xp.int32))


MAX_FRAMES = 1000
"""Largest number of strips of a picture."""
UNREAL_STEP = 16 * 2 * math.pi / 65536
"""Angle between neighbouring beams: 0.0015625 rad in whole Unreal units [rad]."""


@dataclass(frozen=True)
class KinectSettings(SensorSettings):
    """Keys of `[USARSensor.KinectDepth]`, with the values of its class and of its base's section.

    Attributes:
        scan_interval: Time between two strips of a picture [s].
        min_range: Shortest distance that its CONF states; depths are not clipped to it [m].
        max_range: Depth where a beam meets nothing [m].
        vertical_fov: Angle from the bottom of the picture to its top [rad].
        vertical_resolution: Angle between two rows [rad].
        horizontal_fov: Angle from the first beam of a row to the last [rad].
        horizontal_resolution: Angle between two beams of a row [rad].
        frames: Number of strips of a picture.
    """

    with_time_stamp: bool = True
    scan_interval: float = 0.2
    min_range: Annotated[float, NOT_NEGATIVE] = 0.1
    max_range: Annotated[float, POSITIVE] = 3.0
    vertical_fov: Annotated[float, HALF_TURN, Setting(manual_key="VerticalFOV")] = 1.0
    vertical_resolution: Annotated[float, ANGLE_STEP] = UNREAL_STEP
    horizontal_fov: Annotated[float, TURN, Setting(manual_key="HorizontalFOV")] = 0.75
    horizontal_resolution: Annotated[float, ANGLE_STEP] = UNREAL_STEP
    frames: Annotated[int, Setting(ge=1, le=MAX_FRAMES)] = 60

    @property
    def fov(self) -> tuple[float, float]:
        """Horizontal and vertical field of view, the order of its CONF [rad]."""
        return self.horizontal_fov, self.vertical_fov

    @property
    def resolution(self) -> tuple[float, float]:
        """Horizontal and vertical angle between beams [rad]."""
        return self.horizontal_resolution, self.vertical_resolution

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows of a strip, and of beams in a row."""
        # The margin keeps a quotient that rounding has put just above a whole number from adding a row.
        rows = math.ceil(self.vertical_fov / self.frames / self.vertical_resolution - 1e-3)
        return max(1, rows), beam_count(self.horizontal_fov, self.horizontal_resolution)

    def problem(self) -> str:
        """Return a conflict between settings."""
        return beam_count_problem(math.prod(self.shape))


def strip_directions(settings: KinectSettings, frame: Array) -> Array:
    """Return the unit directions of a strip about the x axis (..., points, 3).

    Rows run from the lowest to the highest, the beams of a row from left to right.

    Args:
        settings: Settings of the camera.
        frame: Number of the strip (...).
    """
    rows, columns = settings.shape
    # Each strip begins where its share of the field of view does, not where the strip before ended.
    first = settings.vertical_fov * (xp.asarray(frame, xp.float32) / settings.frames - 0.5)
    up = first[..., None, None] + settings.vertical_resolution * np.arange(rows, dtype=np.float32)[:, None]
    # Left is positive: MuJoCo's y axis points to the left.
    left = settings.horizontal_fov / 2 - settings.horizontal_resolution * np.arange(columns, dtype=np.float32)
    level = xp.cos(up)
    up, *flat = xp.broadcast_arrays(xp.sin(up), level * np.cos(left), level * np.sin(left))
    lines = xp.stack([*flat, up], -1)
    return lines.reshape(*lines.shape[:-3], rows * columns, 3)


@dataclass(frozen=True, eq=False)
class Kinect(SweptScanner):
    """Depth camera; value: number of a strip, then its distances [m] (1 + points,).

    Its memory is the number of the next strip. It measures after a SCAN until its picture is complete.
    """

    kind = "Kinect"
    opcodes: ClassVar[dict[str, Parameters]] = {"SCAN": Parameters()}
    settings_class = KinectSettings

    @property
    def on_command(self) -> bool:
        """True: SCAN begins a picture."""
        return True

    def directions(self, part: Array) -> Array:
        """Return the beams of a strip, in the mount's axes."""
        return strip_directions(self.settings[0], part)

    @vectorized
    def read(self, inputs: SensorInput, memory: Array, key: Array) -> tuple[Array, Array]:
        """Measure a strip."""
        del key
        far = xp.minimum(inputs.hits.distance, self.max_distance)
        # The strip's number leads its distances: a message of a strip says which one it is.
        number = xp.broadcast_to(xp.asarray(memory, far.dtype)[..., None], (*far.shape[:-1], 1))
        return (memory + 1) % self.settings[0].frames, xp.concatenate([number, far], -1)

    def goes_on(self, memory: Array) -> Array:
        """Return whether its picture is incomplete."""
        # The number returns to 0 behind the last strip.
        return xp.asarray(memory) > 0

    def handle_set(
        self, opcode: str, params: tuple[float, ...], inputs: SensorInput, memory: Array
    ) -> Array | None:
        """Accept SCAN; a picture that has begun goes on."""
        del params, inputs
        # The memory stays: 0 begins a picture, and one that is under way is not begun anew.
        return memory if opcode.upper() == "SCAN" else None


SENSORS.add(Kinect.kind, Kinect)


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
        # Without an interval a row has no duration: the sweep is a single row.
        return max(1, round(self.spin_rate / self.scan_interval)) if self.scan_interval else 1


def row_directions(settings: PointCloudSettings, row: Array) -> Array:
    """Return the unit directions of a row about the x axis, from left to right (..., beams, 3).

    Args:
        settings: Settings of the scanner.
        row: Number of the row (...).
    """
    wide, high = settings.h_field_of_view, settings.v_field_of_view
    # Both ends belong to the field of view, so there is one angle less than beams.
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
        # The row of the memory before it goes on: the hits are those of that row's beams.
        # Of cut distances: infinity times a direction's component of 0 would be NaN.
        points = far[..., None] * row_directions(self.settings[0], memory)
        return (memory + 1) % self.settings[0].rows, points


SENSORS.add(PointCloud.kind, PointCloud)
