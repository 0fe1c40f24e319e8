"""Whom to attack: a server that runs, or one that is started for it."""

import contextlib
import ipaddress
import os
import socket
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.serving.clients import HOST, connect
from benchmarks.serving.process import METRICS, OWN_TREE, ROSBRIDGE, VIEWER, ServerProcess, SourceTree
from usarmjx.base.errors import UsageError
from usarmjx.server.network.ports import LAST_PORT

LISTENING = "0A"
"""State of a listening socket in /proc/net/tcp (proc_pid_net(5))."""
NANOSECOND = 1e-9


def find_process(port: int) -> int:
    """Return the number of the process that listens at a port of this machine.

    Raises:
        UsageError: There is none that we may look at.
    """
    sockets = {f"socket:[{inode}]" for inode in _listening(port)}
    for folder in Path("/proc").glob("[0-9]*"):
        if sockets & set(_open_files(folder)):
            return int(folder.name)
    raise UsageError(f"no process of yours on this machine listens at port {port}: name it with --pid")


def _open_files(process: Path) -> Iterator[str]:
    """Yield the open files of a process; none of another user's, and none that has closed meanwhile."""
    with contextlib.suppress(OSError):
        for one in (process / "fd").iterdir():
            with contextlib.suppress(OSError):
                yield os.readlink(one)


def _listening(port: int) -> Iterator[str]:
    """Yield the inodes of sockets that listen at a port."""
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        try:
            lines = Path(table).read_text().splitlines()[1:]
        except OSError:
            continue
        for fields in map(str.split, lines):
            if fields[3] == LISTENING and int(fields[1].rpartition(":")[2], 16) == port:
                yield fields[9]


def main_thread_clock(process: int, say: Callable[[str], None]) -> "ThreadClock | None":
    """Return the clock of a process's main thread; None, and why, where the system does not tell."""
    try:
        return ThreadClock(process)
    except UsageError as error:
        say(f"usarmjx: {error}")
        return None


class ThreadClock:
    """The processor time of one thread of a process on this machine.

    Args:
        process: Number of the process.
        thread: Number of the thread; None: the main thread, which steps the worlds of a server.

    Raises:
        UsageError: The system does not tell.
    """

    def __init__(self, process: int, thread: int | None = None) -> None:
        self._file = Path(f"/proc/{process}/task/{process if thread is None else thread}/schedstat")
        self()

    def __call__(self) -> float:
        """Return what it has used so far [s].

        Raises:
            UsageError: The system does not tell.
        """
        try:
            return int(self._file.read_text().split()[0]) * NANOSECOND
        except OSError as error:
            raise UsageError(f"this system does not tell the processor time of a thread: {error}") from error


@dataclass(frozen=True)
class Target:
    """A server.

    Attributes:
        host: Whose.
        port: Its Gamebots port.
        page_port: Port of its page; None: it has none, or nobody knows.
        metrics_port: Port of its metrics; None likewise.
        rosbridge_port: Port of its rosbridge; None likewise.
        image_port: Port of its pictures; None likewise.
        process: Its process; None: it is on another machine, or another user's.
    """

    host: str
    port: int
    page_port: int | None = None
    metrics_port: int | None = None
    process: int | None = None
    rosbridge_port: int | None = None
    image_port: int | None = None


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


def check_listening(host: str, port: int) -> None:
    """Refuse an address where nobody takes a connection.

    Raises:
        UsageError: There is no server.
    """
    try:
        connect(port, host).close()
    except OSError as error:
        raise UsageError(f"{host}:{port}: {error.strerror or error}; start usarmjx serve first") from error


def local_process(port: int) -> int | None:
    """Return the process that listens at a port of this machine; None if it is not ours to look at."""
    with contextlib.suppress(UsageError):
        return find_process(port)
    return None


@contextlib.contextmanager
def started(arena: str, seats: int, *, records: bool = False) -> Iterator[Target]:
    """Start a server of this source tree with a page, rosbridge and metrics, at free ports.

    Args:
        arena: Name of the arena, or a file.
        seats: Most robots.
        records: Whether it records its world; the recording is removed in the end.
    """
    options = ["--arena", arena, "--engine", "c", "--seats", str(seats)]
    ports = ["--viewer-port", "0", "--metrics-port", "0", "--rosbridge-port", "0"]
    with TemporaryDirectory() as folder:
        recording = ["--record", str(Path(folder) / "soak.mcap")] if records else []
        with ServerProcess(
            SourceTree(OWN_TREE), Path(folder) / "cache", [*options, *ports, *recording]
        ) as server:
            # In the order of its lines.
            rosbridge, metrics, page = map(server.port_said, (ROSBRIDGE, METRICS, VIEWER))
            yield Target(
                HOST, server.port, page, metrics, server.process, rosbridge, image_port=server.image_port
            )
