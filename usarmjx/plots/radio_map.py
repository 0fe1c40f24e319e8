"""A map of the power that a radio's signal has all over an arena."""

# Matplotlib leaves the types of keywords open.
# pyright: reportUnknownMemberType=false

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from usarmjx.base.errors import UsageError
from usarmjx.comms.attenuation import RadioSettings, received_power
from usarmjx.comms.walls import arena_solids, count_walls
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.plots.picture import PAPER, draw_shapes
from usarmjx.plots.style import PAGE, figure_style, save_figure

ANTENNA_HEIGHT = 0.5
"""Default height of antennas above the floor [m]: about a P2AT's."""
MARGIN = 0.5
"""The map goes this far beyond the arena's plan [m]."""
MIN_STEP = 0.02
"""Grids have at least this between their points [m]."""
GRID_POINTS = 300
"""Default number of points along the longer side of an arena."""
COLOUR_MIN_DISTANCE = 0.5
"""Nearer to the sender than this colours change no more [m]."""
COLOURS, CUTOFF_LINE = "viridis", "#d1622b"


@dataclass(frozen=True, eq=False)
class PowerMap:
    """Received power on a grid.

    Attributes:
        x: Columns of the grid [m] (columns,).
        y: Rows of the grid [m] (rows,).
        power: Power received there [dBm] (rows, columns).
        walls: Solids on the way there (rows, columns).
    """

    x: np.ndarray
    y: np.ndarray
    power: np.ndarray
    walls: np.ndarray


def parse_position(text: str) -> tuple[float, ...]:
    """Return the numbers of a position given as "x,y" or "x,y,z".

    Raises:
        UsageError: It is not of that form.
    """
    try:
        position = tuple(float(part) for part in text.split(","))
    except ValueError:
        # A wrong length is refused below, with the same words.
        position = ()
    if len(position) not in (2, 3) or not np.isfinite(position).all():
        raise UsageError(f"{text!r} is not of the form x,y or x,y,z [m]")
    return position


def power_map(
    arena: ArenaSpec,
    source: Sequence[float],
    settings: RadioSettings | None = None,
    *,
    height: float | None = None,
    step: float | None = None,
) -> PowerMap:
    """Return the power received all over an arena.

    Args:
        arena: The arena.
        source: Position of the sender's antenna: x, y and, if it is not `ANTENNA_HEIGHT`, the height above
            the floor, in the arena's axes [m].
        settings: Constants of the radio; None: the manual's.
        height: Height of the receiving antennas above the floor; None: as high as the sender's [m].
        step: Distance of two points on the grid [m]; None: `GRID_POINTS` along the arena.

    Raises:
        UsageError: A step too fine to be drawn.
    """
    (x0, x1), (y0, y1) = arena.extent
    if step is None:
        step = max(MIN_STEP, max(x1 - x0, y1 - y0) / GRID_POINTS)
    # So NaN is refused, too.
    if not step >= MIN_STEP:
        raise UsageError(f"the step of a map is {step}, allowed is {MIN_STEP} m and more")
    # Half a step more, as rounding may drop the last point.
    x, y = (
        np.arange(x0 - MARGIN, x1 + MARGIN + step / 2, step),
        np.arange(y0 - MARGIN, y1 + MARGIN + step / 2, step),
    )
    up = source[2] if len(source) > 2 else ANTENNA_HEIGHT
    grid = np.stack([*np.meshgrid(x, y), np.full((len(y), len(x)), up if height is None else height)], -1)
    # Heights are above the floor, solids are in the world's axes.
    ends = (grid.reshape(-1, 3) + np.array([0.0, 0.0, arena.floor])).astype(np.float32)
    start = np.broadcast_to(np.array([*source[:2], up + arena.floor], np.float32), ends.shape)
    walls = count_walls(arena_solids(arena), jnp.asarray(start), jnp.asarray(ends))
    distance = np.linalg.norm(ends - start, axis=-1)
    power = received_power(settings or RadioSettings(), distance, walls)
    shape = (len(y), len(x))
    return PowerMap(x=x, y=y, power=np.asarray(power).reshape(shape), walls=np.asarray(walls).reshape(shape))


def radio_picture(
    arena: ArenaSpec,
    path: Path,
    source: Sequence[float],
    settings: RadioSettings | None = None,
    *,
    height: float | None = None,
) -> PowerMap:
    """Draw the power received all over an arena as PNG, PDF, SVG or EPS; see `power_map`.

    The colour is the power, a line the cutoff, where there is one.

    Args:
        arena: The arena.
        path: File to write; its folder exists.
        source: Position of the sender's antenna.
        settings: Constants of the radio; None: the manual's.
        height: Height of the receiving antennas.

    Returns:
        The power map.

    Raises:
        UsageError: Another suffix.
        WriteError: The file cannot be written.
    """
    settings = settings or RadioSettings()
    drawn = power_map(arena, source, settings, height=height)
    wide, high = np.ptp(drawn.x), np.ptp(drawn.y)
    # The few points right at the sender would take half of the colours.
    top = min(drawn.power.max(), float(received_power(settings, np.array(COLOUR_MIN_DISTANCE), np.array(0))))
    with figure_style():
        figure = Figure(figsize=(PAGE, 0.86 * PAGE * high / wide + 0.7))
        axes = figure.add_subplot()
        axes.set(aspect="equal", facecolor=PAPER, xlabel="x [m]", ylabel="y [m]")
        axes.set_title(_title(arena, source, settings))
        axes.grid(visible=False)
        colours = axes.pcolormesh(
            drawn.x,
            drawn.y,
            drawn.power,
            cmap=COLOURS,
            vmax=top,
            shading="nearest",
            zorder=1,
            # Each point of the grid would be a path of its own.
            rasterized=True,
        )
        figure.colorbar(colours, ax=axes, label="received power [dBm]", shrink=0.85)
        _draw_cutoff(axes, drawn, settings.cutoff)
        draw_shapes(axes, arena)
        axes.plot(*source[:2], "*", color="white", mec="black", ms=11, zorder=6)
        axes.spines[:].set_visible(False)
    save_figure(figure, path)
    return drawn


def _title(arena: ArenaSpec, source: Sequence[float], settings: RadioSettings) -> str:
    position = ", ".join(f"{number:g}" for number in source)
    return f"{arena.name}: power received from ({position}) m; links hold from {settings.cutoff:g} dBm on"


def _draw_cutoff(axes: Axes, drawn: PowerMap, cutoff: float) -> None:
    # A level beyond the data has no line, of which Matplotlib warns.
    if drawn.power.min() < cutoff < drawn.power.max():
        line = axes.contour(drawn.x, drawn.y, drawn.power, [cutoff], colors=CUTOFF_LINE, zorder=3)
        line.set(linewidth=1.2, linestyle="solid")
