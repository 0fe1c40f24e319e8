"""Meter of a server's event loop: connections, handshakes and reading take a share of each control step.

All that a peer does becomes an event of a socket. The loop's selector hands events over a few at a time, and
the meter measures the processor time of the rounds that follow. When the share of a control step is spent,
the selector holds all metered sockets back until the next one: the system lets their bytes and connections
wait. Work with a budget of its own, such as a control step or the turn of a robot's client, is excluded.
"""

import asyncio
import selectors
import sys
import time
from collections.abc import Callable, Collection, Coroutine, Generator, Mapping
from contextlib import contextmanager
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

T = TypeVar("T")
SHARE = 0.1
"""Share of a control step for metered events [s per simulated second]."""
MOST_DEBT = 10
"""Most control steps for which metered sockets are held back."""
EVENTS_AT_ONCE, PREFERRED_AT_ONCE = 4, 3
"""Most metered events in one round of the loop, and most of preferred sockets among them."""
ROUNDS = 4
"""Rounds of the loop that count as the work of an event: its callback, and the tasks that it wakes."""
MOST_REMEMBERED = 4096
"""Sockets whose last turn is remembered."""


class LoopMeter:
    """Processor time of metered events between two control steps.

    Args:
        share: Share of a control step [s per simulated second].
        clock: Processor time of this thread [s].
    """

    def __init__(self, share: float = SHARE, clock: Callable[[], float] = time.thread_time) -> None:
        self._share, self._clock = share, clock
        self._left = self._excluded = 0.0
        self._began, self._rounds = clock(), 0
        self._exempt, self._preferred = set[int](), set[int]()

    @property
    def is_spent(self) -> bool:
        """Whether metered sockets are held back."""
        return self._left < 0.0

    def refill(self, period: float) -> None:
        """Begin a control step of some simulated time [s]: an unspent rest is lost, a debt stays."""
        growth = self._share * period
        # The debt is bounded, so that one long handshake does not shut all others out for seconds.
        self._left = growth + min(0.0, max(self._left, -MOST_DEBT * growth))

    def exclude(self, cost: float) -> None:
        """Do not count work that has a budget of its own [s]."""
        self._excluded += cost

    @contextmanager
    def excluded(self) -> Generator[None]:
        """Do not count the work within the context, which does not wait."""
        began = self._clock()
        try:
            yield
        finally:
            self.exclude(self._clock() - began)

    def begin_round(self, has_events: bool) -> None:
        """Begin a round of the loop, with metered events or without."""
        if has_events:
            # The tasks that an event wakes run in later rounds, not in the one of its callback.
            self._rounds = ROUNDS
        self._began, self._excluded = self._clock(), 0.0

    def end_round(self) -> None:
        """Count the round if it may belong to a metered event."""
        if self._rounds:
            self._rounds -= 1
            # Never negative: excluded work may have been measured by a coarser clock.
            self._left -= max(0.0, self._clock() - self._began - self._excluded)

    def exempt(self, descriptor: int) -> None:
        """Never hold a socket back: its service has a budget."""
        self._exempt.add(descriptor)

    def prefer(self, descriptor: int) -> None:
        """Take the events of a socket first."""
        self._preferred.add(descriptor)

    def forget(self, descriptor: int) -> None:
        """Meter a socket as any other; call it before the socket closes."""
        self._exempt.discard(descriptor)
        self._preferred.discard(descriptor)

    def is_exempt(self, descriptor: int) -> bool:
        """Return whether a socket is never held back."""
        return descriptor in self._exempt

    def is_preferred(self, descriptor: int) -> bool:
        """Return whether the events of a socket are first."""
        return descriptor in self._preferred


class MeteredSelector(selectors.BaseSelector):
    """The system's selector, which holds sockets back as a meter says.

    Args:
        meter: The meter; the first registered file, by which a loop wakes itself, is exempt.
    """

    def __init__(self, meter: LoopMeter) -> None:
        self.meter = meter
        self._inner = selectors.DefaultSelector()
        self._keys = dict[int, selectors.SelectorKey]()
        self._held = set[int]()
        self._turns, self._turn = dict[int, int](), 0
        self._own, self._holds = -1, False

    def register(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:  # noqa: ANN401
        """Register a file, as the base class has it."""
        key = selectors.SelectorKey(fileobj, _descriptor(fileobj), events, data)
        if key.fd in self._keys:
            raise KeyError(f"{fileobj!r} (FD {key.fd}) is already registered")
        if self._own < 0:
            # asyncio registers its self-pipe first: held back, it could not wake a sleeping loop.
            self._own = key.fd
        self._keys[key.fd] = key
        # A socket that comes while others are held back is held, too, or it would pass them.
        if self._holds and self._is_metered(key.fd):
            self._held.add(key.fd)
        else:
            self._inner.register(key.fd, events)
        return key

    def unregister(self, fileobj: Any) -> selectors.SelectorKey:  # noqa: ANN401 - as in the base class
        """Unregister a file."""
        key = self._keys.pop(_descriptor(fileobj))
        if key.fd in self._held:
            self._held.remove(key.fd)
        else:
            self._inner.unregister(key.fd)
        return key

    def modify(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:  # noqa: ANN401
        """Change the events of a file, or its data."""
        before = self._keys[_descriptor(fileobj)]
        key = self._keys[before.fd] = selectors.SelectorKey(fileobj, before.fd, events, data)
        # A held file gets its new events when it is registered with the system again.
        if events != before.events and key.fd not in self._held:
            self._inner.modify(key.fd, events)
        return key

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """Wait for events; return those of exempt files, and a few others."""
        self.meter.end_round()
        self._hold_back(self.meter.is_spent)
        # The keys of our own table: the system's have no data, which asyncio needs to find its callbacks.
        ready = [(self._keys[key.fd], events) for key, events in self._inner.select(timeout)]
        metered = [one for one in ready if self._is_metered(one[0].fd)]
        if len(metered) > EVENTS_AT_ONCE:
            chosen = {key.fd for key in self._chosen([key for key, _ in metered])}
            ready = [one for one in ready if one[0].fd in chosen or not self._is_metered(one[0].fd)]
        else:
            self._note_turns([key for key, _ in metered])
        self.meter.begin_round(bool(metered))
        return ready

    def close(self) -> None:
        """Close the selector."""
        self._inner.close()
        self._keys.clear()
        self._held.clear()

    def get_key(self, fileobj: Any) -> selectors.SelectorKey:  # noqa: ANN401 - as in the base class
        """Return the key of a file.

        Raises:
            KeyError: It is not registered.
        """
        return self._keys[_descriptor(fileobj)]

    def get_map(self) -> Mapping[Any, selectors.SelectorKey]:
        """Return the registered files by descriptor."""
        return self._keys

    def _is_metered(self, descriptor: int) -> bool:
        return descriptor != self._own and not self.meter.is_exempt(descriptor)

    def _hold_back(self, on: bool) -> None:
        """Hold all metered files back, or none."""
        if self._holds and not on:
            for descriptor in self._held:
                self._inner.register(descriptor, self._keys[descriptor].events)
            self._held.clear()
        elif on:
            # Each time: one that was exempt may be metered now.
            fresh = [one for one in self._keys if one not in self._held and self._is_metered(one)]
            for descriptor in fresh:
                self._inner.unregister(descriptor)
            self._held.update(fresh)
        self._holds = on

    def _chosen(self, keys: Collection[selectors.SelectorKey]) -> list[selectors.SelectorKey]:
        """Return the files whose turn it is: some preferred ones, then those that have waited longest."""
        # Sockets without a turn so far come first.
        waiting = sorted(keys, key=lambda key: self._turns.get(key.fd, 0))
        first = [key for key in waiting if self.meter.is_preferred(key.fd)]
        rest = [key for key in waiting if not self.meter.is_preferred(key.fd)]
        chosen = [*first[:PREFERRED_AT_ONCE], *rest, *first[PREFERRED_AT_ONCE:]][:EVENTS_AT_ONCE]
        self._note_turns(chosen)
        return chosen

    def _note_turns(self, keys: Collection[selectors.SelectorKey]) -> None:
        self._turn += 1
        # Descriptors are reused and never reported as closed, so the table is emptied at times.
        if len(self._turns) > MOST_REMEMBERED:
            self._turns.clear()
        self._turns.update((key.fd, self._turn) for key in keys)


def _descriptor(fileobj: Any) -> int:  # noqa: ANN401 - a number, or an object with one
    return fileobj if isinstance(fileobj, int) else int(fileobj.fileno())


_meters: WeakKeyDictionary[asyncio.AbstractEventLoop, LoopMeter] = WeakKeyDictionary()


def metered_loop() -> asyncio.AbstractEventLoop:
    """Return a new event loop with a meter; without one on Windows, whose loop has no selector."""
    if sys.platform == "win32":
        return asyncio.new_event_loop()
    meter = LoopMeter()
    loop = asyncio.SelectorEventLoop(MeteredSelector(meter))
    _meters[loop] = meter
    return loop


def run_metered(main: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine as `asyncio.run` does, in a loop with a meter."""
    with asyncio.Runner(loop_factory=metered_loop) as runner:
        return runner.run(main)


def loop_meter() -> LoopMeter:
    """Return the meter of the running loop; for a loop without one, a meter without effect."""
    return _meters.get(asyncio.get_running_loop()) or LoopMeter()


@contextmanager
def exempt(descriptor: int) -> Generator[None]:
    """Do not hold a socket of the running loop back within the context: its service has a budget."""
    meter = loop_meter()
    meter.exempt(descriptor)
    try:
        yield
    finally:
        meter.forget(descriptor)


@contextmanager
def preferred(descriptor: int) -> Generator[None]:
    """Take the events of a socket of the running loop first within the context."""
    meter = loop_meter()
    meter.prefer(descriptor)
    try:
        yield
    finally:
        meter.forget(descriptor)
