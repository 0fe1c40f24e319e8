"""`usarmjx film`: a recording as a film in three dimensions."""

import math
import time
from pathlib import Path
from typing import Annotated

import typer

from usarmjx.cli.common import ErrorExit
from usarmjx.cli.recordings import FileArgument, WorldOption, tell_if_broken_off
from usarmjx.cli.startup_messages import announce, say

REPORT_PERIOD = 20.0
"""Time between two lines about the progress [s]."""


def film(
    file: FileArgument,
    out: Annotated[
        Path,
        typer.Option(
            help="Film to write, .mp4 (needs the extra `film`) or .gif; .png, .jpg: its first picture."
        ),
    ],
    size: Annotated[str, typer.Option(help="Width and height in pixels.")] = "1280x720",
    follow: Annotated[
        str | None,
        typer.Option(help="Name of a robot that the camera follows; else it sees the whole arena."),
    ] = None,
    world: WorldOption = 0,
    since: Annotated[float, typer.Option("--from", help="Simulated time of the begin [s].")] = 0.0,
    until: Annotated[float, typer.Option(help="Simulated time of the end [s].")] = math.inf,
    speed: Annotated[float, typer.Option(min=0.01, max=1000.0, help="Simulated seconds per second.")] = 1.0,
    rate: Annotated[float, typer.Option(min=1.0, max=60.0, help="Pictures per second.")] = 30.0,
    signs: Annotated[
        bool,
        typer.Option("--signs/--no-signs", help="Draw laser scans, rings, trails, names, time and score."),
    ] = True,
) -> None:
    """Write a recording as a film in three dimensions, without a screen.

    Example: usarmjx film mission.mcap --out mission.mp4 --size 1920x1080 --follow P2AT1
    """
    with ErrorExit():
        from usarmjx.plots.films.film import FilmPlan, check_film, parse_size, save_film
        from usarmjx.recording.reader import Recording

        plan = FilmPlan(
            size=parse_size(size),
            follow=follow,
            world=world,
            span=(since, until),
            speed=speed,
            rate=rate,
            signs=signs,
        )
        check_film(out)
        announce(f"reading {file} ...")
        recording = Recording(file)
        tell_if_broken_off(recording.is_complete, file)
        began, told = time.monotonic(), [time.monotonic()]

        def tell(done: int, of: int) -> None:
            now = time.monotonic()
            if now - told[0] > REPORT_PERIOD:
                told[0] = now
                left = (now - began) / done * (of - done)
                say(f"picture {done} of {of}, about {left:.0f} s left")

        count = save_film(recording, out, plan, tell)
        typer.echo(f"wrote {out}, {count} picture{'s' * (count != 1)}, {out.stat().st_size / 1e6:.1f} MB")
