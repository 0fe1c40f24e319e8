"""The wireless servers of a served world on real sockets, in the loop of the Gamebots server.

`WirelessService` listens for dialect A, dialect B and the position service. `gamebots.server.BotServer`
starts it, calls `tick` after every control step, and stops it. Every second of simulated time it polls the
world: then robots that have left lose their links, and dialect B breaks and restores its own.
"""

import asyncio
import logging
import socket
import time
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Protocol

from usarmjx.base.errors import PeerError
from usarmjx.base.settings import AT_LEAST_ONE, NOT_NEGATIVE, validate
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.server.network.access import EVERYBODY, AccessRules
from usarmjx.server.network.gate import LINE_ENDS, Gate, peer_address
from usarmjx.server.network.ports import PORT, POSITION_PORT, WSS2_PORT, WSS_PORT
from usarmjx.server.protocol.grammar import HttpRequestError
from usarmjx.server.wireless.dialect_a import MESSAGE_END
from usarmjx.server.wireless.net_a import DataLinkServer
from usarmjx.server.wireless.net_b import ProxyServer
from usarmjx.server.wireless.positions import PositionSession
from usarmjx.server.wireless.radio_channel import RadioChannel
from usarmjx.server.wireless.sockets import (
    READ_SIZE,
    Throttle,
    close_gracefully,
    drain,
    limit_kernel_buffer,
    listen,
    log,
)
from usarmjx.server.wireless.switchboard import MAX_CONNECTIONS
from usarmjx.server.worlds.served_world import ServedWorld

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
        allow: Addresses that may be connected to beside that of the requesting peer.
        max_connections: Most control and position connections at once.
        idle_timeout: Silence after which a peer without a robot in the world is dropped [s].
        access: Rules of access.
    """

    host: str = "127.0.0.1"
    wss_port: Annotated[int, PORT] = WSS_PORT
    wss2_port: Annotated[int, PORT] = WSS2_PORT
    position_port: Annotated[int, PORT] = POSITION_PORT
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


class PositionHandler:
    """Handler of one connection to the position service."""

    alive = closing = False

    def __init__(self, radio: RadioChannel, throttle: Throttle) -> None:
        self._session, self._throttle = PositionSession(radio), throttle

    async def handle(self, data: bytes) -> bytes:
        """Take bytes and return the answer."""
        async with self._throttle:
            return self._session.receive_data(data)

    def connection_lost(self) -> None:
        """Do nothing: there is no state to release."""


class WirelessService:
    """The three servers; a `gamebots.server.Service`.

    Args:
        radio: The radio of the served world.
        clock: Returns the world's time [s].
        settings: Settings of the servers.
        bound: Sockets that are bound to the ports already, by "wss", "wss2" and "position".

    Attributes:
        ports: The ports in use, by the same names, once started.
    """

    def __init__(
        self,
        radio: RadioChannel,
        clock: Callable[[], float],
        settings: WirelessSettings,
        bound: Mapping[str, socket.socket] | None = None,
    ) -> None:
        self._radio, self._clock, self._settings, self._bound = radio, clock, settings, bound or {}
        self._throttle = Throttle()
        self._links = DataLinkServer(radio, settings.allow, self._throttle)
        self._gate = Gate(settings.access, settings.max_connections, "radio")
        calls = Gate(settings.access, MAX_CONNECTIONS, "calls by radio")
        self._proxies = ProxyServer(radio, settings.host, self._throttle, calls)
        self._connections: list[ClientConnection] = []
        self._listeners: list[asyncio.Server] = []
        self._poll_task: asyncio.Task[None] | None = None
        self._next_poll = 0.0
        self.ports: dict[str, int] = {}

    async def start(self) -> list[str]:
        """Listen on all three ports; return lines for the user.

        Raises:
            UsageError: A port is taken or the address is not ours.
        """
        servers: tuple[tuple[str, str, int, Callable[[str], ConnectionHandler]], ...] = (
            ("wss", "wireless server", self._settings.wss_port, self._links.make_handler),
            ("wss2", "second wireless server", self._settings.wss2_port, self._proxies.make_handler),
            ("position", "positions", self._settings.position_port, self._positions),
        )
        lines: list[str] = []
        for name, title, port, make_handler in servers:
            server, self.ports[name] = await listen(
                (self._settings.host, port),
                self._connection_callback(make_handler),
                self._gate,
                self._bound.get(name),
                MESSAGE_END if name == "wss" else LINE_ENDS,
            )
            self._listeners.append(server)
            lines.append(f"{title} on {self._settings.host}:{self.ports[name]}")
        self._next_poll = self._clock() + POLL_PERIOD
        return lines

    def tick(self) -> None:
        """Refill the time share, and poll the world when a poll is due."""
        self._throttle.refill()
        if self._clock() >= self._next_poll and (self._poll_task is None or self._poll_task.done()):
            self._next_poll = self._clock() + POLL_PERIOD
            self._poll_task = asyncio.create_task(self._poll())
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
        latest = time.monotonic() - self._settings.idle_timeout
        for connection in self._connections:
            if connection.handler.closing or (
                connection.last_received < latest and not connection.handler.alive
            ):
                log.info("%s:%d: dropped, it has no robot in the world", *peer_address(connection.writer))
                connection.writer.transport.abort()

    def _positions(self, address: str) -> ConnectionHandler:
        del address
        return PositionHandler(self._radio, self._throttle)

    def _connection_callback(
        self, make_handler: Callable[[str], ConnectionHandler]
    ) -> Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]:
        async def accept(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            address, port = peer_address(writer)
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
        min(strangers, key=lambda connection: connection.last_received).writer.transport.abort()
        return True


async def _converse(connection: ClientConnection, reader: asyncio.StreamReader) -> None:
    while data := await reader.read(READ_SIZE):
        connection.last_received = time.monotonic()
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
    return WirelessService(RadioChannel(world, radio), lambda: world.time, settings, bound)
