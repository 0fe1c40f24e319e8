"""`usarmjx calibrate`: how robots answer their motors, measured on engine `c` for engine `planar`."""

from pathlib import Path
from typing import Annotated

import typer

from usarmjx.cli.tools import ErrorExit
from usarmjx.cli.waiting import announce


def calibrate(
    robots: Annotated[
        list[str] | None, typer.Argument(help="Classes; else all that roll on wheels or tracks.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Keep the figures in this JSON file; classes in it that have not changed are left."
        ),
    ] = None,
    markdown: Annotated[
        bool, typer.Option("--markdown", help="Measure nothing: print the table of what ships.")
    ] = False,
) -> None:
    """Measure how robots answer their motors, for engine planar, and how far off it is with that."""
    with ErrorExit():
        if markdown:
            from usarmjx.engines.planar.responses import error_table

            typer.echo(error_table())
            return
        from usarmjx.models.robots import ROBOTS
        from usarmjx.sim.calibration import measure_all

        chosen = [ROBOTS.get(name) for name in robots] if robots else [robot for _, robot in ROBOTS]
        announce("driving robots by random orders on engines c and planar ...")
        for line in measure_all(chosen, out, everything=not robots):
            typer.echo(line)
