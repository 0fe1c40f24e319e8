"""Sockets of the wireless servers: a throttle, connecting, bounded waits, reserved ports."""

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
from usarmjx.server.runtime.logs import limit_libraries

log = logging.getLogger("usarmjx.server.wireless")
"""Logger of all wireless modules: USARComServer.ini's bDebug enables it."""

READ_SIZE = 256
"""Most bytes read at once from a control connection, whose every message costs some work."""
DATA_READ_SIZE = 16 * 1024
"""Most bytes read at once from a data connection, where a byte costs little."""
MAX_TIME_SHARE = 0.25
"""Share of the time of all wireless connections together; the rest is the world's."""
BURST = 5e-3
"""Largest lead of the connections over their share [s]."""
MAX_WRITE_BUFFER = 256 * 1024
"""Unread bytes of a peer from which no more is read for it [bytes]."""
STALL = 30.0
"""Time after which a peer that does not read is dropped [s]."""
CONNECT_TIMEOUT = 5.0
"""Time that a peer has to accept a connection [s]."""
CONNECT_PENDING = (errno.EINPROGRESS, errno.EWOULDBLOCK)
"""Results of a non-blocking connect that is under way."""
HUNG_UP: int = getattr(select, "POLLRDHUP", 0)
"""Event of `poll` for a peer that has hung up; 0 on systems without one."""
LINGER = 5.0
"""Time that written bytes have to leave before a connection ends [s]."""


class Throttle:
    """Lets connections work one at a time, in the order of arrival, within their share.

    Use `async with throttle:` around work without waiting. No peer can keep the world from stepping, and no
    peer has two turns before a waiting one has its first.
    """

    def __init__(self) -> None:
        self._lock = asyncio.Lock()
        self._stepped = asyncio.Event()
        self._owed = 0.0
        self._began = self._last = time.perf_counter()

    def refill(self) -> None:
        """Credit the time since the last call; call it after a control step."""
        now = time.perf_counter()
        # Idle time is not saved up beyond zero: `BURST` alone bounds a lead.
        self._owed = max(0.0, self._owed - MAX_TIME_SHARE * (now - self._last))
        self._last = now
        # Set and cleared at once: wakes those that wait now, and later ones wait for the next step.
        self._stepped.set()
        self._stepped.clear()

    async def __aenter__(self) -> None:
        """Wait for the turn."""
        # asyncio's lock wakes its waiters in the order of their arrival.
        await self._lock.acquire()
        try:
            while self._owed > BURST:
                await self._stepped.wait()
        # A cancelled waiter holds the lock already; kept, nobody would ever have a turn again.
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
        """Charge the time of the turn."""
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
        handler: Handles every connection that is admitted.
        gate: Admits connections.
        bound: A socket that is bound to them already.
        ends: Bytes of which each ends the line with the token.

    Raises:
        UsageError: The port is taken or the address is not ours.
    """
    # asyncio logs a traceback for each connection that it cannot accept for want of descriptors.
    limit_libraries()
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
    """A port that stays reserved; connections are accepted only while it is open.

    Args:
        host: Address to listen on.
        handler: Handles every connection that is admitted.
        gate: Admits connections; it requires no token here.

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
            UsageError: Another process has the port.
        """
        if self._server is None:
            # The socket passes to the server, which closes it; `close` binds the port anew.
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
                # Bound, but not listening: calls are refused, and no other process can take the port.
                self._bound = bound_socket(self._host, self.port)
            except UsageError as error:  # `open` tries again
                log.warning("%s", error)

    def release(self) -> None:
        """Release the port."""
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
    # Addresses come from `normalize_address`: only those of IPv6 have a colon.
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    client = socket.socket(family, socket.SOCK_STREAM)
    try:
        client.setblocking(False)
        keep_alive(client)
        # Not open_connection: it connects before anybody learns the local port.
        state = client.connect_ex((address, port))
        if state not in (0, *CONNECT_PENDING):
            raise OSError(state, os.strerror(state))
        # The peer may ask for this port (REVERSEDNS) before the connection is established on our side.
        note(client.getsockname()[1])
        if state:
            async with asyncio.timeout(CONNECT_TIMEOUT):
                await asyncio.get_running_loop().sock_connect(client, (address, port))
        # On one machine TCP may connect a port to itself (simultaneous open) when the client's port happens
        # to be the one dialled.
        if client.getsockname() == client.getpeername():
            raise ConnectionRefusedError("nobody listens there: the call was answered by itself")
        return await asyncio.open_connection(sock=client)
    except BaseException:
        client.close()
        raise


async def drain(writer: asyncio.StreamWriter) -> None:
    """Wait until a peer has read most of its waiting bytes.

    Raises:
        PeerError: It reads nothing for too long; the connection is aborted.
        OSError: It is gone.
    """
    while (waiting := writer.transport.get_write_buffer_size()) > MAX_WRITE_BUFFER:
        try:
            async with asyncio.timeout(STALL):
                await writer.drain()
        except TimeoutError as error:
            # Less than before: it reads, only slowly, and has another period.
            if writer.transport.get_write_buffer_size() >= waiting:
                writer.transport.abort()
                raise PeerError(f"the peer does not read: {waiting} bytes wait for it") from error


def close_gracefully(writer: asyncio.StreamWriter) -> None:
    """Close a connection once its written bytes have left, or soon in any case."""
    writer.close()
    if writer.transport.get_write_buffer_size():
        # Not awaited: tasks close their connection while they are cancelled themselves.
        asyncio.get_running_loop().call_later(LINGER, writer.transport.abort)


def limit_kernel_buffer(writer: asyncio.StreamWriter) -> None:
    """Limit the system's send buffer: it would hold megabytes of answers for a peer that does not read."""
    writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, MAX_WRITE_BUFFER // 4)


def limit_receive_buffer(writer: asyncio.StreamWriter, size: int) -> None:
    """Limit the bytes that the system receives ahead of reading."""
    writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, size)


def has_hung_up(connection: socket.socket) -> bool:
    """Return whether a peer has closed a connection, also while there is more to be read; False if unknown.

    Args:
        connection: The open connection.
    """
    if not HUNG_UP:
        return False
    # Not by reading: unread bytes hide the end of the stream, and belong to the handler.
    poll = select.poll()
    poll.register(connection, HUNG_UP)
    return bool(poll.poll(0))
