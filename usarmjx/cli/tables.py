"""Listings as tables: one form for people, pipes, documents and programs.

`listing` selects one of them.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from rich.console import Console
from rich.table import Table

from usarmjx.base.tables import markdown_table
from usarmjx.models.arenas import ARENAS
from usarmjx.models.arenas.lanes import LANES
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.shapes import MATERIALS, OPAQUE

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


@dataclass(frozen=True, kw_only=True)
class Listing:
    """Things of one kind.

    Attributes:
        columns: Names of the columns, the first that of the things' names.
        rows: Their cells, texts or numbers (rows, columns).
        title: Title.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[object]]
    title: str = ""

    def as_json(self) -> str:
        """Return a JSON list with an object for each row."""
        return json.dumps([dict(zip(self.columns, row, strict=True)) for row in self.rows], indent=1)

    def as_markdown(self) -> str:
        """Return a Markdown table."""
        return markdown_table(self.columns, self.rows)

    def as_text(self) -> str:
        """Return lines whose columns stand below each other; for pipes, so nothing is cut off."""
        lines = [list(map(str, row)) for row in (self.columns, *self.rows)]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        padded = [
            "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) for line in lines
        ]
        # The last column would end in blanks.
        return "\n".join(line.rstrip() for line in padded)

    def show(self, console: Console) -> None:
        """Show it on a terminal."""
        table = Table(title=self.title or None, title_justify="left")
        for number, column in enumerate(self.columns):
            # The first column has names to copy, which must not be broken in two.
            table.add_column(column, style="bold" if not number else None, no_wrap=not number)
        for row in self.rows:
            table.add_row(*(str(cell) for cell in row))
        # Names and units in square brackets are no markup of Rich's.
        console.print(table, markup=False)


def robots() -> Listing:
    """Return the robot classes."""
    from usarmjx.cli.catalogue import sensor_names
    from usarmjx.models.robots import ROBOTS

    columns = "class", "steering", "L x W x H [m]", "mass [kg]", "top speed [m/s]", "sensors"
    rows = [
        (
            name,
            f"{robot.drive.vehicle}, {robot.drive.steering}",
            " x ".join(f"{side:.2f}" for side in robot.dimensions),
            round(robot.mass, 3),
            round(robot.drive.top_speed, 2),
            sensor_names(robot),
        )
        for name, robot in ROBOTS
    ]
    return Listing(columns=columns, rows=rows, title="Robots: INIT {ClassName USARBot.<class>}")


def sensors() -> Listing:
    """Return the types of sensors."""
    from usarmjx.cli.catalogue import describe, robots_with
    from usarmjx.sensors.base import SENSORS

    rows = [(kind, *describe(SENSORS.get(kind)), robots_with(kind)) for kind in SENSORS.names()]
    return Listing(columns=("type", "function", "value", "robots"), rows=rows, title="Sensors")


def arenas() -> Listing:
    """Return the arenas."""
    from usarmjx.models.arenas import ARENAS

    rows = [
        (
            name,
            ", ".join(arena.aliases),
            " x ".join(f"{high - low:g}" for low, high in arena.extent),
            len(arena.shapes),
            len(arena.starts),
            len(arena.victims),
            arena.about,
        )
        for name, arena in ARENAS
    ]
    columns = "arena", "also", "size [m]", "solids", "starts", "victims", "description"
    return Listing(columns=columns, rows=rows, title="Arenas: --arena NAME")


def tasks() -> Listing:
    """Return the tasks, and which policies for them come with the package."""
    from usarmjx.train.baselines import BASELINES
    from usarmjx.train.policies import POLICIES
    from usarmjx.train.tasks import TASKS

    made = {"packaged": POLICIES, "baseline": BASELINES}
    rows = [
        (name, task.about, task.episode_steps, ", ".join(how for how in made if name in made[how]) or "none")
        for name, task in TASKS
    ]
    return Listing(
        columns=("task", "description", "steps", "policies"),
        rows=rows,
        title="Tasks: usarmjx train TASK; a name without -v1, -v2, ... is that of the newest version",
    )


def policies() -> Listing:
    """Return the policies that come with the package: trained ones, and baselines."""
    from usarmjx.train.baselines import BASELINES, PLANNERS
    from usarmjx.train.policies import POLICIES
    from usarmjx.train.policies.policy_file import NumpyPolicy

    rows: list[Sequence[object]] = []
    for name, file in POLICIES:
        groups = ", ".join(f"{one['name']} ({len(one['agents'])})" for one in NumpyPolicy(file).groups)
        rows.append((name, "packaged", groups, f"usarmjx play {name} --view"))
    for name in BASELINES.names():
        task = " --task explore" if name in PLANNERS else ""
        rows.append((name, "baseline", "", f"usarmjx play --baseline {name}{task} --view"))
    return Listing(columns=("policy", "made", "robots", "to see it"), rows=rows, title="Policies")


def engines() -> Listing:
    """Return the engines, and what `auto` takes."""
    from usarmjx.cli.catalogue import availability
    from usarmjx.engines import ENGINES, choose_engine

    chosen = {purpose: choose_engine("auto", purpose) for purpose in ("serve", "train", "batch")}
    rows = [
        (name, availability(name), ", ".join(purpose for purpose, best in chosen.items() if best == name))
        for name, _ in ENGINES
    ]
    return Listing(
        columns=("engine", "device", "auto is this for"), rows=rows, title="Engines: --engine NAME"
    )


LISTINGS: Mapping[str, Callable[[], Listing]] = {
    "robots": robots,
    "sensors": sensors,
    "arenas": arenas,
    "tasks": tasks,
    "policies": policies,
    "engines": engines,
}
"""The listings by what they list."""


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
    from usarmjx.sim.trials import measure_crossings

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
