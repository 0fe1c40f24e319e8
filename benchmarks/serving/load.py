"""Cost of robots that stand or drive for a server, how evenly they report, and how soon a command shows."""

import math
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from benchmarks.serving.clients import (
    MIX,
    REPORT_PERIOD,
    TURNING,
    Bounds,
    Crowd,
    Figure,
    Missing,
    RobotClient,
    RunningServer,
    Watcher,
    ask,
    attempt,
    join,
    start_tags,
    wait_for_reports,
)
from usarmjx.base.errors import UsageError
from usarmjx.models.types.arena import START_ELEVATION, ArenaSpec, StartPose
from usarmjx.models.types.shapes import Shape
from usarmjx.server.protocol.grammar import Message

SPAM_LINES = 100
"""Commands that a client hands over at once when it sends as fast as it can."""
SET_POSE = "SET {Type INS} {Name INS} {Opcode POSE} {Params 0,0,0,0,0,0}"


class Bustle:
    """A P2AT that watches, and others who do something.

    Args:
        crowd: Whose loop reads all.
        joining: Number of others.
        bounds: Durations.

    Attributes:
        watcher: The watching one.

    Raises:
        UsageError: It has no report within the limit, or there are not enough start poses.
    """

    def __init__(self, crowd: Crowd, joining: int, bounds: Bounds) -> None:
        self._crowd, self._bounds = crowd, bounds
        first, *self._tags = start_tags(crowd, joining + 1, bounds.limit)
        client = join(crowd, MIX[0], first)
        if isinstance(found := wait_for_reports(crowd, [client], bounds.limit), Missing):
            raise UsageError(found.reason)
        self.watcher = Watcher(crowd, client, bounds.limit)
        self._others: list[RobotClient] = []

    def quiet(self) -> dict[str, Figure]:
        """Do nothing for a while."""
        self._crowd.pump(self._bounds.seconds)
        return {}

    def join_at_once(self) -> dict[str, Figure]:
        """Let all others join at the same moment."""
        self._others = [join(self._crowd, kind, tag) for kind, tag in self._who()]
        return {"all_report_s": wait_for_reports(self._crowd, self._others, self._bounds.limit)}

    def join_in_turn(self) -> dict[str, Figure]:
        """Let the others join, each when the one before has had its first report."""
        took: list[float] = []
        for kind, tag in self._who():
            self._others.append(join(self._crowd, kind, tag))
            found = wait_for_reports(self._crowd, self._others[-1:], self._bounds.limit)
            if isinstance(found, Missing):
                return {"first_sta_s": found}
            took.append(found)
        return {"first_sta_s": took}

    def leave_at_once(self) -> dict[str, Figure]:
        """Let all others leave at the same moment."""
        return self._leave(0.0)

    def leave_in_turn(self) -> dict[str, Figure]:
        """Let the others leave one after another."""
        return self._leave(REPORT_PERIOD)

    def set_pose(self) -> dict[str, Figure]:
        """Let one of the others tell its INS where it is: the first SET of all."""
        limit = self._bounds.limit
        answer = ask(self._crowd, self._others[0], SET_POSE, lambda message: message.kind == "RES", limit)
        return {"answer_s": answer}

    def spam(self) -> dict[str, Figure]:
        """Let one of the others send commands as fast as it can."""
        other, sent = self._others[0], 0
        began = time.perf_counter()
        while time.perf_counter() < began + self._bounds.seconds:
            if not other.unsent:
                other.say(*[TURNING] * SPAM_LINES)
                sent += SPAM_LINES
            self._crowd.pump(1e-3)
        return {"commands_per_s": sent / (time.perf_counter() - began)}

    def _who(self) -> list[tuple[str, str]]:
        return [(MIX[(i + 1) % len(MIX)], tag) for i, tag in enumerate(self._tags)]

    def _leave(self, pause: float) -> dict[str, Figure]:
        for client in self._others:
            self._crowd.leave(client)
            self._crowd.pump(pause)
        self._others = []
        self._crowd.pump(self._bounds.settling)
        return {}


def measure_gaps(server: RunningServer, joining: int, bounds: Bounds) -> dict[str, Any]:
    """Measure how late a watcher's reports are while others join, leave and talk."""
    with Crowd(server.port) as crowd:
        bustle = Bustle(crowd, joining, bounds)
        acts = {
            "quiet": bustle.quiet,
            "joining at once": bustle.join_at_once,
            "first SET POSE": bustle.set_pose,
            "spam": bustle.spam,
            "leaving at once": bustle.leave_at_once,
            "joining in turn": bustle.join_in_turn,
            "leaving in turn": bustle.leave_in_turn,
        }
        return {name: bustle.watcher.during(act) for name, act in acts.items()}


def measure_pictures(server: RunningServer, bounds: Bounds) -> dict[str, Any]:
    """Measure when the first picture comes, and the first that is not black; pictures must be raw."""
    with Crowd(server.port) as crowd:

        def look() -> dict[str, Figure]:
            began = time.perf_counter()
            client = crowd.pictures(server.image_port)
            crowd.wait(lambda: any(shows for _, shows in client.frames), bounds.limit)
            none = Missing(f"none within {bounds.limit:g} s")
            return {
                "first_frame_s": next((came - began for came, _ in client.frames), none),
                "first_view_s": next((came - began for came, shows in client.frames if shows), none),
            }

        return Bustle(crowd, 0, bounds).watcher.during(look)


CELL = 2.0
"""Side of a cell [m]; a robot starts in the middle."""
WALL = (0.5, 0.05, 0.3)
"""Half lengths of a wall between two cells [m]: robots see it, and each other beside it."""
OUTER = (0.1, 0.5)
"""Half the thickness and height of the walls around the hall [m]."""


def make_hall(robots: int) -> ArenaSpec:
    """Return a hall with start poses for at least so many robots."""
    side = math.ceil(math.sqrt(robots))
    half = side * CELL / 2
    middles = [(i + 0.5) * CELL - half for i in range(side)]
    between = [i * CELL - half for i in range(1, side)]
    walls = [_wall((x, y), WALL) for x in middles for y in between]
    thick, high = OUTER
    walls += [_wall((0.0, y), (half, thick, high)) for y in (-half, half)]
    walls += [_wall((x, 0.0), (thick, half, high)) for x in (-half, half)]
    starts = [
        StartPose(tag=f"Cell{row}x{column}", at=(x, y, START_ELEVATION))
        for row, x in enumerate(middles)
        for column, y in enumerate(middles)
    ]
    return ArenaSpec(
        name="DM-Hall",
        about=f"{side * side} cells with low walls in between.",
        shapes=tuple(walls),
        starts=tuple(starts),
        extent=((-half, half), (-half, half)),
    )


def _wall(at: tuple[float, float], size: tuple[float, float, float]) -> Shape:
    return Shape(kind="box", size=size, at=(*at, size[2]), surface="wall")


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
