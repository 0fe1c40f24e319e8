"""`usarmjx bench serve` and `usarmjx bench viewer`: what clients and onlookers of a server meet."""

from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from usarmjx.base.errors import UsageError
from usarmjx.cli.bench_options import (
    BaselinesOption,
    JsonOption,
    LimitOption,
    NoteOption,
    one_class,
)
from usarmjx.cli.tools import EngineOption, ErrorExit
from usarmjx.cli.waiting import announce

app = typer.Typer()


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
    limit: LimitOption = 120.0,
    note: NoteOption = "",
    baselines: BaselinesOption = "cpu",
    json: JsonOption = None,
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
        typer.echo(measure_viewer(case, json, note, baselines))


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
        from usarmjx.bench.serve import ServeCase, measure_serve
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
