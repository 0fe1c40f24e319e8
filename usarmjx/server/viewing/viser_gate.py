"""Viser's server behind a gate: viser listens by itself, and takes no socket, token or limits."""

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

from usarmjx.server.network.gate import Gate
from usarmjx.server.network.web_gate import (
    FROM_ELSEWHERE,
    RequestAnswer,
    asking_token,
    for_own_names,
    gated_connection,
    is_own_page,
)
from usarmjx.view.page import make_viser_server

MAX_MESSAGE_SIZE = 64 * 1024
"""Longest message of a page [bytes]."""
MAX_RATE, MAX_BURST = 200.0, 400.0
"""Messages per second of a page, and burst; further messages wait."""
NO_MESSAGE = "it sent what no page sends"
"""Reason for which a connection is closed."""
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
"""Content security policy: the page talks to this server only, and no other page can embed it."""
_start_lock = threading.Lock()


def gated_viser(bound: socket.socket, host: str, gate: Gate, names: Collection[str]) -> viser.ViserServer:
    """Return a viser server that listens on a socket, for peers that a gate admits.

    Args:
        bound: The socket, bound.
        host: The name or address that it was bound to.
        gate: Admits connections.
        names: Names of the server beside localhost, see `web_gate.for_own_names`.

    Raises:
        RuntimeError: Viser does not start in the known way.
    """
    served: list[object] = []
    made = threading.Event()
    create_connection = _measured_connection(gate)

    # Viser calls websockets.asyncio.server.serve with a host and port of its own; it takes no socket.
    def gated_serve(handler: Any, _host: str, _port: int, **options: Any) -> object:  # noqa: ANN401 - viser's
        answer = _bounded(gate, _secured(options.pop("process_request")))
        # Names first: a rebound name must not learn whether a token is right.
        options["process_request"] = for_own_names({host, *names}, asking_token(gate, answer))
        options |= {"sock": bound, "max_size": MAX_MESSAGE_SIZE, "create_connection": create_connection}
        server = serve(_guarded(handler, gate, made), **options)
        served.append(server)
        return server

    # Only what viser uses of the module: any other use fails at once, and does not pass by the gate.
    stand_in = SimpleNamespace(
        asyncio=SimpleNamespace(server=SimpleNamespace(serve=gated_serve, ServerConnection=ServerConnection)),
        exceptions=websockets.exceptions,
        datastructures=websockets.datastructures,
    )
    # The module's name is replaced for a moment, so two starts must not overlap.
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


def _guarded(handler: Any, gate: Gate, made: threading.Event) -> Any:  # noqa: ANN401 - viser's own
    """Return a handler that waits for viser, and ends connections whose messages viser cannot read.

    Viser listens before all of it is constructed. A message that is none, or nested, raises an error of any
    kind in it, which would be a traceback in the log for each such connection.
    """

    async def handle(connection: ServerConnection) -> None:
        # Polled: the event is of another thread, and the loop must not block on it.
        while not made.is_set():
            await asyncio.sleep(0.01)
        try:
            await handler(connection)
        except websockets.exceptions.ConnectionClosed:
            raise
        except Exception as error:
            peer = connection.remote_address
            gate.refuse(str(peer[0]) if peer else "", f"{NO_MESSAGE} ({type(error).__name__})")
            # 1008 stands for a violation of policy (RFC 6455, 7.4.1).
            await connection.close(1008, NO_MESSAGE)

    return handle


def _secured(answer: RequestAnswer) -> RequestAnswer:
    """Return a handler with security headers in its answers."""

    def answer_secured(connection: ServerConnection, request: Request) -> Response | None:
        response = answer(connection, request)
        if response is not None:
            response.headers["Content-Security-Policy"] = POLICY
            response.headers["X-Content-Type-Options"] = "nosniff"
        return response

    return answer_secured


def _bounded(gate: Gate, answer: RequestAnswer) -> RequestAnswer:
    """Return a handler that refuses foreign pages, and all requests when the port is full."""

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
    """Return the class of connections that a gate admits, with a bounded rate of messages."""

    class MeasuredConnection(gated_connection(gate)):
        async def recv(self, decode: bool | None = None) -> Any:  # noqa: ANN401 - text or bytes
            # Made at the first message: websockets makes the object, with arguments of its own.
            if not hasattr(self, "_rate"):
                self._rate = MessageRate(time.monotonic())
            await asyncio.sleep(self._rate.pause(time.monotonic()))
            return await super().recv(decode)

    return MeasuredConnection


class MessageRate:
    """Token bucket of one connection's messages.

    Args:
        now: The time [s].
    """

    def __init__(self, now: float) -> None:
        self._credit, self._since = MAX_BURST, now

    def pause(self, now: float) -> float:
        """Return the delay of the next message [s]."""
        # The credit may fall below 0: a message in advance makes the next one wait longer.
        self._credit = min(MAX_BURST, self._credit + (now - self._since) * MAX_RATE) - 1.0
        self._since = now
        return max(0.0, -self._credit / MAX_RATE)
