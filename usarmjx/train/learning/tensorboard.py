"""TensorBoard's event file, written without tensorboardX's thread."""

import os
import socket
import struct
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from usarmjx.base.errors import extra
from usarmjx.base.files import AppendedFile

with extra("train"):
    from tensorboardX.proto.event_pb2 import Event, SessionLog
    from tensorboardX.proto.summary_pb2 import Summary
    from tensorboardX.record_writer import masked_crc32c


class TensorBoardLog(AppendedFile):
    """Numbers for TensorBoard, over agent steps.

    They are written at once: tensorboardX's own writer has a thread for that, which ends when the disk is
    full, and then further writes block for ever.

    Args:
        folder: For the file.
        after: Agent steps that are done already; TensorBoard drops records of later ones.
    """

    def __init__(self, folder: Path, after: int) -> None:
        # Time, machine and process: a run that is resumed, or another one, must not write into the same
        # file.
        now = f"{time.time():.0f}.{socket.gethostname()}.{os.getpid()}"
        # TensorBoard reads the files whose names have tfevents in them.
        super().__init__(folder / f"events.out.tfevents.{now}")
        start: Any = SessionLog(status=SessionLog.START)
        # TensorBoard drops what an earlier file has from a START's step on: a resumed run repeats those
        # steps.
        first = Event(step=after + 1, file_version="brain.Event:2")
        # Written with the first numbers, so a run that fails at its start leaves no file.
        self._waiting = [_framed(first), _framed(Event(step=after + 1, session_log=start))]

    def show(self, agent_steps: int, numbers: Mapping[str, float]) -> None:
        """Write the numbers of an iteration, at a count of agent steps.

        Raises:
            WriteError: Nothing was written; they wait.
        """
        values = [Summary.Value(tag=name, simple_value=value) for name, value in numbers.items()]
        self.append(_framed(Event(step=agent_steps, wall_time=time.time(), summary=Summary(value=values))))

    def show_picture(self, agent_steps: int, name: str, gif: bytes) -> None:
        """Write a GIF, still or moving, at a count of agent steps.

        Raises:
            WriteError: Nothing was written; it waits.
        """
        # Six bytes of signature and version come before; GIF is little-endian.
        width, height = struct.unpack("<HH", gif[6:10])  # of the logical screen
        # A colorspace of 3 is RGB.
        picture = Summary.Image(height=height, width=width, colorspace=3, encoded_image_string=gif)
        summary = Summary(value=[Summary.Value(tag=name, image=picture)])
        self.append(_framed(Event(step=agent_steps, wall_time=time.time(), summary=summary)))


def _framed(event: Any) -> bytes:  # noqa: ANN401 - protobuf's
    """Return an event as a TFRecord: length, checksum of that, event, checksum of that."""
    data: bytes = event.SerializeToString()
    size = struct.pack("<Q", len(data))
    return b"".join((size, _checksum(size), data, _checksum(data)))


def _checksum(data: bytes) -> bytes:
    # Masked, as TFRecord asks: a checksum over data that holds checksums is weak.
    return struct.pack("<I", masked_crc32c(data))
