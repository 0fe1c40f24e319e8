"""What clients do wrong, in the log: by rate and in sums, so that nobody fills a disk with lines."""

import json
import logging
import re
import time
from collections.abc import Callable, Sequence
from datetime import UTC, datetime

PEER = re.compile(r"(?:world (?P<world>\d+), )?(?P<peer>[\d.]+:\d+|[0-9a-f:]*:[0-9a-f:]*:\d+): ")
"""How a line about a client begins: the world, if there are several, and the client's address."""


class JsonFormatter(logging.Formatter):
    """Formats a record as a JSON object.

    It has `time` (ISO 8601, UTC), `level`, `logger` and `message`; `world` and `peer` where the message is
    about a client; `exception` where there was one.
    """

    def format(self, record: logging.LogRecord) -> str:
        """Return the line; it has no line end inside, whatever the message holds."""
        message = record.getMessage()
        line: dict[str, object] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
        }
        if about := PEER.match(message):
            message = message[about.end() :]
            if about["world"] is not None:
                line["world"] = int(about["world"])
            line["peer"] = about["peer"]
        line["message"] = message
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        return json.dumps(line)


def configure_log(*, verbose: bool = False, as_json: bool = False) -> None:
    """Log to the standard error stream: warnings, and of this package what happens if it is to be verbose."""
    logging.basicConfig(format="%(levelname)s %(name)s: %(message)s", level=logging.WARNING)
    logging.getLogger("usarmjx").setLevel(logging.INFO if verbose else logging.WARNING)
    if as_json:
        logging.captureWarnings(True)
        for handler in logging.getLogger().handlers:
            handler.setFormatter(JsonFormatter())


INTERVAL = 1.0
"""A client's faults are collected for so long, and then logged as one line [s]."""
MAX_LINES = 20
"""Most lines about all clients together in that time; how many more there were is logged then."""
MAX_SHOWN = 3
"""Most different faults that a line tells."""


class LineLimit:
    """Lets so many lines of a kind into the log in a time, and counts the others.

    Args:
        most: So many.
        interval: In this time from the first of them [s].
        clock: The time [s].
    """

    def __init__(self, most: int, interval: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._most, self._interval, self._clock = most, interval, clock
        self._ends, self._lines, self._left_out = 0.0, 0, 0

    def admits(self) -> bool:
        """Return whether another line may be logged; if not it is counted."""
        now = self._clock()
        if now >= self._ends:
            self._ends, self._lines = now + self._interval, 0
        self._lines += 1
        self._left_out += self._lines > self._most
        return self._lines <= self._most

    def take_left_out(self) -> int:
        """Return how many lines were counted only, once their time is over, and forget them; 0 before."""
        if self._clock() < self._ends:
            return 0
        count, self._left_out = self._left_out, 0
        return count


class FaultLog:
    """Logs what clients do wrong, and only so many lines of it in a second.

    Args:
        log: Where to.
        clock: The time [s].
    """

    def __init__(self, log: logging.Logger, clock: Callable[[], float] = time.monotonic) -> None:
        self._log, self._limit = log, LineLimit(MAX_LINES, INTERVAL, clock)

    def warning(self, text: str, *args: object) -> None:
        """Log a line as `logging` does, or only count it."""
        self.flush()
        if self._limit.admits():
            self._log.warning(text, *args)

    def flush(self) -> None:
        """Say how many lines were left out, once the second is over; to be called now and then."""
        if left_out := self._limit.take_left_out():
            self._log.warning("%d more lines about clients' faults are left out", left_out)


def summary(faults: Sequence[str], count: int) -> str:
    """Return one line about many faults.

    Args:
        faults: The first of them, at least one.
        count: How many there were in all.
    """
    distinct = list(dict.fromkeys(faults))
    shown = distinct[:MAX_SHOWN]
    more = count - len(shown)
    alike = " like it" if len(distinct) == 1 else ""
    return "; ".join(shown) + (f" (and {more:,} more{alike})" if more else "")
