"""`usarmjx arena`: look at arenas, check them, and make new ones."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from usarmjx.base.errors import UsageError
from usarmjx.cli.common import (
    ArenaArgument,
    ErrorExit,
    JsonFlag,
    OldOutArgument,
    OutFolderOption,
    PackagesOption,
    PiecesOption,
    SeedOption,
    announce,
    chosen_out,
    named,
    read_size,
)
from usarmjx.cli.known_names import complete_kinds, complete_robots
from usarmjx.cli.listing import MarkdownFlag, check_form, show_listing

if TYPE_CHECKING:
    from usarmjx.models.types.arena import ArenaSpec


app = typer.Typer(help="List, draw, check and generate arenas.", no_args_is_help=True)

PngOption = Annotated[Path | None, typer.Option(help="Write the floor plan to this PNG file.")]
PerspectiveOption = Annotated[
    Path | None, typer.Option("--perspective", help="Write a picture from a corner above to this PNG file.")
]
MOST_MINUTES = 60.0
"""Of a test in a lane."""
LevelOption = Annotated[float | None, typer.Option(help="Difficulty of this part, from 0 to 1.")]


@app.command("list")
def list_arenas(json: JsonFlag = False, markdown: MarkdownFlag = False) -> None:
    """List the arenas that ship with usarmjx, as `usarmjx list arenas`."""
    with ErrorExit():
        check_form(json, markdown)
        announce("reading the arenas ...")
        show_listing("arenas", json, markdown)


@app.command()
def draw(
    arena: ArenaArgument,
    png: PngOption = None,
    perspective: PerspectiveOption = None,
    packages: PackagesOption = None,
) -> None:
    """Draw an arena's floor plan, or the arena from a corner above, or both."""
    with ErrorExit():
        announce(f"drawing arena {arena} ...")
        from usarmjx.models.files.load import find_arena

        if png is None and perspective is None:
            raise UsageError("name a picture: --png for the floor plan, --perspective for a view")
        _draw(find_arena(arena), png, perspective)


@app.command()
def export(
    arena: ArenaArgument,
    out: Annotated[
        Path,
        typer.Option(help="File to write: .xml (MJCF), .sdf, .world or .urdf; meshes are written beside it."),
    ],
    packages: PackagesOption = None,
) -> None:
    """Write an arena as MJCF, SDF or URDF, with the solids, masses and hinges that it has here."""
    with ErrorExit():
        announce(f"building arena {arena} ...")
        from usarmjx.models.files.arena_export import check_suffix, export_arena
        from usarmjx.models.files.load import find_arena

        # Before the arena is built, which may take long.
        check_suffix(out)
        result = export_arena(find_arena(arena), out)
        for note in result.notes:
            typer.echo(f"note: {note}", err=True)
        typer.echo(f"wrote {', '.join(map(str, result.files))}")


@app.command()
def check(
    arena: ArenaArgument,
    robot: Annotated[
        str,
        typer.Option(
            help="Robot class, or a file, that shall start and drive there.",
            autocompletion=complete_robots,
            callback=named("robot"),
        ),
    ] = "P2AT",
    drive: Annotated[
        bool, typer.Option("--drive", help="Also drive the robot to every start pose and victim it reaches.")
    ] = False,
    png: PngOption = None,
    perspective: PerspectiveOption = None,
    packages: PackagesOption = None,
    pieces: PiecesOption = None,
) -> None:
    """List the faults of an arena; exit code 1 if there are any."""
    with ErrorExit():
        announce(f"checking arena {arena} ...")
        from usarmjx.models.check import check_arena
        from usarmjx.models.files.load import find_arena

        found = find_arena(arena)
        faults = check_arena(found, robot)
        if drive:
            from usarmjx.models.files.find_robot import find_robot
            from usarmjx.sim.trials import drive_arena

            announce(f"driving a {robot} ...")
            tour = drive_arena(found, find_robot(robot))
            made = tour.segments - len(tour.faults)
            typer.echo(f"driven: {made} of {tour.segments} ways, {tour.metres:.1f} m in {tour.seconds:.0f} s")
            faults += tour.faults
        # Before the faults end the command: a picture shows best where they are.
        _draw(found, png, perspective)
        for fault in faults:
            typer.echo(fault)
        if faults:
            raise typer.Exit(1)
        typer.echo(f"{found.name}: no faults found for a {robot}")


KindOption = Annotated[
    str,
    typer.Option(
        help="maze, building, rubble, steps, ramps or collapsed.",
        autocompletion=complete_kinds,
        callback=named("kind of arena"),
    ),
]
PassingRobotOption = Annotated[
    str,
    typer.Option(
        help="Robot class, or a file, that can pass.",
        autocompletion=complete_robots,
        callback=named("robot"),
    ),
]


@app.command()
def generate(
    kind: KindOption = "maze",
    size: Annotated[str, typer.Option(help="Columns and rows of cells of 1.2 m, as 12x8.")] = "8x6",
    seed: SeedOption = 0,
    difficulty: Annotated[float, typer.Option(help="Difficulty of all parts, from 0 to 1.")] = 0.5,
    wall_density: LevelOption = None,
    roughness: LevelOption = None,
    clutter: LevelOption = None,
    dead_ends: LevelOption = None,
    radio_shadow: LevelOption = None,
    obstacles: Annotated[
        float, typer.Option(help="Share of the rings round the base that are crossed over obstacles only.")
    ] = 0.0,
    risk: Annotated[
        float, typer.Option(help="Share of drives that fail at the highest of them; 0: all get over them.")
    ] = 0.0,
    robot: PassingRobotOption = "P2AT",
    reachable: Annotated[float, typer.Option(help="Share of the victims that it reaches.")] = 1.0,
    victims: Annotated[
        int | None, typer.Option(help="Number of victims; one for 12 cells, if not given.")
    ] = None,
    starts: Annotated[int, typer.Option(min=1, help="Most start poses; a free cell has one.")] = 24,
    png: PngOption = None,
    perspective: PerspectiveOption = None,
    yaml: Annotated[Path | None, typer.Option(help="Write the arena to this file.")] = None,
    xml: Annotated[Path | None, typer.Option(help="Write it as an MJCF model for MuJoCo.")] = None,
    packages: PackagesOption = None,
    pieces: PiecesOption = None,
) -> None:
    """Make an arena of the same kind, size, difficulty and seed, always the same; print its contents."""
    with ErrorExit():
        _check_outputs(yaml, xml)
        announce(f"making a {kind} ...")
        from usarmjx.models.files.arena_export import export_arena
        from usarmjx.models.files.load import save_arena
        from usarmjx.models.generate import Difficulty
        from usarmjx.models.generate import generate as make

        levels = {
            "wall_density": wall_density,
            "roughness": roughness,
            "clutter": clutter,
            "dead_ends": dead_ends,
            "radio_shadow": radio_shadow,
        }
        # Not `own or difficulty`: 0 is a level.
        own_levels = {name: difficulty if own is None else own for name, own in levels.items()}
        level = Difficulty(**own_levels, obstacles=obstacles, risk=risk)
        arena = make(kind, read_size(size), seed, level, robot, reachable, victims, starts)
        from usarmjx.cli.tables import summary

        typer.echo(summary(arena))
        _draw(arena, png, perspective)
        if yaml is not None:
            typer.echo(f"wrote {save_arena(arena, yaml)}")
        if xml is not None:
            export_arena(arena, xml)
            typer.echo(f"wrote {xml}")


def _check_outputs(yaml: Path | None, xml: Path | None) -> None:
    """Refuse names of files that do not end as their contents do, before an arena is made.

    Raises:
        UsageError: Names the file and the suffix.
    """
    for path, suffixes in ((yaml, (".yaml", ".yml")), (xml, (".xml",))):
        if path is not None and path.suffix.lower() not in suffixes:
            raise UsageError(f"{path}: an arena is written as {suffixes[0]}")


LaneRobotOption = Annotated[
    str,
    typer.Option(
        "--robot",
        help="Robot class, or a file, that is driven.",
        autocompletion=complete_robots,
        callback=named("robot"),
    ),
]
SpeedOption = Annotated[float, typer.Option(help="Share of its top speed, above 0 and up to 1.")]


@app.command()
def lane(
    name: Annotated[
        str, typer.Argument(help="Lane; `usarmjx arena lanes` lists them.", callback=named("lane"))
    ],
    robot: LaneRobotOption = "P2AT",
    minutes: Annotated[float, typer.Option(help="Simulated time of the test [min].")] = 5.0,
    speed: SpeedOption = 1.0,
    packages: PackagesOption = None,
    pieces: PiecesOption = None,
) -> None:
    """Drive a robot to and fro in a lane; its score is repetitions and metres per minute."""
    with ErrorExit():
        announce(f"driving a {robot} in lane {name} ...")
        from usarmjx.models.arenas.lanes import LANES
        from usarmjx.models.files.find_robot import find_robot
        from usarmjx.sim.trials import run_lane

        if not (0.0 < speed <= 1.0 and 0.0 < minutes <= MOST_MINUTES):
            raise UsageError(f"speed is above 0 and up to 1, minutes above 0 and up to {MOST_MINUTES:g}")
        score = run_lane(LANES.get(name), find_robot(robot), minutes, speed)
        typer.echo(score)
        for fault in score.faults:
            typer.echo(f"fault: {fault}")


@app.command()
def lanes() -> None:
    """List the lanes: single elements of the test methods for response robots."""
    with ErrorExit():
        announce("reading the lanes ...")
        from usarmjx.cli.tables import lanes_table

        typer.echo(lanes_table())


@app.command()
def obstacles(
    robot: LaneRobotOption = "P2AT",
    tries: Annotated[int, typer.Option(help="Lanes that each number is measured in.", min=1)] = 4,
    write: Annotated[
        Path | None,
        typer.Option(
            help="Measure success at heights up to one that hardly any drive gets over, into this file."
        ),
    ] = None,
    packages: PackagesOption = None,
    pieces: PiecesOption = None,
) -> None:
    """Measure the success of a robot at the obstacles of generated arenas that are sized to it."""
    with ErrorExit():
        announce(f"driving a {robot} over obstacles ...")
        if write is None:
            from usarmjx.cli.tables import obstacles_table

            typer.echo(obstacles_table(robot, tries))
            return
        from usarmjx.models.files.find_robot import find_robot
        from usarmjx.sim.trials import write_success

        write_success(find_robot(robot), tries, write)
        typer.echo(f"wrote {write}")


@app.command()
def gallery(out: OutFolderOption = None, old_out: OldOutArgument = None) -> None:
    """Draw the pictures of docs/arenas.md: all arenas, and a generated one of each kind."""
    with ErrorExit():
        where = chosen_out(out, old_out)
        announce("drawing all arenas ...")
        from usarmjx.models.arenas import ARENAS
        from usarmjx.models.generate import KINDS
        from usarmjx.models.generate import generate as make
        from usarmjx.plots.gallery import both_sheet, plan_sheet, view_sheet

        arenas = [arena for _, arena in ARENAS]
        for write, name, shown in (
            (plan_sheet, "arenas-plan.png", arenas),
            (view_sheet, "arenas-view.png", arenas),
            # A fixed seed: pictures of the documents change only where the generators do.
            (both_sheet, "generated.png", [make(kind, seed=7) for kind in KINDS.names()]),
        ):
            write(shown, where / name)
            typer.echo(f"wrote {where / name}")


def _draw(arena: "ArenaSpec", png: Path | None, perspective: Path | None) -> None:
    from usarmjx.plots.floor_plan import floor_plan_picture
    from usarmjx.plots.gallery import perspective as view

    for write, path in ((floor_plan_picture, png), (view, perspective)):
        if path is not None:
            write(arena, path)
            typer.echo(f"wrote {path}")
