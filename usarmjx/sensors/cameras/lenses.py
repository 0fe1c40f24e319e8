"""Where the rays of a camera's pixels go: a pinhole, or a mirror that looks all around (manual 10.14, 10.15).

Directions are in the camera's axes: x forward along the optical axis, y to the left of the picture, z up.
Pixels are handed out in tiles of `TILE` x `TILE`, so that rays after each other go about the same way;
pictures whose sides are no multiples of it are cast a little larger and cut.
"""

import math
from typing import NamedTuple

import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp

TILE = 8
"""Side of the tiles that pixels come in."""
MIRROR_RIM_ANGLE = math.radians(105.0)
"""Half of what the mirror shows, measured from its axis: 15 degrees above the horizon (chosen) [rad]."""
MIRROR_DISTANCE = 0.09
"""How far the mirror's focus is in front of the camera (manual 10.15.2: Z=0.09) [m]."""


NEWTON_STEPS, LEAST_SLOPE, FLATTEST, BEND_ERROR = 12, 0.02, 20.0, 1e-4
"""Of the search for what a lens has bent: how many, the least slope, the largest result, and how far that may
be off [focal lengths]."""


class CameraRays(NamedTuple):
    """The rays of a picture's pixels, tile by tile.

    Attributes:
        direction: Unit vectors in the camera's axes (rays, 3).
        depth_scale: What a ray's length is multiplied by to be a depth (rays,).
        inside: Whether the pixel shows anything at all (rays,).
    """

    direction: Array
    depth_scale: Array
    inside: Array


def pixel_offsets(width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Return how far right and up of a picture's middle its pixels are, in pixels, tile by tile (rays,)."""
    columns, rows = (-(-side // TILE) * TILE for side in (width, height))
    right = np.broadcast_to(np.arange(columns) + 0.5 - width / 2, (rows, columns))
    up = np.broadcast_to(height / 2 - 0.5 - np.arange(rows), (columns, rows)).T
    return tiled(right).astype(np.float32), tiled(up).astype(np.float32)


def tiled(values: np.ndarray) -> np.ndarray:
    """Return values of pixels (rows, columns, ...), both multiples of `TILE`, tile by tile (rays, ...)."""
    rows, columns = values.shape[:2]
    cut = values.reshape(rows // TILE, TILE, columns // TILE, TILE, *values.shape[2:])
    return cut.swapaxes(1, 2).reshape(rows * columns, *values.shape[2:])


def untiled(values: Array, width: int, height: int) -> Array:
    """Return what `pixel_offsets` has put tile by tile (rays, ...) as a picture (height, width, ...)."""
    columns, rows = (-(-side // TILE) for side in (width, height))
    cut = values.reshape(rows, columns, TILE, TILE, *values.shape[1:]).swapaxes(1, 2)
    return cut.reshape(rows * TILE, columns * TILE, *values.shape[1:])[:height, :width]


def pinhole_rays(width: int, height: int, fov: Array, distortion: Array | None = None) -> CameraRays:
    """Return the rays of a pinhole camera.

    With f = (width / 2) / tan(fov / 2) the pixel in column c and row r looks along
    (f, width / 2 - c - 1 / 2, height / 2 - r - 1 / 2). Depth is the distance perpendicular to the picture.

    Args:
        width: Pixels along a row.
        height: Rows; pixels are square.
        fov: Horizontal field of view, of the undistorted picture [rad] ().
        distortion: k1 and k2 of Brown's radial distortion (2,); None: straight lines stay straight.
    """
    right, up = pixel_offsets(width, height)
    focal = width / 2 / xp.tan(fov / 2)
    inside = xp.ones(len(right), bool)
    if distortion is not None:
        seen = xp.asarray(np.hypot(right, up)) / focal
        straight = undistorted(seen, distortion)
        inside = xp.isfinite(straight)
        scale = xp.where(inside, straight, 0.0) / xp.maximum(seen, 1e-9)
        right, up = right * scale, up * scale
    along = xp.stack([xp.broadcast_to(focal, right.shape), -right, up], -1)
    along /= xp.sqrt((along * along).sum(-1, keepdims=True))
    return CameraRays(along, along[:, 0], inside)


def undistorted(seen: Array, distortion: Array) -> Array:
    """Return how far from the middle rays meet a plane 1 m away, r, that are seen at r (1 + k1 r2 + k2 r4).

    By Newton's method, from r = seen. Infinite where there is no such ray: a lens that bulges has an edge.

    Args:
        seen: Distances from the middle, in focal lengths (...,).
        distortion: k1 and k2 (2,).
    """
    k1, k2 = distortion[0], distortion[1]
    r = seen
    for _ in range(NEWTON_STEPS):
        square = r * r
        slope = xp.maximum(1 + square * (3 * k1 + 5 * k2 * square), LEAST_SLOPE)
        r = xp.clip(r - (r * (1 + square * (k1 + k2 * square)) - seen) / slope, 0.0, FLATTEST)
    square = r * r
    error = xp.abs(r * (1 + square * (k1 + k2 * square)) - seen)
    return xp.where((error < BEND_ERROR) & (1 + square * (3 * k1 + 5 * k2 * square) > 0), r, xp.inf)


def omni_rays(width: int, height: int, zoom: Array) -> CameraRays:
    """Return the rays of a camera that looks into a parabolic mirror; they start at the mirror's focus.

    The mirror is the paraboloid z = (h^2 - r^2) / (2 h) about the optical axis, its focus in the origin and z
    towards the camera, whose rays are parallel to the axis. One that meets the mirror at the radius r is
    thrown back as if it came from the focus: at the angle t from z with r = h tan(t / 2). The middle of the
    picture looks back at the camera, the horizon is where r = h, and the circle that fills the picture is
    the mirror's rim, where t = `MIRROR_RIM_ANGLE`. Right and up in the picture are right and up of
    the camera; what is
    outside the rim shows nothing. Depth is the distance from the focus.

    Args:
        width: Pixels along a row.
        height: Rows.
        zoom: How much larger than the picture the mirror appears ().
    """
    right, up = pixel_offsets(width, height)
    radius = np.hypot(right, up) / (min(width, height) / 2)  # in radii of the circle that fills the picture
    share = radius / zoom
    angle = 2 * xp.arctan(share * math.tan(MIRROR_RIM_ANGLE / 2))
    side = np.stack([-right, up], -1) / np.maximum(np.hypot(right, up), 1e-9)[:, None]
    along = xp.concatenate([-xp.cos(angle)[:, None], xp.sin(angle)[:, None] * side], -1)
    return CameraRays(along, xp.ones(len(right)), xp.asarray(share <= 1))
