"""Figures as PNG of few colours, so that they are small."""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from usarmjx.base.files import write_beside

COLOURS = 256
"""Hardly seen, and files are half as large."""


def save_small(figure: Figure, path: Path, colours: int = COLOURS) -> None:
    """Write a figure as PNG with a palette of its most common colours.

    Args:
        figure: What is drawn.
        path: Where to.
        colours: At most so many; lines of a few colours and their edges need 16.

    Raises:
        WriteError: It cannot be written.
    """
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    pixels = np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[..., :3])
    with write_beside(path) as fresh:
        Image.fromarray(pixels).quantize(colours, dither=Image.Dither.NONE).save(fresh, "PNG", optimize=True)
