"""One style for figures: sizes of columns, palette, names with units, files of vectors or pixels."""

# Matplotlib leaves the types of keywords open.
# pyright: reportUnknownMemberType=false

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from usarmjx.base.errors import UsageError
from usarmjx.base.files import atomic_write

STYLE = Path(__file__).with_name("usarmjx.mplstyle")
"""Style of matplotlib, for figures of one's own, too: `matplotlib.style.use(STYLE)`."""
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#333333", "#A6761D")
"""Colours that are told apart without colour vision, too (Okabe and Ito, "Color universal design", 2008)."""
MARKS = ("o", "s", "^", "D", "v", "P", "X", "*")
"""Marks, so that colours are not needed."""
COLUMN, PAGE = 3.5, 7.16
"""Widths of a column and of a page of IEEE's journals [inches]; NeurIPS and ICML have 5.5 and 6.75."""
PANEL_HEIGHT = 2.1
"""Height of a panel [inches]."""
MOST_PANELS = 6
"""Panels of a figure: more cannot be read at print size and become figures of their own."""
FEWEST_FOR_LINE = 3
"""Points that a line joins, at least."""
VECTORS = (".pdf", ".svg", ".eps")
SUFFIXES = (".png", *VECTORS)

NAMES = {
    "arena.level": "density of walls",
    "arena.kind": "kind of arena",
    "arena.size": "size of the arena [cells]",
    "engine": "engine",
    "episodes": "episodes",
    "roster": "team",
    "seed": "seed",
    "split": "split",
    "physics": "physics",
    "radio.cutoff": "cutoff of the radio [dBm]",
    "radio.atten_fac": "attenuation by a wall [dB]",
    "radio.pdo": "received power at 1 m [dBm]",
    "radio.n": "path loss exponent of the radio",
    "vary.friction": "friction (factor)",
    "vary.mass": "mass (factor)",
    "vary.noise": "noise of sensors (factor)",
    "vary.latency": "latency of motors [control steps]",
    "vary.torque": "torque of motors (factor)",
    "vary.speed": "speed of motors (factor)",
    "vary.wheel": "radius of wheels (factor)",
}
"""Names of settings in figures, with units."""


def setting_name(key: str) -> str:
    """Return the name of a setting in a figure: words and unit, instead of its key in a file."""
    return NAMES.get(key) or key.removeprefix("fields.").replace(".", ": ").replace("_", " ")


def check_figure(path: Path) -> None:
    """Refuse a file that is no figure.

    Raises:
        UsageError: Another suffix; names those there are.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise UsageError(f"{path}: figures end in {', '.join(SUFFIXES)}")


@contextmanager
def figure_style() -> Generator[None]:
    """Use the style for what is drawn within; nothing of matplotlib changes outside."""
    # Restored on the way out: a user's notebook keeps its own style.
    with mpl.rc_context(fname=STYLE):
        yield


def panels_of(count: int, *, columns: int = 3, width: float = PAGE) -> tuple[Figure, list[Axes]]:
    """Return a figure with a number of panels, at most `MOST_PANELS`, as wide as a page or a column.

    Args:
        count: Number of panels.
        columns: Most panels beside each other.
        width: Width of the figure [inches].
    """
    across = min(count, columns)
    down = -(-count // across)
    figure = Figure(figsize=(width, PANEL_HEIGHT * down + 0.3), layout="constrained")
    axes = figure.subplots(down, across, squeeze=False).ravel().tolist()
    # A grid has whole rows, and empty axes would show their frames.
    for spare in axes[count:]:
        spare.set_axis_off()
    return figure, axes[:count]


def series(panel: Axes, x: Any, y: Any, number: int, label: str | None = None, **style: Any) -> None:  # noqa: ANN401
    """Draw points with a mark and colour of their own, joined only where they are enough for a line.

    Args:
        panel: Panel to draw in.
        x: Places (points,).
        y: Values (points,).
        number: Number of the series, for colour and mark.
        label: Name in the legend.
        style: More for `Axes.plot`.
    """
    shown: dict[str, Any] = {
        "color": PALETTE[number % len(PALETTE)],
        "marker": MARKS[number % len(MARKS)],
        "linestyle": "-" if len(x) >= FEWEST_FOR_LINE else "none",
    }
    panel.plot(x, y, label=label, **{**shown, **style})


COLOURS = 256
"""Hardly seen, and files are half as large."""


def save_small(figure: Figure, path: Path, colours: int = COLOURS) -> None:
    """Write a figure as PNG with a palette of its most common colours.

    Args:
        figure: Subject.
        path: Destination.
        colours: Most colours; lines of a few colours and their edges need 16.

    Raises:
        WriteError: It cannot be written.
    """
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    # Without opacity, which would take places of the palette.
    pixels = np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[..., :3])
    with atomic_write(path) as fresh:
        # Without dither, whose noise packs badly.
        Image.fromarray(pixels).quantize(colours, dither=Image.Dither.NONE).save(fresh, "PNG", optimize=True)


def save_figure(figure: Figure, path: Path, **metadata: str) -> None:
    """Write a figure: PNG with few colours, or vectors as PDF, SVG or EPS.

    Args:
        figure: The figure.
        path: Destination.
        metadata: Notes in a PNG file.

    Raises:
        UsageError: Another suffix; names those there are.
        WriteError: The file cannot be written.
    """
    check_figure(Path(path))
    with figure_style():
        # A palette has no room for notes.
        if path.suffix.lower() == ".png" and not metadata:
            save_small(figure, path)
            return
        # The constructor makes itself the figure's canvas, which without pyplot draws no pixels.
        FigureCanvasAgg(figure)
        with atomic_write(path) as fresh:
            # Without a date the same figure is the same file.
            notes = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}.get(
                path.suffix.lower(), metadata
            )
            figure.savefig(fresh, format=path.suffix[1:].lower(), metadata=notes or None)


def numbered(path: Path, number: int) -> Path:
    """Return the file of a further figure: `x.pdf`, `x-2.pdf`, `x-3.pdf`."""
    return path if number == 0 else path.with_name(f"{path.stem}-{number + 1}{path.suffix}")
