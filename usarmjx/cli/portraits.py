"""`usarmjx portraits`: pictures of robots."""

from pathlib import Path
from typing import Annotated

import typer

from usarmjx.cli.completion import complete_robots
from usarmjx.cli.tools import ErrorExit, OutOption, chosen_out
from usarmjx.cli.waiting import announce


def portraits(
    robots: Annotated[
        list[str] | None,
        typer.Argument(help="Robot classes; all without any.", autocompletion=complete_robots),
    ] = None,
    out: OutOption = None,
) -> None:
    """Draw robots with the sensors' raycaster."""
    with ErrorExit():
        named = [*(robots or ())]
        # Once the file came first.
        old = Path(named.pop(0)) if out is None and named and named[0].lower().endswith(".png") else None
        where = chosen_out(out, old)
        announce("drawing robots ...")
        from usarmjx.models.robots import ROBOTS
        from usarmjx.plots.portrait import portraits as draw_all

        draw_all(named or ROBOTS.names(), where)
        typer.echo(f"wrote {where}")
