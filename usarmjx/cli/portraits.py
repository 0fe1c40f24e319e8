"""`usarmjx portraits`: pictures of robots."""

from pathlib import Path
from typing import Annotated

import typer

from usarmjx.cli.tools import ErrorExit
from usarmjx.cli.waiting import announce


def portraits(
    out: Annotated[Path, typer.Argument(help="PNG file to write.")],
    robots: Annotated[list[str] | None, typer.Argument(help="Robot classes; all without any.")] = None,
) -> None:
    """Draw robots with the sensors' raycaster."""
    with ErrorExit():
        announce("drawing robots ...")
        from usarmjx.models.robots import ROBOTS
        from usarmjx.plots.portrait import portraits as draw_all

        draw_all(robots or ROBOTS.names(), out)
        typer.echo(f"wrote {out}")
