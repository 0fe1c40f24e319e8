"""Memory that the C library keeps although it was freed."""

import ctypes
from collections.abc import Callable
from functools import cache
from typing import Any, cast


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
