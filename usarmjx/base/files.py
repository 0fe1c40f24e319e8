"""Files are written beside their place and renamed: a full disk leaves the old one whole, and is one line."""

import errno
import os
import re
from collections.abc import Generator
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path

from usarmjx.base.errors import SpecError, WriteError

PARTIAL = ".partial"
"""In the name of what is being written."""
DISK_FAULTS = (
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EFBIG,
    errno.EROFS,
    errno.EIO,
    errno.EACCES,
    errno.EPERM,
    errno.ESTALE,
)
"""What a disk refuses with: no room, files too large, no right to write, broken."""
FOREIGN_FAULT = re.compile(r"os_error_code=.(\d+)")
"""How TensorStore, which writes checkpoints, says what the system said."""


def disk_fault(error: BaseException | None) -> str | None:
    """Return what a disk refused with, in the system's words; None where it was something else."""
    while error is not None:
        number = error.errno if isinstance(error, OSError) else None
        if number is None and (told := FOREIGN_FAULT.search(str(error))):
            number = int(told[1])
        if number in DISK_FAULTS:
            return os.strerror(number)
        error = error.__cause__ or error.__context__
    return None


def read_bounded(path: Path, most: int) -> bytes:
    """Return what a file holds, which may be a pipe.

    Raises:
        SpecError: It is not there, cannot be read, or has more than so many bytes.
    """
    try:
        with path.open("rb") as file:
            data = file.read(most + 1)
    except OSError as error:
        raise SpecError(f"{path}: cannot be read: {error.strerror or error}") from error
    if len(data) > most:
        raise SpecError(f"{path}: has more than {most} bytes, which are too many")
    return data


@contextmanager
def writing(path: Path) -> Generator[None]:
    """Turn what goes wrong while a path is written to into one line.

    Raises:
        WriteError: Names the path and the reason.
    """
    try:
        yield
    except OSError as error:
        reason = disk_fault(error) or error.strerror or error
        raise WriteError(f"cannot write {path}: {reason}") from error


@contextmanager
def write_beside(path: Path) -> Generator[Path]:
    """Give a path to write to, which takes the file's place if all goes well, and else is deleted.

    Folders are made. What is no file, such as a pipe or a terminal, is written to as it is.

    Raises:
        WriteError: Names the path and the reason; what was there before is untouched.
    """
    path = Path(path)
    with writing(path):
        if path.exists() and not path.is_file():
            yield path
            return
        place = Path(os.path.realpath(path))  # a link stays a link
        place.parent.mkdir(parents=True, exist_ok=True)
        fresh = place.with_name(f".{place.stem}{PARTIAL}-{os.getpid()}{place.suffix}")
        try:
            yield fresh
            with fresh.open("rb+") as file:
                os.fsync(file.fileno())
            fresh.replace(place)
        finally:
            with suppress(OSError):
                fresh.unlink(missing_ok=True)


class AppendedFile:
    """A file that always ends with a whole record; what could not be appended waits for the next one.

    Args:
        path: The file, which may be there already; its folder is made.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._waiting: list[bytes] = []
        self._file: FileIO | None = None
        self._size = 0

    @property
    def waiting(self) -> int:
        """How many records could not be appended yet."""
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
                    left = left[file.write(left) :]
            except OSError:
                file.truncate(self._size)
                raise
        self._waiting, self._size = [], end

    def _open(self) -> FileIO:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._file = FileIO(self.path, "a")
        self._size = os.fstat(self._file.fileno()).st_size
        return self._file

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            with suppress(OSError):
                self._file.close()
