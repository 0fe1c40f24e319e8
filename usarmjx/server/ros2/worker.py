"""The thread in which a transport works, so that the server's loop never waits for a network.

Messages wait in a bounded queue of their endpoint, where new ones push out old ones; what is dropped is
counted.
"""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from usarmjx.server.ros2.transport import Closable, Publisher, Qos, Reply, TakeMessage, TakeRequest, Transport
from usarmjx.server.rosbridge.definitions import RosMessage, RosVersion
from usarmjx.server.rosbridge.encodings import MessageBytes

log = logging.getLogger(__name__)

LOOK = 0.1
"""Interval at which the thread looks who reads [s]."""
MOST_JOBS = 10_000
"""Most jobs that wait."""


@dataclass
class TransportCounts:
    """Counters of a transport since its start.

    Attributes:
        sent: Messages sent.
        sent_bytes: Their bytes.
        received: Messages and requests received.
        dropped: Messages that waited too long, here or in the transport.
    """

    sent: int = 0
    sent_bytes: int = 0
    received: int = 0
    dropped: int = 0


@dataclass(eq=False)
class Outlet:
    """A publisher of the worker, as the loop sees it.

    Attributes:
        topic: Name of the topic.
        kind: Short type of its messages.
        qos: Its quality.
        wanted: Whether anybody reads it; latched topics are always wanted.
        waiting: Messages that are not sent yet.
        publisher: The publisher, once there is one.
    """

    topic: str
    kind: str
    qos: Qos
    wanted: bool = False
    waiting: deque[RosMessage] = field(default_factory=deque[RosMessage])
    publisher: Publisher | None = None


class TransportWorker:
    """Runs a transport in a thread.

    All methods may be called in the server's loop; the callbacks of subscriptions and services come in other
    threads.

    Args:
        open_transport: Opens the transport; is called in the thread.

    Attributes:
        counts: Its counters.
    """

    def __init__(self, open_transport: Callable[[], Transport]) -> None:
        self._open = open_transport
        self.counts = TransportCounts()
        self._outlets: set[Outlet] = set()
        # Appends and pops of a deque are atomic in CPython: the loop and the thread share them without
        # a lock.
        self._jobs: deque[Callable[[Transport], None]] = deque()
        self._ready: deque[Outlet] = deque()
        self._wake, self._opened = threading.Event(), threading.Event()
        self._error: Exception | None = None
        self._stopping = self._changed = False
        self._bytes = MessageBytes(RosVersion.ROS2)
        self._thread = threading.Thread(target=self._run, name="ROS 2", daemon=True)

    def start(self) -> None:
        """Open the transport; return once it is open.

        Raises:
            UsageError: It cannot be opened.
        """
        self._thread.start()
        self._opened.wait()
        if self._error is not None:
            raise self._error

    def stop(self) -> None:
        """Close the transport."""
        self._stopping = True
        self._wake.set()
        if self._thread.is_alive():
            # Bounded: a middleware that hangs must not keep the server from ending.
            self._thread.join(10.0)

    def advertise(self, topic: str, kind: str, qos: Qos) -> Outlet:
        """Return the outlet of a new topic."""
        # Latched topics are always wanted: their last message is kept for readers that come later.
        outlet = Outlet(topic, kind, qos, wanted=qos.is_latched)

        def make(transport: Transport) -> None:
            outlet.publisher = transport.publisher(topic, kind, qos)
            self._outlets.add(outlet)

        self._do(make, changes=True)
        return outlet

    def withdraw(self, outlet: Outlet) -> None:
        """Close an outlet."""

        def close(transport: Transport) -> None:
            del transport
            self._outlets.discard(outlet)
            if outlet.publisher is not None:
                outlet.publisher.close()
                outlet.publisher = None

        # At once, not in the thread: the loop must make no more messages for it.
        outlet.wanted = False
        self._do(close, changes=True)

    def send(self, outlet: Outlet, message: RosMessage) -> None:
        """Send a message; the oldest that waits goes if there are more than the quality keeps."""
        # The thread may take the message in between: `_next` tells, and nothing is counted twice.
        if len(outlet.waiting) >= outlet.qos.depth and _next(outlet.waiting) is not None:
            self.counts.dropped += 1
        outlet.waiting.append(message)
        # One entry for each message: an outlet with several takes turns with the others.
        self._ready.append(outlet)
        self._wake.set()

    def subscribe(self, topic: str, kind: str, qos: Qos, take: TakeMessage) -> Closable:
        """Subscribe to a topic."""
        return self._closable(lambda transport: transport.subscription(topic, kind, qos, take))

    def serve(self, name: str, kind: str, take: TakeRequest) -> Closable:
        """Offer a service."""
        return self._closable(lambda transport: transport.service(name, kind, take))

    def reply(self, send: Reply, kind: str, message: RosMessage) -> None:
        """Send the reply to a request, of a type by its short name."""
        self._do(lambda _: send(self._bytes.whole(kind, message)))

    def _closable(self, make: Callable[[Transport], Closable]) -> Closable:
        # Both jobs run in the worker's thread in this order: nothing is closed before it is made.
        handle = _Handle(lambda handle: self._do(lambda _: handle.close_found(), changes=True))
        self._do(lambda transport: handle.take(make(transport)), changes=True)
        return handle

    def _do(self, job: Callable[[Transport], None], *, changes: bool = False) -> None:
        if len(self._jobs) >= MOST_JOBS:
            self.counts.dropped += 1
            return

        def done(transport: Transport) -> None:
            job(transport)
            self._changed |= changes

        self._jobs.append(done)
        self._wake.set()

    def _run(self) -> None:
        try:
            transport = self._open()
        except Exception as error:
            self._error = error
            return
        finally:
            # Also after an error, which `start` raises in the loop.
            self._opened.set()
        look = 0.0
        while not self._stopping:
            self._wake.wait(LOOK)
            # Cleared before the work: what comes during it sets the event again.
            self._wake.clear()
            self._work(transport)
            if time.monotonic() >= look:
                look = time.monotonic() + LOOK
                for outlet in self._outlets:
                    assert outlet.publisher is not None
                    outlet.wanted = outlet.qos.is_latched or outlet.publisher.has_readers()
        try:
            transport.close()
        except Exception as error:  # the library's own: the process ends or goes on without it
            log.warning("ROS 2: %s", error)

    def _work(self, transport: Transport) -> None:
        # Jobs first: a publisher is made before its first message is sent.
        while self._jobs or self._ready:
            try:
                if self._jobs:
                    self._jobs.popleft()(transport)
                else:
                    self._send(self._ready.popleft())
            except Exception as error:  # the library's own: the other topics go on
                self.counts.dropped += 1
                log.warning("ROS 2: %s", error)
        if self._changed:
            self._changed = False
            # Once for many changes: a new robot brings a dozen topics.
            transport.announce()

    def _send(self, outlet: Outlet) -> None:
        message = None if outlet.publisher is None else _next(outlet.waiting)
        if outlet.publisher is None or message is None:
            return
        data = self._bytes.whole(outlet.kind, message)
        if outlet.publisher.write(data):
            self.counts.sent += 1
            self.counts.sent_bytes += len(data)
        else:
            self.counts.dropped += 1


def _next(waiting: deque[RosMessage]) -> RosMessage | None:
    """Take the oldest message; None if the other thread has just taken the last one."""
    try:
        return waiting.popleft()
    except IndexError:
        return None


class _Handle:
    """A subscription or service that the worker makes later, and closes later still."""

    def __init__(self, close: "Callable[[_Handle], None]") -> None:
        self._close, self._found, self._closed = close, None, False

    def take(self, found: Closable) -> None:
        self._found = found

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            self._close(self)

    def close_found(self) -> None:
        if self._found is not None:
            self._found.close()
            self._found = None
