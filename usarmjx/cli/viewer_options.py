"""The options of commands that show worlds on the live page, and what they make of them."""

import contextlib
import socket
from collections.abc import Generator, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Annotated

import typer

from usarmjx.base.errors import UsageError
from usarmjx.server.network.ports import LAST_PORT, VIEWER_PORT, bound_socket

if TYPE_CHECKING:
    import viser

    from usarmjx.comms.attenuation import RadioSettings
    from usarmjx.server.gamebots.server import BotServer
    from usarmjx.server.network.access import AccessRules
    from usarmjx.server.runtime.loop import StepClock
    from usarmjx.server.viewing.controls import ServedControls
    from usarmjx.server.viewing.viewer_service import ViewerSettings
    from usarmjx.view.page import ViewerPage

ViewOption = Annotated[
    bool, typer.Option("--view/--no-view", help="Show the worlds in three dimensions, in a browser.")
]
ViewerControlOption = Annotated[
    bool,
    typer.Option(
        "--viewer-control",
        help="Every visitor of the page may have its controls; else only on this machine, or with a token.",
    ),
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
def viewer_socket(host: str, port: int | None, offset: int, wanted: bool) -> Generator[socket.socket | None]:
    """Take the port of the live page, moved by the offset unless it is 0.

    Args:
        host: Address to listen on.
        port: Its port; None: the usual one, or a free one where that is taken.
        offset: Addition to it.
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
    # 0 means any free port, which an offset would turn into a fixed one.
    number = number + offset if number else 0
    if number > LAST_PORT:
        raise UsageError(f"--viewer-port leads to port {number}; the last one is {LAST_PORT}")
    try:
        bound = _listening(host, number)
    except UsageError:
        # A port that is asked for is not replaced silently.
        if port is not None:
            raise
        bound = _listening(host, 0)
    with bound:
        yield bound


def _listening(host: str, port: int) -> socket.socket:
    """Return a socket that listens: two that are only bound could share a port, until one of them listens.

    Raises:
        UsageError: The port is taken.
    """
    bound = bound_socket(host, port, "--viewer-port")
    try:
        bound.listen()
    except OSError as error:
        bound.close()
        raise UsageError(f"--viewer-port: cannot listen on {host}:{port}: {error.strerror}") from error
    return bound


def viewer_server(
    bound: socket.socket, host: str, rules: "AccessRules | None" = None, names: Sequence[str] = ()
) -> "viser.ViserServer":
    """Return a server for a page of its own at a socket, and tell the user where it is.

    Args:
        bound: Address of the page.
        host: Socket of its port.
        rules: People admitted; None: anybody who can connect.
        names: Names of the server for browsers, as typed.
    """
    from usarmjx.server.network.access import EVERYBODY
    from usarmjx.server.network.gate import Gate
    from usarmjx.server.viewing.viewer_service import page_address
    from usarmjx.server.viewing.viser_gate import gated_viser

    settings = viewer_settings(host, rules or EVERYBODY, names)
    gate = Gate(settings.access, settings.max_connections, "viewers")
    server = gated_viser(bound, host, gate, settings.names)
    typer.echo(f"usarmjx: {page_address(settings, bound.getsockname()[1])}")
    return server


def add_controls(servers: "Sequence[BotServer]", clock: "StepClock") -> "ServedControls":
    """Let people at the pages of servers control their worlds, which have one clock."""
    from usarmjx.server.viewing.controls import ServedControls

    controls = ServedControls(servers, clock)
    # To one server only: they act on the worlds of all.
    servers[0].services.append(controls)
    return controls


def add_viewer(
    servers: "Sequence[BotServer]",
    controls: "ServedControls",
    bound: socket.socket,
    settings: "ViewerSettings",
    radio: "RadioSettings | None" = None,
    layers: Sequence[str] = (),
) -> None:
    """Let the worlds of servers be shown on one page.

    Args:
        servers: The servers.
        controls: Actions allowed on their worlds.
        bound: Address of the page.
        settings: Settings of serving it.
        radio: The radio's constants; None: there is none.
        layers: Layers that are on at first beside those that always are.
    """
    from usarmjx.server.runtime.logs import keep_log
    from usarmjx.server.viewing.controls import control_lock
    from usarmjx.server.viewing.served_source import ServedSource
    from usarmjx.server.viewing.viewer_service import ViewerService

    worlds = [server.world for server in servers]
    source = ServedSource(worlds, radio)
    lock = control_lock(bound.getsockname()[0], settings.access, settings.control)
    tail = keep_log()

    def make_page(server: "viser.ViserServer") -> "ViewerPage":
        from usarmjx.server.viewing.console import ConsolePanel
        from usarmjx.server.viewing.inset import CameraInset
        from usarmjx.view.page import ViewerPage
        from usarmjx.view.user_panels import UserPanels

        title = worlds[0].arena.name
        panels = [
            partial(UserPanels, lock=lock),
            partial(CameraInset, worlds=worlds),
            partial(ConsolePanel, worlds=worlds, lock=lock, tail=tail),
        ]
        page = ViewerPage(source, title=title, controls=controls, panels=panels, server=server)
        page.show_layers(layers)
        return page

    servers[0].services.append(
        ViewerService(source, replace(settings, port=bound.getsockname()[1]), bound, make_page)
    )


def viewer_settings(
    host: str, rules: "AccessRules", names: Sequence[str], control: bool = False
) -> "ViewerSettings":
    """Return the settings of the live page's server.

    Args:
        host: Address to listen on.
        rules: People admitted.
        names: Names of the server for browsers, as typed.
        control: Whether whoever opens it may have its controls.

    Raises:
        UsageError: One of the names is none.
    """
    from usarmjx.server.network.web_gate import check_names
    from usarmjx.server.viewing.viewer_service import ViewerSettings

    return ViewerSettings(host, access=rules, names=check_names(names), control=control)
