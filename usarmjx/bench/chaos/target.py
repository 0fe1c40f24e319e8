"""Whom to attack: a server that runs, or one that is started for it."""

import contextlib
import ipaddress
import socket
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from usarmjx.base.errors import UsageError
from usarmjx.bench.chaos.processor import find_process
from usarmjx.bench.serving.clients import HOST
from usarmjx.bench.serving.process import METRICS, OWN_TREE, PAGE, ServerProcess, SourceTree
from usarmjx.server.ports import LAST_PORT


@dataclass(frozen=True)
class Target:
    """A server.

    Attributes:
        host: Whose.
        port: Its Gamebots port.
        page_port: Port of its page; None: it has none, or nobody knows.
        metrics_port: Port of its metrics; None likewise.
        process: Its process; None: it is on another machine, or another user's.
    """

    host: str
    port: int
    page_port: int | None = None
    metrics_port: int | None = None
    process: int | None = None


def parse_host_port(text: str) -> tuple[str, int]:
    """Return host and port of `HOST:PORT`.

    Raises:
        UsageError: It is not of that form.
    """
    host, colon, port = text.rpartition(":")
    if not (host and colon and port.isdecimal() and 0 < int(port) <= LAST_PORT):
        raise UsageError(f"{text!r} is not of the form HOST:PORT, as 127.0.0.1:3000")
    return host, int(port)


def check_loopback(host: str) -> None:
    """Refuse hosts other than this machine's loopback.

    Raises:
        UsageError: It is another one, or unknown.
    """
    try:
        addresses = {found[4][0] for found in socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)}
    except OSError as error:
        raise UsageError(f"{host}: {error}") from error
    if not all(ipaddress.ip_address(address).is_loopback for address in addresses):
        raise UsageError(
            f"{host} is not this machine's loopback: --own-server says that it is yours to attack"
        )


def local_process(port: int) -> int | None:
    """Return the process that listens at a port of this machine; None if it is not ours to look at."""
    with contextlib.suppress(UsageError):
        return find_process(port)
    return None


@contextlib.contextmanager
def started(arena: str, seats: int) -> Iterator[Target]:
    """Start a server of this source tree with a page and metrics, at free ports.

    Args:
        arena: Name of the arena, or a file.
        seats: Most robots.
    """
    options = ["--arena", arena, "--engine", "c", "--seats", str(seats)]
    ports = ["--spectator-port", "0", "--metrics-port", "0"]
    with (
        TemporaryDirectory() as cache,
        ServerProcess(SourceTree(OWN_TREE), Path(cache), [*options, *ports]) as server,
    ):
        page, metrics = server.port_said(PAGE), server.port_said(METRICS)
        yield Target(HOST, server.port, page, metrics, server.process)
