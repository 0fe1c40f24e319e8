"""Dialect B of the wireless server on real sockets: ports that open and close with the signal."""

import asyncio
import time
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial

from usarmjx.base.errors import PeerError, UsageError
from usarmjx.server.network.gate import Gate, peer_address
from usarmjx.server.network.ports import may_dial
from usarmjx.server.runtime.logs import FaultLog
from usarmjx.server.wireless.comserver import normalize_address
from usarmjx.server.wireless.dialect_b import DialectBSession
from usarmjx.server.wireless.radio_channel import RadioChannel
from usarmjx.server.wireless.sockets import (
    DATA_READ_SIZE,
    ReservedPort,
    Throttle,
    close_gracefully,
    connect,
    drain,
    log,
)
from usarmjx.server.wireless.switchboard import Changes, Route, Switchboard


@dataclass(eq=False)
class ProxyConnection:
    """A connection through the server: the caller's end, and the callee's once it answers."""

    near: asyncio.StreamWriter
    far: asyncio.StreamWriter | None = None

    @property
    def ends(self) -> list[asyncio.StreamWriter]:
        """The present ends of the connection, one or two."""
        return [writer for writer in (self.near, self.far) if writer is not None]

    def cut(self) -> None:
        """Close both ends."""
        for writer in self.ends:
            if not writer.is_closing():
                close_gracefully(writer)


class ProxyServer:
    """Keeps the forwarded ports and the proxied connections of dialect B.

    Args:
        radio: The radio.
        host: Address to listen on.
        throttle: Queue of all work.
        gate: Admits calls to the forwarded ports.
    """

    def __init__(self, radio: RadioChannel, host: str, throttle: Throttle, gate: Gate) -> None:
        self._host, self._throttle, self._gate = host, throttle, gate
        self._board = Switchboard(radio, self._allocate, time.monotonic, may_dial)
        self._fault_log = FaultLog(log)
        self._ports: dict[Route, ReservedPort] = {}
        self._connections: dict[Route, set[ProxyConnection]] = {}
        self._handlers: set[DialectBHandler] = set()

    def make_handler(self, address: str) -> "DialectBHandler":
        """Return the handler of a new control connection."""
        handler = DialectBHandler(self, DialectBSession(self._board, normalize_address(address)))
        self._handlers.add(handler)
        return handler

    def pairs(self) -> list[tuple[str, str]]:
        """Return the names at both ends of every route."""
        return [(route.caller, route.callee) for route in self._ports]

    async def handle(self, handler: "DialectBHandler", session: DialectBSession, data: bytes) -> bytes:
        """Take bytes of a control connection and return the answers; nothing if it is over."""
        async with self._throttle:
            if handler not in self._handlers:
                return b""
            answers = session.receive_data(data)
            opened = self._board.take_opened()
        await self._open(opened)  # before the answer: the client dials the port at once
        return answers

    def poll(self) -> Changes:
        """Return the changes of the world since the last poll."""
        return self._board.poll()

    async def apply_changes(self, changes: Changes) -> None:
        """Open and close ports and connections after changes of the world."""
        for handler in [handler for handler in self._handlers if handler.name in changes.gone]:
            log.info("%s is not in the world, or has no battery: it no longer takes part", handler.name)
            handler.closing = True
            self.leave(handler)
        for route in changes.closed:
            self._close(route)
        await self._open(changes.opened)

    def leave(self, handler: "DialectBHandler") -> None:
        """Forget a control connection with its robot's ports and connections."""
        if handler not in self._handlers:
            return
        self._handlers.remove(handler)
        gone, closed = self._board.leave(handler.name)
        for route in (*gone, *closed):
            self._close(route)
        for route in gone:
            self._ports.pop(route).release()

    def stop(self) -> None:
        """Close all connections."""
        for port in self._ports.values():
            port.release()
        for connection in (one for some in self._connections.values() for one in some):
            for writer in connection.ends:
                writer.transport.abort()

    def _allocate(self, route: Route) -> int | None:
        try:
            self._ports[route] = ReservedPort(self._host, partial(self._called, route), self._gate)
        except UsageError as error:
            self._fault_log.warning("%s", error)
            return None
        return self._ports[route].port

    async def _open(self, routes: Iterable[Route]) -> None:
        for route in routes:
            port = self._ports.get(route)
            if port is None:
                continue
            try:
                await port.open()
            except UsageError as error:
                self._fault_log.warning("%s", error)
                self._board.failed(route)
            # During the wait the caller may have left, or the signal be lost.
            if self._ports.get(route) is not port:
                port.release()
            elif not self._board.is_open(route):
                port.close()

    def _close(self, route: Route) -> None:
        if route in self._ports:
            self._ports[route].close()
        for connection in self._connections.get(route, ()):
            connection.cut()

    async def _called(self, route: Route, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        address, _ = peer_address(writer)
        if not address or not self._board.may_call(route, normalize_address(address)):
            writer.close()
            return
        connection, ports = ProxyConnection(writer), list[int]()
        self._connections.setdefault(route, set()).add(connection)

        def note(port: int) -> None:
            ports.append(port)
            self._board.add_connection(route, port)

        try:
            there, far = await connect(self._board.address_of(route.callee), route.port, note)
            connection.far = far
            if not writer.is_closing():  # it may have been cut while the far end was connecting
                log.info("%s calls %s", route.caller, route.callee)
                pumps = self._pump(reader, connection, far), self._pump(there, connection, writer)
                await asyncio.gather(*pumps)
        except OSError as error:
            log.info("%s does not answer %s: %s", route.callee, route.caller, error)
        except asyncio.CancelledError:
            log.info("%s and %s: the server stops", route.caller, route.callee)
        finally:
            connection.cut()
            self._board.remove_connections(*ports)
            self._connections[route].discard(connection)
            if not self._connections[route]:
                del self._connections[route]

    async def _pump(
        self, reader: asyncio.StreamReader, connection: ProxyConnection, writer: asyncio.StreamWriter
    ) -> None:
        try:
            while data := await reader.read(DATA_READ_SIZE):
                async with self._throttle:
                    if writer.is_closing():
                        break
                    writer.write(data)
                await drain(writer)
        except (OSError, PeerError) as error:
            log.info("a proxied connection ends: %s", error)
        finally:
            connection.cut()


class DialectBHandler:
    """Handler of one control connection of dialect B.

    Args:
        server: The ports and connections.
        session: The dialogue.

    Attributes:
        closing: Whether the robot is no participant any more, which ends the connection.
    """

    def __init__(self, server: ProxyServer, session: DialectBSession) -> None:
        self._server, self._session = server, session
        self.closing = False

    @property
    def name(self) -> str:
        """Name of the robot that it has joined as, "" before."""
        return self._session.name

    @property
    def alive(self) -> bool:
        """Whether it has joined: then it may be silent, as it ends with its robot."""
        return bool(self.name) and not self.closing

    async def handle(self, data: bytes) -> bytes:
        """Take bytes and return the answers."""
        return await self._server.handle(self, self._session, data)

    def connection_lost(self) -> None:
        """Release the ports and connections of its robot."""
        self._server.leave(self)
