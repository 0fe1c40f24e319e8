"""Tables of arenas: the text of `usarmjx arena list`."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from usarmjx.base.tables import markdown_table
from usarmjx.models.arenas import ARENAS
from usarmjx.models.arenas.lanes import LANES
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.shapes import MATERIALS, OPAQUE

if TYPE_CHECKING:
    from usarmjx.models.types.arena import ArenaSpec


ARENA_COLUMNS = (
    "arena",
    "description",
    "size [m]",
    "solids",
    "loose",
    "doors",
    "victims",
    "false alarms",
    "tags",
    "starts",
    "recommended robots",
)


def arenas_table() -> str:
    """Return a Markdown table of the arenas that ship with usarmjx."""
    return markdown_table(ARENA_COLUMNS, (arena_row(arena) for _, arena in ARENAS))


def arena_row(arena: ArenaSpec) -> Sequence[object]:
    """Return an arena's row of the table: what it is, and how much of everything is in it."""
    names = arena.name + (f" ({', '.join(arena.aliases)})" if arena.aliases else "")
    (x0, x1), (y0, y1) = arena.extent
    counts = [len(things) for things in (arena.loose, arena.doors, arena.victims, arena.false_alarms)]
    return [
        names,
        arena.about or "-",
        f"{x1 - x0:g} x {y1 - y0:g}",
        _solids(arena),
        *counts,
        len(arena.tags),
        len(arena.starts),
        ", ".join(arena.robots) or "-",
    ]


def lanes_table() -> str:
    """Return a Markdown table of the lanes."""
    head = "lane", "test method", "description", "length [m]", "a repetition is"
    rows = (
        (
            name,
            lane.method,
            lane.arena.about.rpartition(" (")[0],
            f"{lane.length:.2g}",
            "there and back" if lane.round_trip else "one way",
        )
        for name, lane in LANES
    )
    return markdown_table(head, rows)


def obstacles_table(robot: str, tries: int) -> str:
    """Return a Markdown table: how often, and how fast, a class gets over obstacles sized to it."""
    from usarmjx.models.files.find_robot import find_robot
    from usarmjx.models.generate.obstacles import OBSTACLES
    from usarmjx.sim.trials.obstacles import measure_crossings

    levels, spec = (0.0, 0.5, 1.0), find_robot(robot)
    rows = list[Sequence[object]]()
    for kind in OBSTACLES.names():
        found = [measure_crossings(kind, spec, level, tries) for level in levels]
        rows.append([kind, *(f"{one.crossed} of {one.tries}, {one.seconds:.1f} s" for one in found)])
    return markdown_table((f"obstacle, for a {spec.name}", *(f"roughness {one:g}" for one in levels)), rows)


def _solids(arena: ArenaSpec) -> str:
    """Return the number of solids, and of the special ones: 120 (2 glass, 1 terrain)."""
    kinds: Sequence[tuple[str, int]] = [
        *((name, sum(s.material == name for s in arena.shapes)) for name in MATERIALS if name != OPAQUE),
        ("mesh", sum(shape.mesh is not None for shape in arena.shapes)),
        ("terrain", sum(shape.heights is not None for shape in arena.shapes)),
    ]
    special = ", ".join(f"{count} {name}" for name, count in kinds if count)
    return f"{len(arena.shapes)}" + (f" ({special})" if special else "")


def summary(arena: ArenaSpec) -> str:
    """Return in a line what is in an arena."""
    (x0, x1), (y0, y1) = arena.extent
    counts = ", ".join(
        f"{len(things)} {name}"
        for name, things in (
            ("loose objects", arena.loose),
            ("doors", arena.doors),
            ("victims", arena.victims),
            ("tags", arena.tags),
            ("start poses", arena.starts),
        )
    )
    return f"{arena.name}: {x1 - x0:g} x {y1 - y0:g} m, {_solids(arena)} solids, {counts}"
