"""Warp's callbacks from XLA without Python's garbage collector.

XLA calls back while it captures a CUDA graph. The collector may run there and free compiled programs of
batches that are no longer used; unloading these is illegal during a capture, and the program that is being
captured fails with CUDA error 901.
"""

import gc
from collections.abc import Callable
from functools import cache, wraps
from importlib import import_module
from threading import Lock
from typing import Any


class _Pause:
    """Pause of the collector for as long as any callback runs, in whatever thread."""

    def __init__(self) -> None:
        self._lock, self._running, self._was_enabled = Lock(), 0, False

    def __enter__(self) -> None:
        with self._lock:
            if not self._running:
                self._was_enabled = gc.isenabled()
                gc.disable()
            self._running += 1

    def __exit__(self, *error: object) -> None:
        with self._lock:
            self._running -= 1
            if not self._running and self._was_enabled:
                gc.enable()


_PAUSE = _Pause()


def without_collection(callback: Callable[..., Any]) -> Callable[..., Any]:
    """Return a callback during which no garbage is collected."""

    @wraps(callback)
    def paused(*args: Any) -> Any:  # noqa: ANN401 - those of XLA
        with _PAUSE:
            return callback(*args)

    return paused


@cache
def pause_collection_in_callbacks() -> None:
    """Let all kernels that are made from now on call back without the collector."""
    # Warp has no public place for it; its version is pinned.
    ffi: Any = import_module("warp._src.jax.ffi")
    register: Callable[..., Any] = ffi._register_ffi_targets

    def register_paused(name: str, callback: Callable[..., Any]) -> Any:  # noqa: ANN401 - Warp's own
        return register(name, without_collection(callback))

    ffi._register_ffi_targets = register_paused
