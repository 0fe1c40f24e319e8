"""`usarmjx console`: a client in a terminal."""

from __future__ import annotations

import asyncio
import importlib.util
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from usarmjx.base.errors import UsageError
from usarmjx.cli.common import ErrorExit
from usarmjx.cli.serving_options import TokenFileOption, TokenOption, access_rules

if TYPE_CHECKING:
    from usarmjx.cli.console.client import ConsoleClient
    from usarmjx.cli.console.pictures import PictureFiles, PictureStream

PLACE = "HOST:PORT"
LIBRARY = "textual"


def console(
    place: Annotated[
        str, typer.Argument(metavar=PLACE, help="The server's port for robots, as 3000.")
    ] = "3000",
    script: Annotated[
        Path | None,
        typer.Option(
            help="Send the lines of this file (-: the standard input) and print the messages; no panes."
        ),
    ] = None,
    linger: Annotated[
        float,
        typer.Option(min=0.0, help="Seconds for which messages are printed after a script's last line."),
    ] = 1.0,
    patience: Annotated[
        float, typer.Option(min=0.0, help="Seconds for which @until in a script waits for its message.")
    ] = 10.0,
    transcript: Annotated[
        Path | None, typer.Option(help="Add all messages to this file: time, direction, line.")
    ] = None,
    video: Annotated[
        str | None, typer.Option(metavar="[HOST:]PORT", help="Show pictures of this image server, as 5003.")
    ] = None,
    save_pictures: Annotated[Path | None, typer.Option(help="Put these pictures into this folder.")] = None,
    fps: Annotated[float, typer.Option(min=0.1, max=30.0, help="Most pictures per second.")] = 5.0,
    joystick: Annotated[str, typer.Option(help="auto, off, or a device as /dev/input/js0.")] = "auto",
    ask: Annotated[
        bool, typer.Option(help="Ask GETGEO and GETCONF of the robot, so that its names can be completed.")
    ] = True,
    token: TokenOption = None,
    token_file: TokenFileOption = None,
) -> None:
    """Talk to a server in a terminal: send commands, see messages and pictures, drive by keys or joystick.

    With panes, unless --script is given. Of a script, lines that begin with # are not sent, @sleep 1.5 waits,
    and @until STA waits for a message that begins so.
    """
    with ErrorExit():
        from usarmjx.cli.console.client import ConsoleClient, Transcript, parse_place

        known = access_rules(None, token, token_file, None).token
        host, port = parse_place(place)
        pictures, files = _pictures(video, save_pictures, host, fps, known)
        with Transcript(transcript) as kept:
            client = ConsoleClient(host, port, known, kept)
            if script is not None:
                _run_script(client, script, linger, patience, pictures, files)
            else:
                _run_panes(client, pictures, files, joystick, ask)


def _pictures(
    video: str | None, folder: Path | None, host: str, fps: float, token: str
) -> tuple[PictureStream | None, PictureFiles | None]:
    """Return the source of pictures and their folder.

    Raises:
        UsageError: No such port, or a folder without pictures.
    """
    from usarmjx.cli.console.client import parse_place
    from usarmjx.cli.console.pictures import PictureFiles, PictureStream

    if video is None:
        if folder is not None:
            raise UsageError("--save-pictures needs --video, the port of an image server")
        return None, None
    there = parse_place(video if ":" in video else f"{host}:{video}", "[HOST:]PORT")
    return PictureStream(*there, token, fps), None if folder is None else PictureFiles(folder)


def _run_script(
    client: ConsoleClient,
    script: Path,
    linger: float,
    patience: float,
    pictures: PictureStream | None,
    files: PictureFiles | None,
) -> None:
    from usarmjx.cli.console.client import read_script, run_script

    if pictures is not None and files is None:
        raise UsageError("--video with --script needs --save-pictures: there is no pane to show them in")

    def show(line: str) -> None:
        # Flushed, as a program at the other end of a pipe may react to each message.
        print(line, flush=True)

    async def run() -> None:
        await client.connect()
        saving = None if pictures is None or files is None else asyncio.create_task(pictures.save_all(files))
        try:
            await run_script(client, read_script(script), show, linger=linger, patience=patience)
            # The failure of a task is raised only where somebody asks: missing pictures would go unnoticed.
            if saving is not None and saving.done():
                saving.result()
        finally:
            if saving is not None:
                saving.cancel()

    try:
        asyncio.run(run())
    except BrokenPipeError:
        # The reader is gone. Python's flush at exit must not fail again, or the status would be 120.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _run_panes(
    client: ConsoleClient,
    pictures: PictureStream | None,
    files: PictureFiles | None,
    joystick: str,
    ask: bool,
) -> None:
    if importlib.util.find_spec(LIBRARY) is None:
        raise UsageError(f"the panes need {LIBRARY}: pip install {LIBRARY}; --script does without")
    from usarmjx.cli.console.app import ConsoleApp, ConsoleOptions
    from usarmjx.cli.console.driving import joystick_path

    extras = ConsoleOptions(_robot_classes, pictures, files, joystick_path(joystick), ask)
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise UsageError("the panes need a terminal; with --script FILE (or -) lines are sent without")
    problem = ConsoleApp(client, extras).run()
    if problem:
        raise UsageError(problem)


def _robot_classes() -> Sequence[str]:
    """Return the names of all robot classes; takes about a second, as JAX is loaded."""
    from usarmjx.models.robots import ROBOTS

    return ROBOTS.names()
