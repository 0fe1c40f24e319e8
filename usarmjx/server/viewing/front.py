"""Viser behind our gate: its page obeys `--allow`, `--token` and `--allow-host` as all other ports do.

Viser has no hook for any of that, so it gets another `serve` of the websockets library while it starts: one
that listens on our socket, lets in whom our gate lets in, and asks for the token, for names that are ours and
for pages that are ours. Should viser ever start in another way, nothing is served at all.
"""

import asyncio
import socket
import threading
import time
from collections.abc import Collection
from http import HTTPStatus
from types import SimpleNamespace
from typing import Any

import viser
import viser.infra._infra as viser_infra
import websockets
from websockets.asyncio.server import ServerConnection, serve
from websockets.http11 import Request, Response

from usarmjx.server.gate import Gate
from usarmjx.server.host_names import for_own_names
from usarmjx.server.web_gate import FROM_ELSEWHERE, RequestAnswer, asking_token, gated_connection, is_own_page
from usarmjx.view.viser_server import make_viser_server

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
