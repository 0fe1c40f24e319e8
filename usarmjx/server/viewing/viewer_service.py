"""The live page of served worlds: it costs nothing until a browser opens it."""

import asyncio
import logging
import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from usarmjx.base.settings import AT_LEAST_ONE, validate
from usarmjx.server.network.access import EVERYBODY, AccessRules
from usarmjx.server.network.gate import Gate
from usarmjx.server.network.ports import PORT, bound_socket, keep_reserve

if TYPE_CHECKING:
    import viser

    from usarmjx.view.drawing import FrameSource
    from usarmjx.view.page import ViewerPage

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ViewerSettings:
    """Settings of the live page's server.

    Attributes:
        host: Address to listen on.
        port: Port to listen on; 0: a free one.
        max_connections: Most connections of browsers at once; an open page has one.
        access: Rules of access.
        names: Names of this server for browsers, beside localhost and its IP addresses.
        control: Whether every user of the page may have its controls, see `controls.control_lock`.
    """

    host: str = "127.0.0.1"
    port: Annotated[int, PORT] = 0
    max_connections: Annotated[int, AT_LEAST_ONE] = 16
    access: AccessRules = EVERYBODY
    names: tuple[str, ...] = ()
    control: bool = False

    def __post_init__(self) -> None:
        """Check the settings."""
        validate(self)


class ViewerService:
    """The live page, made at the first request of a browser; a `gamebots.server.Service`.

    Args:
        source: Source of the frames; called in the server's loop.
        settings: Settings of the server.
        bound: A socket that is bound to the port already.
        make_page: Makes the page from viser's server, in the server's loop; None: a page of the source alone.

    Attributes:
        page: The page; None before the first request.
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
        keep_reserve(self._bound)
        # Nobody accepts yet: the first connection waits in the backlog, wakes `_open`, and viser accepts it.
        self._bound.listen()
        self._bound.setblocking(False)
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(self._bound, self._open)
        return [page_address(self._settings, self.port)]

    def tick(self) -> None:
        """Update the page, if there is one."""
        # Made in the loop's thread: the page reads the worlds.
        if self.page is None and self._server is not None:
            self.page = self._new_page(self._server)
        if self.page is not None:
            self.page.update()

    def stop(self) -> None:
        """Close all connections."""
        self._stopped = True
        self._unwatch()
        # Viser starts in that thread; closing the socket under it would leave it half open.
        if self._opener is not None:
            self._opener.join()
        # One owner closes the socket: the page, viser, or nobody yet.
        if self.page is not None:
            self.page.close()
        elif self._server is not None:
            self._server.stop()
        elif self._bound is not None:
            self._bound.close()

    def _open(self) -> None:
        """Start viser in a thread after the first request: the worlds must not wait for it."""
        # At once: the connection stays in the backlog, and would wake the loop again and again.
        self._unwatch()
        self._opener = threading.Thread(target=self._start_server, name="viewer", daemon=True)
        self._opener.start()

    def _unwatch(self) -> None:
        # A closed socket has the number -1, which the loop refuses.
        if self._loop is not None and self._bound is not None and self._bound.fileno() >= 0:
            self._loop.remove_reader(self._bound)

    def _start_server(self) -> None:
        assert self._bound is not None
        try:
            # Viser takes a second to import: therefore here, in the thread, with `view.page`.
            from usarmjx.server.viewing.viser_gate import gated_viser

            self._server = gated_viser(self._bound, self._settings.host, self._gate, self._settings.names)
        except Exception:
            log.exception("the page for viewers cannot be served")
            self._bound.close()

    def _new_page(self, server: "viser.ViserServer") -> "ViewerPage":
        from usarmjx.view.page import ViewerPage

        return ViewerPage(self.source, server=server) if self._make_page is None else self._make_page(server)


def page_address(settings: ViewerSettings, port: int) -> str:
    """Return the address of a page as a line for the user."""
    # IPv6 needs brackets in an address of a page (RFC 3986, 3.2.2).
    shown = f"[{settings.host}]" if ":" in settings.host else settings.host
    # Not the token itself: lines for the user end in logs that are passed on.
    return f"see it at http://{shown}:{port}/{'?token=...' if settings.access.token else ''}"
