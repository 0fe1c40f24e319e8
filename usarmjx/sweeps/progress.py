"""Progress of a sweep: finished cells, and an estimate of the remaining time with its compilations."""

import time
from typing import TextIO

from usarmjx.base.progress import StatusLine

INTERVAL = 10.0
"""Interval of progress lines without a terminal [s]."""
TERMINAL_INTERVAL = 0.2


class SweepProgress:
    """Progress of a sweep, and its lines.

    The estimate takes the mean time of the played cells for each cell, without compilations, and the mean
    time of the past compilations for each group that is not compiled yet.

    Args:
        cells: Number of cells to play.
        stream: Stream to write to; None: none.
        compilations: Number of groups of cells, each compiled once.
        workers: Number of workers that share the batches.
    """

    def __init__(
        self, cells: int, stream: TextIO | None = None, *, compilations: int = 0, workers: int = 1
    ) -> None:
        self.cells = cells
        self._compilations, self._workers = compilations, workers
        self._status = None if stream is None else StatusLine(stream)
        self._begun = self._last = time.monotonic()
        self.done = self.failed = 0
        self._compiled = dict[str, float]()
        self._untimed = 0.0  # cells that took no time of their own: played while compiling, or broken
        self._compiling: tuple[str, float] | None = None

    def begin(self, group: str) -> None:
        """Note the begin of a batch; the first batch of a group compiles until the end of its first step."""
        self._compiling = None if group in self._compiled else (group, time.monotonic())

    def within(self, batch: int, share: float) -> None:
        """Report the played share of a batch of cells."""
        played = batch * min(share, 1.0)
        if self._compiling is not None:
            group, since = self._compiling
            self._compiling, self._compiled[group] = None, time.monotonic() - since
            self._untimed += played
        self._say(self.done + played)

    def add(self, done: int, failed: int, group: str = "", compiling: float = 0.0) -> None:
        """Count cells of a group that have a result, and cells that have failed.

        Args:
            done: Cells that have a result.
            failed: Cells that have failed.
            group: Their group; empty: nothing played them.
            compiling: Time of compilation in a worker [s].
        """
        self.done, self.failed = self.done + done + failed, self.failed + failed
        if not group:
            self._untimed += done + failed  # broken cells take no time
        if compiling > 0.0:
            self._compiled.setdefault(group, compiling)
        self._say(float(self.done))

    def _say(self, done: float) -> None:
        now = time.monotonic()
        if self._status is None:
            return
        if now - self._last >= (TERMINAL_INTERVAL if self._status.terminal else INTERVAL):
            self._last = now
            self._status.show(self.line(done, now - self._begun))

    def line(self, done: float, seconds: float) -> str:
        """Return the line after a number of cells and seconds."""
        failed = f", {self.failed} failed" if self.failed else ""
        line = f"usarmjx: {self.done} of {self.cells} cells{failed}, {duration_text(seconds)}"
        timed = done - self._untimed
        if timed <= 0:
            return line
        compiling = sum(self._compiled.values())
        more = max(self._compilations - len(self._compiled), 0) if self._compiled else 0
        playing = max(seconds * self._workers - compiling, 0.0)
        left = (self.cells - done) * playing / timed + more * compiling / max(len(self._compiled), 1)
        line += f", about {duration_text(left / self._workers)} left"
        return f"{line} with {more} compilation{'' if more == 1 else 's'}" if more else line

    def close(self) -> None:
        """Clear the line: other output follows."""
        if self._status is not None:
            self._status.clear()


def duration_text(seconds: float) -> str:
    """Return a time in seconds, minutes or hours."""
    whole = round(seconds)
    if whole < 100:
        return f"{whole} s"
    return f"{round(whole / 60)} min" if whole < 6000 else f"{whole / 3600:.1f} h"
