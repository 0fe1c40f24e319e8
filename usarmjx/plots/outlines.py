"""What solids cover, seen from above, and between which heights they are."""

import math

import numpy as np
from scipy.spatial import ConvexHull

from usarmjx.base.transforms import mat_from_angles
from usarmjx.models.spec.shapes import Shape

CIRCLE_POINTS = 32
"""Corners that stand for a circle."""
_ANGLES = np.linspace(0.0, 2 * math.pi, CIRCLE_POINTS, endpoint=False)
CIRCLE = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], -1)
CORNER_SIGNS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)


def outline(shape: Shape) -> np.ndarray:
    """Return the polygon that a solid covers, counter-clockwise (corners, 2) [m]."""
    mat, at = np.asarray(mat_from_angles(*np.array(shape.rotation))), np.array(shape.at)
    points = _corners(shape) @ mat[:2].T
    points = (points[:, None] + _shadow(shape, mat)).reshape(-1, 2) + at[:2]
    return points[ConvexHull(points).vertices]


def height_range(shape: Shape) -> tuple[float, float]:
    """Return the heights of a solid's lowest and highest points [m]."""
    up = mat_from_angles(*np.array(shape.rotation))[2]
    z = _corners(shape) @ up + shape.at[2]
    reach = float(np.linalg.norm(_radii(shape) * up))
    if shape.kind == "cylinder":  # of its end discs
        reach = shape.size[0] * math.hypot(up[0], up[1])
    return float(z.min()) - reach, float(z.max()) + reach


def area(polygon: np.ndarray) -> float:
    """Return the area of a polygon (corners, 2) [m2]."""
    x, y = polygon.T
    return abs(float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())) / 2


def _corners(shape: Shape) -> np.ndarray:
    """Return the points in its frame that a solid is the hull of, without round ones' radii (n, 3)."""
    if shape.kind == "box":
        return CORNER_SIGNS * shape.size
    if shape.mesh is not None:
        return np.asarray(shape.mesh.vertices, float)
    if shape.heights is not None:
        x, y, base = shape.size
        top = float(np.max(shape.heights.heights))
        return np.concatenate(
            [CORNER_SIGNS[::2] * (x, y, 0) - (0, 0, base), CORNER_SIGNS[::2] * (x, y, 0) + (0, 0, top)]
        )
    half = shape.size[1] if shape.kind in ("capsule", "cylinder") else 0.0
    return np.array([(0.0, 0.0, -half), (0.0, 0.0, half)])


def _radii(shape: Shape) -> np.ndarray:
    """Return the radii of the ellipsoid that a round solid has around each of its corners (3,)."""
    if shape.kind == "ellipsoid":
        return np.array(shape.size)
    return np.full(3, shape.size[0]) if shape.kind in ("sphere", "capsule") else np.zeros(3)


def _shadow(shape: Shape, mat: np.ndarray) -> np.ndarray:
    """Return what such an ellipsoid, or the disc of a cylinder, covers around its centre (n, 2)."""
    if shape.kind == "cylinder":
        return shape.size[0] * CIRCLE @ mat[:2, :2].T
    spread = mat[:2] * _radii(shape)
    if not spread.any():
        return np.zeros((1, 2))
    # A linear image of the unit ball, which is the image of the unit circle under a root of M M^T.
    return CIRCLE @ np.linalg.cholesky(spread @ spread.T).T
