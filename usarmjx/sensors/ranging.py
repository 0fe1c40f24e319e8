"""Range sensors: sonar, infrared, range scanners and lidar (manual 10.2, 10.3).

The line laser and the object sensor, a scanner whose message names what its beams meet, are those of
USARSim's later versions, after LineLaser.uc and ObjectSensor.uc (`hrnr/robocup-usarsim`).
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, ClassVar

import numpy as np

from usarmjx.base import random
from usarmjx.base.backend import Array, xp
from usarmjx.base.settings import NOT_NEGATIVE, POSITIVE, SHARE, Parameters, Setting
from usarmjx.base.transforms import angles_from_mat
from usarmjx.models.compile.kinematic_tree import BodyPoses
from usarmjx.models.types.robot import ANGLE_STEP, HALF_TURN, TURN
from usarmjx.models.types.shapes import GLASS, SKY
from usarmjx.sensors.base import (
    SENSORS,
    NoisySensorSettings,
    OutputCurve,
    Sensor,
    SensorInput,
    SensorSettings,
    apply_output_curve,
    curve_problem,
    noisy,
    vectorized,
)
from usarmjx.sensors.rays.bundles import Fans
from usarmjx.sensors.sketch import OverlayLines, empty_overlay

MAX_BEAMS = 65_536
"""Largest number of beams of a scan; a larger one is an error in its resolution."""
# Rays of a beam: its axis, four at half the angle on the diagonals, four on the cone itself, as
# (fraction of the half angle, angle about the axis).
BEAM_RINGS = ((0.5, 45.0), (1.0, 0.0))
BEAM_PATTERN = (
    (0.0, 0.0),
    *((share, math.radians(first + 90 * i)) for share, first in BEAM_RINGS for i in range(4)),
)
REFERENCE_DISTANCE = 1.0
"""Distance from which on the power of an echo falls with its square [m]."""


@dataclass(frozen=True)
class RangeSettings(NoisySensorSettings):
    """Settings of all range sensors.

    Attributes:
        min_range: Shortest reported distance [m].
        max_range: Longest distance, reported without a hit [m].
        output_curve: Points of the distortion curve; none: undistorted.
    """

    min_range: Annotated[float, NOT_NEGATIVE] = 0.1
    max_range: Annotated[float, POSITIVE] = 5.0
    output_curve: OutputCurve = ()

    def problem(self) -> str:
        """Return a conflict between settings."""
        if self.min_range > self.max_range:
            return f"MinRange is {self.min_range:g}, expected at most MaxRange, {self.max_range:g}"
        return curve_problem(self.output_curve)


def largest_range(settings: tuple[RangeSettings, ...]) -> float:
    """Return the largest range of some sensors [m]."""
    return max(one.max_range for one in settings)


def range_readings(distance: Array, settings: tuple[RangeSettings, ...], key: Array) -> Array:
    """Convert true distances [m] (..., sensors, n) to reported distances [m] (..., sensors, n).

    Noise applies to hits only and is clamped to the sensor's range; without a hit in range the reading is
    exactly MaxRange; the distortion curve comes last.

    Args:
        distance: True distances.
        settings: Settings of each sensor.
        key: Key of the noise, with as many axes as the distances have before the sensors.
    """
    low, high = (
        np.array([[getattr(s, name)] for s in settings], np.float32) for name in ("min_range", "max_range")
    )
    hit = distance < high
    # Noise is relative: of an infinite distance it would be infinite or NaN.
    noisy_distance = noisy(key, xp.where(hit, distance, 0.0), settings)
    ranges = xp.where(hit, xp.clip(noisy_distance, low, high), high)
    # Sensors may have different curves; without any, one array operation serves all.
    curves = [s.output_curve for s in settings]
    if any(curves):
        return xp.stack([apply_output_curve(ranges[..., i, :], curve) for i, curve in enumerate(curves)], -2)
    return ranges


@dataclass(frozen=True)
class SonarSettings(RangeSettings):
    """Manual 10.2.2; MinRange from captured CONF lines.

    Attributes:
        beam_angle: Full angle of the beam cone [rad].
        max_incidence: Angle of incidence above which a surface reflects the sound away [rad]; from pi / 2 on
            none does, and a level robot hears the floor where its cone meets it. Own key; the manual has
            none.
    """

    with_time_stamp: bool = True
    noise: float = 0.05
    beam_angle: Annotated[float, HALF_TURN] = 0.3491
    max_incidence: Annotated[float, HALF_TURN] = math.pi / 2


def beam_directions(beam_angle: float) -> np.ndarray:
    """Return the unit directions of a beam's rays about the x axis (rays, 3)."""
    lines: list[tuple[float, float, float]] = []
    for share, around in BEAM_PATTERN:
        tilt = share * beam_angle / 2
        lines.append((math.cos(tilt), math.sin(tilt) * math.cos(around), math.sin(tilt) * math.sin(around)))
    return np.array(lines, np.float32)


@dataclass(frozen=True, eq=False)
class Sonar(Sensor):
    """Sonar with several rays per cone, of which the shortest counts; value: ranges [m] (mounts,)."""

    kind = "Sonar"
    grouped = True
    # Two cones to a bundle: neighbouring sonars look in similar directions.
    bundle_size = 2 * len(BEAM_PATTERN)
    settings_class = SonarSettings

    @property
    def needs_incidence(self) -> bool:
        """Whether any of them ignores surfaces at large angles of incidence."""
        return bool((self._min_cosines > -1).any())

    @property
    def max_distance(self) -> float:
        """Largest MaxRange [m]."""
        return largest_range(self.settings)

    @vectorized
    def fans(self, bodies: BodyPoses) -> Fans:
        """Return the rays of all beams."""
        return Fans(*self.mount_poses(bodies), self._cones)

    @cached_property
    def _cones(self) -> np.ndarray:
        """Ray directions of each beam about its mount's x axis (mounts, rays, 3)."""
        return np.stack([beam_directions(settings.beam_angle) for settings in self.settings])

    @cached_property
    def _min_cosines(self) -> np.ndarray:
        """Cosine of each sensor's largest angle of incidence; -1: unlimited (mounts, 1)."""
        widest = np.array([[one.max_incidence] for one in self.settings], np.float32)
        # Compared in single precision: pi / 2 from an ini file must count as unlimited.
        return np.where(widest < np.float32(math.pi / 2), np.cos(widest), np.float32(-1))

    @property
    def least_cosines(self) -> tuple[float, ...]:
        """Cosine of each sensor's largest angle of incidence: the shortest ray of a beam counts."""
        return tuple(self._min_cosines[:, 0].tolist())

    @vectorized
    def read(self, inputs: SensorInput, memory: Any, key: Array) -> tuple[Any, Array]:  # noqa: ANN401
        """Measure once (manual 10.2.1)."""
        hits, beams = inputs.hits, len(self.mounts)
        distance = hits.distance.reshape(*hits.distance.shape[:-1], beams, -1)
        if self.needs_incidence:
            # Before the minimum: a surface that reflects the sound away hides nothing behind another ray.
            distance = xp.where(hits.cosine.reshape(distance.shape) >= self._min_cosines, distance, xp.inf)
        return memory, range_readings(distance.min(-1, keepdims=True), self.settings, key)[..., 0]


@dataclass(frozen=True)
class IrSettings(RangeSettings):
    """Manual 10.2.2; MinRange is that of captured CONF lines of the other range sensors."""

    with_time_stamp: bool = True
    noise: float = 0.05


@dataclass(frozen=True, eq=False)
class Ir(Sensor):
    """Infrared sensor with one ray, which passes glass (manual 10.2.1); value: ranges [m] (mounts,)."""

    kind = "IR"
    grouped = True
    transparent = frozenset({SKY, GLASS})
    settings_class = IrSettings

    @property
    def max_distance(self) -> float:
        """Largest MaxRange [m]."""
        return largest_range(self.settings)

    def rays(self, bodies: BodyPoses) -> tuple[Array, Array]:
        """Return each sensor's ray, along its x axis."""
        pos, mat = self.mount_poses(bodies)
        return pos, mat[:, :, 0]

    @vectorized
    def read(self, inputs: SensorInput, memory: Any, key: Array) -> tuple[Any, Array]:  # noqa: ANN401
        """Measure once (manual 10.2.1)."""
        return memory, range_readings(inputs.hits.distance[..., None], self.settings, key)[..., 0]


@dataclass(frozen=True)
class ScannerSettings(RangeSettings):
    """Manual 10.3.2, angles in radians instead of Unreal's units.

    Attributes:
        scan_interval: Time between scans [s]; 0 is manual mode: scan on the SCAN command only.
        resolution: Angle between two beams [rad].
        scan_fov: Angle from the first beam to the last [rad].
        pitch: Scan in the tilt plane (x-z).
        yaw: Scan in the pan plane (x-y).
    """

    with_time_stamp: bool = True  # captured lines carry the time, though the manual's ini says False
    scan_interval: float = 0.5
    max_range: float = 1000.0
    resolution: Annotated[float, ANGLE_STEP] = 800 * 2 * math.pi / 65536
    scan_fov: Annotated[float, TURN] = math.pi
    pitch: bool = False
    yaw: bool = True

    def problem(self) -> str:
        """Return a conflict between settings."""
        if self.pitch == self.yaw:
            return "a range scanner scans in one plane: exactly one of bYaw and bPitch must be true"
        return super().problem() or beam_count_problem(self.beams)

    @property
    def beams(self) -> int:
        """Number of beams, both ends included; of a full turn, whose ends are one direction, once."""
        return beam_count(self.scan_fov, self.resolution)

    @property
    def is_full_turn(self) -> bool:
        """Whether the beam after the last one is the first."""
        return is_full_turn(self.scan_fov, self.resolution)


def step_count(fov: float, resolution: float) -> int:
    """Return the number of whole steps in a field of view, tolerating a rounding error of 1e-3 steps."""
    # Files state angles with few digits: 3.14159 / 0.0174533 must be 180 steps and not 179.
    return int(fov / resolution + 1e-3)


def is_full_turn(fov: float, resolution: float) -> bool:
    """Return whether whole steps go once around, so that both ends of a field of view are one direction."""
    steps = step_count(fov, resolution)
    return steps > 1 and abs(steps * resolution - 2 * math.pi) < 1e-2 * resolution


def beam_count(fov: float, resolution: float) -> int:
    """Return the number of beams in a field of view, each direction once."""
    return step_count(fov, resolution) + (0 if is_full_turn(fov, resolution) else 1)


def beam_count_problem(beams: int) -> str:
    """Return the fault of a scan with `beams` beams, "" if there is none."""
    return f"that makes {beams} beams, expected up to {MAX_BEAMS}" if beams > MAX_BEAMS else ""


def fan_directions(settings: ScannerSettings) -> np.ndarray:
    """Return the unit directions of a scan about the x axis (beams, 3), from right to left.

    In the tilt plane the first beam is the lowest. The order is that of captured messages.
    """
    # By whole steps from the first beam, as clients compute angles; the last one may fall short of the end.
    angle = -settings.scan_fov / 2 + np.arange(settings.beams) * settings.resolution
    along, aside, zero = np.cos(angle), np.sin(angle), np.zeros_like(angle)
    columns = (along, aside, zero) if settings.yaw else (along, zero, aside)
    return np.stack(columns, -1).astype(np.float32)


@dataclass(frozen=True, eq=False)
class RangeScanner(Sensor):
    """Scanner with one ray per angular step; value: ranges [m] (beams,)."""

    kind = "RangeScanner"
    opcodes: ClassVar[dict[str, Parameters]] = {"SCAN": Parameters()}
    settings_class = ScannerSettings

    @property
    def max_distance(self) -> float:
        """Largest MaxRange [m]."""
        return largest_range(self.settings)

    @property
    def on_command(self) -> bool:
        """Whether it scans only on the SCAN command."""
        return self.settings[0].scan_interval <= 0

    def directions(self) -> np.ndarray:
        """Unit directions of the beams about the mount's x axis (beams, 3)."""
        return fan_directions(self.settings[0])

    @vectorized
    def fans(self, bodies: BodyPoses) -> Fans:
        """Return one ray per step of the fan."""
        return Fans(*self.mount_poses(bodies), self._fan)

    @cached_property
    def _fan(self) -> np.ndarray:
        """Directions of all beams, as one fan (1, beams, 3)."""
        return self.directions()[None]

    @vectorized
    def read(self, inputs: SensorInput, memory: Any, key: Array) -> tuple[Any, Array]:  # noqa: ANN401
        """Scan once (manual 10.3.1)."""
        return memory, range_readings(inputs.hits.distance[..., None, :], self.settings, key)[..., 0, :]

    def handle_set(
        self,
        opcode: str,
        params: tuple[float, ...],
        inputs: SensorInput,
        memory: Any,  # noqa: ANN401
    ) -> Any | None:  # noqa: ANN401
        """Accept SCAN, valid in both modes; the suite makes the scan due (manual, Table 3)."""
        return memory if opcode.upper() == "SCAN" else None


for _sensor in (Sonar, Ir, RangeScanner):
    SENSORS.add(_sensor.kind, _sensor)


@dataclass(frozen=True)
class IrScannerSettings(ScannerSettings):
    """Manual 10.3.2: the range scanner's."""

    @property
    def beams(self) -> int:
        """Number of beams: the number of steps, as the end of the field of view has none (IRScanner.uc)."""
        # The margin keeps a quotient that rounding has put just above a whole number from adding a beam.
        return math.ceil(self.scan_fov / self.resolution - 1e-3)


@dataclass(frozen=True, eq=False)
class IrScanner(RangeScanner):
    """Range scanner with infrared rays, which pass glass (manual 10.3); value: ranges [m] (beams,)."""

    kind = "IRScanner"
    transparent = Ir.transparent
    settings_class = IrScannerSettings


@dataclass(frozen=True)
class Scanner3DSettings(RangeSettings):
    """Settings of the 3D scanner: keys and values of Ardabot's USARBot.ini; see manual 12.17.2 for its name.

    Attributes:
        scan_interval: Time between scans [s]; 0 is manual mode: scan on the SCAN command only.
        vertical_fov: Angle from the first row to the last [rad].
        vertical_resolution: Angle between two rows [rad].
        horizontal_fov: Angle from the first beam of a row to the last [rad].
        horizontal_resolution: Angle between two beams of a row [rad].
    """

    with_time_stamp: bool = True  # as the range scanner
    scan_interval: float = 0.4
    max_range: float = 1000.0
    vertical_fov: Annotated[float, HALF_TURN, Setting(manual_key="VerticalFOV")] = 0.4363
    vertical_resolution: Annotated[float, ANGLE_STEP] = 0.0145
    horizontal_fov: Annotated[float, TURN, Setting(manual_key="HorizontalFOV")] = 1.0472
    horizontal_resolution: Annotated[float, ANGLE_STEP] = 0.0209

    def problem(self) -> str:
        """Return a conflict between settings."""
        return super().problem() or beam_count_problem(math.prod(self.shape))

    @property
    def fov(self) -> tuple[float, float]:
        """Vertical and horizontal field of view [rad]."""
        return self.vertical_fov, self.horizontal_fov

    @property
    def resolution(self) -> tuple[float, float]:
        """Vertical and horizontal angle between beams [rad]."""
        return self.vertical_resolution, self.horizontal_resolution

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and of beams in a row, both ends included; of a full turn once."""
        rows, columns = (beam_count(f, r) for f, r in zip(self.fov, self.resolution, strict=True))
        return rows, columns


def grid_directions(settings: Scanner3DSettings) -> np.ndarray:
    """Return the unit directions of a scan about the x axis (rows, columns, 3).

    Rows run from the highest to the lowest, the order of Player's driver; the beams of a row from right to
    left, as in a range scanner.
    """
    down, left = (
        -fov / 2 + np.arange(count) * resolution
        for fov, resolution, count in zip(settings.fov, settings.resolution, settings.shape, strict=True)
    )
    down, left = np.meshgrid(down, left, indexing="ij")
    lines = (np.cos(down) * np.cos(left), np.cos(down) * np.sin(left), -np.sin(down))
    return np.stack(lines, -1).astype(np.float32)


@dataclass(frozen=True, eq=False)
class RangeScanner3D(RangeScanner):
    """Scanner with rows of beams; value: ranges [m] (rows, columns)."""

    kind = "RangeScanner3D"
    settings_class = Scanner3DSettings

    def directions(self) -> np.ndarray:
        """Unit directions of the beams about the mount's x axis, row by row (beams, 3)."""
        return grid_directions(self.settings[0]).reshape(-1, 3)

    @vectorized
    def read(self, inputs: SensorInput, memory: Any, key: Array) -> tuple[Any, Array]:  # noqa: ANN401
        """Scan once, all beams at the same moment."""
        ranges = range_readings(inputs.hits.distance[..., None, :], self.settings, key)[..., 0, :]
        return memory, ranges.reshape(*ranges.shape[:-1], *self.settings[0].shape)


for _sensor in (IrScanner, RangeScanner3D):
    SENSORS.add(_sensor.kind, _sensor)


@dataclass(frozen=True)
class LidarSettings(Scanner3DSettings):
    """Keys of `[USARBot.Lidar]`: 16 rows 2 degrees apart, 180 beams all around (chosen).

    Attributes:
        reflectance: Fraction of the light that surfaces reflect.
        min_power: Power below which echoes are lost; 1 is that of a white surface 1 m away that faces the
            sensor.
        dropout: Probability of losing any other echo.
        intensity_noise: Standard deviation of the relative noise of intensities.
    """

    scan_interval: float = 0.1
    max_range: float = 100.0
    vertical_fov: Annotated[float, HALF_TURN, Setting(manual_key="VerticalFOV")] = math.radians(30)
    vertical_resolution: Annotated[float, ANGLE_STEP] = math.radians(2)
    horizontal_fov: Annotated[float, TURN, Setting(manual_key="HorizontalFOV")] = math.radians(358)
    horizontal_resolution: Annotated[float, ANGLE_STEP] = math.radians(2)
    reflectance: Annotated[float, SHARE] = 0.5
    min_power: Annotated[float, NOT_NEGATIVE] = 5e-5
    dropout: Annotated[float, SHARE] = 0.0
    intensity_noise: Annotated[float, NOT_NEGATIVE] = 0.0


@dataclass(frozen=True, eq=False)
class Lidar(RangeScanner3D):
    """Lidar with echo intensities; value: ranges [m], then intensities (2, rows, columns).

    An intensity is the reflectance times the cosine of the angle of incidence: calibrated, that is,
    independent of the distance. A lost echo has range MaxRange and intensity 0.
    """

    kind = "Lidar"
    settings_class = LidarSettings

    @property
    def needs_incidence(self) -> bool:
        """True: intensities depend on it."""
        return True

    @vectorized
    def read(self, inputs: SensorInput, memory: Any, key: Array) -> tuple[Any, Array]:  # noqa: ANN401
        """Scan once, all beams at the same moment; range noise as for all scanners."""
        settings, hits = self.settings[0], inputs.hits
        # Lambert's law: a rough surface sends back the cosine of the angle at which light meets it.
        back = settings.reflectance * hits.cosine
        # An infinite distance gives a power of 0, so that misses need no mask.
        power = back / xp.square(xp.maximum(hits.distance, REFERENCE_DISTANCE))
        # Key 0 is used by `range_readings`: all three draws are independent.
        lost, noise = (random.fold_in(key, number) for number in (1, 2))
        heard = (power >= settings.min_power) & (hits.distance < settings.max_range)
        heard &= random.uniform(lost, heard.shape) >= settings.dropout
        # Lost echoes look as if nothing was there: they get MaxRange, without noise.
        distance = xp.where(heard, hits.distance, xp.inf)
        ranges = range_readings(distance[..., None, :], self.settings, key)[..., 0, :]
        factor = 1 + settings.intensity_noise * random.normal(noise, back.shape)
        intensity = xp.where(heard, xp.clip(back * factor, 0.0, 1.0), 0.0)
        both = xp.stack([ranges, intensity], -2)
        return memory, both.reshape(*both.shape[:-1], *settings.shape)


SENSORS.add(Lidar.kind, Lidar)


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
    # The later versions never cast the beam at the far end of the field of view.
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
        # Bounded first: an infinite distance times a component of 0 is NaN.
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


@dataclass(frozen=True)
class ObjectSensorSettings(ScannerSettings):
    """Keys of `[USARSensor.ObjectSensor]`, with the range scanner's values of the later DefaultUSAR.ini.

    Attributes:
        scan_interval: Time between scans [s]; 0 is manual mode: scan on the SCAN command only.
        max_range: Length of the beams [m].
        resolution: Angle between two beams [rad].
        scan_fov: Angle from the first beam to the last [rad].
    """

    scan_interval: float = 0.2
    max_range: Annotated[float, POSITIVE] = 4.0
    resolution: Annotated[float, ANGLE_STEP] = 0.157
    scan_fov: Annotated[float, TURN] = 3.14


@dataclass(frozen=True, eq=False)
class ObjectSensor(RangeScanner):
    """Scanner that names what its beams meet; value: ranges [m] (beams,).

    The message of a served world has the objects in place of the ranges.
    """

    kind = "ObjectSensor"
    names_objects = True
    settings_class = ObjectSensorSettings


SENSORS.add(ObjectSensor.kind, ObjectSensor)
