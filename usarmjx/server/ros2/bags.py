"""Recordings as bags of ROS 2: the topics of a served world, as far as a recording has their data.

Poses and joints are those of the recorded frames, five a second; readings are all. Pictures are not recorded:
who renders some of the frames hands them over.
"""

from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.models.compile.raster import floor_map
from usarmjx.models.robots import ROBOTS
from usarmjx.recording.reader import RecordedMessage, Recording
from usarmjx.recording.shots import CameraShot, recorded_arena
from usarmjx.server.ros2.bag_file import BagWriter
from usarmjx.server.ros2.bag_frames import SCANNERS, robot_transforms
from usarmjx.server.ros2.transport import CLOCK, DEFAULT, LATCHED, SENSOR, Qos
from usarmjx.server.rosbridge import motion, readings
from usarmjx.server.rosbridge.definitions import RosMessage, RosVersion
from usarmjx.server.rosbridge.lens import pinhole_info
from usarmjx.server.rosbridge.motion import MAP, frame_name
from usarmjx.server.rosbridge.robot_description import urdf
from usarmjx.server.rosbridge.topics import IMAGE, USUAL_NAMES, occupancy_grid
from usarmjx.server.rosbridge.wheel_odometry import true_estimate
from usarmjx.view.drawing import Drawing, DrawnMount, DrawnRobot, Frame, RobotFrame

ROS2 = RosVersion.ROS2
RADIATION = {"Sonar": readings.ULTRASOUND, "IR": readings.INFRARED}
"""Radiation of the sensors that are a Range, by their types on the wire."""
POSES = ("Odometry", "INS", "GroundTruth")
"""Types on the wire of sensors that estimate a pose."""


class BagMessage(NamedTuple):
    """A message for a bag: its topic, its short type, itself, and its topic's quality."""

    topic: str
    kind: str
    message: RosMessage
    qos: Qos


def write_bag(
    recording: Recording, folder: Path, world: int = 0, shots: Iterable[CameraShot] = ()
) -> dict[str, int]:
    """Write one world of a recording as a bag; return the number of messages by topic.

    Args:
        recording: The recording.
        folder: The new folder.
        world: Number of the world.
        shots: Pictures of its robots' cameras.

    Raises:
        UsageError: The folder exists already, or there is no such world.
    """
    if world not in recording.worlds:
        raise UsageError(f"{recording.path} has no world {world}; it has {_listed(recording.worlds)}")
    drawing: Drawing | None = None
    with BagWriter(folder) as bag:
        for one in _map_messages(recording, world):
            bag.write(one.topic, one.kind, one.message, recording.start, one.qos)
        for message in recording.messages({"drawings", "frames", "readings"}, world):
            if message.channel.kind == "drawings":
                drawing = message.value
                assert isinstance(drawing, Drawing)
                found = _constant(drawing)
            elif drawing is None:
                continue
            else:
                found = _of_message(message, drawing)
            for one in found:
                bag.write(one.topic, one.kind, one.message, message.time, one.qos)
        for shot in shots:
            for one in _of_shot(shot):
                bag.write(one.topic, one.kind, one.message, shot.time, one.qos)
        return bag.topics


def _listed(worlds: Any) -> str:  # noqa: ANN401 - numbers
    return ", ".join(map(str, worlds))


def _map_messages(recording: Recording, world: int) -> Iterator[BagMessage]:
    """Yield the map of a world whose arena is recorded."""
    arena = recorded_arena(recording, world)
    if arena is not None:
        grid = occupancy_grid(ROS2, arena.floor, *floor_map(arena))
        yield BagMessage("/map", "nav_msgs/OccupancyGrid", grid, LATCHED)


def _of_shot(shot: CameraShot) -> Iterator[BagMessage]:
    robot, camera = frame_name(shot.robot), frame_name(shot.camera)
    frame = motion.optical_name(f"{robot}/{camera}")
    where = motion.transform(ROS2, shot.time, MAP, frame, (shot.pos, shot.quat))
    yield BagMessage("/tf", "tf2_msgs/TFMessage", {"transforms": [where]}, DEFAULT)
    picture = {"header": ROS2.header(shot.time, frame), "format": "jpeg", "data": shot.jpeg}
    yield BagMessage(f"/{robot}/{camera}/compressed", IMAGE, picture, SENSOR)
    info = pinhole_info(ROS2, shot.time, frame, shot.fov, shot.size)
    yield BagMessage(f"/{robot}/{camera}/camera_info", "sensor_msgs/CameraInfo", info, SENSOR)


def _constant(drawing: Drawing) -> Iterator[BagMessage]:
    """Yield what changes only when robots come and go."""
    names = [frame_name(robot.name) for robot in drawing.robots.values()]
    fixed = [motion.odom_transform(ROS2, 0.0, name) for name in names]
    yield BagMessage("/tf_static", "tf2_msgs/TFMessage", {"transforms": fixed}, LATCHED)
    for name, robot in zip(names, drawing.robots.values(), strict=True):
        if robot.robot in ROBOTS:
            text = {"data": urdf(ROBOTS.get(robot.robot), name)}
            yield BagMessage(f"/{name}/robot_description", "std_msgs/String", text, LATCHED)


def _of_message(message: RecordedMessage, drawing: Drawing) -> Iterator[BagMessage]:
    yield BagMessage("/clock", "rosgraph_msgs/Clock", {"clock": ROS2.stamp(message.time)}, CLOCK)
    if message.channel.kind == "frames":
        yield from _of_frame(message.value, drawing)
    else:
        yield from _of_readings(message.time, message.value, drawing)


def _of_frame(frame: Frame, drawing: Drawing) -> Iterator[BagMessage]:
    transforms: list[RosMessage] = []
    for slot, robot in frame.robots.items():
        drawn = drawing.robots[slot]
        name, time = frame_name(drawn.name), frame.time
        state: Any = robot  # poses and velocities have the same names as a RobotState's
        transforms += robot_transforms(frame, drawing, slot)
        odom = motion.odometry(ROS2, time, name, true_estimate(state))
        yield BagMessage(f"/{name}/odom", "nav_msgs/Odometry", odom, DEFAULT)
        joints = _joints(time, drawn, robot)
        yield BagMessage(f"/{name}/joint_states", "sensor_msgs/JointState", joints, DEFAULT)
        battery = readings.battery_state(ROS2, time, name, drawn.battery_life, robot.battery)
        yield BagMessage(f"/{name}/battery_state", "sensor_msgs/BatteryState", battery, DEFAULT)
    yield BagMessage("/tf", "tf2_msgs/TFMessage", {"transforms": transforms}, DEFAULT)


def _joints(time: float, drawn: DrawnRobot, robot: RobotFrame) -> RosMessage:
    return {
        "header": ROS2.header(time, ""),
        "name": list(drawn.joints),
        "position": robot.joint_pos.tolist(),
        "velocity": [],
        "effort": [],
    }


def _of_readings(time: float, content: dict[str, Any], drawing: Drawing) -> Iterator[BagMessage]:
    usual: set[str] = set()
    slots: tuple[int, ...] = content["slots"]
    sensors: tuple[int, ...] = content["sensors"]
    for slot, sensor, value in zip(slots, sensors, content["values"], strict=True):
        if slot not in drawing.robots:
            continue
        robot = drawing.robots[slot]
        name = frame_name(robot.name)
        mount = robot.sensors[sensor]
        for below, kind, message in _reading(time, name, mount, np.asarray(value)):
            yield BagMessage(f"/{name}/{below}", kind, message, SENSOR)
            if kind == "sensor_msgs/LaserScan":  # some viewers draw clouds only
                points = readings.scan_points(message)
                yield BagMessage(f"/{name}/{below}/points", "sensor_msgs/PointCloud2", points, SENSOR)
            alias = f"/{name}/{USUAL_NAMES.get(kind)}"
            is_first = sensor == _first_of(robot, mount.kind)
            if kind in USUAL_NAMES and is_first and alias not in usual:
                usual.add(alias)
                yield BagMessage(alias, kind, message, SENSOR)


def _first_of(robot: DrawnRobot, kind: str) -> int:
    return next(index for index, mount in enumerate(robot.sensors) if mount.kind == kind)


def _reading(
    time: float, robot: str, mount: DrawnMount, value: np.ndarray
) -> Iterator[tuple[str, str, RosMessage]]:
    """Yield the messages of a reading, those that a served world has: topic below the robot, and type."""
    # As much of a sensor as the makers of messages look at.
    settings = tuple(SimpleNamespace(**one) for one in mount.settings)
    sensor: Any = SimpleNamespace(
        settings=settings, mounts=tuple(SimpleNamespace(name=title) for title in mount.names)
    )
    make = {
        "IMU": ("sensor_msgs/Imu", partial(readings.imu, sensor)),
        **dict.fromkeys(SCANNERS, ("sensor_msgs/LaserScan", partial(readings.scan, sensor))),
        **{kind: ("geometry_msgs/PoseStamped", partial(_pose, kind)) for kind in POSES},
    }
    if mount.kind in RADIATION:
        for index, title in enumerate(mount.names):
            made = readings.ranger(sensor, index, RADIATION[mount.kind])(ROS2, time, robot, value)
            yield frame_name(title), "sensor_msgs/Range", made
    elif mount.kind in make:
        kind, function = make[mount.kind]
        yield frame_name(mount.names[0]), kind, function(ROS2, time, robot, value)


def _pose(kind: str, version: RosVersion, time: float, robot: str, value: np.ndarray) -> RosMessage:
    frame = f"{robot}/start" if kind == "Odometry" else MAP
    return readings.pose_estimate(version, time, frame, value)
