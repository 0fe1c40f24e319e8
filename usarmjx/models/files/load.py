"""Arenas from files, and to files.

`load_arena` reads YAML files with the fields of `ArenaSpec` and the names of other files (see `yaml_file`),
and these others by themselves: MJCF, URDF, meshes, grey images, maps of ROS' map_server. `save_arena` writes
any arena as YAML. What a file has that an arena cannot have is refused by name, or left out with a warning.
"""

import logging
from collections.abc import Callable
from pathlib import Path

from usarmjx.base.errors import ArenaFileError, UnknownNameError
from usarmjx.models.arenas import ARENAS
from usarmjx.models.arenas.lanes import LANE_PREFIX, LANES
from usarmjx.models.files.content import EMPTY, Content
from usarmjx.models.files.images import image_size
from usarmjx.models.files.maps import is_map, occupancy_grid_content
from usarmjx.models.files.mjcf import mjcf_content
from usarmjx.models.files.save import save_arena
from usarmjx.models.files.sources import MeshFile, TerrainFile, mesh_content, terrain_content
from usarmjx.models.files.urdf import urdf_content
from usarmjx.models.files.values import YamlValue, read_bytes, read_yaml
from usarmjx.models.files.yaml_file import arena_of_yaml, complete_arena
from usarmjx.models.spec.arena import ArenaSpec

__all__ = ["SUFFIXES", "find_arena", "load_arena", "read_arena", "save_arena"]

logger = logging.getLogger(__name__)

PIXEL = 0.1
"""Distance of the heights in a grey image that is loaded by itself [m]."""
RISE = 1.0
"""Height of white in it [m]."""


def load_arena(path: str | Path) -> ArenaSpec:
    """Return the arena in a file; what of it is left out goes to the log as warnings.

    By themselves, an MJCF, URDF or mesh file stands as it is, a grey PNG image is terrain with heights 0.1 m
    apart and up to 1 m, and a map of map_server has walls of 1.2 m. Then the arena has the file's name, an
    extent 1 m round its solids (a map's is the map's), and one start pose in its largest free area; all of
    which a YAML file can say.

    Raises:
        ArenaFileError: A file that is not there or does not read, or something that an arena cannot have.
    """
    arena, warnings = read_arena(path)
    for warning in warnings:
        logger.warning("%s", warning)
    return arena


def read_arena(path: str | Path) -> tuple[ArenaSpec, tuple[str, ...]]:
    """Return the arena in a file, and in words what of it is left out; see `load_arena`."""
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise ArenaFileError(f"{path}: arenas are files with names in {', '.join(SUFFIXES)}")
    if not path.is_file():
        raise ArenaFileError(f"{path}: there is no such file")
    if path.suffix.lower() in YAML:
        value = read_yaml(path)
        if not is_map(value):
            return arena_of_yaml(value)
        content = occupancy_grid_content(value)
    else:
        content = READERS[path.suffix.lower()](path)
    arena = ArenaSpec(name=path.stem, starts=(), extent=EMPTY)
    return complete_arena(arena, content, YamlValue(None, path, 1), set()), content.warnings


def find_arena(arena: str | Path) -> ArenaSpec:
    """Return a registered arena or lane by its name, as lane_stairs, or the one in a file.

    Raises:
        UnknownNameError: Neither a known name nor the name of a file.
        ArenaFileError: A file that does not read.
    """
    name = str(arena)
    if name in ARENAS:
        return ARENAS.get(name)
    if name.lower().startswith(LANE_PREFIX) and name in LANES:
        return LANES.get(name).arena
    path = Path(name)
    if path.suffix.lower() in SUFFIXES or path.is_file():
        return load_arena(path)
    known = ", ".join(ARENAS.names())
    raise UnknownNameError(f"unknown arena {name!r}; known: {known}; or a file: {', '.join(SUFFIXES)}")


def _xml(path: Path) -> Content:
    """Read MJCF, or URDF that is called .xml."""
    return urdf_content(path) if b"<robot" in read_bytes(path) else mjcf_content(path)


def _mesh(path: Path) -> Content:
    return mesh_content(MeshFile(file=path))


def _terrain(path: Path) -> Content:
    width, height = image_size(path)
    size = (PIXEL * max(width - 1, 1), PIXEL * max(height - 1, 1))
    return terrain_content(TerrainFile(file=path, size=size, height=RISE))


def _picture(path: Path) -> Content:
    raise ArenaFileError(f"{path}: is the picture of a map; load the YAML file that says its resolution")


READERS: dict[str, Callable[[Path], Content]] = {
    ".xml": _xml,
    ".mjcf": mjcf_content,
    ".urdf": urdf_content,
    ".obj": _mesh,
    ".stl": _mesh,
    ".png": _terrain,
    ".pgm": _picture,
}
YAML = (".yaml", ".yml")
SUFFIXES = (*YAML, *READERS)
"""How the names of files end that arenas are read from."""
