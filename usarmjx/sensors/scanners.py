"""The range scanner's relatives: IRScanner (manual 10.3) and RangeScanner3D."""

import math
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.models.spec.settings import ANGLE_STEP, HALF_TURN, TURN, ManualKey
from usarmjx.sensors.base import SENSORS, SensorInput, for_teams
from usarmjx.sensors.ranging import (
    Ir,
    RangeScanner,
    RangeSettings,
    ScannerSettings,
    beam_count_problem,
    range_readings,
    step_count,
)


@dataclass(frozen=True)
class IrScannerSettings(ScannerSettings):
    """Manual 10.3.2: the range scanner's."""

    @property
    def beams(self) -> int:
        """Number of beams: as many as steps, as the end of the field of view has none (IRScanner.uc)."""
        return math.ceil(self.scan_fov / self.resolution - 1e-3)


@dataclass(frozen=True, eq=False)
class IrScanner(RangeScanner):
    """A range scanner of infrared lines, which pass glass (manual 10.3); value: ranges [m] (beams,)."""

    kind = "IRScanner"
    transparent = Ir.transparent
    settings_class = IrScannerSettings


@dataclass(frozen=True)
class Scanner3DSettings(RangeSettings):
    """The manual only names this sensor (12.17.2). Keys and numbers of Ardabot's USARBot.ini.

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
    vertical_fov: Annotated[float, HALF_TURN, ManualKey("VerticalFOV")] = 0.4363
    vertical_resolution: Annotated[float, ANGLE_STEP] = 0.0145
    horizontal_fov: Annotated[float, TURN, ManualKey("HorizontalFOV")] = 1.0472
    horizontal_resolution: Annotated[float, ANGLE_STEP] = 0.0209

    def problem(self) -> str:
        """Return what settings do not go together."""
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
        """Number of rows and of beams in a row, both ends included."""
        rows, columns = (step_count(f, r) + 1 for f, r in zip(self.fov, self.resolution, strict=True))
        return rows, columns


def grid_directions(settings: Scanner3DSettings) -> np.ndarray:
    """Return the unit directions of a scan about the x axis (rows, columns, 3).

    Rows run from the highest to the lowest, which is how Player's driver reads them; the beams of a row
    from right to left, as those of a range scanner.
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
    """Rows of beams; value: ranges [m] (rows, columns)."""

    kind = "RangeScanner3D"
    settings_class = Scanner3DSettings

    def directions(self) -> np.ndarray:
        """Unit directions of the beams about the mount's x axis, row by row (beams, 3)."""
        return grid_directions(self.settings[0]).reshape(-1, 3)

    @for_teams
    def read(self, inputs: SensorInput, memory: Any, key: Array) -> tuple[Any, Array]:  # noqa: ANN401
        """Scan once, all beams at the same moment."""
        ranges = range_readings(inputs.hits.distance[..., None, :], self.settings, key)[..., 0, :]
        return memory, ranges.reshape(*ranges.shape[:-1], *self.settings[0].shape)


for _sensor in (IrScanner, RangeScanner3D):
    SENSORS.add(_sensor.kind, _sensor)
