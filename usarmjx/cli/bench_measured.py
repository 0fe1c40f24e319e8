"""`usarmjx bench train`, `physics`, `compile`, `memory`, `peers` and `report`."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from usarmjx.base.errors import UsageError
from usarmjx.cli.bench_options import (
    BaselinesOption,
    GeneratedOption,
    JsonOption,
    LimitOption,
    NoteOption,
    PhysicsOption,
    RadioOption,
    RepeatsOption,
    RosterOption,
    SceneArenaOption,
    SizeOption,
    StepsOption,
    SubstepsOption,
)
from usarmjx.cli.completion import complete_tasks
from usarmjx.cli.tools import ArenaOption, EngineOption, ErrorExit, SeedOption, WorldsOption, read_size
from usarmjx.cli.waiting import announce

app = typer.Typer()


@app.command("train")
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
            from usarmjx.bench.train import record_run

            for run in runs or ():
                typer.echo(record_run(run, baseline, json, note, baselines))
            return
        from usarmjx.bench.train_here import TrainCase, measure_training

        chosen = tuple(settings or ())
        case = TrainCase(task=task, worlds=worlds, steps=steps, engine=engine, seed=seed, settings=chosen)
        typer.echo(measure_training(case, baseline, json, note, baselines))


@app.command("physics")
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
        from usarmjx.bench.fidelity.scorecard import write_scorecard
        from usarmjx.models.build.compose import PHYSICS

        typer.echo(write_scorecard(PHYSICS.get(physics), robot, jobs, json, note))


@app.command("compile")
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
        from usarmjx.bench.compiling import CompileCase, measure_compile

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


@app.command("memory")
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
        from usarmjx.bench.memory import MemoryCase, measure_memory
        from usarmjx.bench.scenes import SceneCase

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


@app.command("peers")
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
        from usarmjx.bench.peering.contest import ContestCase, measure_peers, parse_sizes

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


@app.command("report")
def bench_report(
    results: Annotated[Path, typer.Option(help="Folder of records.")] = Path("benchmarks/results"),
    page: Annotated[
        Path, typer.Option(help="Page whose blocks are written anew; figures go beside it.")
    ] = Path("docs/performance.md"),
) -> None:
    """Write the tables and figures of docs/performance.md anew from the records."""
    with ErrorExit():
        announce("drawing ...", keep=False)
        from usarmjx.bench.report.page import write_page

        typer.echo(write_page(results, page))
