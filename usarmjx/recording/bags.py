"""ROS 1 and ROS 2 bags: odometry, transforms and plane scans of real robots, as Foxglove's messages."""

from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from usarmjx.base.errors import MissingExtraError, UsageError
from usarmjx.base.installation import install_command
from usarmjx.recording.foxglove import NANO, WORLD

BAG = "bag"
"""First part of topics and frames of a bag."""


class BagMessage(NamedTuple):
    """A message of a bag.

    Attributes:
        time: Its time [ns].
        topic: Topic, with `/bag` in front.
        schema: Foxglove's schema.
        value: The message as JSON has it.
    """

    time: int
    topic: str
    schema: str
    value: dict[str, Any]


def read_bag(path: Path, begin: int = 0) -> Iterator[BagMessage]:
    """Yield odometry, transforms and scans of a bag in their order.

    Args:
        path: A ROS 1 bag (`.bag`), or the folder or the MCAP or SQLite file of a ROS 2 bag.
        begin: Time at which the bag begins [ns].

    Raises:
        UsageError: No bag, or one without such messages.
        MissingExtraError: The package of the extra is missing.
    """
    try:
        highlevel = import_module("rosbags.highlevel")
        stores = import_module("rosbags.typesys")
    except ModuleNotFoundError as error:
        raise MissingExtraError(f"{error.name} is not installed: {install_command('foxglove')}") from error
    store = stores.get_typestore(stores.Stores.ROS2_HUMBLE)
    found = False
    try:
        with highlevel.AnyReader([path], default_typestore=store) as reader:
            wanted = [one for one in reader.connections if one.msgtype in CONVERTERS]
            start = reader.start_time
            for connection, time, data in reader.messages(connections=wanted):
                message = reader.deserialize(data, connection.msgtype)
                schema, convert = CONVERTERS[connection.msgtype]
                found = True
                at = time - start + begin
                yield BagMessage(at, f"/{BAG}{connection.topic}", schema, convert(message, at))
    except (highlevel.AnyReaderError, OSError) as error:
        raise UsageError(f"{path}: does not read as a bag: {error}") from error
    if not found:
        known = ", ".join(CONVERTERS)
        raise UsageError(f"{path}: has no messages of the types {known}")


def _stamp(time: int) -> dict[str, int]:
    return {"sec": time // NANO, "nsec": time % NANO}


def _frame(name: str) -> str:
    return f"{BAG}/{name.lstrip('/')}"


def _xyz(point: Any) -> dict[str, float]:  # noqa: ANN401 - classes that rosbags makes
    return {"x": float(point.x), "y": float(point.y), "z": float(point.z)}


def _xyzw(quaternion: Any) -> dict[str, float]:  # noqa: ANN401
    return {**_xyz(quaternion), "w": float(quaternion.w)}


def _transform(time: int, parent: str, child: str, at: Any, turn: Any) -> dict[str, Any]:  # noqa: ANN401
    return {
        "timestamp": _stamp(time),
        "parent_frame_id": parent,
        "child_frame_id": child,
        "translation": at,
        "rotation": turn,
    }


def _from_odometry(message: Any, time: int) -> dict[str, Any]:  # noqa: ANN401
    """Return an odometry's pose in its frame, which stands in the world's origin."""
    frame = _frame(message.header.frame_id)
    origin = {"x": 0.0, "y": 0.0, "z": 0.0}
    pose = message.pose.pose
    return {
        "transforms": [
            _transform(time, WORLD, frame, origin, {**origin, "w": 1.0}),
            _transform(
                time, frame, _frame(message.child_frame_id), _xyz(pose.position), _xyzw(pose.orientation)
            ),
        ]
    }


def _from_transforms(message: Any, time: int) -> dict[str, Any]:  # noqa: ANN401
    return {
        "transforms": [
            _transform(
                time,
                _frame(one.header.frame_id),
                _frame(one.child_frame_id),
                _xyz(one.transform.translation),
                _xyzw(one.transform.rotation),
            )
            for one in message.transforms
        ]
    }


def _from_scan(message: Any, time: int) -> dict[str, Any]:  # noqa: ANN401
    """Return a scan; readings that are no number, as of beams without an echo, are its longest range."""
    ranges = np.asarray(message.ranges, float)
    ranges = np.where(np.isfinite(ranges), ranges, float(message.range_max))
    origin = {"x": 0.0, "y": 0.0, "z": 0.0}
    return {
        "timestamp": _stamp(time),
        "frame_id": _frame(message.header.frame_id),
        "pose": {"position": origin, "orientation": {**origin, "w": 1.0}},
        "start_angle": float(message.angle_min),
        "end_angle": float(message.angle_max),
        "ranges": ranges.tolist(),
        "intensities": np.asarray(message.intensities, float).tolist(),
    }


Converter = tuple[str, Callable[[Any, int], dict[str, Any]]]
CONVERTERS: dict[str, Converter] = {
    "nav_msgs/msg/Odometry": ("foxglove.FrameTransforms", _from_odometry),
    "tf2_msgs/msg/TFMessage": ("foxglove.FrameTransforms", _from_transforms),
    "tf/msg/tfMessage": ("foxglove.FrameTransforms", _from_transforms),  # of ROS 1 before 2014
    "sensor_msgs/msg/LaserScan": ("foxglove.LaserScan", _from_scan),
}
"""Foxglove's schema and the converter of each type of ROS' messages."""
