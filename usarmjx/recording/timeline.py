"""The panel beside a recording: play, pause, how fast and where; and a recording as one page for the web."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from usarmjx.base.files import write_beside
from usarmjx.recording.source import RecordingSource
from usarmjx.view.drawing import Drawing, Frame

if TYPE_CHECKING:
    import viser

    from usarmjx.view.page import ViewerPage

SPEEDS = {"x 1/4": 0.25, "x 1": 1.0, "x 2": 2.0, "x 5": 5.0, "x 20": 20.0, "x 100": 100.0}
"""How fast a recording may be played, as on the panel."""
USUAL_SPEED = "x 1"
STEP = 0.02
"""A control step of most worlds: what one can scrub by [s]."""
SLIDER_PERIOD = 0.2
"""The slider follows so often [s]."""


class Timeline:
    """A `view.panel.Panel` that moves the page's recording.

    Args:
        page: The page, of a `RecordingSource`.
        now: The clock [s].

    Attributes:
        playing: Whether time passes.
        speed: How many seconds of the recording pass in one.
    """

    def __init__(self, page: "ViewerPage", now: Callable[[], float] = time.monotonic) -> None:
        assert isinstance(page.source, RecordingSource)
        self._source, self._now, self._before = page.source, now, now()
        self.playing, self.speed = True, SPEEDS[USUAL_SPEED]
        self._shown_at, self._moves = 0.0, False
        gui, source = page.server.gui, self._source
        with gui.add_folder("Recording"):
            self._button = gui.add_button("Pause", hint="Play or pause")
            self._speed = gui.add_dropdown("Speed", tuple(SPEEDS), initial_value=USUAL_SPEED)
            longest = max(source.end, source.start + STEP)
            self._slider = gui.add_slider("Time [s]", source.start, longest, STEP, source.start)
        self._button.on_click(lambda _: page.post(self.toggle))
        self._speed.on_update(lambda _: page.post(self._change_speed))
        self._slider.on_update(lambda event: self._scrubbed(page) if event.client is not None else None)

    def _scrubbed(self, page: "ViewerPage") -> None:
        """Somebody has moved the slider."""
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
        """Let time pass."""
        now = self._now()
        passed, self._before = now - self._before, now
        if self.playing:
            self._source.seek(self._source.time + passed * self.speed)
            if self._source.time >= self._source.end:
                self.toggle()

    def begin(self, drawing: Drawing) -> None:
        """Nothing of the panel depends on what is drawn."""
        del drawing

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Show the present time on the slider."""
        del drawing, frame
        if abs(self._now() - self._shown_at) >= SLIDER_PERIOD:
            self._shown_at = self._now()
            self._slider.value = round(self._source.time / STEP) * STEP


def recording_page(
    source: RecordingSource, server: "viser.ViserServer | None" = None
) -> "tuple[ViewerPage, Timeline]":
    """Return a page that plays a recording and tells each robot's state and readings, and its timeline.

    Args:
        source: The recording.
        server: Who serves the page; None: a server of its own.
    """
    from usarmjx.view.page import ViewerPage
    from usarmjx.view.people import PeoplePanel

    title = source.recording.path.name
    page = ViewerPage(source, title=title, panels=[Timeline, PeoplePanel], server=server)
    (timeline,) = (panel for panel in page.panels if isinstance(panel, Timeline))
    return page, timeline


def write_html(source: RecordingSource, path: Path, period: float = 0.1, world: int = 0) -> None:
    """Write a recording as one file that any browser plays, without a server or the web.

    Args:
        source: The recording.
        path: The file.
        period: Time between two pictures [s].
        world: Which world.

    Raises:
        WriteError: It cannot be written.
    """
    from usarmjx.view.page import ViewerPage

    source.seek(source.start)
    page = ViewerPage(source, title=source.recording.path.name)
    try:
        if world:
            page.choose_world(world)
        scene = page.server.get_scene_serializer()
        count = max(1, round((source.end - source.start) / period))
        for picture in range(1, count + 1):
            source.seek(source.start + picture * period)
            page.refresh()
            scene.insert_sleep(period)
        text = scene.as_html()
    finally:
        page.close()
    with write_beside(path) as fresh:
        fresh.write_text(text, encoding="utf-8")
