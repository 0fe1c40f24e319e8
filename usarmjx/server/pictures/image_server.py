"""The image server on a real socket, in the loop of the Gamebots server (manual 3.2.5, 14.5.3).

Pictures are rendered only for clients that wait for one, and rendering and encoding happen in a thread. A
client that has waited for too long gets the last picture again, or a black one.
"""

import asyncio
import logging
import socket
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import Annotated

import numpy as np

from usarmjx.base.settings import AT_LEAST_ONE, NOT_NEGATIVE, POSITIVE, Setting, validate
from usarmjx.server.network.access import EVERYBODY, AccessRules
from usarmjx.server.network.gate import Gate, peer_address
from usarmjx.server.network.ports import IMAGE_PORT, PORT
from usarmjx.server.pictures.views import CompositeView, RenderThread, ViewImages, client_view
from usarmjx.server.protocol.grammar import HttpRequestError
from usarmjx.server.protocol.images import ImageSession, Region, encode_frame
from usarmjx.server.protocol.viewports import MultiView
from usarmjx.server.wireless.sockets import READ_SIZE, STALL, close_gracefully, limit_kernel_buffer, listen
from usarmjx.server.worlds.served_world import ServedWorld

log = logging.getLogger(__name__)

SIZE = (320, 240)
"""Default width and height of pictures [pixels]."""


PartView = tuple[CompositeView, Region]
"""A part of a view's picture."""


@dataclass(frozen=True)
class ImageSettings:
    """Settings of the image server.

    Attributes:
        host: Address to bind; loopback by default.
        port: TCP port; 0 picks a free one.
        size: Width and height of the pictures [pixels].
        fps: Most pictures per second of real time for each client.
        format: Picture type, 0 (raw) to 5; see `images.FORMATS`.
        max_connections: Most clients at once.
        patience: Wait for a picture after which the client gets the last one of the same view again, or a
            black one [s].
        multi_view: Division of the picture among all robots' cameras, for clients whose view is bound to no
            camera; None: they see one robot.
        access: Rules of access.
    """

    host: str = "127.0.0.1"
    port: Annotated[int, PORT] = IMAGE_PORT
    size: Annotated[tuple[int, int], AT_LEAST_ONE] = SIZE
    fps: Annotated[float, POSITIVE] = 10.0
    format: Annotated[int, Setting(ge=0, le=5)] = 3
    max_connections: Annotated[int, AT_LEAST_ONE] = 16
    patience: Annotated[float, NOT_NEGATIVE] = 0.3
    multi_view: MultiView | None = None
    access: AccessRules = EVERYBODY

    def __post_init__(self) -> None:
        """Check the settings."""
        validate(self)


@dataclass(eq=False)
class ImageClient:
    """A client of the image server.

    Attributes:
        writer: Its writer.
        session: Its dialogue.
        last_received: Time of its last bytes [s].
        unsent: Bytes in its write buffer at the last change.
        since: Time of that change [s].
        waits_since: Time since which it waits for a picture [s]; None: it does not wait.
        last: View and frame of its last picture; None without one.
    """

    writer: asyncio.StreamWriter
    session: ImageSession
    last_received: float = field(default_factory=time.monotonic)
    unsent: int = 0
    since: float = field(default_factory=time.monotonic)
    waits_since: float | None = None
    last: tuple[PartView, bytes] | None = None

    def update_unsent(self, now: float) -> int:
        """Return the number of unsent bytes, and record the time of a change."""
        unsent = self.writer.transport.get_write_buffer_size()
        if unsent != self.unsent:
            self.unsent, self.since = unsent, now
        return unsent

    def is_waiting(self, now: float) -> bool:
        """Return whether it waits for a picture, and record since when."""
        waits = self.session.wants(now)
        self.waits_since = (self.waits_since or now) if waits else None
        return waits

    def send(self, frame: bytes, now: float) -> None:
        """Send the awaited picture at a time [s]."""
        self.session.sent(now)
        self.waits_since = None
        self.writer.write(frame)


class ImageServer:
    """The image server; a `gamebots.server.Service`.

    Args:
        world: The served world.
        settings: Settings of the server.
        bound: A socket that is bound to the port already.

    Attributes:
        port: The port in use, once started.
    """

    def __init__(
        self, world: ServedWorld, settings: ImageSettings, bound: socket.socket | None = None
    ) -> None:
        self._world, self._settings, self._bound = world, settings, bound
        self._clients: list[ImageClient] = []
        self._listener: asyncio.Server | None = None
        self._gate = Gate(settings.access, settings.max_connections, "pictures")
        self._stepped = asyncio.Event()
        self._render_thread = RenderThread(world)
        self.port = settings.port
        # The adapter gives each new robot a tile of it, which STA reports as View.
        world.multi_view = settings.multi_view

    async def start(self) -> list[str]:
        """Listen; return lines for the user.

        Raises:
            UsageError: The port is taken or the address is not ours.
        """
        host, port = self._settings.host, self._settings.port
        self._listener, self.port = await listen((host, port), self._accept, self._gate, self._bound)
        return [f"pictures on {host}:{self.port}"]

    def tick(self) -> None:
        """Drop clients that do not read, and start or repeat the pictures that are due."""
        # Wakes all that wait now, and nobody who begins to wait later.
        self._stepped.set()
        self._stepped.clear()
        if not self._clients:
            return
        now = time.monotonic()
        waiting: list[ImageClient] = []
        for client in self._clients:
            # A client that has not read its last picture gets no further one: pictures would pile up.
            if not client.update_unsent(now):
                waiting += [client] * client.is_waiting(now)
            elif now - client.since > STALL:
                log.info("%s:%d: dropped, it does not read", *peer_address(client.writer))
                client.writer.transport.abort()
        if waiting and self._render_thread.is_ready(now):
            self._render_thread.begin(self._send(waiting, now))
        # After the rendering has begun: a slow one keeps no client waiting beyond its patience.
        for client in waiting:
            if client.waits_since is not None and now - client.waits_since > self._settings.patience:
                self._send_last(client, now)

    def stop(self) -> None:
        """Close all connections."""
        if self._listener is not None:
            self._listener.close()
        for client in self._clients:
            client.writer.transport.abort()
        self._render_thread.close()

    async def _send(self, clients: Sequence[ImageClient], now: float) -> None:
        """Send clients their pictures, rendering each view once."""
        wanted = {client: part for client in clients if (part := self._part_of(client)) is not None}
        parts = set(wanted.values())
        try:
            make = partial(_frames, parts, self._settings.format)
            frames = await self._render_thread.render([view for view, _ in parts], make)
        # The error goes on to the log; the clients would otherwise wait for this picture for ever.
        except Exception:
            for client in wanted:
                client.writer.transport.abort()
            raise
        ended = time.monotonic()
        for client, part in wanted.items():
            client.last = part, frames[part]
            # The client may have received `_send_last` meanwhile, and now wait for another part or nothing.
            waits = client.session.wants(ended) and client.session.region == part[1]
            # A client that waited before the rendering counts from its start, which keeps its rate.
            if waits and not client.writer.is_closing():
                client.send(frames[part], now if (client.waits_since or ended) <= now else ended)

    def _part_of(self, client: ImageClient) -> PartView | None:
        """Return the view and part that a client waits for; None without a request."""
        if client.session.region is None:
            return None
        view = client_view(self._world, *peer_address(client.writer), self._settings.size)
        return view, client.session.region

    def _send_last(self, client: ImageClient, now: float) -> None:
        """Send the last picture of the awaited view again; a black one if there is none."""
        part = self._part_of(client)
        if part is None or client.writer.is_closing():
            return
        if client.last is not None and client.last[0] == part:
            client.send(client.last[1], now)
        else:
            _, (*_, width, height) = part
            client.send(_black_frame(self._settings.format, width, height), now)

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        address, port = peer_address(writer)
        if not address or not self._make_room():
            self._gate.refuse(f"{address}:{port}", f"{len(self._clients)} clients are here")
            writer.close()
            return
        # With a large buffer in the kernel an unread picture would count as sent: see `update_unsent`.
        limit_kernel_buffer(writer)
        settings = self._settings
        client = ImageClient(writer, ImageSession(settings.size, 1 / settings.fps, time.monotonic()))
        self._clients.append(client)
        log.info("%s:%d: wants pictures", address, port)
        try:
            while data := await reader.read(READ_SIZE):
                client.last_received = time.monotonic()
                client.session.receive_data(data)
                await self._stepped.wait()  # one read per control step: no client may delay the world
        except HttpRequestError as error:
            self._gate.refuse(f"{address}:{port}", str(error))
        except OSError as error:
            log.info("%s:%d: %s", address, port, error)
        except asyncio.CancelledError:
            log.info("%s:%d: the server stops", address, port)
        finally:
            self._clients.remove(client)
            close_gracefully(writer)

    def _make_room(self) -> bool:
        """Return whether another client fits; the most silent one yields."""
        here = [client for client in self._clients if not client.writer.is_closing()]
        if len(self._clients) < self._settings.max_connections:
            return True
        # One that is closing already leaves by itself: to abort it again would make no room.
        if here:
            min(here, key=lambda client: client.last_received).writer.transport.abort()
        return bool(here)


@lru_cache(maxsize=4)
def _black_frame(number: int, width: int, height: int) -> bytes:
    """Return the frame of a black picture."""
    return encode_frame(number, np.zeros((height, width, 3), np.uint8))


def _frames(wanted: Collection[PartView], number: int, wholes: ViewImages) -> dict[PartView, bytes]:
    """Return the frames of parts of views."""
    frames: dict[PartView, bytes] = {}
    for view, (left, top, width, height) in wanted:
        part = wholes[view][top : top + height, left : left + width]
        frames[view, (left, top, width, height)] = encode_frame(number, part)
    return frames
