"""`usarmjx sensor-plots`: the pictures of docs/sensors.md."""

from pathlib import Path
from typing import Annotated

import typer

from usarmjx.cli.tools import ErrorExit, OutFolderOption, chosen_out
from usarmjx.cli.waiting import announce


def sensor_plots(
    only: Annotated[list[str] | None, typer.Argument(help="Which of them; all without any.")] = None,
    out: OutFolderOption = None,
) -> None:
    """Draw what sensors see and how wrong they are: the pictures of docs/sensors.md."""
    with ErrorExit():
        named = [*(only or ())]
        # Once the folder came first.
        where = chosen_out(out, Path(named.pop(0)) if out is None and named else None)
        announce("drawing what sensors see ...")
        import usarmjx.plots.camera_plots  # noqa: F401 - adds its plots
        from usarmjx.plots.sensor_plots import PLOTS, plot

        for name in named or PLOTS.names():
            typer.echo(f"wrote {plot(name, where)}")
