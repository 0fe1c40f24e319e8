"""The main job on real input: serve a batch, let a client drive a P2AT, draw its path."""

import os
import re
import signal
import subprocess
import sys
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Timer
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from usarmjx.base.errors import UsarmjxError
from usarmjx.base.files import writing
from usarmjx.base.settings.json_file import read_json
from usarmjx.models.arenas import ARENAS
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.plots.picture import run_picture, tracked_poses
from usarmjx.server.runtime.signals import ParentPipe

ROOT = Path(__file__).resolve().parents[2]
CONTROLLER = ROOT / "usarmjx" / "client" / "wander.py"
WORLDS = 4
START_LIMIT = 120.0
"""Time for the server to start [s]: the first time it compiles."""
STOP_LIMIT = 15.0
"""Time for it to stop [s]."""
MIN_SPEED = 0.15
"""Average speed that a run must reach [m/s]: 3 m in 20 s."""
OBSTACLE_MIN_HEIGHT = 0.1
"""Height up to which shapes are driven over, as ramps are [m]; a P2AT's wheel has 0.13."""
TOUCH_CLEARANCE = 0.01
"""Clearance below which the hull counts as touching: the last place of GroundTruth's numbers [m]."""
POSES_PER_REPORT = 4
"""Poses looked at per report: 0.2 s at 0.45 m/s would leave 9 cm unseen."""
LISTENING = re.compile(r"listening on [\d.]+:(\d+)")
SIMULATED = re.compile(r"\s*([\d.]+) s")


class DemoError(UsarmjxError):
    """Reason why the demonstration cannot run here."""


@dataclass(frozen=True)
class RunReport:
    """Result of a run.

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
    # Two rectangles are apart if and only if the direction of a side of one of them separates them.
    apart = np.zeros(len(corners), bool)
    for axis in (*np.eye(2), *turn):
        ours, theirs = hull @ axis, corners @ axis
        apart |= (theirs.min(-1) > ours.max()) | (theirs.max(-1) < ours.min())
    return not apart.all()


def least_clearance(arena: ArenaSpec, truth: np.ndarray) -> float:
    """Return the least clearance of a P2AT along a path of poses (n, 3) [m]."""
    half, boxes = (P2AT.dimensions[0] / 2, P2AT.dimensions[1] / 2), obstacles(arena)
    # Unwrapped, so that interpolation between two headings does not turn the long way round.
    smooth = np.column_stack([truth[:, :2], np.unwrap(truth[:, 2])])
    at = np.asarray(np.linspace(0, len(truth) - 1, POSES_PER_REPORT * (len(truth) - 1) + 1), float)
    poses = np.stack([np.interp(at, np.arange(len(truth)), smooth[:, axis]) for axis in range(3)], -1)
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
def running_server(errors: Path, console: Console) -> Generator[int]:
    """Run a server of a batch as a subprocess for as long as the context lasts; yields its port.

    Args:
        errors: File for what it logs.
        console: Console for the line about the start.

    Raises:
        DemoError: It does not start or does not stop as it should.
    """
    command = [sys.executable, "-m", "usarmjx", "serve", "--worlds", str(WORLDS), "--instance", "0"]
    # Port 0 is any free one, and factor 0 means no waiting: neither a second server nor the clock disturbs.
    command += ["--host", "127.0.0.1", "--port", "0", "--engine", "auto", "--realtime-factor", "0"]
    command += ["--no-wireless", "--no-images"]  # it needs neither, and the usual ports may be taken
    with writing(errors):
        log = errors.open("w", encoding="utf-8")
    with log, ParentPipe() as pipe:
        process = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
            # From the root of a checkout the module is found without an installation.
            cwd=ROOT,
            env={**os.environ, **pipe.settings},
            pass_fds=pipe.inherited,
        )
        # The server has its end now; kept open here, the server would outlive this process.
        pipe.started()
        try:
            with console.status(f"starting a server of {WORLDS} worlds"):
                port = _port_of(process, errors)
            yield port
        except BaseException:
            # Ctrl-C included: the server must not outlive this process.
            process.kill()
            process.wait()
            raise
        # As Ctrl-C does: the demonstration also shows that a server ends in order.
        process.send_signal(signal.SIGINT)
        try:
            # Read while waiting: a full pipe would keep the server from ending.
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
    # Reading a line has no timeout; killing the process ends the loop below.
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
        console: Console of the progress bar.

    Raises:
        DemoError: The controller failed or took too long.
    """
    command = [sys.executable, str(CONTROLLER), "--port", str(port)]
    command += ["--seconds", str(seconds), "--json", str(log.resolve())]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT)
    assert process.stdout is not None
    # Three times real time: slow machines simulate slower than that only when something is wrong.
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
                    # The last report may come after the end: the bar stops there.
                    progress.update(task, completed=min(float(found.group(1)), seconds))
            # The standard output is read to its end above: this collects the errors and the status.
            _, complaint = process.communicate()
            if process.returncode == 0:
                progress.update(task, completed=seconds)
    finally:
        watchdog.cancel()
        process.kill()  # does nothing when it has ended
        process.wait()
    if process.returncode:
        # A process that the watchdog has killed gives no reason.
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
        DemoError: The chain could not run; the message has the reason.
    """
    with writing(out):
        out.mkdir(parents=True, exist_ok=True)
    console = Console()
    record, picture = out / "wander.json", out / "wander.png"
    with running_server(out / "server.log", console) as port:
        run_controller(port, seconds, record, console)
    log = read_json(record)
    arena = ARENAS.get(log["level"])
    account = report_of(arena, log)
    run_picture(arena, log, picture)
    console.print(table_of(account, picture))
    return int(account.touched or not account.fast_enough)
