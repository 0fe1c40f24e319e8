"""Files of films: MP4 by the ffmpeg of the extra `film`, or one in PATH; GIF and pictures by Pillow."""

import shutil
import subprocess
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
from PIL import Image

from usarmjx.base.errors import MissingExtraError, UsageError
from usarmjx.base.installation import install_command

SUFFIXES = (".mp4", ".gif", ".png", ".jpg")
"""Suffixes of films, and of their first picture alone."""
JPEG_QUALITY = 88
QUALITY = "19"
"""Constant rate factor of H.264: lower is better; 18 hardly differs from the pictures."""
GIF_COLOURS, PALETTE_PICTURES = 255, 12
"""Colours of a GIF, and pictures from which they are chosen; one more is left for transparency."""


def find_ffmpeg() -> str:
    """Return the program.

    Raises:
        MissingExtraError: There is none; names the extra.
    """
    try:
        # Here, as the package belongs to an extra.
        import imageio_ffmpeg  # pyright: ignore[reportMissingImports, reportMissingTypeStubs]

        return imageio_ffmpeg.get_ffmpeg_exe()
    # imageio-ffmpeg raises RuntimeError if it has no program for this system.
    except (ImportError, RuntimeError):
        found = shutil.which("ffmpeg")
    if found is None:
        raise MissingExtraError(
            f"MP4 needs ffmpeg, which imageio-ffmpeg brings: {install_command('film')}; or write .gif"
        )
    return found


def write_mp4(pictures: Iterator[np.ndarray], path: Path, rate: float) -> int:
    """Write pictures (height, width, 3) uint8 as H.264; return their number.

    Raises:
        MissingExtraError: There is no ffmpeg.
        UsageError: Ffmpeg fails; quotes it.
    """
    program = find_ffmpeg()
    first = next(pictures)
    height, width = (number // 2 * 2 for number in first.shape[:2])  # yuv420p has even sides only
    command = [
        *(program, "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"),
        # Options before an input of ffmpeg describe the input, those after it the output.
        *("-s", f"{width}x{height}", "-r", f"{rate:g}", "-i", "-"),
        # Players of browsers take yuv420p only; faststart puts the index first, so they play while they load.
        # The format is named, as the fresh file has another suffix.
        *("-pix_fmt", "yuv420p", "-crf", QUALITY, "-movflags", "+faststart", "-f", "mp4", str(path)),
    ]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdin is not None
    count = 0
    try:
        for picture in _all(first, pictures):
            process.stdin.write(np.ascontiguousarray(picture[:height, :width]).tobytes())
            count += 1
    except BrokenPipeError:
        pass  # its standard error tells why
    # Ctrl-C, too: ffmpeg would wait for its input for ever.
    except BaseException:
        process.kill()
        process.communicate()
        raise
    # It closes the input, by which ffmpeg completes the file.
    _, message = process.communicate()
    if process.returncode:
        raise UsageError(
            f"ffmpeg: {' '.join(message.decode('utf-8', 'replace').split()) or process.returncode}"
        )
    return count


def write_gif(pictures: Iterator[np.ndarray], path: Path, rate: float) -> int:
    """Write pictures (height, width, 3) uint8 as a GIF with one palette; return their number."""
    frames = [Image.fromarray(picture) for picture in pictures]
    palette = _palette(frames)
    # Without dither: noise that changes from picture to picture flickers and packs badly.
    small = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    # A GIF counts hundredths of a second: rounded ends, so that the film lasts as long as it should.
    ends = np.round(np.arange(len(small) + 1) * 100 / rate).astype(int)
    small[0].save(
        path,
        format="GIF",
        save_all=True,
        append_images=small[1:],
        # Pillow takes milliseconds.
        duration=(10 * np.diff(ends)).tolist(),
        loop=0,
        # Pillow would choose a palette for each picture again.
        optimize=False,
    )
    return len(small)


def write_first(pictures: Iterator[np.ndarray], path: Path, rate: float, kind: str) -> int:
    """Write the first of pictures (height, width, 3) uint8 in a format of Pillow; return 1."""
    del rate
    Image.fromarray(next(pictures)).save(path, format=kind, quality=JPEG_QUALITY)
    return 1


def _palette(frames: list[Image.Image]) -> Image.Image:
    """Return a picture with the palette of some of the pictures, spread over the film."""
    # A short film has fewer pictures than places: the set below drops the repeated ones.
    chosen: list[float] = np.linspace(0, len(frames) - 1, PALETTE_PICTURES).tolist()
    some = [frames[n] for n in sorted({int(place) for place in chosen})]
    width, height = some[0].size
    sheet = Image.new("RGB", (width, height * len(some)))
    for row, frame in enumerate(some):
        sheet.paste(frame, (0, row * height))
    return sheet.quantize(GIF_COLOURS, method=Image.Quantize.MEDIANCUT)


def _all(first: np.ndarray, others: Iterator[np.ndarray]) -> Iterator[np.ndarray]:
    yield first
    yield from others


WRITERS: dict[str, Callable[[Iterator[np.ndarray], Path, float], int]] = {
    ".mp4": write_mp4,
    ".gif": write_gif,
    ".png": partial(write_first, kind="PNG"),
    ".jpg": partial(write_first, kind="JPEG"),
}
"""Writers of films, by the suffixes of files."""
