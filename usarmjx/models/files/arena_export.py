"""Arenas as files of other tools: MJCF, URDF and SDF, with the solids, masses and hinges of here."""

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

from usarmjx.base.errors import UsageError
from usarmjx.models.compile.compose import new_spec
from usarmjx.models.compile.physics import Physics
from usarmjx.models.files.arena_parts import ArenaLink, MeshFiles, arena_links, lost_content
from usarmjx.models.files.arena_sdf import sdf_of
from usarmjx.models.files.arena_urdf import urdf_of
from usarmjx.models.files.export_pieces import ExportResult, write_file
from usarmjx.models.types.arena import ArenaSpec

SUFFIXES = {".xml": "mjcf", ".urdf": "urdf", ".sdf": "sdf", ".world": "sdf"}
"""Format of a file by its suffix."""


def export_arena(arena: ArenaSpec, path: Path) -> ExportResult:
    """Write an arena's solids, terrain, doors and loose objects as a file of another tool, without robots.

    Args:
        arena: The arena.
        path: The file, whose suffix is one of `SUFFIXES`; meshes of URDF and SDF become STL files beside it.

    Raises:
        UsageError: Another suffix.
        SpecError: The arena cannot be built.
        WriteError: A file cannot be written.
    """
    form = check_suffix(path)
    if form == "mjcf":
        spec = new_spec(arena, Physics())
        spec.compile()
        write_file(path, spec.to_xml().encode())
        return ExportResult(files=(path,), notes=())
    links, meshes = arena_links(arena), MeshFiles(path)
    root = (sdf_of if form == "sdf" else urdf_of)(arena, links, meshes)
    ET.indent(root)
    write_file(path, ET.tostring(root, encoding="utf-8", xml_declaration=True))
    notes = (*lost_content(arena), *_coarser(arena, links, form))
    return ExportResult(files=(path, *meshes.files), notes=notes)


def check_suffix(path: Path) -> str:
    """Return the format of a file.

    Raises:
        UsageError: Its suffix is that of none.
    """
    form = SUFFIXES.get(path.suffix.lower())
    if form is None:
        raise UsageError(f"{path}: an arena is exported as {', '.join(SUFFIXES)}")
    return form


def _coarser(arena: ArenaSpec, links: tuple[ArenaLink, ...], form: str) -> Iterator[str]:
    """Yield what the format has otherwise, in words."""
    shapes = [shape for link in links for _, shape in link.solids]
    if count := sum(shape.kind == "hfield" for shape in shapes):
        yield f"terrain is a mesh, {count} times"
    if form == "sdf":
        return
    if count := sum(shape.kind == "ellipsoid" for shape in shapes):
        yield f"{count} ellipsoids are meshes in URDF"
    if arena.has_floor:
        yield "the floor is a box, up to 50 m beyond the arena's extent"
    if arena.lights:
        yield f"{len(arena.lights)} lamps: left out"
