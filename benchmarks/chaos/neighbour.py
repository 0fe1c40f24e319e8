"""A robot that drives slowly and reads its reports, beside others who behave badly."""

import math
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from itertools import pairwise
from threading import Event, Thread

from benchmarks.serving.clients import REPORT_PERIOD, Crowd, RobotClient
from usarmjx.base.errors import UsageError, UsarmjxError
from usarmjx.server.protocol.grammar import format_message, parse_message

CLASS = "P2AT"
SLOWLY = ("DRIVE {Left 0.3} {Right -0.3}", "DRIVE {Left -0.3} {Right 0.3}")
"""It turns on the spot, this way and that."""
EVERY = 5
"""It changes its mind after so many reports."""
ROUNDING = 0.011
"""Times of reports have two decimals [s]."""
LOOK = 0.05
"""How often it looks whether it shall stop [s]."""
END = b"\r\n"


@dataclass(frozen=True)
class Report:
    """A report of the neighbour.

    Attributes:
        came: When, by the performance counter [s].
        time: Its own time [simulated s].
        processor: Processor time of the server's thread by then [s]; NaN if nobody knows.
    """

    came: float
    time: float
    processor: float


@dataclass(frozen=True)
class Gaps:
    """Observations of a neighbour between two moments.

    Attributes:
        reports: Number of reports that came.
        gap: The longest time between two of them [s].
        processor: The most that the server's thread used between two of them [s]; NaN if nobody knows.
        irregular: Number that came at a wrong time of the world.
        bad_lines: Number of lines that break the protocol.
    """

    reports: int
    gap: float
    processor: float
    irregular: int
    bad_lines: int


class Neighbour(RobotClient):
    """A client whose robot drives slowly and that looks at each line.

    Args:
        port: The port.
        host: Whose.
        clock: Tells the processor time of the server's thread [s].
    """

    def __init__(self, port: int, host: str, clock: Callable[[], float] | None = None) -> None:
        super().__init__(port, host)
        self.history: list[Report] = []
        self.bad_lines = 0
        self._clock, self._half = clock, b""
        self.say(f"INIT {{ClassName USARBot.{CLASS}}} {{Name Neighbour}}")

    def take(self, data: bytes, now: float) -> None:
        """Note lines that came at a time [s], and drive."""
        *lines, self._half = (self._half + data).split(END)
        self.bad_lines += sum(not _is_good(line.decode("latin-1")) for line in lines)
        before = len(self.reports)
        super().take(data, now)
        if len(self.reports) > before:
            used = math.nan if self._clock is None else self._clock()
            self.history += [Report(came, own, used) for came, own in self.reports[before:]]
            if len(self.reports) % EVERY == 0:
                self.say(SLOWLY[len(self.reports) // EVERY % len(SLOWLY)])

    def gaps(self, began: Report, ended: Report, bad_lines: int) -> Gaps:
        """Return what was noticed from one report to another.

        Args:
            began: The first.
            ended: The last.
            bad_lines: Number of bad lines before.
        """
        shown = [report for report in list(self.history) if began.came <= report.came <= ended.came]
        pairs = list(pairwise(shown))
        used = [after.processor - before.processor for before, after in pairs]
        return Gaps(
            reports=len(pairs),
            gap=max((after.came - before.came for before, after in pairs), default=math.nan),
            processor=max(used, default=math.nan),
            irregular=sum(
                abs(after.time - before.time - REPORT_PERIOD) > ROUNDING for before, after in pairs
            ),
            bad_lines=self.bad_lines - bad_lines,
        )


def _is_good(line: str) -> bool:
    """Return whether a line is one that the protocol has, without a number that is none."""
    try:
        return format_message(parse_message(line)) == line and " nan" not in line and " inf" not in line
    except UsarmjxError:
        return False


class Watch(AbstractContextManager["Watch"]):
    """A neighbour that lives in a thread.

    Args:
        port: The port.
        host: Whose.
        clock: Tells the processor time of the server's thread [s].
        limit: A report that takes longer than this does not come any more [s].
    """

    def __init__(self, port: int, host: str, clock: Callable[[], float] | None, limit: float) -> None:
        self._address, self._clock, self._limit = (port, host), clock, limit
        self._stop = Event()
        self._error: Exception | None = None

    def __enter__(self) -> "Watch":
        """Join, and wait for the first reports.

        Raises:
            UsageError: None comes.
        """
        self._crowd = Crowd(self._address[0])
        self._neighbour = self._crowd.add(Neighbour(*self._address, self._clock))
        self._thread = Thread(target=self._read, name="neighbour", daemon=True)
        self._thread.start()
        try:
            self.next_report()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """Leave."""
        self._stop.set()
        self._thread.join()
        self._crowd.__exit__()

    def next_report(self) -> Report:
        """Wait for the next report from now on.

        Raises:
            UsageError: It does not come within the limit, or the server has hung up.
        """
        now, seen = time.perf_counter(), self._neighbour.history
        while time.perf_counter() < now + self._limit and self._error is None:
            if seen and seen[-1].came > now:
                return seen[-1]
            time.sleep(LOOK)
        if self._error is not None:
            raise UsageError(f"the neighbour: {self._error}")
        raise UsageError(f"the neighbour: no report within {self._limit:g} s")

    def during(self, action: Callable[[], None]) -> Gaps:
        """Return what the neighbour noticed while something was done.

        Raises:
            UsageError: A report does not come within the limit, or the server has hung up.
        """
        began, bad_lines = self.next_report(), self._neighbour.bad_lines
        action()
        return self._neighbour.gaps(began, self.next_report(), bad_lines)

    def _read(self) -> None:
        try:
            while not self._stop.is_set():
                self._crowd.pump(LOOK)
        except (OSError, UsageError) as error:
            self._error = error
