"""Surfaces of meshes that are no convex solids, as thin plates: buildings, which have an inside."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from usarmjx.models.files.polygons import convex_parts, signed_area
from usarmjx.models.types.shapes import Mesh

PLATE_THICKNESS = 0.02
"""Thickness of a plate, inwards of its face [m]: a robot at 2 m/s moves a fifth of it in a step."""
MIN_PLATE_AREA = 1e-6
"""Area below which a face is left out [m2]."""
FLATNESS = 1e-3
"""Largest distance of faces that are joined from the plane of the largest of them [m]."""


Plate = tuple[Mesh, np.ndarray]
"""A convex plate, and the normal of its face (3,)."""


def surface_plates(mesh: Any) -> list[Plate]:  # noqa: ANN401 - trimesh.Trimesh
    """Return a mesh's faces as convex plates; faces in one plane that touch are joined if that is convex."""
    plates: list[Plate] = []
    joined = np.zeros(len(mesh.faces), bool)
    beside: dict[int, list[int]] = {}
    for one, other in np.asarray(mesh.face_adjacency).tolist():
        beside.setdefault(one, []).append(other)
        beside.setdefault(other, []).append(one)
    for facet in mesh.facets:
        joined[np.asarray(facet)] = True
        for faces in _flat_groups(mesh, np.asarray(facet), beside):
            plates += _of_plane(mesh, faces)
    for face in np.flatnonzero(~joined):
        plates += _of_plane(mesh, np.array([face]))
    return plates


def _flat_groups(
    mesh: Any,  # noqa: ANN401 - trimesh.Trimesh
    facet: np.ndarray,
    beside: dict[int, list[int]],
) -> Iterator[np.ndarray]:
    """Yield the faces of a facet in groups that lie in one plane each: trimesh joins those of gentle hills.

    Args:
        mesh: The mesh.
        facet: Faces that trimesh takes for those of one plane (n,).
        beside: Faces that share an edge, by face.
    """
    corners, areas = np.asarray(mesh.triangles, float), np.asarray(mesh.area_faces)
    normals = np.asarray(mesh.face_normals, float)
    order: list[int] = facet[np.argsort(-areas[facet], kind="stable")].tolist()
    waiting = set(order)
    for seed in order:
        if seed not in waiting:
            continue
        waiting.discard(seed)
        group = [seed]
        for face in group:  # which grows
            near = [other for other in beside.get(face, ()) if other in waiting]
            for other in near:
                if np.abs((corners[other] - corners[seed, 0]) @ normals[seed]).max() <= FLATNESS:
                    waiting.discard(other)
                    group.append(other)
        yield np.array(group)


def _of_plane(mesh: Any, faces: np.ndarray) -> list[Plate]:  # noqa: ANN401 - trimesh.Trimesh
    """Return the plates of faces (n,) in one plane."""
    areas = np.asarray(mesh.area_faces)[faces]
    if areas.sum() < MIN_PLATE_AREA:
        return []
    normal = np.asarray(mesh.face_normals)[faces[int(areas.argmax())]].astype(float)
    corners = np.asarray(mesh.vertices, float)
    triangles = np.asarray(mesh.faces)[faces]
    ring = _outline(triangles)
    if ring is not None:
        flat, back = _flattened(corners[ring], normal)
        try:
            parts = convex_parts(flat)
        except ValueError:
            parts = []
        area = sum(map(signed_area, parts))
        if parts and abs(area - areas.sum()) < 1e-3 * areas.sum():
            return [_plate(back(part), normal) for part in parts]
    kept = triangles[areas >= MIN_PLATE_AREA]
    return [_plate(corners[triangle], normal) for triangle in kept]


def _outline(triangles: np.ndarray) -> list[int] | None:
    """Return the corners around joined triangles (n, 3) in order; None: a hole, or a corner twice."""
    edges = {(int(t[i]), int(t[(i + 1) % 3])) for t in triangles for i in range(3)}
    border = {a: b for a, b in edges if (b, a) not in edges}
    count = sum((b, a) not in edges for a, b in edges)
    if not border or len(border) != count:
        return None
    first = next(iter(border))
    ring, here = [first], border[first]
    while here != first:
        if here not in border or len(ring) > count:
            return None
        ring.append(here)
        here = border[here]
    return ring if len(ring) == count else None


def _flattened(points: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, Any]:
    """Return points of a plane as (n, 2), and the function that brings such points back as (n, 3)."""
    middle = points.mean(0)
    x = np.cross(normal, np.eye(3)[int(np.abs(normal).argmin())])
    x /= np.linalg.norm(x)
    axes = np.stack([x, np.cross(normal, x)])

    def back(flat: np.ndarray) -> np.ndarray:
        return middle + flat @ axes

    return (points - middle) @ axes.T, back


def _plate(corners: np.ndarray, normal: np.ndarray) -> Plate:
    return Mesh(np.vstack([corners, corners - PLATE_THICKNESS * normal])), normal
