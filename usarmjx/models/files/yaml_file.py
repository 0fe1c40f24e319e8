"""An arena's YAML file: the fields of `ArenaSpec`, and other files as sources of solids."""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from usarmjx.base.errors import SpecError
from usarmjx.base.transforms import Vec3
from usarmjx.models.files.content import EMPTY_EXTENT, Content, extent_of, free_start_pose, merge_contents
from usarmjx.models.files.fields import check_keys, hints_of, problem, read, read_record, required
from usarmjx.models.files.images import read_heights
from usarmjx.models.files.meshes import checked_corners, faces_of_file, vertices_of_file
from usarmjx.models.files.sources import SOLID_SOURCES, Scale
from usarmjx.models.files.values import YamlValue
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.shapes import HeightField, Mesh

MAX_SOLIDS = 50_000
"""Largest number of solids and victims of an arena."""
MAX_OTHER_FILES = {
    **dict.fromkeys(("heights", "heightfield", "map"), 32),
    **dict.fromkeys(("mjcf", "urdf"), 100),
    **dict.fromkeys(("mesh", "meshes", "decomposition"), 1000),
}
"""Largest number of files under each key that names other files."""


def arena_of_yaml(value: YamlValue) -> tuple[ArenaSpec, tuple[str, ...]]:
    """Return the arena that a YAML file describes, and the content of its other files that is left out.

    Raises:
        ArenaFileError: An unknown, missing or invalid value; names file and line.
    """
    given = value.mapping()
    check_keys(value, [*hints_of(ArenaSpec), *SOLID_SOURCES])
    _check_number_of_files(value)
    content = merge_contents(
        [part for key in SOLID_SOURCES if key in given for part in _contents(key, given[key])]
    )
    own = replace(value, data={key: item for key, item in given.items() if key not in SOLID_SOURCES})
    usual = {"name": value.path.stem, "starts": (), "extent": EMPTY_EXTENT}
    arena = read_record(ArenaSpec, own, SPECIAL, **usual)
    return complete_arena(arena, content, value, set(given)), content.warnings


def _check_number_of_files(value: YamlValue) -> None:
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


def complete_arena(arena: ArenaSpec, content: Content, value: YamlValue, given: set[str]) -> ArenaSpec:
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
    arena = replace(arena, shapes=shapes, loose=loose, doors=(*arena.doors, *content.doors))
    if "has_floor" not in given and content.floor is not None:
        arena = replace(arena, has_floor=content.floor)
    if "extent" not in given:
        arena = replace(arena, extent=content.extent or extent_of(shapes, loose))
    if "starts" not in given:
        if wrong := problem(arena):
            raise value.error(wrong)
        try:
            start = free_start_pose(arena, content.free_position)
        except SpecError as error:
            raise value.error(f"no start pose can be found, give `starts`: {error}") from error
        if start is None:
            raise value.error("there is no free place for a robot to start from: give `starts`, or a floor")
        arena = replace(arena, starts=(start,))
    if wrong := problem(arena):
        raise value.error(wrong)
    return arena


def _contents(key: str, value: YamlValue) -> list[Content]:
    """Return the content of the files under a key: one, or a list of them."""
    kind, action = SOLID_SOURCES[key]
    contents: list[Content] = []
    for item in value.data if isinstance(value.data, list) else [value]:
        plain = replace(item, data={"file": item}) if isinstance(item.data, str) else item
        content = action(read_record(kind, plain, SPECIAL))
        for shape in (*content.shapes, *(s for loose in content.loose for s in loose.shapes)):
            if wrong := problem(shape):
                raise item.error(wrong)
        contents.append(content)
    return contents


def _file(value: YamlValue) -> Path:
    path = value.path.parent / read(str, value, {})
    if not path.is_file():
        raise value.error(f"there is no file {path}")
    return path


def _scale(value: YamlValue) -> Scale:
    if isinstance(value.data, list):
        scale = Scale(read(Vec3, value, {}))
    else:
        scale = Scale([read(float, value, {})] * 3)
    if 0.0 in scale:
        raise value.error("a scale is not zero")
    return scale


def _mesh(value: YamlValue) -> Mesh:
    """Read a solid's mesh: the name of a file, a list of vertices, or a file with its faces for rays."""
    if isinstance(value.data, dict):
        check_keys(value, ["file", "rays"])
        if read(Literal["faces", "hull"], required(value, "rays"), {}) == "faces":
            return faces_of_file(_file(required(value, "file")))
        return Mesh(vertices_of_file(_file(required(value, "file"))))
    if isinstance(value.data, str):
        return Mesh(vertices_of_file(_file(value)))
    corners = np.array(read(tuple[Vec3, ...], value, {})).reshape(-1, 3)
    return Mesh(checked_corners(corners, f"{value.path}:{value.line}: {value.name}"))


def _heights(value: YamlValue) -> HeightField:
    """Read a terrain: a file and its height, or a list of rows."""
    if isinstance(value.data, dict):
        check_keys(value, ["file", "height"])
        height = read(float, required(value, "height"), {})
        if height < 0:
            raise required(value, "height").error("is below zero [m]")
        return HeightField(read_heights(_file(required(value, "file")), height))
    rows = read(tuple[tuple[float, ...], ...], value, {})
    if len(rows) < 2 or len(rows[0]) < 2 or len({len(row) for row in rows}) > 1:
        raise value.error("is not a table of at least 2 x 2 heights, all rows of one length")
    if min(map(min, rows)) < 0:
        raise value.error("heights are not below zero [m]")
    return HeightField(np.array(rows))


SPECIAL: Mapping[type, Callable[[YamlValue], Any]] = {
    Path: _file,
    Scale: _scale,
    Mesh: _mesh,
    HeightField: _heights,
}
"""Readers of types with a YAML form of their own."""
