"""The viewing client: a page in a browser, and the pictures that it shows (manual 5.1)."""

import asyncio
import contextlib
import json
import logging
import math
import socket
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from http import HTTPStatus
from pathlib import Path
from typing import TYPE_CHECKING

from websockets.asyncio.server import Server, ServerConnection
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from usarmjx.base.errors import PeerError
from usarmjx.server.gamebots.console import SpectatorCamera, SpectatorConsole
from usarmjx.server.network.access import EVERYBODY, AccessRules, parse_address
from usarmjx.server.network.gate import Gate
from usarmjx.server.network.ports import bound_socket
from usarmjx.server.network.web_gate import FROM_ELSEWHERE, is_own_page, listen_for_websockets
from usarmjx.server.pictures.render_thread import RenderThread, ViewImages
from usarmjx.server.pictures.spectator import Spectator, read_message
from usarmjx.server.pictures.views import CompositeView
from usarmjx.server.protocol.images import jpeg
from usarmjx.server.runtime.logs import LogTail
from usarmjx.server.worlds.served_world import ServedWorld

if TYPE_CHECKING:
    from usarmjx.view.controls import WorldControls

log = logging.getLogger(__name__)

PAGE = Path(__file__).with_name("spectator.html")
MAX_MESSAGE_SIZE = 1024
"""Longest message of a page [bytes]."""
MANY_PICTURES = 20
"""How many a second there are is told of the last so many."""
FORMAT = 2
"""Type of the pictures, see `images.FORMATS`: good."""


@dataclass(frozen=True)
class SpectatorSettings:
    """How to show the world.

    Attributes:
        host: Address to bind; loopback by default.
        port: TCP port; 0 picks a free one.
        size: Width and height of the pictures [pixels].
        fps: Most pictures per second of real time for each page.
        max_connections: Most pages at once.
        idle_timeout: A page that asks for no picture for so long is closed; one that is open does [s].
        access: Who may connect.
        names: What browsers may call this server, beside localhost and its IP addresses.
    """

    host: str = "127.0.0.1"
    port: int = 5005
    size: tuple[int, int] = (320, 240)
    fps: float = 20.0
    max_connections: int = 8
    idle_timeout: float = 60.0
    access: AccessRules = EVERYBODY
    names: tuple[str, ...] = ()


@dataclass(eq=False)
class Page:
    """A page that is open.

    Attributes:
        socket: Its connection.
        spectator: What it looks at.
        ready: Whether it waits for a picture.
        due: When it gets the next one at the earliest [s].
        idle_since: Since when it has asked for nothing [s]; infinite while it waits for a picture.
        shown: When it got the last pictures [s].
    """

    socket: ServerConnection
    spectator: Spectator
    ready: bool = False
    due: float = field(default_factory=time.monotonic)
    idle_since: float = field(default_factory=time.monotonic)
    shown: deque[float] = field(default_factory=lambda: deque(maxlen=MANY_PICTURES))

    def camera(self) -> SpectatorCamera | None:
        """Return from where it looks now; None: from several places."""
        eye = self.spectator.eye()
        if eye is None:
            return None
        spent = self.shown[-1] - self.shown[0] if self.shown else 0.0
        rate = (len(self.shown) - 1) / spent if spent else 0.0
        return SpectatorCamera(*eye, rate, self.spectator.caption())


class SpectatorServer:
    """A `net.Service`.

    Args:
        world: The served world.
        settings: How to show it.
        bound: A socket that is bound to the port already.
        tail: The log, for the console; None: it is not kept.

    Attributes:
        port: The port in use, once started.
        controls: What pauses the world; None: nothing does.
        number: The world's number among those of `controls`.
    """

    def __init__(
        self,
        world: ServedWorld,
        settings: SpectatorSettings,
        bound: socket.socket | None = None,
        tail: LogTail | None = None,
    ) -> None:
        self._world, self._settings, self._bound, self._tail = world, settings, bound, tail
        self.controls: WorldControls | None = None
        self.number = 0
        self._pages: list[Page] = []
        self._gate = Gate(settings.access, settings.max_connections, "pages")
        self._render_thread = RenderThread(world)
        self._stepped = asyncio.Event()
        self._server: Server | None = None
        self.port = settings.port

    async def start(self) -> list[str]:
        """Listen; return lines for the user.

        Raises:
            UsageError: The port is taken or the address is not ours.
        """
        host = self._settings.host
        bound = self._bound or bound_socket(host, self._settings.port)
        self.port = bound.getsockname()[1]
        names = {host, *self._settings.names}
        self._server = await listen_for_websockets(
            self._accept, bound, names, self._gate, _answer, MAX_MESSAGE_SIZE
        )
        return [f"watch at http://{host}:{self.port}/{'?token=...' if self._settings.access.token else ''}"]

    def tick(self) -> None:
        """The world has made a control step."""
        self._stepped.set()
        self._stepped.clear()
        now = time.monotonic()
        for page in self._pages:
            if now - page.idle_since > self._settings.idle_timeout:
                log.info("%s: dropped, it does not look", page.socket.remote_address)
                page.socket.transport.abort()
        waiting = [page for page in self._pages if page.ready and now >= page.due]
        if waiting and self._render_thread.is_ready(now):
            self._render_thread.begin(self._show(waiting, now))

    def stop(self) -> None:
        """Close all connections."""
        if self._server is not None:
            self._server.close()
        self._render_thread.close()

    async def _show(self, pages: Sequence[Page], now: float) -> None:
        views = {page: page.spectator.view() for page in pages}
        captions = {page: page.spectator.caption() for page in pages}
        for page in pages:
            page.ready, page.due = False, now + 1 / self._settings.fps
        shown = round(self._world.time, 2)
        try:
            jpegs = await self._render_thread.render(views.values(), partial(_jpegs, list(views.values())))
        except Exception:
            for page in pages:
                await page.socket.close(1011, "no picture could be taken")
            raise
        for page, picture in zip(pages, jpegs, strict=True):
            with contextlib.suppress(ConnectionClosed):
                await page.socket.send(json.dumps({"caption": captions[page], "time": shown}))
                await page.socket.send(picture)
                page.idle_since = time.monotonic()
                page.shown.append(page.idle_since)

    def _console(self, page: Page) -> SpectatorConsole:
        """Return the console of a page: all of it on this machine, or where a token had to be said."""
        peer = page.socket.remote_address
        is_here = bool(peer) and parse_address(peer[0]).is_loopback
        return SpectatorConsole(
            self._world,
            self.controls,
            number=self.number,
            camera=page.camera,
            tail=self._tail,
            trusted=is_here or bool(self._settings.access.token),
        )

    async def _accept(self, socket: ServerConnection) -> None:
        if len(self._pages) >= self._settings.max_connections:
            await socket.close(1013, f"{len(self._pages)} pages are open already")
            return
        page = Page(socket, Spectator(self._world, self._settings.size))
        self._pages.append(page)
        log.info("%s: watches", socket.remote_address)
        try:
            async for text in socket:
                message = read_message(text)
                page.ready |= isinstance(message, dict) and bool(message.get("ready"))
                page.idle_since = math.inf if page.ready else max(page.idle_since, time.monotonic())
                page.spectator.handle_message(message)
                if isinstance(message, dict) and isinstance(line := message.get("console"), str):
                    await socket.send(json.dumps({"console": self._console(page).run(line)}))
                await self._stepped.wait()  # a message per control step: no page may keep the world from it
        except ConnectionClosed:
            pass
        except PeerError as error:
            self._gate.refuse("{}:{}".format(*socket.remote_address[:2]), str(error))
            await socket.close(1008, str(error))
        finally:
            self._pages.remove(page)


def _jpegs(views: Sequence[CompositeView], wholes: ViewImages) -> list[bytes]:
    return [jpeg(FORMAT, wholes[view]) for view in views]


def _answer(connection: ServerConnection, request: Request) -> Response | None:
    """Return the page; None where a connection for pictures begins, which pages from elsewhere do not get."""
    if request.path == "/":
        response = connection.respond(HTTPStatus.OK, PAGE.read_text(encoding="utf-8"))
        del response.headers["Content-Type"]
        response.headers["Content-Type"] = "text/html; charset=utf-8"
        return response
    if request.path != "/view":
        return connection.respond(HTTPStatus.NOT_FOUND, "there is / and /view\n")
    if not is_own_page(request):
        return connection.respond(HTTPStatus.FORBIDDEN, FROM_ELSEWHERE)
    if "websocket" not in ",".join(request.headers.get_all("Upgrade")).lower():
        return connection.respond(HTTPStatus.UPGRADE_REQUIRED, "/view is for websockets\n")
    return None
