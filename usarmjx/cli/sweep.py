"""`usarmjx sweep`: many cells of a file or of a bundled sweep; what came of them, and how two compare."""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from usarmjx.base.settings import parse_assignments, read_file
from usarmjx.cli.common import (
    ErrorExit,
    PackagesOption,
    PiecesOption,
    TaskRobotOption,
    announce,
    ends_on_signals,
    named,
    say,
    tried_on,
    with_robot,
)
from usarmjx.cli.known_names import check_file, complete_engines
from usarmjx.cli.lazy_commands import import_benchmarks

COMMANDS = ("run", "show", "compare", "report")


class FileOrCommand(TyperGroup):
    """`usarmjx sweep FILE` is `usarmjx sweep run FILE`."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:  # noqa: ANN401 - typer's own click
        """Return the command that arguments begin with; whatever is none is a file to run."""
        if args and args[0] not in COMMANDS:
            args = ["run", *args]
        return super().resolve_command(ctx, args)


app = typer.Typer(
    cls=FileOrCommand, no_args_is_help=True, help="Play many configurations of tasks, and compare them."
)

FolderArgument = Annotated[Path, typer.Argument(help="Folder of a sweep.")]
FigureOption = Annotated[Path | None, typer.Option(help="Draw it to this file, .png, .pdf, .svg or .eps.")]
TableOption = Annotated[
    Path | None, typer.Option(help="Write a row for each cell to this file, .csv or .parquet.")
]
EpisodesOption = Annotated[
    Path | None, typer.Option(help="Write a row for each episode to this file, .csv or .parquet.")
]


SweepFileArgument = Annotated[
    str, typer.Argument(metavar="FILE", help="YAML file, or the name of a bundled sweep.")
]
SweepFolderOption = Annotated[
    Path | None, typer.Option(help="Folder of the results; else sweeps/ and the file's name.")
]
RunOnOption = Annotated[
    str, typer.Option(help="Place of the batches: here, processes, ray; --engine is the physics.")
]
WorkerCountOption = Annotated[
    int | None, typer.Option(min=1, help="With processes or ray: their number; else one for each GPU.")
]
PartOption = Annotated[
    str,
    typer.Option(
        metavar="K/N", help="Play the K-th of N parts of the cells, as a job array does; all share --out."
    ),
]
AddressOption = Annotated[str | None, typer.Option(help="With ray: address of a cluster.")]
CellEngineOption = Annotated[
    str | None,
    typer.Option(
        help="Physics of all cells: warp, jax, c, planar, or auto.",
        autocompletion=complete_engines,
        callback=named("engine"),
    ),
]
CellSettingsOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        "-c",
        metavar="NAME=VALUE",
        help="A setting of all cells, or a field of their task; may be repeated.",
    ),
]
RetryOption = Annotated[bool, typer.Option("--retry", help="Play failed cells again.")]
PlanOption = Annotated[
    bool,
    typer.Option("--plan", help="Only check all cells, and say batches, compilations, time and memory."),
]
ProbeOption = Annotated[
    bool,
    typer.Option(
        "--probe/--no-probe", help="With --plan: play some steps of the largest batch for the time."
    ),
]
SweepQuietOption = Annotated[bool, typer.Option("--quiet", help="Say nothing about progress.")]
TensorboardOption = Annotated[Path | None, typer.Option(help="Folder for TensorBoard.")]
SweepWandbOption = Annotated[str | None, typer.Option(help="Project of Weights & Biases to send cells to.")]
RecordFileOption = Annotated[
    Path | None,
    typer.Option(help="In a checkout: append a record of its cost to this file, as usarmjx bench does."),
]
NoteOption = Annotated[str, typer.Option(help="Remark for readers of the record.")]


@app.command()
def run(
    what: SweepFileArgument,
    out: SweepFolderOption = None,
    run_on: RunOnOption = "here",
    workers: WorkerCountOption = None,
    address: AddressOption = None,
    part: PartOption = "1/1",
    engine: CellEngineOption = None,
    settings: CellSettingsOption = None,
    retry: RetryOption = False,
    plan: PlanOption = False,
    probe: ProbeOption = True,
    quiet: SweepQuietOption = False,
    tensorboard: TensorboardOption = None,
    wandb: SweepWandbOption = None,
    figure: FigureOption = None,
    table: TableOption = None,
    episodes: EpisodesOption = None,
    json: RecordFileOption = None,
    note: NoteOption = "",
    robot: TaskRobotOption = None,
    packages: PackagesOption = None,
    pieces: PiecesOption = None,
) -> None:
    """Play the cells of a sweep that have no result yet, and report the results of all."""
    with ErrorExit(), ends_on_signals():
        begun = time.perf_counter()  # the imports are part of the cost that a record states
        from usarmjx.sweeps.spec import find_spec, load_spec

        file = find_spec(what)
        check_file(read_file(file))
        announce(  # without --engine cells may play on jax, which deadlocks in a small pool
            f"reading {what} ...", aloud=not quiet, engines=["jax" if engine is None else tried_on(engine)]
        )
        from usarmjx.sweeps.run import parse_part, play_prepared, prepare, usual_stream
        from usarmjx.sweeps.workers import Workers

        _check_files(figure, table, episodes)
        own_part = parse_part(part)
        common = _typed(file, parse_assignments(with_robot(settings, robot), "--set"))
        if engine is not None:
            common["engine"] = engine
        spec = load_spec(file, common)
        folder = out or Path("sweeps") / spec.name
        played_on = Workers(place=run_on, count=workers, address=address)
        # Before thousands of cells are resolved: without a checkout there is no record.
        recording = None if json is None or plan else import_benchmarks("benchmarks.sweep")
        prepared = prepare(spec, folder, retry, own_part)
        if plan:
            _show_plan(spec, prepared, played_on, probe)
            raise typer.Exit(1 if prepared.broken else 0)
        meter = None if recording is None else recording.SweepMeter(begun)
        sinks = [*_sinks(tensorboard, wandb, spec.name), *([] if meter is None else [meter])]
        loud: dict[str, Any] = {} if quiet else {"say": say_line, "stream": usual_stream()}
        found = play_prepared(spec, folder, prepared, played_on, sinks=sinks, **loud)
        _tell(found, figure, table, episodes)
        if json is not None:
            _record(found, prepared.plan, meter, played_on, json, note)
        if any(record.failed is not None for record in found.records):
            raise typer.Exit(1)


@app.command()
def show(
    folder: FolderArgument,
    figure: FigureOption = None,
    table: TableOption = None,
    episodes: EpisodesOption = None,
) -> None:
    """Report the results of a sweep, finished or not."""
    with ErrorExit():
        # No engine is built: JAX's pool of threads may be as small as the machine.
        announce(f"reading {folder} ...", engines=[])
        _check_files(figure, table, episodes)
        from usarmjx.sweeps.store import read_sweep

        _tell(read_sweep(folder), figure, table, episodes)


@app.command()
def compare(
    first: FolderArgument,
    second: Annotated[Path, typer.Argument(help="Folder of another sweep.")],
) -> None:
    """List the differences of the cells that two sweeps have in common."""
    with ErrorExit():
        announce(f"reading {first} and {second} ...", engines=[])
        from usarmjx.sweeps.report import compare as compared
        from usarmjx.sweeps.store import read_sweep

        typer.echo(compared(read_sweep(first), read_sweep(second)))


@app.command()
def report(folder: FolderArgument) -> None:
    """Write a page that works without a network and LaTeX tables into the folder: report.html, report.tex."""
    with ErrorExit():
        announce(f"reading {folder} ...", engines=[])
        from usarmjx.sweeps.page import write_report
        from usarmjx.sweeps.store import read_sweep

        for file in write_report(read_sweep(folder), folder):
            typer.echo(f"wrote {file}")


def _show_plan(spec: Any, prepared: Any, workers: Any, probe: bool) -> None:  # noqa: ANN401
    """Print what would be played, and on request the time and memory of it after a probe."""
    typer.echo(f"{prepared.known} of {len(spec.cells)} cells are there already")
    typer.echo(prepared.plan.as_text())
    for record in prepared.broken:
        typer.echo(f"fails: {record.failed}")
    if not probe or not prepared.cells:
        return
    announce("playing some steps of the largest batch ...")
    from usarmjx.sweeps.progress import probe_works
    from usarmjx.sweeps.run import batches_of

    found = probe_works(batches_of(prepared))
    count = 1 if workers.place == "here" else workers.count or 1
    typer.echo("no probe: clients drive all cells" if found is None else found.as_text(count))


def say_line(line: str) -> None:
    """Write a line of a plan to the standard error stream."""
    say(line)


def _typed(file: Path, texts: Mapping[str, str]) -> dict[str, Any]:
    """Return settings of all cells from texts; names that cells do not have are fields of their tasks."""
    from usarmjx.sweeps.resolve import typed_settings
    from usarmjx.sweeps.spec import load_spec

    if not texts:
        return {}
    # Types of fields depend on the task: `--set task=` changes it before all others are read.
    tasks = [texts["task"]] if "task" in texts else [cell["task"] for cell in load_spec(file).cells]
    return typed_settings(texts, tasks)


def _sinks(tensorboard: Path | None, wandb: str | None, name: str) -> list[Any]:
    from usarmjx.sweeps.run import tensorboard_sink, wandb_sink

    sinks: list[Any] = [] if tensorboard is None else [tensorboard_sink(tensorboard)]
    return sinks if wandb is None else [*sinks, wandb_sink(wandb, name)]


def _record(found: Any, plan: Any, meter: Any, workers: Any, file: Path, note: str) -> None:  # noqa: ANN401
    """Append what a sweep took to a file of records, and say it."""
    sweep, tools = import_benchmarks("benchmarks.sweep"), import_benchmarks("benchmarks.tools")
    record = sweep.sweep_record(found, plan, meter, workers, note)
    tools.append_record(record, file)
    typer.echo(f"{sweep.record_line(record)}: {file}")


def _check_files(figure: Path | None, table: Path | None, episodes: Path | None) -> None:
    """Refuse names of files that cannot be written, before hours of play."""
    from usarmjx.plots.style import check_figure
    from usarmjx.sweeps.table import check_table

    if figure is not None:
        check_figure(figure)
    for path in (table, episodes):
        if path is not None:
            check_table(path)


def _tell(found: Any, figure: Path | None, table: Path | None, episodes: Path | None) -> None:  # noqa: ANN401
    """Print what came of a sweep, and write what was asked for."""
    from usarmjx.sweeps.report import report as report_text
    from usarmjx.sweeps.table import cell_rows, episode_rows, export_rows

    typer.echo(report_text(found))
    if figure is not None:
        from usarmjx.sweeps.figures import plot_sweep

        for file in plot_sweep(found, figure):
            typer.echo(f"wrote {file}")
    for path, rows_of in ((table, cell_rows), (episodes, episode_rows)):
        if path is not None:
            export_rows(rows_of(found), path)
            typer.echo(f"wrote {path}")
