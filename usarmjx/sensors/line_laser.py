"""Line laser of USARSim's later versions, after LineLaser.uc (`hrnr/robocup-usarsim`)."""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.base.settings import NOT_NEGATIVE, POSITIVE, Setting
from usarmjx.base.transforms import angles_from_mat
from usarmjx.models.compile.kinematic_tree import BodyPoses
from usarmjx.models.types.robot import TURN
from usarmjx.sensors.base import SENSORS, Sensor, SensorInput, SensorSettings, vectorized
from usarmjx.sensors.ranging import MAX_BEAMS
from usarmjx.sensors.rays.bundles import Fans
from usarmjx.sensors.sketch import OverlayLines, empty_overlay

RED = np.array([1.0, 0.0, 0.0], np.float32)
"""Colour of its light (LineLaser.uc)."""


@dataclass(frozen=True)
class LineLaserSettings(SensorSettings):
    """Keys of `[USARSensor.LineLaser]`, with the values of the later versions' DefaultUSAR.ini.

    Attributes:
        scan_interval: Time between two scans [s].
        min_range: Shortest distance that its CONF states; scans are not clipped to it [m].
        max_range: Length of its beams [m].
        fov: Angle from the first beam to the one after the last [rad].
        beams: Number of beams, and the one after the last; the later versions' Resolution.
    """

    scan_interval: float = 0.1
    min_range: Annotated[float, NOT_NEGATIVE] = 0.1
    max_range: Annotated[float, POSITIVE] = 5.0
    fov: Annotated[float, TURN, Setting(manual_key="FOV")] = 1.570796
    beams: Annotated[int, Setting(ge=2, le=MAX_BEAMS)] = 120


def line_directions(settings: LineLaserSettings) -> np.ndarray:
    """Return the unit directions of the beams about the x axis, from left to right (beams - 1, 3)."""
    left = settings.fov / 2 - settings.fov / (settings.beams - 1) * np.arange(settings.beams - 1)
    return np.stack([np.cos(left), np.sin(left), np.zeros_like(left)], -1).astype(np.float32)


@dataclass(frozen=True, eq=False)
class LineLaser(Sensor):
    """Laser line; value: position [m] and roll, pitch, yaw [rad] of the laser, points of the line [m] (1 + beams, 3).

    All in world axes. A beam that meets nothing ends at MaxRange. Pictures show the points that it meets.
    """  # noqa: E501 - the first line is a table's row

    kind = "LineLaser"
    settings_class = LineLaserSettings

    @property
    def max_distance(self) -> float:
        """MaxRange [m]."""
        return self.settings[0].max_range

    @vectorized
    def fans(self, bodies: BodyPoses) -> Fans:
        """Return its beams."""
        return Fans(*self.mount_poses(bodies), self._fan)

    @cached_property
    def _fan(self) -> np.ndarray:
        """Directions of all beams, as one fan (1, beams - 1, 3)."""
        return line_directions(self.settings[0])[None]

    def init_memory(self, inputs: SensorInput, key: Array) -> OverlayLines:
        """Return an overlay without points."""
        del inputs, key
        return empty_overlay(self._fan.shape[1])

    @vectorized
    def read(self, inputs: SensorInput, memory: OverlayLines, key: Array) -> tuple[OverlayLines, Array]:
        """Scan once."""
        del memory, key
        pos, mat = self.mount_poses(inputs.bodies)
        origin, along = self.fans(inputs.bodies).rays()
        met = inputs.hits.distance <= self.max_distance
        points = origin + xp.minimum(inputs.hits.distance, self.max_distance)[..., None] * along
        pose = xp.stack([pos[..., 0, :], angles_from_mat(mat[..., 0, :, :], xp)], -2)
        red = xp.broadcast_to(RED, points.shape)
        drawn = OverlayLines(start=points, end=points, rgb=red, shown=met)
        return drawn, xp.concatenate([pose, points], -2)

    @property
    def has_overlay(self) -> bool:
        """True: its light is visible."""
        return True

    def overlay(self, memory: OverlayLines) -> OverlayLines:
        """Return the points that the last scan met."""
        return memory


SENSORS.add(LineLaser.kind, LineLaser)
