"""The wireless servers of a served world on real sockets, in the loop of the Gamebots server.

`WirelessService` listens for dialect A, dialect B and the position service. `gamebots.server.BotServer`
starts it, calls `tick` after every control step, and stops it. Every second of simulated time it polls the
world: then robots that have left lose their links, and dialect B breaks and restores its own.
"""

import asyncio
import logging
import socket
import time
from collections.abc import Awaitable, Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated, Protocol

from usarmjx.base.errors import PeerError, UsageError
from usarmjx.base.settings import AT_LEAST_ONE, NOT_NEGATIVE, validate
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.server.network.access import EVERYBODY, AccessRules
from usarmjx.server.network.gate import LINE_ENDS, Gate, peer_address
from usarmjx.server.network.ports import PORT, POSITION_PORT, WSS2_PORT, WSS_PORT, may_dial
from usarmjx.server.protocol.grammar import HttpRequestError
from usarmjx.server.runtime.logs import FaultLog
from usarmjx.server.wireless.channel import reaches
from usarmjx.server.wireless.dialect_a import (
    MESSAGE_END,
    ComServer,
    DataLinkParser,
    DataLinkPhase,
    DialectASession,
    Endpoint,
    EndpointPair,
    normalize_address,
)
from usarmjx.server.wireless.dialect_b import MAX_CONNECTIONS, Changes, DialectBSession, Route, Switchboard
from usarmjx.server.wireless.positions import PositionSession
from usarmjx.server.wireless.radio_channel import RadioChannel
from usarmjx.server.wireless.sockets import (
    DATA_READ_SIZE,
    READ_SIZE,
    ReservedPort,
    Throttle,
    close_gracefully,
    connect,
    drain,
    limit_kernel_buffer,
    listen,
    log,
)
from usarmjx.server.wireless.truth import TruthSession
from usarmjx.server.worlds.served_world import ServedWorld


@dataclass(eq=False)
class LinkEnd:
    """One end of a link."""

    end: Endpoint
    reader: asyncio.StreamReader
    writer: asyncio.StreamWriter


@dataclass(eq=False)
class DataLink:
    """A link between two robots."""

    endpoints: EndpointPair
    sides: tuple[LinkEnd, LinkEnd]

    def cut(self) -> None:
        """Close both ends."""
        for side in self.sides:
            if not side.writer.is_closing():
                close_gracefully(side.writer)


class DataLinkServer:
    """Opens and serves the links of dialect A.

    Args:
        radio: The radio.
        allow: Addresses that may be connected to beside that of the requesting peer.
        throttle: Queue of all work.
    """

    def __init__(self, radio: RadioChannel, allow: Collection[str], throttle: Throttle) -> None:
        self._radio, self._throttle = radio, throttle
        self._server = ComServer(radio, allow)
        self._links: dict[DataLink, asyncio.Task[None]] = {}

    def make_handler(self, address: str) -> "DialectAHandler":
        """Return the handler of a new control connection."""
        return DialectAHandler(self, DialectASession(self._server, address), self._throttle)

    def pairs(self) -> list[tuple[str, str]]:
        """Return the names at both ends of every link."""
        return [link.endpoints.names for link in self._links]

    def poll(self) -> None:
        """Cut the links of robots that have left the world."""
        self._server.poll_presence()
        # To cut only closes the streams: the task that carries the link removes it from the links later.
        for link in self._links:
            if not all(self._radio.has_robot(name) for name in link.endpoints.names):
                link.cut()

    def stop(self) -> None:
        """Cut all links."""
        for link, task in self._links.items():
            # Aborted, as a graceful close would wait for a peer that reads no more.
            for side in link.sides:
                side.writer.transport.abort()
            task.cancel()

    async def make(self, wanted: EndpointPair) -> bool:
        """Connect to both ends of a link and forward between them; return whether both answered."""
        ends = (wanted.first, wanted.second)
        # Without returned exceptions an end that connects after the other has failed would stay open.
        streams = await asyncio.gather(
            *(connect(end.address, end.port) for end in ends), return_exceptions=True
        )
        sides = [
            LinkEnd(end, *pair)
            for end, pair in zip(ends, streams, strict=True)
            if not isinstance(pair, BaseException)
        ]
        # A link has two ends or none: the one that answered must not wait for the other.
        if len(sides) < 2:
            for side in sides:
                side.writer.transport.abort()
            log.info("no link between %s and %s: %s", *wanted.names, streams)
            return False
        link = DataLink(wanted, (sides[0], sides[1]))
        self._links[link] = asyncio.create_task(self._carry(link))
        return True

    async def _carry(self, link: DataLink) -> None:
        log.info("link between %s and %s", *link.endpoints.names)
        one, other = link.sides
        try:
            # Each direction cuts the link when it ends, and so ends the other one.
            await asyncio.gather(self._pump(link, one, other), self._pump(link, other, one))
        finally:
            link.cut()
            del self._links[link]
            self._server.closed(link.endpoints)
            log.info("no more link between %s and %s", *link.endpoints.names)

    async def _pump(self, link: DataLink, here: LinkEnd, there: LinkEnd) -> None:
        """Forward messages from one side to the other until either closes or the signal is lost."""
        parser = DataLinkParser()
        try:
            while parser.phase is not DataLinkPhase.CLOSED and (
                data := await here.reader.read(DATA_READ_SIZE)
            ):
                async with self._throttle:
                    messages = parser.receive_data(data)
                    # Checked when there is something to carry: bytes of a message that is not complete cross
                    # no radio.
                    if messages and not reaches(self._radio, *link.endpoints.names):
                        log.info("%s and %s do not reach each other any more", *link.endpoints.names)
                        break
                    # The other direction may have cut the link while this one waited for its turn.
                    if there.writer.is_closing():
                        break
                    there.writer.write(b"".join(messages))
                # Outside the throttle: waiting for a slow peer must not keep others from their turns.
                await drain(there.writer)
        except (OSError, PeerError) as error:
            log.info("%s: %s", here.end.name, error)
        finally:
            link.cut()


class DialectAHandler:
    """Handler of one control connection of dialect A.

    Args:
        links: Opens the links.
        session: The dialogue.
        throttle: Queue of all work.
    """

    closing = False

    def __init__(self, links: DataLinkServer, session: DialectASession, throttle: Throttle) -> None:
        self._links, self._session, self._throttle = links, session, throttle

    @property
    def alive(self) -> bool:
        """Whether a robot that was registered here is in the world."""
        return self._session.alive

    async def handle(self, data: bytes) -> bytes:
        """Take bytes and return the answers."""
        async with self._throttle:
            link = self._session.receive_data(data)
        while link is not None:
            done = False
            try:
                done = await self._links.make(link)
            # Also when the task is cancelled, or the session would answer nothing more.
            finally:
                link = self._session.answer_open(done)
        return self._session.data_to_send()

    def connection_lost(self) -> None:
        """Do nothing: robots stay registered when their control connection ends."""


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
            # The poll may have removed it while this waited for its turn.
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
        # A list: `leave` removes handlers from the set.
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
        # Only the caller's own ports are released: to a callee that comes back the port must be the same.
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
        # A closed listener leaves accepted connections open: each of them is cut by itself.
        for connection in self._connections.get(route, ()):
            connection.cut()

    async def _called(self, route: Route, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        address, _ = peer_address(writer)
        # The port is open to everybody: only the caller's own address may use it.
        if not address or not self._board.may_call(route, normalize_address(address)):
            writer.close()
            return
        connection, ports = ProxyConnection(writer), list[int]()
        # Registered before the far end is dialled, so that a lost signal cuts it in between, too.
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
                    # A lost signal may have cut the connection during the wait for the turn.
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


POLL_PERIOD = 1.0
"""Interval between two polls of the world [s of simulated time]: that of the stand-alone server."""


@dataclass(frozen=True)
class WirelessSettings:
    """Settings of the wireless servers.

    Attributes:
        host: Address to bind; loopback by default.
        wss_port: Port of dialect A (USARComServer.ini: ListenPort); this and the others: 0 picks a free one.
        wss2_port: Port of dialect B.
        position_port: Port of the position service.
        truth_port: Port of true poses (USARTruth.uc); None: there is none.
        allow: Addresses that may be connected to beside that of the requesting peer.
        max_connections: Most control and position connections at once.
        idle_timeout: Silence after which a peer without a robot in the world is dropped [s].
        access: Rules of access.
    """

    host: str = "127.0.0.1"
    wss_port: Annotated[int, PORT] = WSS_PORT
    wss2_port: Annotated[int, PORT] = WSS2_PORT
    position_port: Annotated[int, PORT] = POSITION_PORT
    truth_port: Annotated[int | None, PORT] = None
    allow: tuple[str, ...] = ()
    max_connections: Annotated[int, AT_LEAST_ONE] = 64
    idle_timeout: Annotated[float, NOT_NEGATIVE] = 60.0
    access: AccessRules = EVERYBODY

    def __post_init__(self) -> None:
        """Check the settings."""
        validate(self)


class ConnectionHandler(Protocol):
    """Handler of one control or position connection."""

    async def handle(self, data: bytes) -> bytes:
        """Take bytes and return the answer."""
        ...

    @property
    def alive(self) -> bool:
        """Whether it belongs to a robot in the world, and may therefore be silent."""
        ...

    @property
    def closing(self) -> bool:
        """Whether the connection must end."""
        ...

    def connection_lost(self) -> None:
        """Release the connection's state: it is gone."""


@dataclass(eq=False)
class ClientConnection:
    """A control or position connection.

    Attributes:
        writer: Its writer.
        handler: Its handler.
        last_received: Time of its last bytes [s].
    """

    writer: asyncio.StreamWriter
    handler: ConnectionHandler
    last_received: float = field(default_factory=time.monotonic)


class AnswerSession(Protocol):
    """Dialogue in which every line has its answer."""

    def receive_data(self, data: bytes) -> bytes:
        """Return the answers to the lines that `data` completes."""
        ...


class PositionHandler:
    """Handler of one connection to the position service, or to that of true poses."""

    alive = closing = False

    def __init__(self, session: AnswerSession, throttle: Throttle) -> None:
        self._session, self._throttle = session, throttle

    async def handle(self, data: bytes) -> bytes:
        """Take bytes and return the answer."""
        async with self._throttle:
            return self._session.receive_data(data)

    def connection_lost(self) -> None:
        """Do nothing: there is no state to release."""


class WirelessService:
    """The three servers, and that of true poses if it has a port; a `gamebots.server.Service`.

    Args:
        radio: The radio of the served world.
        world: The served world.
        settings: Settings of the servers.
        bound: Sockets that are bound to the ports already, by "wss", "wss2", "position" and "truth".

    Attributes:
        ports: The ports in use, by the same names, once started.
    """

    def __init__(
        self,
        radio: RadioChannel,
        world: ServedWorld,
        settings: WirelessSettings,
        bound: Mapping[str, socket.socket] | None = None,
    ) -> None:
        self._radio, self._world, self._settings, self._bound = radio, world, settings, bound or {}
        self._throttle = Throttle()
        self._links = DataLinkServer(radio, settings.allow, self._throttle)
        self._gate = Gate(settings.access, settings.max_connections, "radio")
        # A gate of its own: calls between robots must not take the room of control connections.
        calls = Gate(settings.access, MAX_CONNECTIONS, "calls by radio")
        self._proxies = ProxyServer(radio, settings.host, self._throttle, calls)
        self._connections: list[ClientConnection] = []
        self._listeners: list[asyncio.Server] = []
        self._poll_task: asyncio.Task[None] | None = None
        self._next_poll = 0.0
        self.ports: dict[str, int] = {}

    async def start(self) -> list[str]:
        """Listen on all ports; return lines for the user.

        Raises:
            UsageError: A port is taken or the address is not ours.
        """
        servers: list[tuple[str, str, int, Callable[[str], ConnectionHandler]]] = [
            ("wss", "wireless server", self._settings.wss_port, self._links.make_handler),
            ("wss2", "second wireless server", self._settings.wss2_port, self._proxies.make_handler),
            ("position", "positions", self._settings.position_port, self._positions),
        ]
        if self._settings.truth_port is not None:
            servers.append(("truth", "true poses", self._settings.truth_port, self._true_poses))
        lines: list[str] = []
        for name, title, port, make_handler in servers:
            server, self.ports[name] = await listen(
                (self._settings.host, port),
                self._connection_callback(make_handler),
                self._gate,
                self._bound.get(name),
                # The line with a token ends as the messages of the port's dialect do.
                MESSAGE_END if name == "wss" else LINE_ENDS,
            )
            self._listeners.append(server)
            lines.append(f"{title} on {self._settings.host}:{self.ports[name]}")
        self._next_poll = self._world.time + POLL_PERIOD
        return lines

    def tick(self) -> None:
        """Refill the time share, and poll the world when a poll is due."""
        self._throttle.refill()
        # One poll at a time: a slow one must not be overtaken by the next.
        if self._world.time >= self._next_poll and (self._poll_task is None or self._poll_task.done()):
            # From now on, not from the last due time: after a long step there is nothing to catch up on.
            self._next_poll = self._world.time + POLL_PERIOD
            self._poll_task = asyncio.create_task(self._poll())
            # An exception of a task that nobody awaits would be reported only when it is collected, if at
            # all.
            self._poll_task.add_done_callback(_report)

    def stop(self) -> None:
        """Close all connections."""
        for server in self._listeners:
            server.close()
        for connection in self._connections:
            connection.writer.transport.abort()
        self._links.stop()
        self._proxies.stop()
        if self._poll_task is not None:
            self._poll_task.cancel()

    async def _poll(self) -> None:
        async with self._throttle:
            self._links.poll()
            changes = self._proxies.poll()
        await self._proxies.apply_changes(changes)
        # In real time, unlike the poll itself: a paused or slow world says nothing about a peer's silence.
        latest = time.monotonic() - self._settings.idle_timeout
        for connection in self._connections:
            # A robot's controller may be silent for long: only peers without one have to speak.
            if connection.handler.closing or (
                connection.last_received < latest and not connection.handler.alive
            ):
                # Its entry leaves the list in its own task, later: the loop goes over an unchanged list.
                log.info("%s:%d: dropped, it has no robot in the world", *peer_address(connection.writer))
                connection.writer.transport.abort()

    def _positions(self, address: str) -> ConnectionHandler:
        del address
        return PositionHandler(PositionSession(self._radio), self._throttle)

    def _true_poses(self, address: str) -> ConnectionHandler:
        del address
        return PositionHandler(TruthSession(self._world), self._throttle)

    def _connection_callback(
        self, make_handler: Callable[[str], ConnectionHandler]
    ) -> Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]:
        async def accept(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            address, port = peer_address(writer)
            # Without an address the peer has gone already.
            if not address or not self._make_room():
                self._gate.refuse(f"{address}:{port}", f"{len(self._connections)} connections are open")
                writer.close()
                return
            limit_kernel_buffer(writer)
            connection = ClientConnection(writer, make_handler(address))
            self._connections.append(connection)
            try:
                await _converse(connection, reader)
            except HttpRequestError as error:
                self._gate.refuse(f"{address}:{port}", str(error))
            except (OSError, PeerError) as error:
                log.info("%s:%d: %s", address, port, error)
            except asyncio.CancelledError:
                log.info("%s:%d: the server stops", address, port)
            finally:
                self._connections.remove(connection)
                connection.handler.connection_lost()
                close_gracefully(writer)

        return accept

    def _make_room(self) -> bool:
        """Return whether another connection fits; of those without a robot the most silent one yields."""
        if len(self._connections) < self._settings.max_connections:
            return True
        strangers = [c for c in self._connections if not c.handler.alive and not c.writer.is_closing()]
        if not strangers:
            return False
        # The aborted one leaves the list a little later: for a moment there is one more than the limit.
        min(strangers, key=lambda connection: connection.last_received).writer.transport.abort()
        return True


async def _converse(connection: ClientConnection, reader: asyncio.StreamReader) -> None:
    while data := await reader.read(READ_SIZE):
        connection.last_received = time.monotonic()
        # Read on only after the answer: while a link opens, a session of dialect A keeps messages without a
        # bound.
        connection.writer.write(await connection.handler.handle(data))
        await drain(connection.writer)


def _report(task: asyncio.Task[None]) -> None:
    """Log the error of a task whose result nothing awaits."""
    if not task.cancelled() and (error := task.exception()):
        log.error("the wireless server could not look at the world", exc_info=error)


def make_wireless(
    world: ServedWorld,
    radio: RadioSettings,
    settings: WirelessSettings,
    bound: Mapping[str, socket.socket] | None = None,
) -> WirelessService:
    """Return the wireless servers of a world; `radio.debug` enables their log.

    Args:
        world: The world.
        radio: The radio's constants.
        settings: Settings of the servers.
        bound: As of `WirelessService`.

    Raises:
        UnsupportedGeomError: The arena has a solid of a type whose walls cannot be counted.
    """
    if radio.debug:
        log.setLevel(logging.INFO)
    return WirelessService(RadioChannel(world, radio), world, settings, bound)
