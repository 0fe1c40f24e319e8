"""Which solids of a robot's figure would cover a camera's lens: its pictures leave them out."""

import mujoco
import numpy as np

from usarmjx.base.backend import numpy_backend
from usarmjx.models.build.body_plan import KinematicTree
from usarmjx.models.build.pieces import TRIANGLE_KIND

COVER_DISTANCE = 0.04
"""How near to the lens a solid covers it [m]."""
GeomType = mujoco.mjtGeom


def covering_geoms(plan: KinematicTree, body: int, at: np.ndarray) -> np.ndarray:
    """Return which of a robot's drawn solids a camera at a place (3,) on a body does not see (solids,).

    Those of the body itself, and those nearer than `COVER_DISTANCE` with all joints at 0.
    """
    rest_mat, solids = plan.rest_frames, plan.figure.solids
    lens_pos = plan.rest_pos[body] + rest_mat[body] @ at
    with numpy_backend():  # it may be asked for while JAX traces
        pos, mat = solids.poses(plan.rest_pos, rest_mat)
    local = np.einsum("gji,gj->gi", mat, lens_pos - pos)
    rows = zip(solids.kind.tolist(), local, solids.size, strict=True)
    near = np.array([_away(kind, point, size) < COVER_DISTANCE for kind, point, size in rows], bool)
    return near | (solids.frame == body)


def _away(kind: int, point: np.ndarray, size: np.ndarray) -> float:
    """Return how far a point in a geom's frame is from it [m]; of an ellipsoid, from the box about it."""
    x, y, z = np.abs(point)
    if kind == GeomType.mjGEOM_SPHERE:
        return float(np.linalg.norm(point)) - size[0]
    if kind == GeomType.mjGEOM_CAPSULE:
        return float(np.hypot(np.hypot(x, y), max(z - size[1], 0.0))) - size[0]
    if kind == GeomType.mjGEOM_CYLINDER:
        return float(np.hypot(max(np.hypot(x, y) - size[0], 0.0), max(z - size[1], 0.0)))
    if kind == TRIANGLE_KIND:
        return _from_triangle(point, size)
    return float(np.linalg.norm(np.maximum([x, y, z] - size, 0.0)))


def _from_triangle(point: np.ndarray, size: np.ndarray) -> float:
    corners = np.array([(0.0, 0.0), (size[0], 0.0), (size[1], size[2])])
    edges, flat = np.roll(corners, -1, 0) - corners, point[:2] - corners
    share = np.clip((flat * edges).sum(-1) / np.maximum((edges**2).sum(-1), 1e-12), 0.0, 1.0)
    beside = float(np.linalg.norm(flat - share[:, None] * edges, axis=-1).min())
    within = (edges[:, 0] * flat[:, 1] - edges[:, 1] * flat[:, 0] >= 0).all()
    return float(np.hypot(0.0 if within else beside, point[2]))
