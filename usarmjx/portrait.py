"""Pictures of robots, drawn with the sensors' ray kernels: what is in the picture is what sensors see."""

import math
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from usarmjx.models.arena_spec import ArenaSpec
from usarmjx.models.compose import Physics, add_robot, new_spec
from usarmjx.models.plan import body_plan
from usarmjx.models.robots import ROBOTS
from usarmjx.models.spec import RobotSpec
from usarmjx.render import draw
from usarmjx.scenery import PLANE, solids_of
from usarmjx.viewpoint import FIELD

VIEW = (math.radians(-35.0), math.radians(22.0))
"""Azimuth and elevation from which robots are drawn: from their front right."""


def portrait(robot: RobotSpec, width: int = 480, height: int = 360) -> np.ndarray:
    """Return a picture (height, width, 3) of a robot on a floor, its joints at zero, filling the frame."""
    spec = new_spec(ArenaSpec(name="studio", starts=(), extent=((0, 0), (0, 0))), Physics())
    add_robot(spec, robot, "", (0.0, 0.0, body_plan(robot).clearance))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    solids = solids_of(model, data)
    own = solids.kind != PLANE
    radius = model.geom_rbound[own, None]
    low, high = (solids.pos[own] - radius).min(0), (solids.pos[own] + radius).max(0)
    middle, size = (
        (low + high) / 2,
        float(np.linalg.norm(np.minimum(high - low, 2 * np.array(robot.dimensions)))),
    )
    azimuth, elevation = VIEW
    back = np.array([math.cos(azimuth), math.sin(azimuth), math.tan(elevation)])
    eye = middle + back / np.linalg.norm(back) * size / (2 * math.tan(FIELD / 2)) * 1.15
    return draw(solids, eye, np.array([*middle[:2], robot.dimensions[2] / 2]), width, height)


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
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, format="png")
