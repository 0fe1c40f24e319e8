"""Rotations: quaternions (w first), matrices and rotation vectors."""

from usarmjx.base.arrays import Array
from usarmjx.base.backend import on_numpy, xp

MIN_NORM = 1e-9
"""Below this a rotation vector counts as zero [rad]; float32 cannot tell the difference."""


def mat_from_quat(quat: Array) -> Array:
    """Return the rotation matrix (..., 3, 3) of w-first quaternions (..., 4), normalised first."""
    unit = quat / xp.sqrt((quat * quat).sum(-1, keepdims=True))
    w, x, y, z = (unit[..., i] for i in range(4))
    rows = (
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return xp.stack(rows, -1).reshape(*quat.shape[:-1], 3, 3)


def quat_from_mat(mat: Array) -> Array:
    """Return unit quaternions (..., 4), w first, of rotation matrices (..., 3, 3)."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = ([mat[..., i, j] for j in range(3)] for i in range(3))
    # Four times the products of the components with each other: the row of the largest is the most exact.
    products = (
        *(1 + xx + yy + zz, zy - yz, xz - zx, yx - xy),
        *(zy - yz, 1 + xx - yy - zz, xy + yx, xz + zx),
        *(xz - zx, xy + yx, 1 - xx + yy - zz, yz + zy),
        *(yx - xy, xz + zx, yz + zy, 1 - xx - yy + zz),
    )
    rows = xp.stack(products, -1).reshape(*mat.shape[:-2], 4, 4)
    squares = xp.stack(products[::5], -1)
    row = xp.take_along_axis(rows, xp.argmax(squares, -1)[..., None, None], -2)[..., 0, :]
    return row / xp.sqrt((row * row).sum(-1, keepdims=True))


def wrap_angle(angle: Array) -> Array:
    """Return the angle in [-pi, pi) [rad] (...)."""
    return xp.mod(angle + xp.pi, 2 * xp.pi) - xp.pi


def matvec(mat: Array, vector: Array) -> Array:
    """Return `mat @ vector`, (..., 3, 3) and (..., 3), as sums of products.

    Unlike thousands of small matrix products, these melt into what is computed before and after them, and
    keep all their bits on a GPU. On NumPy they are one call.
    """
    if on_numpy():
        return (mat @ vector[..., None])[..., 0]
    return mat[..., 0] * vector[..., 0:1] + mat[..., 1] * vector[..., 1:2] + mat[..., 2] * vector[..., 2:3]


def matmul(mat: Array, other: Array) -> Array:
    """Return `mat @ other`, both (..., 3, 3), as `matvec` does."""
    if on_numpy():
        return mat @ other
    return xp.stack([matvec(mat, other[..., i]) for i in range(3)], -1)


def rotation_vector(mat: Array) -> Array:
    """Return the rotation vector (axis times angle) [rad] (..., 3) of a rotation matrix (..., 3, 3).

    Exact for turns below half a turn; a simulation step turns by far less.
    """
    pairs = ((2, 1), (0, 2), (1, 0))
    skew = xp.stack([mat[..., i, j] - mat[..., j, i] for i, j in pairs], -1) / 2
    sine = xp.linalg.norm(skew, axis=-1)
    angle = xp.arctan2(sine, (xp.trace(mat, axis1=-2, axis2=-1) - 1) / 2)
    return skew * xp.where(sine > MIN_NORM, angle / xp.maximum(sine, MIN_NORM), 1.0)[..., None]


def mat_from_rotation_vector(vector: Array) -> Array:
    """Return the rotation matrix (..., 3, 3) of a rotation vector [rad] (..., 3): Rodrigues' formula."""
    angle = xp.linalg.norm(vector, axis=-1, keepdims=True)
    unit = vector / xp.maximum(angle, MIN_NORM)
    x, y, z = (unit[..., i] for i in range(3))
    zero, angle = xp.zeros_like(x), angle[..., None]
    skew = xp.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*zero.shape, 3, 3)
    return xp.eye(3) + xp.sin(angle) * skew + (1 - xp.cos(angle)) * matmul(skew, skew)
