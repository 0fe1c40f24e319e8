"""Ray directions of a camera's pixels: pinhole, and omnidirectional mirror (manual 10.14, 10.15).

Directions are in the camera's axes: x forward along the optical axis, y to the left of the picture, z up.
Pixels are ordered in tiles of `TILE` x `TILE`, so that consecutive rays have similar directions; pictures
whose sides are no multiples of it are cast larger and cropped.
"""

import math
from typing import NamedTuple

import numpy as np

from usarmjx.base.backend import Array, xp

TILE = 8
"""Side of a tile [pixels]."""
MIRROR_RIM_ANGLE = math.radians(105.0)
"""Half the mirror's field of view, measured from its axis: 15 degrees above the horizon (chosen) [rad]."""
MIRROR_DISTANCE = 0.09
"""Distance of the mirror's focus in front of the camera (manual 10.15.2: Z=0.09) [m]."""


NEWTON_STEPS, MIN_SLOPE, MAX_RADIUS, DISTORTION_TOLERANCE = 12, 0.02, 20.0, 1e-4
"""Parameters of the inversion of a distortion: Newton steps, lowest slope, largest radius and tolerance
[focal lengths]."""


class CameraRays(NamedTuple):
    """Rays of a picture's pixels, tile by tile.

    Attributes:
        direction: Unit vectors in the camera's axes (rays, 3).
        depth_scale: Factor from a ray's length to depth (rays,).
        inside: Whether the pixel is inside the lens's field of view (rays,).
    """

    direction: Array
    depth_scale: Array
    inside: Array


def pixel_offsets(width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the offsets of pixels right and up from the picture's centre [pixels], tile by tile (rays,)."""
    # Whole tiles: rays of a tile look in similar directions and form one bundle. Extra ones are cut off.
    columns, rows = (-(-side // TILE) * TILE for side in (width, height))
    # Half a pixel more: rays go through the middles of pixels.
    right = np.broadcast_to(np.arange(columns) + 0.5 - width / 2, (rows, columns))
    up = np.broadcast_to(height / 2 - 0.5 - np.arange(rows), (columns, rows)).T
    return to_tiles(right).astype(np.float32), to_tiles(up).astype(np.float32)


def to_tiles(values: np.ndarray) -> np.ndarray:
    """Reorder values of pixels (rows, columns, ...), both multiples of `TILE`, tile by tile (rays, ...)."""
    rows, columns = values.shape[:2]
    cut = values.reshape(rows // TILE, TILE, columns // TILE, TILE, *values.shape[2:])
    return cut.swapaxes(1, 2).reshape(rows * columns, *values.shape[2:])


def from_tiles(values: Array, width: int, height: int) -> Array:
    """Reorder tiled values (rays, ...) into a picture (height, width, ...)."""
    columns, rows = (-(-side // TILE) for side in (width, height))
    cut = values.reshape(rows, columns, TILE, TILE, *values.shape[1:]).swapaxes(1, 2)
    return cut.reshape(rows * TILE, columns * TILE, *values.shape[1:])[:height, :width]


def pinhole_rays(width: int, height: int, fov: Array, distortion: Array | None = None) -> CameraRays:
    """Return the rays of a pinhole camera.

    With f = (width / 2) / tan(fov / 2) the pixel in column c and row r looks along (f, width / 2 - c - 1 / 2,
    height / 2 - r - 1 / 2). Depth is the distance perpendicular to the picture.

    Args:
        width: Pixels along a row.
        height: Rows; pixels are square.
        fov: Horizontal field of view of the undistorted picture [rad] ().
        distortion: k1 and k2 of Brown's radial distortion (2,); None: no distortion.
    """
    right, up = pixel_offsets(width, height)
    focal = width / 2 / xp.tan(fov / 2)
    inside = xp.ones(len(right), bool)
    if distortion is not None:
        seen = xp.asarray(np.hypot(right, up)) / focal
        straight = undistort(seen, distortion)
        # Beyond the lens's edge no light arrives.
        inside = xp.isfinite(straight)
        # The ray through the middle has no offset to scale: 0 / 0.
        scale = xp.where(inside, straight, 0.0) / xp.maximum(seen, 1e-9)
        right, up = right * scale, up * scale
    along = xp.stack([xp.broadcast_to(focal, right.shape), -right, up], -1)
    along /= xp.sqrt((along * along).sum(-1, keepdims=True))
    return CameraRays(along, along[:, 0], inside)


def undistort(seen: Array, distortion: Array) -> Array:
    """Return the undistorted radii r of rays seen at the radii r (1 + k1 r^2 + k2 r^4).

    By Newton's method, starting at the distorted radius. Infinite where there is no such ray: a lens with
    barrel distortion has an edge.

    Args:
        seen: Distorted radii, in focal lengths (...,).
        distortion: k1 and k2 (2,).
    """
    k1, k2 = distortion[0], distortion[1]
    r = seen
    for _ in range(NEWTON_STEPS):
        square = r * r
        # At the lens's edge the slope is 0, and Newton's step would be infinite.
        slope = xp.maximum(1 + square * (3 * k1 + 5 * k2 * square), MIN_SLOPE)
        r = xp.clip(r - (r * (1 + square * (k1 + k2 * square)) - seen) / slope, 0.0, MAX_RADIUS)
    square = r * r
    error = xp.abs(r * (1 + square * (k1 + k2 * square)) - seen)
    # A root with a negative slope lies beyond the edge: it is an image that the lens does not form.
    return xp.where((error < DISTORTION_TOLERANCE) & (1 + square * (3 * k1 + 5 * k2 * square) > 0), r, xp.inf)


def omni_rays(width: int, height: int, zoom: Array) -> CameraRays:
    """Return the rays of a camera that faces a parabolic mirror; they start at the mirror's focus.

    The mirror is the paraboloid z = (h^2 - r^2) / (2 h) about the optical axis, with its focus in the origin
    and z towards the camera, whose rays are parallel to the axis. A ray that meets the mirror at radius r is
    reflected as if it came from the focus: at the angle t from z with r = h tan(t / 2). The centre of the
    picture looks back at the camera, the horizon is at r = h, and the circle that fills the picture is the
    mirror's rim, with t = `MIRROR_RIM_ANGLE`. Right and up in the picture are right and up of the camera;
    pixels outside the rim are empty. Depth is the distance from the focus.

    Args:
        width: Pixels along a row.
        height: Rows.
        zoom: Size of the mirror relative to the picture ().
    """
    right, up = pixel_offsets(width, height)
    radius = np.hypot(right, up) / (min(width, height) / 2)  # in radii of the inscribed circle
    share = radius / zoom
    angle = 2 * xp.arctan(share * math.tan(MIRROR_RIM_ANGLE / 2))
    # At the centre the direction is arbitrary; it is multiplied by a sine of 0.
    side = np.stack([-right, up], -1) / np.maximum(np.hypot(right, up), 1e-9)[:, None]
    along = xp.concatenate([-xp.cos(angle)[:, None], xp.sin(angle)[:, None] * side], -1)
    return CameraRays(along, xp.ones(len(right)), xp.asarray(share <= 1))
