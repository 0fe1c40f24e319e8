"""`usarmjx demo`: robots to look at and to drive; or the main job, checked."""

import json
import logging
import os
import re
import signal
import subprocess
import sys
import threading
import webbrowser
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Timer
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from usarmjx.base.errors import UsageError, UsarmjxError
from usarmjx.base.files import writing
from usarmjx.cli.common import ErrorExit
from usarmjx.cli.serving_options import (
    Host,
    ListenOptions,
    RosbridgePortOption,
    RosOptions,
    RunOptions,
    ViewerOptions,
    port_of,
)
from usarmjx.cli.startup_messages import announce
from usarmjx.cli.viewer_options import ViewerPortOption
from usarmjx.models.arenas import ARENAS
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.plots.picture import run_picture, tracked_poses
from usarmjx.server.network.ports import BOT_PORT, LAST_PORT, bound_socket
from usarmjx.server.runtime.signals import StopSignals

if TYPE_CHECKING:
    from usarmjx.models.types.arena import ArenaSpec
    from usarmjx.server.worlds.policy_world import PolicyWorld


TASK, ARENA = "explore", "yellow"
STARTS = ("Start26", "Start43", "Start39", "Start14")
"""Start poses of the team, in different parts of the arena."""
EPISODE_STEPS = 600
"""So many actions of 0.2 s after which the team forgets its maps and explores anew."""
CUTOFF = -70.0
"""Signals weaker than this are not heard [dBm]; with the task's own cutoff links hold for 3 m at most."""
LAYERS = ("Radio links",)
"""What the page shows beside what it always does."""
SAY_EVERY = 5.0
"""While it compiles a line says so as often [s]."""
TITLE = "usarmjx demo"


class DemoGuide:
    """A `net.Service`: tells how to begin once the robots move, and opens the page in a browser.

    Args:
        page: Address of the page.
        port: Where clients connect.
        robots: Names of the robots.
        browser: Whether a browser is to be opened.
    """

    def __init__(self, page: str, port: int, robots: Sequence[str], browser: bool) -> None:
        self._page, self._port, self._robots, self._browser = page, port, robots, browser
        self._told = False

    async def start(self) -> list[str]:
        """Begin; there is nothing to say before robots move."""
        return []

    def tick(self) -> None:
        """The world has made a control step: the robots move."""
        if self._told:
            return
        self._told = True
        typer.echo(guide_text(self._page, self._port, self._robots))
        if self._browser:
            # It may take as long as it likes to start.
            threading.Thread(target=open_page, args=(self._page,), name="browser", daemon=True).start()

    def stop(self) -> None:
        """End."""


def guide_text(page: str, port: int, robots: Sequence[str]) -> str:
    """Return what to do at the page, and what to try next."""
    last = robots[-1]
    return f"""
{len(robots)} robots explore {ARENA}, driven by the shipped policy for the task `{TASK}`: {page}

  Take one over: press "Take the controls", choose {last} under Robot, press "Take over",
  click beside the arrows, and hold W A S D or the arrow keys; "Give it back" lets the policy go on.
  Click a robot to look through its camera; "Show" switches scans, radio links and the team's map.

What to try next, in another terminal:
  usarmjx console {port}     a client here: INIT {{ClassName USARBot.P2AT}} {{Name {last}}} takes {last}
  usarmjx serve            an arena that waits for a controller of your own
  usarmjx train drive-to-goal --out runs/goal --view
  usarmjx list             robots, sensors, arenas, tasks, policies, engines

Ctrl-C ends the demonstration.
"""


def has_display(environment: Mapping[str, str] = os.environ, platform: str = sys.platform) -> bool:
    """Return whether a browser can show something here: on Linux only where there is a display."""
    if not platform.startswith(("linux", "freebsd")):
        return True
    return any(environment.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"))


def open_page(address: str) -> None:
    """Open a page in the user's browser; where none can be opened the address was told anyway."""
    try:
        webbrowser.open(address)
    except (webbrowser.Error, OSError) as error:
        logging.getLogger(__name__).info("no browser: %s", error)


def run_live(browser: bool, port: int | None, viewer_port: int | None, rosbridge_port: int | None) -> None:
    """Serve the demonstration until a signal comes.

    Args:
        browser: Whether to open a browser, where there is a display.
        port: Where clients connect; None: the usual port, or a free one where that is taken.
        viewer_port: Where the page is; None: likewise.
        rosbridge_port: Where clients of ROS connect; None: nowhere.

    Raises:
        UsageError: A port is taken.
    """
    listen = ListenOptions(port=_free(BOT_PORT) if port is None else port)
    host = Host(
        listen=listen,
        settings=listen.settings((), None),
        numbers=(0,),
        run=RunOptions(),
        viewer=ViewerOptions(viewer_port=viewer_port),
        view=True,
        services=(RosOptions(rosbridge_port=rosbridge_port),),
        layers=LAYERS,
    )
    with StopSignals() as signals, host.ports() as ports:
        announce(
            "building four robots in a maze; half a minute the first time ...",
            quickly=True,
            interval=SAY_EVERY,
        )
        services = host.prepare()
        world = make_world()
        assert ports.page is not None
        page = f"http://{listen.host}:{port_of(ports.page)}/"
        guide = DemoGuide(
            page, port_of(ports.bound[0]["--port"]), [*world.agents()], browser and has_display()
        )
        host.serve([world], ports, services, signals, batch_size=1, more=[guide])


def make_world() -> "PolicyWorld":
    """Return the world in which the shipped policy explores."""
    from usarmjx.models.arenas import ARENAS
    from usarmjx.server.worlds.policy_world import PolicyBatch, PolicyWorld
    from usarmjx.train.baselines import BASELINES
    from usarmjx.train.make import make
    from usarmjx.train.tasks.team import WALLED_RADIO

    arena = starting_at(ARENAS.get(ARENA), STARTS)
    radio = replace(WALLED_RADIO, cutoff=CUTOFF)
    env = make(TASK, engine="c", arena=arena, episode_steps=EPISODE_STEPS, radio=radio)
    return PolicyWorld(PolicyBatch(env, BASELINES.get(TASK)(env)))


def starting_at(arena: "ArenaSpec", tags: tuple[str, ...]) -> "ArenaSpec":
    """Return an arena whose first start poses are those of some tags."""
    starts = {start.tag: start for start in arena.starts}
    rest = [start for start in arena.starts if start.tag not in tags]
    return replace(arena, starts=(*(starts[tag] for tag in tags), *rest))


def _free(port: int) -> int:
    """Return a port if it is free, else 0: any."""
    try:
        with bound_socket("127.0.0.1", port):
            return port
    except UsageError:
        return 0


ROOT = Path(__file__).resolve().parents[2]
CONTROLLER = ROOT / "usarmjx" / "client" / "wander.py"
WORLDS = 4
START_LIMIT = 120.0
"""How long the server may take to start [s]: the first time it compiles."""
STOP_LIMIT = 15.0
"""How long it may take to stop [s]."""
MIN_SPEED = 0.15
"""Average speed that a run must reach [m/s]: 3 m in 20 s."""
OBSTACLE_MIN_HEIGHT = 0.1
"""What is lower than this is for driving over, as ramps are [m]; a P2AT's wheel has 0.13."""
TOUCH_CLEARANCE = 0.01
"""Clearance below which the hull counts as touching: the last place of GroundTruth's numbers [m]."""
POSES_PER_REPORT = 4
"""Poses looked at per report: 0.2 s at 0.45 m/s would leave 9 cm unseen."""
LISTENING = re.compile(r"listening on [\d.]+:(\d+)")
SIMULATED = re.compile(r"\s*([\d.]+) s")


class DemoError(UsarmjxError):
    """The demonstration cannot run here; the message says why."""


@dataclass(frozen=True)
class RunReport:
    """What came out of a run.

    Attributes:
        distance: Way driven [m].
        odometry_error: Distance of odometry's last pose from the truth [m].
        ins_error: Likewise for the INS [m].
        clearance: Least distance from hull to walls and obstacles [m]; 0 when they overlap.
        simulated: Simulated time from the first report to the last [s].
        realtime_factor: Simulated seconds per second while the controller drove.
        messages: Messages that the controller received.
        fast_enough: Whether it drove as far as a run of this length must.
    """

    distance: float
    odometry_error: float
    ins_error: float
    clearance: float
    simulated: float
    realtime_factor: float
    messages: int
    fast_enough: bool

    @property
    def touched(self) -> bool:
        """Whether the hull met a wall or an obstacle."""
        return self.clearance < TOUCH_CLEARANCE


def obstacles(arena: ArenaSpec) -> np.ndarray:
    """Return x0, y0, x1, y1 of the solids to keep away from [m] (solids, 4).

    Those are upright boxes taller than `OBSTACLE_MIN_HEIGHT`; ramps are tilted, boards are low.
    """
    boxes = [
        (s.at[0] - s.size[0], s.at[1] - s.size[1], s.at[0] + s.size[0], s.at[1] + s.size[1])
        for s in arena.shapes
        if s.kind == "box" and not any(s.rotation) and s.at[2] + s.size[2] > OBSTACLE_MIN_HEIGHT
    ]
    return np.array(boxes, float).reshape(-1, 4)


def clearance(pose: np.ndarray, half: tuple[float, float], boxes: np.ndarray) -> float:
    """Return the distance in the plane between a hull and the nearest box [m], 0 when they overlap.

    Args:
        pose: x, y [m] and yaw [rad] of the hull's centre (3,).
        half: Its half length and half width [m].
        boxes: x0, y0, x1, y1 of each (boxes, 4).
    """
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    turn = np.array([[cos, sin], [-sin, cos]])  # row vectors: hull to world; its transpose is back
    signs = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
    hull = (signs * half) @ turn + pose[:2]
    centre, size = (boxes[:, None, 2:] + boxes[:, None, :2]) / 2, boxes[:, None, 2:] - boxes[:, None, :2]
    corners = centre + signs * size / 2
    # Of two convex polygons apart, one nearest point is a corner, of the one or of the other.
    from_hull = np.maximum(np.abs(hull - centre) - size / 2, 0.0)
    from_boxes = np.maximum(np.abs((corners - pose[:2]) @ turn.T) - half, 0.0)
    nearest = min(np.linalg.norm(gaps, axis=-1).min() for gaps in (from_hull, from_boxes))
    return 0.0 if _overlap(hull, corners, turn) else float(nearest)


def _overlap(hull: np.ndarray, corners: np.ndarray, turn: np.ndarray) -> bool:
    """Return whether no side of either rectangle separates the hull from some box."""
    apart = np.zeros(len(corners), bool)
    for axis in (*np.eye(2), *turn):
        ours, theirs = hull @ axis, corners @ axis
        apart |= (theirs.min(-1) > ours.max()) | (theirs.max(-1) < ours.min())
    return not apart.all()


def least_clearance(arena: ArenaSpec, truth: np.ndarray) -> float:
    """Return the least clearance of a P2AT along a path of poses (n, 3) [m]."""
    half, boxes = (P2AT.dimensions[0] / 2, P2AT.dimensions[1] / 2), obstacles(arena)
    smooth = np.column_stack([truth[:, :2], np.unwrap(truth[:, 2])])
    at = np.linspace(0, len(truth) - 1, POSES_PER_REPORT * (len(truth) - 1) + 1)
    poses = np.column_stack([np.interp(at, np.arange(len(truth)), column) for column in smooth.T])
    return min(clearance(pose, half, boxes) for pose in poses)


def report_of(arena: ArenaSpec, log: Mapping[str, Any]) -> RunReport:
    """Judge the log of a run.

    Raises:
        DemoError: The robot hardly reported.
    """
    if len(log["track"]) < 2:
        raise DemoError("the controller received fewer than two reports with poses")
    paths = tracked_poses(log)
    truth = paths["truth"]
    ends = {name: float(np.linalg.norm(path[-1, :2] - truth[-1, :2])) for name, path in paths.items()}
    distance = float(np.linalg.norm(np.diff(truth[:, :2], axis=0), axis=1).sum())
    simulated = log["track"][-1][0] - log["track"][0][0]
    return RunReport(
        distance=distance,
        odometry_error=ends["odometry"],
        ins_error=ends["ins"],
        clearance=least_clearance(arena, truth),
        simulated=simulated,
        realtime_factor=simulated / log["real_seconds"],
        messages=sum(log["messages"].values()),
        fast_enough=distance >= MIN_SPEED * simulated,
    )


@contextmanager
def running_server(errors: Path, console: Console) -> Iterator[int]:
    """Run a server of a batch as a subprocess for as long as the context lasts; yields its port.

    Args:
        errors: File for what it logs.
        console: Where to say that it is starting.

    Raises:
        DemoError: It does not start or does not stop as it should.
    """
    command = [sys.executable, "-m", "usarmjx", "serve", "--worlds", str(WORLDS), "--instance", "0"]
    command += ["--host", "127.0.0.1", "--port", "0", "--engine", "auto", "--realtime-factor", "0"]
    command += ["--no-wireless", "--no-images"]  # it needs neither, and the usual ports may be taken
    with writing(errors):
        log = errors.open("w", encoding="utf-8")
    with log:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True, cwd=ROOT)
    try:
        with console.status(f"starting a server of {WORLDS} worlds"):
            port = _port_of(process, errors)
        yield port
    except BaseException:
        process.kill()
        process.wait()
        raise
    process.send_signal(signal.SIGINT)
    try:
        process.communicate(timeout=STOP_LIMIT)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        raise DemoError(f"the server did not stop within {STOP_LIMIT:g} s") from None
    if process.returncode:
        raise DemoError(f"the server ended with status {process.returncode}; see {errors}")


def _port_of(process: subprocess.Popen[str], errors: Path) -> int:
    """Return the port that a starting server reports on its standard output."""
    assert process.stdout is not None
    watchdog = Timer(START_LIMIT, process.kill)
    watchdog.start()
    try:
        for line in process.stdout:
            if found := LISTENING.search(line):
                return int(found.group(1))
    finally:
        watchdog.cancel()
    raise DemoError(f"the server did not start within {START_LIMIT:g} s; see {errors}")


def run_controller(port: int, seconds: float, log: Path, console: Console) -> None:
    """Run the controller against a server and show how far it is.

    Args:
        port: The server's port on this machine.
        seconds: Simulated time to drive [s].
        log: File that the controller writes.
        console: Where the progress bar goes.

    Raises:
        DemoError: The controller failed or took too long.
    """
    command = [sys.executable, str(CONTROLLER), "--port", str(port)]
    command += ["--seconds", str(seconds), "--json", str(log.resolve())]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT)
    assert process.stdout is not None
    watchdog = Timer(START_LIMIT + 3 * seconds, process.kill)
    watchdog.start()
    columns = (
        TextColumn("driving"),
        BarColumn(),
        TextColumn("{task.completed:.0f} of {task.total:.0f} simulated s"),
    )
    try:
        with Progress(*columns, TimeElapsedColumn(), console=console) as progress:
            task = progress.add_task("drive", total=seconds)
            for line in process.stdout:
                if found := SIMULATED.match(line):
                    progress.update(task, completed=min(float(found.group(1)), seconds))
            _, complaint = process.communicate()
            if process.returncode == 0:
                progress.update(task, completed=seconds)
    finally:
        watchdog.cancel()
        process.kill()  # does nothing when it has ended
        process.wait()
    if process.returncode:
        reason = complaint.strip() or "it was stopped because it took too long"
        raise DemoError(f"the controller ended with status {process.returncode}: {reason}")


def table_of(account: RunReport, picture: Path) -> Table:
    """Return the account as a table for the terminal."""
    verdict = "touched!" if account.touched else "nothing touched"
    driven = "" if account.fast_enough else " (too little)"
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    for name, text in (
        ("distance driven", f"{account.distance:.2f} m in {account.simulated:.1f} s{driven}"),
        ("odometry's error at the end", f"{account.odometry_error:.2f} m"),
        ("INS's error at the end", f"{account.ins_error:.2f} m"),
        ("least clearance", f"{account.clearance:.2f} m to walls and obstacles: {verdict}"),
        ("real-time factor", f"{account.realtime_factor:.1f}, {WORLDS} worlds"),
        ("messages received", str(account.messages)),
        ("picture", str(picture)),
    ):
        table.add_row(name, text)
    return table


def run_demo(out: Path, seconds: float = 20.0) -> int:
    """Run the whole chain once and tell what came of it.

    Args:
        out: Folder for the picture, the controller's log and the server's; made when missing.
        seconds: Simulated time to drive [s].

    Returns:
        Exit status: 0, or 1 when the robot touched something or hardly moved.

    Raises:
        DemoError: The chain could not run; the message says why.
    """
    with writing(out):
        out.mkdir(parents=True, exist_ok=True)
    console = Console()
    record, picture = out / "wander.json", out / "wander.png"
    with running_server(out / "server.log", console) as port:
        run_controller(port, seconds, record, console)
    log = json.loads(record.read_text(encoding="utf-8"))
    arena = ARENAS.get(log["level"])
    account = report_of(arena, log)
    run_picture(arena, log, picture)
    console.print(table_of(account, picture))
    return int(account.touched or not account.fast_enough)


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
            pass  # REMOVED_IMPORT

            run_live(browser, port, viewer_port, rosbridge_port)
            return
        if any(one is not None for one in (port, viewer_port, rosbridge_port)):
            raise UsageError("ports are for the live demonstration, without --headless")
        announce("starting a server, and a robot to drive in it ...")
        pass  # REMOVED_IMPORT

        sys.exit(run_demo(out or FOLDER, seconds or SECONDS))
