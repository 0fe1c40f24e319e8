"""A line of progress that is written over itself on a terminal, and cleared before any other output."""

import threading
from typing import TextIO

CLEAR = "\r\033[K"
"""Moves the cursor to the begin of its line, and clears that."""


class StatusLine:
    """A line on a terminal; on other streams each text is a line of its own.

    Args:
        stream: Where it is written.
    """

    _shown: "StatusLine | None" = None
    _lock = threading.RLock()

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self.terminal = stream.isatty()

    def show(self, text: str) -> None:
        """Write a text in place of the last one."""
        with self._lock:
            self._stream.write(f"{CLEAR}{text}" if self.terminal else f"{text}\n")
            self._stream.flush()
            if self.terminal:
                StatusLine._shown = self

    def clear(self) -> None:
        """Clear the line if it is shown."""
        with self._lock:
            if StatusLine._shown is self:
                StatusLine._shown = None
                self._stream.write(CLEAR)
                self._stream.flush()


def clear_status() -> None:
    """Clear the line that is shown, if any: other output follows."""
    shown = StatusLine._shown  # pyright: ignore[reportPrivateUsage]
    if shown is not None:
        shown.clear()


def is_status_shown() -> bool:
    """Return whether a line is shown on a terminal; takes no lock, so a signal's handler may ask."""
    return StatusLine._shown is not None  # pyright: ignore[reportPrivateUsage]
