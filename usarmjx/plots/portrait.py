"""Pictures of robots, drawn with the sensors' ray kernels: what is in the picture is what sensors see."""

import math
from collections.abc import Sequence
from itertools import product
from pathlib import Path

import mujoco
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from usarmjx.base.files import write_beside
from usarmjx.models.build.body_plan import kinematic_tree_of
from usarmjx.models.build.compose import Physics, add_robot, new_spec
from usarmjx.models.robots import ROBOTS
from usarmjx.models.spec.arena import ArenaSpec
from usarmjx.models.spec.robot import RobotSpec
from usarmjx.plots.render import render_picture
from usarmjx.plots.scenery import PLANE, render_geoms_of
from usarmjx.plots.viewpoint import fit_camera

VIEW_ANGLES = (math.radians(-35.0), math.radians(22.0))
"""Azimuth and elevation from which robots are drawn: from their front right."""
FRAME_FACTOR = 1.2
"""By how much what is in the picture is larger than the robot."""


def portrait(robot: RobotSpec, width: int = 480, height: int = 360) -> np.ndarray:
    """Return a picture (height, width, 3) of a robot on a floor, its joints at zero, filling the frame."""
    spec = new_spec(ArenaSpec(name="studio", starts=(), extent=((0, 0), (0, 0))), Physics())
    add_robot(spec, robot, "", (0.0, 0.0, kinematic_tree_of(robot).clearance))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    azimuth, elevation = VIEW_ANGLES
    back = np.array([math.cos(azimuth), math.sin(azimuth), math.tan(elevation)])
    eye, target = fit_camera(_corners(model, data), back / np.linalg.norm(back), width / height)
    return render_picture(render_geoms_of(model, data), eye, target, width, height)


def _corners(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return the corners of the boxes about all solids but the floor, with room around them (n, 3)."""
    own = model.geom_type != PLANE
    middle, half = np.split(model.geom_aabb[own], 2, axis=1)
    local = middle[:, None] + np.array(list(product((-1, 1), repeat=3))) * half[:, None]
    turned = np.einsum("gij,gcj->gci", data.geom_xmat[own].reshape(-1, 3, 3), local)
    corners = (data.geom_xpos[own][:, None] + turned).reshape(-1, 3)
    return corners.mean(0) + FRAME_FACTOR * (corners - corners.mean(0))


def portraits(names: Sequence[str], path: Path, columns: int = 4) -> None:
    """Write a PNG with a picture of each robot and its name and size below.

    Raises:
        UnknownNameError: No such robot class.
    """
    robots = [ROBOTS.get(name) for name in names]
    rows = -(-len(robots) // columns)
    figure = Figure(figsize=(3.2 * columns, 2.75 * rows), dpi=80, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    for i, robot in enumerate(robots):
        axes = figure.add_subplot(rows, columns, i + 1)
        axes.imshow(portrait(robot))
        length, width, height = robot.dimensions
        axes.set_title(f"{robot.name}  {length:.2f} x {width:.2f} x {height:.2f} m", y=-0.13, fontsize=9)
        axes.set_axis_off()
    with write_beside(path) as fresh:
        figure.savefig(fresh, format="png")
