"""Servers as processes, started by the public command line of this source tree or another one."""

import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from queue import Empty, Queue
from threading import Thread

from benchmarks.tools import commit
from usarmjx.base.errors import UsageError
from usarmjx.server.runtime.signals import ParentPipe

OWN_TREE = Path(__file__).resolve().parents[2]
"""Where this package lies."""
COMMAND = (sys.executable, "-m", "usarmjx", "serve")
FREE_PORTS = ("--port", "--wss-port", "--wss2-port", "--position-port", "--image-port")
LISTENING, PICTURES = re.compile(r"listening on [\d.]+:(\d+)"), re.compile(r"pictures on [\d.]+:(\d+)")
ROSBRIDGE = re.compile(r"rosbridge at ws://[\d.]+:(\d+)")
VIEWER, METRICS = re.compile(r"see it at http://[\d.]+:(\d+)"), re.compile(r"metrics at http://[\d.]+:(\d+)")
"""What a server says about its ports, in this order."""
OPTION = re.compile(r"--[a-z][a-z0-9-]*")
START_LIMIT = 120.0
"""How long a server may take to listen [s]."""
STOP_LIMIT = 20.0
"""How long it may take to end after SIGINT before it is killed [s]."""
HELP_LIMIT = 60.0
"""How long a tree may take to say which options it has [s]."""
COLUMNS = "200"
"""So wide is the help: a narrow one cuts the names of options."""


@dataclass(frozen=True)
class SourceTree:
    """A checkout whose server is measured.

    Attributes:
        folder: Holds the package's folder.
    """

    folder: Path

    @cached_property
    def commit(self) -> str:
        """The commit that is checked out."""
        return commit(self.folder)

    @cached_property
    def options(self) -> frozenset[str]:
        """The options of its `usarmjx serve`.

        Raises:
            UsageError: It has no such command.
        """
        asked = subprocess.run(
            [*COMMAND, "--help"],
            cwd=self.folder,
            env=self.environment | {"COLUMNS": COLUMNS, "NO_COLOR": "1", "TERM": "dumb"},
            capture_output=True,
            text=True,
            timeout=HELP_LIMIT,
        )
        if asked.returncode:
            raise UsageError(f"{self.folder} has no `usarmjx serve`: {last_line(asked.stderr)}")
        return frozenset(OPTION.findall(asked.stdout))

    @property
    def environment(self) -> dict[str, str]:
        """The environment of its processes: they find this tree's package, and no compiled programs."""
        kept = {key: text for key, text in os.environ.items() if not key.startswith(("JAX_COMP", "JAX_PERS"))}
        return kept | {"PYTHONPATH": str(self.folder)}

    def prepare(self) -> None:
        """Compile its Python, so that no first start pays for that.

        Raises:
            UsageError: There is no such package.
        """
        package = self.folder / "usarmjx"
        if not (package / "__init__.py").is_file():
            raise UsageError(f"{self.folder} is no source tree of usarmjx")
        subprocess.run([sys.executable, "-m", "compileall", "-q", str(package)], check=False)

    def seats(self, robots: int) -> list[str]:
        """Return the options that make room for so many robots."""
        if "--seats" in self.options:
            return ["--seats", str(robots)]
        return ["--max-connections", str(robots)]


def _heed_interrupts() -> None:
    """Let SIGINT end a process although the shell that started this one in the background ignores it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


class ServerProcess(AbstractContextManager["ServerProcess"]):
    """A running server with all its services at free ports; it listens once the context is entered.

    Args:
        tree: Whose server.
        cache: Folder of the compilation cache; an empty one is a cold start.
        options: More options of `usarmjx serve`.

    Attributes:
        port: Its Gamebots port.
        image_port: Its image server's port.
        started_s: From the start of the process to "listening" [s].
        stopped_s: From SIGINT to its end [s], after the context; None: it had to be killed.
    """

    def __init__(self, tree: SourceTree, cache: Path, options: list[str]) -> None:
        ports = [word for option in FREE_PORTS for word in (option, "0")]
        self._command = [*COMMAND, *ports, *options]
        self._tree, self._environment = tree, tree.environment | {"XDG_CACHE_HOME": str(cache)}
        self._lines: Queue[str] = Queue()
        self.port = self.image_port = 0
        self.started_s = 0.0
        self.stopped_s: float | None = None

    def __enter__(self) -> "ServerProcess":
        """Start it and wait until it listens.

        Raises:
            UsageError: It ended, or did not listen in time; has the last line of what it said.
        """
        self._errors = tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace")
        began = time.perf_counter()
        self._pipe = ParentPipe()
        self._process = subprocess.Popen(
            self._command,
            cwd=self._tree.folder,
            env=self._environment | self._pipe.settings,
            pass_fds=self._pipe.inherited,
            preexec_fn=_heed_interrupts,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            text=True,
        )
        self._pipe.started()
        Thread(target=self._read, daemon=True).start()
        try:
            self.port = self._port_said(LISTENING, began + START_LIMIT)
            self.started_s = time.perf_counter() - began
            self.image_port = self._port_said(PICTURES, began + START_LIMIT)
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """End it, by SIGINT if that helps."""
        began = time.perf_counter()
        self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(STOP_LIMIT)
            self.stopped_s = time.perf_counter() - began
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        finally:
            self._pipe.__exit__(None, None, None)
        self._errors.close()

    @property
    def process(self) -> int:
        """The number of its process."""
        return self._process.pid

    def port_said(self, wanted: re.Pattern[str]) -> int:
        """Return the port in the next of the lines that it says about its ports.

        Raises:
            UsageError: It says none.
        """
        return self._port_said(wanted, time.perf_counter() + START_LIMIT)

    def cpu_seconds(self) -> float:
        """Return the processor time that it has used so far, in all threads [s].

        Raises:
            UsageError: This system does not tell.
        """
        try:
            text = Path(f"/proc/{self._process.pid}/stat").read_text()
        except OSError as error:
            raise UsageError(f"this system does not tell the processor time of a process: {error}") from error
        user, system = text.rpartition(")")[2].split()[11:13]  # utime and stime of proc_pid_stat(5)
        return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._lines.put(line)
        self._lines.put("")

    def _port_said(self, wanted: re.Pattern[str], end: float) -> int:
        """Return the port in the next line of a form; wait for it until a moment [s]."""
        while True:
            try:
                line = self._lines.get(timeout=max(0.0, end - time.perf_counter()))
            except Empty:
                raise UsageError(f"the server did not listen within {START_LIMIT:g} s") from None
            if found := wanted.search(line):
                return int(found[1])
            if not line:
                self._errors.seek(0)
                raise UsageError(f"the server ended: {last_line(self._errors.read())}")


def last_line(text: str) -> str:
    """Return the last line of a text that is not empty."""
    return next((line.strip() for line in reversed(text.splitlines()) if line.strip()), "it said nothing")
