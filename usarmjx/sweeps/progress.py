"""How far a sweep is, with an estimate of what is left: a line that changes, or one each 10 s for a file."""

import sys
import time
from typing import TextIO

INTERVAL = 10.0
"""So often a line is said where there is no terminal [s]."""
TERMINAL_INTERVAL = 0.2
CLEAR = "\r\033[K"


class SweepProgress:
    """Says how far a sweep is.

    Args:
        cells: How many are to be played.
        stream: Where it is said; None: nowhere.
    """

    def __init__(self, cells: int, stream: TextIO | None = None) -> None:
        self.cells, self._stream = cells, stream
        self._terminal = stream is not None and stream.isatty()
        self._begun = self._last = time.monotonic()
        self.done = self.failed = 0
        self._shown = False

    def within(self, batch: int, share: float) -> None:
        """Tell that a share of a batch of so many cells is played."""
        self._say(self.done + batch * min(share, 1.0))

    def add(self, done: int, failed: int) -> None:
        """Count cells that have a result, and cells that have failed."""
        self.done, self.failed = self.done + done + failed, self.failed + failed
        self._say(float(self.done))

    def _say(self, done: float) -> None:
        now = time.monotonic()
        if self._stream is None or now - self._last < (TERMINAL_INTERVAL if self._terminal else INTERVAL):
            return
        self._last = now
        line = self.line(done, now - self._begun)
        self._stream.write(f"{CLEAR}{line}" if self._terminal else f"{line}\n")
        self._stream.flush()
        self._shown = True

    def line(self, done: float, seconds: float) -> str:
        """Return what is said after so many cells and so long [s]."""
        failed = f", {self.failed} failed" if self.failed else ""
        left = f", about {_long((self.cells - done) * seconds / done)} left" if done > 0 else ""
        return f"usarmjx: {self.done} of {self.cells} cells{failed}, {_long(seconds)}{left}"

    def close(self) -> None:
        """Leave the line as it is, and begin the next one."""
        if self._terminal and self._shown and self._stream is not None:
            self._stream.write(CLEAR)
            self._stream.flush()


def _long(seconds: float) -> str:
    whole = round(seconds)
    if whole < 100:
        return f"{whole} s"
    return f"{round(whole / 60)} min" if whole < 6000 else f"{whole / 3600:.1f} h"


def usual_stream() -> TextIO:
    """Return where progress is said: the error stream, so that output stays what was asked for."""
    return sys.stderr
