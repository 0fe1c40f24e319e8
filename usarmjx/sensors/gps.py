"""GPS sensor (manual 10.5; 10.13 is an older text, with the axes exchanged).

The sensor works in metres and the server converts to degrees: a degree is 111 km, of which float32 would
resolve half a metre.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any

import numpy as np

from usarmjx.base import random
from usarmjx.base.backend import Array, xp
from usarmjx.base.errors import SpecError
from usarmjx.base.settings import Setting
from usarmjx.models.compile.kinematic_tree import BodyPoses
from usarmjx.models.roads.network import (
    METRES_PER_LATITUDE_DEGREE,
    METRES_PER_LONGITUDE_DEGREE,
    LatLon,
    to_lat_lon,
)
from usarmjx.models.types.robot import Options, options
from usarmjx.sensors.base import SENSORS, Sensor, SensorInput, SensorSettings

MAX_SATELLITES, MIN_FIX_SATELLITES = 12, 4
"""Number of satellites, and the smallest number for a position (manual 10.5.2)."""
ELEVATION_MASK = math.radians(5)
"""Lowest elevation of a received satellite (GPSSensor.uc) [rad]."""

DEFAULT_LOCATION = options(
    LatitudeDegree=39, LatitudeMinute=8.0273, LongitudeDegree=-77, LongitudeMinute=-12.998
)
"""Location of the world's origin if neither the arena nor an ini file defines it (GPSSensor.uc)."""


@dataclass(frozen=True)
class GpsSettings(SensorSettings):
    """Manual 10.5.2; the numbers are GPSSensor.uc's.

    Attributes:
        scan_interval: Time between two positions [s] (captured CONF).
        max_noise: Largest error of a coordinate with four satellites [m].
        min_noise: Largest error of a coordinate with twelve [m].
        zero_zero_location: LatitudeDegree, LatitudeMinute, LongitudeDegree and LongitudeMinute of the
            world's origin; south and west are negative. A missing one is 0.
        latitude_scale: Metres per degree of latitude; a negative value reverses the x axis. Own key, like
            the next, for the scale factors of manual 10.13.1's GPSStart.
        longitude_scale: Metres per degree of longitude.
    """

    scan_interval: float = 0.2
    max_noise: Annotated[float, Setting(ge=0, manual_key="maxNoise")] = 2.5
    min_noise: Annotated[float, Setting(ge=0, manual_key="minNoise")] = 0.75
    zero_zero_location: Options = DEFAULT_LOCATION
    latitude_scale: float = METRES_PER_LATITUDE_DEGREE
    longitude_scale: float = METRES_PER_LONGITUDE_DEGREE

    def problem(self) -> str:
        """Return a conflict between settings."""
        if self.min_noise > self.max_noise:
            return f"minNoise is {self.min_noise:g}, expected at most maxNoise, {self.max_noise:g}"
        for key, scale in (("LatitudeScale", self.latitude_scale), ("LongitudeScale", self.longitude_scale)):
            # Positions are divided by the scale: one near 0 would send a robot around the globe.
            if abs(scale) < 1.0:
                return f"{key} is {scale:g}, expected at least 1 or at most -1 metres a degree"
        return ""


@cache
def satellite_directions() -> np.ndarray:
    """Return the directions of the satellites, north, west and up: unit vectors (satellites, 3).

    They are fixed and evenly spread over the sky above the mask: equal steps of height on the unit sphere,
    with the golden angle between bearings. This is our own; the original followed the orbits of real
    satellites.
    """
    # Half a step in: no satellite stands exactly at the mask or in the zenith.
    index = np.arange(MAX_SATELLITES) + 0.5
    up = math.sin(ELEVATION_MASK) + (1 - math.sin(ELEVATION_MASK)) * index / MAX_SATELLITES
    # The golden angle, 137.5 degrees, is no simple part of a turn: no two satellites share a bearing.
    bearing = math.pi * (3 - math.sqrt(5)) * index
    along = np.sqrt(1 - up**2)
    return np.stack([along * np.cos(bearing), along * np.sin(bearing), up], -1).astype(np.float32)


def largest_error(settings: GpsSettings, satellites: Array) -> Array:
    """Return the largest error of a coordinate [m]: linear in the number of satellites (manual 10.5.2)."""
    # Below four satellites the share is negative; there is no position then, and no error.
    share = (satellites - MIN_FIX_SATELLITES) / (MAX_SATELLITES - MIN_FIX_SATELLITES)
    return settings.max_noise + (settings.min_noise - settings.max_noise) * share


def reference_location(location: Options) -> tuple[float, float]:
    """Return latitude and longitude [degrees] of a `ZeroZeroLocation`.

    A negative degree with a positive minute, as in the manual's own example, means a negative minute
    (GPSSensor.uc): -359 and 59.9996 are 0.0004 minutes east.

    Raises:
        SpecError: An unknown key, or a value that is not a number.
    """
    known = [f"{name}{part}" for name in ("Latitude", "Longitude") for part in ("Degree", "Minute")]
    # As in Unreal's ini files, the case of keys does not count.
    values = {key.lower(): value for key, value in location}
    if unknown := values.keys() - {key.lower() for key in known}:
        raise SpecError(f"ZeroZeroLocation has no {sorted(unknown)}; it has: {', '.join(known)}")
    numbers: list[float] = []
    for key in known:
        value = values.get(key.lower(), 0.0)
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise SpecError(f"ZeroZeroLocation: {key} is {value!r}, expected a number")
        numbers.append(float(value))
    north, north_minute, east, east_minute = numbers
    return _degrees(north, north_minute), _degrees(east, east_minute)


def _degrees(degree: float, minute: float) -> float:
    # By the degree's sign alone, as GPSSensor.uc does: its default has -77 degrees and -12.998 minutes.
    return degree - abs(minute) / 60 if degree < 0 else degree + minute / 60


def geographic_coordinates(
    settings: GpsSettings, position: Sequence[float], origin: LatLon | None = None
) -> tuple[float, float]:
    """Return latitude in [-90, 90] and longitude in [-180, 180) [degrees] of a position x, y [m].

    X is north and the wire's y, to the right of it, east. Past a pole the latitude turns back and the
    longitude stays, so that beyond it the x axis points the other way (manual 10.5.1). East past 180 degrees
    is west.

    Args:
        settings: Settings of the sensor.
        position: Position in the world.
        origin: Location of the arena's origin; None: that of the settings, which has lower priority (manual
            10.5.2).
    """
    origin = reference_location(settings.zero_zero_location) if origin is None else origin
    scales = settings.latitude_scale, settings.longitude_scale
    latitude, longitude = map(_wrapped, to_lat_lon(origin, (position[0], position[1]), scales))
    # `_wrapped` leaves up to 180 degrees: the way past a pole counts back from it.
    if abs(latitude) > 90:
        latitude = math.copysign(180, latitude) - latitude
    return latitude, longitude


def _wrapped(degrees: float) -> float:
    return (degrees + 180) % 360 - 180


@dataclass(frozen=True, eq=False)
class Gps(Sensor):
    """Satellite navigation; value: x, y with their error [m], and the number of visible satellites (3,).

    With fewer than `MIN_FIX_SATELLITES` satellites there is no position: x and y are 0. A satellite is
    visible if nothing but the robot itself is between it and the mount: the sky is where rays hit nothing.
    """

    kind = "GPS"
    settings_class = GpsSettings

    def check(self) -> None:
        """Check mounts and settings; see `Sensor.check`."""
        super().check()
        try:
            # The result is dropped: a bad location must be refused while the scene is built.
            reference_location(self.settings[0].zero_zero_location)
        except SpecError as error:
            raise SpecError(f"{self.kind} {self.mounts[0].name}: {error}") from error

    def rays(self, bodies: BodyPoses) -> tuple[Array, Array]:
        """Return one ray to each satellite, independent of the robot's orientation."""
        pos, _ = self.mount_poses(bodies)
        along = xp.asarray(satellite_directions())
        return xp.broadcast_to(pos[0], along.shape), along

    def read(self, inputs: SensorInput, memory: Any, key: Array) -> tuple[Any, Array]:  # noqa: ANN401
        """Measure a position. The largest error is three standard deviations (GPSSensor.uc)."""
        # The robot's own parts are transparent to its rays, so only the arena and others hide the sky.
        satellites = xp.isinf(inputs.hits.distance).sum().astype(xp.float32)
        pos, _ = self.mount_poses(inputs.bodies)
        deviation = largest_error(self.settings[0], satellites) / 3
        # Cut off at three deviations, so that the largest error is not exceeded.
        error = deviation * random.truncated_normal(key, -3.0, 3.0, (2,))
        fixed = xp.where(satellites >= MIN_FIX_SATELLITES, pos[0, :2] + error, 0.0)
        return memory, xp.append(fixed, satellites)


SENSORS.add(Gps.kind, Gps)
