"""`usarmjx demo`: robots to look at and to drive; or the main job, checked."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from usarmjx.base.errors import UsageError
from usarmjx.cli.ros_options import RosbridgePortOption
from usarmjx.cli.tools import ErrorExit
from usarmjx.cli.viewer_options import ViewerPortOption
from usarmjx.cli.waiting import announce
from usarmjx.server.ports import LAST_PORT

JOB = "With --headless"
FOLDER = Path("out")
"""Where the headless demonstration writes to."""
SECONDS = 20.0
"""So long it drives [s]."""


def demo(
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page in a browser, where one can.")
    ] = True,
    port: Annotated[
        int | None,
        typer.Option(min=0, max=LAST_PORT, help="TCP port for clients; else 3000, or a free one."),
    ] = None,
    viewer_port: ViewerPortOption = None,
    rosbridge_port: RosbridgePortOption = None,
    headless: Annotated[
        bool,
        typer.Option(
            "--headless",
            help="Serve a batch, let a client drive a P2AT over TCP, draw and judge what it did.",
        ),
    ] = False,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the picture and the log; else out.", rich_help_panel=JOB)
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(min=1.0, help="Simulated seconds; else 20.", rich_help_panel=JOB)
    ] = None,
) -> None:
    """Show four robots that explore an arena, in a browser: look on, or take one over.

    With --headless, or where --out says where to, the main job runs instead, once, and ends: exit code 0,
    or 1 if the robot touched something or hardly moved.
    """
    with ErrorExit():
        if not (headless or out):
            if seconds is not None:
                raise UsageError("--seconds is for --headless; Ctrl-C ends the live demonstration")
            from usarmjx.cli.demo_live import run_live

            run_live(browser, port, viewer_port, rosbridge_port)
            return
        if any(one is not None for one in (port, viewer_port, rosbridge_port)):
            raise UsageError("ports are for the live demonstration, without --headless")
        announce("starting a server, and a robot to drive in it ...")
        from usarmjx.cli.demo_run import run_demo

        sys.exit(run_demo(out or FOLDER, seconds or SECONDS))
