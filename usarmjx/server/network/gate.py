"""Gate of a port: a connection is refused, asked for the token, or passed to the handler."""

import asyncio
import logging
import socket
import time
from collections import Counter
from collections.abc import Awaitable, Callable
from typing import TypeAlias

from usarmjx.base.errors import PeerError
from usarmjx.server.network.access import AUTH, AccessRules, IPAddress, parse_address, token_of
from usarmjx.server.network.loop_meter import exempt
from usarmjx.server.runtime.logs import LineLimit

log = logging.getLogger(__name__)

Handler: TypeAlias = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]

LINE_ENDS = b"\r\n"
"""Bytes of which each ends a line."""
AUTH_TIMEOUT = 10.0
"""Time that a new connection has to send the token [s]."""
MAX_AUTH_SIZE = 192
"""Longest line with a token [bytes]."""
MAX_STRANGERS = 64
"""Most connections to one kind of port without a token or handshake yet; for one more the oldest closes."""
LOG_INTERVAL = 10.0
"""Interval between two log lines about refusals, each with the number of those in between [s]."""
KEEPALIVE_IDLE, KEEPALIVE_INTERVAL, KEEPALIVE_COUNT = 60, 10, 6
"""Silence before a probe [s], interval of probes [s], and unanswered probes after which a peer is gone."""


class Gate:
    """Admits connections to one kind of port, and counts them.

    Args:
        rules: Rules of access.
        room: Most connections there at once.
        name: Name of the port in the log.
        now: Returns the time [s].
    """

    def __init__(
        self, rules: AccessRules, room: int, name: str, now: Callable[[], float] = time.monotonic
    ) -> None:
        self.rules, self._room = rules, room
        # A quarter of the connections stays for other addresses.
        self._limit = -(-3 * room // 4) if rules.per_address is None else rules.per_address
        self._name, self._lines = name, LineLimit(1, LOG_INTERVAL, now)
        self._counts: Counter[IPAddress] = Counter()
        self._strangers: list[asyncio.WriteTransport] = []

    def enter(self, address: str) -> bool:
        """Return whether a connection from an address is admitted; call `leave` when it has ended."""
        try:
            found = parse_address(address)
        except ValueError:  # it has gone already
            # A peer without an address cannot be counted out later.
            return False
        if not self.rules.allows(found):
            self.refuse(address, "it is not in --allow")
            return False
        if self._counts[found] >= self._limit and not found.is_loopback:
            self.refuse(address, f"{self._limit} connections of that address are open")
            return False
        self._counts[found] += 1
        return True

    @property
    def is_full(self) -> bool:
        """Whether more are admitted than fit; a service with a limit of its own does not ask."""
        return self._counts.total() > self._room

    def leave(self, address: str) -> None:
        """Count out a connection that was admitted."""
        found = parse_address(address)
        self._counts[found] -= 1
        if not self._counts[found]:
            # Zero counts of every address that ever came would pile up.
            del self._counts[found]

    def refuse(self, peer: str, reason: str) -> None:
        """Log the refusal of a peer; count it only if another one was logged just before."""
        count = self._lines.take_left_out()
        if self._lines.admits():
            more = f" ({count} more since the last such line)" if count else ""
            log.warning("%s: %s is refused: %s%s", self._name, peer, reason, more)

    def add_stranger(self, transport: asyncio.WriteTransport) -> None:
        """Record a connection without a token or a handshake yet; the oldest of too many is closed.

        Peers that never send either must neither keep others from it nor take all file descriptors.
        """
        if len(self._strangers) >= MAX_STRANGERS:
            # Aborted, not closed: closing would wait for a peer that reads nothing.
            self._strangers.pop(0).abort()
        self._strangers.append(transport)

    def remove_stranger(self, transport: asyncio.WriteTransport) -> None:
        """Record that a connection has sent it, or has ended."""
        if transport in self._strangers:
            self._strangers.remove(transport)

    async def is_known(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, ends: bytes) -> bool:
        """Return whether a peer sends the token, if one is required; later bytes stay unread."""
        if not self.rules.token:
            return True
        self.add_stranger(writer.transport)
        try:
            async with asyncio.timeout(AUTH_TIMEOUT):
                line = await _read_line(reader, ends)
            if self.rules.knows(token_of(line)):
                return True
            reason = "a wrong token"
        except TimeoutError:
            reason = f"no token for {AUTH_TIMEOUT:g} s"
        except (OSError, PeerError) as error:
            reason = f"no token: {error}"
        finally:
            self.remove_stranger(writer.transport)
        self.refuse(peer_address(writer)[0], reason)
        return False


def guarded(gate: Gate, handler: Handler, ends: bytes | None = LINE_ENDS) -> Handler:
    """Return a handler of connections that passes only admitted ones on.

    Args:
        gate: Admits connections.
        handler: Handles admitted connections.
        ends: Bytes that end the line with the token; None: no token is required here.
    """

    async def accept(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        address, _ = peer_address(writer)
        if not gate.enter(address):
            writer.transport.abort()
            return
        try:
            connection = writer.get_extra_info("socket")
            keep_alive(connection)
            if ends is None or await gate.is_known(reader, writer, ends):
                # From the token on the client's own budget bounds its work, and the meter would count it
                # twice.
                with exempt(connection.fileno()):
                    await handler(reader, writer)
            else:
                writer.transport.abort()
        except asyncio.CancelledError:
            writer.transport.abort()  # the server stops, and nothing awaits this task
        finally:
            gate.leave(address)

    return accept


def keep_alive(connection: socket.socket) -> None:
    """Enable TCP keepalive, so that the system notices a peer that vanished."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in (
        ("TCP_KEEPIDLE", KEEPALIVE_IDLE),
        ("TCP_KEEPINTVL", KEEPALIVE_INTERVAL),
        ("TCP_KEEPCNT", KEEPALIVE_COUNT),
    ):
        if hasattr(socket, name):  # not on every system
            connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


def peer_address(writer: asyncio.StreamWriter) -> tuple[str, int]:
    """Return address and port of a peer; "" and 0 if it is gone already."""
    peer = writer.get_extra_info("peername")
    return (peer[0], peer[1]) if peer else ("", 0)


async def _read_line(reader: asyncio.StreamReader, ends: bytes) -> str:
    r"""Return the first line that is not blank, up to its end or to the first byte that rules AUTH out.

    Of the end "\r\n" the second byte may stay unread.

    Raises:
        PeerError: There is none, or it is too long.
    """
    line = bytearray()
    for _ in range(MAX_AUTH_SIZE):
        # Byte by byte: what follows the line belongs to the handler, and a StreamReader cannot take it back.
        byte = await reader.read(1)
        if not byte:
            raise PeerError("it has hung up")
        if byte not in ends:
            line += byte
        # Blank lines before the token are skipped: an end of line before may have left its second byte.
        elif line.strip():
            break
        if not AUTH.encode().startswith(line.lstrip()[: len(AUTH)].upper()):
            break  # another protocol's client may wait for an answer first: refuse it now, not at the timeout
    else:
        raise PeerError(f"its first line has more than {MAX_AUTH_SIZE} bytes")
    return line.decode("latin-1")
