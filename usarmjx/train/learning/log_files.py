"""What a run writes as it goes on: lines of JSON, and TensorBoard's events. A full disk only delays them."""

import os
import socket
import struct
import time
from collections.abc import Mapping
from contextlib import suppress
from io import FileIO
from pathlib import Path
from typing import Any

from tensorboardX.proto.event_pb2 import Event, SessionLog
from tensorboardX.proto.summary_pb2 import Summary
from tensorboardX.record_writer import masked_crc32c

from usarmjx.base.files import writing


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


class Board(AppendedFile):
    """Numbers for TensorBoard.

    They are written at once: tensorboardX's own writer has a thread for that, which ends when the disk is
    full, and then whoever hands it more waits for ever.

    Args:
        folder: For the file.
        after: Iterations that are behind already; TensorBoard forgets what it was shown of later ones.
    """

    def __init__(self, folder: Path, after: int) -> None:
        now = f"{time.time():.0f}.{socket.gethostname()}.{os.getpid()}"
        super().__init__(folder / f"events.out.tfevents.{now}")
        start: Any = SessionLog(status=SessionLog.START)
        first = Event(step=after + 1, file_version="brain.Event:2")
        self._waiting = [_framed(first), _framed(Event(step=after + 1, session_log=start))]

    def show(self, iteration: int, numbers: Mapping[str, float]) -> None:
        """Write down the numbers of an iteration.

        Raises:
            WriteError: Nothing was written; they wait.
        """
        values = [Summary.Value(tag=name, simple_value=value) for name, value in numbers.items()]
        self.append(_framed(Event(step=iteration, wall_time=time.time(), summary=Summary(value=values))))


def _framed(event: Any) -> bytes:  # noqa: ANN401 - protobuf's
    """Return an event as a TFRecord: length, checksum of that, event, checksum of that."""
    data: bytes = event.SerializeToString()
    size = struct.pack("<Q", len(data))
    return b"".join((size, _checksum(size), data, _checksum(data)))


def _checksum(data: bytes) -> bytes:
    return struct.pack("<I", masked_crc32c(data))
