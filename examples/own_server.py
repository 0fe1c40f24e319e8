"""A server of one's own for as long as a program runs: `usarmjx serve`, without pages, radio and pictures."""

import contextlib
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from typing import IO

LISTENING = re.compile(r"listening on .*:(\d+)")
QUIET = ("--port", "0", "--no-view", "--no-wireless", "--no-images")


@contextlib.contextmanager
def served(*options: str) -> Iterator[int]:
    """Serve a world with more options of `usarmjx serve`; give the port, and stop in the end.

    Raises:
        RuntimeError: It did not start; it has said why.
    """
    command = [sys.executable, "-m", "usarmjx", "serve", *QUIET, *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        said = process.stdout
        if said is None or not (port := _port(said)):
            raise RuntimeError("the server has not started")
        # What it says later, how fast it was for instance, is shown too, and fills no pipe.
        rest = threading.Thread(target=_show, args=(said,))
        rest.start()
        try:
            yield port
        finally:
            process.send_signal(signal.SIGINT)
            rest.join()


def _port(said: IO[str]) -> int:
    """Show what the server says until it says its port; 0: it has ended before."""
    for line in said:
        print(line, end="", flush=True)
        if found := LISTENING.search(line):
            return int(found[1])
    return 0


def _show(said: IO[str]) -> None:
    for line in said:
        print(line, end="", flush=True)
