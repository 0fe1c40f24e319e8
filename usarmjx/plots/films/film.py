"""A recording as a film in three dimensions, from a corner above or behind a robot."""

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.files import atomic_write
from usarmjx.plots.films.codecs import SUFFIXES, WRITERS, find_ffmpeg
from usarmjx.plots.films.overlays import Signs, write_captions
from usarmjx.plots.films.picture import FilmScene
from usarmjx.plots.films.raster import FilmView
from usarmjx.recording.reader import Recording
from usarmjx.recording.source import RecordingSource
from usarmjx.view.drawing import Drawing, Frame
from usarmjx.view.viewpoint import CameraPose, Chase, fit_box

MIN_SIDE, MAX_SIDE, MIN_GIF_WIDTH = 64, 4096, 64
"""Least and largest sides of a film [pixels]."""
HEADING_SHARE = 0.12
"""Share of a robot's turn that the view over it follows in a picture: it swings gently."""


@dataclass(frozen=True, kw_only=True)
class FilmPlan:
    """Choice of worlds, moments and view of a film.

    Attributes:
        size: Width and height [pixels].
        follow: Name of the robot that the camera follows; None: it sees the whole arena.
        world: Number of the world in the recording.
        span: Simulated times of begin and end [s].
        speed: Simulated seconds per second.
        rate: Pictures per second.
        signs: Whether laser scans, rings, trails, names and the line of the score are drawn.
    """

    size: tuple[int, int] = (1280, 720)
    follow: str | None = None
    world: int = 0
    span: tuple[float, float] = (0.0, math.inf)
    speed: float = 1.0
    rate: float = 30.0
    signs: bool = True


def parse_size(text: str) -> tuple[int, int]:
    """Return width and height of a text such as `1920x1080`.

    Raises:
        UsageError: Another text, or a side out of range.
    """
    found = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    size = (int(found[1]), int(found[2])) if found else (0, 0)
    if not all(MIN_SIDE <= side <= MAX_SIDE for side in size):
        raise UsageError(
            f"size {text!r}; expected WIDTHxHEIGHT with {MIN_SIDE} to {MAX_SIDE} pixels a side, as 1920x1080"
        )
    return size


def save_film(
    recording: Recording, path: Path, plan: FilmPlan, tell: Callable[[int, int], None] = lambda done, of: None
) -> int:
    """Write a film of a recording; return the number of its pictures.

    Args:
        recording: The recording.
        path: File to write, .mp4 or .gif; .png and .jpg get the first picture.
        plan: Choice of its moments and view.
        tell: Takes the number of finished pictures and that of all.

    Raises:
        UsageError: Another suffix, no such world or robot, or nothing in the span.
        MissingExtraError: An MP4 without ffmpeg.
        WriteError: It cannot be written.
    """
    check_film(path)
    source = RecordingSource(recording)
    index = _world_index(recording, source, plan.world)
    times = picture_times(plan, source.start, source.end)
    if plan.follow is not None:
        _check_robot(source, index, plan.follow, times)

    # One at a time: the pictures of a long film would not fit into memory.
    def pictures() -> Iterator[np.ndarray]:
        shots = Shots(source, index, plan)
        for done, time in enumerate(times.tolist(), 1):
            yield shots.picture(time)
            tell(done, len(times))

    with atomic_write(path) as fresh:
        return WRITERS[path.suffix.lower()](pictures(), fresh, plan.rate)


def check_film(path: Path) -> None:
    """Refuse files that no film can be written to.

    Raises:
        UsageError: Lists the suffixes.
        MissingExtraError: An MP4 without ffmpeg.
    """
    if path.suffix.lower() not in WRITERS:
        raise UsageError(f"{path}: films end in {', '.join(SUFFIXES)}")
    if path.suffix.lower() == ".mp4":
        # Before any picture is drawn, which takes minutes.
        find_ffmpeg()


def picture_times(plan: FilmPlan, start: float, end: float) -> np.ndarray:
    """Return the simulated time of each picture [s] (pictures,).

    Raises:
        UsageError: The span is empty.
    """
    begin, last = max(plan.span[0], start), min(plan.span[1], end)
    if begin > last:
        raise UsageError(
            f"nothing from {plan.span[0]:g} to {plan.span[1]:g} s; the recording has {start:g} to {end:g} s"
        )
    # A single moment is a picture, too.
    count = max(1, round((last - begin) * plan.rate / plan.speed))
    # Counted and not added up, so that rounding does not grow with the length of the film.
    return begin + np.arange(count) * plan.speed / plan.rate


def _world_index(recording: Recording, source: RecordingSource, world: int) -> int:
    if world not in source.worlds:
        known = ", ".join(map(str, source.worlds))
        raise UsageError(f"{recording.path}: has no world {world}; it has: {known}")
    return source.worlds.index(world)


def _check_robot(source: RecordingSource, index: int, name: str, times: np.ndarray) -> None:
    """Refuse names of robots that are not there at some second of the film.

    Raises:
        UsageError: Lists the robots that are.
    """
    known: dict[str, None] = {}
    # The last moment is added: a short film has no whole second.
    for time in np.unique(np.append(np.arange(times[0], times[-1], 1.0), times[-1])).tolist():
        source.seek(time)
        drawing, frame = source.drawing(index), source.frame(index)
        known |= {drawing.robots[slot].name: None for slot in sorted(frame.robots) if slot in drawing.robots}
        if name in known:
            return
    raise UsageError(f"no robot {name!r} in that time; known: {', '.join(known) or 'none'}")


class Shots:
    """Pictures of a world of a recording, in the order of time.

    Args:
        source: The recording.
        index: Index of the world in the source.
        plan: Choice of moments and view.
    """

    def __init__(self, source: RecordingSource, index: int, plan: FilmPlan) -> None:
        self._source, self._index, self._plan = source, index, plan
        self._drawing: Drawing | None = None
        self._last: CameraPose | None = None

    def picture(self, time: float) -> np.ndarray:
        """Return the picture of a simulated time [s]: colours, 0 to 255 uint8 (height, width, 3)."""
        self._source.seek(time)
        drawing, frame = self._source.drawing(self._index), self._source.frame(self._index)
        # Robots have joined or left: all that was prepared for the old drawing is void.
        if drawing is not self._drawing:
            self._drawing, self._scene, self._signs = drawing, FilmScene(drawing), Signs(drawing)
            self._chase = Chase(drawing, HEADING_SHARE)
        pose, moves = self._pose(drawing, frame)
        view = FilmView.of(pose, *self._plan.size)
        overlays = self._signs.overlays(frame, view) if self._plan.signs else []
        # Only a camera that stands still shows the same background again.
        picture = self._scene.render(frame, view, overlays, keep=not moves)
        if not self._plan.signs:
            return picture
        return write_captions(picture, drawing, frame, view, caption(frame))

    def _pose(self, drawing: Drawing, frame: Frame) -> tuple[CameraPose, bool]:
        """Return the pose of the camera, and whether it moves; it waits where a followed robot is gone."""
        slots = {robot.name: slot for slot, robot in drawing.robots.items() if slot in frame.robots}
        slot = None if self._plan.follow is None else slots.get(self._plan.follow)
        if slot is not None:
            self._last = self._chase.pose(drawing.robots[slot], frame)
            return self._last, True
        width, height = self._plan.size
        # Without the followed robot the camera stays at its last pose.
        return self._last or fit_box(*self._scene.bounds, width / height), False


def caption(frame: Frame) -> str:
    """Return the line of a frame: minutes and seconds, and the score of a task."""
    time = f"{int(frame.time) // 60}:{frame.time % 60:04.1f}"
    return time if frame.score is None else f"{time}   score {frame.score:.1f}"
