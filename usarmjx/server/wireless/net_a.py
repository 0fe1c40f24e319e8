"""Dialect A of the wireless server on real sockets: links between two robots' ports, and their SENDs."""

import asyncio
from collections.abc import Collection
from dataclasses import dataclass

from usarmjx.base.errors import PeerError
from usarmjx.server.wireless.channel import reaches
from usarmjx.server.wireless.comserver import ComServer, Endpoint, EndpointPair
from usarmjx.server.wireless.dialect_a import DataLinkParser, DataLinkPhase, DialectASession
from usarmjx.server.wireless.radio_channel import RadioChannel
from usarmjx.server.wireless.sockets import DATA_READ_SIZE, Throttle, close_gracefully, connect, drain, log


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
        for link in self._links:
            if not all(self._radio.has_robot(name) for name in link.endpoints.names):
                link.cut()

    def stop(self) -> None:
        """Cut all links."""
        for link, task in self._links.items():
            for side in link.sides:
                side.writer.transport.abort()
            task.cancel()

    async def make(self, wanted: EndpointPair) -> bool:
        """Connect to both ends of a link and forward between them; return whether both answered."""
        ends = (wanted.first, wanted.second)
        streams = await asyncio.gather(
            *(connect(end.address, end.port) for end in ends), return_exceptions=True
        )
        sides = [
            LinkEnd(end, *pair)
            for end, pair in zip(ends, streams, strict=True)
            if not isinstance(pair, BaseException)
        ]
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
                    if messages and not reaches(self._radio, *link.endpoints.names):
                        log.info("%s and %s do not reach each other any more", *link.endpoints.names)
                        break
                    if there.writer.is_closing():
                        break
                    there.writer.write(b"".join(messages))
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
            finally:
                link = self._session.answer_open(done)
        return self._session.data_to_send()

    def connection_lost(self) -> None:
        """Do nothing: robots stay registered when their control connection ends."""
