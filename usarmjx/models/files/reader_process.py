"""Files whose readers are not ours are first read in a process of their own, under limits.

MuJoCo reads MJCF, trimesh reads meshes. Whatever a file does to them, this process gets one line of it. The
other process is started for the first file (see docs/security.md for what that costs), stays for those that
follow within seconds, and ends by itself.
"""

import atexit
import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np

from usarmjx.base.errors import ArenaFileError
from usarmjx.models.files import reader_child

CPU_TIME = 20
"""Of a processor, for reading one file [s]."""
MEMORY = 2_000_000_000
"""For reading one file, beyond what the readers take themselves [bytes]."""
PATIENCE = 120.0
"""For one file, by the clock on the wall [s]: six times as long as its share of a processor."""
IDLE = 10.0
"""After so long without a file the other process ends [s]."""
ENVIRONMENT = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "2"}
"""Threads reserve memory that nobody uses, and the limit counts it."""
MeshArrays = tuple[str, np.ndarray, np.ndarray]
"""Name, vertices (n, 3) and faces (m, 3) of an object."""


def try_model(path: Path) -> str:
    """Read and compile an MJCF or URDF file elsewhere; return what is wrong with it, empty: nothing."""
    return _READER.read("model", path)[0].get("error", "")


def read_mesh_objects(path: Path) -> list[MeshArrays]:
    """Return the objects of a mesh file.

    Raises:
        ArenaFileError: What is wrong with it, in one line.
    """
    head, body = _READER.read("mesh", path)
    if "error" in head:
        raise ArenaFileError(f"{path}: does not read as a mesh: {head['error']}")
    found, start = [], 0
    for shape, kind in zip(head["shapes"], ["<f8", "<i8"] * len(head["names"]), strict=True):
        count = int(np.prod(shape))
        found.append(np.frombuffer(body, kind, count, start).reshape(shape))
        start += 8 * count
    return list(zip(head["names"], found[::2], found[1::2], strict=True))


class ReaderProcess:
    """The other process, which is there while it has something to do.

    Args:
        cpu_time: Of a processor, for reading one file [s].
        memory: For reading one file, beyond what the readers take themselves [bytes].
        patience: For one file, by the clock on the wall [s].
        idle: After so long without a file it ends [s].
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
        self._owner = 0  # of the child: after a fork it is somebody else's

    def read(self, kind: str, path: Path) -> tuple[dict[str, Any], bytes]:
        """Return what the other process says about a file, and the bytes behind that.

        Args:
            kind: How to read it, one of `reader_child.READERS`.
            path: The file.

        Returns:
            Values; under "error" what is wrong with the file, or why the process ended over it.
        """
        request = json.dumps([kind, str(path.absolute())]).encode() + b"\n"
        with self._lock:
            found = self._ask(request) or self._ask(request)  # it may end just before it is asked
        return found or ({"error": "the process that reads it does not start"}, b"")

    def close(self) -> None:
        """End the other process."""
        child, self._child = self._child, None
        if child is not None and self._owner == os.getpid():
            child.kill()
            child.communicate()

    def _ask(self, request: bytes) -> tuple[dict[str, Any], bytes] | None:
        """Return the answer; None from a process that had ended for want of questions."""
        try:
            child = self._started()
        except OSError as error:
            return {"error": f"the process that reads it does not start: {error}"}, b""
        assert child.stdin is not None
        assert child.stdout is not None
        late = threading.Timer(self._patience, child.kill)
        late.daemon = True
        late.start()
        try:
            with contextlib.suppress(BrokenPipeError):
                child.stdin.write(request)
                child.stdin.flush()
            head = child.stdout.readline()
            answer = json.loads(head) if head.endswith(b"\n") else None
            body = child.stdout.read(answer["bytes"]) if answer else b""
            if answer is not None and len(body) == answer["bytes"]:
                return answer, body
            ended = child.wait()
        finally:
            timed_out = not late.is_alive()
            late.cancel()
        self.close()
        if ended == 0:
            return None
        return {"error": self._why(ended, timed_out=timed_out)}, b""

    def _started(self) -> subprocess.Popen[bytes]:
        """Return the process that is there, or a new one."""
        if self._child is not None and self._owner == os.getpid() and self._child.poll() is None:
            return self._child
        self.close()
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
        threading.Thread(target=self._child.wait, daemon=True).start()  # else it stays as a zombie
        return self._child

    def _why(self, ended: int, *, timed_out: bool) -> str:
        """Return why reading ended without an answer."""
        if timed_out:
            return f"reading it takes longer than {self._patience:g} s"
        if ended == -getattr(signal, "SIGXCPU", 0):
            return f"reading it takes more than {self._cpu_time} s of a processor"
        if ended == -getattr(signal, "SIGKILL", 0):
            return "the process that read it was killed: is there memory enough?"
        return f"its reader crashed ({signal.Signals(-ended).name if ended < 0 else f'code {ended}'})"


_READER = ReaderProcess()
atexit.register(_READER.close)
