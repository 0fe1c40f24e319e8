"""One trainer in a folder: whoever comes second is refused."""

import os
import socket
import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from usarmjx.base.errors import UsageError
from usarmjx.base.files import writing

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

LOCK_FILE = "trainer.lock"


@contextmanager
def run_lock(run: Path) -> Generator[None]:
    """Keep other trainers out of the folder of a run, which is there.

    The system holds the lock for this process, so none is left behind, however the process ends.

    Raises:
        UsageError: Another process trains there; says which.
        WriteError: The folder cannot be written to.
    """
    path = run / LOCK_FILE
    with writing(path):
        file = path.open("a+")
    with file:
        if not _lock(file.fileno()):
            file.seek(0)
            who = file.read().strip() or "another process"
            raise UsageError(f"{who} trains in {run}: wait for its end, or choose another folder")
        with writing(path):
            file.truncate(0)
            file.write(f"process {os.getpid()} on {socket.gethostname()}\n")
            file.flush()
        yield


def _lock(descriptor: int) -> bool:
    """Return whether nobody else holds the lock; true also where the system has none, which is told."""
    reason = "this system has no fcntl"
    if fcntl is not None:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        except BlockingIOError:
            return False
        except OSError as error:
            reason = str(error.strerror)
    sys.stderr.write(
        f"usarmjx: a second trainer in this folder would not be noticed, as it cannot be locked: {reason}\n"
    )
    return True
