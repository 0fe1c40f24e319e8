"""Clients of a server on this machine: one loop reads them all and notes when what came."""

import contextlib
import selectors
import socket
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import Protocol, TypeVar

from usarmjx.base.errors import UsageError
from usarmjx.server.protocol.grammar import Message, parse_message

HOST = "127.0.0.1"
CONNECT_LIMIT = 60.0
"""How long a connection may take [s]: the system accepts it for a server that is busy."""
READ_SIZE = 1 << 18
"""Most bytes taken from a socket at once."""
PATIENCE = 0.02
"""How often a condition is looked at while nothing comes [s]."""
FRAME_HEAD = struct.Struct(">BI")
"""Of a picture: its type and the bytes that follow."""
RAW_HEAD = 4
"""Bytes in front of a raw picture's colours: width and height."""


class Connection(Protocol):
    """What a `Crowd` reads."""

    socket: socket.socket

    def take(self, data: bytes, now: float) -> None:
        """Note bytes that came at a time [s]."""
        ...

    def flush(self) -> None:
        """Send what waits to be sent, as far as the system takes it."""
        ...


AnyClient = TypeVar("AnyClient", bound=Connection)


def connect(port: int, host: str = HOST) -> socket.socket:
    """Return a connection to a port, of this machine by default, that never blocks."""
    made = socket.create_connection((host, port), CONNECT_LIMIT)
    made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    made.setblocking(False)
    return made


class RobotClient:
    """A client of the Gamebots port.

    Args:
        port: The port.
        host: Whose it is.

    Attributes:
        socket: Its connection.
        began: When it connected, by the performance counter [s].
        reports: When each STA came by the performance counter, and its own time [s, simulated s].
        unsent: What the system has not taken yet.
        answer: The line that `expect` asked for, and when it came.
    """

    def __init__(self, port: int, host: str = HOST) -> None:
        self.began = time.perf_counter()
        self.socket = connect(port, host)
        self.reports: list[tuple[float, float]] = []
        self.unsent = b""
        self.answer: tuple[Message, float] | None = None
        self._wanted: Callable[[Message], bool] | None = None
        self._rest = b""

    def say(self, *lines: str) -> None:
        """Send lines."""
        self.unsent += "".join(f"{line}\r\n" for line in lines).encode("latin-1")
        self.flush()

    def flush(self) -> None:
        """Send what waits to be sent, as far as the system takes it."""
        if self.unsent:
            with contextlib.suppress(BlockingIOError):
                self.unsent = self.unsent[self.socket.send(self.unsent) :]

    def expect(self, wanted: Callable[[Message], bool]) -> None:
        """Keep the next message that is wanted as the answer."""
        self._wanted, self.answer = wanted, None

    def take(self, data: bytes, now: float) -> None:
        """Note lines that came at a time [s]."""
        *lines, self._rest = (self._rest + data).split(b"\r\n")
        for line in lines:
            status = line.startswith(b"STA ")
            if not status and self._wanted is None:
                continue
            message = parse_message(line.decode("latin-1"))
            if status:
                self.reports.append((now, float(message.get("Time"))))
            if self._wanted is not None and self._wanted(message):
                self._wanted, self.answer = None, (message, now)


class PictureClient:
    """A client of the image server that asks for the next picture as soon as it has one.

    Args:
        port: The port.

    Attributes:
        socket: Its connection.
        frames: When each picture came by the performance counter [s], and whether it shows anything.
    """

    def __init__(self, port: int) -> None:
        self.socket = connect(port)
        self.frames: list[tuple[float, bool]] = []
        self._rest = b""

    def flush(self) -> None:
        """Send nothing: the few bytes of an OK never have to wait."""

    def take(self, data: bytes, now: float) -> None:
        """Note pictures that came at a time [s]; they must be raw."""
        self._rest += data
        while len(self._rest) >= FRAME_HEAD.size:
            _, size = FRAME_HEAD.unpack_from(self._rest)
            end = FRAME_HEAD.size + size
            if len(self._rest) < end:
                return
            self.frames.append((now, bool(self._rest[FRAME_HEAD.size + RAW_HEAD : end].strip(b"\0"))))
            self._rest = self._rest[end:]
            self.socket.send(b"OK")


class Crowd(AbstractContextManager["Crowd"]):
    """Clients of one server; they leave with the context.

    Args:
        port: Its Gamebots port.
        on_close: Is told whose connection the server has closed; None: that is an error.
    """

    def __init__(self, port: int, on_close: Callable[[Connection], None] | None = None) -> None:
        self._port, self._selector, self._on_close = port, selectors.DefaultSelector(), on_close

    def robot(self) -> RobotClient:
        """Return a new client of the Gamebots port."""
        return self.add(RobotClient(self._port))

    def pictures(self, port: int) -> PictureClient:
        """Return a new client of an image server."""
        return self.add(PictureClient(port))

    def add(self, client: AnyClient) -> AnyClient:
        """Read a client, too; return it."""
        self._selector.register(client.socket, selectors.EVENT_READ, client)
        return client

    def leave(self, client: Connection) -> None:
        """Close a client's connection."""
        self._selector.unregister(client.socket)
        client.socket.close()

    def pump(self, seconds: float) -> None:
        """Read whatever comes in that time [s].

        Raises:
            ConnectionError: The server has closed a connection.
        """
        for _ in self._rounds(seconds):
            pass

    def wait(self, done: Callable[[], bool], limit: float) -> bool:
        """Read until something is done; return whether that was so within a time [s].

        Raises:
            ConnectionError: The server has closed a connection.
        """
        return done() or any(done() for _ in self._rounds(limit))

    def report_after(self, client: RobotClient, moment: float, limit: float) -> tuple[float, float]:
        """Wait for a client's first report after a moment [s]; return when it came, and its own time.

        Raises:
            UsageError: None came within the limit [s].
            ConnectionError: The server has closed a connection.
        """
        if not self.wait(lambda: bool(client.reports) and client.reports[-1][0] > moment, limit):
            raise UsageError(f"no report within {limit:g} s")
        return next(report for report in client.reports if report[0] > moment)

    def __exit__(self, *_: object) -> None:
        """Close all connections."""
        for key in list(self._selector.get_map().values()):
            self.leave(key.data)
        self._selector.close()

    def _rounds(self, seconds: float) -> Iterator[None]:
        """Read what comes again and again for so long [s]."""
        end = time.perf_counter() + seconds
        while (left := end - time.perf_counter()) > 0:
            for key in list(self._selector.get_map().values()):
                try:
                    key.data.flush()
                except ConnectionError:
                    self._lose(key.data)
            for key, _ in self._selector.select(min(left, PATIENCE)):
                data = _received(key.data.socket)
                if data:
                    key.data.take(data, time.perf_counter())
                else:
                    self._lose(key.data)
            yield

    def _lose(self, client: Connection) -> None:
        if self._on_close is None:
            raise ConnectionError("the server has closed a connection")
        self.leave(client)
        self._on_close(client)


def _received(connection: socket.socket) -> bytes:
    """Return what has come; nothing if the connection is closed or broken off."""
    try:
        return connection.recv(READ_SIZE)
    except ConnectionError:
        return b""
