"""Arenas from files, and to files.

`load_arena` reads YAML files with the fields of `ArenaSpec` and the names of other files (see `yaml_file`),
and these others by themselves: worlds of Gazebo and Stage, SDF, MJCF, URDF, meshes, grey images, maps of ROS'
map_server and of MovingAI, route networks. `save_arena` writes any arena as YAML. Unsupported content of a
file is refused by name, or left out with a warning.
"""

import logging
from collections.abc import Callable, Iterable, Sequence
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import yaml

from usarmjx.base.errors import ArenaFileError, UnknownNameError
from usarmjx.base.files import atomic_write
from usarmjx.base.registry import unknown_name
from usarmjx.base.settings import FileValue
from usarmjx.base.settings.files import read_bytes
from usarmjx.base.settings.yaml_file import read_yaml
from usarmjx.models.arenas import ARENAS
from usarmjx.models.arenas.lanes import LANE_PREFIX, LANES
from usarmjx.models.files.content import EMPTY_EXTENT, Content
from usarmjx.models.files.images import image_size, write_heights
from usarmjx.models.files.maps import check_picture, is_map, moving_ai_content, occupancy_grid_content
from usarmjx.models.files.mesh_solids import world_pieces
from usarmjx.models.files.mjcf import mjcf_content
from usarmjx.models.files.mjcf_solids import Pose
from usarmjx.models.files.resources import Resources
from usarmjx.models.files.roads_file import is_route_network, roads_content
from usarmjx.models.files.sdf import sdf_content
from usarmjx.models.files.sdf_solids import placed_pieces
from usarmjx.models.files.sdf_tree import SDF_ROOTS
from usarmjx.models.files.stage import stage_content
from usarmjx.models.files.urdf import urdf_content
from usarmjx.models.files.xml_file import root_tag
from usarmjx.models.files.yaml_file import (
    MeshFile,
    TerrainFile,
    arena_of_yaml,
    complete_arena,
    mesh_content,
    scale_notes,
    terrain_content,
)
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.shapes import HeightField, Mesh, Shape

logger = logging.getLogger(__name__)

HEADER = "# An arena of usarmjx. Lengths in metres, angles in radians; x forward, y left, z up.\n"
"""Comment at the top of saved files."""
WIDTH = 110
"""Line length of saved files."""

PIXEL_SIZE = 0.1
"""Spacing of the heights in a grey image that is loaded by itself [m]."""

WHITE_HEIGHT = 1.0
"""Height of white in it [m]."""

YAML = (".yaml", ".yml")


def save_arena(arena: ArenaSpec, path: str | Path) -> Path:
    """Write an arena as a YAML file that `load_arena` reads as an equal one; return its path.

    Meshes go into OBJ files beside it, terrain into PNG files of 16 bits, whose heights are rounded to a
    65535th of the highest one. All other numbers are kept to the last digit.

    Raises:
        ArenaFileError: A name that does not end in .yaml, or a missing folder.
        WriteError: The folder cannot be written to.
    """
    path = Path(path)
    if path.suffix.lower() not in (".yaml", ".yml"):
        raise ArenaFileError(f"{path}: arenas are saved as .yaml files")
    if not path.parent.is_dir():
        raise ArenaFileError(f"{path}: cannot be written: No such file or directory")
    plain = _Files(path).plain(arena)
    # ASCII: files then read the same whatever encoding an editor assumes.
    text = yaml.safe_dump(plain, default_flow_style=None, sort_keys=False, width=WIDTH, allow_unicode=False)
    with atomic_write(path) as fresh:
        fresh.write_text(HEADER + text, encoding="utf-8")
    return path


class _Files:
    """Converter of values to YAML's types, which writes the files that they name.

    Args:
        path: The YAML file; the others are beside it and begin with its stem.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._known: dict[int, object] = {}

    def plain(self, value: Any) -> Any:  # noqa: ANN401 - any field's value
        """Return a value as mappings, lists and scalars; fields that have their defaults are left out."""
        if isinstance(value, (Mesh, HeightField)):
            # By identity: several solids share one mesh, and comparing arrays would be slow.
            if id(value) not in self._known:
                self._known[id(value)] = _write(value, self._path, len(self._known))
            return self._known[id(value)]
        if is_dataclass(value):
            pairs = [(field, getattr(value, field.name)) for field in fields(value)]
            return {
                field.name: self.plain(held)
                for field, held in pairs
                if field.default is MISSING or held != field.default
            }
        if isinstance(value, (tuple, list)):
            return [self.plain(item) for item in cast("Sequence[object]", value)]
        # PyYAML's safe dump refuses NumPy's scalars.
        return cast("Any", value).item() if isinstance(value, np.generic) else value


def _write(value: Mesh | HeightField, path: Path, number: int) -> object:
    return (
        _write_mesh(value, path, number) if isinstance(value, Mesh) else _write_terrain(value, path, number)
    )


def _write_mesh(mesh: Mesh, path: Path, number: int) -> str | dict[str, str]:
    """Write the vertices and the faces, its own or those of their hull; return its YAML value."""
    vertices = np.asarray(mesh.vertices, float)
    # repr of a float reads back to the same bits.
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    if mesh.faces is None:
        lines += _hull_lines(vertices)
    else:
        # OBJ counts vertices from 1.
        lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + 1).tolist()]
    name = f"{path.stem}-mesh-{number}.obj"
    with atomic_write(path.parent / name) as fresh:
        fresh.write_text("\n".join(lines) + "\n", encoding="ascii")
    return {"file": name, "rays": "faces"} if mesh.faces is not None else name


def _hull_lines(vertices: np.ndarray) -> list[str]:
    """Return the faces of vertices' hull as lines of an OBJ file."""
    from scipy.spatial import ConvexHull

    hull, lines = ConvexHull(vertices), list[str]()
    for (a, b, c), outward in zip(hull.simplices.tolist(), hull.equations[:, :3], strict=True):
        normal = np.cross(vertices[b] - vertices[a], vertices[c] - vertices[a])
        # Qhull's simplices have corners in any order; faces show their outside by the order.
        first, second = (b, c) if normal @ outward > 0 else (c, b)
        lines.append(f"f {a + 1} {first + 1} {second + 1}")
    return lines


def _write_terrain(terrain: HeightField, path: Path, number: int) -> dict[str, object]:
    """Write heights as grey values; return the file's name and the height of white."""
    name = f"{path.stem}-heights-{number}.png"
    return {"file": name, "height": write_heights(path.parent / name, terrain.heights)}


def load_arena(path: str | Path, *, packages: Iterable[str | Path] = ()) -> ArenaSpec:
    """Return the arena in a file; content that is left out is logged as warnings.

    By itself, a file of SDF, Stage, MJCF, URDF or meshes is used unchanged, a grey PNG image is terrain with
    heights 0.1 m apart and up to 1 m, maps have walls of 1.2 m, and cells of MovingAI's have a side of 1 m.
    Then the arena has the file's name, an extent 1 m around its solids (a map's is the map's), and the file's
    start poses or one in its largest free area; a YAML file can set all of these.

    Args:
        path: The file.
        packages: Folders in which packages and models are searched first.

    Raises:
        ArenaFileError: A missing or unreadable file, or content that an arena cannot have.
    """
    arena, warnings = read_arena(path, packages=packages)
    for warning in warnings:
        logger.warning("%s", warning)
    return arena


def read_arena(path: str | Path, *, packages: Iterable[str | Path] = ()) -> tuple[ArenaSpec, tuple[str, ...]]:
    """Return the arena in a file, and the content that was left out, in words; see `load_arena`."""
    path = Path(path)
    resources = Resources(folders=tuple(Path(folder) for folder in packages))
    if path.suffix.lower() not in (*YAML, *READERS):
        raise ArenaFileError(f"{path}: arenas are files with names in {', '.join(SUFFIXES)}")
    if not path.is_file():
        raise ArenaFileError(f"{path}: there is no such file")
    if path.suffix.lower() in YAML:
        value = read_yaml(path, ArenaFileError)
        if not is_map(value):
            return arena_of_yaml(value, resources)
        content = occupancy_grid_content(value)
    else:
        content = READERS[path.suffix.lower()](path, resources)
    arena = ArenaSpec(name=path.stem, starts=(), extent=EMPTY_EXTENT)
    # Such a file sets no fields of an arena: errors name its first line.
    arena = complete_arena(arena, content, FileValue(None, path, 1, refusal=ArenaFileError), set())
    return arena, content.warnings + scale_notes(arena, path)


def find_arena(arena: str | Path, *, packages: Iterable[str | Path] = ()) -> ArenaSpec:
    """Return a registered arena or lane by its name, as lane_stairs, or the one in a file.

    Args:
        arena: The name, or the file.
        packages: Folders in which a file's packages and models are searched first.

    Raises:
        UnknownNameError: Neither a known name nor the name of a file.
        ArenaFileError: An unreadable file.
    """
    name = str(arena)
    if name in ARENAS:
        return ARENAS.get(name)
    if name.lower().startswith(LANE_PREFIX) and name in LANES:
        return LANES.get(name).arena
    path = Path(name)
    if path.suffix.lower() in (*YAML, *READERS) or path.is_file():
        return load_arena(path, packages=packages)
    refusal = unknown_name("arena", name, ARENAS.names(), ARENAS.aliases())
    raise UnknownNameError(f"{refusal}; or a file: {', '.join(SUFFIXES)}")


def _xml(path: Path, resources: Resources) -> Content:
    """Read MJCF, or URDF or SDF with the suffix .xml."""
    root = root_tag(read_bytes(path, refusal=ArenaFileError))
    if root == "robot":
        return urdf_content(path, resources=resources)
    # A .world file of any other root goes to Gazebo's reader, which names what is wrong with it.
    is_sdf = root in SDF_ROOTS or (path.suffix.lower() == ".world" and root != "mujoco")
    return sdf_content(path, resources=resources) if is_sdf else mjcf_content(path)


def _world(path: Path, resources: Resources) -> Content:
    """Read a world of Gazebo, which is XML, or of Stage."""
    # A byte order mark may come before the first sign.
    data = read_bytes(path, refusal=ArenaFileError).lstrip(b"\xef\xbb\xbf \t\r\n")
    if data.startswith(b"#usda"):
        return _usd(path)
    return _xml(path, resources) if data.startswith(b"<") else stage_content(path)


def _mesh(path: Path) -> Content:
    return mesh_content(MeshFile(file=path))


def _building(path: Path) -> Content:
    """Return a COLLADA file's convex pieces, or what a world would make of the file."""
    try:
        return _mesh(path)
    except ArenaFileError:
        pieces, notes = world_pieces(path, (1.0, 1.0, 1.0), "", False, "fixed")
        if not pieces:
            raise
    like = Shape(kind="mesh", surface="")
    shapes = tuple(placed_pieces(pieces, Pose(np.zeros(3), np.eye(3)), like, "fixed"))
    plates = sum(piece.normal is not None for piece in pieces)
    said = [f"{path}: {plates} plates along faces stand for parts that are not convex"] if plates else []
    return Content(shapes=shapes, warnings=(*said, *(f"{path}: {note}" for note in notes)))


def _terrain(path: Path) -> Content:
    width, height = image_size(path)
    # Heights are at the pixels' middles: n of them span n - 1 spacings.
    size = (PIXEL_SIZE * max(width - 1, 1), PIXEL_SIZE * max(height - 1, 1))
    content = terrain_content(TerrainFile(file=path, size=size, height=WHITE_HEIGHT))
    check_picture(path)
    return content


def _picture(path: Path) -> Content:
    raise ArenaFileError(f"{path}: is the picture of a map; load the YAML file that says its resolution")


def _text(path: Path) -> Content:
    if is_route_network(read_bytes(path, refusal=ArenaFileError)):
        return roads_content(path)
    raise ArenaFileError(f"{path}: is no route network: its first word is not RNDF_name")


def _usd(path: Path) -> Content:
    raise ArenaFileError(f"{path}: USD is not read: export it as OBJ, or as SDF or MJCF, and load that")


def _plain(reader: Callable[[Path], Content]) -> Callable[[Path, Resources], Content]:
    """Return a reader of files that name no packages."""
    return lambda path, _: reader(path)


def _sdf(path: Path, resources: Resources) -> Content:
    return sdf_content(path, resources=resources)


def _urdf(path: Path, resources: Resources) -> Content:
    return urdf_content(path, resources=resources)


READERS: dict[str, Callable[[Path, Resources], Content]] = {
    ".world": _world,
    ".sdf": _sdf,
    ".inc": _plain(stage_content),
    ".xml": _xml,
    ".mjcf": _plain(mjcf_content),
    ".urdf": _urdf,
    **dict.fromkeys((".obj", ".stl"), _plain(_mesh)),
    ".dae": _plain(_building),
    ".png": _plain(_terrain),
    ".pgm": _plain(_picture),
    **dict.fromkeys((".map", ".scen"), _plain(moving_ai_content)),
    ".rndf": _plain(roads_content),
    ".txt": _plain(_text),
    # Known only to be refused with advice, so `SUFFIXES` leaves them out.
    **dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), _plain(_usd)),
}
"""Reader of each suffix, apart from YAML."""
SUFFIXES = tuple(suffix for suffix in (*YAML, *READERS) if not suffix.startswith(".usd"))
"""Suffixes of files with arenas."""
