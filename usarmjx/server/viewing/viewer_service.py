"""The live page of the worlds that are served: it costs nothing until somebody opens it."""

import asyncio
import logging
import socket
import threading
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from http import HTTPStatus
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import viser
import viser.infra._infra as viser_infra
import websockets
from websockets.asyncio.server import ServerConnection, serve
from websockets.http11 import Request, Response

from usarmjx.comms.attenuation import RadioSettings
from usarmjx.comms.links import Links
from usarmjx.server.network.access import EVERYBODY, AccessRules
from usarmjx.server.network.gate import Gate
from usarmjx.server.network.ports import bound_socket
from usarmjx.server.network.web_gate import (
    FROM_ELSEWHERE,
    RequestAnswer,
    asking_token,
    for_own_names,
    gated_connection,
    is_own_page,
)
from usarmjx.server.worlds.policy_world import PolicyWorld
from usarmjx.server.worlds.served_world import ServedWorld
from usarmjx.view.capture import Capture
from usarmjx.view.drawing import MAP_GRID, MAP_PREFIX, Drawing, Frame
from usarmjx.view.page import make_viser_server

if TYPE_CHECKING:
    import viser

    from usarmjx.view.drawing import FrameSource
    from usarmjx.view.page import ViewerPage


MAX_MESSAGE_SIZE = 64 * 1024
"""Longest message of a page [bytes]."""
MAX_RATE, MAX_BURST = 200.0, 400.0
"""A page may say so much in a second, and so much at once; what is more waits [messages]."""
POLICY = "; ".join(
    [
        "default-src 'self' 'unsafe-inline' data: blob:",
        "script-src 'self' 'unsafe-inline' 'unsafe-eval' blob: data:",
        "connect-src 'self' data: blob:",
        "worker-src 'self' blob: data:",
        "frame-ancestors 'none'",
        "form-action 'none'",
        "base-uri 'none'",
    ]
)
"""What browsers let the page do: it asks nobody but us for anything, and no other page can hold it."""
_start_lock = threading.Lock()


def gated_viser(bound: socket.socket, host: str, gate: Gate, names: Collection[str]) -> viser.ViserServer:
    """Return a server of viser's that listens on a socket, for those only whom a gate lets in.

    Args:
        bound: The socket, bound.
        host: The name or address that it was bound to.
        gate: Who may connect.
        names: What the server is called beside localhost, see `host_names`.

    Raises:
        RuntimeError: Viser does not start as we know it.
    """
    served: list[object] = []
    made = threading.Event()
    create_connection = _measured_connection(gate)

    def gated_serve(handler: Any, _host: str, _port: int, **options: Any) -> object:  # noqa: ANN401 - viser's own
        answer = _bounded(gate, _secured(options.pop("process_request")))
        options["process_request"] = for_own_names({host, *names}, asking_token(gate, answer))
        options |= {"sock": bound, "max_size": MAX_MESSAGE_SIZE, "create_connection": create_connection}
        server = serve(_once_made(handler, made), **options)
        served.append(server)
        return server

    stand_in = SimpleNamespace(
        asyncio=SimpleNamespace(server=SimpleNamespace(serve=gated_serve, ServerConnection=ServerConnection)),
        exceptions=websockets.exceptions,
        datastructures=websockets.datastructures,
    )
    with _start_lock:
        viser_infra.websockets = stand_in  # type: ignore[attr-defined]
        try:
            server = make_viser_server(host, bound.getsockname()[1])
        finally:
            viser_infra.websockets = websockets  # type: ignore[attr-defined]
    if not served:
        server.stop()
        raise RuntimeError(f"viser {viser.__version__} starts in a way that we cannot guard")
    made.set()
    return server


def _once_made(handler: Any, made: threading.Event) -> Any:  # noqa: ANN401 - viser's own
    """Return a handler whose connections wait for viser: it listens before all of it is there."""

    async def handle(connection: ServerConnection) -> None:
        while not made.is_set():
            await asyncio.sleep(0.01)
        await handler(connection)

    return handle


def _secured(answer: RequestAnswer) -> RequestAnswer:
    """Return what answers as before, and tells browsers to keep the page to itself."""

    def answer_secured(connection: ServerConnection, request: Request) -> Response | None:
        response = answer(connection, request)
        if response is not None:
            response.headers["Content-Security-Policy"] = POLICY
            response.headers["X-Content-Type-Options"] = "nosniff"
        return response

    return answer_secured


def _bounded(gate: Gate, answer: RequestAnswer) -> RequestAnswer:
    """Return what refuses pages from elsewhere, and everybody when all places are taken."""

    def answer_bounded(connection: ServerConnection, request: Request) -> Response | None:
        if gate.is_full:
            peer = connection.remote_address
            gate.refuse(str(peer[0]) if peer else "", "all places are taken")
            return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, "too many are looking already\n")
        if not is_own_page(request):
            return connection.respond(HTTPStatus.FORBIDDEN, FROM_ELSEWHERE)
        return answer(connection, request)

    return answer_bounded


def _measured_connection(gate: Gate) -> type[ServerConnection]:
    """Return the class of connections that a gate lets in, and that are heard only so often."""

    class MeasuredConnection(gated_connection(gate)):
        async def recv(self, decode: bool | None = None) -> Any:  # noqa: ANN401 - text or bytes
            if not hasattr(self, "_rate"):
                self._rate = MessageRate(time.monotonic())
            await asyncio.sleep(self._rate.pause(time.monotonic()))
            return await super().recv(decode)

    return MeasuredConnection


class MessageRate:
    """How often somebody is heard.

    Args:
        now: The time [s].
    """

    def __init__(self, now: float) -> None:
        self._credit, self._since = MAX_BURST, now

    def pause(self, now: float) -> float:
        """Return how long the next message has to wait [s]."""
        self._credit = min(MAX_BURST, self._credit + (now - self._since) * MAX_RATE) - 1.0
        self._since = now
        return max(0.0, -self._credit / MAX_RATE)


LINK_PERIOD = 0.5
"""The radio of a world that has none of its own is looked at so often [s of its time]."""


@dataclass
class _Looked:
    """What is known of a world: what it was drawn of, and its links when last looked at."""

    key: tuple[object, ...]
    capture: Capture
    drawing: Drawing
    links: Links | None = None
    links_due: float = 0.0


class ServedSource:
    """A `FrameSource` of served worlds; to be asked by the thread that runs them.

    Args:
        worlds: The worlds, in the order of their numbers.
        radio: Constants of the radio that the wireless server has; None: links are shown only where a world
            has a radio of its own.
    """

    def __init__(self, worlds: Sequence[ServedWorld], radio: RadioSettings | None = None) -> None:
        self._worlds, self._radio = worlds, radio
        self._looked: dict[int, _Looked] = {}

    @property
    def num_worlds(self) -> int:
        """How many worlds are served."""
        return len(self._worlds)

    def drawing(self, world: int) -> Drawing:
        """Return a world's drawing: another one when a robot has joined or left, or with another arena."""
        return self._look(world).drawing

    def frame(self, world: int) -> Frame:
        """Return a world as it is now."""
        looked, served = self._look(world), self._worlds[world]
        frame = looked.capture.frame(*served.one_world())
        return replace(
            frame,
            links=self._links(looked, served, frame),
            trace=served.traces.sketch(),
            score=served.score if isinstance(served, PolicyWorld) else None,
            extra=_maps(looked.drawing, served) if isinstance(served, PolicyWorld) else {},
        )

    def _look(self, world: int) -> _Looked:
        served = self._worlds[world]
        state, physics = served.one_world()
        names = {slot: robot.name for slot, robot in served.robots.items()}
        episode = 0 if state.arena_state is None else int(state.episode)
        key = served.scene, tuple(names.items()), episode, int(state.number)
        if world not in self._looked or self._looked[world].key != key:
            capture = Capture(served.scene)
            self._looked[world] = _Looked(key, capture, capture.drawing(state, physics, names))
        return self._looked[world]

    def _links(self, looked: _Looked, served: ServedWorld, frame: Frame) -> Links | None:
        if self._radio is None or frame.links is not None:
            return frame.links
        if not 0.0 <= looked.links_due - frame.time <= LINK_PERIOD:
            looked.links, looked.links_due = served.links(self._radio), frame.time + LINK_PERIOD
        return looked.links


def _maps(drawing: Drawing, world: PolicyWorld) -> dict[str, np.ndarray]:
    """Return the maps that the robots of a task are building, as `Frame.extra` has them."""
    maps = world.maps
    if maps is None:
        return {}
    named = {
        f"{MAP_PREFIX}{robot.name}": np.asarray(maps.squares[slot]) for slot, robot in drawing.robots.items()
    }
    return {MAP_GRID: np.array([*maps.low, maps.cell]), **named}


log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ViewerSettings:
    """How to serve the page.

    Attributes:
        host: Address to listen on.
        port: Port to listen on; 0: a free one.
        max_connections: Most connections of browsers at once; a page that is open has one.
        access: Who may connect.
        names: What browsers may call this server, beside localhost and its IP addresses.
        control: Whether everybody who can open the page may have its controls, see `seat`.
    """

    host: str = "127.0.0.1"
    port: int = 0
    max_connections: int = 16
    access: AccessRules = EVERYBODY
    names: tuple[str, ...] = ()
    control: bool = False


class ViewerService:
    """A `net.Service`: the page, which is made when a browser asks for it first.

    Args:
        source: What there is to see; asked in the server's loop.
        settings: How to serve it.
        bound: A socket that is bound to the port already.
        make_page: Makes the page of a server of viser's, in the server's loop; None: one that shows the
            source and no more.

    Attributes:
        page: The page; None before it is asked for.
        port: The port in use.
    """

    def __init__(
        self,
        source: "FrameSource",
        settings: ViewerSettings,
        bound: socket.socket | None = None,
        make_page: "Callable[[viser.ViserServer], ViewerPage] | None" = None,
    ) -> None:
        self.source, self._settings, self._make_page = source, settings, make_page
        self.page: ViewerPage | None = None
        self.port = settings.port
        self._bound = bound
        self._gate = Gate(settings.access, settings.max_connections, "viewers")
        self._server: viser.ViserServer | None = None
        self._opener: threading.Thread | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stopped = False

    async def start(self) -> list[str]:
        """Listen; return lines for the user.

        Raises:
            UsageError: The port is taken or the address is not ours.
        """
        host = self._settings.host
        self._bound = self._bound or bound_socket(host, self.port)
        self.port = self._bound.getsockname()[1]
        self._bound.listen()
        self._bound.setblocking(False)
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(self._bound, self._open)
        return [page_address(self._settings, self.port)]

    def tick(self) -> None:
        """The worlds have made a control step."""
        if self.page is None and self._server is not None:
            self.page = self._new_page(self._server)
        if self.page is not None:
            self.page.update()

    def stop(self) -> None:
        """Close all connections."""
        self._stopped = True
        self._unwatch()
        if self._opener is not None:
            self._opener.join()
        if self.page is not None:
            self.page.close()
        elif self._server is not None:
            self._server.stop()
        elif self._bound is not None:
            self._bound.close()

    def _open(self) -> None:
        """Start viser in a thread: somebody has asked for the page, and the worlds must not wait."""
        self._unwatch()
        self._opener = threading.Thread(target=self._start_server, name="viewer", daemon=True)
        self._opener.start()

    def _unwatch(self) -> None:
        if self._loop is not None and self._bound is not None and self._bound.fileno() >= 0:
            self._loop.remove_reader(self._bound)

    def _start_server(self) -> None:
        assert self._bound is not None
        try:
            import usarmjx.view.page  # noqa: F401 - `tick` shall not wait for it

            pass  # REMOVED_IMPORT

            self._server = gated_viser(self._bound, self._settings.host, self._gate, self._settings.names)
        except Exception:
            log.exception("the page for viewers cannot be served")
            self._bound.close()

    def _new_page(self, server: "viser.ViserServer") -> "ViewerPage":
        from usarmjx.view.page import ViewerPage

        return ViewerPage(self.source, server=server) if self._make_page is None else self._make_page(server)


def page_address(settings: ViewerSettings, port: int) -> str:
    """Return where a page is, as a line for the user."""
    shown = f"[{settings.host}]" if ":" in settings.host else settings.host
    return f"see it at http://{shown}:{port}/{'?token=...' if settings.access.token else ''}"
