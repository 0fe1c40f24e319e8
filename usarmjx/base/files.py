"""Atomic file writes: a temporary file beside the target, then a rename.

A full disk leaves the old file intact and becomes a one-line error.
"""

import errno
import os
import secrets
from collections.abc import Generator
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path

from usarmjx.base.errors import SpecError, WriteError

PARTIAL_MARK = ".partial"
"""Part of the name of an unfinished file."""
DISK_ERRORS = (
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EFBIG,
    errno.EROFS,
    errno.EIO,
    errno.EACCES,
    errno.EPERM,
    errno.ESTALE,
    errno.ENAMETOOLONG,
    errno.ELOOP,
)
"""Error numbers of a disk: no space, file too large, no permission, read-only, I/O error, refused name."""


def disk_error(error: BaseException | None) -> str | None:
    """Return the system's message for a disk error in a chain of exceptions; None: no disk error."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in DISK_ERRORS:
            return os.strerror(error.errno)
        # Libraries wrap the system's error in their own.
        error = error.__cause__ or error.__context__
    return None


def read_bounded(path: Path, max_bytes: int) -> bytes:
    """Return the content of a file, which may be a pipe.

    Raises:
        SpecError: The file is missing, unreadable, or longer than `max_bytes` bytes.
    """
    try:
        with path.open("rb") as file:
            # One byte more than allowed tells too long from just fitting, also of a pipe, which has no size.
            data = file.read(max_bytes + 1)
    except OSError as error:
        raise SpecError(f"{path}: cannot be read: {error.strerror or error}") from error
    if len(data) > max_bytes:
        raise SpecError(f"{path}: has more than {max_bytes} bytes, which are too many")
    return data


@contextmanager
def writing(path: Path) -> Generator[None]:
    """Turn an error while writing to a path into a one-line `WriteError`.

    Raises:
        WriteError: Names the path and the reason.
    """
    try:
        yield
    except OSError as error:
        reason = disk_error(error) or error.strerror or error
        raise WriteError(f"cannot write {path}: {reason}") from error


@contextmanager
def atomic_write(path: Path) -> Generator[Path]:
    """Yield a temporary path that replaces the file on success and is deleted on failure.

    Folders are created. A target that is not a regular file, such as a pipe or a terminal, is written
    directly.

    Raises:
        WriteError: Names the path and the reason; the old file is untouched.
    """
    path = Path(path)
    with writing(path):
        # A rename would replace a pipe or /dev/stdout by a plain file.
        if path.exists() and not path.is_file():
            yield path
            return
        target = Path(os.path.realpath(path))  # a link stays a link
        target.parent.mkdir(parents=True, exist_ok=True)
        fresh = _partial_file(target)
        try:
            yield fresh
            with fresh.open("rb+") as file:
                # Before the rename: else a crash of the machine could leave the new name on an empty file.
                os.fsync(file.fileno())
            fresh.replace(target)
        finally:
            with suppress(OSError):
                fresh.unlink(missing_ok=True)


def _partial_file(target: Path) -> Path:
    """Create an empty file beside a target, under a name that no other writer of any machine has."""
    while True:
        # Containers that share a folder share process ids. The suffix stays last for those that look at it.
        fresh = target.with_name(f".{target.stem}{PARTIAL_MARK}-{secrets.token_hex(8)}{target.suffix}")
        try:
            # The usual permissions, less the umask; files of tempfile would be private.
            os.close(os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
        except FileExistsError:
            continue
        return fresh


class AppendedFile:
    """File of whole records; a record that cannot be appended waits for the next attempt.

    Args:
        path: File, which may exist; its folder is created.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._waiting: list[bytes] = []
        self._file: FileIO | None = None
        self._size = 0

    @property
    def waiting(self) -> int:
        """Number of records not yet written."""
        return len(self._waiting)

    def append(self, record: bytes) -> None:
        """Append a record.

        Raises:
            WriteError: Nothing was appended; the record waits.
        """
        self._waiting.append(record)
        with writing(self.path):
            file = self._file or self._open()
            left = memoryview(b"".join(self._waiting))
            end = self._size + len(left)
            try:
                while left:
                    # Unbuffered files may take only a part of what they are given.
                    left = left[file.write(left) :]
            except OSError:
                # A partial record at the end would make the file unreadable.
                file.truncate(self._size)
                raise
        self._waiting, self._size = [], end

    def _open(self) -> FileIO:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        # Unbuffered: what is appended is either in the file or still waiting, and never in between.
        self._file = FileIO(self.path, "a")
        self._size = os.fstat(self._file.fileno()).st_size
        return self._file

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            with suppress(OSError):
                self._file.close()
