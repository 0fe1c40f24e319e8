"""The options of commands that show worlds on the live page, and what they make of them."""

import contextlib
import socket
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from usarmjx.base.errors import UsageError
from usarmjx.server.ports import LAST_PORT, VIEWER_PORT, bound_socket

if TYPE_CHECKING:
    import viser

    from usarmjx.comms.attenuation import RadioSettings
    from usarmjx.server.access import AccessRules
    from usarmjx.server.net import BotServer
    from usarmjx.server.viewing.viewer_service import ViewerService

ViewerOption = Annotated[
    bool, typer.Option("--viewer/--no-viewer", help="Show the worlds in three dimensions, in a browser.")
]
ViewOption = Annotated[
    bool, typer.Option("--view", help="Show what happens in three dimensions, in a browser.")
]
ViewerPortOption = Annotated[
    int | None,
    typer.Option(
        min=0,
        max=LAST_PORT,
        help=f"Port of that page (0: a free one); else {VIEWER_PORT}, or a free one if that is taken.",
    ),
]


@contextlib.contextmanager
def viewer_socket(host: str, port: int | None, offset: int, wanted: bool) -> Iterator[socket.socket | None]:
    """Take the port of the live page, moved by the offset unless it is 0.

    Args:
        host: Address to listen on.
        port: Its port; None: the usual one, or a free one where that is taken.
        offset: What is added to it.
        wanted: Whether there is to be a page.

    Yields:
        The bound socket, which is closed in the end; None without a page.

    Raises:
        UsageError: It is taken, or there is no such port.
    """
    if not wanted:
        yield None
        return
    number = VIEWER_PORT if port is None else port
    number = number + offset if number else 0
    if number > LAST_PORT:
        raise UsageError(f"--viewer-port leads to port {number}; the last one is {LAST_PORT}")
    try:
        bound = bound_socket(host, number, "--viewer-port")
    except UsageError:
        if port is not None:
            raise
        bound = bound_socket(host, 0, "--viewer-port")
    with bound:
        yield bound


def viewer_server(
    bound: socket.socket, host: str, rules: "AccessRules | None" = None, names: Sequence[str] = ()
) -> "viser.ViserServer":
    """Return a server for a page of its own at a socket, and tell the user where it is.

    Args:
        bound: Where the page is.
        host: What its port was bound to.
        rules: Who may look; None: anybody who can connect.
        names: What browsers may call the server, as typed.
    """
    from usarmjx.server.access import EVERYBODY
    from usarmjx.server.gate import Gate
    from usarmjx.server.host_names import check_names
    from usarmjx.server.viewing.front import gated_viser
    from usarmjx.server.viewing.viewer_service import ViewerSettings, page_address

    settings = ViewerSettings(host, access=rules or EVERYBODY, names=check_names(names))
    gate = Gate(settings.access, settings.max_connections, "viewers")
    server = gated_viser(bound, host, gate, settings.names)
    typer.echo(f"usarmjx: {page_address(settings, bound.getsockname()[1])}")
    return server


def add_viewer(
    servers: "Sequence[BotServer]",
    bound: socket.socket,
    host: str,
    rules: "AccessRules",
    names: Sequence[str],
    radio: "RadioSettings | None",
) -> "ViewerService":
    """Let the worlds of servers be shown on one page at a socket; return what serves it.

    Args:
        servers: The servers.
        bound: Where the page is.
        host: What its port was bound to.
        rules: Who may look.
        names: What browsers may call the server, as typed.
        radio: The radio's constants; None: there is none.
    """
    from usarmjx.server.host_names import check_names
    from usarmjx.server.viewing.served_source import ServedSource
    from usarmjx.server.viewing.viewer_service import ViewerService, ViewerSettings

    worlds = [server.world for server in servers]
    settings = ViewerSettings(host, access=rules, names=check_names(names))
    service = ViewerService(ServedSource(worlds, radio), settings, bound)
    servers[-1].services.append(service)
    return service
