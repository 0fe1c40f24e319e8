"""Victim and false positive sensor (manual 10.10), as the original's VictSensor.uc works."""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.errors import SpecError
from usarmjx.models.plan import Bodies
from usarmjx.sensors.base import SENSORS, Common, Sensor, Sight
from usarmjx.sensors.kernels import ray_box
from usarmjx.sensors.ranging import steps
from usarmjx.transforms import Array

TOLERANCE = 1e-3
"""A ray that ends this much short of a body part still met it [m]: the same number, worked out twice."""
PATTERNS = ((0, 0), (1, 0), (1, 1), (0, 1))
"""The four grids of rays that a reading is made of: by how many half steps each is shifted to the right and
down."""


@dataclass(frozen=True)
class VictimSettings(Common):
    """Manual 10.10.2.

    Attributes:
        scan_interval: Time between two readings [s]: the original sends one of its four grids with each of
            its robot's reports, which come every 0.2 s, and tells what all of them met after the fourth.
        distance: Length of the rays [m].
        horizontal_fov: Angle from the first column of rays to the last [rad].
        horizontal_step: Angle between two columns of a grid [rad].
        vertical_fov: Angle from the first row of rays to the last [rad].
        vertical_step: Angle between two rows of a grid [rad].
        show_results: Whether to show in pictures where rays end; has no effect.
        mean: Mean error of a coordinate, as a share of the distance.
        sigma: Standard deviation of the error, as a share of the distance.
    """

    with_time_stamp: bool = True
    scan_interval: float = 0.8
    distance: float = 6.0
    horizontal_fov: float = 0.6981317
    horizontal_step: float = 0.0698131
    vertical_fov: float = 0.6981317
    vertical_step: float = 0.0698131
    show_results: bool = False
    mean: float = 0.0
    sigma: float = 0.01


def grids(settings: VictimSettings) -> tuple[np.ndarray, ...]:
    """Return the unit directions about the x axis of each of the four grids (rays, 3).

    Raises:
        SpecError: A step that is not positive.
    """
    if not (settings.horizontal_step > 0 and settings.vertical_step > 0):
        raise SpecError(
            "VictSensor: HorizontalStep and VerticalStep are "
            f"{settings.horizontal_step} and {settings.vertical_step}, expected numbers above 0"
        )
    return tuple(
        _grid(
            _angles(settings.horizontal_fov, settings.horizontal_step, right),
            _angles(settings.vertical_fov, settings.vertical_step, down),
        )
        for right, down in PATTERNS
    )


def _angles(fov: float, step: float, shift: int) -> np.ndarray:
    """Angles from half the field of view downward, the first by `shift` half steps less (n,)."""
    late = shift * step / 2
    return fov / 2 - late - np.arange(steps(fov - late, step) + 1) * step


def _grid(left: np.ndarray, up: np.ndarray) -> np.ndarray:
    left, up = np.meshgrid(left, up, indexing="ij")
    lines = (np.cos(up) * np.cos(left), np.cos(up) * np.sin(left), np.sin(up))
    return np.stack(lines, -1).reshape(-1, 3).astype(np.float32)


@dataclass(frozen=True, eq=False)
class VictSensor(Sensor):
    """Grids of rays that look for parts of victims; value: (boxes, 5).

    For each box of a victim or false alarm: whether it was met, which part it is as a place in
    `victims.PART_NAMES`, and where its centre is, in the sensor's axes [m].

    All four grids are cast at the moment of the reading. A left and a right limb are two parts, upper and
    lower arm (leg) one. False alarms come and go as the original's do: each grid that meets one takes it for
    nothing with the probability with which a normal number is below `distance` / 3 of its distance.
    """

    kind = "VictSensor"
    looks_around = True
    defaults = VictimSettings

    def check(self) -> None:
        """Find what is wrong; see `Sensor.check`."""
        super().check()
        grids(self.settings[0])

    def rays(self, bodies: Bodies) -> tuple[jax.Array, jax.Array]:
        """All four grids, one after the other."""
        pos, mat = self.mount_poses(bodies)
        lines = np.concatenate(grids(self.settings[0]))
        # A sum of products, so that a GPU does not round it to TensorFloat-32.
        along = (mat[0] * lines[:, None, :]).sum(-1)
        return jnp.broadcast_to(pos[0], along.shape), along

    def read(self, sight: Sight, memory: Any, key: jax.Array) -> tuple[Any, jax.Array]:  # noqa: ANN401
        """Look once with all four grids."""
        settings, around = self.settings[0], sight.around
        pos, mat = self.mount_poses(sight.bodies)
        met = self._met(sight)
        offset = jnp.asarray(around.box_pos) - pos[0]
        place = (offset[:, :, None] * mat[0]).sum(1)  # in the sensor's axes
        far = jnp.linalg.norm(offset, axis=-1)
        taken, noise = jax.random.split(key)
        doubt = jnp.abs(jax.random.normal(taken, met.shape)) * far > settings.distance / 3
        seen = (met & (doubt | (jnp.asarray(around.owner) >= 0))).any(0)
        error = settings.mean + settings.sigma * jax.random.normal(noise, place.shape)
        told = jnp.where(seen[:, None], place + far[:, None] * error, 0.0)
        row = jnp.stack([seen.astype(jnp.float32), jnp.asarray(around.part, jnp.float32)], -1)
        return memory, jnp.concatenate([row, told], -1)

    def _met(self, sight: Sight) -> jax.Array:
        """Return which boxes each grid met (4, boxes): those whose surface is where a ray ends."""
        settings, around = self.settings[0], sight.around
        origin, along = self.rays(sight.bodies)
        limit = jnp.minimum(sight.hits.distance + TOLERANCE, settings.distance)
        ends = np.cumsum([len(grid) for grid in grids(settings)])[:-1]

        def one(pos: Array, mat: Array, size: Array) -> jax.Array:
            start = (mat * (origin[0] - pos)[:, None]).sum(0)
            turned = (mat[None] * along[:, :, None]).sum(1)
            hit = ray_box(start[:, None], turned.T, size[:, None]) <= limit
            return jnp.stack([grid.any() for grid in jnp.split(hit, ends)])

        if around.box_pos.shape[0] == 0:
            return jnp.zeros((len(PATTERNS), 0), bool)
        boxes = (around.box_pos, around.box_mat, around.box_size)
        return jax.vmap(one, out_axes=1)(*map(jnp.asarray, boxes))


SENSORS.add(VictSensor.kind, VictSensor)
