"""Listening for websockets behind the gate of a port and its token."""

import socket
from collections.abc import Awaitable, Callable, Collection
from typing import TypeAlias

from websockets.asyncio.server import Server, ServerConnection, serve

from usarmjx.base.errors import UsageError
from usarmjx.server.gate import Gate
from usarmjx.server.host_names import for_own_names
from usarmjx.server.web_gate import RequestAnswer, asking_token, gated_connection

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
    """Listen on a bound socket for browsers and programs that ask for us by name and say the token.

    Args:
        accept: Serves a websocket.
        bound: The socket; closed if this fails.
        names: The names that are ours.
        gate: Of the port.
        answer: Answers requests over HTTP; None lets a websocket begin.
        max_size: Of a message [bytes].

    Raises:
        UsageError: The port is taken or the address is not ours.
    """
    try:
        return await serve(
            accept,
            sock=bound,
            process_request=for_own_names(names, asking_token(gate, answer)),
            create_connection=gated_connection(gate),
            max_size=max_size,
            compression=None,
        )
    except OSError as error:
        host, port = bound.getsockname()[:2]
        bound.close()
        raise UsageError(f"cannot listen on {host}:{port}: {error}") from error
