"""The gate of a port for browsers: they say the token in an address once, and by a cookie from then on."""

import asyncio
from collections.abc import Callable
from dataclasses import replace
from http import HTTPStatus
from typing import TypeAlias
from urllib.parse import unquote

from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from usarmjx.server.gate import Gate, keep_alive

RequestAnswer: TypeAlias = Callable[[ServerConnection, Request], Response | None]
"""Answers a request over HTTP; None lets a websocket begin."""

COOKIE = "usarmjx"
"""Name of the cookie."""
TOKEN_QUERY = "token="
"""What comes before the token in an address."""
NO_TOKEN = "this server asks for its token: open /?token=...\n"
FROM_ELSEWHERE = "this page is from elsewhere\n"


def gated_connection(gate: Gate) -> type[ServerConnection]:
    """Return the class of connections that a gate lets in: others are closed before anything is read."""

    class GatedConnection(ServerConnection):
        _entered = ""

        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            peer = transport.get_extra_info("peername")
            address = str(peer[0]) if peer else ""
            if gate.enter(address):
                self._entered = address
                keep_alive(transport.get_extra_info("socket"))
                super().connection_made(transport)
            elif isinstance(transport, asyncio.Transport):
                transport.abort()

        def connection_lost(self, exc: Exception | None) -> None:
            if self._entered:
                gate.leave(self._entered)
                super().connection_lost(exc)

    return GatedConnection


def asking_token(gate: Gate, answer: RequestAnswer) -> RequestAnswer:
    """Return what refuses requests without the token or its cookie, and leaves the others to another one.

    Args:
        gate: Knows the token; if none is asked for, nobody is refused.
        answer: Answers the others; it does not get to see the token.
    """

    def answer_known(connection: ServerConnection, request: Request) -> Response | None:
        path, _, query = request.path.partition("?")
        given = next((part for part in query.split("&") if part.startswith(TOKEN_QUERY)), "")
        said = gate.rules.knows(unquote(given.removeprefix(TOKEN_QUERY)))
        if gate.rules.token and not said and not any(map(gate.rules.knows_cookie, _cookies(request))):
            peer = connection.remote_address
            gate.refuse(str(peer[0]) if peer else "", "a wrong token" if given else "no token")
            return connection.respond(HTTPStatus.FORBIDDEN, NO_TOKEN)
        response = answer(connection, replace(request, path=path))
        if said and response is not None:
            cookie = f"{COOKIE}={gate.rules.cookie}; Path=/; HttpOnly; SameSite=Strict"
            response.headers["Set-Cookie"] = cookie
            response.headers["Referrer-Policy"] = "no-referrer"
            response.headers["Cache-Control"] = "no-store"
        return response

    return answer_known


def is_own_page(request: Request) -> bool:
    """Return whether a request is no page's from elsewhere: browsers say where a page is that asks.

    There is one Host header: `host_names.for_own_names` has seen to that.
    """
    host = request.headers.get_all("Host")
    return all([origin.partition("://")[2]] == host for origin in request.headers.get_all("Origin"))


def _cookies(request: Request) -> list[str]:
    """Return the values of all cookies of our name."""
    texts = (text for line in request.headers.get_all("Cookie") for text in line.split(";"))
    pairs = (text.strip().partition("=") for text in texts)
    return [value for name, _, value in pairs if name == COOKIE]
