"""The wireless servers of a served world on real sockets, in the loop of the Gamebots server.

`Wireless` listens for dialect A, dialect B and the position service. `net.Server` starts it, tells it after
every control step, and stops it. Every second of simulated time it looks at the world: that is when robots
that have left lose their links, and when dialect B breaks and restores its own.
"""

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable, Collection
from dataclasses import dataclass, field
from typing import Protocol

from usarmjx.base.errors import PeerError, UsageError
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.server.wireless.comserver import Refusal, plain_address
from usarmjx.server.wireless.net_a import LinkServer
from usarmjx.server.wireless.net_b import PipeServer
from usarmjx.server.wireless.positions import PositionSession
from usarmjx.server.wireless.radio_channel import Ether
from usarmjx.server.wireless.sockets import (
    CHUNK,
    Turnstile,
    address_of,
    drain,
    hang_up,
    limit_kernel_buffer,
    listen,
    log,
)
from usarmjx.server.worlds.host import HostWorld

LOOK = 1.0
"""Between two looks at the world [s of simulated time]: the pace of the stand-alone server's poll."""


@dataclass(frozen=True)
class WirelessSettings:
    """How to serve the radio.

    Attributes:
        host: Address to bind; loopback by default.
        wss_port: Port of dialect A (USARComServer.ini: ListenPort); this and the others: 0 picks a free one.
        wss2_port: Port of dialect B.
        position_port: Port of the position service.
        allow: Addresses that may be dialled beside that of the peer who asks for it.
        max_connections: Most control and position connections at once.
        idle: Who has no robot in the world and says nothing for so long is dropped [s].
    """

    host: str = "127.0.0.1"
    wss_port: int = 5874
    wss2_port: int = 50000
    position_port: int = 7435
    allow: tuple[str, ...] = ()
    max_connections: int = 64
    idle: float = 60.0


class Talk(Protocol):
    """What answers one control or position connection."""

    async def hear(self, data: bytes) -> bytes:
        """Take bytes and return the answer."""
        ...

    @property
    def alive(self) -> bool:
        """Whether it belongs to a robot in the world, which makes it welcome to be silent."""
        ...

    @property
    def over(self) -> bool:
        """Whether the connection has to end."""
        ...

    def end(self) -> None:
        """Clear up: the connection is gone."""


@dataclass(eq=False)
class Guest:
    """A control or position connection.

    Attributes:
        writer: Its writer.
        talk: What answers it.
        heard: When it said something last [s].
    """

    writer: asyncio.StreamWriter
    talk: Talk
    heard: float = field(default_factory=time.monotonic)


class PositionTalk:
    """Answers one connection to the position service."""

    alive = over = False

    def __init__(self, ether: Ether, turnstile: Turnstile) -> None:
        self._session, self._turnstile = PositionSession(ether), turnstile

    async def hear(self, data: bytes) -> bytes:
        """Take bytes and return the answer."""
        async with self._turnstile:
            return self._session.receive_data(data)

    def end(self) -> None:
        """Nothing to clear up."""


class Wireless:
    """The three servers; a `net.Service`.

    Args:
        ether: The radio of the served world.
        clock: The world's time [s].
        settings: How to serve.

    Attributes:
        ports: The ports in use, by "wss", "wss2" and "position", once started.
    """

    def __init__(self, ether: Ether, clock: Callable[[], float], settings: WirelessSettings) -> None:
        self._ether, self._clock, self._settings = ether, clock, settings
        self._turnstile = Turnstile()
        self._links = LinkServer(ether, settings.allow, self._turnstile)
        self._pipes = PipeServer(ether, settings.host, self._turnstile)
        self._guests: list[Guest] = []
        self._listeners: list[asyncio.Server] = []
        self._look: asyncio.Task[None] | None = None
        self._next_look = 0.0
        self.ports: dict[str, int] = {}

    async def start(self) -> list[str]:
        """Listen on all three ports; return what to tell the user.

        Raises:
            UsageError: A port is taken or the address is not ours.
        """
        talks: tuple[tuple[str, str, int, Callable[[str], Talk]], ...] = (
            ("wss", "wireless server", self._settings.wss_port, self._links.talk),
            ("wss2", "second wireless server", self._settings.wss2_port, self._pipes.talk),
            ("position", "positions", self._settings.position_port, self._positions),
        )
        lines = []
        for name, title, port, talk in talks:
            server, self.ports[name] = await listen(self._settings.host, port, self._door(talk))
            self._listeners.append(server)
            lines.append(f"{title} on {self._settings.host}:{self.ports[name]}")
        self._next_look = self._clock() + LOOK
        return lines

    def tick(self) -> None:
        """The world has made a control step."""
        self._turnstile.step()
        if self._clock() >= self._next_look and (self._look is None or self._look.done()):
            self._next_look = self._clock() + LOOK
            self._look = asyncio.create_task(self._look_around())
            self._look.add_done_callback(_report)

    def stop(self) -> None:
        """Hang up on everybody."""
        for server in self._listeners:
            server.close()
        for guest in self._guests:
            guest.writer.transport.abort()
        self._links.stop()
        self._pipes.stop()
        if self._look is not None:
            self._look.cancel()

    async def _look_around(self) -> None:
        async with self._turnstile:
            self._ether.look_ahead([*self._links.pairs(), *self._pipes.pairs()])
            self._links.look()
            changes = self._pipes.look()
        await self._pipes.carry_out(changes)
        latest = time.monotonic() - self._settings.idle
        for guest in self._guests:
            if guest.talk.over or (guest.heard < latest and not guest.talk.alive):
                log.info("%s:%d: dropped, it has no robot in the world", *address_of(guest.writer))
                guest.writer.transport.abort()

    def _positions(self, address: str) -> Talk:
        del address
        return PositionTalk(self._ether, self._turnstile)

    def _door(
        self, talk: Callable[[str], Talk]
    ) -> Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]:
        async def come_in(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            address, port = address_of(writer)
            if not address or not self._make_room():
                log.warning("%s:%d: refused, %d connections are open", address, port, len(self._guests))
                writer.close()
                return
            limit_kernel_buffer(writer)
            guest = Guest(writer, talk(address))
            self._guests.append(guest)
            try:
                await _converse(guest, reader)
            except (OSError, PeerError) as error:
                log.info("%s:%d: %s", address, port, error)
            except asyncio.CancelledError:
                log.info("%s:%d: the server stops", address, port)
            finally:
                self._guests.remove(guest)
                guest.talk.end()
                hang_up(writer)

        return come_in

    def _make_room(self) -> bool:
        """Return whether another connection fits; of those without a robot the most silent one yields."""
        if len(self._guests) < self._settings.max_connections:
            return True
        strangers = [g for g in self._guests if not g.talk.alive and not g.writer.is_closing()]
        if not strangers:
            return False
        min(strangers, key=lambda guest: guest.heard).writer.transport.abort()
        return True


async def _converse(guest: Guest, reader: asyncio.StreamReader) -> None:
    while data := await reader.read(CHUNK):
        guest.heard = time.monotonic()
        guest.writer.write(await guest.talk.hear(data))
        await drain(guest.writer)


def _report(task: asyncio.Task[None]) -> None:
    """Log what went wrong in a task that nobody waits for."""
    if not task.cancelled() and (error := task.exception()):
        log.error("the wireless server could not look at the world", exc_info=error)


def make_wireless(world: HostWorld, radio: RadioSettings, settings: WirelessSettings) -> Wireless:
    """Return the wireless servers of a world; `radio.debug` makes them log what they do.

    Raises:
        UnsupportedGeomError: The arena has a solid of a type whose walls cannot be counted.
    """
    if radio.debug:
        log.setLevel(logging.INFO)
    return Wireless(Ether(world, radio), lambda: world.time, settings)


def check_addresses(addresses: Collection[str]) -> tuple[str, ...]:
    """Return IP addresses in their usual form.

    Raises:
        UsageError: One is none.
    """
    try:
        return tuple(plain_address(address) for address in addresses)
    except Refusal as error:
        raise UsageError(f"{', '.join(addresses)}: an IP address is expected") from error
