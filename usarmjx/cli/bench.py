"""`usarmjx bench`: how fast things go on this machine."""

from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from usarmjx.base.errors import UsageError
from usarmjx.cli.tools import (
    ArenaOption,
    EngineOption,
    ErrorExit,
    IniOption,
    SeedOption,
    UnitOption,
    configure_from,
)
from usarmjx.cli.waiting import announce


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


app = typer.Typer(help="Measure how fast things go on this machine.", no_args_is_help=True)


@app.command("radio")
def bench_radio(
    worlds: Annotated[int, typer.Option(min=1, help="Worlds at once.")] = 64,
    robots: Annotated[int, typer.Option(min=2, help="Robots in each; all pairs are evaluated.")] = 16,
    walls: Annotated[int, typer.Option(min=1, help="Walls in each.")] = 100,
    steps: Annotated[int, typer.Option(min=1, help="Evaluations per repeat.")] = 20,
    repeats: Annotated[int, typer.Option(min=1, help="Repeats; the median counts.")] = 5,
    seed: SeedOption = 0,
    json: Annotated[Path | None, typer.Option(help="Append the record to this file.")] = None,
) -> None:
    """Measure the links of all pairs of robots, walls counted."""
    with ErrorExit():
        announce("measuring the radio ...", keep=False)
        from usarmjx.bench.radio import RadioCase, measure_radio

        case = RadioCase(worlds=worlds, robots=robots, walls=walls, steps=steps, repeats=repeats, seed=seed)
        typer.echo(measure_radio(case, json))


@app.command("rays")
def bench_rays(
    worlds: Annotated[int, typer.Option(min=1, help="Worlds at once.")] = 4,
    roster: Annotated[
        str, typer.Option(help="Robots in each, of a class with a range scanner; all of them scan.")
    ] = "P2AT:16",
    walls: Annotated[int, typer.Option(min=1, help="Walls in each.")] = 100,
    steps: Annotated[int, typer.Option(min=1, help="Scans per repeat.")] = 10,
    repeats: Annotated[int, typer.Option(min=1, help="Repeats; the median counts.")] = 5,
    seed: SeedOption = 0,
    json: Annotated[Path | None, typer.Option(help="Append the record to this file.")] = None,
) -> None:
    """Measure laser scans of all robots, and the same by brute force."""
    with ErrorExit():
        announce("measuring rays ...", keep=False)
        from usarmjx.bench.rays import RayCase, measure_rays

        robot, robots = one_class(roster)
        size = {"worlds": worlds, "robots": robots, "walls": walls, "steps": steps, "repeats": repeats}
        typer.echo(measure_rays(RayCase(robot=robot, seed=seed, **size), json))


@app.command("camera")
def bench_camera(
    worlds: Annotated[int, typer.Option(min=1, help="Worlds in the batch.")] = 16,
    roster: Annotated[str, typer.Option(help="Robots in each, of one class; all of them look.")] = "P2AT:1",
    arena: ArenaOption = "yellow",
    size: Annotated[str, typer.Option(help="Width and height of a picture, as 64x64.")] = "64x64",
    engine: EngineOption = "auto",
    steps: Annotated[int, typer.Option(min=1, help="Rounds of pictures per repeat.")] = 5,
    repeats: Annotated[int, typer.Option(min=1, help="Repeats; the median counts.")] = 5,
    seed: SeedOption = 0,
    peer: Annotated[bool, typer.Option("--peer", help="Measure MuJoCo Warp's renderer too.")] = False,
    json: Annotated[Path | None, typer.Option(help="Append the record to this file.")] = None,
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
        typer.echo(measure_camera(case, json))


@app.command("viewer")
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
    limit: Annotated[float, typer.Option(min=1.0, help="Seconds after which a wait is given up.")] = 120.0,
    json: Annotated[Path | None, typer.Option(help="Append the record to this file.")] = None,
) -> None:
    """Measure what the live page costs, and what a server with a page open keeps up with."""
    with ErrorExit():
        announce("measuring the live page ...", keep=False)
        from usarmjx.bench.viewer import ViewerCase, measure_viewer

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
        typer.echo(measure_viewer(case, json))


@app.command("serve")
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
    robots: Annotated[
        list[int] | None,
        typer.Option(min=1, help="Robots whose load is measured; may be repeated. Else 1, 4, 16, 64."),
    ] = None,
    joining: Annotated[int, typer.Option(min=1, help="How many join, leave and talk.")] = 15,
    engine: EngineOption = "c",
    seconds: Annotated[float, typer.Option(min=0.5, help="Length of one look at a load.")] = 5.0,
    windows: Annotated[int, typer.Option(min=1, help="How many of them.")] = 3,
    repeats: Annotated[int, typer.Option(min=1, help="Servers started for each other figure.")] = 3,
    limit: Annotated[float, typer.Option(min=1.0, help="Seconds after which a wait is given up.")] = 120.0,
    note: Annotated[str, typer.Option(help="What a reader of the record must know.")] = "",
    json: Annotated[Path | None, typer.Option(help="Append the record to this file.")] = None,
) -> None:
    """Measure what clients of `usarmjx serve` wait for, and what robots cost it, over TCP."""
    with ErrorExit():
        from usarmjx.bench.serve import ServeCase, measure_serve

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
        typer.echo(measure_serve(case, checkout or (), json, note, say))


@app.command("train")
def bench_train(
    runs: Annotated[list[Path], typer.Argument(help="Folders of runs that were trained here just now.")],
    baseline: Annotated[float | None, typer.Option(help="Score of the policy by hand.")] = None,
    json: Annotated[Path | None, typer.Option(help="Append the records to this file.")] = None,
) -> None:
    """Record runs of `usarmjx train`: their speed and curves, and when they were as good as by hand."""
    with ErrorExit():
        announce("reading runs ...")
        from usarmjx.bench.train import record_run

        for run in runs:
            typer.echo(record_run(run, baseline, json))


@app.command("physics")
def bench_physics(
    robot: Annotated[
        list[str] | None, typer.Option(help="Class that is driven; may be repeated. Else all.")
    ] = None,
    physics: Annotated[str, typer.Option(help="Settings beside the reference's.")] = "fast",
    jobs: Annotated[int, typer.Option(min=1, help="Processes at once.")] = 1,
    json: Annotated[Path | None, typer.Option(help="Append the record to this file.")] = None,
) -> None:
    """Drive every class through manoeuvres under settings of the physics and under the reference's."""
    with ErrorExit():
        announce("driving ...", keep=False)
        from usarmjx.bench.fidelity.scorecard import write_scorecard
        from usarmjx.models.build.compose import PHYSICS

        typer.echo(write_scorecard(PHYSICS.get(physics), robot, jobs, json))


@app.command("step")
def bench_step(
    worlds: Annotated[int, typer.Option(min=1, help="Worlds in the batch.")] = 4,
    roster: Annotated[str, typer.Option(help="Robots of each world, as P2AT:4,Zerg:2.")] = "P2AT:4",
    arena: Annotated[str, typer.Option(help="Arena name, or with --generated the kind.")] = "yellow",
    generated: Annotated[
        int, typer.Option(min=0, help="So many generated arenas, which the worlds have in turn.")
    ] = 0,
    engine: EngineOption = "auto",
    radio: Annotated[bool, typer.Option("--radio", help="Evaluate all radio links too.")] = False,
    physics: Annotated[str, typer.Option(help="Settings of the physics: reference or fast.")] = "reference",
    substeps: Annotated[
        int | None, typer.Option(min=1, help="Physics steps per control step; else those of 50 ms.")
    ] = None,
    steps: Annotated[int, typer.Option(min=1, help="Control steps per repeat.")] = 20,
    repeats: Annotated[int, typer.Option(min=1, help="Repeats; the median counts.")] = 5,
    seed: SeedOption = 0,
    ini: IniOption = None,
    uu_per_metre: UnitOption = 250.0,
    json: Annotated[Path | None, typer.Option(help="Append the record to this file.")] = None,
) -> None:
    """Measure bare physics and the whole step (control, physics, sensors, resets) in one run."""
    with ErrorExit():
        announce("measuring steps ...", keep=False)
        configure_from(ini, uu_per_metre)
        from usarmjx.bench.step import StepCase, measure_step

        case = StepCase(
            worlds=worlds,
            roster=roster,
            arena=arena,
            generated=generated,
            engine=engine,
            radio=radio,
            physics=physics,
            substeps=substeps,
            steps=steps,
            repeats=repeats,
            seed=seed,
        )
        typer.echo(measure_step(case, json))
