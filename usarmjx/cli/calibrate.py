"""`usarmjx calibrate`: how robots answer their motors, measured on engine `c` for engine `planar`."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from usarmjx.base.errors import UsageError
from usarmjx.base.progress import RateLimitedLog
from usarmjx.cli.common import ErrorExit, PackagesOption, PiecesOption, SeedOption, announce, say
from usarmjx.cli.known_names import check_name

COMPARED = "c", "planar"
"""The engines of all but --tasks."""


def calibrate(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            help="Classes of robots; else all that roll on wheels or tracks, with --drives those that fly or "
            "dive, too. With --tasks, tasks or folders of runs; else all tasks."
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Keep the figures in this JSON file; classes in it that have not changed are left."
        ),
    ] = None,
    markdown: Annotated[
        bool, typer.Option("--markdown", help="Measure nothing: print the packaged table.")
    ] = False,
    drives: Annotated[
        bool,
        typer.Option(
            "--drives",
            help="Instead compare poses, ranges, odometry and contacts along random drives on an open floor "
            "and in a maze, of flyers and divers in open air or water.",
        ),
    ] = False,
    tasks: Annotated[
        bool, typer.Option("--tasks", help="Instead compare the scores of policies on several engines.")
    ] = False,
    engines: Annotated[str, typer.Option(help="With --tasks: their names.")] = "c,planar",
    episodes: Annotated[
        int, typer.Option(min=1, help="With --tasks: episodes of each seed, at least.")
    ] = 100,
    seeds: Annotated[int, typer.Option(min=1, help="With --tasks: number of seeds, from --seed on.")] = 1,
    seed: SeedOption = 0,
    worlds: Annotated[int, typer.Option(min=1, help="With --tasks: worlds at once.")] = 20,
    split: Annotated[
        str | None, typer.Option(help="With --tasks: generated arenas that were not trained on, as of eval.")
    ] = None,
    packages: PackagesOption = None,
    pieces: PiecesOption = None,
) -> None:
    """Measure the responses of robots to their motors, for engine planar, and its remaining errors."""
    with ErrorExit():
        if markdown + drives + tasks > 1:
            raise UsageError("--markdown, --drives and --tasks are one each: name one of them")
        # Before JAX is imported: engines are read when the worlds of some are built already.
        for name in () if tasks else names or ():
            check_name("robot", name)
        for name in engines.split(",") if tasks else ():
            check_name("engine", name.strip())
        if markdown:
            from usarmjx.engines.planar.responses import error_table

            typer.echo(error_table())
        elif tasks:
            _print(_task_rows(names, engines, episodes, range(seed, seed + seeds), worlds, split))
        elif drives:
            _print(_drive_rows(names))
        else:
            _print(_figures(names, out))


def _print(lines: Iterator[str]) -> None:
    # Line by line as they come, because to measure them takes minutes.
    for line in lines:
        typer.echo(line)


def _figures(names: list[str] | None, out: Path | None) -> Iterator[str]:
    announce("driving robots by random orders on engines c and planar ...", engines=COMPARED)
    from usarmjx.models.files.find_robot import find_robot
    from usarmjx.models.robots import ROBOTS
    from usarmjx.sim.calibration import measure_all

    chosen = [find_robot(name) for name in names] if names else [robot for _, robot in ROBOTS]
    yield from measure_all(chosen, out, everything=not names)


def _drive_rows(names: list[str] | None) -> Iterator[str]:
    announce("driving robots on a floor and in a maze, on engines c and planar ...", engines=COMPARED)
    from usarmjx.models.files.find_robot import find_robot
    from usarmjx.models.robots import ROBOTS
    from usarmjx.train.evaluation.engine_gap import drive_table

    return drive_table([find_robot(name) for name in names or ROBOTS.names()], everything=not names)


def _task_rows(
    names: list[str] | None, engines: str, episodes: int, seeds: range, worlds: int, split: str | None
) -> Iterator[str]:
    announce("building the worlds that policies are tried in ...", engines=engines.split(","))
    from usarmjx.train.evaluation.engine_gap import TASKS_TRIED, sources_of, task_gap

    tried = sources_of(names or TASKS_TRIED)
    return task_gap(engines.split(","), tried, episodes, seeds, worlds, split, RateLimitedLog(say))
