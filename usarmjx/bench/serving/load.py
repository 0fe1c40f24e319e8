"""What robots cost a server that stand or drive, how evenly they report, and how soon a command shows."""

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from usarmjx.bench.serving.clients import Crowd, RobotClient
from usarmjx.bench.serving.figures import Missing, attempt
from usarmjx.bench.serving.robots import (
    MIX,
    REPORT_PERIOD,
    TURNING,
    Bounds,
    RunningServer,
    ask,
    join,
    start_tags,
    wait_for_reports,
)
from usarmjx.server.protocol.grammar import Message

STOPPING = "DRIVE {Left 0.0} {Right 0.0}"
PAN = 0.03
"""A camera is panned to this and back, which half a second is enough for [rad]."""
SMALL_MOTION = 0.002
"""What has moved by this moves [rad, m]; at rest MISSTA and Odometry stay within a tenth of it."""
GOLDEN = 0.618
"""Share of a report period by which a try is later than the one before: they fall evenly between reports."""


def measure_load(server: RunningServer, robots: int, bounds: Bounds) -> dict[str, Any]:
    """Measure the processor time of standing and driving robots, and how soon a command shows."""
    with Crowd(server.port) as crowd:
        tags = start_tags(crowd, robots, bounds.limit)
        clients = [join(crowd, MIX[i % len(MIX)], tag) for i, tag in enumerate(tags)]
        joined = wait_for_reports(crowd, clients, bounds.limit)
        if isinstance(joined, Missing):
            return dict.fromkeys(("all_report_s", "standing", "driving", "command"), joined)
        windows = partial(_windows, server, crowd, clients, bounds)
        figures: dict[str, Any] = {"all_report_s": joined, "standing": attempt(windows)}
        figures["command"] = attempt(lambda: _commands(crowd, clients[0], bounds))
        for client in clients:
            client.say(TURNING)
        return figures | {"driving": attempt(windows)}


def _windows(
    server: RunningServer, crowd: Crowd, clients: Sequence[RobotClient], bounds: Bounds
) -> dict[str, list[float]]:
    """Return processor time and pace of several windows, and how unevenly reports came.

    Raises:
        UsageError: A report does not come, or the system does not tell the processor time.
    """
    crowd.pump(bounds.settling)
    figures: dict[str, list[float]] = {}
    for _ in range(bounds.windows):
        began, start = crowd.report_after(clients[0], time.perf_counter(), bounds.limit)
        used = server.cpu_seconds()
        crowd.pump(bounds.seconds)
        ended, end = crowd.report_after(clients[0], time.perf_counter(), bounds.limit)
        used = server.cpu_seconds() - used
        jitter = np.concatenate([jitter_of(client.reports, began, ended) for client in clients])
        found = {
            "cpu_per_simulated_s": used / (end - start),
            "realtime_factor": (end - start) / (ended - began),
            "jitter_p95_s": float(np.quantile(jitter, 0.95)),
            "jitter_most_s": float(jitter.max()),
        }
        for name, value in found.items():
            figures.setdefault(name, []).append(value)
    return figures


def jitter_of(reports: Sequence[tuple[float, float]], began: float, ended: float) -> np.ndarray:
    """Return by how much the time between two reports differs from their own times' difference [s] (gaps,).

    That is by how much the way from the tick into the client's hands took longer or shorter.

    Args:
        reports: When each came, and its own time [s, simulated s].
        began: Reports before this moment do not count [s].
        ended: Nor do those after this one [s].
    """
    came = np.array([report for report in reports if began <= report[0] <= ended]).reshape(-1, 2)
    return np.abs(np.diff(came[:, 0]) - np.diff(came[:, 1]))


def _commands(crowd: Crowd, client: RobotClient, bounds: Bounds) -> dict[str, list[float | Missing]]:
    """Return how long a P2AT's commands take to show, and a question to be answered."""
    figures: dict[str, list[float | Missing]] = {"joint_shows_s": [], "motion_shows_s": [], "answer_s": []}
    shows = partial(_shows, crowd, client, bounds.limit)
    for i in range(2 * bounds.windows):
        pause = REPORT_PERIOD * (GOLDEN * i % 1)
        order = f"DRIVE {{Name CameraPanTilt_Link1}} {{Order 0}} {{Value {-PAN if i % 2 else PAN}}}"
        figures["joint_shows_s"].append(shows(order, _pan, pause))
        figures["motion_shows_s"].append(shows(TURNING, _odometry, pause))
        client.say(STOPPING)
        crowd.pump(bounds.settling)
        question, wanted = "GETCONF {Type Odometry}", lambda message: message.kind == "CONF"
        figures["answer_s"].append(ask(crowd, client, question, wanted, bounds.limit))
    return figures


def _shows(
    crowd: Crowd,
    client: RobotClient,
    limit: float,
    order: str,
    value: Callable[[Message], np.ndarray | None],
    pause: float,
) -> float | Missing:
    """Return how long it takes until a value is another one than before a command [s]."""
    client.expect(lambda message: value(message) is not None)
    crowd.wait(lambda: client.answer is not None, limit)
    if client.answer is None or (before := value(client.answer[0])) is None:
        return Missing(f"nothing to compare with within {limit:g} s")
    crowd.pump(pause)

    def moves(message: Message) -> bool:
        now = value(message)
        return now is not None and bool(np.abs(now - before).max() > SMALL_MOTION)

    return ask(crowd, client, order, moves, limit)


def _pan(message: Message) -> np.ndarray | None:
    """Return the camera's pan, if a message tells it [rad] (1,)."""
    return np.array([float(message.get("Value"))]) if message.kind == "MISSTA" else None


def _odometry(message: Message) -> np.ndarray | None:
    """Return x, y and yaw of the odometry, if a message tells them [m, m, rad] (3,)."""
    if message.kind != "SEN" or message.get("Type") != "Odometry":
        return None
    return np.array([float(number) for number in message.get("Pose").split(",")])
