"""Rotations of JAX arrays: quaternions (w first), matrices and rotation vectors."""

from types import ModuleType

import jax
import jax.numpy as jnp

from usarmjx.base.arrays import Array

MIN_NORM = 1e-9
"""Below this a rotation vector counts as zero [rad]; float32 cannot tell the difference."""


def mat_from_quat(quat: Array) -> jax.Array:
    """Return the rotation matrix (..., 3, 3) of w-first quaternions (..., 4), normalised first."""
    w, x, y, z = jnp.moveaxis(quat / jnp.linalg.norm(quat, axis=-1, keepdims=True), -1, 0)
    rows = (
        jnp.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
        jnp.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
        jnp.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
    )
    return jnp.stack(rows, -2)


def wrap_angle(angle: Array, xp: ModuleType = jnp) -> Array:
    """Return the angle in [-pi, pi) [rad] (...), of either array module."""
    return xp.mod(angle + xp.pi, 2 * xp.pi) - xp.pi


def matvec(mat: jax.Array, vector: Array) -> jax.Array:
    """Return `mat @ vector`, (..., 3, 3) and (..., 3), as sums of products.

    Unlike thousands of small matrix products, these melt into what is computed before and after them, and
    keep all their bits on a GPU.
    """
    return mat[..., 0] * vector[..., 0:1] + mat[..., 1] * vector[..., 1:2] + mat[..., 2] * vector[..., 2:3]


def matmul(mat: jax.Array, other: Array) -> jax.Array:
    """Return `mat @ other`, both (..., 3, 3), as `matvec` does."""
    return jnp.stack([matvec(mat, other[..., i]) for i in range(3)], -1)


def rotation_vector(mat: jax.Array) -> jax.Array:
    """Return the rotation vector (axis times angle) [rad] (3,) of a rotation matrix (3, 3).

    Exact for turns below half a turn; a simulation step turns by far less.
    """
    skew = jnp.array([mat[2, 1] - mat[1, 2], mat[0, 2] - mat[2, 0], mat[1, 0] - mat[0, 1]]) / 2
    sine = jnp.linalg.norm(skew)
    angle = jnp.arctan2(sine, (jnp.trace(mat) - 1) / 2)
    return skew * jnp.where(sine > MIN_NORM, angle / jnp.maximum(sine, MIN_NORM), 1.0)


def mat_from_rotation_vector(vector: jax.Array) -> jax.Array:
    """Return the rotation matrix (3, 3) of a rotation vector [rad] (3,): Rodrigues' formula."""
    angle = jnp.linalg.norm(vector)
    x, y, z = vector / jnp.maximum(angle, MIN_NORM)
    zero = jnp.zeros_like(x)
    skew = jnp.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]])
    return jnp.eye(3) + jnp.sin(angle) * skew + (1 - jnp.cos(angle)) * (skew @ skew)
