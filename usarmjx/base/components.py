"""Vectors, quaternions and matrices as tuples of their numbers, each an array of its own.

So written, a chain of rotations is sums and products all through, which XLA makes a kernel or two of on a
GPU: each stack of numbers, as of a cross product, would end one. Numbers may be of NumPy or of JAX.
"""

from collections.abc import Sequence
from typing import TypeAlias

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp

Numbers: TypeAlias = tuple[Array, ...]
"""Of a vector (3) or a quaternion, w first (4)."""
Rows: TypeAlias = tuple[Numbers, ...]
"""Of a matrix."""


def parts(vectors: Array) -> Numbers:
    """Return the numbers of vectors (..., n)."""
    return tuple(vectors[..., i] for i in range(vectors.shape[-1]))


def matrix_rows(mat: Array) -> Rows:
    """Return the numbers of matrices (..., n, m), row by row."""
    return tuple(tuple(mat[..., i, j] for j in range(mat.shape[-1])) for i in range(mat.shape[-2]))


def plus(one: Sequence[Array], other: Sequence[Array]) -> Numbers:
    """Return sums."""
    return tuple(a + b for a, b in zip(one, other, strict=True))


def minus(one: Sequence[Array], other: Sequence[Array]) -> Numbers:
    """Return differences."""
    return tuple(a - b for a, b in zip(one, other, strict=True))


def times(one: Sequence[Array], factor: Array | float) -> Numbers:
    """Return products with a number."""
    return tuple(a * factor for a in one)


def dot(one: Sequence[Array], other: Sequence[Array]) -> Array:
    """Return products of vectors, summed."""
    first, *more = (a * b for a, b in zip(one, other, strict=True))
    for product in more:
        first = first + product
    return first


def cross(one: Sequence[Array], other: Sequence[Array]) -> Numbers:
    """Return products that are vectors at right angles to both."""
    (a, b, c), (x, y, z) = one, other
    return b * z - c * y, c * x - a * z, a * y - b * x


def apply(mat: Rows, vector: Sequence[Array]) -> Numbers:
    """Return a matrix times a vector."""
    return tuple(dot(row, vector) for row in mat)


def transposed(mat: Rows) -> Rows:
    """Return rows and columns exchanged."""
    return tuple(zip(*mat, strict=True))


def rotation(quat: Sequence[Array]) -> Rows:
    """Return the matrix of a quaternion, normalised first, as `rotations.mat_from_quat` does."""
    size = xp.sqrt(dot(quat, quat))
    w, x, y, z = (number / size for number in quat)
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def quat_times(one: Sequence[Array], other: Sequence[Array]) -> Numbers:
    """Return the product of two quaternions."""
    (w, *axis), (v, *along) = one, other
    return w * v - dot(axis, along), *plus(plus(times(along, w), times(axis, v)), cross(axis, along))


def rotated(quat: Sequence[Array], vector: Sequence[Array]) -> Numbers:
    """Return a vector turned by a unit quaternion."""
    w, *axis = quat
    return plus(vector, times(cross(axis, plus(cross(axis, vector), times(vector, w))), 2))
