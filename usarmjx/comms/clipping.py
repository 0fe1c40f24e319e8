"""Which part of a segment lies inside a convex solid: it is cut at one plane after the other.

Segments are seen by their middle and half vector, as in `walls`: the place at share t, from -1 to 1, is
middle + t half. Parts are given as the first and the last share, and are empty if these are not in order.
"""

from functools import reduce

import jax
import jax.numpy as jnp

Triple = tuple[jax.Array, jax.Array, jax.Array]
"""Components x, y, z; apart, so that no array of segments times geoms is stored."""
Part = tuple[jax.Array, jax.Array]

SEAM = 1e-5
"""By this share of its width a column reaches over its sides: no segment slips through where two meet."""


def positive(start: jax.Array, slope: jax.Array) -> Part:
    """Return the part of a segment where `start + t slope` is positive."""
    t = -start / jnp.where(slope == 0, 1.0, slope)
    outside = (slope == 0) & (start <= 0)
    low = jnp.where(outside, 1.0, jnp.where(slope > 0, jnp.maximum(t, -1.0), -1.0))
    high = jnp.where(outside, -1.0, jnp.where(slope < 0, jnp.minimum(t, 1.0), 1.0))
    return low, high


def both(one: Part, other: Part) -> Part:
    """Return what is in two parts."""
    return jnp.maximum(one[0], other[0]), jnp.minimum(one[1], other[1])


def behind_face(middle: Triple, half: Triple) -> Part:
    """Return the part of a segment below z = 0: of a convex solid one of whose faces is a triangle."""
    return positive(-middle[2], -half[2])


def crosses_column(middle: Triple, half: Triple, size: Triple) -> jax.Array:
    """Whether a segment meets the inside of a column of terrain; see `pieces.columns_of`."""
    (x, y, z), (dx, dy, dz) = middle, half
    above_bottom = positive(z + size[0] * x + size[1] * y + size[2], dz + size[0] * dx + size[1] * dy)
    sides = (positive(x + SEAM, dx), positive(y + SEAM, dy), positive(1 + SEAM - x - y, -dx - dy))
    low, high = reduce(both, (*sides, positive(-z, -dz), above_bottom))
    return low < high
