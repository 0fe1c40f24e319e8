"""A guard against a deadlock of JAX's CPU backend on machines with few cores.

jaxlib 0.10.2 factors batches of matrices in parallel on the thread pool that already runs it: with two
cores two such operations wait for each other for ever (seen in 5 of 6 runs of MJX with several worlds).
A pool of eight threads, which the environment variable NPROC sets when the backend starts, never hung.
`usarmjx` raises NPROC when it is imported; this module also finds out when that came too late.

XLA divides each loop, however short, among as many tasks as the pool has threads, and eight of them on two
cores wait for each other: who does not solve with engine `jax` is faster with a thread for each core.
"""

import ctypes
import os
import sys
import time
from collections.abc import Callable
from functools import cache
from typing import Any, cast

from usarmjx.base.errors import EngineError


@cache
def _trim() -> Callable[[int], Any] | None:
    """Return glibc's malloc_trim; None where the C library is another one."""
    try:
        return cast(Callable[[int], Any], ctypes.CDLL(None).malloc_trim)
    except (AttributeError, OSError, TypeError):
        return None


def return_freed_memory() -> None:
    """Give the system back what was freed, where the C library can; takes a millisecond or two.

    A model and its data are made anew whenever a robot joins or leaves. glibc keeps such large blocks for
    later and puts small ones in between, so that a server grew by half a megabyte with each visit of a robot.
    """
    trim = _trim()
    if trim is not None:
        trim(0)


STARTED = time.time()
"""[s since the epoch]"""


MIN_THREADS = 8
POOL, CORES = "USARMJX_POOL", "cores"
"""Environment variable, and what it is where the pool is to have as many threads as there are cores."""
_started_before_us = False
_raised_from: tuple[str | None] | None = None
"""What NPROC was before it was raised; None: it was not."""


def ensure_pool_size() -> None:
    """Make sure that JAX's CPU thread pool will be large enough, however few cores there are."""
    global _raised_from, _started_before_us
    if _size_asked_for() >= MIN_THREADS or fits_cores():
        return
    _started_before_us, _raised_from = _backend_runs(), (os.environ.get("NPROC"),)
    os.environ["NPROC"] = str(MIN_THREADS)


def fit_pool_to_cores() -> None:
    """Let the pool have a thread for each core, here and in processes that this one starts.

    For who does not solve with engine `jax` on a CPU, which refuses to be built then. Nothing happens where
    JAX runs already, or where NPROC has been set to as many threads as that engine needs.
    """
    if _backend_runs() or _raised_from is None:
        return
    os.environ[POOL] = CORES
    os.environ.pop("NPROC")
    if _raised_from[0] is not None:
        os.environ["NPROC"] = _raised_from[0]


def fits_cores() -> bool:
    """Return whether the pool is to have a thread for each core."""
    return os.environ.get(POOL, "").strip().lower() == CORES


def _size_asked_for() -> int:
    asked = os.environ.get("NPROC", "")
    return (int(asked) if asked.isdecimal() else 0) if asked else cores()


def cores() -> int:
    """Return how many cores this process may use, which is what JAX's pool is sized by."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _backend_runs() -> bool:
    bridge = sys.modules.get("jax._src.xla_bridge")
    return bool(bridge and bridge.backends_are_initialized())


def check_pool_size() -> None:
    """Refuse to run where the deadlock could strike.

    Raises:
        EngineError: JAX's CPU backend was already running, with a small pool, when usarmjx was imported; or
            the pool is small because that was asked for.
    """
    if fits_cores() and _size_asked_for() < MIN_THREADS and _on_cpu():
        raise EngineError(
            f"{POOL}={CORES} leaves JAX with {_size_asked_for()} threads, and engine jax needs {MIN_THREADS} "
            f"to be safe from a deadlock of its CPU backend; unset {POOL}, or take another engine"
        )
    if _started_before_us:
        raise EngineError(
            "JAX was already running, with too few threads to be safe from a deadlock of its CPU backend, "
            f"when usarmjx was imported; import usarmjx first, or set NPROC={MIN_THREADS} in the environment"
        )


def _on_cpu() -> bool:
    import jax

    return jax.default_backend() == "cpu"
