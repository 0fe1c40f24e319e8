"""Rays against single solids of C MuJoCo, in arrays: distances and angles of incidence.

The formulas are those of `mj_ray`, in double precision: the distance to the first surface crossed, also from
inside a solid; a plane is met only from its front.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import mujoco
import numpy as np

MARGIN = 1e-4
"""Enlargement of bounding spheres and boxes against rounding [m]."""
MIN_LENGTH = 1e-15
"""MuJoCo's mjMINVAL."""
BOX = int(mujoco.mjtGeom.mjGEOM_BOX)


class LocalRays(NamedTuple):
    """Rays of pairs of a bundle and a geom, in the geom's frame.

    Attributes:
        point: Origins [m] (3, 1, pairs).
        along: Unit vectors (3, rays, pairs).
        size: Sizes of the geoms [m] (3, 1, pairs).
    """

    point: np.ndarray
    along: np.ndarray
    size: np.ndarray

    def part(self, index: Any) -> "LocalRays":  # noqa: ANN401 - what indexes arrays
        """Return some of the rays."""
        return LocalRays(self.point[index], self.along[index], self.size[index])


def cone_meets_box(axes: LocalRays, chord: np.ndarray) -> np.ndarray:
    """Return whether any ray of a bundle may meet a box (1, pairs).

    Args:
        axes: The first rays of the bundles.
        chord: How far the ends of the others' unit vectors are from its end (pairs,).
    """
    low, high = np.zeros((1, len(chord))), np.full((1, len(chord)), np.inf)
    for point, along, size in zip(*axes, strict=True):
        # Within this distance along the rays none of them is above the box, or none below it.
        for speed, room in ((along - chord, size + MARGIN - point), (-along - chord, size + MARGIN + point)):
            end = room / speed
            low = np.where(speed < 0.0, np.maximum(low, end), low)
            high = np.where(speed > 0.0, np.minimum(high, end), high)
    return low <= high


# Kernels: rays of pairs -> distance, infinite without a hit (rays, pairs).


def _plane(rays: LocalRays) -> np.ndarray:
    point, along, size = rays
    met = -point[2] / along[2]
    is_met = (along[2] <= -MIN_LENGTH) & (met >= 0.0)
    for i in (0, 1):
        is_met &= (size[i] <= 0.0) | (np.abs(point[i] + met * along[i]) <= size[i])
    return np.where(is_met, met, np.inf)


def _box(rays: LocalRays) -> np.ndarray:
    point, along, size = rays
    low, high = (-size - point) / along, (size - point) / along
    first, last = np.minimum(low, high), np.maximum(low, high)
    flat: np.ndarray = np.abs(along) <= MIN_LENGTH
    if flat.any():
        away: np.ndarray = np.where(np.abs(point) <= size, -np.inf, np.inf)
        first, last = np.where(flat, away, first), np.where(flat, -away, last)
    enters: np.ndarray = np.maximum(np.maximum(first[0], first[1]), first[2])
    leaves: np.ndarray = np.minimum(np.minimum(last[0], last[1]), last[2])
    is_met = (enters <= leaves) & (leaves >= 0.0)
    return np.where(is_met, np.where(enters >= 0.0, enters, leaves), np.inf)


def _roots(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return both solutions of a x^2 + 2 b x + c = 0, the smaller first; -1 without."""
    square = b * b - a * c
    root, exists = np.sqrt(square), square >= MIN_LENGTH
    return np.where(exists, (-b - root) / a, -1.0), np.where(exists, (-b + root) / a, -1.0)


def _nearest(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the smaller of two distances, the first being the smaller, that is not negative."""
    return np.where(first >= 0.0, first, np.where(second >= 0.0, second, np.inf))


def _dot(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the scalar products of vectors (3, ...), summed in MuJoCo's order."""
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


def _sphere(rays: LocalRays) -> np.ndarray:
    point, along, size = rays
    radius = size[0]
    return _nearest(*_roots(_dot(along, along), _dot(along, point), _dot(point, point) - radius * radius))


def _round_side(rays: LocalRays) -> np.ndarray:
    """Return the distance to the round side of a cylinder: radius and half length."""
    point, along, size = rays
    a = along[0] * along[0] + along[1] * along[1]
    b = along[0] * point[0] + along[1] * point[1]
    c = point[0] * point[0] + point[1] * point[1] - size[0] * size[0]
    met = _nearest(*_roots(a, b, c))
    return np.where(np.abs(point[2] + met * along[2]) <= size[1], met, np.inf)


def _cylinder(rays: LocalRays) -> np.ndarray:
    point, along, size = rays
    nearest = _round_side(rays)
    for side in (-1.0, 1.0):
        met = (side * size[1] - point[2]) / along[2]
        x, y = point[0] + met * along[0], point[1] + met * along[1]
        is_met = (np.abs(along[2]) > MIN_LENGTH) & (met >= 0.0) & (x * x + y * y <= size[0] * size[0])
        nearest = np.where(is_met, np.minimum(nearest, met), nearest)
    return nearest


def _capsule(rays: LocalRays) -> np.ndarray:
    point, along, size = rays
    nearest = _round_side(rays)
    for side in (1.0, -1.0):
        end = np.stack([point[0], point[1], point[2] - side * size[1]])
        a, b = _dot(along, along), _dot(along, end)
        for met in _roots(a, b, _dot(end, end) - size[0] * size[0]):
            is_met = (met >= 0.0) & (side * (point[2] + met * along[2]) >= size[1])
            nearest = np.where(is_met, np.minimum(nearest, met), nearest)
    return nearest


# Cosines: rays and the distances at which they meet, both (..., pairs) -> cosine of incidence (pairs,).


def _ends(rays: LocalRays, met: np.ndarray) -> np.ndarray:
    return rays.point + met * rays.along


def _cosine_to(normal: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Return the cosines of the angles to normals of any length."""
    return np.abs(_dot(normal, along)) / np.sqrt(_dot(normal, normal))


def _plane_cosine(rays: LocalRays, met: np.ndarray) -> np.ndarray:
    del met
    return np.abs(rays.along[2])


def _box_cosine(rays: LocalRays, met: np.ndarray) -> np.ndarray:
    face = (np.abs(_ends(rays, met)) / rays.size).argmax(0)
    return np.abs(np.take_along_axis(rays.along, face[None], 0)[0])


def _sphere_cosine(rays: LocalRays, met: np.ndarray) -> np.ndarray:
    return _cosine_to(_ends(rays, met), rays.along)


def _cylinder_cosine(rays: LocalRays, met: np.ndarray) -> np.ndarray:
    x, y, z = _ends(rays, met)
    is_flat = np.abs(z) / rays.size[1] > np.sqrt(x * x + y * y) / rays.size[0]
    side = _cosine_to(np.stack([x, y, np.zeros_like(z)]), rays.along)
    return np.where(is_flat, np.abs(rays.along[2]), side)


def _capsule_cosine(rays: LocalRays, met: np.ndarray) -> np.ndarray:
    x, y, z = _ends(rays, met)
    half = rays.size[1]
    return _cosine_to(np.stack([x, y, z - np.clip(z, -half, half)]), rays.along)


class Solid(NamedTuple):
    """Functions of a type of geom.

    Attributes:
        distance: Distances of rays, infinite without a hit [m] (rays, pairs).
        cosine: Cosines of incidence of rays that meet it at some distances (pairs,).
    """

    distance: Callable[[LocalRays], np.ndarray]
    cosine: Callable[[LocalRays, np.ndarray], np.ndarray]


SOLIDS = {
    int(mujoco.mjtGeom.mjGEOM_PLANE): Solid(_plane, _plane_cosine),
    int(mujoco.mjtGeom.mjGEOM_SPHERE): Solid(_sphere, _sphere_cosine),
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): Solid(_capsule, _capsule_cosine),
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): Solid(_cylinder, _cylinder_cosine),
    BOX: Solid(_box, _box_cosine),
}
"""Known types of geoms."""
