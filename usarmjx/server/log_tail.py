"""The last lines of the server's log, for `showlog` (manual 5.1)."""

import logging
from collections import deque

PACKAGE = "usarmjx"
"""Name of the logger above all of ours."""
MAX_LINES = 500
"""So many lines are kept."""
MAX_LINE = 400
"""Of a longer one the beginning is kept [characters]."""


class LogTail(logging.Handler):
    """Keeps the last lines of a log.

    Attributes:
        lines: The lines, the oldest first.
    """

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self.lines: deque[str] = deque(maxlen=MAX_LINES)
        self._times = logging.Formatter(datefmt="%H:%M:%S")

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a line: time of day, level and message."""
        message = " ".join(record.getMessage().splitlines())
        when = self._times.formatTime(record, self._times.datefmt)
        self.lines.append(f"{when} {record.levelname} {message}"[:MAX_LINE])


def keep_log() -> LogTail:
    """Keep the log of this package from now on, also what the error stream is not to show.

    Returns:
        What keeps it; the same one whenever this is called again.
    """
    package = logging.getLogger(PACKAGE)
    shown = package.getEffectiveLevel()
    tail = next((handler for handler in package.handlers if isinstance(handler, LogTail)), None)
    if tail is None:
        tail = LogTail()
        package.addHandler(tail)
    if shown > tail.level:
        for handler in logging.getLogger().handlers:
            if type(handler) is logging.StreamHandler:
                handler.setLevel(max(handler.level, shown))
        package.setLevel(tail.level)
    return tail
