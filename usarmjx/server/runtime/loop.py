"""The loop that all is served in: it steps the served worlds in time with the clock."""

import asyncio
import contextlib
import gc
import logging
import math
import sys
import threading
import time
from bisect import bisect_left
from collections import deque
from collections.abc import Iterator, Sequence
from functools import partial

from usarmjx.base.errors import UsageError
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.runtime.signals import StopSignals

GAP_BOUNDS = (0.005, 0.01, 0.015, 0.025, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
"""Gaps between two control steps are counted up to each of these [s]; one is due after 0.02 s."""
WINDOW, SAMPLE = 5.0, 0.5
"""The real-time factor is that of the last seconds, looked at so often [s]."""


class StepMeter:
    """A `net.Service` that measures the control steps of a world.

    Args:
        server: The world's server.

    Attributes:
        server: The world's server.
        gaps: How many gaps between two control steps were up to each bound, and how many above the last.
        gap_sum: Their sum [s].
    """

    def __init__(self, server: BotServer) -> None:
        self.server = server
        self.gaps = [0] * (len(GAP_BOUNDS) + 1)
        self.gap_sum = 0.0
        self._last = self._next_sample = 0.0
        self._samples: deque[tuple[float, float]] = deque(maxlen=round(WINDOW / SAMPLE) + 1)

    async def start(self) -> list[str]:
        """Begin; there is nothing to say."""
        return []

    def tick(self) -> None:
        """The world has made a control step."""
        self.count(time.perf_counter())

    def count(self, now: float) -> None:
        """Count a control step that was made at a time [s]."""
        if self._last:
            gap = now - self._last
            self.gaps[bisect_left(GAP_BOUNDS, gap)] += 1
            self.gap_sum += gap
        self._last = now
        if now >= self._next_sample:
            self._next_sample = now + SAMPLE
            self._samples.append((now, self.server.world.time))

    def stop(self) -> None:
        """Nothing to do."""

    def realtime_factor(self, now: float) -> float:
        """Return simulated seconds per second of late, as seen at a time [s]; 0 while there is no telling."""
        if not self._samples or now <= self._samples[0][0]:
            return 0.0
        began, start = self._samples[0]
        return (self.server.world.time - start) / (now - began)


log = logging.getLogger(__name__)

MAX_LAG = 0.5
"""What is further behind the clock than this gives up catching up [s]."""
RECOVERY = 2.0
"""What is in time so long after giving up has caught its breath [s]."""


class Pace:
    """Says when to make the next control step.

    A world that cannot keep up with the clock makes its steps one right after the other. Whenever it is
    `MAX_LAG` behind, it lets that time go: else it would run ahead of the clock when it could again. The log
    gets a line when that begins, and one with the total when it ends.

    Args:
        period: Length of a control step [s of simulated time].
        factor: Simulated seconds per second; 0: as fast as it can.
        now: When the first step is made [s].
    """

    def __init__(self, period: float, factor: float, now: float) -> None:
        self._period = period / factor if factor > 0 else 0.0
        self._deadline = now
        self._fell_behind = self._gave_up = math.nan
        self._lost = 0.0

    def pause(self, now: float) -> float:
        """Return how long to wait for the next control step, after one that ended at a time [s]."""
        if self._period <= 0.0:
            return 0.0
        self._deadline += self._period
        behind = now - self._deadline
        if behind > MAX_LAG:
            self._give_up(now, behind)
        elif behind <= 0.0 and now >= self._gave_up + RECOVERY:
            self.finish(now)
        return max(0.0, -behind)

    def _give_up(self, now: float, behind: float) -> None:
        if math.isnan(self._fell_behind):
            self._fell_behind = now
            log.warning("%.2f s behind the clock: simulated time falls back", behind)
        self._gave_up = self._deadline = now
        self._lost += behind

    def finish(self, now: float) -> None:
        """Log how much time was lost, if any was since that was logged last, at a time [s]."""
        if not math.isnan(self._fell_behind):
            lasted = now - self._fell_behind
            log.warning("no longer behind the clock: %.2f s lost in %.1f s", self._lost, lasted)
        self._fell_behind = self._gave_up = math.nan
        self._lost = 0.0


IDLE_PERIOD = 0.02
"""Worlds that stand still are attended to so often [s]."""
MAX_STEPS = 1000
"""Most single steps that may wait."""
MAX_FACTOR = 1000.0
"""Largest factor that can be asked for."""


class StepClock:
    """Says when worlds make their next control step, and whether they make it.

    Whoever steps them asks `takes_step` before each and `wait` after it; `pause`, `step` and `set_factor` may
    be called from any thread.

    Args:
        factor: Simulated seconds per second; 0: as many as there can be.
    """

    def __init__(self, factor: float = 1.0) -> None:
        self._factor, self._paused, self._steps = factor, False, 0
        self._pace: Pace | None = None
        self._period = 0.0
        self._lock = threading.Lock()

    @property
    def factor(self) -> float:
        """Simulated seconds per second that are wanted; 0: as many as there can be."""
        return self._factor

    @property
    def paused(self) -> bool:
        """Whether the worlds stand still."""
        return self._paused

    def pause(self, on: bool) -> None:
        """Let the worlds stand still, or go on."""
        with self._lock:
            self._paused, self._steps = on, 0

    def step(self, steps: int = 1) -> None:
        """Let the worlds make so many more control steps, and stand still then.

        Raises:
            UsageError: That many cannot be asked for.
        """
        if not 1 <= steps <= MAX_STEPS:
            raise UsageError(f"{steps} single steps cannot be asked for: 1 to {MAX_STEPS}")
        with self._lock:
            self._paused, self._steps = True, min(self._steps + steps, MAX_STEPS)

    def set_factor(self, factor: float) -> None:
        """Set how many simulated seconds a second shall have.

        Raises:
            UsageError: It is no such number.
        """
        if not (math.isfinite(factor) and 0.0 <= factor <= MAX_FACTOR):
            raise UsageError(f"a real-time factor of {factor:g} is not possible: 0 to {MAX_FACTOR:g}")
        with self._lock:
            self._factor, self._pace = factor, None

    def takes_step(self) -> bool:
        """Return whether the worlds make a control step now; a single step is used up by that."""
        with self._lock:
            if self._paused and not self._steps:
                return False
            self._steps -= self._paused
            return True

    def wait(self, period: float, now: float) -> float:
        """Return how long to wait after a time [s]: for the next control step, or the next look.

        Args:
            period: Length of a control step [s of simulated time].
            now: When the last one ended [s].
        """
        with self._lock:
            if self._paused:
                self._pace = None
                return IDLE_PERIOD
            if self._pace is None:
                self._pace = Pace(period, self._factor, now)
            return self._pace.pause(now)

    def finish(self, now: float) -> None:
        """Log how much time was lost, if any was since that was logged last, at a time [s]."""
        with self._lock:
            if self._pace is not None:
                self._pace.finish(now)


GC_THRESHOLD = 1000
"""Young objects are looked through for garbage so often before old ones are; Python's default is 10."""
SWITCH_INTERVAL = 5e-4
"""The loop gets its turn so soon when another thread runs Python, as when JAX traces a function [s]."""


class ServerLoop:
    """Serves worlds until told to stop.

    All have one clock: each makes one control step after the other in the order given, and in between
    sockets are read.

    Args:
        servers: One for each world.
        clock: Pauses, and how fast simulated time goes; a number: simulated seconds per second, or 0.

    Attributes:
        listening: Whether all is listening.
    """

    def __init__(self, servers: Sequence[BotServer], clock: StepClock | float = 1.0) -> None:
        self._servers = servers
        self._clock = clock if isinstance(clock, StepClock) else StepClock(clock)
        self._stop = asyncio.Event()
        self._busy = 0.0
        self.listening = False

    async def run(self) -> None:
        """Listen, say so, and step until `stop`.

        Raises:
            UsageError: A port is taken or the address is not ours.
        """
        try:
            # First all listen: who has read the line of one world finds the others too.
            for lines in [self._announcement(server, await server.start()) for server in self._servers]:
                print(*(f"usarmjx: {line}" for line in lines), sep="\n", flush=True)
            self.listening = True
            await self._run_worlds()
        finally:
            for server in self._servers:
                server.stop()

    def stop(self) -> None:
        """End `run` after the present step."""
        self._stop.set()

    def _times_up(self, served: float) -> bool:
        """Return whether the worlds have been served for as long as they shall be [s of simulated time]."""
        limit = self._servers[0].settings.time_limit
        return limit > 0 and served >= 60 * limit - self._servers[0].world.period / 2

    def _announcement(self, server: BotServer, lines: Sequence[str]) -> Sequence[str]:
        return lines if len(self._servers) == 1 else [f"{server.title}: {', '.join(lines)}"]

    async def _run_worlds(self) -> None:
        world = self._servers[0].world
        began, start = time.perf_counter(), world.time
        while not self._stop.is_set() and not self._times_up(world.time - start):
            moves = self._clock.takes_step()
            for number, server in enumerate(self._servers):
                if number:
                    await asyncio.sleep(0)
                self._tick(server, moves)
            await asyncio.sleep(self._clock.wait(world.period, time.perf_counter()))
        ended = time.perf_counter()
        self._clock.finish(ended)
        spent = max(ended - began, 1e-9)
        print(
            f"usarmjx: stopped after {world.time - start:.1f} simulated s; real-time factor "
            f"{(world.time - start) / spent:.2f}, busy {100 * self._busy / spent:.0f} % of the time",
            flush=True,
        )

    def _tick(self, server: BotServer, moves: bool) -> None:
        began = time.perf_counter()
        server.tick(moves)
        self._busy += time.perf_counter() - began


@contextlib.contextmanager
def low_latency() -> Iterator[None]:
    """Let no other thread and no search for garbage hold up the loop; on leaving all is as it was.

    To look for garbage among the hundreds of thousands of objects that JAX keeps holds up all threads, and
    that again and again while a function is traced.
    """
    switch_interval, thresholds = sys.getswitchinterval(), gc.get_threshold()
    sys.setswitchinterval(SWITCH_INTERVAL)
    gc.freeze()
    gc.set_threshold(*thresholds[:2], GC_THRESHOLD)
    try:
        yield
    finally:
        sys.setswitchinterval(switch_interval)
        gc.set_threshold(*thresholds)
        gc.unfreeze()


def serve(servers: Sequence[BotServer], clock: StepClock | float, signals: StopSignals) -> None:
    """Serve worlds until a signal comes.

    Args:
        servers: One for each world.
        clock: Pauses, and how fast simulated time goes; a number: simulated seconds per second, or 0.
        signals: What says when to stop.

    Raises:
        UsageError: A port is taken or the address is not ours.
    """

    async def main() -> None:
        loop = ServerLoop(servers, clock)
        signals.on_stop(partial(_call_soon, asyncio.get_running_loop(), loop))
        await loop.run()

    for server in servers:
        server.world.warm_up()
    with low_latency():
        asyncio.run(main())


def _call_soon(running: asyncio.AbstractEventLoop, loop: ServerLoop) -> None:
    """Stop a loop from another thread."""
    with contextlib.suppress(RuntimeError):  # it has ended meanwhile
        running.call_soon_threadsafe(loop.stop)
