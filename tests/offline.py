"""A guard for tests: nobody but this machine is reached, and who tries is written down."""

import os
import re
import socket
import sys
from pathlib import Path

HERE = ("127.", "::1", "localhost", "0.0.0.0")
LOADERS = {"curl", "wget", "pip", "pip3", "ssh", "scp", "rsync", "aria2c"}
CONNECTING = ("socket.connect", "socket.sendto", "socket.sendmsg")
RESOLVING = ("socket.getaddrinfo", "socket.gethostbyname")
WATCHED = {*CONNECTING, *RESOLVING, "subprocess.Popen"}
NO_ROUTE = 101, "Network is unreachable"


def is_here(host: str | bytes | None) -> bool:
    """Return whether an address or a name is this machine's."""
    text = host.decode() if isinstance(host, bytes) else host
    return text in (None, "", "::", socket.gethostname()) or str(text).startswith(HERE)


def attempt(event: str, args: tuple) -> str | None:
    """Return what an event of Python's audit asks of another machine; None: nothing."""
    if event in CONNECTING:
        address = args[1]
        return str(address) if isinstance(address, tuple) and not is_here(address[0]) else None
    if event in RESOLVING:  # nobody is asked about an address in numbers
        return None if is_here(args[0]) or re.fullmatch(r"[\d.]+|[\da-f:]+", str(args[0])) else str(args[0])
    program, *words = [os.fsdecode(word) for word in args[1]]
    installs = program == sys.executable and words[:2] == ["-m", "pip"] and "--no-index" not in words
    return " ".join((program, *words)) if installs or os.path.basename(program) in LOADERS else None


def cut_network(file: Path) -> None:
    """Let this process reach nobody but this machine, for good; append each attempt to a file.

    Written down, because a library may get over it when nobody answers.
    """

    def guard(event: str, args: tuple) -> None:
        if event not in WATCHED:
            return
        if asked := attempt(event, args):
            with file.open("a") as lines:
                lines.write(f"{event} {asked}\n")
            raise OSError(*NO_ROUTE)

    sys.addaudithook(guard)


SITE = """
import os
from pathlib import Path
from tests.offline import cut_network
cut_network(Path(os.environ["ASKED"]))
"""
"""`sitecustomize`, which Python imports before anything else, also in processes that a process starts."""
