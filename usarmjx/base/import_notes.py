"""Imports without MJX's notes on the standard output that Warp is missing; Brax imports MJX, too."""

import builtins
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any

NOTE = "Failed to import"


class _Filter:
    """The replacement of `print` while a thread imports; others print as usual."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._users = 0
        self._usual: Callable[..., Any] = builtins.print

    def begin(self) -> None:
        """Drop notes until the last user ends."""
        with self._lock:
            self._users += 1
            if self._users == 1:
                self._usual, builtins.print = builtins.print, self._print_other

    def end(self) -> None:
        """Print notes again, unless another user goes on."""
        with self._lock:
            self._users -= 1
            if not self._users:
                builtins.print = self._usual

    def _print_other(self, *words: object, **options: object) -> None:
        if not (words and str(words[0]).startswith(NOTE)):
            self._usual(*words, **options)


_FILTER = _Filter()


@contextmanager
def without_notes() -> Generator[None]:
    """Drop what MJX prints of optional packages."""
    _FILTER.begin()
    try:
        yield
    finally:
        _FILTER.end()
