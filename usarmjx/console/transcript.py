"""The transcript: every message either way, one line each, with its direction and the time."""

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import IO

from usarmjx.base.errors import WriteError

SENT, RECEIVED, NOTE = ">", "<", "#"
"""Directions: from us, to us; and what is no message, as that the connection was lost."""


class Transcript:
    """A file of lines `2026-01-31T12:00:00.123Z > DRIVE {Left 1}`; `>` was sent, `<` came, `#` is a remark.

    Args:
        path: The file, which is continued if it is there; None: nothing is kept.
        now: Tells the time.

    Raises:
        WriteError: It cannot be written.
    """

    def __init__(self, path: Path | None, now: Callable[[], datetime] = lambda: datetime.now(UTC)) -> None:
        self._path, self._now = path, now
        self._file: IO[str] | None = None
        if path is not None:
            try:
                # Line by line, so that what there was is there whatever becomes of the console.
                self._file = path.open("a", encoding="utf-8", buffering=1)
            except OSError as error:
                raise WriteError(f"--transcript: cannot write {path}: {error.strerror}") from error

    def write(self, direction: str, line: str) -> None:
        """Add a line.

        Raises:
            WriteError: It cannot be written.
        """
        if self._file is None:
            return
        when = self._now().astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        try:
            self._file.write(f"{when} {direction} {line}\n")
        except OSError as error:
            self._file = None
            raise WriteError(f"--transcript: cannot write {self._path}: {error.strerror}") from error

    def __enter__(self) -> "Transcript":
        """Begin."""
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
