"""Writing on pictures of a film: names over robots, and a line with time, score and victims."""

from functools import lru_cache
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from usarmjx.plots.films.views import FilmView
from usarmjx.view.drawing import Drawing, Frame
from usarmjx.view.layers.base import robot_colors
from usarmjx.view.layers.marks import NAME_GAP

NAME_SHARE, LINE_SHARE, LEAST_TEXT = 0.026, 0.034, 11
"""Heights of names and of the line, as shares of the picture's height, and the least height [pixels]."""
PLATE, INK = (20, 24, 30, 190), (255, 255, 255, 255)
"""Colours behind texts and of texts, red, green, blue and opacity."""


@lru_cache(maxsize=8)
def _font(height: int, bold: bool) -> ImageFont.FreeTypeFont:
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / name), height)


def write_captions(
    picture: np.ndarray, drawing: Drawing, frame: Frame, view: FilmView, line: str
) -> np.ndarray:
    """Return a picture (height, width, 3) with names over robots and a line in a corner.

    Args:
        picture: Colours, 0 to 255 uint8 (height, width, 3).
        drawing: Drawing of the world.
        frame: The frame.
        view: The view.
        line: Text of the line; empty: none.
    """
    sheet = Image.fromarray(picture).convert("RGBA")
    plates = Image.new("RGBA", sheet.size, (0, 0, 0, 0))
    pen = ImageDraw.Draw(plates)
    small, large = (max(LEAST_TEXT, round(share * view.height)) for share in (NAME_SHARE, LINE_SHARE))
    for slot, robot in sorted(frame.robots.items()):
        if slot not in drawing.robots:
            continue
        drawn = drawing.robots[slot]
        above = np.add(robot.pos, (0.0, 0.0, drawn.dimensions[2] / 2 + NAME_GAP))
        (x, y), depth = view.project(above)
        if depth > 0 and 0 <= x < view.width and 0 <= y < view.height:
            _plate(pen, (float(x), float(y)), drawn.name, small, tuple(robot_colors(np.array(slot)).tolist()))
    if line:
        margin = large // 2
        font = _font(large, True)
        box = pen.textbbox((2 * margin, 2 * margin), line, font=font)
        pen.rounded_rectangle(
            (box[0] - margin, box[1] - margin, box[2] + margin, box[3] + margin), margin, fill=PLATE
        )
        pen.text((2 * margin, 2 * margin), line, font=font, fill=INK)
    return np.asarray(Image.alpha_composite(sheet, plates).convert("RGB"))


def _plate(
    pen: ImageDraw.ImageDraw, at: tuple[float, float], text: str, height: int, rgb: tuple[int, ...]
) -> None:
    """Write a name whose plate ends at a point [pixels], with a line of the robot's colour below it."""
    font, gap = _font(height, False), height // 3
    x, y = at[0], at[1] - gap
    left, top, right, bottom = pen.textbbox((x, y), text, font=font, anchor="ms")
    pen.rectangle((left - gap, top - gap, right + gap, bottom + gap), fill=PLATE)
    pen.rectangle((left - gap, bottom + gap, right + gap, bottom + 2 * gap), fill=(*rgb, 255))
    pen.text((x, y), text, font=font, anchor="ms", fill=INK)
