"""An arena's YAML file: the fields of `ArenaSpec`, and other files as sources of solids."""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np

from usarmjx.base.errors import ArenaFileError, SpecError
from usarmjx.base.settings import NOT_NEGATIVE, FileValue, Setting
from usarmjx.base.settings.reader import Reader
from usarmjx.base.transforms import Vec3
from usarmjx.models.files.content import (
    EMPTY_EXTENT,
    Content,
    Rectangle,
    extent_of,
    free_start_pose,
    merge_contents,
)
from usarmjx.models.files.images import read_heights
from usarmjx.models.files.meshes import SeenBy, checked_corners, faces_of_file, vertices_of_file
from usarmjx.models.files.resources import Resources
from usarmjx.models.files.rules import ARENA_RULES, arena_problem
from usarmjx.models.files.scale_notes import scale_notes
from usarmjx.models.files.sources import (
    SOLID_SOURCES,
    GridFile,
    MapFile,
    MeshFile,
    ModelFile,
    RoadFile,
    Scale,
    TerrainFile,
)
from usarmjx.models.types.arena import ArenaSpec, StartPose
from usarmjx.models.types.shapes import HeightField, Mesh

T = TypeVar("T")

MAX_SOLIDS = 50_000
"""Largest number of solids and victims of an arena."""
MAX_OTHER_FILES = {
    **dict.fromkeys(("heights", "heightfield", "map", "moving_ai", "rndf"), 32),
    **dict.fromkeys(("mjcf", "urdf", "sdf", "stage"), 100),
    **dict.fromkeys(("mesh", "meshes", "decomposition"), 1000),
}
"""Largest number of files under each key that names other files."""


@dataclass(frozen=True, kw_only=True)
class ArenaFile(ArenaSpec):
    """A YAML file: an arena, and other files as sources of solids.

    Attributes:
        name: Level name; empty: the file's name.
        starts: Start poses; without the key, one in the largest free area.
        extent: x and y limits of the floor plan; without the key, 1 m around the solids.
        mjcf: MJCF files.
        urdf: URDF files.
        sdf: SDF files and worlds of Gazebo.
        stage: World files of Stage.
        meshes: OBJ, STL and COLLADA files.
        heightfield: Grey images as terrain.
        map: Maps of ROS' map_server.
        moving_ai: Maps and scenarios of MovingAI.
        rndf: Route networks.
    """

    name: str = ""
    starts: tuple[StartPose, ...] = ()
    extent: Rectangle = EMPTY_EXTENT
    mjcf: tuple[ModelFile, ...] = ()
    urdf: tuple[ModelFile, ...] = ()
    sdf: tuple[ModelFile, ...] = ()
    stage: tuple[ModelFile, ...] = ()
    meshes: tuple[MeshFile, ...] = ()
    heightfield: tuple[TerrainFile, ...] = ()
    map: tuple[MapFile, ...] = ()
    moving_ai: tuple[GridFile, ...] = ()
    rndf: tuple[RoadFile, ...] = ()

    @property
    def arena(self) -> ArenaSpec:
        """The arena without the content of the other files."""
        return ArenaSpec(**{one.name: getattr(self, one.name) for one in fields(ArenaSpec)})


@dataclass(frozen=True, kw_only=True)
class FileOfMesh:
    """A solid's mesh with its geometry for rays.

    Attributes:
        file: OBJ, STL or COLLADA file.
        rays: Its faces, or the hull.
    """

    file: Path
    rays: SeenBy


@dataclass(frozen=True, kw_only=True)
class FileOfHeights:
    """A solid's terrain.

    Attributes:
        file: PNG file of 8 or 16 bits.
        height: Height of white above black [m].
    """

    file: Path
    height: Annotated[float, NOT_NEGATIVE]


def arena_of_yaml(value: FileValue, resources: Resources) -> tuple[ArenaSpec, tuple[str, ...]]:
    """Return the arena that a YAML file describes, and the content of its other files that is left out.

    Args:
        value: The file.
        resources: Folders of packages and models that its other files name.

    Raises:
        ArenaFileError: An unknown, missing or invalid value; names file and line.
    """
    _check_number_of_files(value)
    given = value.mapping()
    file = ARENA_READER.from_data(ArenaFile, value, defaults={"name": value.path.stem})
    parts = [
        _content(action(source, resources), item)
        for key, action in SOLID_SOURCES.items()
        if key in given
        for source, item in zip(getattr(file, key), _one_or_several(given[key]), strict=True)
    ]
    content = merge_contents(parts)
    arena = complete_arena(file.arena, content, value, set(given))
    return arena, content.warnings + scale_notes(arena, value.path)


def _check_number_of_files(value: FileValue) -> None:
    """Refuse a file that names too many other files."""
    found: Counter[str] = Counter()
    waiting = [value]
    while waiting:
        one = waiting.pop()
        pairs = one.data.items() if isinstance(one.data, dict) else ()
        waiting += one.data if isinstance(one.data, list) else [item for _, item in pairs]
        for key, item in pairs:
            if key in MAX_OTHER_FILES:
                named = item.data if isinstance(item.data, list) else [item]
                found[key] += sum(isinstance(name.data, str | dict) for name in named)
                if found[key] > MAX_OTHER_FILES[key]:
                    raise item.error(f"more than {MAX_OTHER_FILES[key]} files under {key!r} in one arena")


def complete_arena(arena: ArenaSpec, content: Content, value: FileValue, given: set[str]) -> ArenaSpec:
    """Return an arena with the content of other files, and with defaults for missing fields.

    Args:
        arena: The arena.
        content: Content of other files.
        value: The file's value, for errors.
        given: Fields that the file has.
    """
    shapes, loose = (*arena.shapes, *content.shapes), (*arena.loose, *content.loose)
    solids = [*shapes, *(shape for one in loose for shape in one.shapes)]
    if len(solids) + len(arena.victims) > MAX_SOLIDS:
        raise value.error(
            f"{len(solids)} solids and {len(arena.victims)} victims; at most {MAX_SOLIDS} in all"
        )
    arena = replace(
        arena,
        shapes=shapes,
        loose=loose,
        doors=(*arena.doors, *content.doors),
        lights=(*arena.lights, *content.lights),
        gps=arena.gps or content.gps,
    )
    if "has_floor" not in given and content.floor is not None:
        arena = replace(arena, has_floor=content.floor)
    if "extent" not in given:
        arena = replace(arena, extent=content.extent or extent_of(shapes, loose))
    if "starts" not in given and content.starts:
        arena = replace(arena, starts=content.starts)
    elif "starts" not in given:
        if wrong := arena_problem(arena):
            raise value.error(wrong)
        try:
            start = free_start_pose(arena, content.free_position)
        except SpecError as error:
            raise value.error(f"no start pose can be found, give `starts`: {error}") from error
        if start is None:
            raise value.error("there is no free place for a robot to start from: give `starts`, or a floor")
        arena = replace(arena, starts=(start,))
    if wrong := arena_problem(arena):
        raise value.error(wrong)
    return arena


def _content(content: Content, value: FileValue) -> Content:
    """Return the content of another file, checked."""
    for shape in (*content.shapes, *(s for loose in content.loose for s in loose.shapes)):
        try:
            ARENA_READER.validate(shape)
        except ArenaFileError as error:
            raise value.error(str(error)) from None
    return content


def _one_or_several(value: FileValue) -> list[FileValue]:
    return value.data if isinstance(value.data, list) else [value]


def _sources(kind: type[T], value: FileValue) -> tuple[T, ...]:
    """Read one source of solids or a list of them, each a mapping or the name of its file alone."""
    items = _one_or_several(value)
    whole = [replace(one, data={"file": one}) if isinstance(one.data, str) else one for one in items]
    return tuple(ARENA_READER.from_data(kind, one) for one in whole)


def _file(value: FileValue) -> Path:
    path = value.path.parent / ARENA_READER.convert(str, value)
    if not path.is_file():
        raise value.error(f"there is no file {path}")
    return path


def _scale(value: FileValue) -> Scale:
    if isinstance(value.data, list):
        scale = Scale(ARENA_READER.convert(Vec3, value))
    else:
        scale = Scale([ARENA_READER.convert(float, value)] * 3)
    if 0.0 in scale:
        raise value.error("a scale is not zero")
    return scale


def _mesh(value: FileValue) -> Mesh:
    """Read a solid's mesh: the name of a file, a list of vertices, or a file with its faces for rays."""
    if isinstance(value.data, dict):
        given = ARENA_READER.from_data(FileOfMesh, value)
        return faces_of_file(given.file) if given.rays == "faces" else Mesh(vertices_of_file(given.file))
    if isinstance(value.data, str):
        return Mesh(vertices_of_file(_file(value)))
    corners = np.array(ARENA_READER.convert(tuple[Vec3, ...], value)).reshape(-1, 3)
    return Mesh(checked_corners(corners, f"{value.place}: {value.name}"))


def _heights(value: FileValue) -> HeightField:
    """Read a terrain: a file and its height, or a list of rows."""
    if isinstance(value.data, dict):
        given = ARENA_READER.from_data(FileOfHeights, value)
        return HeightField(read_heights(given.file, given.height))
    rows = ARENA_READER.convert(tuple[tuple[Annotated[float, HEIGHT], ...], ...], value)
    if len(rows) < 2 or len(rows[0]) < 2 or len({len(row) for row in rows}) > 1:
        raise value.error("is not a table of at least 2 x 2 heights, all rows of one length")
    return HeightField(np.array(rows))


HEIGHT = Setting(ge=0, unit="m")
SOURCES = (ModelFile, MeshFile, TerrainFile, MapFile, GridFile, RoadFile)
SPECIAL: Mapping[Any, Callable[[FileValue], Any]] = {
    Path: _file,
    Scale: _scale,
    Mesh: _mesh,
    HeightField: _heights,
    **{tuple[kind, ...]: partial(_sources, kind) for kind in SOURCES},
}
"""Readers of types with a YAML form of their own."""
ARENA_READER = Reader(
    special=SPECIAL,
    rules={**ARENA_RULES, ArenaFile: arena_problem},
    refusal=ArenaFileError,
    single_precision=False,  # MuJoCo compiles arenas in double precision
)
"""Reader of arenas' files."""
