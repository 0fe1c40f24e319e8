"""The process: thread pool of JAX's CPU backend, freed memory and start time.

jaxlib 0.10.2 factors batches of matrices in parallel on the thread pool that already runs it: with two cores
two such operations can deadlock (seen in 5 of 6 runs of MJX with several worlds). A pool of eight threads,
which the environment variable NPROC sets when the backend starts, never did. `usarmjx` raises NPROC when it
is imported; this module also detects that JAX was already running.

XLA divides each loop, however short, into one task per thread of the pool, and on two cores eight tasks wait
for each other: without engine `jax` one thread per core is faster.
"""

import ctypes
import os
import sys
import time
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, cast

from usarmjx.base.errors import EngineError

PROCESS_START = time.time()
"""Start of this process [s since the epoch]."""
MIN_THREADS = 8
"""Smallest thread pool that does not deadlock."""
POOL, CORES = "USARMJX_POOL", "cores"
"""Environment variable and its value for a pool of one thread per core."""
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, M_ARENA_MAX = -1, -3, -8
"""Parameters of glibc's mallopt (malloc.h)."""
MAPPED_SIZE, MAX_ARENAS = 2**19, 2
"""Size from which a long-running process maps blocks separately [bytes], and its largest number of heaps."""
KEPT_SIZE = 2**23
"""Free memory at the end of a heap that stays there for the next arrays [bytes]."""
MALLOC_VARIABLES = (
    *("MALLOC_MMAP_THRESHOLD_", "MALLOC_TRIM_THRESHOLD_", "MALLOC_ARENA_MAX"),
    "GLIBC_TUNABLES",
)
"""Environment variables with which users set the same."""
_started_before_us = False
_raised_from: tuple[str | None] | None = None
"""Value of NPROC before it was raised, in a tuple; None: not raised."""


@cache
def _trim() -> Callable[[int], Any] | None:
    """Return glibc's malloc_trim; None with another C library."""
    try:
        return cast(Callable[[int], Any], ctypes.CDLL(None).malloc_trim)
    except (AttributeError, OSError, TypeError):
        return None


def return_freed_memory() -> None:
    """Return freed memory to the system where the C library can; takes one or two milliseconds.

    A model and its data are allocated anew whenever a robot joins or leaves. glibc keeps such large blocks
    for reuse and puts small ones between them: a server grew by 0.5 MB with each visit of a robot.
    """
    trim = _trim()
    if trim is not None:
        trim(0)


def limit_fragmentation(environment: Mapping[str, str] = os.environ) -> bool:
    """Let the C library map large blocks separately and use few heaps; call it before threads start.

    glibc raises its threshold for separate maps, to 32 MB at most, with each mapped block that is freed.
    Models and pictures then lie in heaps of several threads, between small blocks that keep those from
    shrinking: with the same bytes in use, a server grew by 0.5 MB in a minute of 28 joins.

    A threshold that is set leaves the other at 128 KiB, from which the end of a heap goes back to the system:
    the arrays of each control step would be new pages.

    Args:
        environment: Settings of the user's own stay.

    Returns:
        Whether the library took it: only glibc does.
    """
    # mallopt would override what the user has set.
    if any(environment.get(name) for name in MALLOC_VARIABLES):
        return False
    try:
        option = cast(Callable[[int, int], int], ctypes.CDLL(None).mallopt)
        # A threshold that is set stays: glibc stops raising it.
        settings = {M_MMAP_THRESHOLD: MAPPED_SIZE, M_TRIM_THRESHOLD: KEPT_SIZE, M_ARENA_MAX: MAX_ARENAS}
        return all([option(name, value) for name, value in settings.items()])
    except (AttributeError, OSError, TypeError):
        return False


def ensure_pool_size() -> None:
    """Raise NPROC so that JAX's CPU thread pool is large enough on any number of cores."""
    global _raised_from, _started_before_us
    if _requested_pool_size() >= MIN_THREADS or pool_fits_cores():
        return
    # JAX reads NPROC once, when its backend starts: engine `jax` reports a setting that comes too late.
    _started_before_us, _raised_from = _backend_runs(), (os.environ.get("NPROC"),)
    os.environ["NPROC"] = str(MIN_THREADS)


def check_inherited_cache() -> None:
    """Check what this process loads from the cache of compilations that its parent has set up, if it has."""
    if os.environ.get("USARMJX_PROGRAMS"):
        from usarmjx.base.checked_cache import install_cache_checks

        install_cache_checks()


def fit_pool_to_cores() -> None:
    """Give the pool one thread per core, in this process and its children.

    For processes without engine `jax` on a CPU, which then refuses to be built. No effect if JAX already
    runs, or if NPROC was already large enough for that engine.
    """
    if _backend_runs() or _raised_from is None:
        return
    os.environ[POOL] = CORES
    # Children read it, too: they get the value that was there before us.
    os.environ.pop("NPROC")
    if _raised_from[0] is not None:
        os.environ["NPROC"] = _raised_from[0]


def pool_fits_cores() -> bool:
    """Return whether the pool has one thread per core."""
    return os.environ.get(POOL, "").strip().lower() == CORES


def _requested_pool_size() -> int:
    asked = os.environ.get("NPROC", "")
    return (int(asked) if asked.isdecimal() else 0) if asked else cores()


def cores() -> int:
    """Return the number of cores that this process may use, JAX's default pool size."""
    # Containers and taskset may allow fewer cores than the machine has.
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _backend_runs() -> bool:
    # Looked up, not imported: this module runs before JAX is imported.
    bridge = sys.modules.get("jax._src.xla_bridge")
    return bool(bridge and bridge.backends_are_initialized())


def check_pool_size() -> None:
    """Refuse to run if the deadlock is possible.

    Raises:
        EngineError: JAX's CPU backend was already running, with a small pool, when usarmjx was imported; or a
            small pool was requested.
    """
    if pool_fits_cores() and _requested_pool_size() < MIN_THREADS and _on_cpu():
        raise EngineError(
            f"{POOL}={CORES} leaves JAX with {_requested_pool_size()} threads, and engine jax needs "
            f"{MIN_THREADS} to be safe from a deadlock of its CPU backend; unset {POOL}, "
            "or take another engine"
        )
    if _started_before_us:
        raise EngineError(
            "JAX was already running, with too few threads to be safe from a deadlock of its CPU backend, "
            f"when usarmjx was imported; import usarmjx first, or set NPROC={MIN_THREADS} in the environment"
        )


def _on_cpu() -> bool:
    import jax

    return jax.default_backend() == "cpu"
