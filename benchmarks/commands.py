"""`usarmjx bench train`, `physics`, `compile`, `memory`, `peers` and `report`."""

from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from usarmjx.base.errors import UsageError
from usarmjx.cli.common import (
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
from usarmjx.cli.completion import complete_tasks
from usarmjx.cli.startup_messages import announce

JsonOption = Annotated[Path | None, typer.Option(help="Append the record to this file.")]
NoteOption = Annotated[str, typer.Option(help="What a reader of the record must know.")]
StepsOption = Annotated[int, typer.Option(min=1, help="Control steps, scans or rounds of a repeat.")]
RepeatsOption = Annotated[int, typer.Option(min=1, help="Repeats; the median counts.")]
BaselinesOption = Annotated[
    str,
    typer.Option(help="What is measured beside it: all, cpu (C MuJoCo on all cores, not bare MJX) or none."),
]
RosterOption = Annotated[str, typer.Option(help="Robots of each world, as P2AT:4,Zerg:2.")]
SceneArenaOption = Annotated[str, typer.Option(help="Arena name, or with --generated the kind.")]
GeneratedOption = Annotated[
    int, typer.Option(min=0, help="So many generated arenas, which the worlds have in turn.")
]
SizeOption = Annotated[
    str | None,
    typer.Option(help="Cells of a generated arena, as 12x8; else 8x6, or 3 for each robot of a larger team."),
]
RadioOption = Annotated[bool, typer.Option("--radio", help="Evaluate all radio links too.")]
PhysicsOption = Annotated[
    str,
    typer.Option(help="Settings of the physics: reference, fast, sleeping (warp), coarse (planar)."),
]
SubstepsOption = Annotated[
    int | None, typer.Option(min=1, help="Physics steps per control step; else those of 50 ms.")
]
LimitOption = Annotated[float, typer.Option(min=1.0, help="Seconds after which a wait is given up.")]


def one_class(roster: str) -> tuple[str, int]:
    """Return the class of a roster's robots, and how many there are.

    Raises:
        UsageError: They are of several classes, or there are none.
    """
    from usarmjx.server.worlds.make import parse_roster

    names = parse_roster(roster)
    if len({*names}) != 1:
        raise UsageError(f"--roster: expected robots of one class, as P2AT:16; got {roster!r}")
    return names[0], len(names)


serving_app = typer.Typer()


@serving_app.command("viewer")
def bench_viewer(
    roster: Annotated[
        list[str] | None,
        typer.Option(
            help="Robots whose updates are measured, as P2AT:16; may be repeated, with one class. "
            "Else P2AT:1 and P2AT:16."
        ),
    ] = None,
    updates: Annotated[int, typer.Option(min=1, help="Updates of the page for each number.")] = 100,
    served: Annotated[
        int, typer.Option(min=0, help="Robots of a server, whose pace is measured with a page and without.")
    ] = 16,
    seconds: Annotated[float, typer.Option(min=0.5, help="Length of one look at that server.")] = 5.0,
    windows: Annotated[int, typer.Option(min=1, help="How many of them.")] = 3,
    limit: LimitOption = 120.0,
    note: NoteOption = "",
    baselines: BaselinesOption = "cpu",
    json: JsonOption = None,
) -> None:
    """Measure what the live page costs, and what a server with a page open keeps up with."""
    with ErrorExit():
        announce("measuring the live page ...", keep=False)
        from benchmarks.viewer import ViewerCase, measure_viewer

        given = [one_class(one) for one in roster or ("P2AT:1", "P2AT:16")]
        if len({robot for robot, _ in given}) > 1:
            raise UsageError(f"--roster: robots of one class are measured; got {', '.join(roster or ())}")
        case = ViewerCase(
            robots=tuple(count for _, count in given),
            robot=given[0][0],
            updates=updates,
            served=served,
            seconds=seconds,
            windows=windows,
            limit=limit,
        )
        typer.echo(measure_viewer(case, json, note, baselines))


@serving_app.command("serve")
def bench_serve(
    checkout: Annotated[
        list[Path] | None,
        typer.Option(help="Source tree whose server is measured too, in turn with ours; may be repeated."),
    ] = None,
    part: Annotated[
        list[str] | None,
        typer.Option(help="Only start, init, gaps, load or pictures; may be repeated. Else all."),
    ] = None,
    arena: Annotated[str, typer.Option(help="Arena name, or a file.")] = "yellow",
    robot: Annotated[
        list[str] | None, typer.Option(help="Class whose INIT is timed; may be repeated. Else five.")
    ] = None,
    roster: Annotated[
        list[str] | None,
        typer.Option(
            help="Robots whose load is measured: how many counts, they are P2AT and P2DX in turn; may be "
            "repeated. Else 1, 4, 16 and 64."
        ),
    ] = None,
    joining: Annotated[int, typer.Option(min=1, help="How many join, leave and talk.")] = 15,
    engine: EngineOption = "c",
    seconds: Annotated[float, typer.Option(min=0.5, help="Length of one look at a load.")] = 5.0,
    windows: Annotated[int, typer.Option(min=1, help="How many of them.")] = 3,
    repeats: Annotated[int, typer.Option(min=1, help="Servers started for each other figure.")] = 3,
    limit: LimitOption = 120.0,
    note: NoteOption = "",
    baselines: BaselinesOption = "cpu",
    json: JsonOption = None,
) -> None:
    """Measure what clients of `usarmjx serve` wait for, and what robots cost it, over TCP."""
    with ErrorExit():
        from benchmarks.serve import ServeCase, measure_serve
        from usarmjx.server.worlds.make import parse_roster

        robots = [len(parse_roster(one)) for one in roster or ()]
        chosen = {"parts": part, "classes": robot, "robots": robots}
        given: dict[str, Any] = {name: tuple(values) for name, values in chosen.items() if values}
        case = ServeCase(
            arena=arena,
            joining=joining,
            engine=engine,
            seconds=seconds,
            windows=windows,
            repeats=repeats,
            limit=limit,
            **given,
        )
        say = partial(typer.echo, err=True)
        typer.echo(measure_serve(case, checkout or (), json, note, say, baselines))


measured_app = typer.Typer()


@measured_app.command("train")
def bench_train(
    runs: Annotated[
        list[Path] | None, typer.Argument(help="Folders of runs that were trained here just now.")
    ] = None,
    task: Annotated[
        str | None,
        typer.Option(help="Train this task here instead, and forget it.", autocompletion=complete_tasks),
    ] = None,
    worlds: Annotated[int | None, typer.Option(min=1, help="With --task: worlds in the batch.")] = None,
    steps: Annotated[int, typer.Option(min=1, help="With --task: agent steps.")] = 200_000,
    engine: EngineOption = "auto",
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", "-c", help="With --task: a setting, key=value; may be repeated."),
    ] = None,
    baseline: Annotated[float | None, typer.Option(help="Score of the policy by hand.")] = None,
    seed: SeedOption = 0,
    note: NoteOption = "",
    baselines: BaselinesOption = "cpu",
    json: JsonOption = None,
) -> None:
    """Record runs of `usarmjx train`: their speed and curves, and when they were as good as by hand."""
    with ErrorExit():
        if bool(runs) == (task is not None):
            raise UsageError("name folders of runs, or a task to train: --task TASK")
        announce(f"training {task} ..." if task else "reading runs ...")
        if task is None:
            from benchmarks.train import record_run

            for run in runs or ():
                typer.echo(record_run(run, baseline, json, note, baselines))
            return
        from benchmarks.train import TrainCase, measure_training

        chosen = tuple(settings or ())
        case = TrainCase(task=task, worlds=worlds, steps=steps, engine=engine, seed=seed, settings=chosen)
        typer.echo(measure_training(case, baseline, json, note, baselines))


@measured_app.command("physics")
def bench_physics(
    robot: Annotated[
        list[str] | None, typer.Option(help="Class that is driven; may be repeated. Else all.")
    ] = None,
    physics: Annotated[str, typer.Option(help="Settings beside the reference's.")] = "fast",
    jobs: Annotated[int, typer.Option(min=1, help="Processes at once.")] = 1,
    note: NoteOption = "",
    json: JsonOption = None,
) -> None:
    """Drive every class through manoeuvres under settings of the physics and under the reference's."""
    with ErrorExit():
        announce("driving ...", keep=False)
        from benchmarks.fidelity.scorecard import write_scorecard
        from usarmjx.models.compile.physics import PHYSICS

        typer.echo(write_scorecard(PHYSICS.get(physics), robot, jobs, json, note))


@measured_app.command("compile")
def bench_compile(
    worlds: WorldsOption = 4,
    roster: RosterOption = "P2AT:4",
    arena: SceneArenaOption = "yellow",
    generated: GeneratedOption = 0,
    size: SizeOption = None,
    engine: EngineOption = "auto",
    radio: RadioOption = False,
    physics: PhysicsOption = "reference",
    substeps: SubstepsOption = None,
    repeats: Annotated[int, typer.Option(min=1, help="Pairs of processes, cold and cached.")] = 1,
    limit: LimitOption = 1800.0,
    seed: SeedOption = 0,
    note: NoteOption = "",
    baselines: BaselinesOption = "cpu",
    json: JsonOption = None,
) -> None:
    """Measure how long the first step takes: imports, scene, tracing, XLA; cold and with a filled cache."""
    with ErrorExit():
        announce("measuring compilation ...", keep=False)
        from benchmarks.compiling import CompileCase, measure_compile

        scene = {
            "worlds": worlds,
            "roster": roster,
            "arena": arena,
            "generated": generated,
            "size": read_size(size) if size else None,
            "engine": engine,
            "radio": radio,
            "physics": physics,
            "substeps": substeps,
            "seed": seed,
        }
        case = CompileCase(scene=scene, repeats=repeats, limit=limit)
        typer.echo(measure_compile(case, json, note, baselines))


@measured_app.command("memory")
def bench_memory(
    worlds: Annotated[
        list[int] | None, typer.Option(min=1, help="Worlds in the batch; may be repeated. Else 1 and 16.")
    ] = None,
    roster: RosterOption = "P2AT:4",
    arena: SceneArenaOption = "yellow",
    generated: GeneratedOption = 0,
    size: SizeOption = None,
    engine: EngineOption = "auto",
    radio: RadioOption = False,
    physics: PhysicsOption = "reference",
    substeps: SubstepsOption = None,
    compiled: Annotated[
        bool,
        typer.Option(
            "--compiled/--not-compiled", help="Compile a step, to see what it needs beside the state."
        ),
    ] = True,
    seed: SeedOption = 0,
    note: NoteOption = "",
    baselines: BaselinesOption = "cpu",
    json: JsonOption = None,
) -> None:
    """Measure the memory of worlds, by part, and what a compiled step needs."""
    with ErrorExit():
        announce("measuring memory ...", keep=False)
        from benchmarks.memory import MemoryCase, measure_memory
        from benchmarks.scenes import SceneCase

        scene = SceneCase(
            worlds=1,
            roster=roster,
            arena=arena,
            generated=generated,
            size=read_size(size) if size else None,
            engine=engine,
            radio=radio,
            physics=physics,
            substeps=substeps,
            seed=seed,
        )
        case = MemoryCase(scene=scene, counts=tuple(worlds or (1, 16)), compile=compiled)
        typer.echo(measure_memory(case, json, note, baselines))


@measured_app.command("peers")
def bench_peers(
    size: Annotated[
        list[str] | None,
        typer.Option(help="Worlds and robots in each, as 4096x16; may be repeated. Else 64x4."),
    ] = None,
    peer: Annotated[
        list[str] | None, typer.Option(help="Folder of a peer; may be repeated. Else all there are.")
    ] = None,
    engine: Annotated[
        list[str] | None, typer.Option(help="Engine of ours; may be repeated. Else auto and planar.")
    ] = None,
    variant: Annotated[
        list[str] | None,
        typer.Option(
            help="Only this of a peer or of ours, as jaxnav, navigation, whole, blind or bare; "
            "may be repeated. Else all."
        ),
    ] = None,
    arena: ArenaOption = "yellow",
    folder: Annotated[Path, typer.Option(help="Where the peers are.")] = Path("benchmarks/peers"),
    environments: Annotated[
        Path, typer.Option(help="Where each peer has its environment, or gets one.")
    ] = Path("build/peers"),
    install: Annotated[
        bool, typer.Option("--install/--no-install", help="Make environments that are not there.")
    ] = True,
    steps: StepsOption = 20,
    repeats: RepeatsOption = 3,
    limit: LimitOption = 900.0,
    seed: SeedOption = 0,
    note: NoteOption = "",
    json: JsonOption = None,
) -> None:
    """Run other simulators and ours in turn, each in a process of its own, and tell what is in whose step."""
    with ErrorExit():
        announce("measuring ours and others ...", keep=False)
        from benchmarks.peering.contest import ContestCase, measure_peers, parse_sizes

        case = ContestCase(
            sizes=parse_sizes(size or ["64x4"]),
            peers=tuple(peer or ()),
            engines=tuple(engine or ("auto", "planar")),
            variants=tuple(variant or ()),
            steps=steps,
            repeats=repeats,
            seed=seed,
            arena=arena,
            limit=limit,
        )
        say = partial(typer.echo, err=True)
        typer.echo(measure_peers(case, folder, environments, install=install, file=json, note=note, say=say))


@measured_app.command("report")
def bench_report(
    results: Annotated[Path, typer.Option(help="Folder of records.")] = Path("benchmarks/results"),
    page: Annotated[
        Path, typer.Option(help="Page whose blocks are written anew; figures go beside it.")
    ] = Path("docs/performance.md"),
) -> None:
    """Write the tables and figures of docs/performance.md anew from the records."""
    with ErrorExit():
        announce("drawing ...", keep=False)
        from benchmarks.report.page import write_page

        typer.echo(write_page(results, page))


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
        from benchmarks.radio import RadioCase, measure_radio
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
        from benchmarks.rays import RayCase, measure_rays

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
        from benchmarks.camera import CameraCase, measure_camera
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
        from benchmarks.step import StepCase, measure_step

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


for command in (app, app):
    app.registered_commands += command.registered_commands
