"""Progress: a line that is written over itself on a terminal; rate-limited lines for files and pipes."""

import threading
import time
from collections.abc import Callable
from typing import TextIO

PERIOD = 30.0
"""Time between two lines [s]."""
CLEAR = "\r\033[K"
"""Moves the cursor to the begin of its line, and clears that."""


class RateLimitedLog:
    """Callable that passes on at most one line per period, the first one after one period.

    Args:
        tell: Takes a line.
        period: Time between two lines [s].
        clock: Returns the time [s].
    """

    def __init__(
        self,
        tell: Callable[[str], None],
        period: float = PERIOD,
        # Not the time of day: set back by an hour, it would hold lines back for an hour.
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._tell, self._period, self._clock = tell, period, clock
        self._next = clock() + period

    def __call__(self, text: str) -> None:
        """Pass on a line if one is due."""
        now = self._clock()
        if now >= self._next:
            # From now, not from the moment that was due: after a pause no burst of lines follows.
            self._next = now + self._period
            self._tell(text)


class StatusLine:
    """A line on a terminal; on other streams each text is a line of its own.

    Args:
        stream: Stream that it is written to.
    """

    _shown: "StatusLine | None" = None
    _lock = threading.RLock()

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self.terminal = stream.isatty()

    def show(self, text: str) -> None:
        """Write a text in place of the last one."""
        with self._lock:
            self._stream.write(f"{CLEAR}{text}" if self.terminal else f"{text}\n")
            self._stream.flush()
            if self.terminal:
                StatusLine._shown = self

    def clear(self) -> None:
        """Clear the line if it is shown."""
        with self._lock:
            # Another line may have been shown since: that one stays.
            if StatusLine._shown is self:
                StatusLine._shown = None
                self._stream.write(CLEAR)
                self._stream.flush()


def clear_status() -> None:
    """Clear the line that is shown, if any: other output follows."""
    shown = StatusLine._shown  # pyright: ignore[reportPrivateUsage]
    if shown is not None:
        shown.clear()


def is_status_shown() -> bool:
    """Return whether a line is shown on a terminal; takes no lock, so a signal's handler may ask."""
    return StatusLine._shown is not None  # pyright: ignore[reportPrivateUsage]
