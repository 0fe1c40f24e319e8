"""What the wireless servers share on sockets: a throttle, connecting, bounded waits, reserved ports."""

import asyncio
import errno
import logging
import os
import select
import socket
import time
from collections.abc import Callable
from types import TracebackType

from usarmjx.base.errors import PeerError, UsageError
from usarmjx.server.network.gate import LINE_ENDS, Gate, Handler, guarded, keep_alive
from usarmjx.server.network.ports import FIRST_DIALLED, bound_socket, may_dial

log = logging.getLogger("usarmjx.server.wireless")
"""One logger for all of it: USARComServer.ini's bDebug turns it on."""

READ_SIZE = 256
"""Most bytes taken at once from a control connection, whose every message costs some work."""
DATA_READ_SIZE = 16 * 1024
"""Likewise from a data connection, where a byte costs little."""
MAX_TIME_SHARE = 0.25
"""All wireless connections together may use so much of the time; the rest is the world's."""
BURST = 5e-3
"""They may be so far ahead of their share [s]."""
MAX_WRITE_BUFFER = 256 * 1024
"""While this much waits for a peer to read it, nothing more is read for it [bytes]."""
STALL = 30.0
"""A peer that reads nothing for so long although something waits for it is dropped [s]."""
CONNECT_TIMEOUT = 5.0
"""How long a peer may take to accept a connection [s]."""
CONNECT_PENDING = (errno.EINPROGRESS, errno.EWOULDBLOCK)
"""What a connect that does not wait returns."""
HUNG_UP: int = getattr(select, "POLLRDHUP", 0)
"""What `poll` reports of a peer that has hung up; 0 where systems cannot tell."""
LINGER = 5.0
"""How long what was written before a connection ends may take to leave [s]."""


class Throttle:
    """Lets connections do their work one at a time, in the order of their coming, within their share.

    `async with throttle:` around work without waiting. Nobody can keep the world from stepping, and nobody
    comes twice before another has come once.
    """

    def __init__(self) -> None:
        self._lock = asyncio.Lock()
        self._stepped = asyncio.Event()
        self._owed = 0.0
        self._began = self._last = time.perf_counter()

    def refill(self) -> None:
        """Count the time that has passed: the world has made a control step."""
        now = time.perf_counter()
        self._owed = max(0.0, self._owed - MAX_TIME_SHARE * (now - self._last))
        self._last = now
        self._stepped.set()
        self._stepped.clear()

    async def __aenter__(self) -> None:
        """Wait for the turn."""
        await self._lock.acquire()
        try:
            while self._owed > BURST:
                await self._stepped.wait()
        except BaseException:
            self._lock.release()
            raise
        self._began = time.perf_counter()

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Count what it took."""
        self._owed += time.perf_counter() - self._began
        self._lock.release()


async def listen(
    where: tuple[str, int],
    handler: Handler,
    gate: Gate,
    bound: socket.socket | None = None,
    ends: bytes = LINE_ENDS,
) -> tuple[asyncio.Server, int]:
    """Return a listening server and its port.

    Args:
        where: Address and port to listen on; 0 picks a free one.
        handler: Is called with every connection that is let in.
        gate: Lets them in.
        bound: A socket that is bound to them already.
        ends: What ends the line with the token: any of these bytes.

    Raises:
        UsageError: The port is taken or the address is not ours.
    """
    host, port = where
    bound = bound or bound_socket(host, port)
    port = bound.getsockname()[1]
    try:
        server = await asyncio.start_server(guarded(gate, handler, ends), sock=bound)
    except OSError as error:
        bound.close()
        raise UsageError(f"cannot listen on {host}:{port}: {error}") from error
    return server, port


class ReservedPort:
    """A port that stays ours; connections are accepted only while it is open.

    Args:
        host: Address to listen on.
        handler: Is called with every connection that is let in.
        gate: Lets them in; it asks for no token here.

    Raises:
        UsageError: There is no port left.
    """

    def __init__(self, host: str, handler: Handler, gate: Gate) -> None:
        self._host, self._handler = host, guarded(gate, handler, ends=None)
        self._bound: socket.socket | None = bound_socket(host, 0)
        self._server: asyncio.Server | None = None
        self.port: int = self._bound.getsockname()[1]

    async def open(self) -> None:
        """Accept connections.

        Raises:
            UsageError: Somebody else got hold of the port.
        """
        if self._server is None:
            bound, self._bound = self._bound or bound_socket(self._host, self.port), None
            try:
                self._server = await asyncio.start_server(self._handler, sock=bound)
            except OSError as error:
                bound.close()
                raise UsageError(f"cannot listen on {self._host}:{self.port}: {error}") from error

    def close(self) -> None:
        """Refuse connections, and keep the port."""
        if self._server is not None:
            self._server.close()
            self._server = None
            try:
                self._bound = bound_socket(self._host, self.port)
            except UsageError as error:  # `open` tries again
                log.warning("%s", error)

    def release(self) -> None:
        """Give the port back."""
        if self._server is not None:
            self._server.close()
        if self._bound is not None:
            self._bound.close()
        self._server = self._bound = None


async def connect(
    address: str, port: int, note: Callable[[int], None] = lambda port: None
) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    """Connect to a peer.

    Args:
        address: Its IP address.
        port: Its port.
        note: Called with our port as soon as the connection is under way, before anything is read.

    Raises:
        OSError: It does not answer, or may not be dialled; TimeoutError, which is one, if not in time.
    """
    if not may_dial(address, port):
        raise PermissionError(f"{address}:{port} is not dialled: it is ours or below {FIRST_DIALLED}")
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    client = socket.socket(family, socket.SOCK_STREAM)
    try:
        client.setblocking(False)
        keep_alive(client)
        state = client.connect_ex((address, port))
        if state not in (0, *CONNECT_PENDING):
            raise OSError(state, os.strerror(state))
        note(client.getsockname()[1])
        if state:
            async with asyncio.timeout(CONNECT_TIMEOUT):
                await asyncio.get_running_loop().sock_connect(client, (address, port))
        if client.getsockname() == client.getpeername():
            raise ConnectionRefusedError("nobody listens there: the call was answered by itself")
        return await asyncio.open_connection(sock=client)
    except BaseException:
        client.close()
        raise


async def drain(writer: asyncio.StreamWriter) -> None:
    """Wait until a peer has read most of what waits for it.

    Raises:
        PeerError: It reads nothing for too long; the connection is broken off.
        OSError: It is gone.
    """
    while (waiting := writer.transport.get_write_buffer_size()) > MAX_WRITE_BUFFER:
        try:
            async with asyncio.timeout(STALL):
                await writer.drain()
        except TimeoutError as error:
            if writer.transport.get_write_buffer_size() >= waiting:
                writer.transport.abort()
                raise PeerError(f"the peer does not read: {waiting} bytes wait for it") from error


def close_gracefully(writer: asyncio.StreamWriter) -> None:
    """Close a connection once what was written has left, or soon in any case."""
    writer.close()
    if writer.transport.get_write_buffer_size():
        asyncio.get_running_loop().call_later(LINGER, writer.transport.abort)


def limit_kernel_buffer(writer: asyncio.StreamWriter) -> None:
    """Keep the system from holding megabytes of answers for a peer that does not read them."""
    writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, MAX_WRITE_BUFFER // 4)


def limit_receive_buffer(writer: asyncio.StreamWriter, size: int) -> None:
    """Keep the system from taking more than so many bytes of a peer that nobody has read yet."""
    writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, size)


def has_hung_up(connection: socket.socket) -> bool:
    """Return whether a peer has closed a connection, also while there is more to be read; False if unknown.

    Args:
        connection: The open connection.
    """
    if not HUNG_UP:
        return False
    poll = select.poll()
    poll.register(connection, HUNG_UP)
    return bool(poll.poll(0))
