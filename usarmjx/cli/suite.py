"""`usarmjx suite`: a method's results in a suite of tasks, standings of methods, the leaderboard."""

import json as json_format
from pathlib import Path
from typing import Annotated

import typer

from usarmjx.base.errors import UsageError
from usarmjx.base.files import atomic_write
from usarmjx.base.registry import unknown_name
from usarmjx.cli.common import ErrorExit, announce, ends_on_signals, tried_on
from usarmjx.cli.known_names import check_run
from usarmjx.cli.sweep import CellEngineOption, RunOnOption, SweepQuietOption, WorkerCountOption, say_line

app = typer.Typer(no_args_is_help=True, help="Play methods through a suite of tasks, and rank them.")

SuiteOption = Annotated[str, typer.Option(help="YAML file, or the name of a bundled suite.")]
ResultsArgument = Annotated[list[Path], typer.Argument(help="Results files, or folders of them.")]


@app.command()
def run(
    method: Annotated[str, typer.Argument(help="Name of the method in tables.")],
    runs: Annotated[
        list[str] | None,
        typer.Argument(
            help="Its runs: folder of a run, exported file, baseline, packaged, random, a planner such as "
            "oracle, baseline:NAME, FILE.py:FUNCTION, client:COMMAND; {task} stands for each task. Default: "
            "the method's name."
        ),
    ] = None,
    suite: SuiteOption = "teams-v3",
    split: Annotated[str, typer.Option(help="validation, to choose by; test, to report.")] = "validation",
    out: Annotated[Path, typer.Option(help="Folder of the results files.")] = Path("results"),
    engine: CellEngineOption = None,
    episodes: Annotated[
        int | None, typer.Option(min=1, help="Play the first of each cell only; for trials.")
    ] = None,
    run_on: RunOnOption = "here",
    workers: WorkerCountOption = None,
    note: Annotated[str, typer.Option(help="Remark for readers of the results.")] = "",
    quiet: SweepQuietOption = False,
) -> None:
    """Play all runs of a method through a suite, and write a results file for each."""
    with ErrorExit(), ends_on_signals():
        from usarmjx.sweeps.spec import SPLITS_OF_SUITES, find_suite

        file = find_suite(suite)
        # Before JAX is imported, which takes seconds.
        for one in runs or [method]:
            check_run(one)
        if split not in SPLITS_OF_SUITES:
            raise UsageError(unknown_name("split", split, SPLITS_OF_SUITES))
        engines = ["planar" if engine is None else tried_on(engine)]
        announce(f"reading suite {suite} ...", aloud=not quiet, engines=engines)
        from usarmjx.sweeps.run import usual_stream
        from usarmjx.sweeps.suite import load_suite, run_suite
        from usarmjx.sweeps.workers import Workers

        # Only typed settings: all others stay as the suite's file has them.
        common: dict[str, object] = {} if engine is None else {"engine": engine}
        if episodes is not None:
            common["episodes"] = episodes
        files = run_suite(
            load_suite(file),
            split,
            method,
            runs or [method],
            out,
            workers=Workers(place=run_on, count=workers),
            say=None if quiet else say_line,
            stream=None if quiet else usual_stream(),
            note=note,
            **common,
        )
        for file in files:
            typer.echo(f"wrote {file}")


@app.command()
def show(
    results: ResultsArgument,
    suite: SuiteOption = "teams-v3",
    split: Annotated[str, typer.Option(help="Split of the results.")] = "validation",
    figure: Annotated[
        Path | None, typer.Option(help="Draw performance profiles to this file, .png, .pdf, .svg or .eps.")
    ] = None,
    json: Annotated[Path | None, typer.Option(help="Write the standings to this file.")] = None,
) -> None:
    """Compare methods: a table for each task, and normalised scores over all tasks."""
    with ErrorExit():
        from usarmjx.sweeps.spec import find_suite

        file = find_suite(suite)
        announce("resampling runs and buildings ...", engines=[])
        from usarmjx.sweeps.standings import standings_of, standings_record, standings_report
        from usarmjx.sweeps.suite import load_suite, read_results

        # Before the resampling, which takes long.
        if figure is not None:
            from usarmjx.plots.style import check_figure

            check_figure(figure)
        chosen = load_suite(file)
        own = [one for one in read_results(results) if (one.suite, one.split) == (chosen.name, split)]
        if not own:
            raise UsageError(f"no results of suite {chosen.name} on split {split} there")
        found = standings_of(own, chosen)
        typer.echo(standings_report(found))
        if json is not None:
            with atomic_write(json) as fresh:
                fresh.write_text(
                    json_format.dumps(standings_record(found), indent=1) + "\n", encoding="utf-8"
                )
        if figure is not None:
            from usarmjx.sweeps.figures import plot_profiles

            plot_profiles(found, figure)
            typer.echo(f"wrote {figure}")


@app.command()
def leaderboard(
    results: Annotated[Path, typer.Argument(help="Folder of results files.")] = Path("leaderboard"),
    out: Annotated[Path, typer.Option(help="Page to write.")] = Path("docs/leaderboard.md"),
) -> None:
    """Write the leaderboard page from results files on split test."""
    with ErrorExit():
        announce("resampling runs and buildings ...", engines=[])
        from usarmjx.sweeps.standings import write_leaderboard

        write_leaderboard(results, out)
        typer.echo(f"wrote {out}")


@app.command()
def replay(
    file: Annotated[Path, typer.Argument(help="Results file of a run.")],
    suite: Annotated[
        str | None, typer.Option(help="Suite, if it is not the bundled one of its name.")
    ] = None,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes of each task.")] = 3,
    run: Annotated[
        str | None,
        typer.Option(help="The run in the file, if you trust its code: FILE.py:FUNCTION or client:COMMAND."),
    ] = None,
) -> None:
    """Play the first buildings of a results file again, and print the differences."""
    with ErrorExit(), ends_on_signals():
        from usarmjx.sweeps.spec import find_suite

        if suite is not None:
            find_suite(suite)
        announce(f"playing {episodes} buildings of each task in {file} ...", engines=[])
        from usarmjx.sweeps.standings import replay as play_again
        from usarmjx.sweeps.suite import load_suite, read_result

        result = read_result(file)
        again = play_again(result, load_suite(find_suite(suite or result.suite)), episodes, run=run)
        for one in again:
            buildings = "same buildings" if one.same_buildings else "OTHER BUILDINGS"
            typer.echo(
                f"{one.task}: {one.before.mean():.4g} in the file, {one.after.mean():.4g} now, largest "
                f"difference {one.largest:.3g}, {buildings}"
            )
        # Scores in other buildings do not compare; other scores in the same ones are for the reader to judge.
        if not all(one.same_buildings for one in again):
            raise typer.Exit(1)
