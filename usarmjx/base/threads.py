"""A guard against a deadlock of JAX's CPU backend on machines with few cores.

jaxlib 0.10.2 factors batches of matrices in parallel on the thread pool that already runs it: with two
cores two such operations wait for each other for ever (seen in 5 of 6 runs of MJX with several worlds).
A pool of eight threads, which the environment variable NPROC sets when the backend starts, never hung.
`usarmjx` raises NPROC when it is imported; this module also finds out when that came too late.
"""

import os
import sys

from usarmjx.base.errors import EngineError

MIN_THREADS = 8
_started_before_us = False


def ensure_pool_size() -> None:
    """Make sure that JAX's CPU thread pool will be large enough, however few cores there are."""
    global _started_before_us
    asked = os.environ.get("NPROC", "")
    size = int(asked) if asked.isdecimal() else 0
    if (size if asked else cores()) >= MIN_THREADS:
        return
    _started_before_us = _backend_runs()
    os.environ["NPROC"] = str(MIN_THREADS)


def cores() -> int:
    """Return how many cores this process may use, which is what JAX's pool is sized by."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _backend_runs() -> bool:
    bridge = sys.modules.get("jax._src.xla_bridge")
    return bool(bridge and bridge.backends_are_initialized())


def check_pool_size() -> None:
    """Refuse to run where the deadlock could strike.

    Raises:
        EngineError: JAX's CPU backend was already running, with a small pool, when usarmjx was imported.
    """
    if _started_before_us:
        raise EngineError(
            "JAX was already running, with too few threads to be safe from a deadlock of its CPU backend, "
            f"when usarmjx was imported; import usarmjx first, or set NPROC={MIN_THREADS} in the environment"
        )
