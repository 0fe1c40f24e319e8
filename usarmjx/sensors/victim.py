"""Victim and false positive sensor (manual 10.10), after the original's VictSensor.uc."""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from usarmjx.base import random
from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.base.settings import NOT_NEGATIVE, POSITIVE, Setting
from usarmjx.models.compile.kinematic_tree import BodyPoses
from usarmjx.models.types.robot import ANGLE_STEP, HALF_TURN, TURN
from usarmjx.sensors.base import SENSORS, Sensor, SensorInput, SensorSettings
from usarmjx.sensors.ranging import beam_count_problem, step_count
from usarmjx.sensors.rays.bundles import Fans
from usarmjx.sensors.sketch import OverlayLines, empty_overlay

BOX_TOLERANCE = 1e-3
"""Tolerance of a ray's end on a body part [m]: the same distance computed in two ways."""
GRID_SHIFTS = ((0, 0), (1, 0), (1, 1), (0, 1))
"""Shifts of the four ray grids of a reading, in half steps to the right and down."""
GREEN, YELLOW, RED, WHITE = np.array([(0, 1, 0), (1, 1, 0), (1, 0, 0), (1, 1, 1)], np.float32)
"""Colours of ray ends: on a victim, a false alarm, anything else, nothing (chosen)."""


@dataclass(frozen=True)
class VictSensorSettings(SensorSettings):
    """Manual 10.10.2.

    Attributes:
        scan_interval: Time between two readings [s]: the original casts one of its four grids with each of
            its robot's reports, every 0.2 s, and reports the hits of all four after the last.
        distance: Length of the rays [m].
        horizontal_fov: Angle from the first column of rays to the last [rad].
        horizontal_step: Angle between two columns of a grid [rad].
        vertical_fov: Angle from the first row of rays to the last [rad].
        vertical_step: Angle between two rows of a grid [rad].
        show_results: Whether pictures show the ends of the rays and their hits.
        mean: Mean error of a coordinate, relative to the distance.
        sigma: Standard deviation of the error, relative to the distance.
    """

    with_time_stamp: bool = True
    scan_interval: float = 0.8
    distance: Annotated[float, POSITIVE] = 6.0
    horizontal_fov: Annotated[float, TURN, Setting(manual_key="HorizontalFOV")] = 0.6981317
    horizontal_step: Annotated[float, ANGLE_STEP] = 0.0698131
    vertical_fov: Annotated[float, HALF_TURN, Setting(manual_key="VerticalFOV")] = 0.6981317
    vertical_step: Annotated[float, ANGLE_STEP] = 0.0698131
    show_results: bool = False
    mean: float = 0.0
    sigma: Annotated[float, NOT_NEGATIVE] = 0.01

    def problem(self) -> str:
        """Return a conflict between settings."""
        columns = step_count(self.horizontal_fov, self.horizontal_step) + 1
        return beam_count_problem(columns * (step_count(self.vertical_fov, self.vertical_step) + 1))


def shifted_grids(settings: VictSensorSettings) -> tuple[np.ndarray, ...]:
    """Return the unit directions about the x axis of each of the four grids (rays, 3)."""
    return tuple(
        _grid(
            _angles(settings.horizontal_fov, settings.horizontal_step, right),
            _angles(settings.vertical_fov, settings.vertical_step, down),
        )
        for right, down in GRID_SHIFTS
    )


def _angles(fov: float, step: float, shift: int) -> np.ndarray:
    """Return angles from half the field of view downward, shifted by `shift` half steps (n,).

    Empty if the shift exceeds the field of view.
    """
    late = shift * step / 2
    if late > fov:
        return np.zeros(0)
    return fov / 2 - late - np.arange(step_count(fov - late, step) + 1) * step


def _grid(left: np.ndarray, up: np.ndarray) -> np.ndarray:
    left, up = np.meshgrid(left, up, indexing="ij")
    lines = (np.cos(up) * np.cos(left), np.cos(up) * np.sin(left), np.sin(up))
    return np.stack(lines, -1).reshape(-1, 3).astype(np.float32)


@dataclass(frozen=True, eq=False)
class VictSensor(Sensor):
    """Ray grid that looks for parts of victims; value: hit or not, part and x, y, z [m] of each (boxes, 5).

    For each box of a victim or false alarm: whether it was hit, its body part as an index in
    `victims.PART_NAMES`, and its centre in the sensor's axes [m].

    All four grids are cast at the moment of the reading. A left and a right limb are two parts, upper and
    lower arm (leg) one. False alarms flicker as in the original: each grid that hits one ignores it with the
    probability that a normal number is below `distance` / 3 of its distance.
    """

    kind = "VictSensor"
    needs_surroundings = True
    settings_class = VictSensorSettings

    @cached_property
    def _grids(self) -> tuple[np.ndarray, ...]:
        """Directions of each grid (rays, 3)."""
        return shifted_grids(self.settings[0])

    @cached_property
    def _fan(self) -> np.ndarray:
        """Directions of all grids, concatenated (1, rays, 3)."""
        return np.concatenate(self._grids)[None]

    def fans(self, bodies: BodyPoses) -> Fans:
        """Return all four grids, concatenated."""
        return Fans(*self.mount_poses(bodies), self._fan)

    def read(self, inputs: SensorInput, memory: Any, key: Array) -> tuple[Any, Array]:  # noqa: ANN401
        """Measure once with all four grids."""
        settings, around = self.settings[0], inputs.surroundings_or_empty
        pos, mat = self.mount_poses(inputs.bodies)
        end, inside = self._ends(inputs)
        bounds = np.cumsum([len(grid) for grid in self._grids])[:-1]
        met = xp.stack([grid.any(1) for grid in xp.split(inside, bounds, axis=1)])
        offset = xp.asarray(around.box_pos) - pos[0]
        position = (offset[:, :, None] * mat[0]).sum(1)  # in the sensor's axes
        far = xp.linalg.norm(offset, axis=-1)
        drawn = random.normal(key, (met.size + position.size,))
        doubt = xp.abs(drawn[: met.size].reshape(met.shape)) * far > settings.distance / 3
        seen = (met & (doubt | (xp.asarray(around.box_owner) >= 0))).any(0)
        error = settings.mean + settings.sigma * drawn[met.size :].reshape(position.shape)
        reported = xp.where(seen[:, None], position + far[:, None] * error, 0.0)
        row = xp.stack([seen.astype(xp.float32), xp.asarray(around.box_part, xp.float32)], -1)
        if self.has_overlay:
            rgb = xp.where((inputs.hits.distance <= settings.distance)[:, None], RED, WHITE)
            for owned, color in ((around.box_owner < 0, YELLOW), (around.box_owner >= 0, GREEN)):
                rgb = xp.where(xp.any(inside & owned[:, None], 0)[:, None], color, rgb)
            memory = OverlayLines(start=end, end=end, rgb=rgb, shown=xp.ones(len(end), bool))
        return memory, xp.concatenate([row, reported], -1)

    def _ends(self, inputs: SensorInput) -> tuple[Array, Array]:
        """Return the ends of rays [m] (rays, 3), and the boxes whose surfaces are there (boxes, rays)."""
        settings, around = self.settings[0], inputs.surroundings_or_empty
        origin, along = self.rays(inputs.bodies)
        near = inputs.hits.distance <= settings.distance
        end = origin + xp.minimum(inputs.hits.distance, settings.distance)[:, None] * along
        pos, mat, size = map(xp.asarray, (around.box_pos, around.box_mat, around.box_size))
        away = [end[:, j] - pos[:, j, None] for j in range(3)]
        inside = near
        for axis in range(3):  # sums of products: no TensorFloat-32 on a GPU
            position = sum(mat[:, j, axis, None] * away[j] for j in range(3))
            inside = inside & (xp.abs(position) <= size[:, axis, None] + BOX_TOLERANCE)
        return end, inside

    def init_memory(self, inputs: SensorInput, key: Array) -> Any:  # noqa: ANN401 - an overlay if it has one
        """Return a memory without hits."""
        del inputs, key
        return empty_overlay(self._fan.shape[1]) if self.has_overlay else ()

    @property
    def has_overlay(self) -> bool:
        """Whether bShowResults is set (manual 10.10.2)."""
        return self.settings[0].show_results

    def overlay(self, memory: OverlayLines) -> OverlayLines:
        """Return the ends of rays as points, coloured by their hits."""
        return memory


SENSORS.add(VictSensor.kind, VictSensor)
