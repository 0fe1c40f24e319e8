"""Progress of a sweep with an estimate of the rest, and a probe of its time and memory."""

import os
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TextIO

import jax

from usarmjx.base.progress import StatusLine
from usarmjx.sweeps.batch import GroupRunner
from usarmjx.sweeps.play import BatchWork, resolved
from usarmjx.sweeps.resolve import Resolved

INTERVAL = 10.0
"""Interval of progress lines without a terminal [s]."""
TERMINAL_INTERVAL = 0.2
STEPS = 8
"""Control steps that are timed after the first one, which compiles."""


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
            # The end of the first step is the end of compiling: JAX compiles within it.
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
            # Only the first worker of a group counts; others compile the same meanwhile.
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
        # Without a compilation so far there is no time to multiply, so none is announced.
        more = max(self._compilations - len(self._compiled), 0) if self._compiled else 0
        # Each worker spends its own seconds, so the time of all is what cells share.
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


class _Enough(Exception):
    """Ends a batch once its steps are timed."""


@dataclass(frozen=True, kw_only=True)
class SweepProbe:
    """Time and memory of a batch, and what follows for the sweep.

    Attributes:
        worlds: Worlds of the batch that was probed.
        first: Time to build and compile it, with its first step [s].
        step: Time of a control step [s].
        seconds: Estimated time of all batches, one after the other, without clients [s].
        used: Peak of the memory [bytes]: the device's if it reports one, else this process's; 0: unknown.
        room: Memory of the device or machine [bytes]; 0: not known.
    """

    worlds: int
    first: float
    step: float
    seconds: float
    used: int
    room: int

    @property
    def fits(self) -> bool:
        """Whether the batch needs no more than nine tenths of the memory."""
        return not self.room or self.used <= 0.9 * self.room

    def as_text(self, workers: int = 1) -> str:
        """Return the probe in a line, with the time on workers that share the batches evenly."""
        memory = f", {self.used / 1e9:.1f} of {self.room / 1e9:.0f} GB of memory" if self.room else ""
        line = (
            f"probe of {self.worlds} worlds: {self.first:.0f} s to build and compile, "
            f"{1e3 * self.step:.0f} ms a step{memory}; about {duration_text(self.seconds / workers)} for all"
        )
        return line if self.fits else f"{line}; too large: set a smaller number of worlds in the file"


def probe_works(works: Sequence[BatchWork]) -> SweepProbe | None:
    """Play some steps of the largest batch; None if clients drive all cells.

    The time of a step is taken as proportional to the worlds, and that of a compilation as equal for all
    groups; episodes that end early shorten a sweep.

    Raises:
        UsageError: The worlds of its cells cannot be built.
    """
    played = [work for work in works if _cell(work).driver.command is None]
    if not played:
        return None
    largest = max(played, key=_worlds)
    begun = time.perf_counter()
    kin = [resolved(settings) for settings in largest.kin]
    runner = GroupRunner(kin, largest.size, largest.engine)
    times: list[float] = []

    def tick(share: float) -> None:
        times.append(time.perf_counter())
        if len(times) > STEPS or share >= 1.0:
            # An exception is the only way out of a batch that knows nothing of probes.
            raise _Enough

    with suppress(_Enough):
        runner.run([resolved(settings) for _, settings in largest.cells], tick)
    # The first tick includes building and compiling; differences of the later ones are plain steps.
    first, step = times[0] - begun, (times[-1] - times[0]) / max(len(times) - 1, 1)
    worlds = runner.env.worlds
    groups = {work.group for work in played}
    steps = sum(_cell(work).task.episode_steps * _worlds(work) / worlds for work in played)
    used, room = memory()
    return SweepProbe(
        worlds=worlds,
        first=first,
        step=step,
        seconds=first * len(groups) + step * steps,
        used=used,
        room=room,
    )


def _cell(work: BatchWork) -> Resolved:
    return resolved(work.cells[0][1])


def _worlds(work: BatchWork) -> int:
    return work.size * _cell(work).episodes


def memory() -> tuple[int, int]:
    """Return the peak of the memory in use and the memory in all [bytes]; zeros if neither is known."""
    stats = jax.devices()[0].memory_stats() if jax.devices()[0].platform != "cpu" else None
    if stats is not None:
        return int(stats.get("peak_bytes_in_use", 0)), int(stats.get("bytes_limit", 0))
    if sys.platform == "win32":
        return 0, 0
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # ru_maxrss is in bytes on macOS and in KiB on Linux.
    unit = 1 if sys.platform == "darwin" else 1024
    return peak * unit, os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
