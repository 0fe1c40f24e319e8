"""Walls that come in pieces, meshes and terrain: which part of a segment lies inside of them.

Segments are seen by their middle and half vector, as in `walls`: the place at share t, from -1 to 1, is
middle + t half. Parts are given as the first and the last share, and are empty if these are not in order.
A convex mesh is what lies behind all its triangles; a terrain is all of its columns.
"""

from functools import reduce

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.models.build.pieces import COLUMN_KIND, TRIANGLE_KIND
from usarmjx.sensors.rays.targets import GeomBlock

XYZ = tuple[jax.Array, jax.Array, jax.Array]
"""Components x, y, z; apart, so that no array of segments times geoms is stored."""
SegmentInterval = tuple[jax.Array, jax.Array]

PIECE_KINDS = (TRIANGLE_KIND, COLUMN_KIND)
"""Kinds of pieces that solids come in."""
PIECES_PER_PASS = 16
"""Pieces that one pass over all segments looks at."""
SIDE_MARGIN = 1e-5
"""By this share of its width a column reaches over its sides: no segment slips through where two meet."""


def positive_interval(start: jax.Array, slope: jax.Array) -> SegmentInterval:
    """Return the part of a segment where `start + t slope` is positive."""
    t = -start / jnp.where(slope == 0, 1.0, slope)
    outside = (slope == 0) & (start <= 0)
    low = jnp.where(outside, 1.0, jnp.where(slope > 0, jnp.maximum(t, -1.0), -1.0))
    high = jnp.where(outside, -1.0, jnp.where(slope < 0, jnp.minimum(t, 1.0), 1.0))
    return low, high


def intersection(one: SegmentInterval, other: SegmentInterval) -> SegmentInterval:
    """Return what is in two parts."""
    return jnp.maximum(one[0], other[0]), jnp.minimum(one[1], other[1])


def behind_face(middle: XYZ, half: XYZ) -> SegmentInterval:
    """Return the part of a segment below z = 0: of a convex solid one of whose faces is a triangle."""
    return positive_interval(-middle[2], -half[2])


def crosses_column(middle: XYZ, half: XYZ, size: XYZ) -> jax.Array:
    """Whether a segment meets the inside of a column of terrain; see `pieces.terrain_columns`."""
    (x, y, z), (dx, dy, dz) = middle, half
    above_bottom = positive_interval(
        z + size[0] * x + size[1] * y + size[2], dz + size[0] * dx + size[1] * dy
    )
    sides = (
        positive_interval(x + SIDE_MARGIN, dx),
        positive_interval(y + SIDE_MARGIN, dy),
        positive_interval(1 + SIDE_MARGIN - x - y, -dx - dy),
    )
    low, high = reduce(intersection, (*sides, positive_interval(-z, -dz), above_bottom))
    return low < high


def padded_to_chunks(block: GeomBlock) -> GeomBlock:
    """Return pieces of solids, those of each followed by copies of its last one up to whole chunks.

    Args:
        block: Pieces; those of one solid follow one another and have the same owner. Numpy arrays.
    """
    owner = np.asarray(block.owner)
    ends = np.append(np.flatnonzero(np.diff(owner)) + 1, len(owner))
    runs = np.split(np.arange(len(owner)), ends[:-1])
    rows = np.concatenate([np.append(run, np.repeat(run[-1], -len(run) % PIECES_PER_PASS)) for run in runs])
    return jax.tree.map(lambda x: x[rows], block)


def count_in_pieces(kind: int, block: GeomBlock, middle: XYZ, half: XYZ) -> jax.Array:
    """Return how many solids of one kind each segment crosses (segments,).

    Args:
        kind: One of `PIECE_KINDS`.
        block: Pieces as `padded_to_chunks` returns them.
        middle: Middles of the segments [m] (segments,) each.
        half: Half vectors from there to their ends [m] (segments,) each.
    """
    arrays = map(jnp.asarray, (block.pos, block.mat, block.size, block.owner))
    pos, mat, size, owner = (x.reshape(-1, PIECES_PER_PASS, *x.shape[1:]) for x in arrays)
    last = jnp.append(owner[1:, 0] != owner[:-1, 0], True)
    mesh = kind == TRIANGLE_KIND
    fresh = (-jnp.ones_like(half[0]), jnp.ones_like(half[0])) if mesh else (jnp.zeros(half[0].shape, bool),)

    def chunk(c: jax.Array, tally: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
        count, *so_far = tally
        # Pieces by rows, segments by columns; sums of products, not matrix products, as in `walls`.
        offset = [middle[j] - pos[c, :, j, None] for j in range(3)]
        local = tuple(sum(mat[c, :, j, i, None] * offset[j] for j in range(3)) for i in range(3))
        along = tuple(sum(mat[c, :, j, i, None] * half[j] for j in range(3)) for i in range(3))
        if mesh:
            low, high = behind_face(local, along)  # type: ignore - three components each
            now = intersection((so_far[0], so_far[1]), (low.max(0), high.min(0)))
            crossed = now[0] < now[1]
        else:
            sizes = tuple(size[c, :, i, None] for i in range(3))
            crossed = so_far[0] | crosses_column(local, along, sizes).any(0)  # type: ignore - as above
            now = (crossed,)
        kept = (jnp.where(last[c], new, old) for new, old in zip(fresh, now, strict=True))
        return (count + (crossed & last[c]), *kept)

    start = (jnp.zeros(half[0].shape, jnp.int32), *fresh)
    return jax.lax.fori_loop(0, len(owner), chunk, start)[0]
