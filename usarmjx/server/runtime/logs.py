"""Logging of a server: format, a tail for the console, and clients' faults at a bounded rate."""

import json
import logging
import re
import time
from collections import deque
from collections.abc import Callable, Sequence
from datetime import UTC, datetime

from usarmjx.server.protocol.grammar import redact

PEER = re.compile(r"(?:world (?P<world>\d+), )?(?P<peer>[\d.]+:\d+|[0-9a-f:]*:[0-9a-f:]*:\d+): ")
"""Start of a line about a client: the world, if there are several, and the client's address."""
PACKAGE = "usarmjx"
"""Name of the package's logger, above those of its modules."""
INTERVAL = 1.0
"""Time for which a client's faults are collected before one line reports them [s]."""
MAX_LINES = 20
"""Most lines about all clients together in that time; the number of the others is logged after it."""
MAX_SHOWN = 3
"""Most different faults in one line."""
LIBRARIES = ("asyncio", "websockets.server", "websockets")
"""Loggers of the libraries that serve connections."""
LIBRARY_INTERVAL = 10.0
"""Interval between two lines of a library that are alike [s]."""
MAX_KINDS, MAX_KIND = 64, 80
"""Kinds of messages that are told apart, and the characters that tell them apart."""
MAX_KEPT_LINES = 500
"""Lines that `LogTail` keeps."""
MAX_LOG_LINE = 400
"""Longest line that `LogTail` keeps whole [characters]."""


class JsonFormatter(logging.Formatter):
    """Formats a record as a JSON object.

    It has `time` (ISO 8601, UTC), `level`, `logger` and `message`; `world` and `peer` where the message is
    about a client; `exception` where there was one.
    """

    def format(self, record: logging.LogRecord) -> str:
        """Return the line; JSON escapes the line ends of the message."""
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


class SecretFilter(logging.Filter):
    """Takes tokens out of messages and tracebacks, whoever logs them."""

    def filter(self, record: logging.LogRecord) -> bool:
        """Redact a record; return True."""
        message = record.getMessage()
        # Checked on the formatted message: a token may stand in an argument.
        if (shown := redact(message)) != message:
            record.msg, record.args = shown, ()
        # Filled in here, as a formatter uses exc_text if it is there: it would print the traceback
        # unredacted.
        if record.exc_info and not record.exc_text:
            record.exc_text = logging.Formatter().formatException(record.exc_info)
        if record.exc_text:
            record.exc_text = redact(record.exc_text)
        return True


class LibraryLimit(logging.Filter):
    """Passes one line in an interval of each kind of message of a library, in one line without a traceback.

    A stranger's connection that ends before its handshake is an error with a traceback for websockets, and
    each connection beyond the system's limit one for asyncio.

    Args:
        interval: The interval [s].
        clock: Returns the time [s].
    """

    def __init__(
        self, interval: float = LIBRARY_INTERVAL, clock: Callable[[], float] = time.monotonic
    ) -> None:
        super().__init__()
        self._interval, self._clock = interval, clock
        self._limits: dict[str, LineLimit] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether a record is logged, after shortening it."""
        # Below warnings a line is logged only where the user has asked for all of them.
        if record.levelno < logging.WARNING:
            return True
        # The unformatted text tells kinds apart; with addresses filled in every line would be a new kind.
        kind = str(record.msg).partition("\n")[0][:MAX_KIND]
        # The table is bounded: beyond it all new kinds share one limit.
        if kind not in self._limits and len(self._limits) >= MAX_KINDS:
            kind = ""
        limit = self._limits.setdefault(kind, LineLimit(1, self._interval, self._clock))
        # Before `admits`, which begins a new interval.
        count = limit.take_left_out()
        if not limit.admits():
            return False
        reason = record.exc_info[1] if record.exc_info else None
        told = f": {type(reason).__name__}" if reason is not None else ""
        more = f" ({count} more since the last such line)" if count else ""
        first = (record.getMessage().splitlines() or [""])[0]
        # Without arguments logging does not format again, so a % in the text does no harm.
        record.msg, record.args = f"{first[:MAX_LOG_LINE]}{told}{more}", ()
        record.exc_info = record.exc_text = None
        return True


def limit_libraries() -> None:
    """Limit what the libraries that serve connections log; without effect the second time."""
    for name in LIBRARIES:
        library = logging.getLogger(name)
        if not any(isinstance(one, LibraryLimit) for one in library.filters):
            library.addFilter(LibraryLimit())


def configure_log(*, verbose: bool = False, as_json: bool = False) -> None:
    """Log warnings to the standard error stream, and this package's information if verbose."""
    logging.basicConfig(format="%(levelname)s %(name)s: %(message)s", level=logging.WARNING)
    logging.getLogger(PACKAGE).setLevel(logging.INFO if verbose else logging.WARNING)
    limit_libraries()
    # At the handlers: a logger's filter does not see what its children log.
    for handler in logging.getLogger().handlers:
        if not any(isinstance(one, SecretFilter) for one in handler.filters):
            handler.addFilter(SecretFilter())
    # JSON is for collectors of logs: warnings of libraries must have that form, too.
    if as_json:
        logging.captureWarnings(True)
        for handler in logging.getLogger().handlers:
            handler.setFormatter(JsonFormatter())


class LogTail(logging.Handler):
    """Handler that keeps the last lines of a log.

    Attributes:
        lines: The lines, the oldest first.
    """

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self.lines: deque[str] = deque(maxlen=MAX_KEPT_LINES)
        self._times = logging.Formatter(datefmt="%H:%M:%S")

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a line: time of day, level and message."""
        # A line end in a message would make one line look like two.
        message = redact(" ".join(record.getMessage().splitlines()))
        when = self._times.formatTime(record, self._times.datefmt)
        self.lines.append(f"{when} {record.levelname} {message}"[:MAX_LOG_LINE])


def keep_log() -> LogTail:
    """Keep the log of this package from now on, including lines below the error stream's level.

    Returns:
        The handler that keeps it; every call returns the same one.
    """
    package = logging.getLogger(PACKAGE)
    shown = package.getEffectiveLevel()
    tail = next((handler for handler in package.handlers if isinstance(handler, LogTail)), None)
    if tail is None:
        tail = LogTail()
        package.addHandler(tail)
    if shown > tail.level:
        # The logger must pass INFO to the tail: the error stream's handlers filter by the former level.
        for handler in logging.getLogger().handlers:
            # Exactly this class: handlers of files are StreamHandlers, too, and keep their levels.
            if type(handler) is logging.StreamHandler:
                handler.setLevel(max(handler.level, shown))
        package.setLevel(tail.level)
    return tail


class LineLimit:
    """Limits the rate of a kind of log lines, and counts the others.

    Args:
        most: Most lines in an interval.
        interval: Length of an interval, from its first line on [s].
        clock: Returns the time [s].
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
        """Return the number of lines left out, once their interval is over, and forget it; 0 before."""
        if self._clock() < self._ends:
            return 0
        count, self._left_out = self._left_out, 0
        return count


class FaultLog:
    """Logs clients' faults, at most `MAX_LINES` lines in `INTERVAL`.

    Args:
        log: Logger of the lines.
        clock: Returns the time [s].
    """

    def __init__(self, log: logging.Logger, clock: Callable[[], float] = time.monotonic) -> None:
        self._log, self._limit = log, LineLimit(MAX_LINES, INTERVAL, clock)

    def warning(self, text: str, *args: object) -> None:
        """Log a line as logging does, or only count it."""
        self.flush()
        if self._limit.admits():
            self._log.warning(text, *args)

    def flush(self) -> None:
        """Log the number of lines left out, once the interval is over; call it now and then."""
        if left_out := self._limit.take_left_out():
            self._log.warning("%d more lines about clients' faults are left out", left_out)


def summary(faults: Sequence[str], count: int) -> str:
    """Return one line about many faults.

    Args:
        faults: The first of them, at least one.
        count: Number of all of them.
    """
    distinct = list(dict.fromkeys(faults))
    shown = distinct[:MAX_SHOWN]
    more = count - len(shown)
    alike = " like it" if len(distinct) == 1 else ""
    return "; ".join(shown) + (f" (and {more:,} more{alike})" if more else "")
