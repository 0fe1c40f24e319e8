"""`usarmjx sensor-plots`: the pictures of docs/sensors.md."""

from pathlib import Path
from typing import Annotated

import typer

from usarmjx.cli.tools import ErrorExit
from usarmjx.cli.waiting import announce


def sensor_plots(
    out: Annotated[Path, typer.Argument(help="Folder for the pictures.")],
    only: Annotated[list[str] | None, typer.Argument(help="Which of them; all without any.")] = None,
) -> None:
    """Draw what sensors see and how wrong they are: the pictures of docs/sensors.md."""
    with ErrorExit():
        announce("drawing what sensors see ...")
        import usarmjx.plots.camera_plots  # noqa: F401 - adds its plots
        from usarmjx.plots.sensor_plots import PLOTS, plot

        for name in only or PLOTS.names():
            typer.echo(f"wrote {plot(name, out)}")
