"""Bundles of rays that go about the same way, and which geoms they can meet at all.

A bundle is a cone about an axis, thick at its tip by how far its rays' starts are apart. A geom is left out
when the cone misses the box about it: one test in place of as many as the bundle has rays.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import on_numpy, xp
from usarmjx.base.rotations import matvec
from usarmjx.sensors.rays.kernels import TINY, XYZ, bounding_box

CONE_MARGIN = 1e-3
"""Cones are thicker by this, for the rounding of single precision [m]."""
MIN_SLOPE = 1e-5
"""Cones are at least this steep: their walls are never parallel to a geom's face they go along."""
MIN_COSINE = 0.17
"""Bundles whose rays are farther from the axis than this cosine meet everything."""


class Fans(NamedTuple):
    """Rays that start in the origins of moving frames and are fixed in them: a fan for each frame.

    Attributes:
        pos: Origins [m] (..., fans, 3).
        mat: Orientations (..., fans, 3, 3).
        directions: Unit vectors in the frames (fans, lines, 3).
    """

    pos: Array
    mat: Array
    directions: np.ndarray

    def rays(self) -> tuple[Array, Array]:
        """Return starts [m] and unit vectors in world axes, fan by fan, both (..., rays, 3)."""
        if on_numpy():  # a matrix product for each fan
            along = self.directions @ self.mat.mT
        else:
            along = matvec(self.mat[..., None, :, :], self.directions)
        start, flat = xp.broadcast_to(self.pos[..., None, :], along.shape), (*along.shape[:-3], -1, 3)
        return start.reshape(flat), along.reshape(flat)


class Cone(NamedTuple):
    """A cone about a bundle's rays; components as in `kernels.XYZ`.

    Attributes:
        tip: Middle of the rays' starts [m].
        axis: Unit vector.
        tip_radius: How far from the tip rays start [m] (...,).
        slope: Tangent of the half angle (...,); negative: it is too wide to leave anything out.
    """

    tip: XYZ
    axis: XYZ
    tip_radius: jax.Array
    slope: jax.Array


def bundled(values: jax.Array, size: int) -> jax.Array:
    """Return numbers of rays (..., rays) in bundles (..., bundles, size); the last one fills the last."""
    missing = (*values.shape[:-1], -values.shape[-1] % size)
    whole = jnp.concatenate([values, jnp.broadcast_to(values[..., -1:], missing)], -1)
    return whole.reshape(*values.shape[:-1], -1, size)


def bounding_cones(start: XYZ, along: XYZ) -> Cone:
    """Return the cones about bundles of rays (..., size), components (...)."""
    tip, axis = ([x.mean(-1) for x in vector] for vector in (start, along))
    length = jnp.maximum(jnp.sqrt(sum(x * x for x in axis)), TINY)
    axis = [x / length for x in axis]
    turned = [way * x[..., None] for way, x in zip(along, axis, strict=True)]
    cosine: jax.Array = jnp.min(turned[0] + turned[1] + turned[2], -1)
    slope = jnp.sqrt(jnp.maximum(1 - cosine**2, 0.0)) / jnp.maximum(cosine, MIN_COSINE) + MIN_SLOPE
    away = sum((at - x[..., None]) ** 2 for at, x in zip(start, tip, strict=True))
    thick = jnp.sqrt(away).max(-1) + CONE_MARGIN
    return Cone(tip, axis, thick, jnp.where(cosine < MIN_COSINE, -1.0, slope))


def cone_box_distance(
    kind: int, size: XYZ, tip: XYZ, axis: XYZ, tip_radius: jax.Array, slope: jax.Array
) -> jax.Array:
    """Return how far along its axis a cone meets the box about a geom, infinite for a miss [m] (...).

    No ray of the bundle meets the geom any nearer. The box grows along the axis as the cone does, which
    makes the slab test of a ray one of a cone; that says too much, never too little.

    Args:
        kind: Of geom.
        size: Its size numbers [m].
        tip: The cone's, in the geom's frame [m].
        axis: The cone's, in the geom's frame.
        tip_radius: See `Cone` [m].
        slope: See `Cone`.
    """
    middle, half = bounding_box(kind, size)
    near, far = 0.0 * tip_radius, jnp.inf
    for i, (at, along) in enumerate(zip(tip, axis, strict=True)):
        offset, room = at if middle is None else at - middle[i], half[i] + tip_radius
        position, speed = jnp.where(along >= 0, offset, -offset), jnp.abs(along)
        # In at one side, where the cone's wall closes in on it; out at the other, if the cone is that narrow.
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
    """As `cone_box_distance`, for the bounding sphere: too much of what is long, at a quarter of the work.

    Args:
        offset: From the cone's tip to the middle of the sphere [m].
        axis: The cone's; both in any axes.
        radius: Of the sphere [m].
        tip_radius: See `Cone` [m].
        slope: See `Cone`.
    """
    far = offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2]
    along = offset[0] * axis[0] + offset[1] * axis[1] + offset[2] * axis[2]
    reach = radius + tip_radius
    width = reach + slope * (along + radius)
    inside = (far - along * along <= width * width) & (along > -reach)
    near = jnp.maximum(jnp.sqrt(far) - reach, 0.0)
    return jnp.where(inside | (slope < 0), near, jnp.inf)
