"""A server's process on this machine: which it is, and the processor time of the thread that steps worlds."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path

from usarmjx.base.errors import UsageError

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
        try:
            if any(os.readlink(one) in sockets for one in (folder / "fd").iterdir()):
                return int(folder.name)
        except OSError:
            continue  # another user's, or gone meanwhile
    raise UsageError(f"no process of yours on this machine listens at port {port}: name it with --pid")


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
