"""Ray intersection: one small kernel per geom type, bounding volumes and surface normals.

A kernel takes a ray in the geom's frame, origin and direction as three arrays (...) each, and three size
values, and returns the distance to the surface (...), infinite for a miss. Arrays (3, ...) are accepted, too.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import mujoco
import numpy as np

from usarmjx.base.backend import Array, xp
from usarmjx.models.compile.ray_geoms import FENDER_KIND, TRIANGLE_KIND

TINY = 1e-12
"""Lower bound of a direction's components, so that slabs parallel to a ray divide safely."""
EDGE_MARGIN = 3e-5
"""Relative widening of a triangle's edges, so that no ray passes between two triangles."""
GRID_PITCH, BAR_WIDTH = 0.05, 0.01
"""Spacing and width of a grid fender's bars [m] (chosen)."""

UNBOUNDED = 1e9
"""Half length of an unbounded geom [m]."""

GeomType = mujoco.mjtGeom

XYZ = Sequence[Any] | Array
"""Components along x, y and z."""


def _nearest(*candidates: Array) -> Array:
    """Return the smallest candidate that is not behind the origin."""
    ahead = [xp.where(t >= 0, t, xp.inf) for t in candidates]
    out = ahead[0]
    for t in ahead[1:]:
        out = xp.minimum(out, t)
    return out


def ray_plane(origin: XYZ, direction: XYZ, size: XYZ) -> Array:
    """Return the distance to a plane through the frame's origin with normal z; sizes of 0 are unbounded."""
    # Only from the front, as in C MuJoCo's mj_ray.
    t = xp.where(direction[2] < -TINY, -origin[2] / xp.where(direction[2] < -TINY, direction[2], -1), -1)
    inside = t >= 0
    for axis in (0, 1):
        inside &= (size[axis] <= 0) | (xp.abs(origin[axis] + t * direction[axis]) <= size[axis])
    return xp.where(inside, t, xp.inf)


def ray_box(origin: XYZ, direction: XYZ, size: XYZ) -> Array:
    """Return the distance to a box with half lengths `size` by the slab method."""
    near: Any = -math.inf
    far: Any = math.inf
    for axis in range(3):
        # Parallel to a face the reciprocal is huge instead of infinite: 0 times infinity would be NaN.
        share = 1.0 / xp.where(xp.abs(direction[axis]) < TINY, TINY, direction[axis])
        middle, half = origin[axis] * share, size[axis] * xp.abs(share)
        # One division per axis instead of one per face.
        near, far = xp.maximum(near, -middle - half), xp.minimum(far, half - middle)
    return xp.where(near <= far, _nearest(near, far), xp.inf)


def _dot(a: XYZ, b: XYZ) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _ball(origin: XYZ, direction: XYZ, radius: Array) -> tuple[Array, Array]:
    """Return both crossings of a sphere, infinite (not NaN) for a miss."""
    middle = -_dot(origin, direction)
    # Squared distance of the centre from the ray, by the foot point: |o|^2 - m^2 would cancel.
    foot = [o + middle * d for o, d in zip(origin, direction, strict=True)]
    under = radius**2 - _dot(foot, foot)
    root = xp.sqrt(xp.maximum(under, 0.0))
    hit = under >= 0
    return xp.where(hit, middle - root, xp.inf), xp.where(hit, middle + root, xp.inf)


def ray_sphere(origin: XYZ, direction: XYZ, size: XYZ) -> Array:
    """Return the distance to a sphere of radius `size[0]`."""
    return _nearest(*_ball(origin, direction, size[0]))


def _tube(origin: XYZ, direction: XYZ, radius: Array) -> tuple[Array, Array]:
    """Return both crossings of an unbounded tube about z."""
    flat = direction[0] ** 2 + direction[1] ** 2
    # A ray along the axis never meets the side: it is masked below, with a finite derivative.
    safe = xp.maximum(flat, TINY)
    middle = -(origin[0] * direction[0] + origin[1] * direction[1]) / safe
    x, y = origin[0] + middle * direction[0], origin[1] + middle * direction[1]
    under = radius**2 - x * x - y * y
    half = xp.sqrt(xp.maximum(under, 0.0) / safe)
    hit = (under >= 0) & (flat > TINY)
    return xp.where(hit, middle - half, xp.inf), xp.where(hit, middle + half, xp.inf)


def _within(t: Array, z: Array, low: Array | float, high: Array | float) -> Array:
    return xp.where((z >= low) & (z <= high), t, xp.inf)


def ray_cylinder(origin: XYZ, direction: XYZ, size: XYZ) -> Array:
    """Return the distance to a cylinder about z with radius `size[0]` and half length `size[1]`."""
    radius, half = size[0], size[1]
    sides = [_within(t, origin[2] + t * direction[2], -half, half) for t in _tube(origin, direction, radius)]
    # As in `ray_box`: huge instead of infinite.
    step = xp.where(xp.abs(direction[2]) < TINY, TINY, direction[2])
    caps: list[Array] = []
    for end in (-half, half):
        t = (end - origin[2]) / step
        x, y = origin[0] + t * direction[0], origin[1] + t * direction[1]
        caps.append(xp.where(x * x + y * y <= radius**2, t, xp.inf))
    return _nearest(*sides, *caps)


def ray_capsule(origin: XYZ, direction: XYZ, size: XYZ) -> Array:
    """Return the distance to a capsule about z with radius `size[0]` and half length `size[1]`."""
    radius, half = size[0], size[1]
    hits = [_within(t, origin[2] + t * direction[2], -half, half) for t in _tube(origin, direction, radius)]
    # Of each ball only the half beyond the tube is surface; inside the tube its crossings do not count.
    for end, low, high in ((half, half, xp.inf), (-half, -xp.inf, -half)):
        shifted = (origin[0], origin[1], origin[2] - end)
        for t in _ball(shifted, direction, radius):
            hits.append(_within(t, origin[2] + t * direction[2], low, high))
    return _nearest(*hits)


def ray_ellipsoid(origin: XYZ, direction: XYZ, size: XYZ) -> Array:
    """Return the distance to an ellipsoid with radii `size`: a unit ball in scaled coordinates."""
    start = [o / s for o, s in zip(origin, size, strict=True)]
    along = [d / s for d, s in zip(direction, size, strict=True)]
    # The scaled direction is no unit vector, so t stays the distance along the given one.
    stretch = _dot(along, along)
    middle = -_dot(start, along) / stretch
    foot = [s + middle * a for s, a in zip(start, along, strict=True)]  # as in `_ball`
    under = 1.0 - _dot(foot, foot)
    half = xp.sqrt(xp.maximum(under, 0.0) / stretch)
    return xp.where(under >= 0, _nearest(middle - half, middle + half), xp.inf)


def ray_triangle(origin: XYZ, direction: XYZ, size: XYZ) -> Array:
    """Return the distance to a two-sided triangle in the plane z = 0; see `ray_geoms.TRIANGLE_KIND`."""
    length, x3, y3 = size[0], size[1], size[2]
    t = -origin[2] / xp.where(xp.abs(direction[2]) < TINY, TINY, direction[2])
    x, y = origin[0] + t * direction[0], origin[1] + t * direction[1]
    # Barycentric coordinates of the second and the third corner, times twice the area.
    second, third = x * y3 - y * x3, y * length
    area = length * y3
    slack = EDGE_MARGIN * area
    # Padding triangles have no area and are never met.
    inside = (second >= -slack) & (third >= -slack) & (second + third <= area + slack) & (area > 0)
    return xp.where(inside & (t >= 0), t, xp.inf)


def in_hole(point: XYZ, size: XYZ) -> Array:
    """Return whether a point (3, ...) on the surface of a grid fender lies in a hole (...).

    Bars run along the axes of the box, one of them through the centre of each face. A face narrower than the
    bar spacing has no holes.
    """
    free = [
        (xp.abs(point[i] - GRID_PITCH * xp.floor(point[i] / GRID_PITCH + 0.5)) > BAR_WIDTH / 2)
        & (size[i] >= GRID_PITCH / 2)
        for i in range(3)
    ]
    # The face is the one that the point is farthest out of: hits are off by roundings.
    over = [xp.abs(point[i]) - size[i] for i in range(3)]
    on_x = (over[0] >= over[1]) & (over[0] >= over[2])
    on_y = ~on_x & (over[1] >= over[2])
    return xp.where(on_x, free[1] & free[2], xp.where(on_y, free[0] & free[2], free[0] & free[1]))


def ray_fender(origin: XYZ, direction: XYZ, size: XYZ) -> Array:
    """Return the distance to a box-shaped grid: a ray whose first hit is in a hole passes the box entirely.

    For a ray from inside the exit point decides.
    """
    t = ray_box(origin, direction, size)
    # Finite for a miss too: infinity times a direction's 0 is NaN.
    met = xp.isfinite(t)
    reach = xp.where(met, t, 0.0)
    point = [origin[i] + reach * direction[i] for i in range(3)]
    return xp.where(met & ~in_hole(point, size), t, xp.inf)


RAY_KERNELS: dict[int, Callable[[XYZ, XYZ, XYZ], Array]] = {
    int(GeomType.mjGEOM_PLANE): ray_plane,
    int(GeomType.mjGEOM_BOX): ray_box,
    int(GeomType.mjGEOM_SPHERE): ray_sphere,
    int(GeomType.mjGEOM_CAPSULE): ray_capsule,
    int(GeomType.mjGEOM_CYLINDER): ray_cylinder,
    int(GeomType.mjGEOM_ELLIPSOID): ray_ellipsoid,
    TRIANGLE_KIND: ray_triangle,
    FENDER_KIND: ray_fender,
}
"""Kernel of each geom type."""


def bounding_box(kind: int, size: XYZ) -> tuple[XYZ | None, XYZ]:
    """Return centre (None: the frame's origin) and half lengths of a geom's bounding box, in its frame."""
    zero, middle = 0.0 * size[0], None
    if kind == GeomType.mjGEOM_PLANE:
        # MuJoCo's planes of size 0 are unbounded.
        wide, long = (xp.where(half > 0, half, UNBOUNDED) for half in (size[0], size[1]))
        return middle, (wide, long, zero)
    if kind == GeomType.mjGEOM_SPHERE:
        return middle, (size[0], size[0], size[0])
    if kind == GeomType.mjGEOM_CAPSULE:
        return middle, (size[0], size[0], size[0] + size[1])
    if kind == GeomType.mjGEOM_CYLINDER:
        return middle, (size[0], size[0], size[1])
    if kind == TRIANGLE_KIND:
        # Corners are (0, 0), (size[0], 0) and (size[1], size[2]), in the plane z = 0.
        low, high = xp.minimum(size[1], 0.0), xp.maximum(size[0], size[1])
        return ((low + high) / 2, size[2] / 2, zero), ((high - low) / 2, xp.abs(size[2]) / 2, zero)
    return middle, size


def bounding_radius(kind: int, size: XYZ) -> Array:
    """Return the radius of the bounding sphere about a geom's position."""
    if kind == TRIANGLE_KIND:
        # A triangle's position is its first corner, so the farther of the other two decides.
        return xp.maximum(xp.abs(size[0]), xp.hypot(size[1], size[2]))
    _, half = bounding_box(kind, size)
    return xp.sqrt(_dot(half, half))


def surface_normal(kind: int, point: Array, size: Array) -> Array:
    """Return the unit normal at a point on the surface; all in the geom's frame, (..., 3).

    Flat geoms, which have two sides, have normal z.
    """
    up = xp.broadcast_to(xp.array([0.0, 0.0, 1.0]), point.shape)
    if kind in (GeomType.mjGEOM_PLANE, TRIANGLE_KIND):
        return up
    if kind in (GeomType.mjGEOM_BOX, FENDER_KIND):
        # The face that the point is farthest out of: hits are off by roundings.
        side = (xp.argmax(xp.abs(point) - size, -1)[..., None] == np.arange(3)).astype(point.dtype)
        return side * xp.sign(point)
    if kind == GeomType.mjGEOM_ELLIPSOID:
        # The gradient of the ellipsoid's equation.
        return _unit(point / size**2)
    if kind == GeomType.mjGEOM_SPHERE:
        return _unit(point)
    half = size[..., 1]
    # The nearest point of the axis within the tube: at a capsule's ends it is the middle of the ball.
    along = xp.clip(point[..., 2], -half, half)
    normal = _unit(point - up * along[..., None])
    if kind == GeomType.mjGEOM_CYLINDER:
        # The nearer surface decides: hits lie on neither exactly.
        on_cap = half - xp.abs(point[..., 2]) < size[..., 0] - xp.hypot(point[..., 0], point[..., 1])
        normal = xp.where(on_cap[..., None], up * xp.sign(point[..., 2:]), normal)
    return normal


def _unit(vector: Array) -> Array:
    return vector / xp.maximum(xp.linalg.norm(vector, axis=-1, keepdims=True), TINY)
