"""Mesh files (OBJ, STL, COLLADA) as convex solids, one for each connected piece; checks of their bytes.

Contacts and the radio treat a solid of kind mesh as the convex hull of its vertices. A piece that is not
convex is therefore refused, unless its hull is requested; rays and pictures then use its faces.

Readers of meshes skip or repair much of what is wrong: a file that is cut off would become another solid.
"""

import hashlib
import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np

from usarmjx.base.errors import ArenaFileError
from usarmjx.base.settings.files import read_bytes
from usarmjx.base.transforms import Vec3
from usarmjx.models.files.content import MAX_COORDINATE, surface_of
from usarmjx.models.files.reader_process import MeshArrays, read_mesh_objects
from usarmjx.models.types.shapes import Mesh, Shape

STL_HEADER_BYTES, STL_FACET_BYTES = 84, 50
"""Size of the header of a binary STL file, and of a facet [bytes]."""
STL_FACET_DTYPE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("colour", "<u2")])
"""Layout of a facet of a binary STL file."""
MAX_OUTLIER_RATIO = 1e6
"""Distance of a corner over the median of a file, beyond which it is corrupt."""
MIN_NORMAL_COSINE = 0.9
"""Smallest cosine between a facet's normal in a file and that of its corners."""
MAX_QUOTED = 40
"""Largest length of a quoted word in messages [characters]."""
BYTE_ORDER_MARKS = (b"\xff\xfe", b"\xfe\xff")
"""First bytes of a text in UTF-16."""
GEOMETRY_ID = re.compile(r"""<geometry\b[^>]*\bid\s*=\s*["']([^"']*)["']""")
GEOMETRY_PLACE = re.compile(r"""<instance_geometry\b[^>]*\burl\s*=\s*["']#?([^"']*)["']""")
INSTANCE_SKIN = "<instance_controller"
"""A mesh of a COLLADA file, a place where its scene has one, and the begin of one with bones."""
MAX_MESH_BYTES = 64_000_000
"""Largest size of a mesh file [bytes]."""
MAX_VERTICES = 200
"""Largest number of vertices of one solid's hull: MJX tests all of them in every contact."""
MAX_MESH_PIECES = 500
"""Largest number of pieces of one file."""
MAX_CONVEX_RATIO = 1.01
"""Ratio of the hull's volume to the piece's up to which a piece is convex."""
MIN_VOLUME = 1e-12
"""Smallest volume of a solid [m3]."""
MAX_FACES = 20_000
"""Largest number of faces of a piece that is not convex: rays test all of them."""
SeenBy = Literal["faces", "hull"]
"""Geometry of a piece that is not convex for rays and pictures."""
NO_MESH = Mesh(np.zeros((0, 3)))
"""Placeholder of a shape's mesh."""
ADVICE = (
    "cut it into convex pieces (with a tool as CoACD or V-HACD) and name their files under "
    "`decomposition`, or give `hull: true`: robots and radio meet its hull then, rays its faces"
)
"""Advice about pieces that are not convex, for messages."""


def check_mesh(path: Path, data: bytes) -> None:
    """Refuse a mesh file that is empty, cut off, or has no faces, wrong numbers or faces without vertices.

    Args:
        path: The file, for its kind and for messages.
        data: Its content.

    Raises:
        ArenaFileError: Names the error, and its line or facet.
    """
    if not data.strip():
        raise mesh_error(path, "it is empty, it has no faces")
    MESH_CHECKS[path.suffix.lower()](path, data)


def mesh_error(path: Path, text: str, line: int | None = None) -> ArenaFileError:
    """Return the error of an unreadable mesh file."""
    return ArenaFileError(f"{path}{'' if line is None else f':{line}'}: does not read as a mesh: {text}")


def _check_obj(path: Path, data: bytes) -> None:
    vertices, highest, faces = 0, (0, 0), 0
    for number, words in _logical_lines(data):
        if words[0] == b"v":
            _check_numbers(path, words[1:4], number)
            vertices += 1
        elif words[0] == b"f":
            faces += 1
            if len(words) < 4:
                raise mesh_error(path, f"a face with {len(words) - 1} corners; a face has at least 3", number)
            # Negative, so that of equal indices the first line is named.
            highest = max(highest, (max(_index(path, word, number) for word in words[1:]), -number))
    if not faces:
        raise mesh_error(path, "it has no faces")
    if highest[0] > vertices:
        raise mesh_error(path, f"face index {highest[0]}, but the file has {vertices} vertices", -highest[1])


def _logical_lines(data: bytes) -> Iterator[tuple[int, list[bytes]]]:
    """Yield number and words of lines that are not blank; a backslash joins one to the next."""
    joined = b""
    for number, line in enumerate(data.splitlines(), 1):
        if line.endswith(b"\\"):
            joined += line[:-1]
            continue
        if words := (joined + line).split():
            yield number, words
        joined = b""


def _index(path: Path, word: bytes, line: int) -> int:
    """Return a corner's vertex, counted from 1; from the end of the file if it is negative."""
    try:
        index = abs(int(word.partition(b"/")[0]))
    except ValueError:
        index = 0
    if index == 0:
        raise mesh_error(path, f"{_shown(word)} is no vertex's number", line)
    return index


def _check_numbers(path: Path, words: list[bytes], line: int) -> None:
    for word in words:
        try:
            fine = math.isfinite(float(word))
        except ValueError:
            fine = False
        if not fine:
            raise mesh_error(path, f"{_shown(word)} is not a number", line)
    if len(words) < 3:
        raise mesh_error(path, f"a vertex with {len(words)} numbers; vertices have three", line)


def _shown(word: bytes) -> str:
    text = word.decode("utf-8", "replace")
    return repr(text if len(text) <= MAX_QUOTED else text[:MAX_QUOTED] + "...")


def _check_stl(path: Path, data: bytes) -> None:
    # The header of a binary file ends with its number of facets.
    announced = int.from_bytes(data[STL_HEADER_BYTES - 4 : STL_HEADER_BYTES], "little")
    # The length decides first: binary files may begin with the word "solid", too.
    if len(data) >= STL_HEADER_BYTES and len(data) == STL_HEADER_BYTES + STL_FACET_BYTES * announced:
        _check_facets(path, np.frombuffer(data, STL_FACET_DTYPE, announced, STL_HEADER_BYTES))
        return
    if b"\0" not in data and b"solid" in data[:1000].lower():
        _check_text(path, data)
        return
    if len(data) < STL_HEADER_BYTES:
        raise mesh_error(
            path, f"it is neither text nor as long as the header of a binary file, {STL_HEADER_BYTES} bytes"
        )
    whole = (len(data) - STL_HEADER_BYTES) // STL_FACET_BYTES
    said = f"it announces {announced} facets"
    if whole < announced:
        raise mesh_error(path, f"{said} and is cut off in facet {whole + 1}")
    raise mesh_error(
        path, f"{said}, and {len(data) - STL_HEADER_BYTES - STL_FACET_BYTES * announced} bytes follow them"
    )


def _check_facets(path: Path, facets: np.ndarray) -> None:
    """Check the facets of a binary file."""
    if not len(facets):
        raise mesh_error(path, "it has no faces")
    wrong = np.flatnonzero(~np.isfinite(facets["corners"]).all(axis=(1, 2)))
    if len(wrong):
        raise mesh_error(path, f"facet {wrong[0] + 1} has a corner that is not finite")


def find_corrupt_facet(path: Path, data: bytes) -> str:
    """Return in words the first suspect facet of a binary STL file; "" if there is none.

    For files that are readable but make no solid: a facet is suspect that has no area, one corner far from
    all others, or a normal unlike that of its corners in a file whose other normals agree.
    """
    announced = int.from_bytes(data[STL_HEADER_BYTES - 4 : STL_HEADER_BYTES], "little")
    if path.suffix.lower() != ".stl" or len(data) != STL_HEADER_BYTES + STL_FACET_BYTES * announced:
        return ""
    facets = np.frombuffer(data, STL_FACET_DTYPE, announced, STL_HEADER_BYTES)
    corners, said = facets["corners"].astype(float), facets["normal"].astype(float)
    reach = np.abs(corners).max(axis=(1, 2))
    usual = float(np.median(reach))
    # The median is not moved by the corrupt corner itself.
    if reach.max() > MAX_OUTLIER_RATIO * max(usual, 1e-9):
        return (
            f"facet {reach.argmax() + 1} has a corner {reach.max():.3g} m away, most are within {usual:.3g}"
        )
    # Twice the area of the triangle long, along the side from which its corners run counter-clockwise.
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area, length = np.linalg.norm(normal, axis=1), np.linalg.norm(said, axis=1)
    if not area.all():
        return f"facet {area.argmin() + 1} has no area"
    unlike = (length > 0) & ((normal * said).sum(1) < MIN_NORMAL_COSINE * area * length)
    # Files whose normals are all zero or all reversed are common, and no damage.
    if 0 < unlike.sum() < announced / 2:
        return f"facet {unlike.argmax() + 1} has another normal than its corners"
    return ""


def _check_text(path: Path, data: bytes) -> None:
    """Check the facets of a text file, which may have any line breaks."""
    facet, corners, line, open_facet, ended = 0, 0, 1, False, False
    words = _words(data)
    for line, word in words:
        if word == b"facet":
            if open_facet:
                raise mesh_error(path, f"facet {facet} does not end before the next one", line)
            facet, corners, open_facet = facet + 1, 0, True
        elif word == b"vertex":
            corners += 1
            # Behind the end of the file words are empty, which are refused as numbers.
            _check_numbers(path, [next(words, (line, b""))[1] for _ in range(3)], line)
        elif word == b"endfacet":
            if corners != 3:
                raise mesh_error(path, f"facet {facet} has {corners} corners; facets have 3", line)
            open_facet = False
        elif word == b"endsolid":
            ended = True
    if open_facet or not ended:
        where = f"in facet {facet}" if open_facet else f"after facet {facet}: it has no endsolid"
        raise mesh_error(path, f"it is cut off {where}", line)
    if not facet:
        raise mesh_error(path, "it has no faces")


def _words(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield line number and word, without the names of solids."""
    for number, line in enumerate(data.lower().splitlines(), 1):
        words = line.split()
        # A solid's name may be any words, "facet" and "vertex" among them.
        named = words[:1] in ([b"solid"], [b"endsolid"]) and b"normal" not in words
        for word in words[:1] if named else words:
            yield number, word


def _check_dae(path: Path, data: bytes) -> None:
    """Refuse what is no COLLADA or places no mesh; a document type's entities could expand exponentially."""
    # Latin-1 decodes any bytes: the checks below need ASCII words only, whatever the encoding.
    text = data.decode("utf-16" if data.startswith(BYTE_ORDER_MARKS) else "latin-1", "replace")
    if "<collada" not in text[:4096].lower():
        raise mesh_error(path, "it is no COLLADA: its root is not <COLLADA>")
    if "<!doctype" in text.lower():
        raise mesh_error(path, "it defines a document type (<!DOCTYPE>); meshes have none")
    known = set(GEOMETRY_ID.findall(text))
    placed = [(found.start(), found[1]) for found in GEOMETRY_PLACE.finditer(text)]
    if not placed:
        skins = " but skins of <instance_controller>, which are not read" if INSTANCE_SKIN in text else ""
        raise mesh_error(path, f"its scene places no <geometry>{skins}")
    for start, name in placed:
        if name not in known:
            line = text.count("\n", 0, start) + 1
            raise mesh_error(path, f"it has no <geometry> of id {name[:MAX_QUOTED]!r}", line)


def _check_ply(path: Path, data: bytes) -> None:
    """Refuse what has no PLY header, or announces no faces."""
    # Headers are a few lines of text: a body of megabytes is not searched for its end.
    head, ended, _ = data[:100_000].partition(b"end_header")
    if not head.startswith(b"ply") or not ended:
        raise mesh_error(path, "it is no PLY: it has no header from ply to end_header")
    counts = {
        words[1]: words[2]
        for words in map(bytes.split, head.splitlines())
        if len(words) == 3 and words[0] == b"element"
    }
    for name in (b"vertex", b"face"):
        count = counts.get(name, b"0")
        # An element takes a byte at least: a larger number would make its reader allocate without end.
        if not count.isdigit() or not 0 < int(count) <= len(data):
            raise mesh_error(path, f"it announces {_shown(count)} elements {name.decode()}")


def _check_glb(path: Path, data: bytes) -> None:
    """Refuse what is no binary glTF of the length that it announces."""
    # The header of binary glTF: a magic word, the version, and the length of the whole file [bytes].
    if data[:4] != b"glTF" or int.from_bytes(data[8:12], "little") != len(data):
        raise mesh_error(path, "it is no binary glTF of the length that it announces")


MESH_CHECKS: dict[str, Callable[[Path, bytes], None]] = {
    ".obj": _check_obj,
    ".stl": _check_stl,
    ".dae": _check_dae,
    ".ply": _check_ply,
    ".glb": _check_glb,
}
"""Check of each kind of mesh files, by their suffix."""


@dataclass(frozen=True, eq=False)
class ConvexPiece:
    """A connected piece of a mesh.

    Attributes:
        name: Name in errors.
        corners: Corners of its convex hull [m] (n, 3).
        volume: Volume of the hull [m3].
        seen: Geometry for rays of a piece that is not convex; None: its hull.
    """

    name: str
    corners: np.ndarray
    volume: float
    seen: Mesh | None = None

    @property
    def mesh(self) -> Mesh:
        """The solid."""
        return self.seen or Mesh(self.corners)


def load_convex_pieces(
    path: Path, scale: Sequence[float] = (1.0, 1.0, 1.0), *, hull: bool = False, rays: SeenBy = "faces"
) -> list[ConvexPiece]:
    """Return the convex pieces of a mesh file: one for each object, and each connected part of it.

    Args:
        path: OBJ, STL or COLLADA file; its axes are used unchanged, z up.
        scale: Factors of x, y and z.
        hull: Whether to replace pieces that are not convex by their hulls.
        rays: Geometry of such pieces for rays.

    Raises:
        ArenaFileError: A file that is unreadable or corrupt; a piece that is not closed or not convex, flat,
            or
            that has too many vertices; names it.
    """
    x, y, z = scale
    # Pieces are cached by content: a file that changes while a program runs is read again.
    digest = _checked_file(path)
    try:
        return [*_pieces_of(path, digest, (x, y, z), hull, rays)]
    except ArenaFileError as error:
        if suspect := find_corrupt_facet(path, read_bytes(path, MAX_MESH_BYTES, ArenaFileError)):
            raise ArenaFileError(f"{path} is corrupt: {suspect}") from error
        raise


@lru_cache(maxsize=64)
def _pieces_of(path: Path, digest: bytes, scale: Vec3, hull: bool, rays: SeenBy) -> tuple[ConvexPiece, ...]:
    """Return the pieces of a file, cached by its content: a building has a hundred doors of one file."""
    found: list[ConvexPiece] = []
    for name, vertices, faces in _objects(path):
        called = f"{path}: {name}".rstrip(": ")
        found += convex_pieces(vertices * np.asarray(scale), faces, called, hull=hull, rays=rays)
        if len(found) > MAX_MESH_PIECES:
            raise ArenaFileError(f"{path}: more than {MAX_MESH_PIECES} pieces; give it in several files")
    return tuple(found)


def vertices_of_file(path: Path) -> np.ndarray:
    """Return all vertices of a mesh file in its order [m] (n, 3): those of one convex solid.

    Raises:
        ArenaFileError: A file that is unreadable, or has too many vertices.
    """
    return checked_corners(mesh_vertices(path), str(path))


def mesh_vertices(path: Path) -> np.ndarray:
    """Return all vertices of a mesh file's faces (n, 3), z up, in the file's metres, as many as there are.

    Raises:
        ArenaFileError: A file that is missing, unreadable, too large or corrupt.
    """
    _checked_file(path)
    return np.concatenate([vertices for _, vertices, _ in _objects(path)])


def mesh_objects(path: Path) -> list[MeshArrays]:
    """Return name, vertices (n, 3) and faces (m, 3) of a mesh file's objects, as many as there are.

    Raises:
        ArenaFileError: A file that is missing, unreadable, too large or corrupt, or reaches too far.
    """
    _checked_file(path)
    found = [*_objects(path)]
    for name, vertices, _ in found:
        _check_reach(vertices, f"{path}: {name}".rstrip(": "))
    return found


def faces_of_file(path: Path) -> Mesh:
    """Return all vertices and faces of a mesh file in its order: a solid whose faces rays meet.

    Raises:
        ArenaFileError: A file that is unreadable, or has too many faces or vertices of its hull.
    """
    _checked_file(path)
    vertices, faces, before = list[np.ndarray](), list[np.ndarray](), 0
    for _, own, found in _objects(path):
        vertices.append(own)
        # Faces count the vertices of their own object; here all objects share one array.
        faces.append(found + before)
        before += len(own)
    corners, triangles = np.concatenate(vertices), np.concatenate(faces).astype(np.int32)
    _check_reach(corners, str(path))
    checked_corners(_hull(corners, str(path))[0], f"{path}: its hull")
    _check_faces(len(triangles), str(path))
    return Mesh(corners, triangles)


def checked_corners(vertices: np.ndarray, name: str) -> np.ndarray:
    """Return the vertices of a solid (n, 3) if they are valid.

    Raises:
        ArenaFileError: They lie in a plane or too far away, or are too many.
    """
    if len(vertices) > MAX_VERTICES:
        raise ArenaFileError(f"{name}: {len(vertices)} vertices; a solid has at most {MAX_VERTICES}")
    _check_reach(vertices, name)
    _hull(vertices, name)
    return vertices


def _check_reach(vertices: np.ndarray, name: str) -> None:
    farthest = float(np.abs(vertices).max(initial=0.0))
    # In this form: NaN is refused as well.
    if not farthest <= MAX_COORDINATE:
        raise ArenaFileError(
            f"{name} reaches {farthest:g} m from its origin, at most {MAX_COORDINATE:g}; mind `scale`"
        )


def convex_pieces(
    vertices: np.ndarray, faces: np.ndarray, name: str, *, hull: bool = False, rays: SeenBy = "faces"
) -> list[ConvexPiece]:
    """Return the connected pieces of a mesh (n, 3), (m, 3) as convex solids; see `load_convex_pieces`."""
    import trimesh

    _check_reach(vertices, name)
    mesh: Any = trimesh.Trimesh(vertices, faces, process=False)
    graph: Any = trimesh.graph
    # Files of facets repeat each corner: without merging, every facet would be a piece of its own.
    mesh.merge_vertices()
    every = np.arange(len(mesh.faces))
    # All faces are nodes, and min_len is 1: a single face is a piece too, and none gets lost.
    groups = graph.connected_components(mesh.face_adjacency, min_len=1, nodes=every, engine="scipy")
    if len(groups) > MAX_MESH_PIECES:
        raise ArenaFileError(f"{name}: {len(groups)} pieces; at most {MAX_MESH_PIECES}")
    # Without repair: holes are refused below instead of closed by a guess.
    parts = mesh.submesh(groups, append=False, repair=False)
    names = (
        [name] if len(parts) == 1 else [f"{name}, piece {i + 1} of {len(parts)}" for i in range(len(parts))]
    )
    return [_piece(part, called, hull, rays) for part, called in zip(parts, names, strict=True)]


def _piece(part: Any, name: str, hull: bool, rays: SeenBy) -> ConvexPiece:  # noqa: ANN401 - trimesh.Trimesh
    corners, volume = _hull(np.asarray(part.vertices), name)
    seen = hull and rays == "faces"
    if not hull:
        if not part.is_watertight:
            raise ArenaFileError(f"{name} is not closed, so it has no inside: close it; or {ADVICE}")
        if not part.is_winding_consistent:
            raise ArenaFileError(f"{name} has faces that turn either way round: recalculate its normals")
        # Negative where all faces point inwards, which does no harm.
        own = abs(float(part.volume))
        if volume > MAX_CONVEX_RATIO * own:
            filled = f"its hull has {volume:.4g} m3, itself {own:.4g}"
            raise ArenaFileError(f"{name} is not convex ({filled}): {ADVICE}")
    if len(corners) > MAX_VERTICES:
        raise ArenaFileError(
            f"{name} has a hull with {len(corners)} vertices, at most {MAX_VERTICES} are allowed: "
            "simplify it (Blender's Decimate, MeshLab's quadric edge collapse)"
        )
    return ConvexPiece(name, corners, volume, _faces_of(part, name, volume) if seen else None)


def _faces_of(part: Any, name: str, volume: float) -> Mesh | None:  # noqa: ANN401 - trimesh.Trimesh
    """Return a piece with its faces; None if it is convex."""
    if (
        part.is_watertight
        and part.is_winding_consistent
        and volume <= MAX_CONVEX_RATIO * abs(float(part.volume))
    ):
        return None
    _check_faces(len(part.faces), name)
    return Mesh(np.asarray(part.vertices, float), np.asarray(part.faces, np.int32))


def _check_faces(count: int, name: str) -> None:
    if count > MAX_FACES:
        raise ArenaFileError(
            f"{name} is not convex and has {count} faces, at most {MAX_FACES} are allowed: "
            "simplify it, or let rays meet its hull too (`rays: hull`)"
        )


def _hull(vertices: np.ndarray, name: str) -> tuple[np.ndarray, float]:
    """Return the vertices of the convex hull, in their order, and its volume."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(vertices)
    except (QhullError, ValueError):
        raise ArenaFileError(f"{name} is flat or has fewer than four corners: it is no solid") from None
    if hull.volume < MIN_VOLUME:
        raise ArenaFileError(f"{name} has a volume of {hull.volume:.2g} m3: it is no solid; mind `scale`")
    return vertices[np.sort(hull.vertices)], float(hull.volume)


def _checked_file(path: Path) -> bytes:
    """Check a mesh file for defects; return a digest of its content."""
    if path.suffix.lower() not in MESH_CHECKS:
        raise ArenaFileError(f"{path}: meshes are {' or '.join(MESH_CHECKS)} files")
    if not path.is_file():
        raise ArenaFileError(f"{path}: there is no such mesh file")
    data = read_bytes(path, MAX_MESH_BYTES, ArenaFileError)
    check_mesh(path, data)
    return hashlib.blake2b(data).digest()


def _objects(path: Path) -> Iterator[MeshArrays]:
    """Yield name, vertices and faces of a file's objects."""
    found = [one for one in read_mesh_objects(path) if len(one[2])]
    if not found:
        raise mesh_error(path, "it has no faces")
    if any(vertices.shape[1:] != (3,) or not np.isfinite(vertices).all() for _, vertices, _ in found):
        raise mesh_error(path, "vertices are three finite numbers each")
    for name, vertices, faces in found:
        # Vertices without a face would be corners of the hull.
        used, indices = np.unique(faces, return_inverse=True)
        if used[0] < -len(vertices) or used[-1] >= len(vertices):
            raise mesh_error(path, f"faces have vertices {used[0]} to {used[-1]} of {len(vertices)}")
        # NumPy 1 returns the inverse flat, NumPy 2.0 in the shape of the input.
        yield (name if len(found) > 1 else ""), vertices[used], indices.reshape(faces.shape)


def shapes_of(found: Sequence[ConvexPiece], like: Shape, mass: float = 0.0) -> tuple[Shape, ...]:
    """Return pieces as shapes with the pose of `like`, sharing a mass by volume.

    A piece gets a surface by its form if `like` has none ("").
    """
    whole = sum(piece.volume for piece in found)
    shapes = [replace(like, mesh=piece.mesh, mass=mass * piece.volume / whole) for piece in found]
    return tuple(replace(s, surface=s.surface or surface_of(s)) for s in shapes)
