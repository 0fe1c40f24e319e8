"""Recordings as bags of ROS 2, read by rosbags and by mcap-ros2-support."""

import numpy as np
import pytest
import yaml
from mcap_ros2.reader import read_ros2_messages
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from typer.testing import CliRunner

from tests.recording.missions import drive_mission
from usarmjx.base.errors import UsageError
from usarmjx.cli.app import app
from usarmjx.recording.reader import Recording
from usarmjx.server.ros2.bag_file import message_definition
from usarmjx.server.ros2.bags import write_bag


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
