"""A clock for served worlds that goes on only while the clients of a test wait, as trio's autojump clock.

A world that follows the wall clock makes each test last as long as its simulated time, and runs ahead of a
client that a loaded machine holds up. Under `Lockstep` it stands still while the test computes, and steps at
once while the test waits for data that has not come.

The clients of a test use blocking sockets in this process. While a served world is in lockstep, the blocking
calls of sockets, `select.select` and `time.sleep` report that their thread waits. Daemon threads do not
count: they are part of a client library (of `websockets`, for one) and wait at all times.
"""

import asyncio
import contextlib
import select
import socket
import threading
import time

from usarmjx.server.runtime.loop import IDLE_PERIOD, StepClock

LOCKSTEP = "lockstep"
"""Real-time factor that asks for this clock instead."""
MAX_FACTOR = 50.0
"""Most simulated seconds per second: what a test waits for may be the work of another thread."""
TURNS = 3
"""Rounds of the event loop from bytes in a socket to their command."""

SOCKET_CALLS = ("recv", "recv_into", "accept", "sendall")
ORIGINAL = {name: getattr(socket.socket, name) for name in SOCKET_CALLS}
SELECT, SLEEP = select.select, time.sleep


class Lockstep(StepClock):
    """A clock whose steps are due while a client waits and nothing has come for it.

    Args:
        factor: Simulated seconds per second that the clock reports.
    """

    def __init__(self, factor=1.0):
        super().__init__(factor)
        self._waiting = {}  # by thread: the sockets that would end its wait
        self._wake = self._loop = None
        self._last = 0.0

    @contextlib.contextmanager
    def waiting(self, *sockets):
        """Let worlds step until one of these sockets can be read; without sockets, until `with` ends."""
        thread = threading.get_ident()
        before = self._waiting.get(thread)
        self._waiting[thread] = sockets
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # it has ended meanwhile
                self._loop.call_soon_threadsafe(self._wake.set)
        try:
            yield
        finally:
            if before is None:
                del self._waiting[thread]
            else:
                self._waiting[thread] = before

    def _is_wanted(self):
        waits = list(self._waiting.values())
        sockets = [one for wait in waits for one in wait if one.fileno() >= 0]
        try:
            ready = SELECT(sockets, [], [], 0.0)[0] if sockets else []
        except (OSError, ValueError):  # its thread has closed a socket meanwhile, so that wait is over
            return False
        return bool(waits) and not ready

    def takes_step(self):
        return self._is_wanted() and super().takes_step()

    async def sleep(self, period):
        if self._loop is None:
            self._loop, self._wake = asyncio.get_running_loop(), asyncio.Event()
        for _ in range(TURNS):
            await asyncio.sleep(0.0)
        if self.paused:
            await asyncio.sleep(IDLE_PERIOD)
        elif self._is_wanted():
            due = self._last + period / MAX_FACTOR
            await asyncio.sleep(max(0.0, due - time.perf_counter()))
            self._last = time.perf_counter()
        else:
            self._wake.clear()
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._wake.wait(), IDLE_PERIOD)


CLOCKS = []
"""The clocks of all worlds that are being served in lockstep."""


@contextlib.contextmanager
def waiting(*sockets):
    """Report to all clocks that this thread waits, for one of the sockets if any are given."""
    if threading.current_thread().daemon:
        yield
        return
    with contextlib.ExitStack() as waits:
        for clock in CLOCKS:
            waits.enter_context(clock.waiting(*sockets))
        yield


@contextlib.contextmanager
def lockstep(factor=1.0):
    """A clock; until the end of `with` the blocking calls of this process report to it."""
    clock = Lockstep(factor)
    CLOCKS.append(clock)
    if len(CLOCKS) == 1:
        for name in SOCKET_CALLS:
            setattr(socket.socket, name, _reporting(name))
        select.select, time.sleep = _select, _sleep
    try:
        yield clock
    finally:
        CLOCKS.remove(clock)
        if not CLOCKS:
            for name in SOCKET_CALLS:
                setattr(socket.socket, name, ORIGINAL[name])
            select.select, time.sleep = SELECT, SLEEP


def _reporting(name):
    original = ORIGINAL[name]

    def call(self, *args):
        if self.gettimeout() == 0.0:  # it does not block
            return original(self, *args)
        with waiting() if name == "sendall" else waiting(self):
            return original(self, *args)

    return call


def _select(readers, writers, errors, timeout=None):
    if timeout is not None and timeout <= 0.0:
        return SELECT(readers, writers, errors, timeout)
    with waiting(*readers):
        return SELECT(readers, writers, errors, timeout)


def _sleep(seconds):
    with waiting():
        SLEEP(seconds)
