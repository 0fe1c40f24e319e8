"""TCP ports: those of the servers of every world, and their binding before anything is built."""

import contextlib
import errno
import math
import socket
from collections.abc import Generator, Mapping, Sequence
from typing import Any
from weakref import WeakSet

from usarmjx.base.errors import UsageError
from usarmjx.base.settings import Setting

try:
    import resource
except ImportError:  # not on Windows
    resource = None

BOT_PORT = 3000
"""Default port of the Gamebots server (BotAPI.ini: ListenPort; manual 9.1)."""
WSS_PORT, WSS2_PORT, POSITION_PORT = 5874, 50000, 7435
"""Default ports of the wireless server (USARComServer.ini), the stand-alone one, and the position service."""
IMAGE_PORT = 5003
"""Default port of the image server (manual 3.2.5)."""
VIEWER_PORT = 8100
"""Default port of the live page."""
LAST_PORT = 65535
PORT = Setting(ge=0, le=LAST_PORT)
"""Limits of the number of a port."""
FIRST_DIALLED = 1024
"""Lowest port that is dialled for a client: those below are the system's."""
ACCEPTS_AT_ONCE = 2
"""Most connections that a loop accepts at a port before it does other work."""
RESERVE = 128
"""Descriptors that connections of browsers leave to robots, at most a quarter of all."""
WRONG_PORT = (errno.EADDRINUSE, errno.EACCES)
"""Errors after which another port may work."""
_bound_sockets: WeakSet[socket.socket] = WeakSet()


class ListeningSocket(socket.socket):
    """Socket that hands connections over a few at a time, although asyncio asks for a hundred.

    Attributes:
        keeps_reserve: Whether it closes connections when few descriptors are left.
    """

    keeps_reserve = False
    _count = 0

    def accept(self) -> tuple[socket.socket, Any]:
        """Accept a connection.

        Raises:
            BlockingIOError: There is none, or it is the turn of others.
        """
        # asyncio accepts in a loop until it would block; the rest comes in the next round, as epoll is
        # level-triggered.
        if self._count >= ACCEPTS_AT_ONCE:
            self._count = 0
            raise BlockingIOError(errno.EAGAIN, "others come first")
        try:
            connection, address = super().accept()
        except OSError:
            self._count = 0
            raise
        self._count += 1
        # The system gives the lowest free number.
        if self.keeps_reserve and connection.fileno() >= most_descriptors():
            connection.close()
            raise BlockingIOError(errno.EAGAIN, "the other descriptors are for robots")
        return connection, address


def keep_reserve(bound: socket.socket) -> None:
    """Make a port for browsers leave `RESERVE` descriptors to robots."""
    if isinstance(bound, ListeningSocket):
        bound.keeps_reserve = True


def most_descriptors() -> float:
    """Return the number of descriptors that connections of browsers may fill up to."""
    if resource is None:
        return math.inf
    limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    # A small limit is shared, not eaten up, by the reserve.
    return math.inf if limit == resource.RLIM_INFINITY else limit - min(RESERVE, limit // 4)


def count_up(first: Mapping[str, int], worlds: int, offset: int = 0) -> list[dict[str, int]]:
    """Return the ports of every served world, by the options that set them.

    The first world has those of the options, moved by the offset. Each further one has, of every kind, the
    next port after that of the world before it which no other server here has: with pictures from 5003 on
    and pages from 5005 on, three worlds have pictures at 5003, 5004, 5007 and pages at 5005, 5006, 5008.

    Args:
        first: The first world's ports by their options; 0, in all worlds, lets the system pick a free one.
        worlds: Number of served worlds.
        offset: Added to all ports but 0.

    Raises:
        UsageError: Two options name one port, or there is no such port.
    """
    latest = {option: port + offset if port else 0 for option, port in first.items()}
    ports, owners = [latest], dict[int, str]()
    for option, port in latest.items():
        _claim(owners, option, port)
    for _ in range(worlds - 1):
        latest = dict(latest)
        for option, port in latest.items():
            # Free ports, given as 0, never have an owner, and stay 0.
            while port in owners:
                port += 1
            _claim(owners, option, port)
            latest[option] = port
        ports.append(latest)
    return ports


def _claim(owners: dict[int, str], option: str, port: int) -> None:
    """Record the option that a port belongs to.

    Raises:
        UsageError: It belongs to another one, or there is no such port.
    """
    if port > LAST_PORT:
        raise UsageError(f"{option} leads to port {port}; the last one is {LAST_PORT}")
    if port in owners:
        raise UsageError(f"{owners[port]} and {option} both lead to port {port}")
    if port:
        owners[port] = option


@contextlib.contextmanager
def bound_ports(host: str, ports: Sequence[Mapping[str, int]]) -> Generator[list[dict[str, socket.socket]]]:
    """Bind ports; within the context connections are refused until a server listens.

    Args:
        host: Address to listen on.
        ports: Of every world by the options that set them, as `count_up` returns them.

    Yields:
        The bound sockets in the same order; they are closed in the end.

    Raises:
        UsageError: A port is taken or the address is not ours; names the option.
    """
    bound: list[dict[str, socket.socket]] = [{} for _ in ports]
    # Ports with a number come first: one of them might otherwise be picked as a free one.
    wanted = sorted(
        ((world, option, port) for world, own in enumerate(ports) for option, port in own.items()),
        key=lambda item: item[2] == 0,
    )
    with contextlib.ExitStack() as stack:
        for world, option, port in wanted:
            bound[world][option] = stack.enter_context(bound_socket(host, port, option))
        yield bound


def bound_socket(host: str, port: int, option: str = "") -> socket.socket:
    """Return a socket bound to an address, not listening yet; port 0 picks a free one.

    While it only is bound, connections are refused. A host with addresses of both kinds, such as localhost,
    means the IPv4 one: USARSim's clients know no other.

    Args:
        host: Address or name.
        port: Its port.
        option: Option that sets the port, for the message.

    Raises:
        UsageError: The port is taken or the address is not ours.
    """
    try:
        families = [found[0] for found in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)]
        family = socket.AF_INET if socket.AF_INET in families else families[0]
        bound = ListeningSocket(family, socket.SOCK_STREAM)
    except OSError as error:
        raise _refusal(host, port, option, error) from error
    try:
        # After a restart the port's old connections may still be in TIME_WAIT.
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.bind((host, port))
    except OSError as error:
        bound.close()
        raise _refusal(host, port, option, error) from error
    _bound_sockets.add(bound)
    return bound


def may_dial(address: str, port: int) -> bool:
    """Return whether the server may connect to a port for a client: not to the system's, nor to its own.

    Args:
        address: IP address of the peer to dial.
        port: Its port.
    """
    # Closed sockets stay in the set until they are collected; their descriptor is -1.
    own = {bound.getsockname()[1] for bound in _bound_sockets if bound.fileno() >= 0}
    return port >= FIRST_DIALLED and not (port in own and _is_ours(address))


def _is_ours(address: str) -> bool:
    """Return whether an IP address is one of this machine's: only those can be bound."""
    with socket.socket(socket.AF_INET6 if ":" in address else socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            # UDP binds without a connection, so the test disturbs no service of that address.
            probe.bind((address, 0))
        except OSError:
            return False
    return True


def _refusal(host: str, port: int, option: str, error: OSError) -> UsageError:
    """Return the error for the user, with the option that would help."""
    # A port that no option sets, as a free one for a call by radio, has no remedy to name.
    if not option:
        hint = ""
    elif error.errno in WRONG_PORT:
        hint = f" ({option} sets it, --port-offset moves all ports)"
    else:
        hint = " (--host sets the address)"
    return UsageError(f"cannot listen on {host}:{port}: {error}{hint}")
