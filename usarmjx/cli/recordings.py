"""`usarmjx view`, `film`, `plot` and `replay`: commands about a recording; the option that makes one."""

import contextlib
import math
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from usarmjx.base.errors import UsageError
from usarmjx.cli.common import ErrorExit, announce, say
from usarmjx.cli.viewer_options import ViewerPortOption, viewer_server, viewer_socket

if TYPE_CHECKING:
    from usarmjx.comms.attenuation import RadioSettings
    from usarmjx.recording.file import RecordingFile
    from usarmjx.recording.reader import CameraShot
    from usarmjx.server.worlds.served_world import ServedWorld
    from usarmjx.train.envs.env import Env
    from usarmjx.train.envs.state import EnvState


HOST = "127.0.0.1"
"""Host of the page of a recording."""
PAUSE = 0.01
"""Between two looks at the clock [s]."""
RecordOption = Annotated[
    Path | None,
    typer.Option(help="Keep all that happens in this file, .mcap; see `usarmjx view`, `plot`, `replay`."),
]
FileArgument = Annotated[Path, typer.Argument(help="Recording, .mcap, also one that was broken off.")]
PicturesOption = Annotated[
    float | None,
    typer.Option(
        help="Render the robots' cameras in this period into the MCAP file or ROS 2 bag [s].",
        show_default=False,
    ),
]
WorldOption = Annotated[int, typer.Option(min=0, help="Which world of the recording.")]
REPORT_PERIOD = 20.0
"""Time between two lines about the progress [s]."""


@contextlib.contextmanager
def recorded(
    worlds: "Sequence[ServedWorld]", path: Path | None, radio: "RadioSettings | None" = None
) -> "Generator[RecordingFile | None]":
    """Record served worlds while a context lasts; None: do not.

    Args:
        worlds: The worlds.
        path: The file, or None.
        radio: Constants of the radio that robots have by the server; None: they have none.

    Yields:
        The file, which is complete in the end; None: there is none.

    Raises:
        UsageError: The file is there already.
        WriteError: It cannot be written.
    """
    if path is None:
        yield None
        return
    from usarmjx.recording.file import MOST_LAG
    from usarmjx.server.worlds.recorded import record_worlds

    file = record_worlds(worlds, path, radio, MOST_LAG)
    typer.echo(f"usarmjx: recording to {path}")
    try:
        yield file
    finally:
        file.close()


@contextlib.contextmanager
def recorded_episode(
    env: "Env", path: Path | None, seed: int
) -> "Generator[Callable[[EnvState], None] | None]":
    """Give what records the first world of an environment, state by state; None: nothing does.

    Args:
        env: The environment.
        path: The file; None: nothing is to be recorded.
        seed: Seed of the environment's reset.

    Raises:
        UsageError: The file is there already.
        WriteError: It cannot be written.
    """
    if path is None:
        yield None
        return
    from usarmjx.recording.episodes import EpisodeRecorder, episode_file

    with episode_file(env, path) as file:
        yield EpisodeRecorder(env, file, range(1), seed).watch
    typer.echo(f"usarmjx: recorded to {path}")


def view(
    file: FileArgument,
    viewer_port: ViewerPortOption = None,
    html: Annotated[
        Path | None, typer.Option(help="Write one page that plays anywhere to this file, and end.")
    ] = None,
    world: WorldOption = 0,
    period: Annotated[
        float, typer.Option(min=0.02, help="With --html: time between two pictures [s].")
    ] = 0.1,
    protobuf: Annotated[
        Path | None,
        typer.Option(help="Write an MCAP file with Foxglove's protobuf schemas, as Rerun reads, and end."),
    ] = None,
    bag: Annotated[
        Path | None,
        typer.Option(help="With --protobuf: put odometry, transforms and scans of this ROS bag beside."),
    ] = None,
    bag_start: Annotated[
        float, typer.Option(help="With --bag: time of the recording at which the bag begins [s].")
    ] = 0.0,
    pictures: PicturesOption = None,
) -> None:
    """Show a recording in a browser, at any speed."""
    with ErrorExit():
        # Before the imports below, which take seconds.
        announce(f"reading {file} ...")
        if bag is not None and protobuf is None:
            raise UsageError("--bag needs --protobuf FILE, the file that both are written to")
        if pictures is not None and protobuf is None:
            raise UsageError("--pictures needs --protobuf FILE, the file that they are written to")
        if protobuf is not None:
            from usarmjx.recording.protobuf import write_protobuf

            counts = write_protobuf(file, protobuf, bag, bag_start, rendered(file, pictures))
            typer.echo(f"wrote {protobuf}, {sum(counts.values())} messages on {len(counts)} topics")
            return
        from usarmjx.recording.reader import Recording
        from usarmjx.recording.source import RecordingSource, recording_page, write_html

        recording = Recording(file)
        tell_if_broken_off(recording.is_complete, file)
        source = RecordingSource(recording)
        if html is not None:
            write_html(source, html, period, world)
            typer.echo(f"wrote {html}, {html.stat().st_size / 1e6:.1f} MB")
            return
        with viewer_socket(HOST, viewer_port, 0, True) as bound:
            # None is for servers without a page; this command always has one.
            assert bound is not None
            page, timeline = recording_page(source, viewer_server(bound, HOST))
            # Ctrl-C is the way to end a page that is looked at.
            with contextlib.suppress(KeyboardInterrupt):
                while True:
                    timeline.tick()
                    page.update()
                    time.sleep(PAUSE)
            page.close()


def rendered(file: Path, period: float | None, world: int | None = None) -> "Iterator[CameraShot]":
    """Yield pictures of the cameras in a recording, rendered as they are taken; none without a period."""
    if period is None:
        return
    from usarmjx.plots.films.picture import camera_shots
    from usarmjx.recording.reader import Recording

    # A reader may stop in the middle: the file closes with the generator.
    with contextlib.closing(Recording(file)) as recording:
        yield from camera_shots(recording, period, world)


def tell_if_broken_off(is_complete: bool, file: Path) -> None:
    """Print a note about a recording whose end is missing."""
    if not is_complete:
        typer.echo(f"usarmjx: note: {file} was broken off; its complete part is used", err=True)


def replay(
    file: FileArgument,
    check: Annotated[
        bool, typer.Option("--check/--no-check", help="Fail if anything differs; else only tell.")
    ] = True,
) -> None:
    """Compute a recording again, bit for bit; report the first number that differs, and fail then."""
    with ErrorExit():
        announce(f"reading {file} ...")
        from usarmjx.recording.reader import Recording
        from usarmjx.recording.replay import check_recording

        recording = Recording(file)
        tell_if_broken_off(recording.is_complete, file)
        differ = False
        for number in recording.worlds:
            result = check_recording(recording, number)
            which = f"world {number}: " if len(recording.worlds) > 1 else ""
            typer.echo(f"{which}{result.steps} steps, bit for bit")
            for line in filter(None, (result.difference, result.note)):
                typer.echo(f"{which}{line}")
            differ |= bool(result.difference)
        # After all worlds, so that each one's first difference is printed.
        if differ and check:
            raise typer.Exit(1)


def plot(
    file: FileArgument,
    png: Annotated[Path | None, typer.Option(help="Write the figure to this PNG file.")] = None,
    pdf: Annotated[Path | None, typer.Option(help="Write the figure to this PDF file.")] = None,
    world: WorldOption = 0,
    since: Annotated[float, typer.Option("--from", help="Leave out the time before this [s].")] = 0.0,
    until: Annotated[float, typer.Option(help="Leave out the time after this [s].")] = math.inf,
) -> None:
    """Draw a recorded mission: plan, trails, scans, radio power, victims found, and all over time."""
    with ErrorExit():
        announce(f"drawing {file} ...")
        from usarmjx.plots.recording import plot_recording
        from usarmjx.recording.reader import Recording

        wanted = [path for path in (png, pdf) if path is not None]
        if not wanted:
            raise UsageError("name the figure's file: --png FILE, --pdf FILE, or both")
        recording = Recording(file)
        tell_if_broken_off(recording.is_complete, file)
        for path in plot_recording(recording, wanted, world, (since, until)):
            typer.echo(f"wrote {path}")


BAG_SUFFIX = ".rosbag2"
"""Suffix of the folder of a bag of ROS 2."""


def export_recording(
    file: Path, out: Path, world: int = 0, speed: float = 2.0, pictures: float | None = None
) -> None:
    """Write a recording as tables, as a film or as a bag of ROS 2, as the name of the file says."""
    from usarmjx.plots.recording import FILMS, save_film
    from usarmjx.recording.reader import Recording
    from usarmjx.recording.tables import SUFFIXES, export_tables

    # Before the recording is read, which may take minutes.
    suffix = out.suffix.lower()
    if suffix not in (*SUFFIXES, *FILMS, BAG_SUFFIX):
        raise UsageError(f"{out}: recordings are exported to {', '.join((*SUFFIXES, *FILMS, BAG_SUFFIX))}")
    if pictures is not None and suffix != BAG_SUFFIX:
        raise UsageError(f"--pictures needs a file that ends in {BAG_SUFFIX}")
    recording = Recording(file)
    tell_if_broken_off(recording.is_complete, file)
    if suffix == BAG_SUFFIX:
        from usarmjx.server.ros2.bags import write_bag

        for topic, count in write_bag(recording, out, world, rendered(file, pictures, world)).items():
            typer.echo(f"{topic}: {count}")
        typer.echo(f"wrote {out}")
    elif suffix in SUFFIXES:
        written = export_tables(recording, out)
        for path in written:
            typer.echo(f"wrote {path}")
        if not written:
            raise UsageError(f"{file}: nothing is left of it that makes a table; nothing is written")
    else:
        save_film(recording, out, world, speed)
        typer.echo(f"wrote {out}")


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
        # Before the recording is read: a wrong name must not cost minutes.
        check_film(out)
        announce(f"reading {file} ...")
        recording = Recording(file)
        tell_if_broken_off(recording.is_complete, file)
        began, told = time.monotonic(), [time.monotonic()]

        def tell(done: int, of: int) -> None:
            now = time.monotonic()
            if now - told[0] > REPORT_PERIOD:
                told[0] = now
                # Pictures cost about the same: the rest takes as long as those so far, in proportion.
                left = (now - began) / done * (of - done)
                say(f"picture {done} of {of}, about {left:.0f} s left")

        count = save_film(recording, out, plan, tell)
        typer.echo(f"wrote {out}, {count} picture{'s' * (count != 1)}, {out.stat().st_size / 1e6:.1f} MB")
