"""Types of ROS: their bytes and their hashes, held against rosbags and against code that rosidl generated."""

import numpy as np
import pytest

from tests.server.ros2.typestores import foreign, full_name, sample, typestore
from usarmjx.base.errors import PeerError
from usarmjx.server.ros2.transport import message_hash, service_hash
from usarmjx.server.rosbridge.definitions import ALSO_TAKEN, INTERFACES, SHARED, RosVersion
from usarmjx.server.rosbridge.encodings import CdrReader, MessageBytes

ONLY_ONE_VERSION = ("std_msgs/Header", "sensor_msgs/Range", "sensor_msgs/CameraInfo")
KINDS = [kind for kind in (*SHARED, *ONLY_ONE_VERSION) if not kind.startswith("tf2_web_republisher")]


@pytest.fixture(scope="module")
def stores():
    return {version: typestore(version) for version in RosVersion}


@pytest.mark.oracle
@pytest.mark.parametrize("version", list(RosVersion))
def test_bytes_are_those_of_rosbags_and_read_back(stores, version):
    store, random, compared = stores[version], np.random.default_rng(3), 0
    further = INTERFACES if version == RosVersion.ROS2 else ()
    for kind in (*KINDS, *further):
        full = full_name(version, kind)
        if full not in store.types:  # ROS 1's tf2_msgs
            continue
        for _ in range(5):
            message = sample(version, kind, random)
            data = MessageBytes(version).whole(kind, message)
            other = foreign(store, version, kind, message)
            if version == RosVersion.ROS2:
                assert data == bytes(store.serialize_cdr(other, full)), kind
                assert CdrReader(data).message(kind) == message, kind
                swapped = store.serialize_cdr(other, full, little_endian=False)
                assert CdrReader(bytes(swapped)).message(kind) == message, kind
            else:
                assert data == bytes(store.serialize_ros1(other, full)), kind
            compared += 1
    assert compared > 130 if version == RosVersion.ROS1 else compared > 300


def test_a_number_that_is_not_known_is_nan():
    fix = sample(RosVersion.ROS2, "sensor_msgs/NavSatFix", np.random.default_rng(1)) | {"altitude": None}
    data = MessageBytes(RosVersion.ROS2).whole("sensor_msgs/NavSatFix", fix)
    assert np.isnan(CdrReader(data).message("sensor_msgs/NavSatFix")["altitude"])


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\0\1",
        b"\0\7\0\0",
        b"\0\1\0\0\5\0\0\0a",
        b"\0\1\0\0\xff\xff\xff\xffabc",
        b"\0\1\0\0\2\0\0\0\xff\xff",
    ],
)
def test_bytes_that_are_no_message_are_a_peers_fault(data):
    with pytest.raises(PeerError):
        CdrReader(data).message("std_msgs/String")
    with pytest.raises(PeerError):
        CdrReader(data).message("tf2_msgs/TFMessage")


@pytest.mark.oracle
def test_hashes_of_messages_are_those_of_rosbags(stores):
    """rosbags has another number for `char`, see the next test."""
    store, compared = stores[RosVersion.ROS2], 0
    for kind in (*KINDS, *INTERFACES, *ALSO_TAKEN):
        text = RosVersion.ROS2.text(kind)
        if "char" not in text:
            assert message_hash(kind) == store.hash_rihs01(full_name(RosVersion.ROS2, kind)), kind
            compared += 1
    assert compared > 60


@pytest.mark.parametrize(
    ("kind", "known"),
    [
        # In C that rosidl_generator_c wrote for these packages.
        ("std_srvs/srv/Empty", "5888399dedec5ccc85ea6451949fd2c9f97bfdf963f9a588821639fcd31b5d19"),
        (
            "simulation_interfaces/srv/SpawnEntity",
            "66860313e11009faddbfc8568e5d410d1a11607fe75eeb1308671dc0406fe3a7",
        ),
        (
            "simulation_interfaces/srv/ResetSimulation",
            "4ce285d7ff9b8ac70dcc95161f32bf54c05a6f4b13427990e41ab40c36c39646",
        ),
        ("service_msgs/ServiceEventInfo", "41bcbbe07a75c9b52bc96bfd5c24d7f0fc0a08c0cb7921b3373c5732345a6f45"),
    ],
)
def test_hashes_are_those_of_rosidl(kind, known):
    found = service_hash(kind) if "/srv/" in kind else message_hash(kind)
    assert found == f"RIHS01_{known}"
