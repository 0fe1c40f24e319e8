"""Which solids of a robot's figure would cover a camera's lens: its pictures leave them out."""

import mujoco
import numpy as np

from usarmjx.base.backend import numpy_backend
from usarmjx.models.build.body_plan import KinematicTree
from usarmjx.models.build.figures import Solids
from usarmjx.models.build.pieces import TRIANGLE_KIND

COVER_DISTANCE = 0.04
"""How near to the lens a solid covers it [m]."""
STAND_IN_MARGIN = 0.01
"""How far beside a solid the middle of what is drawn in its place may be [m]."""
GeomType = mujoco.mjtGeom


def covering_geoms(plan: KinematicTree, body: int, at: np.ndarray) -> np.ndarray:
    """Return which of a robot's drawn solids a camera at a place (3,) on a body does not see (solids,).

    Those of the body itself, those nearer than `COVER_DISTANCE` with all joints at 0, and those that are
    drawn in the place of a solid so near, as the pieces of a housing are.
    """
    drawn, solids = plan.figure.solids, plan.solids
    (middles, drawn_mat), (pos, mat) = _rest_poses(plan, drawn), _rest_poses(plan, solids)
    lens = (plan.rest_pos[body] + plan.rest_frames[body] @ at)[None]

    def away(of: Solids, place: int, mat: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Return how far points (n, 3), seen from the middle of a solid, are from it (n,)."""
        kind, size = int(of.kind[place]), of.size[place]
        return np.array([_away(kind, point, size) for point in points @ mat[place]])

    count = range(len(drawn.kind))
    near = [away(drawn, i, drawn_mat, lens - middles[i])[0] < COVER_DISTANCE for i in count]
    hidden = np.array(near, bool) | (drawn.frame == body)
    for place in range(len(solids.kind)):
        if away(solids, place, mat, lens - pos[place])[0] < COVER_DISTANCE:
            own = np.flatnonzero((drawn.frame == solids.frame[place]) & ~hidden)
            hidden[own[away(solids, place, mat, middles[own] - pos[place]) <= STAND_IN_MARGIN]] = True
    return hidden


def _rest_poses(plan: KinematicTree, solids: Solids) -> tuple[np.ndarray, np.ndarray]:
    """Return where solids are on the chassis with all joints at 0 [m] (n, 3), and their turns (n, 3, 3)."""
    with numpy_backend():  # it may be asked for while JAX traces
        pos, mat = solids.poses(plan.rest_pos, plan.rest_frames)
    return np.asarray(pos), np.asarray(mat)


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
