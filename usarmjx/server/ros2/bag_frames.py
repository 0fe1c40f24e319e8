"""Transforms of a recorded robot's frames, those that it has in a served world."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from usarmjx.base.backend import numpy_backend
from usarmjx.base.rotations import mat_from_quat
from usarmjx.models.robots import ROBOTS
from usarmjx.server.rosbridge import motion
from usarmjx.server.rosbridge.definitions import RosMessage, RosVersion
from usarmjx.server.rosbridge.motion import SensorFrame, frame_name
from usarmjx.server.rosbridge.wheel_odometry import true_estimate
from usarmjx.view.drawing import Drawing, DrawnRobot, Frame

ROS2 = RosVersion.ROS2
SCANNERS = ("RangeScanner", "IRScanner")
"""Types on the wire of plane scanners."""


def frames_of(drawing: Drawing, drawn: DrawnRobot) -> list[SensorFrame]:
    """Return the frames of a robot's sensors, cameras and parts; of those with one name the first."""
    found: dict[str, SensorFrame] = {}
    for mount in (*drawn.sensors, *drawn.cameras):
        upright = mount.kind in SCANNERS and bool(mount.settings[0].get("pitch"))
        for index, title in enumerate(mount.names):
            mat = mount.mat[index] @ (motion.UPRIGHT if upright else np.eye(3))
            body = int(mount.body[index]) - drawn.body
            found.setdefault(title, SensorFrame(title, body, mount.pos[index], mat))
    for body in range(1, drawn.num_bodies):
        part = drawing.bodies[drawn.body + body].name.split("/", 2)[2]
        found.setdefault(part, SensorFrame(part, body, np.zeros(3), np.eye(3)))
    return list(found.values())


def robot_transforms(frame: Frame, drawing: Drawing, slot: int) -> Iterator[RosMessage]:
    """Yield the transforms of a robot from its odom frame, and of its frames from it."""
    drawn = drawing.robots[slot]
    state: Any = frame.robots[slot]  # poses and velocities have the same names as a RobotState's
    name, time = frame_name(drawn.name), frame.time
    yield motion.base_transform(ROS2, time, name, true_estimate(state))
    if drawn.robot in ROBOTS:
        spec = ROBOTS.get(drawn.robot)
        yield motion.footprint_transform(ROS2, time, name, spec, state, drawing.floor)
    own = slice(drawn.body, drawn.body + drawn.num_bodies)
    with numpy_backend():
        mats = np.asarray(mat_from_quat(frame.quat[own]), float)
    places = np.asarray(frame.pos[own], float), mats
    yield from motion.sensor_transforms(ROS2, time, name, frames_of(drawing, drawn), places)
