"""`usarmjx demo`: the main job on real input."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from usarmjx.cli.tools import ErrorExit
from usarmjx.cli.waiting import announce


def demo(
    out: Annotated[Path, typer.Option(help="Folder for the picture and the log.")] = Path("out"),
    seconds: Annotated[float, typer.Option(min=1.0, help="Simulated seconds to wander.")] = 20.0,
) -> None:
    """Run the main job: serve a batch, let a client drive a P2AT, draw what it did."""
    with ErrorExit():
        announce("starting a server, and a robot to drive in it ...")
        from usarmjx.cli.demo_run import run_demo

        sys.exit(run_demo(out, seconds))
