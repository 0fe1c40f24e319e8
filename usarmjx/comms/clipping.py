"""Segment clipping at solids that consist of pieces: convex meshes and terrain.

As in `walls`, a segment is its midpoint and half vector: the point at parameter t in [-1, 1] is middle + t
half. An interval is its first and last parameter, and empty if the first exceeds the last. A convex mesh is
the intersection of the half spaces behind its triangles; a terrain is the union of its columns.
"""

from functools import reduce
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.backend import Array, on_numpy, xp
from usarmjx.models.compile.ray_geoms import COLUMN_KIND, TRIANGLE_KIND
from usarmjx.sensors.rays.targets import GeomBlock

XYZ = tuple[Array, Array, Array]
"""Components x, y, z as separate arrays, so that no array of segments times geoms is stored."""
SegmentInterval = tuple[Array, Array]
"""First and last parameter of a part of a segment."""

PIECE_KINDS = (TRIANGLE_KIND, COLUMN_KIND)
"""Kinds of pieces."""
PIECES_PER_PASS = 16
"""Pieces per pass over all segments."""
SIDE_MARGIN = 1e-5
"""Relative widening of a column's sides, so that no segment passes between two columns."""


def positive_interval(start: Array, slope: Array) -> SegmentInterval:
    """Return the interval of a segment on which `start + t slope` is positive."""
    # The quotient of a constant is not used; dividing by 0 would put NaN into gradients.
    t = -start / xp.where(slope == 0, 1.0, slope)
    # Constant and not positive: an empty interval, whose first parameter exceeds the last.
    outside = (slope == 0) & (start <= 0)
    low = xp.where(outside, 1.0, xp.where(slope > 0, xp.maximum(t, -1.0), -1.0))
    high = xp.where(outside, -1.0, xp.where(slope < 0, xp.minimum(t, 1.0), 1.0))
    return low, high


def intersection(one: SegmentInterval, other: SegmentInterval) -> SegmentInterval:
    """Return the intersection of two intervals."""
    return xp.maximum(one[0], other[0]), xp.minimum(one[1], other[1])


def behind_face(middle: XYZ, half: XYZ) -> SegmentInterval:
    """Return the interval of a segment below z = 0: behind a face of a convex solid, in the face's frame."""
    # Normals of faces point outward, along z.
    return positive_interval(-middle[2], -half[2])


def crosses_column(middle: XYZ, half: XYZ, size: XYZ) -> Array:
    """Return whether a segment crosses the interior of a terrain column; see `ray_geoms.terrain_columns`."""
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
    # Less and not equal: a segment that only touches the column crosses nothing.
    return low < high


def pad_to_chunks(block: GeomBlock) -> GeomBlock:
    """Pad the pieces of each solid to whole chunks with copies of its last piece.

    Args:
        block: Pieces; those of one solid are adjacent and have the same owner. NumPy arrays.
    """
    owner = np.asarray(block.owner)
    ends = np.append(np.flatnonzero(np.diff(owner)) + 1, len(owner))
    runs = np.split(np.arange(len(owner)), ends[:-1])
    # Copies change neither the intersection of half spaces nor the union of columns.
    rows = np.concatenate([np.append(run, np.repeat(run[-1], -len(run) % PIECES_PER_PASS)) for run in runs])
    return jax.tree.map(lambda x: x[rows], block)


def components(vectors: Array) -> XYZ:
    """Return the components of vectors (n, 3) as rows (n, 1)."""
    return vectors[:, 0, None], vectors[:, 1, None], vectors[:, 2, None]


def local_segments(block: GeomBlock, middle: XYZ, half: XYZ) -> tuple[XYZ, XYZ]:
    """Return segments in the frames of geoms: midpoints and half vectors [m] (geoms, segments) each.

    Args:
        block: The geoms.
        middle: Midpoints of the segments [m] (segments,) each.
        half: Half vectors of the segments [m] (segments,) each.
    """
    # Sums of products instead of matrix products: they fuse, and avoid TensorFloat-32 on a GPU.
    offset = [part - pos for part, pos in zip(middle, components(block.pos), strict=True)]
    mat = block.mat[..., None]
    local = tuple(sum(mat[:, j, i] * offset[j] for j in range(3)) for i in range(3))
    along = tuple(sum(mat[:, j, i] * half[j] for j in range(3)) for i in range(3))
    return local, along  # type: ignore - three components each


def count_in_pieces(kind: int, block: GeomBlock, middle: XYZ, half: XYZ) -> Array:
    """Return the number of solids of one kind that each segment crosses (segments,).

    Args:
        kind: One of `PIECE_KINDS`.
        block: Pieces from `pad_to_chunks`.
        middle: Midpoints of the segments [m] (segments,) each.
        half: Half vectors of the segments [m] (segments,) each.
    """
    return (_count_at_once if on_numpy() else _count_in_passes)(kind, block, middle, half)


def _count_at_once(kind: int, block: GeomBlock, middle: XYZ, half: XYZ) -> Array:
    """As `_count_in_passes`, all pieces of a solid at once: few calls, for NumPy."""
    owner, count = np.asarray(block.owner), np.zeros(half[0].shape, np.int32)
    bounds = [0, *(np.flatnonzero(np.diff(owner)) + 1), len(owner)]
    for first, last in pairwise(bounds):
        solid = jax.tree.map(lambda x, own=slice(first, last): x[own], block)
        local, along = local_segments(solid, middle, half)
        if kind == TRIANGLE_KIND:
            low, high = behind_face(local, along)
            # A convex solid is the intersection of half spaces: the segment crosses it where all intervals
            # meet.
            count += low.max(0) < high.min(0)
        else:
            count[_crosses_columns(local, along, solid.size)] += 1
    return count


def _crosses_columns(local: XYZ, along: XYZ, size: Array) -> np.ndarray:
    """Return which segments cross any column (segments,); only columns near a segment are tested."""
    # NumPy computes everything that it is given: sorting far columns out pays there, in one pass.
    (x, y, _), (dx, dy, _) = local, along
    reach = (x + np.abs(dx) > -SIDE_MARGIN) & (y + np.abs(dy) > -SIDE_MARGIN)
    column, segment = np.nonzero(reach & (x + y - np.abs(dx + dy) < 1 + SIDE_MARGIN))
    near = [tuple(part[column, segment] for part in parts) for parts in (local, along)]
    met = crosses_column(*near, tuple(size[column].T))  # type: ignore - three components each
    crossed = np.zeros(x.shape[1], bool)
    crossed[segment[met]] = True
    return crossed


def _count_in_passes(kind: int, block: GeomBlock, middle: XYZ, half: XYZ) -> Array:
    """Return the number of solids that each segment crosses, a few pieces per pass, on JAX."""
    rows: GeomBlock = jax.tree.map(lambda x: jnp.asarray(x).reshape(-1, PIECES_PER_PASS, *x.shape[1:]), block)
    # A solid spans several chunks: its interval or flag is carried along, and counted at its last chunk.
    last = jnp.append(rows.owner[1:, 0] != rows.owner[:-1, 0], True)
    mesh = kind == TRIANGLE_KIND
    fresh = (-jnp.ones_like(half[0]), jnp.ones_like(half[0])) if mesh else (jnp.zeros(half[0].shape, bool),)

    def chunk(c: Array, tally: tuple[Array, ...]) -> tuple[Array, ...]:
        count, *so_far = tally
        pieces = jax.tree.map(lambda x: x[c], rows)
        local, along = local_segments(pieces, middle, half)
        if mesh:
            low, high = behind_face(local, along)
            now = intersection((so_far[0], so_far[1]), (low.max(0), high.min(0)))
            crossed = now[0] < now[1]
        else:
            crossed = so_far[0] | crosses_column(local, along, components(pieces.size)).any(0)
            now = (crossed,)
        kept = (jnp.where(last[c], new, old) for new, old in zip(fresh, now, strict=True))
        return (count + (crossed & last[c]), *kept)

    start = (jnp.zeros(half[0].shape, jnp.int32), *fresh)
    # A loop, so that no array of segments times all pieces is stored.
    return jax.lax.fori_loop(0, len(rows.owner), chunk, start)[0]
