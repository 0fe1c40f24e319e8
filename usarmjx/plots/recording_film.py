"""Recordings as films from above: GIF by Pillow, MP4 by ffmpeg where that is installed."""

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.files import write_beside
from usarmjx.plots.mission import RecordedMission, read_mission
from usarmjx.plots.play import EpisodeRecording, film_frames, save_gif
from usarmjx.recording.reader import Recording

PICTURES_PER_SECOND = 20


def save_film(recording: Recording, path: Path, world: int = 0, speed: float = 2.0) -> None:
    """Write a world of a recording as a film from above.

    Args:
        recording: The recording.
        path: File to write, .gif or .mp4.
        world: Which world.
        speed: Of an MP4: how many seconds of the recording pass in one.

    Raises:
        UsageError: Another suffix, no such world, or ffmpeg is missing.
        WriteError: It cannot be written.
    """
    write = FILMS.get(path.suffix.lower())
    if write is None:
        raise UsageError(f"{path}: films end in {', '.join(FILMS)}")
    shown = _as_episode(read_mission(recording, world, (0.0, np.inf)), recording.path.stem)
    with write_beside(path) as fresh:
        write(shown, fresh, speed)


def _as_episode(mission: RecordedMission, title: str) -> EpisodeRecording:
    """Return a mission as what films are drawn of; who was not there yet stands where it came."""
    times = np.unique(np.concatenate([way.times for way in mission.ways]))
    poses = np.zeros((len(times), len(mission.ways), 3))
    for place, way in enumerate(mission.ways):
        last = np.clip(np.searchsorted(way.times, times, side="right") - 1, 0, None)
        poses[:, place] = np.array(way.poses)[last]
    known, scores = zip(*(mission.scores or [(0.0, 0.0)]), strict=True)
    late = np.clip(np.searchsorted(known, times, side="right") - 1, 0, None)
    when, where = zip(*mission.loose, strict=True)
    seen = np.clip(np.searchsorted(when, times, side="right") - 1, 0, None)
    return EpisodeRecording(
        task=title,
        arena=mission.arena,
        names=tuple(way.name for way in mission.ways),
        times=times,
        scores=np.array(scores)[late],
        poses=poses,
        loose=np.array(where)[seen],
        goal=None,
        end="",
    )


def _save_gif(shown: EpisodeRecording, path: Path, speed: float) -> None:
    save_gif(shown, path, speed)


def _save_mp4(shown: EpisodeRecording, path: Path, speed: float) -> None:
    """Pipe pictures to ffmpeg."""
    lasts = (shown.times[-1] - shown.times[0]) / speed
    count = max(2, round(lasts * PICTURES_PER_SECOND))
    wanted = np.linspace(shown.times[0], shown.times[-1], count)
    frames = np.clip(np.searchsorted(shown.times, wanted, side="right") - 1, 0, None)
    pictures = film_frames(shown, frames)
    first = next(pictures)
    height, width = (number // 2 * 2 for number in first.shape[:2])  # what yuv420p can have
    command = [
        *(_ffmpeg(), "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"),
        *("-s", f"{width}x{height}", "-r", str(PICTURES_PER_SECOND), "-i", "-"),
        *("-pix_fmt", "yuv420p", "-f", "mp4", str(path)),
    ]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdin is not None
    try:
        for picture in (first, *pictures):
            process.stdin.write(np.ascontiguousarray(picture[:height, :width]).tobytes())
    except BrokenPipeError:
        pass  # it says why
    _, said = process.communicate()
    if process.returncode:
        raise UsageError(f"ffmpeg: {said.decode('utf-8', 'replace').strip() or process.returncode}")


def _ffmpeg() -> str:
    """Return the program.

    Raises:
        UsageError: There is none.
    """
    try:
        import imageio_ffmpeg  # pyright: ignore[reportMissingImports]

        return imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError):
        found = shutil.which("ffmpeg")
    if found is None:
        raise UsageError("MP4 needs ffmpeg: pip install imageio-ffmpeg; or write .gif")
    return found


FILMS: dict[str, Callable[[EpisodeRecording, Path, float], None]] = {".gif": _save_gif, ".mp4": _save_mp4}
"""What films are written as, by the ends of files' names."""
