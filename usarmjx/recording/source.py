"""A recording as a `view.drawing.FrameSource`: the page shows it like running worlds."""

import time
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.files import atomic_write
from usarmjx.models.compile.victims import victim_table
from usarmjx.recording.reader import RecordedMessage, Recording
from usarmjx.view.drawing import Drawing, Frame
from usarmjx.view.scoreboard import BoardFacts

if TYPE_CHECKING:
    import viser

    from usarmjx.view.page import ViewerPage


LONGEST_GAP = 1.0
"""Gap between two frames above which no motion is interpolated [s]."""
KEPT_DRAWINGS = 64
"""Number of decoded drawings that are kept."""
SPEEDS = {"x 1/4": 0.25, "x 1": 1.0, "x 2": 2.0, "x 5": 5.0, "x 20": 20.0, "x 100": 100.0}
"""Playing speeds of the panel, in seconds per second."""
USUAL_SPEED = "x 1"
STEP = 0.02
"""Step of the time slider [s]: a control step of most worlds."""
SLIDER_PERIOD = 0.2
"""Interval between two updates of the slider [s]."""


class RecordingSource:
    """The worlds of a recording at a time that `seek` sets.

    Args:
        recording: The recording.

    Attributes:
        recording: The recording.
        time: The present time [s].
        start: Time of its first frame [s].
        end: Time of its end [s].
        worlds: Numbers of its worlds, by the index that the methods take.

    Raises:
        UsageError: There are no frames in it.
    """

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self.worlds = tuple(
            world for world in recording.worlds if recording.following("frames", world, -1.0) is not None
        )
        if not self.worlds:
            raise UsageError(f"{recording.path}: there is nothing to be seen in it")
        firsts = [recording.following("frames", world, -1.0) for world in self.worlds]
        self.start = min(first.time for first in firsts if first is not None)
        self.end = recording.end
        self.time = self.start
        # On the instance: on the method the cache would keep closed recordings alive.
        self._read = lru_cache(maxsize=KEPT_DRAWINGS)(self._read_drawing)
        self._facts: dict[int, BoardFacts] = {}
        self._around: dict[int, tuple[RecordedMessage, RecordedMessage | None]] = {}

    @property
    def num_worlds(self) -> int:
        """Number of worlds with frames."""
        return len(self.worlds)

    def seek(self, time: float) -> None:
        """Go to a time [s], or to the beginning or end if it is beyond that."""
        self.time = min(max(time, self.start), self.end)

    def drawing(self, world: int) -> Drawing:
        """Return a world's drawing at the present time; the same object as long as it does not change."""
        return self._read(world, self._frame_message(world).time)[1]

    def _read_drawing(self, world: int, time: float) -> tuple[float, Drawing]:
        found = self.recording.last("drawings", self.worlds[world], time)
        if found is None or not isinstance(found.value, Drawing):
            raise UsageError(f"{self.recording.path}: no drawing of world {world} at {time:.2f} s")
        # Cached by the drawing's own time: frames of one drawing get one object, which the page compares.
        if found.time != time:
            return self._read(world, found.time)
        return found.time, found.value

    def board_facts(self, world: int) -> BoardFacts:
        """Return a world's facts for the scoreboard; without victims if the file does not have the arena."""
        if world not in self._facts:
            arenas = self.recording.setup(self.worlds[world]).arenas
            owners = victim_table(arenas[0].victims, arenas[0].false_alarms).owner if arenas else ()
            owners = np.asarray(owners, int)
            # A false alarm has a negative owner.
            self._facts[world] = BoardFacts(owners=owners, victims=len(np.unique(owners[owners >= 0])))
        return self._facts[world]

    def _frame_message(self, world: int) -> RecordedMessage:
        """Return the frame at the present time, the last one before it, or the first of all."""
        return self._frames_around(world)[0]

    def _frames_around(self, world: int) -> tuple[RecordedMessage, RecordedMessage | None]:
        # The page asks often between two frames: the last pair mostly serves, and nothing is read.
        known = self._around.get(world)
        if known is not None and known[1] is not None and known[0].time <= self.time < known[1].time:
            return known
        number = self.worlds[world]
        before = self.recording.last("frames", number, self.time)
        # Before a world's first frame it is shown as it begins.
        before = before or self.recording.following("frames", number, -1.0)
        assert before is not None  # every world of `worlds` has a frame
        self._around[world] = before, self.recording.following("frames", number, before.time)
        return self._around[world]

    def frame(self, world: int) -> Frame:
        """Return a world at the present time; between two frames bodies move linearly."""
        message, later = self._frames_around(world)
        before: Frame = message.value
        if self.time <= message.time or later is None or later.time > message.time + LONGEST_GAP:
            return before
        after: Frame = later.value
        drawings = self._read(world, message.time)[1], self._read(world, later.time)[1]
        # A robot has joined or left between the frames: their bodies have different indices.
        if drawings[0] is not drawings[1]:
            after = _in_order_of(drawings, before, after)
        return between(before, after, (self.time - message.time) / (later.time - message.time))


def _in_order_of(drawings: tuple[Drawing, Drawing], before: Frame, after: Frame) -> Frame:
    """Return a later frame with the bodies of an earlier one: bodies that are gone by then stay."""
    indices = {body.name: index for index, body in enumerate(drawings[1].bodies)}
    there = np.array([indices.get(body.name, -1) for body in drawings[0].bodies])
    gone = (there < 0)[:, None]
    return replace(
        after,
        pos=np.where(gone, before.pos, after.pos[there]),
        quat=np.where(gone, before.quat, after.quat[there]),
    )


def between(before: Frame, after: Frame, share: float) -> Frame:
    """Interpolate between two frames with the same drawing.

    Args:
        before: The earlier one.
        after: The later one.
        share: Elapsed share of the time between them, from 0 to 1.
    """
    # A quaternion and its negative are the same rotation: blend along the shorter way.
    sign = np.where((before.quat * after.quat).sum(-1, keepdims=True) < 0.0, -1.0, 1.0)
    # The blend of two unit quaternions is shorter than 1, and is normalised below to be a rotation.
    quat = before.quat + share * (sign * after.quat - before.quat)
    return replace(
        before,
        time=before.time + share * (after.time - before.time),
        pos=before.pos + share * (after.pos - before.pos),
        quat=quat / np.maximum(np.linalg.norm(quat, axis=-1, keepdims=True), 1e-9),
    )


class Timeline:
    """A `view.page.Panel` that moves through the page's recording.

    Args:
        page: The page, of a `RecordingSource`.
        now: Returns the time [s].

    Attributes:
        playing: Whether time passes.
        speed: Seconds of the recording per second.
    """

    def __init__(self, page: "ViewerPage", now: Callable[[], float] = time.monotonic) -> None:
        assert isinstance(page.source, RecordingSource)
        self._source, self._now, self._before = page.source, now, now()
        self.playing, self.speed = True, SPEEDS[USUAL_SPEED]
        self._shown_at = 0.0
        gui, source = page.server.gui, self._source
        with gui.add_folder("Recording"):
            self._button = gui.add_button("Pause", hint="Play or pause")
            self._speed = gui.add_dropdown("Speed", tuple(SPEEDS), initial_value=USUAL_SPEED)
            # A slider needs a span, which a recording of a single frame has not.
            longest = max(source.end, source.start + STEP)
            self._slider = gui.add_slider("Time [s]", source.start, longest, STEP, source.start)
        self._button.on_click(lambda _: page.post(self.toggle))
        self._speed.on_update(lambda _: page.post(self._change_speed))
        # The slider also moves by itself while it plays; then there is no client.
        self._slider.on_update(lambda event: self._scrubbed(page) if event.client is not None else None)

    def _scrubbed(self, page: "ViewerPage") -> None:
        """Go to the slider's time after a user has moved it."""
        page.post(lambda: self.go_to(float(self._slider.value)))

    def _change_speed(self) -> None:
        self.speed = SPEEDS[self._speed.value]

    def toggle(self) -> None:
        """Play, from the beginning if it was over, or pause."""
        self.playing = not self.playing
        if self.playing and self._source.time >= self._source.end:
            self._source.seek(self._source.start)
        self._button.label = "Pause" if self.playing else "Play"

    def go_to(self, time: float) -> None:
        """Go to a time [s]."""
        self._source.seek(time)

    def tick(self) -> None:
        """Advance the recording by the elapsed time."""
        now = self._now()
        # Measured, not counted: ticks come late when the page is busy.
        passed, self._before = now - self._before, now
        if self.playing:
            self._source.seek(self._source.time + passed * self.speed)
            if self._source.time >= self._source.end:
                self.toggle()

    def begin(self, drawing: Drawing) -> None:
        """Do nothing: the panel does not depend on the drawing."""
        del drawing

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Show the present time on the slider."""
        del drawing, frame
        if abs(self._now() - self._shown_at) >= SLIDER_PERIOD:
            self._shown_at = self._now()
            # The slider takes multiples of its step only.
            self._slider.value = round(self._source.time / STEP) * STEP


def recording_page(
    source: RecordingSource, server: "viser.ViserServer | None" = None
) -> "tuple[ViewerPage, Timeline]":
    """Return a page that plays a recording and shows each robot's state and readings, and its timeline.

    Args:
        source: The recording.
        server: Server of the page; None for one of its own.
    """
    from usarmjx.view.page import ViewerPage
    from usarmjx.view.user_panels import UserPanels

    title = source.recording.path.name
    page = ViewerPage(source, title=title, panels=[Timeline, UserPanels], server=server)
    (timeline,) = (panel for panel in page.panels if isinstance(panel, Timeline))
    return page, timeline


def write_html(source: RecordingSource, path: Path, period: float = 0.1, world: int = 0) -> None:
    """Write a recording as one HTML file that any browser plays, without a server or the web.

    Args:
        source: The recording.
        path: The file.
        period: Time between two pictures [s].
        world: Index of the world.

    Raises:
        WriteError: It cannot be written.
    """
    from usarmjx.view.page import ViewerPage

    source.seek(source.start)
    page = ViewerPage(source, title=source.recording.path.name)
    try:
        if world:
            page.choose_world(world)
        # Viser's recorder of messages: it starts with all that the scene has now.
        scene = page.server.get_scene_serializer()
        count = max(1, round((source.end - source.start) / period))
        for picture in range(1, count + 1):
            source.seek(source.start + picture * period)
            page.refresh()
            scene.insert_sleep(period)
        text = scene.as_html()
    finally:
        page.close()
    with atomic_write(path) as fresh:
        fresh.write_text(text, encoding="utf-8")
