"""Gate of a port for browsers: host names, and the token, once in the address and then by a cookie."""

import asyncio
import re
import socket
from collections.abc import Awaitable, Callable, Collection
from dataclasses import replace
from http import HTTPStatus
from typing import Any, TypeAlias
from urllib.parse import unquote

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.http11 import Request, Response
from websockets.protocol import State

from usarmjx.base.errors import UsageError
from usarmjx.server.network.access import parse_address
from usarmjx.server.network.gate import Gate, keep_alive
from usarmjx.server.network.ports import keep_reserve
from usarmjx.server.protocol.grammar import clip
from usarmjx.server.runtime.logs import limit_libraries

RequestAnswer: TypeAlias = Callable[[ServerConnection, Request], Response | None]
"""Answers a request over HTTP; None lets a websocket begin."""

READ_SIZE = 2048
"""Most bytes that are read at once."""
MAX_REQUEST_LINE = 8192
"""Bytes within which the first line of a request ends."""
COOKIE = "usarmjx"
"""Name of the cookie."""
TOKEN_QUERY = "token="
"""Text before the token in an address."""
MAX_QUEUE = 4
"""Messages of a client that are read ahead of its turn."""
NO_TOKEN = "this server asks for its token: open /?token=...\n"
FROM_ELSEWHERE = "this page is from elsewhere\n"
LOCALHOST = re.compile(r"(?:.+\.)?localhost")
"""Names that always mean the browser's own machine, never a site."""
_HOST = re.compile(r"(?:\[([0-9a-f:.]+)\]|([a-z0-9._-]+))(?::[0-9]+)?", re.IGNORECASE)
_NAME = re.compile(r"[a-z0-9._-]+|[0-9a-f:.]+", re.IGNORECASE)


class _CurrentHttpConnection(ServerConnection, asyncio.BufferedProtocol):
    """Connection that takes requests of HTTP/1.0, too, and reads little at a time.

    A quarter of a megabyte, which asyncio reads at once, has a hundred thousand frames.
    """

    _head: bytes | None = b""
    _buffer: bytearray | None = None

    def get_buffer(self, sizehint: int) -> bytearray:
        """Return the room for the next bytes."""
        del sizehint
        # One buffer for the connection: its bytes are copied out before the next ones come.
        self._buffer = self._buffer or bytearray(READ_SIZE)
        return self._buffer

    def buffer_updated(self, nbytes: int) -> None:
        """Take the bytes that have come."""
        assert self._buffer is not None
        self.data_received(bytes(self._buffer[:nbytes]))

    def data_received(self, data: bytes) -> None:
        if self._head is not None:  # the request line has not come yet
            self._head += data
            # The version stands at the end of the request line, which may come in pieces.
            if b"\n" not in self._head and len(self._head) < MAX_REQUEST_LINE:
                return
            data, self._head = as_current_http(self._head), None
        super().data_received(data)


def gated_connection(gate: Gate) -> type[ServerConnection]:
    """Return the class of connections that a gate admits: others are closed before anything is read."""

    class GatedConnection(_CurrentHttpConnection):
        _entered = ""

        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            peer = transport.get_extra_info("peername")
            address = str(peer[0]) if peer else ""
            if gate.enter(address):
                self._entered = address
                keep_alive(transport.get_extra_info("socket"))
                if isinstance(transport, asyncio.WriteTransport):
                    gate.add_stranger(transport)
                super().connection_made(transport)
            elif isinstance(transport, asyncio.Transport):
                transport.abort()

        async def handshake(self, *options: Any, **more: Any) -> None:  # noqa: ANN401 - websockets' own
            await super().handshake(*options, **more)
            # An answered HTTP request is no websocket: it stays a stranger until it closes.
            if self.protocol.state is State.OPEN:
                gate.remove_stranger(self.transport)

        def connection_lost(self, exc: Exception | None) -> None:
            if self._entered:
                gate.leave(self._entered)
                gate.remove_stranger(self.transport)
                super().connection_lost(exc)

    return GatedConnection


def as_current_http(head: bytes) -> bytes:
    """Return the beginning of a request with HTTP/1.1 in place of HTTP/1.0.

    Proxies and `ab` send HTTP/1.0, which websockets refuses with a traceback. The answers close the
    connection, as clients of HTTP/1.0 expect.
    """
    line, end, rest = head.partition(b"\n")
    if line.rstrip(b"\r").endswith(b" HTTP/1.0"):
        line = line.replace(b" HTTP/1.0", b" HTTP/1.1")
    return line + end + rest


def asking_token(gate: Gate, answer: RequestAnswer) -> RequestAnswer:
    """Return a handler that refuses requests without the token or its cookie, and passes the others on.

    Args:
        gate: Has the token; if none is required, no request is refused.
        answer: Answers the others; it does not see the token.
    """

    def answer_known(connection: ServerConnection, request: Request) -> Response | None:
        # The token is cut off here: the answer, its logs and its links see the path alone.
        path, _, query = request.path.partition("?")
        given = next((part for part in query.split("&") if part.startswith(TOKEN_QUERY)), "")
        has_token = gate.rules.knows(unquote(given.removeprefix(TOKEN_QUERY)))
        if gate.rules.token and not has_token and not any(map(gate.rules.knows_cookie, _cookies(request))):
            peer = connection.remote_address
            gate.refuse(str(peer[0]) if peer else "", "a wrong token" if given else "no token")
            return connection.respond(HTTPStatus.FORBIDDEN, NO_TOKEN)
        response = answer(connection, replace(request, path=path))
        if has_token and response is not None:
            # The address with the token must not stay in a cache, nor travel on as a referrer.
            # Not Secure, either: pages come over plain HTTP, where browsers refuse such a cookie from afar.
            cookie = f"{COOKIE}={gate.rules.cookie}; Path=/; HttpOnly; SameSite=Strict"
            response.headers["Set-Cookie"] = cookie
            response.headers["Referrer-Policy"] = "no-referrer"
            response.headers["Cache-Control"] = "no-store"
        return response

    return answer_known


def is_own_page(request: Request) -> bool:
    """Return whether a request comes from a page of this server, or from no page (no Origin header).

    Browsers add the Origin of the page; `for_own_names` has checked that there is one Host header.
    """
    host = request.headers.get_all("Host")
    # A page of a foreign scheme may name the same host and port: only that part is compared.
    return all([origin.partition("://")[2]] == host for origin in request.headers.get_all("Origin"))


def _cookies(request: Request) -> list[str]:
    """Return the values of all cookies of our name."""
    texts = (text for line in request.headers.get_all("Cookie") for text in line.split(";"))
    pairs = (text.strip().partition("=") for text in texts)
    return [value for name, _, value in pairs if name == COOKIE]


def check_names(names: Collection[str], option: str = "--allow-host") -> tuple[str, ...]:
    """Return the names of an option in their compared form.

    Raises:
        UsageError: One is no host name and no IP address.
    """
    for name in names:
        if not _NAME.fullmatch(name):
            wanted = "expected a name or IP address alone, as sim.example.org"
            raise UsageError(f"{option}: {name!r} is no host; {wanted}")
    return tuple(map(_plain, names))


def is_own_name(host: str, names: Collection[str]) -> bool:
    """Return whether a Host header names this server.

    Args:
        host: The header, with or without a port.
        names: Its names beside `LOCALHOST`: names and IP addresses, as from `check_names`.
    """
    found = _HOST.fullmatch(host)
    name = _plain(found[1] or found[2]) if found else ""
    return name in names or LOCALHOST.fullmatch(name) is not None


def for_own_names(names: Collection[str], answer: RequestAnswer) -> RequestAnswer:
    """Return a handler that refuses requests under foreign names, and passes the others on.

    It protects against DNS rebinding: a site may point its own name at this machine, and its page then counts
    as ours for the browser.

    Args:
        names: Names of the server beside `LOCALHOST` and the IP address of the connection's own end.
        answer: Answers the others.
    """
    names = {_plain(name) for name in names}

    def answer_own(connection: ServerConnection, request: Request) -> Response | None:
        hosts, here = request.headers.get_all("Host"), connection.local_address
        own = {*names, _plain(str(here[0]))} if here else set(names)
        if len(hosts) == 1 and is_own_name(hosts[0], own):
            return answer(connection, request)
        reason = f"not served under the name {clip(', '.join(hosts))}; --allow-host NAME allows one\n"
        return connection.respond(HTTPStatus.FORBIDDEN, reason)

    return answer_own


def _plain(name: str) -> str:
    """Return a name or IP address in its compared form."""
    try:
        return str(parse_address(name))
    except ValueError:
        return name.lower().removesuffix(".")


Accept: TypeAlias = Callable[[ServerConnection], Awaitable[None]]
"""Serves a websocket until it ends."""


async def listen_for_websockets(
    accept: Accept,
    bound: socket.socket,
    names: Collection[str],
    gate: Gate,
    answer: RequestAnswer,
    max_size: int,
) -> Server:
    """Listen on a bound socket for browsers and programs that use one of our names and send the token.

    Args:
        accept: Serves a websocket.
        bound: The socket; closed if this fails.
        names: The names that are ours.
        gate: Gate of the port.
        answer: Answers requests over HTTP; None lets a websocket begin.
        max_size: Longest message [bytes].

    Raises:
        UsageError: The port is taken or the address is not ours.
    """
    limit_libraries()
    keep_reserve(bound)
    try:
        return await serve(
            accept,
            sock=bound,
            # Names first: a rebound name must not learn whether a token is right.
            process_request=for_own_names(names, asking_token(gate, answer)),
            create_connection=gated_connection(gate),
            max_size=max_size,
            # Compression costs processor time of the loop, and memory for each connection.
            compression=None,
            max_queue=MAX_QUEUE,
        )
    except OSError as error:
        host, port = bound.getsockname()[:2]
        bound.close()
        raise UsageError(f"cannot listen on {host}:{port}: {error}") from error
