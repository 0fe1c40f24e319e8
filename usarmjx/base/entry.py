"""Guards of the methods through which programs use JAX: single precision, and no forked process."""

import os
import sys
from functools import wraps
from types import FunctionType
from typing import Any, TypeVar, cast

import jax

from usarmjx.base.backend import single_precision
from usarmjx.base.errors import UsageError

T = TypeVar("T", bound=type)
FORKED = (
    "this process was forked from one in which JAX had started, and would hang: start it with 'spawn', as "
    "AsyncVectorEnv(..., context='spawn'), SubprocVecEnv(..., start_method='spawn') or "
    "DataLoader(..., multiprocessing_context='spawn')"
)


class _Process:
    """Whether this process can use JAX."""

    is_forked = False


def _note_fork() -> None:
    bridge = sys.modules.get("jax._src.xla_bridge")
    started = getattr(bridge, "backends_are_initialized", lambda: bridge is not None)
    # A fork of a fork stays unusable.
    _Process.is_forked = _Process.is_forked or bool(started())


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_note_fork)


def check_not_forked() -> None:
    """Refuse a process that was forked after JAX had started: its threads are missing there.

    Raises:
        UsageError: It was; names the way out.
    """
    if _Process.is_forked:
        raise UsageError(FORKED)


def jax_entry_points(cls: T) -> T:
    """Guard the constructor and all methods that a class defines; a decorator.

    They compute in single precision whatever `jax_enable_x64` says, and raise a `UsageError` in a process
    that was forked after JAX had started.
    """
    for name, method in list(vars(cls).items()):
        if isinstance(method, FunctionType) and (name == "__init__" or not name.startswith("__")):
            setattr(cls, name, _guarded(method))
    return cls


def _guarded(method: FunctionType) -> FunctionType:
    precise, settings = single_precision(method), cast(Any, jax.config)

    @wraps(method)
    def run(*args: object, **kwargs: object) -> object:
        check_not_forked()
        # Every step comes here: another call would be a third of what the guard costs.
        return (precise if settings.jax_enable_x64 else method)(*args, **kwargs)

    return run  # type: ignore[return-value] - of the same signature
