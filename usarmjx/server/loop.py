"""The loop that all is served in: it steps the served worlds in time with the clock."""

import asyncio
import contextlib
import gc
import sys
import time
from collections.abc import Iterator, Sequence
from functools import partial

from usarmjx.server.clock import StepClock
from usarmjx.server.net import BotServer
from usarmjx.server.signals import StopSignals

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
