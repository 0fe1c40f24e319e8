"""Meshes and polygons as solids: convex pieces, hulls, round bodies, prisms; rooms of worlds as plates."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations
from pathlib import Path
from typing import Any, Literal

import numpy as np

from usarmjx.base.errors import ArenaFileError
from usarmjx.base.transforms import Vec3
from usarmjx.models.files.meshes import MAX_CONVEX_RATIO, MAX_FACES, MAX_VERTICES, mesh_objects
from usarmjx.models.files.mjcf_solids import Pose
from usarmjx.models.types.shapes import Mesh, Shape

MAX_CORNERS = 200
"""Largest number of corners of a polygon."""
FLAT = 1e-12
"""Twice the area below which three corners are on a line [m2]."""
PLATE_THICKNESS = 0.02
"""Thickness of a plate, inwards of its face [m]: a robot at 2 m/s moves a fifth of it in a step."""
MIN_PLATE_AREA = 1e-6
"""Area below which a face is left out [m2]."""
FLATNESS = 1e-3
"""Largest distance of faces that are joined from the plane of the largest of them [m]."""
Plate = tuple[Mesh, np.ndarray]
"""A convex plate, and the normal of its face (3,)."""
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


def convex_parts(corners: np.ndarray) -> list[np.ndarray]:
    """Cut a polygon (n, 2) without holes into convex ones, counter-clockwise; empty: it has no area.

    Raises:
        ValueError: Its edges cross, or it has too many corners.
    """
    if len(corners) > MAX_CORNERS:
        raise ValueError(f"a polygon of {len(corners)} corners; at most {MAX_CORNERS}")
    ring = _clean(corners)
    if len(ring) < 3:
        return []
    if _is_convex_polygon(ring):
        return [ring]
    parts = [list(part) for part in _triangles(ring)]
    return [ring[part] for part in _merged(ring, parts)]


def signed_area(ring: np.ndarray) -> float:
    """Return the area of a polygon (n, 2) [m2], above zero if it is counter-clockwise."""
    x, y = ring.T
    # The shoelace formula.
    return float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) / 2


def _cross(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    """Return twice the signed area of a triangle."""
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def _clean(corners: np.ndarray) -> np.ndarray:
    """Return a polygon counter-clockwise, without repeated corners and corners on a line."""
    ring = [np.asarray(corner, float) for corner in corners]
    # Without a corner others may lie on a line: again until none does.
    for _ in range(len(ring)):
        kept = [
            p for i, p in enumerate(ring) if abs(_cross(ring[i - 1], p, ring[(i + 1) % len(ring)])) > FLAT
        ]
        if len(kept) == len(ring) or len(kept) < 3:
            ring = kept
            break
        ring = kept
    if len(ring) < 3:
        return np.zeros((0, 2))
    found = np.array(ring)
    # Everything below takes left turns for convex.
    return found if signed_area(found) > 0 else found[::-1]


def _is_convex_polygon(ring: np.ndarray) -> bool:
    turns = [_cross(ring[i - 2], ring[i - 1], ring[i]) for i in range(len(ring))]
    if min(turns) < -FLAT:
        return False
    # The turns alone do not show a star: each of its corners turns left as well.
    way = np.diff(np.vstack([ring, ring[:1]]), axis=0)
    angles = np.unwrap(np.arctan2(way[:, 1], way[:, 0]))
    return angles[-1] - angles[0] < 2 * np.pi  # a star turns several times


def _triangles(ring: np.ndarray) -> list[tuple[int, int, int]]:
    """Return the triangles of a polygon, by their corners' numbers: ears are cut off until none is left."""
    left = list(range(len(ring)))
    found: list[tuple[int, int, int]] = []
    while len(left) > 3:
        ear = next((i for i in range(len(left)) if _is_ear(ring, left, i)), None)
        if ear is None:
            raise ValueError("a polygon whose edges cross")
        found.append((left[ear - 1], left[ear], left[(ear + 1) % len(left)]))
        del left[ear]
    return [*found, (left[0], left[1], left[2])]


def _is_ear(ring: np.ndarray, left: list[int], place: int) -> bool:
    before, here, after = left[place - 1], left[place], left[(place + 1) % len(left)]
    a, b, c = ring[before], ring[here], ring[after]
    # A reflex corner: its triangle lies outside of the polygon.
    if _cross(a, b, c) <= 0:
        return False
    others = ring[[i for i in left if i not in (before, here, after)]]
    inside = np.ones(len(others), bool)
    for start, end in ((a, b), (b, c), (c, a)):
        (dx, dy), away = end - start, others - start
        inside &= dx * away[:, 1] - dy * away[:, 0] >= 0
    return not inside.any()


def _merged(ring: np.ndarray, parts: list[list[int]]) -> list[list[int]]:
    """Join convex polygons over an edge that they share, edge by edge, where the joined one is convex."""
    owner = {edge: number for number, part in enumerate(parts) for edge in _edges(part)}
    # Inner edges belong to two triangles, in opposite directions; the outline's to one.
    for a, b in [edge for edge in owner if edge[0] < edge[1] and edge[::-1] in owner]:
        one, other = owner[a, b], owner[b, a]
        joined = _joined(parts[one], parts[other])
        if joined is not None and _is_convex_polygon(ring[joined]):
            parts[one], parts[other] = joined, []
            # The shared edge keeps its old owners, but is inside now and never asked for again.
            owner |= dict.fromkeys(_edges(joined), one)
    return [part for part in parts if part]


def _edges(part: list[int]) -> list[tuple[int, int]]:
    return [(part[k - 1], part[k]) for k in range(len(part))]


def _joined(one: list[int], other: list[int]) -> list[int] | None:
    """Return two counter-clockwise polygons that share an edge as one; None: they share none."""
    edges = {(other[k - 1], other[k]): k for k in range(len(other))}
    for k in range(len(one)):
        a, b = one[k - 1], one[k]
        if (b, a) in edges:
            place = edges[b, a]
            # The other one from behind that edge on, up to before it.
            rest = [other[(place + 1 + n) % len(other)] for n in range(len(other) - 2)]
            return [*one[:k], *rest, *one[k:]] if k else [*one, *rest]
    return None


def prism(corners: np.ndarray, low: float, high: float, like: Shape) -> Shape:
    """Return an upright prism on a convex polygon (n, 2), in the axes of `like`'s origin.

    A rectangle along the axes becomes a box.

    Args:
        corners: The polygon.
        low: Height of its foot [m].
        high: Height of its top [m].
        like: Its surface and colour; a pose is replaced.
    """
    low_corner, high_corner = corners.min(0), corners.max(0)
    middle = (low_corner + high_corner) / 2
    x, y = middle.tolist()
    at = (x, y, (low + high) / 2)
    half = (high_corner - low_corner) / 2
    if len(corners) == 4 and np.allclose(np.abs(corners - middle), half, rtol=0, atol=1e-9):
        size = (*half.tolist(), (high - low) / 2)
        return replace(like, kind="box", size=size, at=at, rotation=(0.0, 0.0, 0.0), mesh=None)
    flat = corners - middle
    rise = (high - low) / 2
    foot, top = (np.column_stack([flat, np.full(len(flat), z)]) for z in (-rise, rise))
    mesh = Mesh(np.vstack([foot, top]))
    return replace(like, kind="mesh", size=(), mesh=mesh, at=at, rotation=(0.0, 0.0, 0.0))


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
    # trimesh's facets have two faces at least: the single ones are left.
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
    # The largest face first: its normal is the most certain, and defines the plane.
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
        # Another area means a fold or an overlap: then every triangle is a plate of its own.
        if parts and abs(area - areas.sum()) < 1e-3 * areas.sum():
            return [_plate(back(part), normal) for part in parts]
    kept = triangles[areas >= MIN_PLATE_AREA]
    return [_plate(corners[triangle], normal) for triangle in kept]


def _outline(triangles: np.ndarray) -> list[int] | None:
    """Return the corners around joined triangles (n, 3) in order; None: a hole, or a corner twice."""
    edges = {(int(t[i]), int(t[(i + 1) % 3])) for t in triangles for i in range(3)}
    border = {a: b for a, b in edges if (b, a) not in edges}
    count = sum((b, a) not in edges for a, b in edges)
    # A corner that two edges of the border leave stands once in `border`, and twice in `count`.
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
    # The axis that the normal is least along: the product is far from zero.
    x = np.cross(normal, np.eye(3)[int(np.abs(normal).argmin())])
    x /= np.linalg.norm(x)
    axes = np.stack([x, np.cross(normal, x)])

    def back(flat: np.ndarray) -> np.ndarray:
        return middle + flat @ axes

    return (points - middle) @ axes.T, back


def _plate(corners: np.ndarray, normal: np.ndarray) -> Plate:
    return Mesh(np.vstack([corners, corners - PLATE_THICKNESS * normal])), normal


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
    # Qhull may succeed on a nearly flat mesh, whose hull MuJoCo then refuses.
    if hull.volume < MIN_THICKNESS**3:
        return _thickened(vertices)
    points = vertices[hull.vertices]
    # So few corners cost little: none has to go.
    if len(points) <= 8:
        return points
    # The extremes in 26 directions are the first hull, from which the distances of all others count.
    ways = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z])
    chosen = set(np.argmax(points @ ways.T, axis=0).tolist())
    while len(chosen) < MAX_HULL_CORNERS:
        index = sorted(chosen)
        try:
            inner = hull_of(points[index])
        except (QhullError, ValueError):
            # The extremes are flat though the mesh is not: any corners are better than these.
            return points[:MAX_HULL_CORNERS]
        outside = points @ inner.equations[:, :3].T + inner.equations[:, 3]
        worst = outside.max(1)
        if worst.max() <= HULL_TOLERANCE:
            break
        # The farthest corner of each face, the farthest of these first.
        fresh = {int(i) for i in outside.argmax(0) if worst[i] > HULL_TOLERANCE} - chosen
        room = MAX_HULL_CORNERS - len(chosen)
        # Half of them at a time: the near ones may lie within the hull of the far ones.
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
    # Closed over the full turn: the last gap is from the last corner to the first.
    gaps = np.diff(np.append(ordered, ordered[0] + 2 * math.pi))
    # A square has a rim of four corners at one radius: only enough of them all round make a circle.
    if len(ordered) < MIN_SIDES or gaps.max() > 2 * math.pi / MIN_SIDES + 1e-6:
        return None
    low, high = float(along.min()), float(along.max())
    middle = anchor + axis * (low + high) / 2
    return RoundSolid((radius, max((high - low) / 2, MIN_THICKNESS / 2), middle))


@lru_cache(maxsize=256)
def hull_mesh(content: bytes) -> Mesh:
    """Return the solid of a hull's corners, given as bytes of (n, 3) doubles: equal ones share it."""
    return Mesh(hull_corners(np.frombuffer(content).reshape(-1, 3)))


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
        # A file with a single object has its name left out (`mesh_objects`).
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
            # `<center>` of SDF puts the middle of the submesh's box at the origin.
            corners = corners - (corners.min(0) + corners.max(0)) / 2
        # A mirrored mesh has its faces inside out.
        if np.prod(scale) < 0:
            faces = faces[:, ::-1]
        called = f"{path.name}: {name}".rstrip(": ")
        for part in _parts(corners, faces):
            for piece in _pieces(part, called, use, notes):
                # A piece without faces is its hull, and MuJoCo has a cheaper kind for boxes.
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
    # Three edges at a corner add up to the way to the opposite one, the farthest.
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
        # Right-handed, whichever order the edges come in.
        axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
        return np.linalg.norm(edges, axis=1) / 2, Pose(corners.mean(0), axes)
    return None


def _parts(vertices: np.ndarray, faces: np.ndarray) -> list[Any]:
    """Return the connected parts of an object, all as one if they are many."""
    import trimesh

    # Without trimesh's processing, which would also drop faces and reorder vertices.
    mesh: Any = trimesh.Trimesh(vertices, faces, process=False)
    # Facets of STL files share no corners: each would be a part by itself.
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
        # A flat piece has to get a share of the object's mass as well.
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
    # Qhull succeeds on nearly flat corners too: relative to its size such a piece has no volume.
    return volume if volume > 1e-12 and volume > 1e-6 * float(size.max()) ** 3 else 0.0


def _is_convex(part: Any, volume: float) -> bool:  # noqa: ANN401 - Trimesh
    closed = bool(part.is_watertight and part.is_winding_consistent)
    return closed and volume <= MAX_CONVEX_RATIO * abs(float(part.volume))
