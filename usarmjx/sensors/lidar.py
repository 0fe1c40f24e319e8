"""Lidar: a 3D scanner that tells intensities and loses echoes, as today's do. Ours; the manual has none."""

import math
from dataclasses import dataclass
from typing import Annotated, Any

from usarmjx.base import random
from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.models.spec.settings import ANGLE_STEP, HALF_TURN, NOT_NEGATIVE, TURN, ManualKey, NumberLimits
from usarmjx.sensors.base import SENSORS, SensorInput, for_teams
from usarmjx.sensors.ranging import range_readings
from usarmjx.sensors.scanners import RangeScanner3D, Scanner3DSettings

SHARE_OF_ALL = NumberLimits(low=0.0, high=1.0)
NEAREST = 1.0
"""The power of an echo falls with the square of the distance from here on [m]."""


@dataclass(frozen=True)
class LidarSettings(Scanner3DSettings):
    """Keys of `[USARBot.Lidar]`: 16 rows 2 degrees apart, 180 beams all around (chosen).

    Attributes:
        reflectance: Share of the light that surfaces throw back.
        min_power: Weaker echoes are lost; 1 is that of a white surface 1 m away that faces the sensor.
        dropout: Probability with which any other echo is lost.
        intensity_noise: Standard deviation of the noise of intensities, as a share.
    """

    scan_interval: float = 0.1
    max_range: float = 100.0
    vertical_fov: Annotated[float, HALF_TURN, ManualKey("VerticalFOV")] = math.radians(30)
    vertical_resolution: Annotated[float, ANGLE_STEP] = math.radians(2)
    horizontal_fov: Annotated[float, TURN, ManualKey("HorizontalFOV")] = math.radians(358)
    horizontal_resolution: Annotated[float, ANGLE_STEP] = math.radians(2)
    reflectance: Annotated[float, SHARE_OF_ALL] = 0.5
    min_power: Annotated[float, NOT_NEGATIVE] = 5e-5
    dropout: Annotated[float, SHARE_OF_ALL] = 0.0
    intensity_noise: Annotated[float, NOT_NEGATIVE] = 0.0


@dataclass(frozen=True, eq=False)
class Lidar(RangeScanner3D):
    """Rows of beams and the strength of their echoes; value: ranges [m], then intensities (2, rows, columns).

    An intensity is what the surface throws back, its reflectance times the cosine of the angle of incidence:
    calibrated, that is, distance taken out. An echo that is lost is MaxRange with an intensity of 0.
    """

    kind = "Lidar"
    settings_class = LidarSettings

    @property
    def needs_incidence(self) -> bool:
        """It does: a surface met flatly throws back little."""
        return True

    @for_teams
    def read(self, inputs: SensorInput, memory: Any, key: Array) -> tuple[Any, Array]:  # noqa: ANN401
        """Scan once, all beams at the same moment; noise of ranges as of any scanner."""
        settings, hits = self.settings[0], inputs.hits
        back = settings.reflectance * hits.cosine
        power = back / xp.square(xp.maximum(hits.distance, NEAREST))
        lost, noise = (random.fold_in(key, number) for number in (1, 2))
        heard = (power >= settings.min_power) & (hits.distance < settings.max_range)
        heard &= random.uniform(lost, heard.shape) >= settings.dropout
        distance = xp.where(heard, hits.distance, xp.inf)
        ranges = range_readings(distance[..., None, :], self.settings, key)[..., 0, :]
        factor = 1 + settings.intensity_noise * random.normal(noise, back.shape)
        intensity = xp.where(heard, xp.clip(back * factor, 0.0, 1.0), 0.0)
        both = xp.stack([ranges, intensity], -2)
        return memory, both.reshape(*both.shape[:-1], *settings.shape)


SENSORS.add(Lidar.kind, Lidar)
