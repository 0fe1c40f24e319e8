"""Primitives of a model's geoms for ray casting: unchanged, as triangles, or as a grid fender.

Triangles are those of C MuJoCo's `mj_ray`: a mesh's faces, and for terrain two per cell, split from the
corner with the lowest x and y to the opposite one, with its sides down to the bottom and the bottom itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from usarmjx.base.backend import Array
from usarmjx.models.types.shapes import FENDER, OPAQUE

TRIANGLE_KIND, FENDER_KIND, COLUMN_KIND = 201, 202, 203
"""Kinds of primitives beside MuJoCo's own `mjtGeom`.

A triangle's position is its first corner, the x axis of its frame its first edge and z its normal, outward
for solids; its size: the length of that edge, x and y of the third corner. A fender is a box. A column is a
piece of terrain for the radio, see `terrain_columns`.
"""
Frames = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Positions (n, 3), orientations (n, 3, 3) and sizes (n, 3)."""
GeomType = mujoco.mjtGeom
MESH, HFIELD = int(GeomType.mjGEOM_MESH), int(GeomType.mjGEOM_HFIELD)
MIN_DOUBLE_AREA = 1e-12
"""Bound on twice the area of a triangle, below which it is dropped [m2]."""
FLATNESS = 1e-5
"""Height above a face within which a corner is in its plane, relative to the mesh's size."""


@dataclass(frozen=True, eq=False)
class RayPrimitives:
    """Primitives of geoms; arrays have a leading axis over primitives, those of a geom adjacent.

    Attributes:
        geom: Index of the geom of each among the requested ones (n,).
        kind: `mjtGeom`, or a kind of this module (n,).
        material: Material; a member of `shapes.MATERIALS` (n,).
        pos: Position in its geom's frame [m] (n, 3).
        mat: Orientation in its geom's frame (n, 3, 3).
        size: Size numbers [m] (n, 3).
    """

    geom: np.ndarray
    kind: np.ndarray
    material: np.ndarray
    pos: np.ndarray
    mat: np.ndarray
    size: np.ndarray

    def world_poses(self, pos: Array, mat: Array) -> tuple[Array, Array]:
        """Return positions (n, 3) and orientations (n, 3, 3) of the primitives for those of the geoms."""
        # Whole geoms have the pose of their geom: nothing to compose.
        if (self.kind < TRIANGLE_KIND).all():
            return pos[self.geom], mat[self.geom]
        turn, local = mat[self.geom], self.pos.astype(np.float32)
        offset = sum(turn[:, :, j] * local[:, None, j] for j in range(3))
        turned = sum(turn[:, :, j, None] * self.mat.astype(np.float32)[:, None, j] for j in range(3))
        return pos[self.geom] + offset, turned  # type: ignore - sums of three


def ray_primitives_of(
    model: mujoco.MjModel,
    geoms: Sequence[int] | np.ndarray,
    materials: Sequence[str] | None = None,
    *,
    columns: bool = False,
) -> RayPrimitives:
    """Return the primitives of some of a model's geoms.

    Args:
        model: The compiled model.
        geoms: Ids of the geoms.
        materials: Material of each geom of the model, see `materials_of`; None: all opaque.
        columns: Whether terrain is cut into columns instead of triangles, and meshes are replaced by their
            hulls, as for the radio.
    """
    owners: list[tuple[int, int, str]] = []
    frames: list[Frames] = []
    for index, geom in enumerate(geoms):
        kind, material = int(model.geom_type[geom]), OPAQUE if materials is None else materials[geom]
        if kind == HFIELD and columns:
            kind, (pos, mat, size) = COLUMN_KIND, terrain_columns(model, geom)
        elif kind in (MESH, HFIELD):
            kind, (pos, mat, size) = TRIANGLE_KIND, triangles_of(model, geom, hull=columns)
        else:
            kind = FENDER_KIND if material == FENDER else kind
            pos, mat, size = np.zeros((1, 3)), np.eye(3)[None], model.geom_size[geom][None]
        owners.append((index, kind, material))
        frames.append((pos, mat, size))
    counts = [len(pos) for pos, _, _ in frames]
    stacked = [
        np.concatenate([frame[k] for frame in frames]) if frames else np.zeros((0, *shape))
        for k, shape in ((0, (3,)), (1, (3, 3)), (2, (3,)))
    ]
    return RayPrimitives(
        geom=np.repeat([owner[0] for owner in owners], counts).astype(int),
        kind=np.repeat([owner[1] for owner in owners], counts).astype(int),
        material=np.repeat(np.array([owner[2] for owner in owners], object), counts),
        pos=stacked[0].astype(np.float32),
        mat=stacked[1].astype(np.float32),
        size=stacked[2].astype(np.float32),
    )


def triangles_of(model: mujoco.MjModel, geom: int, *, hull: bool = False) -> Frames:
    """Return the triangles of a mesh or a terrain in its geom's frame, in the form of `TRIANGLE_KIND`.

    Args:
        model: The compiled model.
        geom: The geom's id.
        hull: Whether a mesh that is not convex is replaced by its hull.
    """
    data = int(model.geom_dataid[geom])
    if int(model.geom_type[geom]) == HFIELD:
        return triangle_frames(terrain_faces(*terrain_grid(model, data), model.hfield_size[data]))
    first, count = model.mesh_vertadr[data], model.mesh_vertnum[data]
    faces = model.mesh_face[model.mesh_faceadr[data] :][: model.mesh_facenum[data]]
    corners = model.mesh_vert[first : first + count].astype(float)
    found = triangle_frames(corners[faces])
    return found if not hull or _convex(found, corners) else triangle_frames(_hull_faces(corners))


def _convex(triangles: Frames, corners: np.ndarray) -> bool:
    """Return whether all corners (n, 3) lie behind the planes of all triangles."""
    first, mat, _ = triangles
    height = [((corners - origin) @ turn[:, 2]).max() for origin, turn in zip(first, mat, strict=True)]
    return max(height, default=0.0) <= FLATNESS * float(np.ptp(corners, 0).max())


def _hull_faces(corners: np.ndarray) -> np.ndarray:
    """Return the triangles of points' convex hull (triangles, 3, 3)."""
    from scipy.spatial import ConvexHull  # slow to import; only such meshes need it

    hull = ConvexHull(corners)
    triangles = corners[hull.simplices]
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    # Qhull orders the corners of its triangles arbitrarily.
    inward = (normal * hull.equations[:, :3]).sum(-1) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    return triangles


def triangle_frames(corners: np.ndarray) -> Frames:
    """Return the frames of triangles (n, 3, 3), corners counter-clockwise seen from outside.

    Triangles without an area are left out.
    """
    corners = np.asarray(corners, float)
    first, second, third = corners[:, 0], corners[:, 1], corners[:, 2]
    normal = np.cross(second - first, third - first)
    solid = np.linalg.norm(normal, axis=-1) > MIN_DOUBLE_AREA
    first, edge, other, normal = (x[solid] for x in (first, second - first, third - first, normal))
    length = np.linalg.norm(edge, axis=-1)
    z = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    x = edge / length[:, None]
    y = np.cross(z, x)
    # Three numbers are enough: the first corner is the origin, and the second lies on the x axis.
    size = np.stack([length, (other * x).sum(-1), (other * y).sum(-1)], -1)
    return first, np.stack([x, y, z], -1), size


def terrain_grid(model: mujoco.MjModel, data: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return x (columns,), y (rows,) and z (rows, columns) of a terrain's corners in its geom's frame [m]."""
    rows, columns = int(model.hfield_nrow[data]), int(model.hfield_ncol[data])
    half_x, half_y, top, _ = model.hfield_size[data].tolist()
    first = model.hfield_adr[data]
    # MuJoCo keeps heights from 0 to 1, and their scale apart.
    z = model.hfield_data[first : first + rows * columns].astype(float).reshape(rows, columns) * top
    return (
        np.linspace(-float(half_x), float(half_x), columns),
        np.linspace(-float(half_y), float(half_y), rows),
        z,
    )


def terrain_faces(x: np.ndarray, y: np.ndarray, z: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Return the corners (n, 3, 3) of a terrain's triangles: its surface, its four sides and its bottom."""
    grid = np.stack([*np.meshgrid(x, y), z], -1)
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    faces = [np.stack([a, b, c], -2).reshape(-1, 3, 3), np.stack([a, c, d], -2).reshape(-1, 3, 3)]
    for edge in (grid[0], grid[:, -1], grid[-1, ::-1], grid[::-1, 0]):  # counter-clockwise from above
        foot = edge * (1, 1, 0) - (0, 0, size[3])
        faces += [np.stack([foot[:-1], foot[1:], edge[1:]], 1), np.stack([foot[:-1], edge[1:], edge[:-1]], 1)]
    low = grid[[0, 0, -1, -1], [0, -1, -1, 0]] * (1, 1, 0) - (0, 0, size[3])
    faces.append(np.stack([low[[0, 2, 1]], low[[0, 3, 2]]]))
    return np.concatenate(faces)


def terrain_columns(model: mujoco.MjModel, geom: int) -> Frames:
    """Return a terrain as columns below its surface's triangles, in its geom's frame.

    A column's frame is not orthonormal: x and y run from 0 at its first corner to 1 at the other two (0 on
    the side between these: x + y = 1), z is the height above its top. The size: heights of the other two
    corners above the first, and the depth of the bottom below it [m].
    """
    data = int(model.geom_dataid[geom])
    x, y, z = terrain_grid(model, data)
    grid = np.stack([*np.meshgrid(x, y), z], -1)
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    first = np.concatenate([b.reshape(-1, 3), d.reshape(-1, 3)])
    second = np.concatenate([c.reshape(-1, 3), a.reshape(-1, 3)])
    third = np.concatenate([a.reshape(-1, 3), c.reshape(-1, 3)])
    edges = np.stack([second - first, third - first], -1)  # as columns
    basis = np.concatenate([edges, np.zeros((len(first), 3, 1))], -1)
    basis[:, 2, 2] = 1.0
    # Kernels multiply by the transpose, which has to be the inverse of the basis.
    mat = np.swapaxes(np.linalg.inv(basis), 1, 2)
    size = np.stack([edges[:, 2, 0], edges[:, 2, 1], first[:, 2] + model.hfield_size[data][3]], -1)
    return first, mat, size
