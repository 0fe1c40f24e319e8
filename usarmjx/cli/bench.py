"""`usarmjx bench`: how fast things go on this machine."""

from typing import Annotated

import typer

from usarmjx.base.errors import UsageError
from usarmjx.cli import bench_measured, bench_serving
from usarmjx.cli.bench_options import (
    BaselinesOption,
    GeneratedOption,
    JsonOption,
    NoteOption,
    PhysicsOption,
    RadioOption,
    RepeatsOption,
    RosterOption,
    SceneArenaOption,
    SizeOption,
    StepsOption,
    SubstepsOption,
    one_class,
)
from usarmjx.cli.tools import (
    ArenaOption,
    EngineOption,
    ErrorExit,
    IniOption,
    SeedOption,
    UnitOption,
    WorldsOption,
    configure_from,
    read_size,
)
from usarmjx.cli.waiting import announce

app = typer.Typer(help="Measure how fast things go on this machine.", no_args_is_help=True)


@app.command("radio")
def bench_radio(
    worlds: WorldsOption = 64,
    roster: Annotated[
        str, typer.Option(help="Robots in each; all pairs are evaluated, whatever their class.")
    ] = "P2AT:16",
    walls: Annotated[int, typer.Option(min=1, help="Walls in each.")] = 100,
    steps: StepsOption = 20,
    repeats: RepeatsOption = 5,
    seed: SeedOption = 0,
    note: NoteOption = "",
    baselines: BaselinesOption = "all",
    json: JsonOption = None,
) -> None:
    """Measure the links of all pairs of robots, walls counted."""
    with ErrorExit():
        announce("measuring the radio ...", keep=False)
        from usarmjx.bench.radio import RadioCase, measure_radio
        from usarmjx.server.worlds.make import parse_roster

        robots = len(parse_roster(roster))
        if robots < 2:
            raise UsageError(f"--roster: a link takes two robots; got {roster!r}")
        case = RadioCase(worlds=worlds, robots=robots, walls=walls, steps=steps, repeats=repeats, seed=seed)
        typer.echo(measure_radio(case, json, note, baselines))


@app.command("rays")
def bench_rays(
    worlds: WorldsOption = 4,
    roster: Annotated[
        str, typer.Option(help="Robots in each, of a class with a range scanner; all of them scan.")
    ] = "P2AT:16",
    walls: Annotated[int, typer.Option(min=1, help="Walls in each.")] = 100,
    steps: StepsOption = 10,
    repeats: RepeatsOption = 5,
    seed: SeedOption = 0,
    note: NoteOption = "",
    baselines: BaselinesOption = "all",
    json: JsonOption = None,
) -> None:
    """Measure laser scans of all robots, and the same by brute force."""
    with ErrorExit():
        announce("measuring rays ...", keep=False)
        from usarmjx.bench.rays import RayCase, measure_rays

        robot, robots = one_class(roster)
        size = {"worlds": worlds, "robots": robots, "walls": walls, "steps": steps, "repeats": repeats}
        typer.echo(measure_rays(RayCase(robot=robot, seed=seed, **size), json, note, baselines))


@app.command("camera")
def bench_camera(
    worlds: WorldsOption = 16,
    roster: Annotated[str, typer.Option(help="Robots in each, of one class; all of them look.")] = "P2AT:1",
    arena: ArenaOption = "yellow",
    size: Annotated[str, typer.Option(help="Width and height of a picture, as 64x64.")] = "64x64",
    engine: EngineOption = "auto",
    steps: StepsOption = 5,
    repeats: RepeatsOption = 5,
    seed: SeedOption = 0,
    peer: Annotated[bool, typer.Option("--peer", help="Measure MuJoCo Warp's renderer too.")] = False,
    note: NoteOption = "",
    baselines: BaselinesOption = "all",
    json: JsonOption = None,
) -> None:
    """Measure pictures of all robots' main cameras: colours, depth and segmentation."""
    with ErrorExit():
        announce("measuring pictures ...", keep=False)
        from usarmjx.bench.camera import CameraCase, measure_camera
        from usarmjx.server.protocol.images import parse_size

        width, height = parse_size(size)
        robot, robots = one_class(roster)
        case = CameraCase(
            worlds=worlds,
            robots=robots,
            robot=robot,
            arena=arena,
            width=width,
            height=height,
            engine=engine,
            steps=steps,
            repeats=repeats,
            seed=seed,
            peer=peer,
        )
        typer.echo(measure_camera(case, json, note, baselines))


@app.command("step")
def bench_step(
    worlds: WorldsOption = 4,
    roster: RosterOption = "P2AT:4",
    arena: SceneArenaOption = "yellow",
    generated: GeneratedOption = 0,
    size: SizeOption = None,
    engine: EngineOption = "auto",
    radio: RadioOption = False,
    physics: PhysicsOption = "reference",
    substeps: SubstepsOption = None,
    steps: StepsOption = 20,
    repeats: RepeatsOption = 5,
    seed: SeedOption = 0,
    graph: Annotated[
        str,
        typer.Option(
            help="CUDA graphs of engine warp: step or control, one for each; with -staged or -staged-ex, one "
            "for all arrays, which are copied in it or around it."
        ),
    ] = "step",
    profile: Annotated[
        bool, typer.Option("--profile", help="Tell which kernels a repeat of the whole step more takes.")
    ] = False,
    ini: IniOption = None,
    uu_per_metre: UnitOption = 250.0,
    note: NoteOption = "",
    baselines: BaselinesOption = "all",
    json: JsonOption = None,
) -> None:
    """Measure bare physics and the whole step (control, physics, sensors, resets) in one run."""
    with ErrorExit():
        built = [engine, "jax"] if baselines == "all" else [engine]
        announce("measuring steps ...", keep=False, engines=built)
        configure_from(ini, uu_per_metre)
        from usarmjx.bench.step import StepCase, measure_step

        case = StepCase(
            worlds=worlds,
            roster=roster,
            arena=arena,
            generated=generated,
            size=read_size(size) if size else None,
            engine=engine,
            radio=radio,
            physics=physics,
            substeps=substeps,
            steps=steps,
            repeats=repeats,
            seed=seed,
            graph=graph,
            profile=profile,
        )
        typer.echo(measure_step(case, json, note, baselines))


for command in (bench_serving.app, bench_measured.app):
    app.registered_commands += command.registered_commands
