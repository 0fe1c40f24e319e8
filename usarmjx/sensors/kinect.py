"""Depth camera of USARSim's later versions, after KinectDepth.uc (`hrnr/robocup-usarsim`).

A SCAN starts a picture, whose horizontal strips are measured one after the other from the bottom to the top.
"""

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.base.parameters import Parameters
from usarmjx.base.settings import NOT_NEGATIVE, POSITIVE, Setting
from usarmjx.models.types.robot import ANGLE_STEP, HALF_TURN, TURN
from usarmjx.sensors.base import SENSORS, SensorInput, SensorSettings, vectorized
from usarmjx.sensors.ranging import beam_count, beam_count_problem
from usarmjx.sensors.swept import SweptScanner

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
    first = settings.vertical_fov * (xp.asarray(frame, xp.float32) / settings.frames - 0.5)
    up = first[..., None, None] + settings.vertical_resolution * np.arange(rows, dtype=np.float32)[:, None]
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
        number = xp.broadcast_to(xp.asarray(memory, far.dtype)[..., None], (*far.shape[:-1], 1))
        return (memory + 1) % self.settings[0].frames, xp.concatenate([number, far], -1)

    def goes_on(self, memory: Array) -> Array:
        """Return whether its picture is incomplete."""
        return xp.asarray(memory) > 0

    def handle_set(
        self, opcode: str, params: tuple[float, ...], inputs: SensorInput, memory: Array
    ) -> Array | None:
        """Accept SCAN; a picture that has begun goes on."""
        del params, inputs
        return memory if opcode.upper() == "SCAN" else None


SENSORS.add(Kinect.kind, Kinect)
