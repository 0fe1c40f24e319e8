"""A short probe of a plan: some steps of its largest batch give time and memory of the whole sweep."""

import os
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import jax

from usarmjx.sweeps.batch import GroupRunner
from usarmjx.sweeps.play import BatchWork, resolved
from usarmjx.sweeps.progress import duration_text
from usarmjx.sweeps.resolve import Resolved

STEPS = 8
"""Control steps that are timed after the first one, which compiles."""


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
            raise _Enough

    with suppress(_Enough):
        runner.run([resolved(settings) for _, settings in largest.cells], tick)
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
    unit = 1 if sys.platform == "darwin" else 1024
    return peak * unit, os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
