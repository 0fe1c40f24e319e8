"""Images as terrain heights and as grey values of maps, with limits on their size."""

from pathlib import Path

import numpy as np

from usarmjx.base.errors import ArenaFileError
from usarmjx.base.files import atomic_write
from usarmjx.base.settings.files import read_bytes

FORMATS = ("PNG", "PPM", "BMP", "JPEG", "GIF")
"""Image formats by Pillow's names (PPM: also PGM and PBM); decoders of others run external programs."""


MAX_PIXELS = 16_000_000
"""Largest number of pixels of a map."""


MAX_HEIGHTS = 1_000_000
"""Largest number of heights of a terrain."""


LOSSY_FORMATS = ("JPEG",)
"""Formats with lossy compression."""


WHITE_BY_MODE = {"L": 255, "I;16": 65535, "I;16B": 65535, "I": 65535}
"""Value of white in Pillow's modes with one grey value."""


def read_heights(path: Path, height: float) -> np.ndarray:
    """Return the terrain in a grey image of 8 or 16 bits [m] (rows, columns), the lowest row of y first.

    Black is 0 and white is `height`; the first line of the image is far, at the largest y.

    Raises:
        ArenaFileError: A file that is unreadable, has colours, or is too small or too large, or is a JPEG,
            whatever its suffix: lossy compression changes the heights.
    """
    mode, pixels, form = _read_image(path, MAX_HEIGHTS)
    if form in LOSSY_FORMATS:
        raise ArenaFileError(
            f"{path}: is a {form} image, which is lossy: a floor drawn flat comes out bumpy; "
            "give heights as PNG, made from the original"
        )
    if mode not in WHITE_BY_MODE or pixels.ndim != 2:
        raise ArenaFileError(
            f"{path}: is an image of mode {mode}; heights are grey values of 8 or 16 bits, nothing else"
        )
    if min(pixels.shape) < 2:
        raise ArenaFileError(f"{path}: a terrain has at least 2 x 2 heights")
    # Images count rows from the top, terrain from the lowest y.
    return pixels[::-1].astype(float) / WHITE_BY_MODE[mode] * height


def read_height_shares(path: Path) -> np.ndarray:
    """Return the terrain in an image as shares of white (rows, columns), the lowest row of y first.

    Colours count as their mean, as in Gazebo.

    Raises:
        ArenaFileError: A file that is unreadable, too small or too large, or lossy.
    """
    mode, pixels, form = _read_image(path, MAX_HEIGHTS)
    if mode in WHITE_BY_MODE or form in LOSSY_FORMATS:
        return read_heights(path, 1.0)
    if min(pixels.shape[:2]) < 2:
        raise ArenaFileError(f"{path}: a terrain has at least 2 x 2 heights")
    grey, _ = read_grey(path)
    return grey / 255


def write_heights(path: Path, heights: np.ndarray) -> float:
    """Write a terrain (rows, columns) as a PNG file of 16 bits, and return the height of white [m].

    Heights are rounded to a 65535th of that.
    """
    from PIL import Image

    top = float(np.max(heights))
    # Of zeros alone any height of white is right.
    steps = np.rint(np.asarray(heights, float) / (top or 1.0) * 65535).astype(np.uint16)
    with atomic_write(path) as fresh:
        Image.fromarray(np.ascontiguousarray(steps[::-1])).save(fresh)
    return top


def read_grey(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean of an image's channels, 0 to 255, and its opaque pixels, both (rows, columns).

    The lowest row of y comes first.

    Raises:
        ArenaFileError: A file that is unreadable or too large.
    """
    mode, pixels = _pixels(path, MAX_PIXELS)
    pixels = pixels[::-1].astype(float) * (255 / WHITE_BY_MODE.get(mode, 255))
    if pixels.ndim == 2:
        return pixels, np.ones(pixels.shape, bool)
    # The alpha channel is no brightness: it stays out of the mean.
    clear = mode in ("LA", "RGBA")
    grey: np.ndarray = pixels[..., :-1].mean(-1) if clear else pixels.mean(-1)
    opaque: np.ndarray = pixels[..., -1] == 255 if clear else np.ones(grey.shape, bool)
    return grey, opaque


def image_size(path: Path) -> tuple[int, int]:
    """Return an image's width and height in pixels."""
    _, pixels = _pixels(path, MAX_HEIGHTS)
    return pixels.shape[1], pixels.shape[0]


def _pixels(path: Path, most: int) -> tuple[str, np.ndarray]:
    """Return an image's mode and its pixels; see `_read_image`."""
    return _read_image(path, most)[:2]


def _read_image(path: Path, most: int) -> tuple[str, np.ndarray, str]:
    """Return an image's mode, its pixels (rows, columns[, channels]) and format; palettes become colours."""
    from PIL import Image

    # For its limit of size and its refusals: Pillow opens the file itself.
    read_bytes(path, 8 * most, ArenaFileError)
    try:
        with Image.open(path, formats=FORMATS) as image:
            width, height = image.size
            form = image.format or ""
            # `Image.open` reads the head only: a bomb is refused before its pixels are decompressed.
            if width * height > most:
                raise ArenaFileError(f"{path}: {width} x {height} pixels; at most {most} in all")
            # Mode 1 has booleans and mode P numbers of a palette: neither is a grey value.
            if image.mode in ("1", "P"):
                image = image.convert("L" if image.mode == "1" else "RGB")
            return image.mode, np.array(image), form
    except ArenaFileError:
        raise
    except Exception as error:  # Pillow raises whatever its decoders run into
        raise ArenaFileError(f"{path}: does not read as an image: {error}") from error
