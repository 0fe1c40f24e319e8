"""Floor plans of arenas: everything that an arena's description holds, seen from above."""

# Matplotlib leaves the types of keywords open.
# pyright: reportUnknownMemberType=false

import math
import textwrap
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Arc, Patch, Polygon, Rectangle

from usarmjx.base.transforms import angles_from_mat, mat_from_angles
from usarmjx.models.compile.tags import tag_ids
from usarmjx.models.compile.victims import segment_poses, victim_table
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.shapes import FENDER, GLASS, MIRROR, Shape
from usarmjx.plots.picture import (
    ARROW,
    GROUND,
    PAPER,
    STYLES,
    WALL,
    draw_shapes,
    height_range,
    outline,
)
from usarmjx.plots.style import PAGE, figure_style, save_figure

MAX_HEIGHT = 9.0
"""Most that a picture is high [inches]; of long, narrow arenas it becomes narrower instead."""
MARGIN = 0.04
"""Around the plan, in shares of its longer side."""
MAX_NAMED_STARTS = 14
"""Most start poses with names in the picture; of more, only the first has one."""
WATER, LOOSE, VICTIM, ALARM = "#9cc7dd", "#e07b39", "#c4122f", "#e58fa0"
TAG, LAMP, DOOR, START = "#1b7f5a", "#e0b000", "#7a4a1e", "#1f5fa8"
TITLE_COLUMNS = 120
"""Letters of a line above the picture."""


def floor_plan_picture(arena: ArenaSpec, path: Path) -> None:
    """Draw an arena's floor plan with a legend as PNG, PDF, SVG or EPS; makes the folder if need be.

    Raises:
        UsageError: Another suffix.
        WriteError: The file cannot be written.
    """
    (x0, x1), (y0, y1) = arena.extent
    about = textwrap.wrap(arena.about, TITLE_COLUMNS)
    room = 0.9 + 0.14 * len(about)
    tall = PAGE * (y1 - y0) / (x1 - x0)
    shrink = min(1.0, (MAX_HEIGHT - room) / tall)
    with figure_style():
        figure = Figure(figsize=(max(PAGE * shrink, 0.6 * PAGE), tall * shrink + room))
        axes = figure.add_subplot()
        title = f"{arena.name}: {x1 - x0:g} x {y1 - y0:g} m"
        figure.suptitle("\n".join([title, *about]), x=0.01, ha="left", fontsize=8)
        keys = draw_plan(axes, arena)
        figure.legend(handles=keys, loc="outside lower center", ncols=7)
    save_figure(figure, path)


def draw_plan(axes: Axes, arena: ArenaSpec, *, words: bool = True, starts: bool = True) -> list[Any]:
    """Draw an arena's floor plan, if wanted with its `words` and `starts`; return the keys of a legend."""
    (x0, x1), (y0, y1) = arena.extent
    margin = MARGIN * max(x1 - x0, y1 - y0)
    axes.set(
        aspect="equal",
        facecolor=PAPER,
        xlim=(x0 - margin, x1 + margin),
        # Room for the scale below the plan.
        ylim=(y0 - 1.8 * margin, y1 + margin),
        xticks=[],
        yticks=[],
    )
    axes.spines[:].set_visible(False)
    axes.grid(visible=False)
    for water in arena.waters:
        low, high = water.low, water.high
        size = (high[0] - low[0], high[1] - low[1])
        axes.add_patch(Rectangle((low[0], low[1]), *size, facecolor=WATER, edgecolor="none", zorder=1))
    draw_shapes(axes, arena)
    _draw_loose(axes, arena, 1.4 if words else 0.7)
    _draw_bones(axes, arena)
    _draw_marks(axes, arena, words)
    if starts:
        _draw_starts(axes, arena, words)
    _draw_scale(axes, (x0, y0 - margin), (x1 - x0) / 5, 9 if words else 7)
    return _keys(arena)


def _draw_loose(axes: Axes, arena: ArenaSpec, line: float) -> None:
    """Draw loose objects and doors; an arc shows where a door swings."""
    for loose in arena.loose:
        mat = np.asarray(mat_from_angles(*np.array(loose.rotation)))
        for shape in loose.shapes:
            placed = _placed(shape, np.array(loose.at), mat)
            axes.add_patch(Polygon(outline(placed), fc=shape.rgba, ec=LOOSE, lw=line, zorder=3))
    for door in arena.doors:
        width, x, y = door.size[0], door.at[0], door.at[1]
        # Rows are vectors, so this matrix is the transposed rotation.
        cos, sin = math.cos(door.yaw), math.sin(door.yaw)
        way = np.array([(0.0, 0.0), (width, 0.0)]) @ np.array([[cos, sin], [-sin, cos]]) + (x, y)
        axes.plot(*way.T, color=DOOR, lw=2 * line, solid_capstyle="butt", zorder=3)
        low, high = (math.degrees(door.yaw + limit) for limit in door.limits)
        swing = Arc((x, y), 2 * width, 2 * width, theta1=low, theta2=high, color=DOOR, lw=0.7, ls=":")
        axes.add_patch(swing)


def _placed(shape: Shape, at: np.ndarray, mat: np.ndarray) -> Shape:
    """Return a solid of a loose object in the arena's axes."""
    rotation = angles_from_mat(mat @ mat_from_angles(*np.array(shape.rotation)))
    pos = at + mat @ np.array(shape.at)
    return replace(shape, at=tuple(pos), rotation=tuple(rotation))


def _draw_bones(axes: Axes, arena: ArenaSpec) -> None:
    """Draw every bone of the victims and false alarms, the highest last."""
    if not (arena.victims or arena.false_alarms):
        return
    table = victim_table(arena.victims, arena.false_alarms)
    # Limbs move over time: the plan shows them at time 0.
    pos, quat = segment_poses(table, np.zeros((), np.float32))
    bones: list[tuple[float, np.ndarray, str]] = []
    for i in range(table.num_boxes):
        mat = np.zeros(9)
        # MuJoCo takes floats of 64 bits only.
        mujoco.mju_quat2Mat(mat, quat[i].astype(float))
        bone = Shape(
            kind="box",
            size=tuple(table.size[i]),
            at=tuple(pos[i]),
            rotation=tuple(angles_from_mat(mat.reshape(3, 3))),
        )
        bones.append((height_range(bone)[1], outline(bone), VICTIM if table.owner[i] >= 0 else ALARM))
    bones.sort(key=lambda bone: bone[0])
    # One collection draws its members in order, and much faster than single patches.
    patches = PatchCollection([Polygon(corners) for _, corners, _ in bones], zorder=4)
    patches.set(facecolor=[colour for _, _, colour in bones], edgecolor="white", linewidth=0.3)
    axes.add_collection(patches)


def _draw_marks(axes: Axes, arena: ArenaSpec, words: bool) -> None:
    """Draw lamps and tags, the latter with their numbers."""
    for light in arena.lights:
        axes.plot(*light.at[:2], "*", color=LAMP, mec="#7a6000", mew=0.6, ms=12 if words else 7, zorder=5)
    style: dict[str, Any] = {"textcoords": "offset points", "fontsize": 7, "color": TAG, "zorder": 6}
    for tag, number in zip(arena.tags, tag_ids(arena.tags), strict=True):
        axes.plot(*tag.at[:2], "D", color=TAG, mec="white", mew=0.5, ms=5 if words else 3.5, zorder=5)
        if words:
            axes.annotate(f"{number}", tag.at[:2], (4, 3), **style)


def _draw_starts(axes: Axes, arena: ArenaSpec, words: bool) -> None:
    named = arena.starts if len(arena.starts) <= MAX_NAMED_STARTS else arena.starts[:1]
    for start in arena.starts:
        cos, sin = math.cos(start.yaw), math.sin(start.yaw)
        # Markers do not turn with the data, so their corners are turned.
        marker = ARROW @ np.array([[cos, sin], [-sin, cos]])
        axes.plot(*start.at[:2], marker=marker, color=START, ms=10 if words else 6, ls="", zorder=5)
        if words and start in named:
            style: dict[str, Any] = {"fontsize": 7, "color": START, "ha": "center"}
            axes.annotate(start.tag, start.at[:2], (0, -13), textcoords="offset points", zorder=6, **style)


def _draw_scale(axes: Axes, at: tuple[float, float], longest: float, fontsize: float) -> None:
    """Draw a bar of a round length."""
    # The power of ten just below, whose 1, 2 or 5 fold is the largest that fits.
    step = 10.0 ** math.floor(math.log10(longest))
    length = max(step * factor for factor in (1, 2, 5) if step * factor <= longest)
    axes.plot([at[0], at[0] + length], [at[1]] * 2, color="black", lw=3.0, solid_capstyle="butt", zorder=6)
    text: dict[str, Any] = {"textcoords": "offset points", "va": "center", "fontsize": fontsize}
    axes.annotate(f"{length:g} m", (at[0] + length, at[1]), (4, 0), **text)


def _keys(arena: ArenaSpec) -> list[Any]:
    """Return the keys of a legend: of what there is only."""
    materials = {shape.material for shape in arena.shapes}
    surfaces = {shape.surface for shape in arena.shapes if shape.heights is None}
    terrain = any(shape.heights is not None for shape in arena.shapes)

    def mark(shape: str, colour: str, name: str) -> Line2D:
        return Line2D([], [], marker=shape, color=colour, ls="", ms=8, label=name)

    keys = [
        ("wall" in surfaces, Patch(fc=WALL, label="wall")),
        (bool(surfaces - {"wall", "fixture"}), Patch(fc=GROUND(0.5), label="ground (darker: higher)")),
        (terrain, Patch(fc=GROUND(0.2), ec=GROUND(1.0), label="terrain")),
        *((name in materials, Patch(**STYLES[name], label=name)) for name in (GLASS, MIRROR, FENDER)),
        (bool(arena.waters), Patch(fc=WATER, label="water")),
        (bool(arena.doors), Line2D([], [], color=DOOR, lw=3, label="door")),
        (bool(arena.loose), Patch(fc="white", ec=LOOSE, lw=1.4, label="loose object")),
        (bool(arena.victims), Patch(fc=VICTIM, label="victim")),
        (bool(arena.false_alarms), Patch(fc=ALARM, label="false alarm")),
        (bool(arena.tags), mark("D", TAG, "RFID tag")),
        (bool(arena.lights), mark("*", LAMP, "lamp")),
        (bool(arena.starts), mark(">", START, "start pose")),
    ]
    return [key for there, key in keys if there]
