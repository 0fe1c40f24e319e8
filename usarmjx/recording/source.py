"""A recording as a `view.drawing.FrameSource`: the page shows it as it shows worlds that run."""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.recording.reader import RecordedMessage, Recording
from usarmjx.view.drawing import Drawing, Frame

LONGEST_GAP = 1.0
"""Between frames that are further apart nothing is filled in [s]."""
KEPT_DRAWINGS = 64


class RecordingSource:
    """The worlds of a recording at a time that `seek` chooses.

    Args:
        recording: The recording.

    Attributes:
        recording: The recording.
        time: The present time [s].
        start: When it begins [s].
        end: When it ends [s].

    Raises:
        UsageError: There is nothing to be seen in it.
    """

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self._worlds = tuple(
            world for world in recording.worlds if recording.following("frames", world, -1.0) is not None
        )
        if not self._worlds:
            raise UsageError(f"{recording.path}: there is nothing to be seen in it")
        firsts = [recording.following("frames", world, -1.0) for world in self._worlds]
        self.start = min(first.time for first in firsts if first is not None)
        self.end = recording.end
        self.time = self.start
        self._read = lru_cache(maxsize=KEPT_DRAWINGS)(self._read_drawing)
        self._around: dict[int, tuple[RecordedMessage, RecordedMessage | None]] = {}

    @property
    def num_worlds(self) -> int:
        """How many worlds there are to choose from."""
        return len(self._worlds)

    def seek(self, time: float) -> None:
        """Go to a time [s], or to the beginning or end if it is beyond that."""
        self.time = min(max(time, self.start), self.end)

    def drawing(self, world: int) -> Drawing:
        """Return what a world looks like at the present time; the same object as long as that is the same."""
        return self._read(world, self._frame_message(world).time)[1]

    def _read_drawing(self, world: int, time: float) -> tuple[float, Drawing]:
        found = self.recording.last("drawings", self._worlds[world], time)
        if found is None or not isinstance(found.value, Drawing):
            raise UsageError(f"{self.recording.path}: no drawing of world {world} at {time:.2f} s")
        if found.time != time:
            return self._read(world, found.time)
        return found.time, found.value

    def _frame_message(self, world: int) -> RecordedMessage:
        """Return the frame at the present time, the last one before it, or the first of all."""
        return self._frames_around(world)[0]

    def _frames_around(self, world: int) -> tuple[RecordedMessage, RecordedMessage | None]:
        known = self._around.get(world)
        if known is not None and known[1] is not None and known[0].time <= self.time < known[1].time:
            return known
        number = self._worlds[world]
        before = self.recording.last("frames", number, self.time)
        before = before or self.recording.following("frames", number, -1.0)
        assert before is not None  # or the world would not be among those to choose from
        self._around[world] = before, self.recording.following("frames", number, before.time)
        return self._around[world]

    def frame(self, world: int) -> Frame:
        """Return a world at the present time; between two frames bodies move evenly."""
        message, later = self._frames_around(world)
        before: Frame = message.value
        if self.time <= message.time or later is None or later.time > message.time + LONGEST_GAP:
            return before
        after: Frame = later.value
        drawings = self._read(world, message.time)[1], self._read(world, later.time)[1]
        if drawings[0] is not drawings[1]:
            after = _in_order_of(drawings, before, after)
        return between(before, after, (self.time - message.time) / (later.time - message.time))


def _in_order_of(drawings: tuple[Drawing, Drawing], before: Frame, after: Frame) -> Frame:
    """Return a later frame with the bodies of an earlier one: those that are gone by then stay."""
    places = {body.name: place for place, body in enumerate(drawings[1].bodies)}
    there = np.array([places.get(body.name, -1) for body in drawings[0].bodies])
    gone = (there < 0)[:, None]
    return replace(
        after,
        pos=np.where(gone, before.pos, after.pos[there]),
        quat=np.where(gone, before.quat, after.quat[there]),
    )


def between(before: Frame, after: Frame, share: float) -> Frame:
    """Return a world between two frames with the same drawing.

    Args:
        before: The earlier one.
        after: The later one.
        share: How much of the time between them has passed, from 0 to 1.
    """
    sign = np.where((before.quat * after.quat).sum(-1, keepdims=True) < 0.0, -1.0, 1.0)
    quat = before.quat + share * (sign * after.quat - before.quat)
    return replace(
        before,
        time=before.time + share * (after.time - before.time),
        pos=before.pos + share * (after.pos - before.pos),
        quat=quat / np.maximum(np.linalg.norm(quat, axis=-1, keepdims=True), 1e-9),
    )
