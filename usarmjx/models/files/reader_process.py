"""Sandbox for third-party readers: files are first read in a process of their own, under limits.

MuJoCo reads MJCF, trimesh reads meshes. Whatever a file does to them, this process gets one line of it. The
other process starts with the first file (docs/security.md has the cost), stays for those that follow within
seconds, and ends by itself.
"""

import atexit
import contextlib
import json
import math
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from usarmjx.base.errors import ArenaFileError
from usarmjx.base.installation import install_command
from usarmjx.models.files import reader_child

CPU_TIME = 20
"""Processor time for reading one file [s]."""
MEMORY = 2_000_000_000
"""Memory for reading one file, beyond the readers' own [bytes]."""
PATIENCE = 120.0
"""Wall-clock time for one file [s]: six times its processor time."""
IDLE = 10.0
"""Time without a file after which the other process ends [s]."""
ENVIRONMENT = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "2"}
"""Variables of the other process: threads reserve address space without using it, which the limit counts."""
MeshArrays = tuple[str, np.ndarray, np.ndarray]
"""Name, vertices (n, 3) and faces (m, 3) of an object."""


def try_model(path: Path, text: str = "") -> str:
    """Read and compile a model in the other process; return its error, empty: none.

    Args:
        path: An MJCF or URDF file.
        text: MJCF text made of the file, to be read in its place; empty: the file itself.
    """
    return _READER.read("model", path, text)[0].get("error", "")


def read_mesh_objects(path: Path) -> list[MeshArrays]:
    """Return the objects of a mesh file.

    Raises:
        ArenaFileError: Names the defect, in one line.
    """
    head, body = _READER.read("mesh", path)
    if "error" in head:
        raise ArenaFileError(f"{path}: does not read as a mesh: {head['error']}")
    found: list[np.ndarray] = []
    start = 0
    for shape, kind in zip(head["shapes"], ["<f8", "<i8"] * len(head["names"]), strict=True):
        count = math.prod(shape)
        found.append(np.frombuffer(body, kind, count, start).reshape(shape))
        start += 8 * count
    return list(zip(head["names"], found[::2], found[1::2], strict=True))


def read_pieces(path: Path, count: int, scale: np.ndarray) -> list[np.ndarray]:
    """Return the vertices (n, 3) of convex pieces of a mesh file's objects, at most `count` of each.

    Raises:
        ArenaFileError: Names the defect, in one line.
    """
    head, body = _READER.read("pieces", path, count, scale.tolist())
    if "error" in head:
        raise ArenaFileError(f"{path}: is not cut into convex pieces: {head['error']}")
    found: list[np.ndarray] = []
    start = 0
    for shape in head["shapes"]:
        found.append(np.frombuffer(body, "<f8", math.prod(shape), start).reshape(shape))
        start += 8 * math.prod(shape)
    return found


def expand_xacro(path: Path, folders: Mapping[str, str], mappings: Mapping[str, str]) -> bytes | str:
    """Return a xacro file's XML; or the name of a package for which a folder is needed.

    Args:
        path: The file.
        folders: Folders of packages.
        mappings: Arguments of the file, by name.

    Raises:
        ArenaFileError: Names the defect, in one line.
    """
    head, body = _READER.read("xacro", path, {"folders": dict(folders), "mappings": dict(mappings)})
    if "error" in head:
        raise ArenaFileError(f"{path}: does not expand as xacro: {head['error']}")
    return head.get("package") or body


class ReaderProcess:
    """The other process, which is started on demand.

    Args:
        cpu_time: Processor time for reading one file [s].
        memory: Memory for reading one file, beyond the readers' own [bytes].
        patience: Wall-clock time for one file [s].
        idle: Time without a file after which it ends [s].
    """

    def __init__(
        self,
        cpu_time: int = CPU_TIME,
        memory: int = MEMORY,
        patience: float = PATIENCE,
        idle: float = IDLE,
    ) -> None:
        self._cpu_time, self._memory, self._patience, self._idle = cpu_time, memory, patience, idle
        self._lock = threading.Lock()
        self._child: subprocess.Popen[bytes] | None = None
        self._owner = 0  # process id: after a fork the child belongs to the parent process

    def read(self, kind: str, path: Path, *arguments: object) -> tuple[dict[str, Any], bytes]:
        """Return the other process's answer about a file, and the bytes behind it.

        Args:
            kind: One of `reader_child.READERS`.
            path: The file.
            arguments: Further arguments of that reader, as JSON has them.

        Returns:
            Values; under "error" the defect of the file, or the reason why the process ended.
        """
        request = json.dumps([kind, str(path.absolute()), *arguments]).encode() + b"\n"
        with self._lock:
            found = self._ask(request) or self._ask(request)  # it may end by itself just before the request
        head, body = found or ({"error": "the process that reads it does not start"}, b"")
        if "extra" in head:
            head["error"] += f": {install_command(head['extra'])}"
        return head, body

    def close(self) -> None:
        """End the other process."""
        child, self._child = self._child, None
        if child is not None and self._owner == os.getpid():
            child.kill()
            # Closes the pipes and reaps the process.
            child.communicate()

    def _ask(self, request: bytes) -> tuple[dict[str, Any], bytes] | None:
        """Return the answer; None from a process that had ended for lack of requests."""
        try:
            child = self._started()
        except OSError as error:
            return {"error": f"the process that reads it does not start: {error}"}, b""
        assert child.stdin is not None
        assert child.stdout is not None
        # A blocking read of a pipe has no timeout: the end of the process closes the pipe and thereby ends
        # the read.
        late = threading.Timer(self._patience, child.kill)
        late.daemon = True
        late.start()
        try:
            with contextlib.suppress(BrokenPipeError):
                child.stdin.write(request)
                child.stdin.flush()
            head = child.stdout.readline()
            # A line without its end is what a crash has left of an answer.
            answer = json.loads(head) if head.endswith(b"\n") else None
            body = child.stdout.read(answer["bytes"]) if answer else b""
            if answer is not None and len(body) == answer["bytes"]:
                return answer, body
            ended = child.wait()
        finally:
            # A timer that has run out has killed the process.
            timed_out = not late.is_alive()
            late.cancel()
        self.close()
        if ended == 0:
            return None
        return {"error": self._why(ended, timed_out=timed_out)}, b""

    def _started(self) -> subprocess.Popen[bytes]:
        """Return the running process, or a new one."""
        if self._child is not None and self._owner == os.getpid() and self._child.poll() is None:
            return self._child
        self.close()
        # By argument: the option -I ignores PYTHONPATH and the working directory.
        folders = [folder for folder in sys.path if folder]
        options = [folders, self._cpu_time, self._memory, self._idle]
        self._child = subprocess.Popen(
            [sys.executable, "-I", reader_child.__file__, json.dumps(options)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **ENVIRONMENT},
        )
        self._owner = os.getpid()
        threading.Thread(
            target=self._child.wait, daemon=True
        ).start()  # reaps it when it ends, lest it stays a zombie
        return self._child

    def _why(self, ended: int, *, timed_out: bool) -> str:
        """Return the reason why reading ended without an answer."""
        if timed_out:
            return f"reading it takes longer than {self._patience:g} s"
        # Windows has neither signal: 0 there is an exit code that `_ask` has handled.
        if ended == -getattr(signal, "SIGXCPU", 0):
            return f"reading it takes more than {self._cpu_time} s of a processor"
        if ended == -getattr(signal, "SIGKILL", 0):
            return "the process that read it was killed: is there memory enough?"
        return f"its reader crashed ({signal.Signals(-ended).name if ended < 0 else f'code {ended}'})"


_READER = ReaderProcess()
atexit.register(_READER.close)
