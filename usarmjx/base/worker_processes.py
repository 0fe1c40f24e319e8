"""Python worker processes, for work that would block this process's other threads (the GIL).

Python's own pools run the main program's file again in each process, which a user's training script need not
support; these workers run only this module.
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
SETTINGS = {
    "JAX_PLATFORMS": "cpu",
    "CUDA_VISIBLE_DEVICES": "",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MALLOC_MMAP_THRESHOLD_": str(2**28),
    "MALLOC_TRIM_THRESHOLD_": str(2**28),
}
"""Environment of a worker. It needs neither a GPU nor threads. glibc returns blocks of 0.1 MB to the system
when they are freed, until its threshold adapts: arena maps took twice as long."""
BROKEN = (OSError, EOFError, ValueError, pickle.PickleError, AttributeError, TypeError)
"""Exceptions of a pipe to an ended process, and of objects that cannot be pickled."""


class WorkerProcesses:
    """Pool of worker processes that end with this object or with this process.

    Args:
        count: Number of workers.
        modules: Modules that each worker imports at its start.
    """

    def __init__(self, count: int, modules: Sequence[str] = ()) -> None:
        # Workers are new interpreters: they find what this one has on its path, also without an installation.
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
        # A bound method would hold the object, which would then never be collected.
        finalize(self, _end, self._processes)

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
        """Return the function's result for each item, computed by all workers in parallel.

        Items of a worker that fails, or in which the function is unavailable, are computed in this process.
        Only one thread at a time may call this.
        """
        parts = [[*items]]
        if self._processes:
            # Dealt out like cards: neighbouring items often take equally long.
            parts = [parts[0][first :: len(self._processes)] for first in range(len(self._processes))]
        # All are asked before any is answered, so that they work at the same time.
        asked = [_ask(*one, function) for one in zip(self._processes, parts, strict=False)]
        done = [
            _answer(process) if told else None for process, told in zip(self._processes, asked, strict=True)
        ]
        results = [
            [function(item) for item in part] if found is None else found
            for part, found in zip(parts, done or [None], strict=True)
        ]
        # Undoes the dealing: item n is the (n // parts)-th of part n % parts.
        return [results[n % len(results)][n // len(results)] for n in range(sum(map(len, parts)))]


@contextmanager
def use_workers(workers: WorkerProcesses | None) -> Generator[None]:
    """Let `spread` use some workers in this thread; None: none."""
    _of_thread.workers = workers
    try:
        yield
    finally:
        _of_thread.workers = None


def spread(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Return the function's result for each item, computed by this thread's workers if it has any."""
    workers: WorkerProcesses | None = getattr(_of_thread, "workers", None)
    return [function(item) for item in items] if workers is None else workers.map(function, items)


def serve() -> None:
    """Answer requests from the standard input until it ends; the main function of a worker."""
    # A duplicate of the pipe: descriptor 1 itself becomes the error stream below.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # prints of the function must not mix with answers
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
            os._exit(0)  # the parent has ended; closing the pipe would fail again


def _ask(process: subprocess.Popen[bytes], part: list[Any], function: Callable[[Any], Any]) -> bool:
    """Send a request to a worker; return whether that worked."""
    try:
        asked = pickle.dumps(
            (function, part), pickle.HIGHEST_PROTOCOL
        )  # before any write: a partial request would desynchronise the pipe
        assert process.stdin is not None
        process.stdin.write(asked)
        process.stdin.flush()
    except BROKEN:
        return False
    return True


def _answer(process: subprocess.Popen[bytes]) -> list[Any] | None:
    """Return a worker's results; None: it has ended, or the function failed."""
    try:
        assert process.stdout is not None
        return pickle.load(process.stdout)
    # Half an answer may still be in the pipe: the worker is of no use any more.
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
