"""Robots that join a server, and one that watches meanwhile: INIT to the first STA of each class.

Figures go by their names, which end with the unit: s is seconds.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.bench.serving.clients import Crowd, RobotClient
from usarmjx.bench.serving.figures import Figure, Missing
from usarmjx.server.protocol.grammar import Message

REPORT_PERIOD = 0.2
"""A robot's report is due so often (KRobot.uc: msgTimer) [s]."""
MIX = ("P2AT", "P2DX")
"""Classes of many robots, in turn."""
TURNING = "DRIVE {Left 2.0} {Right -2.0}"
"""Turns a robot of the mix on the spot, so that none meets another."""


class RunningServer(Protocol):
    """A server that can be measured."""

    port: int
    image_port: int

    def cpu_seconds(self) -> float:
        """Return the processor time that it has used so far [s]."""
        ...


@dataclass(frozen=True)
class Bounds:
    """How long to measure and to wait.

    Attributes:
        seconds: Length of one measurement of what goes on and on [s].
        windows: How many of them.
        limit: What takes longer than this is given up [s].
        settling: Time for what has begun or ended to take effect [s].
    """

    seconds: float
    windows: int
    limit: float
    settling: float = 1.0


class Watcher:
    """A robot that stands and reads its reports while others are busy.

    Args:
        crowd: Whose loop reads them.
        client: The robot's client, which has had a report.
        limit: A report that takes longer than this does not come any more [s].
    """

    def __init__(self, crowd: Crowd, client: RobotClient, limit: float) -> None:
        self._crowd, self._client, self._limit = crowd, client, limit

    def during(self, action: Callable[[], dict[str, Figure]]) -> dict[str, Figure]:
        """Return an action's figures, and by how much the watcher's longest gap meanwhile was too long."""
        began, _ = self._crowd.report_after(self._client, time.perf_counter(), self._limit)
        figures = action()
        try:
            ended, _ = self._crowd.report_after(self._client, time.perf_counter(), self._limit)
        except UsageError as error:
            return figures | {"beyond_due_s": Missing(f"the watcher: {error}")}
        came = [arrival for arrival, _ in self._client.reports if began <= arrival <= ended]
        return figures | {"beyond_due_s": float(np.diff(came).max() - REPORT_PERIOD)}


def start_tags(crowd: Crowd, robots: int, limit: float) -> list[str]:
    """Return start poses for so many robots, evenly spread over the arena's list.

    Raises:
        UsageError: There are not so many, or they do not come within the limit [s].
    """
    asking = crowd.robot()
    asking.expect(lambda message: bool(message.get("StartPoses")))
    asking.say("GETSTARTPOSES")
    crowd.wait(lambda: asking.answer is not None, limit)
    crowd.leave(asking)
    if asking.answer is None:
        raise UsageError(f"no start poses within {limit:g} s")
    words = " ".join(f"{key} {value}" for key, value in asking.answer[0].segments[1:]).split()
    tags = words[::3]
    if robots > len(tags):
        raise UsageError(f"the arena has {len(tags)} start poses, not {robots}")
    return [tags[i * len(tags) // robots] for i in range(robots)]


def join(crowd: Crowd, kind: str, tag: str) -> RobotClient:
    """Return a new client that has asked for a robot of a class at a start pose."""
    client = crowd.robot()
    client.say(f"INIT {{ClassName USARBot.{kind}}} {{Name At{tag}}} {{Start {tag}}}")
    return client


def wait_for_reports(crowd: Crowd, clients: Sequence[RobotClient], limit: float) -> float | Missing:
    """Return the time from the first client's connection to the last one's first report [s]."""
    if crowd.wait(lambda: all(client.reports for client in clients), limit):
        return max(client.reports[0][0] for client in clients) - min(client.began for client in clients)
    there = sum(bool(client.reports) for client in clients)
    return Missing(f"{there} of {len(clients)} robots reported within {limit:g} s")


def ask(
    crowd: Crowd, client: RobotClient, line: str, wanted: Callable[[Message], bool], limit: float
) -> float | Missing:
    """Return how long it takes from a command to the first message that is wanted [s]."""
    client.expect(wanted)
    began = time.perf_counter()
    client.say(line)
    crowd.wait(lambda: client.answer is not None, limit)
    return client.answer[1] - began if client.answer else Missing(f"no answer within {limit:g} s")


def measure_inits(server: RunningServer, kinds: Sequence[str], bounds: Bounds) -> dict[str, Any]:
    """Measure INIT to the first STA of robots of several classes, one after another.

    The first of them watches the others come.
    """
    figures: dict[str, Any] = {}
    with Crowd(server.port) as crowd:
        watcher: Watcher | None = None
        for kind, tag in zip(kinds, start_tags(crowd, len(kinds), bounds.limit), strict=True):

            def act(kind: str = kind, tag: str = tag) -> dict[str, Figure]:
                return {"first_sta_s": wait_for_reports(crowd, [join(crowd, kind, tag)], bounds.limit)}

            if watcher is not None:
                figures[kind] = watcher.during(act)
                continue
            first = join(crowd, kind, tag)
            figures[kind] = {"first_sta_s": wait_for_reports(crowd, [first], bounds.limit)}
            if first.reports:
                watcher = Watcher(crowd, first, bounds.limit)
    return figures
