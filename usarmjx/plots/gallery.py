"""Pictures of arenas from a corner above, drawn with the sensors' ray kernels, and sheets of many."""

# Matplotlib leaves the types of keywords open.
# pyright: reportUnknownMemberType=false

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path

import mujoco
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imsave  # pyright: ignore[reportUnknownVariableType]

from usarmjx.base.backend import numpy_backend
from usarmjx.base.files import atomic_write
from usarmjx.engines.c.camera_rays import CCameraRays
from usarmjx.models.compile.compose import materials_of, new_spec
from usarmjx.models.compile.kinematic_tree import KinematicTree, kinematic_tree_of
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.victims import victim_table
from usarmjx.models.compile.visuals import solid_extents
from usarmjx.models.files.find_robot import find_robot
from usarmjx.models.types.arena import ArenaSpec, StartPose
from usarmjx.models.types.robot import RobotSpec
from usarmjx.models.types.shapes import SKY, Shape
from usarmjx.plots.floor_plan import draw_plan
from usarmjx.plots.picture import area, height_range, outline, overhead_height
from usarmjx.plots.render import (
    DEFAULT_LIGHTING,
    FOV_Y,
    Lighting,
    RenderGeoms,
    box_geoms,
    camera_axes,
    downsample,
    fit_camera,
    lit_scene,
    render_geoms_of,
    render_picture,
    victim_geoms,
)
from usarmjx.plots.style import save_small
from usarmjx.sensors.cameras.paint import (
    FALSE_ALARM_LABEL,
    VICTIM_LABEL,
    WATER_RGB,
    WATER_TRANSPARENCY,
    labels_of,
)
from usarmjx.sensors.cameras.picture import pinhole_viewpoint
from usarmjx.sensors.rays.targets import Geoms
from usarmjx.sim.scene import build_scene
from usarmjx.sim.views import geom_colors_of

PORTRAIT_ANGLES = (math.radians(-35.0), math.radians(22.0))
"""Azimuth and elevation from which robots are drawn: from their front right."""
FRAME_FACTOR = 1.1
"""By how much what is in the picture is larger than the robot."""


@numpy_backend()
def portrait(robot: RobotSpec, width: int = 480, height: int = 360) -> np.ndarray:
    """Return a picture (height, width, 3) of a robot on a floor, its joints at zero, filling the frame."""
    plan = kinematic_tree_of(robot)
    # The clearance is the height of a robot's origin when its wheels touch the floor.
    start = StartPose(tag="here", at=(0.0, 0.0, plan.clearance))
    scene = build_scene(ArenaSpec(name="studio", starts=(start,), extent=((0, 0), (0, 0))), [robot])
    data = mujoco.MjData(scene.model)
    # A new scene parks its robots outside of the arena.
    data.qpos[scene.groups[0].indices[0].root_qposadr :][:7] = (*start.at, 1.0, 0.0, 0.0, 0.0)
    azimuth, elevation = PORTRAIT_ANGLES
    back = np.array([math.cos(azimuth), math.sin(azimuth), math.tan(elevation)])
    eye, target = fit_camera(_corners(plan), back / np.linalg.norm(back), width / height)
    right, up, forward = camera_axes(eye - target)
    # Viewpoints have a horizontal field of view, this module's constant is vertical.
    fov = 2 * math.atan(width / height * math.tan(FOV_Y / 2))
    viewpoint = pinhole_viewpoint(eye, np.stack([forward, -right, up], -1), fov)
    looks = geom_colors_of(scene)
    # Only light: C MuJoCo casts the rays at its own geoms.
    light = lit_scene(Geoms(blocks=(), kinds=(), materials=()), looks.appearance, DEFAULT_LIGHTING)
    # Nothing is compiled: a sheet of all classes has as many models as pictures.
    sight = CCameraRays(scene.model, data, looks)
    return downsample(np.asarray(sight.render(light, viewpoint, 2 * width, 2 * height).rgb) / 255)


def _corners(plan: KinematicTree) -> np.ndarray:
    """Return the corners of the boxes about all that is drawn of a robot, with room around them (n, 3)."""
    solids, corner = plan.visuals.solids, np.array(list(product((-1.0, 1.0), repeat=3)))
    places, turns = solids.poses(plan.rest_pos + np.array([0.0, 0.0, plan.clearance]), plan.rest_frames)
    low, high = solid_extents(solids, np.asarray(turns))
    boxes = np.asarray(places)[:, None] + np.where(corner > 0, high[:, None], low[:, None])
    corners = boxes.reshape(-1, 3)
    middle = (corners.min(0) + corners.max(0)) / 2
    return middle + FRAME_FACTOR * (corners - middle)


def portraits(names: Sequence[str | RobotSpec], path: Path, columns: int = 4) -> None:
    """Write a PNG with a picture of each robot and its name and size below.

    Raises:
        UnknownNameError: No such robot class.
    """
    robots = [find_robot(name) for name in names]
    rows = -(-len(robots) // columns)
    figure = Figure(figsize=(3.2 * columns, 2.75 * rows), dpi=80, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    for i, robot in enumerate(robots):
        axes = figure.add_subplot(rows, columns, i + 1)
        axes.imshow(portrait(robot))
        length, width, height = robot.dimensions
        axes.set_title(f"{robot.name}  {length:.2f} x {width:.2f} x {height:.2f} m", y=-0.13, fontsize=9)
        axes.set_axis_off()
    with atomic_write(path) as fresh:
        figure.savefig(fresh, format="png")


ARENA_ANGLES = (math.radians(-62.0), math.radians(44.0))
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
    # Each ray has one colour: means of four smooth the edges.
    picture = downsample(
        render_picture(arena_render_geoms(shown), eye, target, 2 * width, 2 * height, setting)
    )
    if path is not None:
        with atomic_write(path) as fresh:
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
    """Return the view of an arena at the start.

    Raises:
        SpecError: The arena cannot be built.
    """
    model = new_spec(arena, Physics()).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    solids = render_geoms_of(model, data, materials_of(model, arena), labels_of(model, arena))
    # Victims of the model are the boxes that sensors hit; pictures show limbs in their places.
    solids = solids.select(~np.isin(solids.label, (VICTIM_LABEL, FALSE_ALARM_LABEL)))
    solids = solids.concatenate(victim_geoms(victim_table(arena.victims, arena.false_alarms), arena.floor))
    corners = np.array([(water.low, water.high) for water in arena.waters]).reshape(-1, 2, 3)
    # Water's corners are heights above the floor.
    corners[..., 2] += arena.floor
    return solids.concatenate(
        box_geoms(corners[:, 0], corners[:, 1], np.array(WATER_RGB), WATER_TRANSPARENCY)
    )


def _eye(arena: ArenaSpec, aspect: float) -> tuple[np.ndarray, np.ndarray]:
    """Return from where the whole arena fills a picture, and the picture's middle (3,) and (3,) [m]."""
    (x0, x1), (y0, y1) = arena.extent
    top = max([0.0, *(height_range(shape)[1] for shape in arena.shapes if shape.material != SKY)])
    # A mast must not make the camera step back from all the rest.
    top = min(top, 0.5 * min(x1 - x0, y1 - y0))
    corners = np.array([(x, y, z + arena.floor) for x in (x0, x1) for y in (y0, y1) for z in (0.0, top)])
    azimuth, elevation = ARENA_ANGLES
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
