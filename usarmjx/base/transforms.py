"""Conversion between USARSim's and MuJoCo's axes, and rotation matrices of angles.

Inside usarmjx all axes are MuJoCo's: x forward, y left, z up, right-handed, quaternions with w first. USARSim
uses SAE J670 (manual 6.1): x forward, y right, z down, yaw clockwise seen from above. The two differ by a
rotation of pi about x: a vector changes the signs of y and z, and of the angles roll, pitch, yaw (applied as
yaw, then pitch, then roll: ZYX, manual 9.3) pitch and yaw change sign.

The functions accept NumPy and JAX arrays: `xp` is the array module.
"""

from __future__ import annotations

from types import ModuleType
from typing import TYPE_CHECKING, overload

import numpy as np

if TYPE_CHECKING:
    # Not while running: the protocol modules use this one and know no JAX.
    from usarmjx.base.backend import Array, ArrayLike

Vec3 = tuple[float, float, float]
GRAVITY = 9.81
"""Gravity, MuJoCo's default [m/s2]."""
GIMBAL_LOCK_COS = 1e-5
"""Cosine of the pitch below which single precision cannot separate roll from yaw."""


def flip_vector(vector: Vec3) -> Vec3:
    """Convert a vector [m] between USARSim's and MuJoCo's axes, in either direction."""
    x, y, z = vector
    return (x, -y, -z)


def flip_angles(angles: Vec3) -> Vec3:
    """Convert (roll, pitch, yaw) [rad] between USARSim's and MuJoCo's axes, in either direction."""
    roll, pitch, yaw = angles
    return (roll, -pitch, -yaw)


@overload
def mat_from_angles(roll: ArrayLike, pitch: ArrayLike, yaw: ArrayLike) -> np.ndarray: ...
@overload
def mat_from_angles(roll: ArrayLike, pitch: ArrayLike, yaw: ArrayLike, xp: ModuleType) -> Array: ...
def mat_from_angles(roll: ArrayLike, pitch: ArrayLike, yaw: ArrayLike, xp: ModuleType = np) -> Array:
    """Return the rotation matrix of ZYX angles [rad] (...,) as (..., 3, 3)."""
    cr, sr, cp, sp = xp.cos(roll), xp.sin(roll), xp.cos(pitch), xp.sin(pitch)
    cy, sy = xp.cos(yaw), xp.sin(yaw)
    rows = (
        xp.stack([cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr], -1),
        xp.stack([sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr], -1),
        xp.stack([-sp, cp * sr, cp * cr], -1),
    )
    return xp.stack(rows, -2)


@overload
def angles_from_mat(mat: Array) -> np.ndarray: ...
@overload
def angles_from_mat(mat: Array, xp: ModuleType) -> Array: ...
def angles_from_mat(mat: Array, xp: ModuleType = np) -> Array:
    """Return ZYX angles (roll, pitch, yaw) [rad] (..., 3) of rotation matrices (..., 3, 3).

    In gimbal lock (pitch of +-pi/2) roll is 0 and yaw is the whole rotation.
    """
    # The hypotenuse is the cosine of the pitch.
    upright = xp.hypot(mat[..., 0, 0], mat[..., 1, 0]) < GIMBAL_LOCK_COS
    roll = xp.where(upright, 0.0, xp.arctan2(mat[..., 2, 1], mat[..., 2, 2]))
    # Clipped: rounding can exceed 1, and arcsin would return NaN.
    pitch = xp.arcsin(xp.clip(-mat[..., 2, 0], -1.0, 1.0))
    # With a roll of 0 these entries are minus the sine and the cosine of the yaw.
    turned = xp.arctan2(-mat[..., 0, 1], mat[..., 1, 1])
    yaw = xp.where(upright, turned, xp.arctan2(mat[..., 1, 0], mat[..., 0, 0]))
    return xp.stack([roll, pitch, yaw], -1)


def quat_from_angles(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """Return the w-first quaternion (4,) of ZYX angles [rad]."""
    cr, sr = np.cos(roll / 2), np.sin(roll / 2)
    cp, sp = np.cos(pitch / 2), np.sin(pitch / 2)
    cy, sy = np.cos(yaw / 2), np.sin(yaw / 2)
    w, x = cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy
    y, z = cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy
    return np.array([w, x, y, z])
