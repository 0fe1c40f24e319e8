"""The commands `usarmjx bench ...`: a case and a record's options in, a summary for people out."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.cases import (
    AllBaselineOptions,
    BaselineOptions,
    CameraCase,
    CompileCase,
    ContestCase,
    MemoryCase,
    PeerFolders,
    RadioCase,
    RayCase,
    RecordOptions,
    ScorecardCase,
    ServeCase,
    StepCase,
    TrainCase,
    ViewerCase,
)
from usarmjx.base.errors import UsageError
from usarmjx.cli.common import ErrorExit, IniOption, UnitOption, announce, configure_from
from usarmjx.cli.setting_options import with_settings

app = typer.Typer(help="Measure the speed of this machine.", no_args_is_help=True)


@app.command("radio")
@with_settings
def bench_radio(case: RadioCase, record: AllBaselineOptions) -> None:
    """Measure the links of all pairs of robots, walls counted."""
    with ErrorExit():
        announce("measuring the radio ...", keep=False)
        from benchmarks.radio import measure_radio

        typer.echo(measure_radio(case, record))


@app.command("rays")
@with_settings
def bench_rays(case: RayCase, record: AllBaselineOptions) -> None:
    """Measure laser scans of all robots, and the same by brute force."""
    with ErrorExit():
        announce("measuring rays ...", keep=False)
        from benchmarks.rays import measure_rays

        typer.echo(measure_rays(case, record))


@app.command("camera")
@with_settings
def bench_camera(case: CameraCase, record: AllBaselineOptions) -> None:
    """Measure pictures of all robots' main cameras: colours, depth and segmentation."""
    with ErrorExit():
        announce("measuring pictures ...", keep=False)
        from benchmarks.camera import measure_camera

        typer.echo(measure_camera(case, record))


@app.command("step")
@with_settings
def bench_step(
    case: StepCase, record: AllBaselineOptions, ini: IniOption = None, uu_per_metre: UnitOption = 250.0
) -> None:
    """Measure bare physics and the whole step (control, physics, sensors, resets) in one run."""
    with ErrorExit():
        case.check_names(ini)
        engines = [case.engine, "jax"] if record.baselines == "all" else [case.engine]
        announce("measuring steps ...", keep=False, engines=engines)
        configure_from(ini, uu_per_metre)
        from benchmarks.step import measure_step

        typer.echo(measure_step(case, record))


@app.command("viewer")
@with_settings
def bench_viewer(case: ViewerCase, record: BaselineOptions) -> None:
    """Measure the cost of the live page, and the load that a server with a page bears."""
    with ErrorExit():
        announce("measuring the live page ...", keep=False)
        from benchmarks.viewer import measure_viewer

        typer.echo(measure_viewer(case, record))


@app.command("serve")
@with_settings
def bench_serve(
    case: ServeCase,
    record: BaselineOptions,
    checkout: Annotated[
        list[Path] | None,
        typer.Option(help="Source tree whose server is measured too, in turn with ours; may be repeated."),
    ] = None,
) -> None:
    """Measure the waits of clients of `usarmjx serve`, and the cost of robots, over TCP."""
    with ErrorExit():
        announce("measuring a server ...", keep=False)
        from benchmarks.serve import measure_serve

        typer.echo(measure_serve(case, checkout or (), record, partial(typer.echo, err=True)))


@app.command("train")
@with_settings
def bench_train(
    case: TrainCase,
    record: BaselineOptions,
    runs: Annotated[
        list[Path] | None, typer.Argument(help="Folders of runs that were trained here just now.")
    ] = None,
    baseline: Annotated[float | None, typer.Option(help="Score of the task's baseline.")] = None,
) -> None:
    """Record runs of `usarmjx train`: their speed and curves, and when they were as good as the baseline."""
    with ErrorExit():
        if bool(runs) == (case.task is not None):
            raise UsageError("name folders of runs, or a task to train: --task TASK")
        announce(f"training {case.task} ..." if case.task else "reading runs ...")
        from benchmarks.train import measure_training, record_run

        if case.task is not None:
            typer.echo(measure_training(case, baseline, record))
        for run in runs or ():
            typer.echo(record_run(run, baseline, record))


@app.command("physics")
@with_settings
def bench_physics(case: ScorecardCase, record: RecordOptions) -> None:
    """Drive every class through manoeuvres under settings or on an engine, and under the reference's on c."""
    with ErrorExit():
        announce("driving ...", keep=False)
        from benchmarks.fidelity.scorecard import write_scorecard

        typer.echo(write_scorecard(case, record))


@app.command("compile")
@with_settings
def bench_compile(case: CompileCase, record: BaselineOptions) -> None:
    """Measure the time until the first step: imports, scene, tracing, XLA; cold and with a filled cache."""
    with ErrorExit():
        case.check_names()
        announce("measuring compilation ...", keep=False)
        from benchmarks.compiling import measure_compile

        typer.echo(measure_compile(case, record))


@app.command("memory")
@with_settings
def bench_memory(case: MemoryCase, record: BaselineOptions) -> None:
    """Measure the memory of worlds, by part, and of a compiled step."""
    with ErrorExit():
        case.check_names()
        announce("measuring memory ...", keep=False)
        from benchmarks.memory import measure_memory

        typer.echo(measure_memory(case, record))


@app.command("peers")
@with_settings
def bench_peers(case: ContestCase, folders: PeerFolders, record: RecordOptions) -> None:
    """Run other simulators and ours in turn, each in its own process, and list the parts of their steps."""
    with ErrorExit():
        announce("measuring ours and others ...", keep=False)
        from benchmarks.peering.contest import measure_peers

        typer.echo(measure_peers(case, folders, record, partial(typer.echo, err=True)))


@app.command("compare")
def bench_compare(
    results: Annotated[Path, typer.Option(help="Folder of records.")] = Path("benchmarks/results"),
    tolerance: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Loss of a rate that does not count, as a share.")
    ] = 0.05,
) -> None:
    """Compare each case's newest record with the one before it on the same machine.

    Exits with status 1 where a rate fell.
    """
    with ErrorExit():
        from benchmarks.compare import compare

        text, slower = compare(results, tolerance)
        typer.echo(text)
        raise typer.Exit(int(slower > 0))


@app.command("report")
def bench_report(
    results: Annotated[Path, typer.Option(help="Folder of records.")] = Path("benchmarks/results"),
    page: Annotated[
        Path, typer.Option(help="Page whose blocks are written anew; figures go beside it.")
    ] = Path("docs/evidence/speed.md"),
) -> None:
    """Write the tables and figures of docs/evidence/speed.md anew from the records."""
    with ErrorExit():
        announce("drawing ...", keep=False)
        from benchmarks.report.page import write_page

        typer.echo(write_page(results, page))
