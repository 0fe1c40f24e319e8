"""Recordings with Foxglove's protobuf schemas, for viewers that do not read its JSON; bags beside them."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from usarmjx.base.errors import MissingExtraError, UsageError
from usarmjx.base.files import atomic_write
from usarmjx.base.installation import install_command
from usarmjx.base.settings.files import first_line
from usarmjx.recording.file import CHANNELS, topic_of
from usarmjx.recording.foxglove import NANO, WORLD
from usarmjx.recording.reader import CameraShot, Recording, grid_message, recorded_arena, shot_messages

BAG = "bag"
"""First part of topics and frames of a bag."""
FOXGLOVE = "foxglove."
"""Prefix of schemas that have a protobuf form."""
MOMENTS = ("google.protobuf.Timestamp", "google.protobuf.Duration")
"""Messages for which JSON has `sec` and `nsec`."""


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
    # For ROS 2 bags without definitions of their messages; others bring their own.
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
                # Bags have times of day, recordings those of their world.
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
    # ROS 1 writes the same frame with a slash in front, or without.
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


def write_protobuf(
    recording: Path,
    path: Path,
    bag: Path | None = None,
    bag_start: float = 0.0,
    shots: Iterable[CameraShot] = (),
) -> Mapping[str, int]:
    """Write transforms, shapes, scans, trails, log lines and map of a recording as protobuf messages.

    States and inputs are left out: the recording itself remains the file for `usarmjx view` and `replay`.

    Args:
        recording: An MCAP file of usarmjx, also one that was broken off.
        path: The file, which must not exist yet.
        bag: ROS bag whose odometry, transforms and scans are put beside; None: none.
        bag_start: Time of the recording at which the bag begins [s].
        shots: Pictures of its robots' cameras.

    Returns:
        Number of messages by topic.

    Raises:
        UsageError: No recording, one without such messages or with one of another form, no bag, or a file
            that exists.
        MissingExtraError: The packages of the extra are missing.
        WriteError: It cannot be written.
    """
    try:
        library = import_module("mcap_protobuf.writer")
        import_module("foxglove_schemas_protobuf")
    except ModuleNotFoundError as error:
        raise MissingExtraError(f"{error.name} is not installed: {install_command('foxglove')}") from error
    # The atomic writer would replace it.
    if path.exists():
        raise UsageError(f"{path} exists already")
    counts: Counter[str] = Counter()
    with atomic_write(path) as fresh, fresh.open("wb") as target:
        writer = library.Writer(target)
        for topic, schema, value, time in _together(recording, bag, bag_start, shots):
            try:
                message = message_of(schema, value)
            except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
                where = f"{recording}: {topic} at {time / NANO:.2f} s"
                raise UsageError(f"{where}: is no {schema}: {first_line(error)}") from error
            writer.write_message(topic, message, log_time=time, publish_time=time)
            counts[topic] += 1
        writer.finish()
    return counts


Timed = tuple[str, str, Mapping[str, Any], int]
"""Topic, schema and value of a message, and its time [ns]."""


def _together(
    recording: Path, bag: Path | None, bag_start: float, shots: Iterable[CameraShot]
) -> Iterator[Timed]:
    """Yield the messages of a recording, then those of a bag and pictures: readers sort them by time."""
    start = None
    for one in _recorded(recording):
        # The smallest, not the first: shapes are written in pieces, behind later messages.
        start = one[3] if start is None else min(start, one[3])
        yield one
    if start is None:
        raise UsageError(f"{recording}: has no messages of Foxglove's schemas: is it a recording of usarmjx?")
    with closing(Recording(recording)) as source:
        several = len(source.worlds) > 1
        for world in source.worlds:
            arena = recorded_arena(source, world)
            if arena is not None:
                value = grid_message(arena, start / NANO)
                yield _topic(world, "map", several=several), "foxglove.Grid", value, start
        for shot in shots:
            for kind, schema, value in shot_messages(shot):
                yield _topic(shot.world, kind, several=several), schema, value, round(shot.time * NANO)
    if bag is not None:
        shift = start + round(bag_start * NANO)
        for time, topic, schema, value in read_bag(bag, shift):
            yield topic, schema, value, time


def _topic(world: int, kind: str, *, several: bool) -> str:
    return f"/world{world}/{kind}" if several else f"/{kind}"


def _recorded(recording: Path) -> Iterator[Timed]:
    """Yield the messages of Foxglove's schemas; damaged parts are left out with a warning."""
    kinds = [kind for kind, schema in CHANNELS.items() if schema.startswith(FOXGLOVE)]
    with closing(Recording(recording)) as source:
        several = len(source.worlds) > 1
        for time, channel, value in source.messages(kinds):
            yield topic_of(channel, several=several), CHANNELS[channel.kind], value, round(time * NANO)


def message_of(schema: str, value: Mapping[str, Any]) -> Any:  # noqa: ANN401 - a generated class
    """Return a message of Foxglove's JSON as its protobuf message.

    Args:
        schema: Its schema, such as `foxglove.LaserScan`.
        value: The message.
    """
    name = schema.removeprefix(FOXGLOVE)
    # Each schema is a module of its own in that package, found by the name in our table alone.
    kind = getattr(import_module(f"foxglove_schemas_protobuf.{name}_pb2"), name)
    made = kind()
    _fill(made, value)
    return made


def _fill(message: Any, value: Mapping[str, Any]) -> None:  # noqa: ANN401 - a generated class
    if message.DESCRIPTOR.full_name in MOMENTS:
        message.seconds, message.nanos = value["sec"], value["nsec"]
        return
    fields = message.DESCRIPTOR.fields_by_name
    for key, item in value.items():
        field = fields[key]
        if isinstance(item, list):
            # Protobuf refuses an assignment to a repeated field: it is filled in place.
            target = getattr(message, key)
            if field.message_type is None:
                target.extend(item)
            else:
                for one in cast("list[dict[str, Any]]", item):
                    _fill(target.add(), one)
        elif field.message_type is None:
            setattr(message, key, item)
        else:
            target = getattr(message, key)
            # A message of zeros would count as absent: protobuf does not write defaults.
            target.SetInParent()
            _fill(target, item)
