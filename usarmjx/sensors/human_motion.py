"""Human motion sensor (manual 10.12): a pyroelectric sensor, which detects warm moving objects."""

import math
from dataclasses import dataclass
from types import ModuleType
from typing import Annotated, Any

from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.base.settings import POSITIVE, Setting
from usarmjx.models.compile.kinematic_tree import BodyPoses
from usarmjx.models.types.shapes import GLASS, SKY
from usarmjx.sensors.base import (
    SENSORS,
    NoisySensorSettings,
    OutputCurve,
    Sensor,
    SensorInput,
    apply_output_curve,
    curve_problem,
    noisy,
)
from usarmjx.sensors.surroundings import Surroundings, nearest

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


class _Movers(struct.PyTreeNode, kw_only=True):
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
        ahead = (offset * mat[0, :, 0]).sum(-1) >= far * math.cos(settings.fov_radians / 2)
        moves = (xp.asarray(surroundings.speed) > MIN_MOVING_SPEED) & (
            xp.asarray(surroundings.box_owner) >= 0
        )
        shown = xp.where(moves & ahead & (far <= settings.max_range), far, xp.inf)
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
        found = xp.isfinite(far[first])
        likely = xp.where(
            found, human_motion_probability(xp.where(found, far[first], 0.0), speed, swing), 0.0
        )
        reported = apply_output_curve(noisy(key, likely[None], self.settings)[0], settings.output_curve)
        return memory, xp.clip(reported, 0.0, 1.0)


SENSORS.add(HumanMotion.kind, HumanMotion)
