"""Sensors that find people: victims, their breath, their cries and their motion (manual 10.10 to 10.12).

The victim sensor is after the original's VictSensor.uc. The CO2 sensor has no section in the manual: its
message, `{Gas CO2} {Density ...}`, is as captured.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from types import ModuleType
from typing import Annotated, Any

import numpy as np

from usarmjx.base import random
from usarmjx.base.backend import Array, xp
from usarmjx.base.nodes import Node
from usarmjx.base.settings import NOT_NEGATIVE, POSITIVE, Setting
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
)
from usarmjx.sensors.ranging import beam_count_problem, step_count
from usarmjx.sensors.rays.bundles import Fans
from usarmjx.sensors.sketch import OverlayLines, empty_overlay
from usarmjx.sensors.surroundings import Surroundings, nearest

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
        # The largest of the four grids, the unshifted one, which has no fewer rays than the others.
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
        # The grids are cast together, but each decides for itself on false alarms.
        bounds = np.cumsum([len(grid) for grid in self._grids])[:-1]
        met = xp.stack([grid.any(1) for grid in xp.split(inside, bounds, axis=1)])
        offset = xp.asarray(around.box_pos) - pos[0]
        # A sum of products, as a matrix product may run in TensorFloat-32 on a GPU.
        position = (offset[:, :, None] * mat[0]).sum(1)  # in the sensor's axes
        far = xp.linalg.norm(offset, axis=-1)
        # One draw for everything: each call of the generator is a hundred operations to XLA.
        drawn = random.normal(key, (met.size + position.size,))
        doubt = xp.abs(drawn[: met.size].reshape(met.shape)) * far > settings.distance / 3
        # A victim is never doubted: owners below 0 are false alarms.
        seen = (met & (doubt | (xp.asarray(around.box_owner) >= 0))).any(0)
        error = settings.mean + settings.sigma * drawn[met.size :].reshape(position.shape)
        reported = xp.where(seen[:, None], position + far[:, None] * error, 0.0)
        row = xp.stack([seen.astype(xp.float32), xp.asarray(around.box_part, xp.float32)], -1)
        if self.has_overlay:
            rgb = xp.where((inputs.hits.distance <= settings.distance)[:, None], RED, WHITE)
            # Victims last: where both overlap, the victim's colour is shown.
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
        # A ray that meets nothing ends at its full length, which may lie within the tolerance of a box.
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


BREATH_CO2 = 4.0
"""CO2 in breath in excess of that in air [percent by volume]."""
MOUTH_RADIUS = 0.1
"""Distance from a mouth within which the air is pure breath [m] (chosen)."""


@dataclass(frozen=True, eq=False)
class Co2(Sensor):
    """CO2 sensor for victims' breath; value: CO2 in excess of that in air [percent by volume] ().

    The concentration falls with the square of the distance, like sound: 0.04 % at 1 m, and beyond 3 m it
    vanishes in two decimals. This model is our own: no source describes the original's.
    """

    kind = "CO2Sensor"
    needs_surroundings = True
    settings_class = NoisySensorSettings

    def read(self, inputs: SensorInput, memory: Any, key: Array) -> tuple[Any, Array]:  # noqa: ANN401
        """Measure once."""
        around = inputs.surroundings_or_empty
        pos, _ = self.mount_poses(inputs.bodies)
        far = xp.linalg.norm(xp.asarray(around.mouth) - pos[0], axis=-1)
        breath = xp.where(
            xp.asarray(around.breathes),
            BREATH_CO2 * (MOUTH_RADIUS / xp.maximum(far, MOUTH_RADIUS)) ** 2,
            0.0,
        )
        # Air next to several mouths is no more than pure breath.
        density = xp.minimum(breath.sum(), BREATH_CO2)
        return memory, noisy(key, density[None], self.settings)[0]


SENSORS.add(Co2.kind, Co2)


MIN_SOURCE_DISTANCE = 0.1
"""Lower bound of a source's distance [m]."""


@dataclass(frozen=True)
class SoundSettings(NoisySensorSettings):
    """Manual 10.11.2; noise is on the loudness.

    Attributes:
        output_curve: Points of the loudness's distortion curve; none: undistorted.
    """

    noise: float = 0.05
    output_curve: OutputCurve = ()

    def problem(self) -> str:
        """Return a conflict between settings."""
        return curve_problem(self.output_curve)


@dataclass(frozen=True, eq=False)
class Sound(Sensor):
    """Microphone for the loudest victim; value: loudness, and duration of its cries [s] (2,).

    Walls do not attenuate sound: the manual has only the square of the distance. In silence both are 0.
    """

    kind = "Sound"
    needs_surroundings = True
    settings_class = SoundSettings

    def read(self, inputs: SensorInput, memory: Any, key: Array) -> tuple[Any, Array]:  # noqa: ANN401
        """Measure once."""
        settings, around = self.settings[0], inputs.surroundings_or_empty
        # argmax of nothing fails; the number of victims is static.
        if around.mouth.shape[0] == 0:
            return memory, xp.zeros(2)
        pos, _ = self.mount_poses(inputs.bodies)
        far = xp.maximum(xp.linalg.norm(xp.asarray(around.mouth) - pos[0], axis=-1), MIN_SOURCE_DISTANCE)
        loud = xp.asarray(around.loudness) / far**2
        best = xp.argmax(loud)
        heard = apply_output_curve(noisy(key, loud[best][None], self.settings)[0], settings.output_curve)
        # In silence argmax names the first victim.
        lasts = xp.where(loud[best] > 0, xp.asarray(around.duration)[best], 0.0)
        return memory, xp.stack([heard, lasts])


SENSORS.add(Sound.kind, Sound)


MAX_MOVERS = 8
"""Number of moving body parts, nearest first, that are tested for occlusion."""
MIN_MOVING_SPEED = 1e-3
"""Lowest speed that counts as motion [m/s]."""
HALF_DISTANCE, HALF_SPEED, HALF_SWING = 5.0, 0.2, 0.1
"""Distance [m], speed [m/s] and amplitude [m] at which each halves the probability (chosen)."""


@dataclass(frozen=True)
class HumanMotionSettings(NoisySensorSettings):
    """Manual 10.12.2.

    Attributes:
        max_range: Range [m].
        fov: Full angle of the field of view. The manual has 60 and defines 65535 as a full turn, which
            contradicts the 60: values up to 360 are degrees, larger ones Unreal's units.
        output_curve: Points of the distortion curve; none: undistorted.
    """

    max_range: Annotated[float, POSITIVE] = 1000.0
    fov: Annotated[float, Setting(gt=0, le=65535, manual_key="FOV")] = 60.0
    noise: float = 0.1
    output_curve: OutputCurve = ()

    def problem(self) -> str:
        """Return a conflict between settings."""
        return curve_problem(self.output_curve)

    @property
    def fov_radians(self) -> float:
        """Field of view [rad]."""
        return math.radians(self.fov) if self.fov <= 360 else self.fov * 2 * math.pi / 65535


def human_motion_probability(distance: Array, speed: Array, swing: Array, xp: ModuleType = xp) -> Array:
    """Return the probability that a motion is a human's (...,).

    Our own formula, as the manual only names the variables: 1 for a near, fast and wide motion, halved by
    each of `HALF_DISTANCE`, `HALF_SPEED` and `HALF_SWING`.

    Args:
        distance: Distance [m] (...,).
        speed: Speed [m/s] (...,).
        swing: Amplitude from the initial position [m] (...,).
        xp: Array module of all three.
    """
    near = 1 / (1 + (distance / HALF_DISTANCE) ** 2)
    return near * speed / (speed + HALF_SPEED) * swing / xp.maximum(swing + HALF_SWING, HALF_SWING)


class _Movers(Node, kw_only=True):
    """Nearest moving body parts, nearest first.

    Attributes:
        pos: Positions [m] (n, 3).
        distance: Distances, infinite for missing parts [m] (n,).
        owner: Victims' indices (n,).
        speed: Speeds of their fastest corners [m/s] (n,).
        swing: Largest amplitudes of their corners [m] (n,).
        half_diagonal: Half the diagonals of their boxes [m] (n,).
    """

    pos: Array
    distance: Array
    owner: Array
    speed: Array
    swing: Array
    half_diagonal: Array


@dataclass(frozen=True, eq=False)
class HumanMotion(Sensor):
    """Detector of the closest moving victim in view; value: probability of human motion ().

    A victim is in view if the centre of a moving part is, and a ray to it ends on the part.
    """

    kind = "HumanMotion"
    needs_surroundings = True
    transparent = frozenset({SKY, GLASS})
    settings_class = HumanMotionSettings

    def _movers(self, bodies: BodyPoses, surroundings: Surroundings) -> tuple[Array, _Movers]:
        """Return the sensor's position (3,), and the moving parts in its field of view."""
        settings = self.settings[0]
        pos, mat = self.mount_poses(bodies)
        boxes = xp.asarray(surroundings.box_pos)
        offset = boxes - pos[0]
        far = xp.linalg.norm(offset, axis=-1)
        # Multiplied by the distance instead of divided: a part at the sensor itself would give 0 / 0.
        ahead = (offset * mat[0, :, 0]).sum(-1) >= far * math.cos(settings.fov_radians / 2)
        moves = (xp.asarray(surroundings.speed) > MIN_MOVING_SPEED) & (
            xp.asarray(surroundings.box_owner) >= 0
        )
        shown = xp.where(moves & ahead & (far <= settings.max_range), far, xp.inf)
        # Padded, so that there are always enough to choose from.
        shown = xp.concatenate([shown, xp.full(MAX_MOVERS, xp.inf)])
        index = nearest(shown, MAX_MOVERS)

        def pick(values: Array) -> Array:
            values = xp.asarray(values)
            return xp.concatenate([values, xp.zeros((MAX_MOVERS, *values.shape[1:]), values.dtype)])[index]

        return pos[0], _Movers(
            pos=pick(boxes),
            distance=shown[index],
            owner=pick(surroundings.box_owner),
            speed=pick(surroundings.speed),
            swing=pick(surroundings.swing),
            half_diagonal=xp.linalg.norm(pick(surroundings.box_size), axis=-1),
        )

    def aimed_rays(self, bodies: BodyPoses, surroundings: Surroundings) -> tuple[Array, Array]:
        """Return one ray to each of the nearest moving parts."""
        pos, movers = self._movers(bodies, surroundings)
        way = movers.pos - pos
        along = way / xp.maximum(xp.linalg.norm(way, axis=-1, keepdims=True), 1e-3)
        # A zero direction is not cast.
        along = xp.where(xp.isfinite(movers.distance)[:, None], along, 0.0)
        return xp.broadcast_to(pos, along.shape), along

    def read(self, inputs: SensorInput, memory: Any, key: Array) -> tuple[Any, Array]:  # noqa: ANN401
        """Measure once: the closest visible part, and the widest motion of its victim."""
        settings = self.settings[0]
        _, movers = self._movers(inputs.bodies, inputs.surroundings_or_empty)
        # A ray to a box's centre ends within half the diagonal of it; an obstacle in front ends it earlier.
        seen = xp.isfinite(movers.distance) & (inputs.hits.distance >= movers.distance - movers.half_diagonal)
        far = xp.where(seen, movers.distance, xp.inf)
        first = xp.argmin(far)
        same = seen & (movers.owner == movers.owner[first])
        speed, swing = (xp.where(same, values, 0.0).max() for values in (movers.speed, movers.swing))
        # If none is seen, argmin names the first.
        found = xp.isfinite(far[first])
        likely = xp.where(
            found, human_motion_probability(xp.where(found, far[first], 0.0), speed, swing), 0.0
        )
        reported = apply_output_curve(noisy(key, likely[None], self.settings)[0], settings.output_curve)
        return memory, xp.clip(reported, 0.0, 1.0)


SENSORS.add(HumanMotion.kind, HumanMotion)
