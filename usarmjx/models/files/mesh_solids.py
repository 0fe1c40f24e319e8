"""Solids of robots' meshes: cylinders and spheres of round ones, convex hulls of all others."""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from usarmjx.models.types.shapes import Mesh

ROUNDNESS = 0.02
"""Difference of a round mesh's radius from a circle's, relative to it."""
MIN_SIDES = 8
"""Smallest number of corners around the axis of a round mesh."""
MAX_HULL_CORNERS = 100
"""Largest number of corners of a robot's hull: rays test all faces, MJX all corners."""
HULL_TOLERANCE = 1e-3
"""Distance of a corner from the hull of the others within which it is left out [m]."""
MIN_THICKNESS = 1e-3
"""Smallest thickness of a hull; flatter meshes become boxes of it [m]."""


def hull_corners(vertices: np.ndarray) -> np.ndarray:
    """Return corners (n, 3) whose hull is that of all vertices within `HULL_TOLERANCE`.

    The extremes along the axes stay, and at most `MAX_HULL_CORNERS` corners remain. A flat mesh becomes a box
    with a thickness.
    """
    from scipy.spatial import ConvexHull, QhullError

    vertices = np.asarray(vertices, float)
    hull_of: Callable[[np.ndarray], Any] = ConvexHull
    try:
        hull = hull_of(vertices)
    except (QhullError, ValueError):
        return _thickened(vertices)
    if hull.volume < MIN_THICKNESS**3:
        return _thickened(vertices)
    points = vertices[hull.vertices]
    if len(points) <= 8:
        return points
    ways = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z])
    chosen = set(np.argmax(points @ ways.T, axis=0).tolist())
    while len(chosen) < MAX_HULL_CORNERS:
        index = sorted(chosen)
        try:
            inner = hull_of(points[index])
        except (QhullError, ValueError):
            return points[:MAX_HULL_CORNERS]
        outside = points @ inner.equations[:, :3].T + inner.equations[:, 3]
        worst = outside.max(1)
        if worst.max() <= HULL_TOLERANCE:
            break
        # The farthest corner of each face, the farthest of these first.
        fresh = {int(i) for i in outside.argmax(0) if worst[i] > HULL_TOLERANCE} - chosen
        room = MAX_HULL_CORNERS - len(chosen)
        chosen |= set(sorted(fresh, key=lambda i: -worst[i])[: min(room, max(1, len(fresh) // 2))])
    return points[sorted(chosen)]


def _thickened(vertices: np.ndarray) -> np.ndarray:
    """Return the corners of the box around vertices in their principal axes, with a thickness."""
    middle = vertices.mean(0)
    _, axes = np.linalg.eigh(np.cov((vertices - middle).T) if len(vertices) > 1 else np.eye(3))
    local = (vertices - middle) @ axes
    low, high = local.min(0), local.max(0)
    grow = np.maximum(0.0, MIN_THICKNESS - (high - low)) / 2
    low, high = low - grow, high + grow
    corners = np.array([[(low, high)[i][k] for k, i in enumerate(signs)] for signs in np.ndindex(2, 2, 2)])
    return corners @ axes.T + middle


class RoundSolid(tuple[float, float, np.ndarray]):
    """Radius and half length of a round mesh, and its middle (3,)."""


def round_about(vertices: np.ndarray, axis: np.ndarray, anchor: np.ndarray) -> RoundSolid | None:
    """Return a mesh that is round about an axis as a cylinder; None: it is not round.

    Args:
        vertices: Its vertices (n, 3).
        axis: Unit vector of the axis (3,).
        anchor: A point on the axis (3,).
    """
    along = (vertices - anchor) @ axis
    across = (vertices - anchor) - np.outer(along, axis)
    far = np.linalg.norm(across, axis=1)
    radius = float(far.max())
    if radius <= 0:
        return None
    rim = far > (1 - ROUNDNESS) * radius
    x = across[np.argmax(far)] / radius
    angles = np.arctan2(across @ np.cross(axis, x), across @ x)[rim]
    ordered = np.sort(angles)
    gaps = np.diff(np.append(ordered, ordered[0] + 2 * math.pi))
    if len(ordered) < MIN_SIDES or gaps.max() > 2 * math.pi / MIN_SIDES + 1e-6:
        return None
    low, high = float(along.min()), float(along.max())
    middle = anchor + axis * (low + high) / 2
    return RoundSolid((radius, max((high - low) / 2, MIN_THICKNESS / 2), middle))


@lru_cache(maxsize=256)
def hull_mesh(content: bytes) -> Mesh:
    """Return the solid of a hull's corners, given as bytes of (n, 3) doubles: equal ones share it."""
    return Mesh(hull_corners(np.frombuffer(content).reshape(-1, 3)))
