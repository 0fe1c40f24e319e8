"""Checks of the bytes of mesh files (OBJ, STL, COLLADA, PLY, GLB), so that errors name line or facet.

Readers of meshes skip or repair much of what is wrong: a file that is cut off would become another solid.
"""

import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from usarmjx.base.errors import ArenaFileError

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
    if reach.max() > MAX_OUTLIER_RATIO * max(usual, 1e-9):
        return (
            f"facet {reach.argmax() + 1} has a corner {reach.max():.3g} m away, most are within {usual:.3g}"
        )
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area, length = np.linalg.norm(normal, axis=1), np.linalg.norm(said, axis=1)
    if not area.all():
        return f"facet {area.argmin() + 1} has no area"
    unlike = (length > 0) & ((normal * said).sum(1) < MIN_NORMAL_COSINE * area * length)
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
        named = words[:1] in ([b"solid"], [b"endsolid"]) and b"normal" not in words
        for word in words[:1] if named else words:
            yield number, word


def _check_dae(path: Path, data: bytes) -> None:
    """Refuse what is no COLLADA or places no mesh; a document type's entities could expand exponentially."""
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
        if not count.isdigit() or not 0 < int(count) <= len(data):
            raise mesh_error(path, f"it announces {_shown(count)} elements {name.decode()}")


def _check_glb(path: Path, data: bytes) -> None:
    """Refuse what is no binary glTF of the length that it announces."""
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
