"""Pictures of robots, drawn as cameras see them, with the rays of C MuJoCo."""

import math
from collections.abc import Sequence
from itertools import product
from pathlib import Path

import mujoco
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from usarmjx.base.backend import numpy_backend
from usarmjx.base.files import write_beside
from usarmjx.cameras.picture import Viewpoint
from usarmjx.engines.c_figures import NOBODY
from usarmjx.engines.c_sight import CSight
from usarmjx.models.build.body_plan import KinematicTree, kinematic_tree_of
from usarmjx.models.build.figures import reach_of
from usarmjx.models.robots import ROBOTS
from usarmjx.models.spec.arena import ArenaSpec, StartPose
from usarmjx.models.spec.robot import RobotSpec
from usarmjx.plots.render import DEFAULT_LIGHTING, lit_scene
from usarmjx.plots.viewpoint import FOV_Y, camera_axes, downsample, fit_camera
from usarmjx.sensors.rays.targets import Geoms
from usarmjx.sim.looks import looks_of
from usarmjx.sim.scene import build_scene

VIEW_ANGLES = (math.radians(-35.0), math.radians(22.0))
"""Azimuth and elevation from which robots are drawn: from their front right."""
FRAME_FACTOR = 1.1
"""By how much what is in the picture is larger than the robot."""


@numpy_backend()
def portrait(robot: RobotSpec, width: int = 480, height: int = 360) -> np.ndarray:
    """Return a picture (height, width, 3) of a robot on a floor, its joints at zero, filling the frame."""
    plan = kinematic_tree_of(robot)
    start = StartPose(tag="here", at=(0.0, 0.0, plan.clearance))
    scene = build_scene(ArenaSpec(name="studio", starts=(start,), extent=((0, 0), (0, 0))), [robot])
    data = mujoco.MjData(scene.model)
    data.qpos[scene.groups[0].indices[0].root_qposadr :][:7] = (*start.at, 1.0, 0.0, 0.0, 0.0)
    azimuth, elevation = VIEW_ANGLES
    back = np.array([math.cos(azimuth), math.sin(azimuth), math.tan(elevation)])
    eye, target = fit_camera(_corners(plan), back / np.linalg.norm(back), width / height)
    right, up, forward = camera_axes(eye - target)
    fov = np.array(2 * math.atan(width / height * math.tan(FOV_Y / 2)), np.float32)
    viewpoint = Viewpoint(
        pos=eye,
        mat=np.stack([forward, -right, up], -1),
        eye_offsets=np.zeros((1, 3)),
        fov=fov,
        default_fov=fov,
        slot=np.array(NOBODY),
        hidden_geoms=np.zeros(0, bool),
        lens="pinhole",
    )
    looks = looks_of(scene)
    light = lit_scene(Geoms(blocks=(), kinds=(), materials=()), looks.appearance, DEFAULT_LIGHTING)
    sight = CSight(scene.model, data, looks)
    return downsample(np.asarray(sight.render(light, viewpoint, 2 * width, 2 * height).rgb) / 255)


def _corners(plan: KinematicTree) -> np.ndarray:
    """Return the corners of the boxes about all that is drawn of a robot, with room around them (n, 3)."""
    solids, corner = plan.figure.solids, np.array(list(product((-1.0, 1.0), repeat=3)))
    places, turns = solids.poses(plan.rest_pos + np.array([0.0, 0.0, plan.clearance]), plan.rest_frames)
    low, high = reach_of(solids, np.asarray(turns))
    boxes = np.asarray(places)[:, None] + np.where(corner > 0, high[:, None], low[:, None])
    corners = boxes.reshape(-1, 3)
    middle = (corners.min(0) + corners.max(0)) / 2
    return middle + FRAME_FACTOR * (corners - middle)


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
