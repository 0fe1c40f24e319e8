"""Bundles of rays with similar directions, and the culling of geoms by their bounding cones.

A bundle is a cone about an axis, with a tip as thick as the spread of its rays' origins. A geom is culled if
the cone misses its bounding box: one test instead of one per ray.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.backend import Array, on_numpy, xp
from usarmjx.base.rotations import matvec
from usarmjx.sensors.rays.kernels import TINY, XYZ, bounding_box

CONE_MARGIN = 1e-3
"""Thickening of cones against rounding [m]."""
MIN_SLOPE = 1e-5
"""Lowest slope of a cone, so that its walls are never parallel to a face of a geom."""
MIN_COSINE = 0.17
"""Cosine to the axis below which a bundle is too wide for culling."""


class Fans(NamedTuple):
    """Rays from the origins of moving frames, fixed in them: one fan per frame.

    Attributes:
        pos: Origins [m] (..., fans, 3).
        mat: Orientations (..., fans, 3, 3).
        directions: Unit vectors in the frames (fans, lines, 3).
    """

    pos: Array
    mat: Array
    directions: np.ndarray

    def rays(self) -> tuple[Array, Array]:
        """Return origins [m] and unit vectors in world axes, fan by fan, both (..., rays, 3)."""
        if on_numpy():  # one matrix product per fan
            along = self.directions @ self.mat.mT
        else:
            along = matvec(self.mat[..., None, :, :], self.directions)
        start, flat = xp.broadcast_to(self.pos[..., None, :], along.shape), (*along.shape[:-3], -1, 3)
        return start.reshape(flat), along.reshape(flat)


class Cone(NamedTuple):
    """Bounding cone of a bundle's rays; components as in `kernels.XYZ`.

    Attributes:
        tip: Mean of the rays' origins [m].
        axis: Unit vector.
        tip_radius: Largest distance of a ray's origin from the tip [m] (...,).
        slope: Tangent of the half angle (...,); negative: too wide for culling.
    """

    tip: XYZ
    axis: XYZ
    tip_radius: jax.Array
    slope: jax.Array


def bundled(values: jax.Array, size: int) -> jax.Array:
    """Return values of rays (..., rays) in bundles (..., bundles, size), padded with the last value."""
    missing = (*values.shape[:-1], -values.shape[-1] % size)
    # Copies of the last ray neither widen the cone nor reach farther.
    whole = jnp.concatenate([values, jnp.broadcast_to(values[..., -1:], missing)], -1)
    return whole.reshape(*values.shape[:-1], -1, size)


def bounding_cones(start: XYZ, along: XYZ) -> Cone:
    """Return the bounding cones of bundles of rays (..., size), components (...)."""
    # A mean of unit vectors is not the narrowest cone's axis, but near it and cheap.
    tip, axis = ([x.mean(-1) for x in vector] for vector in (start, along))
    length = jnp.maximum(jnp.sqrt(sum(x * x for x in axis)), TINY)
    axis = [x / length for x in axis]
    turned = [way * x[..., None] for way, x in zip(along, axis, strict=True)]
    # The ray farthest from the axis decides; the tangent below is sine over cosine.
    cosine: jax.Array = jnp.min(turned[0] + turned[1] + turned[2], -1)
    slope = jnp.sqrt(jnp.maximum(1 - cosine**2, 0.0)) / jnp.maximum(cosine, MIN_COSINE) + MIN_SLOPE
    away = sum((at - x[..., None]) ** 2 for at, x in zip(start, tip, strict=True))
    # Rays of a bundle may start at several mounts: the cone's tip is a ball around their origins.
    thick = jnp.sqrt(away).max(-1) + CONE_MARGIN
    return Cone(tip, axis, thick, jnp.where(cosine < MIN_COSINE, -1.0, slope))


def cone_box_distance(
    kind: int, size: XYZ, tip: XYZ, axis: XYZ, tip_radius: jax.Array, slope: jax.Array
) -> jax.Array:
    """Return the distance at which a cone meets a geom's bounding box, infinite for a miss [m] (...).

    It is measured along the axis and a lower bound for all rays of the bundle. The box is widened along the
    axis as the cone is, which turns the slab test of a ray into one of a cone; the test may report a false
    hit, never a false miss.

    Args:
        kind: Geom type.
        size: Geom sizes [m].
        tip: Tip of the cone in the geom's frame [m].
        axis: Axis of the cone in the geom's frame.
        tip_radius: See `Cone` [m].
        slope: See `Cone`.
    """
    middle, half = bounding_box(kind, size)
    near, far = 0.0 * tip_radius, jnp.inf
    for i, (at, along) in enumerate(zip(tip, axis, strict=True)):
        offset, room = at if middle is None else at - middle[i], half[i] + tip_radius
        position, speed = jnp.where(along >= 0, offset, -offset), jnp.abs(along)
        # Entry where the cone's wall approaches the slab; exit at the other side of a narrow cone.
        opening, closing = speed + slope, speed - slope
        closing = jnp.where(jnp.abs(closing) < TINY, TINY, closing)
        share = 1.0 / (opening * closing)
        enter, leave = (-position - room) * closing * share, (room - position) * opening * share
        near = jnp.maximum(near, jnp.where(closing < 0, jnp.maximum(enter, leave), enter))
        far = jnp.where(closing > 0, jnp.minimum(far, leave), far)
    return jnp.where(slope < 0, 0.0, jnp.where(near <= far, near, jnp.inf))


def cone_sphere_distance(
    offset: XYZ, axis: XYZ, radius: Array, tip_radius: jax.Array, slope: jax.Array
) -> jax.Array:
    """As `cone_box_distance`, for the bounding sphere: coarser for long geoms, at a quarter of the cost.

    Args:
        offset: Vector from the cone's tip to the sphere's centre [m].
        axis: Axis of the cone; both in any frame.
        radius: Radius of the sphere [m].
        tip_radius: See `Cone` [m].
        slope: See `Cone`.
    """
    far = offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2]
    along = offset[0] * axis[0] + offset[1] * axis[1] + offset[2] * axis[2]
    reach = radius + tip_radius
    # At the far side of the sphere, where the cone is widest.
    width = reach + slope * (along + radius)
    inside = (far - along * along <= width * width) & (along > -reach)
    # Along any ray, not along the axis: still a lower bound, which is all that culling needs.
    near = jnp.maximum(jnp.sqrt(far) - reach, 0.0)
    return jnp.where(inside | (slope < 0), near, jnp.inf)
