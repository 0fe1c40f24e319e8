"""Arenas as MJCF files, as the physics has them."""

from pathlib import Path

from usarmjx.base.errors import UsageError
from usarmjx.base.files import atomic_write
from usarmjx.models.compile.compose import new_spec
from usarmjx.models.compile.physics import Physics
from usarmjx.models.types.arena import ArenaSpec


def export_arena(arena: ArenaSpec, path: Path) -> None:
    """Write an arena's solids, terrain, doors and loose objects as one MJCF file without robots.

    Args:
        arena: The arena.
        path: The file.

    Raises:
        UsageError: A name that does not end in .xml.
        SpecError: The arena cannot be built.
        WriteError: The file cannot be written.
    """
    if path.suffix.lower() != ".xml":
        raise UsageError(f"{path}: an arena is exported as .xml")
    spec = new_spec(arena, Physics())
    spec.compile()
    with atomic_write(path) as fresh:
        fresh.write_text(spec.to_xml(), encoding="utf-8")
