"""The server's loop: it steps the served worlds in time with the clock, and sockets are read in between.

A `StepClock` decides when the worlds step, a `Pace` how they catch up after a delay, a `StepMeter` measures.
"""

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
from collections.abc import Generator, Sequence
from functools import partial

from usarmjx.base.errors import UsageError
from usarmjx.base.process import return_freed_memory
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.network.loop_meter import LoopMeter, loop_meter, run_metered
from usarmjx.server.runtime.signals import StopSignals

log = logging.getLogger(__name__)

GAP_BOUNDS = (0.005, 0.01, 0.015, 0.025, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
"""Upper bounds of the histogram of gaps between two control steps [s]; a step is due after 0.02 s."""
WINDOW, SAMPLE = 5.0, 0.5
"""Time over which the real-time factor is averaged, and interval of its samples [s]."""
MAX_LAG = 0.5
"""Lag at which the pacing loop gives up catching up [s]."""
RECOVERY = 2.0
"""Time without a lag after which the loop counts as recovered [s]."""
IDLE_PERIOD = 0.02
"""Interval at which paused worlds are served [s]."""
MAX_STEPS = 1000
"""Most waiting single steps."""
MAX_FACTOR = 1000.0
"""Largest real-time factor."""
GC_THRESHOLD = 1000
"""Collections of young objects before one of old objects; Python's default is 10."""
CLEANING, CLEANING_SHARE, RAREST_CLEANING = 10.0, 1e-3, 60.0
"""Intervals at which a server collects old objects all the same, and returns freed memory to the system [s].

Websockets that have ended leave cycles of objects with their buffers: a server grew by 10 MB in a minute. The
interval is longer than the first value if a collection would take more than that share of the processor.
"""
SWITCH_INTERVAL = 5e-4
"""Time after which the loop interrupts another thread of Python, such as JAX's tracing [s]."""


class StepMeter:
    """A `gamebots.server.Service` that measures the control steps of a world.

    Args:
        server: The world's server.

    Attributes:
        server: The world's server.
        gaps: Number of gaps between two control steps up to each bound, and above the last.
        gap_sum: Their sum [s].
    """

    def __init__(self, server: BotServer) -> None:
        self.server = server
        self.gaps = [0] * (len(GAP_BOUNDS) + 1)
        self.gap_sum = 0.0
        self._last = self._next_sample = 0.0
        self._seen: float | None = None
        # One more than intervals: the first sample is the beginning of the window.
        self._samples: deque[tuple[float, float]] = deque(maxlen=round(WINDOW / SAMPLE) + 1)

    async def start(self) -> list[str]:
        """Do nothing: there is no port to open."""
        return []

    def tick(self) -> None:
        """Count a control step that has just been made; a world that is held has made none."""
        now, seen = time.perf_counter(), self.server.world.time
        if seen != self._seen:
            self.count(now)
        else:
            # A pause is no gap between two steps.
            self._last = now
        self._seen = seen

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
        """Do nothing."""

    def realtime_factor(self, now: float) -> float:
        """Return the recent simulated seconds per second at a time [s]; 0 before the first sample."""
        # The factor needs two different times; a division by zero would fail a request for metrics.
        if not self._samples or now <= self._samples[0][0]:
            return 0.0
        began, start = self._samples[0]
        return (self.server.world.time - start) / (now - began)


class Pace:
    """Schedule of control steps.

    A world that cannot keep up with the clock makes its steps one right after the other. Whenever it lags by
    `MAX_LAG`, it gives that time up: otherwise it would later run faster than the clock to make up for it.
    The log gets a line when that begins, and one with the total when it ends.

    Args:
        period: Length of a control step [s of simulated time].
        factor: Simulated seconds per second; 0: as fast as possible.
        now: Time of the first step [s].
    """

    def __init__(self, period: float, factor: float, now: float) -> None:
        self._period = period / factor if factor > 0 else 0.0
        self._deadline = now
        self._fell_behind = self._gave_up = math.nan
        self._lost = 0.0

    def pause(self, now: float) -> float:
        """Return the wait until the next control step [s], after one that ended at a time [s]."""
        if self._period <= 0.0:
            return 0.0
        # From the last deadline, not from now: oversleeping must not accumulate.
        self._deadline += self._period
        behind = now - self._deadline
        if behind > MAX_LAG:
            self._give_up(now, behind)
        # A comparison with NaN is false: without a lag so far there is nothing to finish.
        elif behind <= 0.0 and now >= self._gave_up + RECOVERY:
            self.finish(now)
        return max(0.0, -behind)

    def _give_up(self, now: float, behind: float) -> None:
        if math.isnan(self._fell_behind):
            self._fell_behind = now
            log.warning("%.2f s behind the clock: simulated time falls back", behind)
        # The schedule starts anew from now, so lost time is never made up by running fast.
        self._gave_up = self._deadline = now
        self._lost += behind

    def finish(self, now: float) -> None:
        """Log the time that was lost since the last such line, if any, at a time [s]."""
        if not math.isnan(self._fell_behind):
            lasted = now - self._fell_behind
            log.warning("no longer behind the clock: %.2f s lost in %.1f s", self._lost, lasted)
        self._fell_behind = self._gave_up = math.nan
        self._lost = 0.0


class StepClock:
    """Clock of the worlds: pauses, single steps and the real-time factor.

    The loop calls `takes_step` before each control step and `sleep` after it; `pause`, `step` and
    `set_factor` may be called from any thread.

    Args:
        factor: Simulated seconds per second; 0: as many as possible.
    """

    def __init__(self, factor: float = 1.0) -> None:
        self._factor, self._paused, self._steps = factor, False, 0
        self._pace: Pace | None = None
        self._period = 0.0
        self._lock = threading.Lock()

    @property
    def factor(self) -> float:
        """Wanted simulated seconds per second; 0: as many as possible."""
        return self._factor

    @property
    def paused(self) -> bool:
        """Whether the worlds are paused."""
        return self._paused

    def pause(self, on: bool) -> None:
        """Pause the worlds, or let them go on."""
        with self._lock:
            self._paused, self._steps = on, 0

    def step(self, steps: int = 1) -> None:
        """Make some more control steps, and pause the worlds.

        Raises:
            UsageError: The number is out of range.
        """
        if not 1 <= steps <= MAX_STEPS:
            raise UsageError(f"{steps} single steps cannot be asked for: 1 to {MAX_STEPS}")
        with self._lock:
            self._paused, self._steps = True, min(self._steps + steps, MAX_STEPS)

    def set_factor(self, factor: float) -> None:
        """Set the simulated seconds per second.

        Raises:
            UsageError: The factor is out of range.
        """
        if not (math.isfinite(factor) and 0.0 <= factor <= MAX_FACTOR):
            raise UsageError(f"a real-time factor of {factor:g} is not possible: 0 to {MAX_FACTOR:g}")
        with self._lock:
            # A new schedule: the old one's deadlines belong to another speed.
            self._factor, self._pace = factor, None

    def takes_step(self) -> bool:
        """Return whether the worlds make a control step now; it uses up a single step."""
        with self._lock:
            if self._paused and not self._steps:
                return False
            # Paused counts as 1: only then is a single step used up.
            self._steps -= self._paused
            return True

    def wait(self, period: float, now: float) -> float:
        """Return the wait [s] until the next control step, or the next check of a pause.

        Args:
            period: Length of a control step [s of simulated time].
            now: End of the last one [s].
        """
        with self._lock:
            if self._paused:
                # The time of a pause is no lag to catch up after it.
                self._pace = None
                return IDLE_PERIOD
            if self._pace is None:
                self._pace = Pace(period, self._factor, now)
            return self._pace.pause(now)

    async def sleep(self, period: float) -> None:
        """Sleep until the next control step, or the next check of a pause, is due.

        A subclass that does not follow the wall clock overrides this and `takes_step`.

        Args:
            period: Length of a control step [s of simulated time].
        """
        await asyncio.sleep(self.wait(period, time.perf_counter()))

    def finish(self, now: float) -> None:
        """Log the time that was lost since the last such line, if any, at a time [s]."""
        with self._lock:
            if self._pace is not None:
                self._pace.finish(now)


class ServerLoop:
    """Serves worlds until `stop`.

    All have one clock: each makes one control step after the other in the order given, and in between
    sockets are read.

    Args:
        servers: Server of each world.
        clock: Clock of all worlds; a number: simulated seconds per second, or 0.

    Attributes:
        listening: Whether all servers listen.
    """

    def __init__(self, servers: Sequence[BotServer], clock: StepClock | float = 1.0) -> None:
        self._servers = servers
        self._clock = clock if isinstance(clock, StepClock) else StepClock(clock)
        self._stop = asyncio.Event()
        self._busy = 0.0
        self._clean_at = math.inf
        self.listening = False

    async def run(self) -> None:
        """Listen, print the addresses, and step until `stop`.

        Raises:
            UsageError: A port is taken or the address is not ours.
        """
        try:
            # All listen before the first line: a reader of one world's address may use the others at once.
            for lines in [self._announcement(server, await server.start()) for server in self._servers]:
                # Flushed: a program that has started this one waits for these lines at a pipe.
                print(*(f"usarmjx: {line}" for line in lines), sep="\n", flush=True)
            self.listening = True
            await self._run_worlds()
        finally:
            # All of them, also those that do not listen yet because another's port is taken.
            for server in self._servers:
                server.stop()

    def stop(self) -> None:
        """End `run` after the present step."""
        self._stop.set()

    def _times_up(self, served: float) -> bool:
        """Return whether the time limit is reached, after some time of serving [s of simulated time]."""
        # That of the first world, as all worlds have one clock.
        limit = self._servers[0].settings.time_limit
        # Half a step as margin: the time is a sum of floats, and would end a step late.
        return limit > 0 and served >= 60 * limit - self._servers[0].world.period / 2

    def _announcement(self, server: BotServer, lines: Sequence[str]) -> Sequence[str]:
        return lines if len(self._servers) == 1 else [f"{server.title}: {', '.join(lines)}"]

    async def _run_worlds(self) -> None:
        world, meter = self._servers[0].world, loop_meter()
        began, start = time.perf_counter(), world.time
        self._clean_at = began + CLEANING
        while not self._stop.is_set() and not self._times_up(world.time - start):
            moves = self._clock.takes_step()
            for number, server in enumerate(self._servers):
                # Sockets are read between two worlds, too: a round over many worlds is longer than a turn may
                # wait.
                if number:
                    await asyncio.sleep(0)
                self._tick(server, moves, meter)
            # Once in a round: the meter shares one thread's time among all worlds.
            meter.refill(world.period)
            self._clean(time.perf_counter())
            await self._clock.sleep(world.period)
        ended = time.perf_counter()
        self._clock.finish(ended)
        # A signal may come before any time is spent.
        spent = max(ended - began, 1e-9)
        print(
            f"usarmjx: stopped after {world.time - start:.1f} simulated s; real-time factor "
            f"{(world.time - start) / spent:.2f}, busy {100 * self._busy / spent:.0f} % of the time",
            flush=True,
        )

    def _clean(self, now: float) -> None:
        """Collect old objects if it is time [s], and if `low_latency` has put that off."""
        # With Python's own thresholds it collects by itself, and a second collection would only cost time.
        if now >= self._clean_at and gc.get_threshold()[2] == GC_THRESHOLD:
            began = time.thread_time()
            gc.collect()
            return_freed_memory()
            pause = (time.thread_time() - began) / CLEANING_SHARE
            self._clean_at = now + min(max(CLEANING, pause), RAREST_CLEANING)

    def _tick(self, server: BotServer, moves: bool, meter: LoopMeter) -> None:
        began = time.perf_counter()
        with meter.excluded():
            server.tick(moves)
        self._busy += time.perf_counter() - began


@contextlib.contextmanager
def low_latency() -> Generator[None]:
    """Keep other threads and the garbage collector from delaying the loop, within the context.

    A collection among the hundreds of thousands of objects that JAX keeps stops all threads, and tracing a
    function triggers many of them.
    """
    switch_interval, thresholds = sys.getswitchinterval(), gc.get_threshold()
    sys.setswitchinterval(SWITCH_INTERVAL)
    # Collections skip all objects that exist now, most of them JAX's.
    gc.freeze()
    gc.set_threshold(*thresholds[:2], GC_THRESHOLD)
    try:
        yield
    finally:
        sys.setswitchinterval(switch_interval)
        gc.set_threshold(*thresholds)
        # Programs that go on after the server have their objects collected as before.
        gc.unfreeze()


def serve(servers: Sequence[BotServer], clock: StepClock | float, signals: StopSignals) -> None:
    """Serve worlds until a signal.

    Args:
        servers: Server of each world.
        clock: Clock of all worlds; a number: simulated seconds per second, or 0.
        signals: Signals that stop the loop.

    Raises:
        UsageError: A port is taken or the address is not ours.
    """

    async def main() -> None:
        loop = ServerLoop(servers, clock)
        signals.on_stop(partial(_call_soon, asyncio.get_running_loop(), loop))
        await loop.run()

    # Compiled before the ports open: a client that connects early would wait for it within the loop.
    for server in servers:
        server.world.warm_up()
    with low_latency():
        run_metered(main())


def _call_soon(running: asyncio.AbstractEventLoop, loop: ServerLoop) -> None:
    """Stop a loop from another thread."""
    with contextlib.suppress(RuntimeError):  # it has ended meanwhile
        running.call_soon_threadsafe(loop.stop)
