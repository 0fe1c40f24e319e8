"""Pictures of arenas from a corner above, drawn with the sensors' ray kernels, and sheets of many."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import imsave

from usarmjx.base.files import write_beside
from usarmjx.cameras.paint import (
    FALSE_ALARM_LABEL,
    VICTIM_LABEL,
    WATER_RGB,
    WATER_TRANSPARENCY,
    labels_of,
)
from usarmjx.models.build.compose import Physics, new_spec
from usarmjx.models.build.materials import materials_of
from usarmjx.models.build.victims import victim_table
from usarmjx.models.spec.arena import ArenaSpec
from usarmjx.models.spec.shapes import SKY, Shape
from usarmjx.plots.floor_plan import draw_plan
from usarmjx.plots.outlines import area, height_range, outline
from usarmjx.plots.palette import save_small
from usarmjx.plots.picture import overhead_height
from usarmjx.plots.render import Lighting, render_picture
from usarmjx.plots.scenery import RenderGeoms, box_geoms, render_geoms_of, victim_geoms
from usarmjx.plots.viewpoint import downsample, fit_camera

VIEW_ANGLES = (math.radians(-62.0), math.radians(44.0))
"""Azimuth and elevation from which arenas are seen: as on the plan, x runs to the right."""
SUN = (-0.45, -0.7, 0.85)
"""Behind the viewer's left shoulder."""
ROOF_SHARE = 0.5
"""Solids overhead are a roof, and left out, if together they cover more than this share of the plan."""
CHECKER_SIZES = (0.5, 1.0, 5.0, 10.0, 50.0)
"""Sides of the floor's checkers [m]: the first that gives at most `MAX_CHECKERS` along an arena."""
MAX_CHECKERS = 45


def perspective(
    arena: ArenaSpec, path: Path | None = None, width: int = 720, height: int = 480
) -> np.ndarray:
    """Return a picture (height, width, 3) of an arena from a corner above, and write it as a PNG file.

    It shows fixed solids without the roof, water, loose objects, doors and victims as they are at the start;
    no lamps: the light is the sun's.

    Args:
        arena: The arena.
        path: File to write; None: none.
        width: Pixels along a row.
        height: Rows.

    Raises:
        SpecError: The arena cannot be built.
    """
    shown = replace(arena, shapes=without_roof(arena))
    eye, target = _eye(shown, width / height)
    tile = next(
        (t for t in CHECKER_SIZES if t * MAX_CHECKERS > np.ptp(arena.extent, axis=1).max()), CHECKER_SIZES[-1]
    )
    setting = Lighting(sun=SUN, checker_size=tile, checker_extent=arena.extent)
    picture = downsample(
        render_picture(arena_render_geoms(shown), eye, target, 2 * width, 2 * height, setting)
    )
    if path is not None:
        with write_beside(path) as fresh:
            imsave(fresh, picture)
    return picture


def without_roof(arena: ArenaSpec) -> tuple[Shape, ...]:
    """Return an arena's solids without the roof, if it has one."""
    (x0, x1), (y0, y1) = arena.extent
    height = overhead_height(arena)
    above = [height_range(shape)[0] > height and shape.material != SKY for shape in arena.shapes]
    roof = sum(area(outline(shape)) for shape, high in zip(arena.shapes, above, strict=True) if high)
    if roof <= ROOF_SHARE * (x1 - x0) * (y1 - y0):
        return arena.shapes
    return tuple(shape for shape, high in zip(arena.shapes, above, strict=True) if not high)


def arena_render_geoms(arena: ArenaSpec) -> RenderGeoms:
    """Return what is seen of an arena as it is at the start.

    Raises:
        SpecError: The arena cannot be built.
    """
    model = new_spec(arena, Physics()).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    solids = render_geoms_of(model, data, materials_of(model, arena), labels_of(model, arena))
    solids = solids.select(~np.isin(solids.label, (VICTIM_LABEL, FALSE_ALARM_LABEL)))
    solids = solids.concatenate(victim_geoms(victim_table(arena.victims, arena.false_alarms), arena.floor))
    corners = np.array([(water.low, water.high) for water in arena.waters]).reshape(-1, 2, 3)
    corners[..., 2] += arena.floor
    return solids.concatenate(
        box_geoms(corners[:, 0], corners[:, 1], np.array(WATER_RGB), WATER_TRANSPARENCY)
    )


def _eye(arena: ArenaSpec, aspect: float) -> tuple[np.ndarray, np.ndarray]:
    """Return from where the whole arena fills a picture, and the picture's middle (3,) and (3,) [m]."""
    (x0, x1), (y0, y1) = arena.extent
    top = max([0.0, *(height_range(shape)[1] for shape in arena.shapes if shape.material != SKY)])
    top = min(top, 0.5 * min(x1 - x0, y1 - y0))
    corners = np.array([(x, y, z + arena.floor) for x in (x0, x1) for y in (y0, y1) for z in (0.0, top)])
    azimuth, elevation = VIEW_ANGLES
    back = np.array([math.cos(azimuth), math.sin(azimuth), math.tan(elevation)])
    return fit_camera(corners, back / np.linalg.norm(back), aspect)


def plan_sheet(arenas: Sequence[ArenaSpec], path: Path, columns: int = 3) -> None:
    """Write a PNG file with the plans of several arenas, without words."""
    _sheet([(_title(arena), partial(_small_plan, arena)) for arena in arenas], path, columns)


def view_sheet(arenas: Sequence[ArenaSpec], path: Path, columns: int = 3) -> None:
    """Write a PNG file with several arenas from a corner above."""
    _sheet([(_title(arena), partial(_small_view, arena)) for arena in arenas], path, columns)


def both_sheet(arenas: Sequence[ArenaSpec], path: Path, columns: int = 4) -> None:
    """Write a PNG file with plan and view of several arenas, the plan on the left."""
    cells = [
        (title, partial(small, arena))
        for arena in arenas
        for title, small in ((_title(arena), _small_plan), ("", _small_view))
    ]
    _sheet(cells, path, columns)


def _title(arena: ArenaSpec) -> str:
    (x0, x1), (y0, y1) = arena.extent
    return f"{arena.name}  {x1 - x0:g} x {y1 - y0:g} m"


def _small_plan(arena: ArenaSpec, axes: Axes) -> None:
    draw_plan(axes, arena, words=False)


def _small_view(arena: ArenaSpec, axes: Axes) -> None:
    axes.imshow(perspective(arena, width=420, height=290))
    axes.set_axis_off()


def _sheet(cells: Sequence[tuple[str, Callable[[Axes], None]]], path: Path, columns: int) -> None:
    rows = -(-len(cells) // columns)
    figure = Figure(figsize=(4.2 * columns, 3.1 * rows), dpi=90, facecolor="white", layout="constrained")
    for i, (title, fill) in enumerate(cells):
        axes = figure.add_subplot(rows, columns, i + 1)
        fill(axes)
        axes.set_title(title, fontsize=9, loc="left")
    save_small(figure, path)
