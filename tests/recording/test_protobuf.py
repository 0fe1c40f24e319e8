"""Recordings with protobuf schemas, and ROS bags beside them, read with their makers' own libraries."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from mcap.reader import make_reader

from tests.recording.missions import drive_mission
from usarmjx.base.errors import UsageError
from usarmjx.recording import protobuf
from usarmjx.recording.protobuf import message_of, read_bag, write_protobuf

pytest.importorskip("mcap_protobuf")
rosbags = pytest.importorskip("rosbags.typesys")
from google.protobuf.json_format import MessageToDict  # noqa: E402
from mcap_protobuf.decoder import DecoderFactory  # noqa: E402
from rosbags.rosbag1 import Writer as Writer1  # noqa: E402
from rosbags.rosbag2 import Writer as Writer2  # noqa: E402

SECOND = 10**9


def moments(value):
    """Foxglove's JSON with the times as protobuf's own JSON has them, without zeros and empty lists."""
    if isinstance(value, dict):
        if value.keys() == {"sec", "nsec"}:
            return value["sec"] + value["nsec"] / SECOND
        return {key: made for key, item in value.items() if (made := moments(item)) not in (0, "", [], False)}
    return [moments(item) for item in value] if isinstance(value, list) else value


def plain(value, key=""):
    if isinstance(value, dict):
        return {
            name: made
            for name, item in value.items()
            if (made := plain(item, name)) not in (0, "", [], False)
        }
    if isinstance(value, list):
        return [plain(item, key) for item in value]
    if key == "timestamp":
        return float(np.datetime64(value.rstrip("Z"), "ns").astype(int) / SECOND)
    return float(value.rstrip("s")) if key == "lifetime" else value


def near(one, other):
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(near(item, other[key]) for key, item in one.items())
    if isinstance(one, list):
        return len(one) == len(other) and all(map(near, one, other))
    return one == pytest.approx(other, rel=1e-6, abs=1e-6) if isinstance(one, float) else one == other


def test_every_message_of_a_mission_is_read_back_by_foxgloves_own_classes(mission, tmp_path):
    path = tmp_path / "proto.mcap"
    counts = {**write_protobuf(mission[0], path)}
    with mission[0].open("rb") as file:
        theirs = [
            (channel.topic, message.log_time, schema.name, json.loads(message.data))
            for schema, channel, message in make_reader(file).iter_messages()
            if schema.name.startswith("foxglove.")
        ]
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        ours = [one for one in reader.iter_decoded_messages() if one[1].topic != "/map"]
    assert counts.pop("/map") == 1
    assert len(ours) == len(theirs) == sum(counts.values()) > 10
    seen = {}
    for (schema, channel, message, decoded), (topic, time, name, value) in zip(ours, theirs, strict=True):
        assert (schema.encoding, channel.message_encoding) == ("protobuf", "protobuf")
        assert (channel.topic, message.log_time, schema.name) == (topic, time, name)
        seen.setdefault(name, (decoded, value))
    for decoded, value in seen.values():
        found = MessageToDict(decoded, preserving_proto_field_name=True, use_integers_for_enums=True)
        assert near(plain(found), moments(value)), value
    assert {"foxglove.FrameTransforms", "foxglove.SceneUpdate", "foxglove.LaserScan"} <= seen.keys()


def test_what_is_no_recording_is_refused(tmp_path, mission):
    (tmp_path / "a.mcap").write_bytes(b"nothing")
    with pytest.raises(UsageError, match=r"a\.mcap: is no recording of usarmjx"):
        write_protobuf(tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert not (tmp_path / "b.mcap").exists()
    with pytest.raises(UsageError, match="exists already"):
        write_protobuf(mission[0], tmp_path / "a.mcap")


def test_a_damaged_part_is_left_out_with_a_warning_and_the_rest_written(monkeypatch, tmp_path, caplog):
    """Of a file without its end, too; nothing of what follows is dropped without a word."""
    monkeypatch.setattr("usarmjx.recording.file.FLUSH", 0.0)  # a chunk for each frame, however fast it runs
    path = tmp_path / "mission.mcap"
    drive_mission(path)
    with path.open("rb") as file:
        chunks = make_reader(file).get_summary().chunk_indexes
    whole = write_protobuf(path, tmp_path / "whole.mcap")
    middle = max(chunks[10 : len(chunks) // 2], key=lambda chunk: chunk.chunk_length)
    data = bytearray(path.read_bytes())
    data[middle.chunk_start_offset + middle.chunk_length // 2] ^= 4
    for name, content in (("flipped", data), ("cut", data[: chunks[-1].chunk_start_offset + 20])):
        (tmp_path / f"{name}.mcap").write_bytes(content)
        caplog.clear()
        left = write_protobuf(tmp_path / f"{name}.mcap", tmp_path / f"{name}.proto.mcap")
        assert "damaged and left out" in caplog.text
        assert 0 < sum(left.values()) < sum(whole.values())
        with (tmp_path / f"{name}.proto.mcap").open("rb") as file:
            last = max(message.log_time for _, _, message in make_reader(file).iter_messages())
        assert last > middle.message_end_time


def test_a_message_of_another_form_is_refused_in_one_line(mission, tmp_path, monkeypatch):
    odd = {"transforms": [{"nothing": 3}]}
    monkeypatch.setattr(protobuf, "_recorded", lambda path: [("/tf", "foxglove.FrameTransforms", odd, 5)])
    with pytest.raises(UsageError, match=r"/tf at 0\.00 s: is no foxglove\.FrameTransforms: 'nothing'"):
        write_protobuf(mission[0], tmp_path / "odd.mcap")
    assert not (tmp_path / "odd.mcap").exists()


def header(types, frame):
    time = types["builtin_interfaces/msg/Time"](sec=100, nanosec=0)
    kind = types["std_msgs/msg/Header"]
    more = {"seq": 0} if "seq" in kind.__dataclass_fields__ else {}
    return kind(stamp=time, frame_id=frame, **more)


def messages(types):
    make = SimpleNamespace(
        **{name.rpartition("/")[2]: kind for name, kind in types.items() if "/msg/" in name}
    )
    pose = types["geometry_msgs/msg/Pose"](
        position=types["geometry_msgs/msg/Point"](x=1.0, y=2.0, z=0.5),
        orientation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=1.0, w=0.0),
    )
    zero = types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
    odometry = types["nav_msgs/msg/Odometry"](
        header=header(types, "odom"),
        child_frame_id="base",
        pose=make.PoseWithCovariance(pose=pose, covariance=np.zeros(36)),
        twist=make.TwistWithCovariance(twist=make.Twist(linear=zero, angular=zero), covariance=np.zeros(36)),
    )
    scan = types["sensor_msgs/msg/LaserScan"](
        header=header(types, "/laser"),
        angle_min=-1.0,
        angle_max=1.0,
        angle_increment=1.0,
        time_increment=0.0,
        scan_time=0.1,
        range_min=0.1,
        range_max=8.0,
        ranges=np.array([1.0, np.inf, 3.0], np.float32),
        intensities=np.zeros(0, np.float32),
    )
    return {"/odom": odometry, "/scan": scan}


@pytest.fixture(params=[1, 2])
def bag(request, tmp_path):
    if request.param == 1:
        store = rosbags.get_typestore(rosbags.Stores.ROS1_NOETIC)
        path, writer, write = tmp_path / "real.bag", Writer1, store.serialize_ros1
        path_writer = writer(path)
    else:
        store = rosbags.get_typestore(rosbags.Stores.ROS2_HUMBLE)
        path, write = tmp_path / "real", store.serialize_cdr
        path_writer = Writer2(path, version=9)
    with path_writer as file:
        for number, (topic, message) in enumerate(messages(store.types).items()):
            connection = file.add_connection(topic, message.__msgtype__, typestore=store)
            file.write(connection, 100 * SECOND + number * SECOND // 2, write(message, message.__msgtype__))
    return path


def test_transforms_of_bags_from_before_tf2_are_read(tmp_path):
    """ROS 1 had the type tf/tfMessage, and a slash before frames' names."""
    store = rosbags.get_typestore(rosbags.Stores.ROS1_NOETIC)
    kind = "tf/msg/tfMessage"
    store.register(rosbags.get_types_from_msg("geometry_msgs/TransformStamped[] transforms", kind))
    types = store.types
    where = types["geometry_msgs/msg/Transform"](
        translation=types["geometry_msgs/msg/Vector3"](x=0.2, y=0.0, z=0.3),
        rotation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
    )
    one = types["geometry_msgs/msg/TransformStamped"](
        header=header(types, "/robot_0/base_footprint"), child_frame_id="/hokuyo", transform=where
    )
    with Writer1(tmp_path / "old.bag") as file:
        connection = file.add_connection("/tf", kind, typestore=store)
        file.write(connection, SECOND, store.serialize_ros1(types[kind](transforms=[one]), kind))
    (found,) = read_bag(tmp_path / "old.bag")
    (transform,) = found.value["transforms"]
    assert (found.topic, found.schema) == ("/bag/tf", "foxglove.FrameTransforms")
    assert (transform["parent_frame_id"], transform["child_frame_id"]) == (
        "bag/robot_0/base_footprint",
        "bag/hokuyo",
    )
    assert transform["translation"] == {"x": 0.2, "y": 0.0, "z": 0.3}


def test_odometry_and_scans_of_bags_are_read(bag):
    odometry, scan = read_bag(bag, 5 * SECOND)
    assert (odometry.time, odometry.topic, odometry.schema) == (
        5 * SECOND,
        "/bag/odom",
        "foxglove.FrameTransforms",
    )
    root, moved = odometry.value["transforms"]
    assert (root["parent_frame_id"], root["child_frame_id"]) == ("world", "bag/odom")
    assert (moved["parent_frame_id"], moved["child_frame_id"]) == ("bag/odom", "bag/base")
    assert moved["translation"] == {"x": 1.0, "y": 2.0, "z": 0.5}
    assert moved["rotation"] == {"x": 0.0, "y": 0.0, "z": 1.0, "w": 0.0}
    assert (scan.time, scan.value["frame_id"]) == (5 * SECOND + SECOND // 2, "bag/laser")
    assert scan.value["ranges"] == [1.0, 8.0, 3.0], "no echo is the longest range"
    assert message_of(scan.schema, scan.value).end_angle == 1.0


def test_a_bag_lies_beside_the_recording(bag, mission, tmp_path):
    path = tmp_path / "both.mcap"
    counts = write_protobuf(mission[0], path, bag, 0.5)
    assert (counts["/bag/odom"], counts["/bag/scan"]) == (1, 1)
    with path.open("rb") as file:
        found = list(make_reader(file).iter_messages())
    start = min(message.log_time for _, channel, message in found if not channel.topic.startswith("/bag"))
    (odometry,) = (message.log_time for _, channel, message in found if channel.topic == "/bag/odom")
    assert odometry - start == SECOND // 2


def test_what_is_no_bag_is_refused(tmp_path):
    (tmp_path / "x.bag").write_bytes(b"nothing")
    with pytest.raises(UsageError, match=r"x\.bag: does not read as a bag"):
        list(read_bag(tmp_path / "x.bag"))
