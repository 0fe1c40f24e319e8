"""Meshes of worlds as solids: convex pieces as they are, rooms as plates, small things as hulls."""

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations
from pathlib import Path
from typing import Any, Literal

import numpy as np

from usarmjx.base.errors import ArenaFileError
from usarmjx.base.transforms import Vec3
from usarmjx.models.files.mesh_solids import hull_corners
from usarmjx.models.files.meshes import MAX_CONVEX_RATIO, MAX_FACES, MAX_VERTICES, mesh_objects
from usarmjx.models.files.mjcf_solids import Pose
from usarmjx.models.files.plates import surface_plates
from usarmjx.models.types.shapes import Mesh

MAX_PARTS = 2000
"""Number of connected parts of an object from which they are taken as one."""
BOX_TOLERANCE = 1e-5
"""Distance of a corner from a box's, relative to its diagonal, up to which a solid is a box."""
SMALL = 0.3
"""Length up to which a part that is not convex is its hull [m]: no robot drives into it."""
MAX_PLATED_FACES = 2000
"""Number of faces up to which a part that is not convex is its faces as plates."""
FURNITURE = 3.0
"""Length up to which a part with more faces is its hull [m]; longer parts are left out."""
Use = Literal["fixed", "loose", "seen"]
"""Bodies and rays that meet a mesh: all, all while it moves, or rays only."""


@dataclass(frozen=True, eq=False)
class WorldPiece:
    """A convex solid of a mesh, or one that is only seen.

    Attributes:
        mesh: The solid.
        volume: Volume of its hull, for its share of a mass [m3].
        normal: Normal of a plate (3,); None: it is no plate.
        box: Half lengths and pose of a box; None: it is none.
    """

    mesh: Mesh
    volume: float
    normal: np.ndarray | None = None
    box: tuple[np.ndarray, Pose] | None = None


PiecesAndNotes = tuple[tuple[WorldPiece, ...], tuple[str, ...]]
"""The solids of a mesh, and notes."""


def world_pieces(path: Path, scale: Vec3, submesh: str, centred: bool, use: Use) -> PiecesAndNotes:
    """Return the solids of a mesh file, and what of it is left out or coarser than it, in words.

    Args:
        path: OBJ, STL or COLLADA file.
        scale: Factors of x, y and z.
        submesh: Name of the one object that is taken; empty: all.
        centred: Whether that object is moved to the middle of the box around it.
        use: Bodies and rays that meet it.

    Raises:
        ArenaFileError: An unreadable file.
    """
    try:
        stat = path.stat()
    except OSError as error:
        raise ArenaFileError(f"{path}: cannot be read: {error.strerror}") from error
    return _kept_pieces(path, (stat.st_mtime_ns, stat.st_size), scale, submesh, centred, use)


@lru_cache(maxsize=256)
def _kept_pieces(
    path: Path, state: tuple[int, int], scale: Vec3, submesh: str, centred: bool, use: Use
) -> PiecesAndNotes:
    """Return the pieces of a file in a state, its time and size: a world has a hundred chairs of one file."""
    del state
    objects = mesh_objects(path)
    if submesh:
        objects = [one for one in objects if one[0] in (submesh, "")] or [
            one for one in objects if one[0].startswith(submesh)
        ]
        if not objects:
            raise ArenaFileError(f"{path}: has no object {submesh!r}")
    pieces: list[WorldPiece] = []
    notes: list[str] = []
    for name, vertices, faces in objects:
        corners = vertices * np.asarray(scale)
        if centred and submesh:
            corners = corners - (corners.min(0) + corners.max(0)) / 2
        if np.prod(scale) < 0:
            faces = faces[:, ::-1]
        called = f"{path.name}: {name}".rstrip(": ")
        for part in _parts(corners, faces):
            for piece in _pieces(part, called, use, notes):
                pieces.append(
                    piece if piece.mesh.faces is not None else replace(piece, box=box_of(piece.mesh.vertices))
                )
    return tuple(pieces), tuple(dict.fromkeys(notes))


def box_of(corners: np.ndarray) -> tuple[np.ndarray, Pose] | None:
    """Return half lengths (3,) and pose of the box with these corners (8, 3); None: they are no box's."""
    if len(corners) != 8:
        return None
    way = corners[1:] - corners[0]
    lengths = np.linalg.norm(way, axis=1)
    close = BOX_TOLERANCE * float(lengths.max())
    for i, j, k in combinations(range(7), 3):
        if np.linalg.norm(way[i] + way[j] + way[k] - way[int(lengths.argmax())]) > close:
            continue
        edges = way[[i, j, k]]
        flat = np.abs(edges @ edges.T - np.diag(lengths[[i, j, k]] ** 2)).max()
        if flat > close * float(lengths.max()):
            continue
        made = corners[0] + np.array([np.array(bits) @ edges for bits in np.ndindex(2, 2, 2)])
        away = np.linalg.norm(made[:, None] - corners[None], axis=2)
        if max(away.min(0).max(), away.min(1).max()) > close:
            continue
        axes = (edges / np.linalg.norm(edges, axis=1, keepdims=True)).T
        axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
        return np.linalg.norm(edges, axis=1) / 2, Pose(corners.mean(0), axes)
    return None


def _parts(vertices: np.ndarray, faces: np.ndarray) -> list[Any]:
    """Return the connected parts of an object, all as one if they are many."""
    import trimesh

    mesh: Any = trimesh.Trimesh(vertices, faces, process=False)
    mesh.merge_vertices()
    mesh.update_faces(mesh.nondegenerate_faces())
    if not len(mesh.faces):
        return []
    graph: Any = trimesh.graph
    every = np.arange(len(mesh.faces))
    groups = graph.connected_components(mesh.face_adjacency, min_len=1, nodes=every, engine="scipy")
    if len(groups) == 1 or len(groups) > MAX_PARTS:
        return [mesh]
    return list(mesh.submesh(groups, append=False, repair=False))


def _pieces(part: Any, name: str, use: Use, notes: list[str]) -> list[WorldPiece]:  # noqa: ANN401 - Trimesh
    """Return the solids of a connected part."""
    corners = np.asarray(part.vertices, float)
    volume = _hull_volume(corners)
    if use == "seen":
        return _seen(part, corners, volume, name, notes)
    if use == "loose":
        return [WorldPiece(Mesh(hull_corners(corners)), max(volume, 1e-9))]
    if volume and _is_convex(part, volume):
        fine = corners if len(corners) <= MAX_VERTICES else hull_corners(corners)
        return [WorldPiece(Mesh(fine), volume)]
    length = float((corners.max(0) - corners.min(0)).max())
    count = len(part.faces)
    if length > SMALL and (count <= MAX_PLATED_FACES or (length > FURNITURE and count <= MAX_FACES)):
        return [WorldPiece(mesh, 0.0, normal) for mesh, normal in surface_plates(part)]
    if length > FURNITURE:
        notes.append(
            f"{name} has {count} faces and is {length:.3g} m long: left out; simplify it to {MAX_FACES} faces"
        )
        return []
    if length > SMALL:
        notes.append(f"{name}, {length:.3g} m long, with {count} faces: robots meet its hull, rays its faces")
    if not volume:
        return [WorldPiece(Mesh(hull_corners(corners)), 1e-9)]
    if count > MAX_FACES or length <= SMALL:
        return [WorldPiece(Mesh(hull_corners(corners)), volume)]
    return [WorldPiece(Mesh(corners, np.asarray(part.faces, np.int32)), volume)]


def _seen(
    part: Any,  # noqa: ANN401 - Trimesh
    corners: np.ndarray,
    volume: float,
    name: str,
    notes: list[str],
) -> list[WorldPiece]:
    """Return a part that only rays meet: its faces."""
    if not volume:
        return [WorldPiece(mesh, 0.0, normal) for mesh, normal in surface_plates(part)]
    if len(part.faces) > MAX_FACES:
        notes.append(f"{name} has {len(part.faces)} faces, over {MAX_FACES}: rays meet its hull")
        return [WorldPiece(Mesh(hull_corners(corners)), volume)]
    return [WorldPiece(Mesh(corners, np.asarray(part.faces, np.int32)), volume)]


def _hull_volume(corners: np.ndarray) -> float:
    """Return the volume of the hull of corners [m3]; 0: they are flat."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        volume = float(ConvexHull(corners).volume)
    except (QhullError, ValueError):
        return 0.0
    size = corners.max(0) - corners.min(0)
    return volume if volume > 1e-12 and volume > 1e-6 * float(size.max()) ** 3 else 0.0


def _is_convex(part: Any, volume: float) -> bool:  # noqa: ANN401 - Trimesh
    closed = bool(part.is_watertight and part.is_winding_consistent)
    return closed and volume <= MAX_CONVEX_RATIO * abs(float(part.volume))
