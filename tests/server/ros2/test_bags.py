"""Recordings as bags of ROS 2, read by rosbags and by mcap-ros2-support."""

from xml.etree.ElementTree import fromstring

import numpy as np
import pytest
import yaml
from mcap_ros2.reader import read_ros2_messages
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from typer.testing import CliRunner

from tests.recording.missions import SCOUT, SIDE, drive_mission
from usarmjx.base.errors import UsageError
from usarmjx.base.transforms import flip_vector
from usarmjx.cli.app import app
from usarmjx.models.robots import ROBOTS
from usarmjx.recording.reader import Recording
from usarmjx.server.ros2.bags import message_definition, write_bag
from usarmjx.server.rosbridge.robot_description import urdf


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """A bag of a mission, and where the robots were after each step, by name."""
    folder = tmp_path_factory.mktemp("bag")
    places = drive_mission(folder / "mission.mcap")
    result = CliRunner().invoke(
        app, ["export", str(folder / "mission.mcap"), "--out", str(folder / "m.rosbag2")]
    )
    assert result.exit_code == 0, result.output
    assert "/clock: " in result.output
    return folder, places


def test_rosbags_reads_every_message_of_a_bag(bag):
    folder, places = bag
    store, seen = get_typestore(Stores.ROS2_KILTED), {}
    with Reader(folder / "m.rosbag2") as reader:
        for connection, stamp, data in reader.messages():
            message = store.deserialize_cdr(data, connection.msgtype)
            seen.setdefault(connection.topic, []).append((stamp * 1e-9, message))
        assert reader.message_count == sum(len(one) for one in seen.values())
        kinds = {one.topic: (one.msgtype, one.digest) for one in reader.connections}
        latched = {
            one.topic for one in reader.connections if "TRANSIENT" in str(one.ext.offered_qos_profiles)
        }
    assert {"/clock", "/tf", "/tf_static", "/map", "/First/odom", "/Second/joint_states"} <= set(seen)
    assert latched == {"/tf_static", "/map"}, "a class of the test's own has no description"
    for kind, digest in kinds.values():
        assert digest in ("", store.hash_rihs01(kind))
    for name in ("First", "Second"):
        for time, odom in seen[f"/{name}/odom"]:
            at = odom.pose.pose.position
            here = places[round(time / 0.02) - 1][name]
            np.testing.assert_allclose([at.x, at.y, at.z], here, atol=1e-5)
    scan = seen["/First/scan"][0][1]
    assert scan.header.frame_id == "First/Scanner1"
    assert len(scan.ranges) == 32
    frames = {one.child_frame_id for one in seen["/tf"][0][1].transforms}
    assert {"First/base_link", "First/Scanner1"} <= frames


def _read(folder):
    """Messages of the bag of a folder by topic, read by rosbags."""
    store, found = get_typestore(Stores.ROS2_KILTED), {}
    with Reader(folder / "m.rosbag2") as reader:
        for connection, _, data in reader.messages():
            found.setdefault(connection.topic, []).append(store.deserialize_cdr(data, connection.msgtype))
    return found


def _pose(transform):
    """Return position (3,) and orientation (3, 3) of a transform."""
    at, turn = transform.transform.translation, transform.transform.rotation
    x, y, z, w = turn.x, turn.y, turn.z, turn.w
    axis = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.array([at.x, at.y, at.z]), np.eye(3) + 2 * w * axis + 2 * axis @ axis


def test_points_of_scans_lie_on_the_walls(bag):
    """Viewers that draw no LaserScan draw the cloud, in the frame that `/tf` places."""
    found = _read(bag[0])
    poses = {one.child_frame_id: one for one in found["/tf"][0].transforms}
    scan, cloud = found["/First/Scanner1"][0], found["/First/Scanner1/points"][0]
    assert (cloud.header.frame_id, cloud.height, cloud.point_step) == ("First/Scanner1", 1, 12)
    assert [(one.name, one.offset, one.datatype, one.count) for one in cloud.fields] == [
        ("x", 0, 7, 1),
        ("y", 4, 7, 1),
        ("z", 8, 7, 1),
    ]
    points = cloud.data.view("<f4").reshape(cloud.width, 3).astype(float)
    echoes = scan.ranges[scan.ranges < scan.range_max]
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), echoes, rtol=1e-5)
    for frame in ("First/Scanner1", "First/base_link"):  # the odom frame is the map's in a bag
        at, mat = _pose(poses[frame])
        points = points @ mat.T + at
    inner = SIDE - 0.05  # the room's walls are 0.1 m thick
    off = np.abs(np.abs(points[:, :2]).max(1) - inner)
    assert len(points) > 20
    assert np.median(off) < 0.03, "half the beams meet a wall, with the scanner's noise"


def test_parts_have_frames_where_their_class_has_them(bag):
    found = _read(bag[0])
    first = {one.child_frame_id: _pose(one) for one in found["/tf"][0].transforms}
    for part in SCOUT.parts:
        at, _ = first[f"First/{part.name}"]
        np.testing.assert_allclose(at, flip_vector(part.at), atol=1e-4)
    last = [one for message in found["/tf"] for one in message.transforms][-1]
    assert last.child_frame_id.startswith("Second/")


def test_links_of_a_named_robot_are_its_frames():
    """A viewer without a prefix for frames draws two robots of one class in their places."""
    root = fromstring(urdf(ROBOTS.get("P2AT"), "R1"))
    assert root.get("name") == "R1"
    links = {one.get("name") for one in root.iter("link")}
    assert {"R1/base_link", "R1/LeftFWheel"} <= links
    assert all(name.startswith("R1/") for name in links)
    ends = {one.get("link") for kind in ("parent", "child") for one in root.iter(kind)}
    assert ends == links
    assert "LeftFWheel" in {one.get("name") for one in root.iter("joint")}, "as in joint_states"


def test_mcap_ros2_reads_the_schemas_of_a_bag(bag):
    folder, _ = bag
    topics = set()
    for message in read_ros2_messages(folder / "m.rosbag2" / "m_0.mcap"):
        topics.add(message.channel.topic)
        assert message.schema.encoding == "ros2msg"
        if message.channel.topic == "/clock":
            assert message.ros_msg.clock.sec >= 0
    assert "/First/battery_state" in topics
    about = yaml.safe_load((folder / "m.rosbag2" / "metadata.yaml").read_text())
    about = about["rosbag2_bagfile_information"]
    assert (about["version"], about["storage_identifier"]) == (9, "mcap")
    assert about["relative_file_paths"] == ["m_0.mcap"]


def test_definitions_have_all_types_in_them_by_short_names():
    text = message_definition("rosgraph_msgs/Clock")
    time = "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    assert text == f"builtin_interfaces/Time clock\n{'=' * 80}\n{time}"


def test_a_bag_is_a_new_folder_of_a_world_that_is_there(bag):
    folder, _ = bag
    recording = Recording(folder / "mission.mcap")
    with pytest.raises(UsageError, match="exists already"):
        write_bag(recording, folder / "m.rosbag2")
    with pytest.raises(UsageError, match="has no world 7; it has 0"):
        write_bag(recording, folder / "other.rosbag2", world=7)
    assert not (folder / "other.rosbag2").exists()
