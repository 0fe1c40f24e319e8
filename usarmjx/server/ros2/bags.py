"""Recordings as bags of ROS 2: topics of a served world, as rosbag2 writes them.

Poses and joints are those of the recorded frames, five a second; readings are all. Pictures are not recorded:
who renders some of the frames hands them over.
"""

from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace, TracebackType
from typing import Any, NamedTuple, Self

import numpy as np
import yaml
from mcap.writer import CompressionType, Writer

from usarmjx.base.backend import numpy_backend
from usarmjx.base.errors import UsageError
from usarmjx.base.files import atomic_write
from usarmjx.base.rotations import mat_from_quat
from usarmjx.models.compile.raster import floor_map
from usarmjx.models.robots import ROBOTS
from usarmjx.recording.reader import CameraShot, RecordedMessage, Recording, recorded_arena
from usarmjx.server.ros2.transport import CLOCK, DEFAULT, LATCHED, SENSOR, Qos, message_hash
from usarmjx.server.rosbridge import motion, topics
from usarmjx.server.rosbridge.definitions import RosMessage, RosVersion
from usarmjx.server.rosbridge.encodings import MessageBytes
from usarmjx.server.rosbridge.motion import MAP, SensorFrame, frame_name, true_estimate
from usarmjx.server.rosbridge.robot_description import urdf
from usarmjx.server.rosbridge.topics import IMAGE, USUAL_NAMES, occupancy_grid, pinhole_info
from usarmjx.view.drawing import Drawing, DrawnMount, DrawnRobot, Frame, RobotFrame

VERSION = 9
"""Version of `metadata.yaml`: that of Jazzy, Kilted and later."""
PROFILE, SCHEMA_ENCODING, MESSAGE_ENCODING = "ros2", "ros2msg", "cdr"
NANO = 10**9
# The largest int64 of nanoseconds, which stands for infinity in rmw.
FOREVER = {"sec": 9223372036, "nsec": 854775807}
SEPARATOR = "=" * 80
ROS2 = RosVersion.ROS2
SCANNERS = ("RangeScanner", "IRScanner")
"""Types on the wire of plane scanners."""
RADIATION = {"Sonar": topics.ULTRASOUND, "IR": topics.INFRARED}
"""Radiation of the sensors that are a Range, by their types on the wire."""
POSES = ("Odometry", "INS", "GroundTruth")
"""Types on the wire of sensors that estimate a pose."""


def message_definition(kind: str) -> str:
    """Return the definition of a type with all types in it, as rosbag2 stores it: with short names."""
    listed, waiting, parts = {kind}, [kind], list[str]()
    while waiting:
        name = waiting.pop(0)
        fields = RosVersion.ROS2.fields(name)
        body = "".join(f"{its} {field}\n" for field, its in fields.items())
        parts.append(body if name == kind else f"{SEPARATOR}\nMSG: {name}\n{body}")
        for base in (its.partition("[")[0] for its in fields.values()):
            if "/" in base and base not in listed:
                listed.add(base)
                waiting.append(base)
    return "".join(parts)


def offered_qos(qos: Qos) -> dict[str, Any]:
    """Return a quality as `metadata.yaml` has it."""
    return {
        "history": "keep_last",
        "depth": qos.depth,
        "reliability": "reliable" if qos.is_reliable else "best_effort",
        "durability": "transient_local" if qos.is_latched else "volatile",
        "deadline": dict(FOREVER),
        "lifespan": dict(FOREVER),
        "liveliness": "automatic",
        "liveliness_lease_duration": dict(FOREVER),
        "avoid_ros_namespace_conventions": False,
    }


class BagWriter:
    """Writer of a bag; a context manager.

    Args:
        folder: The new folder.

    Raises:
        UsageError: There is something of that name already.
    """

    def __init__(self, folder: Path) -> None:
        if folder.exists():
            raise UsageError(f"{folder} exists already: a bag is a new folder")
        folder.mkdir(parents=True)
        # rosbag2 finds a file by this name pattern in the folder.
        self._folder, self._file = folder, f"{folder.stem}_0.mcap"
        self._stream = (folder / self._file).open("wb")
        self._writer = Writer(self._stream, compression=CompressionType.ZSTD)
        self._writer.start(profile=PROFILE, library="usarmjx")
        self._bytes = MessageBytes(RosVersion.ROS2)
        self._schemas: dict[str, int] = {}
        self._topics: dict[str, dict[str, Any]] = {}
        self._channels: dict[str, int] = {}
        self._first = self._last = -1

    @property
    def topics(self) -> dict[str, int]:
        """The number of messages so far, by topic."""
        return {name: one["message_count"] for name, one in self._topics.items()}

    def write(self, topic: str, kind: str, message: RosMessage, time: float, qos: Qos) -> None:
        """Write a message of a type, by its short name, at a simulated time [s]."""
        # Simulated time for both of MCAP's times: rosbag2 plays by the log time, which a wall clock would
        # stretch.
        stamp = round(time * NANO)
        if topic not in self._channels:
            self._channels[topic] = self._channel(topic, kind, qos)
        data = self._bytes.whole(kind, message)
        self._writer.add_message(self._channels[topic], stamp, data, stamp)
        self._topics[topic]["message_count"] += 1
        self._first = stamp if self._first < 0 else min(self._first, stamp)
        # Pictures come after all else, with earlier times: the first and last are not those written first and
        # last.
        self._last = max(self._last, stamp)

    def _channel(self, topic: str, kind: str, qos: Qos) -> int:
        name, quality = RosVersion.ROS2.type_name(kind), [offered_qos(qos)]
        if kind not in self._schemas:
            text = message_definition(kind).encode()
            self._schemas[kind] = self._writer.register_schema(name, SCHEMA_ENCODING, text)
        self._topics[topic] = {
            "topic_metadata": {
                "name": topic,
                "type": name,
                "serialization_format": MESSAGE_ENCODING,
                "offered_qos_profiles": quality,
                "type_description_hash": message_hash(kind),
            },
            "message_count": 0,
        }
        about = {
            "offered_qos_profiles": yaml.safe_dump(quality, sort_keys=False),
            "topic_type_hash": message_hash(kind),
        }
        return self._writer.register_channel(topic, MESSAGE_ENCODING, self._schemas[kind], about)

    def close(self) -> None:
        """Complete the file, and write `metadata.yaml`."""
        self._writer.finish()
        self._stream.close()
        count = sum(self.topics.values())
        # A bag without messages still has -1 as its first time.
        start = {"nanoseconds_since_epoch": max(self._first, 0)}
        lasted = {"nanoseconds": max(self._last - self._first, 0)}
        about = {
            "version": VERSION,
            "storage_identifier": "mcap",
            "duration": lasted,
            "starting_time": start,
            "message_count": count,
            "topics_with_message_count": list(self._topics.values()),
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self._file],
            "files": [
                {"path": self._file, "starting_time": start, "duration": lasted, "message_count": count}
            ],
            "custom_data": None,
            "ros_distro": "usarmjx",
        }
        # Written last: a folder without it is an unfinished bag for readers, not a wrong one.
        with atomic_write(self._folder / "metadata.yaml") as fresh:
            fresh.write_text(
                yaml.dump({"rosbag2_bagfile_information": about}, Dumper=_NoAliases, sort_keys=False),
                encoding="utf-8",
            )

    def __enter__(self) -> Self:
        """Write until the end of `with`."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Complete the bag."""
        self.close()


class _NoAliases(yaml.SafeDumper):
    """Writes equal values twice: rosbag2's reader knows no aliases."""

    def ignore_aliases(self, data: Any) -> bool:  # noqa: ANN401 - any value of YAML
        del data
        return True


def frames_of(drawing: Drawing, drawn: DrawnRobot) -> list[SensorFrame]:
    """Return the frames of a robot's sensors, cameras and parts; of those with one name the first."""
    found: dict[str, SensorFrame] = {}
    for mount in (*drawn.sensors, *drawn.cameras):
        upright = mount.kind in SCANNERS and bool(mount.settings[0].get("pitch"))
        for index, title in enumerate(mount.names):
            mat = mount.mat[index] @ (motion.UPRIGHT if upright else np.eye(3))
            # Counted from the robot's own chassis, as transforms are relative to it.
            body = int(mount.body[index]) - drawn.body
            found.setdefault(title, SensorFrame(title, body, mount.pos[index], mat))
    for body in range(1, drawn.num_bodies):
        # Bodies of robots are called robot/SLOT/PART.
        part = drawing.bodies[drawn.body + body].name.split("/", 2)[2]
        found.setdefault(part, SensorFrame(part, body, np.zeros(3), np.eye(3)))
    return list(found.values())


def robot_transforms(frame: Frame, drawing: Drawing, slot: int) -> Iterator[RosMessage]:
    """Yield the transforms of a robot from its odom frame, and of its frames from it."""
    drawn = drawing.robots[slot]
    state: Any = frame.robots[slot]  # poses and velocities have the same names as a RobotState's
    name, time = frame_name(drawn.name), frame.time
    yield motion.base_transform(ROS2, time, name, true_estimate(state))
    # The class may be one of a file that is not here: its origin's height is unknown then.
    if drawn.robot in ROBOTS:
        spec = ROBOTS.get(drawn.robot)
        yield motion.footprint_transform(ROS2, time, name, spec, state, drawing.floor)
    own = slice(drawn.body, drawn.body + drawn.num_bodies)
    with numpy_backend():
        mats = np.asarray(mat_from_quat(frame.quat[own]), float)
    places = np.asarray(frame.pos[own], float), mats
    yield from motion.sensor_transforms(ROS2, time, name, frames_of(drawing, drawn), places)


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
        # At the time of the start: the map comes before all that is placed on it.
        for one in _map_messages(recording, world):
            bag.write(one.topic, one.kind, one.message, recording.start, one.qos)
        for message in recording.messages({"drawings", "frames", "readings"}, world):
            if message.channel.kind == "drawings":
                drawing = message.value
                assert isinstance(drawing, Drawing)
                found = _constant(drawing)
            # Frames before the first drawing cannot be named: robots are in the drawing.
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
        battery = topics.battery_state(ROS2, time, name, drawn.battery_life, robot.battery)
        yield BagMessage(f"/{name}/battery_state", "sensor_msgs/BatteryState", battery, DEFAULT)
    yield BagMessage("/tf", "tf2_msgs/TFMessage", {"transforms": transforms}, DEFAULT)


def _joints(time: float, drawn: DrawnRobot, robot: RobotFrame) -> RosMessage:
    return {
        "header": ROS2.header(time, ""),
        "name": list(drawn.joints),
        "position": robot.joint_pos.tolist(),
        # Frames do not have it; an empty list says so in a JointState.
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
                points = topics.scan_points(message)
                yield BagMessage(f"/{name}/{below}/points", "sensor_msgs/PointCloud2", points, SENSOR)
            # Names without the sensor's own, as tools for one scanner or IMU subscribe to.
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
        "IMU": ("sensor_msgs/Imu", partial(topics.imu, sensor)),
        **dict.fromkeys(SCANNERS, ("sensor_msgs/LaserScan", partial(topics.scan, sensor))),
        **{kind: ("geometry_msgs/PoseStamped", partial(_pose, kind)) for kind in POSES},
    }
    if mount.kind in RADIATION:
        for index, title in enumerate(mount.names):
            made = topics.ranger(sensor, index, RADIATION[mount.kind])(ROS2, time, robot, value)
            yield frame_name(title), "sensor_msgs/Range", made
    elif mount.kind in make:
        kind, function = make[mount.kind]
        yield frame_name(mount.names[0]), kind, function(ROS2, time, robot, value)


def _pose(kind: str, version: RosVersion, time: float, robot: str, value: np.ndarray) -> RosMessage:
    frame = f"{robot}/start" if kind == "Odometry" else MAP
    return topics.pose_estimate(version, time, frame, value)
