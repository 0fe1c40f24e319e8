"""Python processes beside this one, for work that would hold up its other threads.

Python's own pools, which sweeps use from our own command, run the main program's file once more in each
process; a script that trains need not stand that. These run nothing but this module.
"""

import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import contextmanager, suppress
from typing import Any, TypeVar
from weakref import finalize

Item = TypeVar("Item")
Result = TypeVar("Result")
_of_thread = threading.local()
# They need neither a GPU nor threads of their own. glibc gives arrays of 0.1 MB back to the system when they
# are dropped, until it learns better: maps of an arena took twice as long.
SETTINGS = {
    "JAX_PLATFORMS": "cpu",
    "CUDA_VISIBLE_DEVICES": "",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MALLOC_MMAP_THRESHOLD_": str(2**28),
    "MALLOC_TRIM_THRESHOLD_": str(2**28),
}
BROKEN = (OSError, EOFError, ValueError, pickle.PickleError, AttributeError, TypeError)
"""What a pipe to a process that has ended, or what cannot be pickled, raises."""


class WorkerProcesses:
    """Some of them, which end with this object, or with this process.

    Args:
        count: How many.
        modules: What each of them imports at once, so that it waits for what is asked.
    """

    def __init__(self, count: int, modules: Sequence[str] = ()) -> None:
        path = os.pathsep.join(entry for entry in sys.path if entry)
        settings = {**os.environ, **SETTINGS, "PYTHONPATH": path}
        imports = "".join(f"import {module}; " for module in modules)
        command = [sys.executable, "-c", f"from {__name__} import serve; {imports}serve()"]
        pipe = subprocess.PIPE
        self._processes = [
            # In a session of its own Ctrl-C does not reach it: it ends when its input does.
            subprocess.Popen(command, env=settings, stdin=pipe, stdout=pipe, start_new_session=True)
            for _ in range(count)
        ]
        finalize(self, _end, self._processes)

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
        """Return what a function makes of each item, worked out by all processes at once.

        What one of them cannot do, as its function is not to be had there, or raises, is done here. Only one
        thread at a time may call this.
        """
        parts = [[*items]]
        if self._processes:
            parts = [parts[0][first :: len(self._processes)] for first in range(len(self._processes))]
        asked = [_ask(*one, function) for one in zip(self._processes, parts, strict=False)]
        done = [
            _answer(process) if told else None for process, told in zip(self._processes, asked, strict=True)
        ]
        results = [
            [function(item) for item in part] if found is None else found
            for part, found in zip(parts, done or [None], strict=True)
        ]
        return [results[n % len(results)][n // len(results)] for n in range(sum(map(len, parts)))]


@contextmanager
def spread_over(workers: WorkerProcesses | None) -> Generator[None]:
    """Let `spread` of this thread use some processes; None: none."""
    _of_thread.workers = workers
    try:
        yield
    finally:
        _of_thread.workers = None


def spread(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Return what a function makes of each item, in the processes that `spread_over` has named, if any."""
    workers: WorkerProcesses | None = getattr(_of_thread, "workers", None)
    return [function(item) for item in items] if workers is None else workers.map(function, items)


def serve() -> None:
    """Do what is asked for on the standard input until that ends; this is such a process."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what somebody prints is no answer
    while True:
        try:
            function, items = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        try:
            found: list[Any] | None = [function(item) for item in items]
        except Exception:
            found = None
        try:
            pickle.dump(found, answers, pickle.HIGHEST_PROTOCOL)
            answers.flush()
        except BrokenPipeError:
            os._exit(0)  # whoever asked has ended; to close the pipe would fail again


def _ask(process: subprocess.Popen[bytes], part: list[Any], function: Callable[[Any], Any]) -> bool:
    """Return whether a process could be asked."""
    try:
        asked = pickle.dumps((function, part), pickle.HIGHEST_PROTOCOL)  # first: half of one is none
        assert process.stdin is not None
        process.stdin.write(asked)
        process.stdin.flush()
    except BROKEN:
        return False
    return True


def _answer(process: subprocess.Popen[bytes]) -> list[Any] | None:
    """Return what a process has found; None: it has ended, or could not do it."""
    try:
        assert process.stdout is not None
        return pickle.load(process.stdout)
    except (*BROKEN, ImportError):
        process.kill()
        return None


def _end(processes: list[subprocess.Popen[bytes]]) -> None:
    for process in processes:
        for pipe in (process.stdin, process.stdout):
            with suppress(OSError):
                if pipe is not None:
                    pipe.close()
        process.kill()
        process.wait()
