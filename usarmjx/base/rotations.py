"""Rotations: quaternions (w first), matrices and rotation vectors.

Two forms of the same operations: functions of arrays whose last axes are the components, and, below,
functions of tuples of components. Tuples let XLA keep each component in a register: no array of vectors is
stored between two operations.
"""

from collections.abc import Sequence
from typing import TypeAlias

import jax
import jax.numpy as jnp

from usarmjx.base.backend import Array, on_numpy, xp

Components: TypeAlias = tuple[Array, ...]
"""Components of a vector (3) or of a quaternion, w first (4)."""
MatrixRows: TypeAlias = tuple[Components, ...]
"""Rows of a matrix."""
MIN_NORM = 1e-9
"""Norm below which a rotation vector counts as zero [rad]; float32 cannot resolve it."""


def mat_from_quat(quat: Array) -> Array:
    """Return the rotation matrix (..., 3, 3) of w-first quaternions (..., 4), normalised first."""
    unit = quat / xp.sqrt((quat * quat).sum(-1, keepdims=True))
    w, x, y, z = parts(unit)
    rows = (
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return xp.stack(rows, -1).reshape(*quat.shape[:-1], 3, 3)


def up_from_quat(quat: Array) -> Array:
    """Return the z axis of frames (..., 3): the last column of `mat_from_quat`, without the others."""
    w, x, y, z = parts(quat / xp.sqrt((quat * quat).sum(-1, keepdims=True)))
    return xp.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], -1)


def quat_from_mat(mat: Array) -> Array:
    """Return unit quaternions (..., 4), w first, of rotation matrices (..., 3, 3)."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = ([mat[..., i, j] for j in range(3)] for i in range(3))
    # Four times the products of the quaternion's components: the row of the largest square is most accurate.
    products = (
        *(1 + xx + yy + zz, zy - yz, xz - zx, yx - xy),
        *(zy - yz, 1 + xx - yy - zz, xy + yx, xz + zx),
        *(xz - zx, xy + yx, 1 - xx + yy - zz, yz + zy),
        *(yx - xy, xz + zx, yz + zy, 1 - xx - yy + zz),
    )
    rows = xp.stack(products, -1).reshape(*mat.shape[:-2], 4, 4)
    # The diagonal of the table of four rows.
    squares = xp.stack(products[::5], -1)
    row = xp.take_along_axis(rows, xp.argmax(squares, -1)[..., None, None], -2)[..., 0, :]
    # The length is twice the largest component, whatever the row.
    return row / xp.sqrt((row * row).sum(-1, keepdims=True))


def wrap_angle(angle: Array) -> Array:
    """Return the angle in [-pi, pi) [rad] (...)."""
    return xp.mod(angle + xp.pi, 2 * xp.pi) - xp.pi


def matvec(mat: Array, vector: Array) -> Array:
    """Return `mat @ vector`, (..., 3, 3) and (..., 3), as sums of products.

    Unlike thousands of small matrix products, sums fuse with the operations around them and keep full
    precision on a GPU (no TensorFloat-32). On NumPy this is one call.
    """
    if on_numpy():
        return (mat @ vector[..., None])[..., 0]
    # A split is one operation to trace, three slices are three.
    if isinstance(vector, jax.Array):
        x, y, z = jax.lax.split(vector, (1, 1, 1), vector.ndim - 1)
    else:
        x, y, z = vector[..., 0:1], vector[..., 1:2], vector[..., 2:3]
    first, second, third = parts(mat)
    return first * x + second * y + third * z


def matmul(mat: Array, other: Array) -> Array:
    """Return `mat @ other`, both (..., 3, 3), as `matvec` does."""
    if on_numpy():
        return mat @ other
    return xp.stack([matvec(mat, other[..., i]) for i in range(3)], -1)


def rotation_vector(mat: Array) -> Array:
    """Return the rotation vector (axis times angle) [rad] (..., 3) of a rotation matrix (..., 3, 3).

    Exact for angles below pi; a simulation step rotates by far less.
    """
    # The antisymmetric part is sin(angle) times the axis; atan2 stays accurate at all angles below pi.
    pairs = ((2, 1), (0, 2), (1, 0))
    skew = xp.stack([mat[..., i, j] - mat[..., j, i] for i, j in pairs], -1) / 2
    sine = xp.linalg.norm(skew, axis=-1)
    angle = xp.arctan2(sine, (xp.trace(mat, axis1=-2, axis2=-1) - 1) / 2)
    # For small angles angle / sine is 1.
    return skew * xp.where(sine > MIN_NORM, angle / xp.maximum(sine, MIN_NORM), 1.0)[..., None]


def mat_from_rotation_vector(vector: Array) -> Array:
    """Return the rotation matrix (..., 3, 3) of a rotation vector [rad] (..., 3): Rodrigues' formula."""
    angle = xp.linalg.norm(vector, axis=-1, keepdims=True)
    # The zero vector has no axis: with a sine of 0 any will do.
    unit = vector / xp.maximum(angle, MIN_NORM)
    x, y, z = (unit[..., i] for i in range(3))
    zero, angle = xp.zeros_like(x), angle[..., None]
    skew = xp.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*zero.shape, 3, 3)
    return xp.eye(3) + xp.sin(angle) * skew + (1 - xp.cos(angle)) * matmul(skew, skew)


def parts(vectors: Array) -> Components:
    """Return the components of vectors (..., n), or the columns of matrices."""
    # One operation to trace, in less than half the time of indexing; constants stay NumPy's.
    if isinstance(vectors, jax.Array):
        return tuple(jnp.unstack(vectors, axis=-1))
    return tuple(vectors[..., i] for i in range(vectors.shape[-1]))


def matrix_rows(mat: Array) -> MatrixRows:
    """Return the components of matrices (..., n, m), row by row."""
    return tuple(tuple(mat[..., i, j] for j in range(mat.shape[-1])) for i in range(mat.shape[-2]))


def plus(one: Sequence[Array], other: Sequence[Array]) -> Components:
    """Return the sum of two vectors."""
    return tuple(a + b for a, b in zip(one, other, strict=True))


def minus(one: Sequence[Array], other: Sequence[Array]) -> Components:
    """Return the difference of two vectors."""
    return tuple(a - b for a, b in zip(one, other, strict=True))


def times(one: Sequence[Array], factor: Array | float) -> Components:
    """Return a vector times a number."""
    return tuple(a * factor for a in one)


def dot(one: Sequence[Array], other: Sequence[Array]) -> Array:
    """Return the scalar product of two vectors."""
    # Not the built-in sum: its 0 at the start would be one more operation to trace.
    first, *more = (a * b for a, b in zip(one, other, strict=True))
    for product in more:
        first = first + product
    return first


def cross(one: Sequence[Array], other: Sequence[Array]) -> Components:
    """Return the cross product of two vectors."""
    (a, b, c), (x, y, z) = one, other
    return b * z - c * y, c * x - a * z, a * y - b * x


def apply(mat: MatrixRows, vector: Sequence[Array]) -> Components:
    """Return a matrix times a vector."""
    return tuple(dot(row, vector) for row in mat)


def transposed(mat: MatrixRows) -> MatrixRows:
    """Return the transpose of a matrix."""
    return tuple(zip(*mat, strict=True))


def rotation(quat: Sequence[Array]) -> MatrixRows:
    """Return the matrix of a quaternion, normalised first, as `mat_from_quat` does."""
    size = xp.sqrt(dot(quat, quat))
    w, x, y, z = (number / size for number in quat)
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def quat_times(one: Sequence[Array], other: Sequence[Array]) -> Components:
    """Return the product of two quaternions."""
    (w, *axis), (v, *along) = one, other
    return w * v - dot(axis, along), *plus(plus(times(along, w), times(axis, v)), cross(axis, along))


def rotated(quat: Sequence[Array], vector: Sequence[Array]) -> Components:
    """Return a vector rotated by a unit quaternion."""
    w, *axis = quat
    # v + 2 q x (q x v + w v): fewer products than two multiplications of quaternions.
    return plus(vector, times(cross(axis, plus(cross(axis, vector), times(vector, w))), 2))
