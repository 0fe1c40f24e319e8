"""Messages as they travel: against bytes of another implementation, and CBOR's own reader.

The bytes were made by rosbags 0.11.9 (Noetic, Jazzy), which agreed on all messages here.
"""

import base64
import hashlib
import io
import json

import numpy as np
import pytest
from cbor2 import CBORTag, loads
from PIL import Image

from usarmjx.server.rosbridge.definitions import RosVersion
from usarmjx.server.rosbridge.encodings import Compression, MessageBytes, as_json, fragments, publication

NONE_TURNED = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
HEADER = {1: "00000000010000000065cd1d0400000052312f61", 2: "00010000010000000065cd1d0500000052312f6100"}
ZERO = "0000000000000000"


def samples(version):
    header = version.header(1.5, "R1/a")
    moved = {"translation": {"x": 1.0, "y": 2.0, "z": 3.0}, "rotation": NONE_TURNED}
    angles = [
        "angle_min",
        "angle_max",
        "angle_increment",
        "time_increment",
        "scan_time",
        "range_min",
        "range_max",
    ]
    origin = {"position": {"x": 1.0, "y": 0.0, "z": 0.0}, "orientation": NONE_TURNED}
    return {
        "sensor_msgs/JointState": {
            "header": header,
            "name": ["a", "bcd"],
            "position": [1.0, 2.0],
            "velocity": [-0.5],
            "effort": [],
        },
        "sensor_msgs/NavSatFix": {
            "header": header,
            "status": {"status": -1, "service": 1},
            "latitude": 1.0,
            "longitude": 2.0,
            "altitude": None,
            "position_covariance": [0.0] * 8 + [4.0],
            "position_covariance_type": 1,
        },
        "sensor_msgs/Image": {
            "header": header,
            "height": 1,
            "width": 1,
            "encoding": "rgb8",
            "is_bigendian": 0,
            "step": 3,
            "data": b"\1\2\3",
        },
        "sensor_msgs/LaserScan": {
            "header": header,
            **dict.fromkeys(angles, 0.25),
            "ranges": [0.5],
            "intensities": [],
        },
        "nav_msgs/OccupancyGrid": {
            "header": header,
            "info": {
                "map_load_time": version.stamp(0.0),
                "resolution": 0.25,
                "width": 3,
                "height": 1,
                "origin": origin,
            },
            "data": [0, 100, -1],
        },
        "tf2_msgs/TFMessage": {
            "transforms": [{"header": header, "child_frame_id": "b", "transform": moved}] * 2
        },
    }


REST = {
    (1, "sensor_msgs/JointState"): "0200000001000000610300000062636402000000000000000000f03f"
    "000000000000004001000000000000000000e0bf00000000",
    (2, "sensor_msgs/JointState"): "000000020000000200000061000000040000006263640002000000"
    "00000000000000000000f03f00000000000000400100000000000000000000000000e0bf00000000",
    (1, "sensor_msgs/NavSatFix"): f"ff0100000000000000f03f0000000000000040000000000000f87f{ZERO * 8}"
    "000000000000104001",
    (2, "sensor_msgs/NavSatFix"): "ff010000000000000000000000f03f0000000000000040000000000000f87f"
    f"{ZERO * 8}000000000000104001",
    (1, "sensor_msgs/Image"): "01000000010000000400000072676238000300000003000000010203",
    (2, "sensor_msgs/Image"): "000000010000000100000005000000726762380000000003000000" + "03000000010203",
    (1, "sensor_msgs/LaserScan"): f"{'0000803e' * 7}010000000000003f00000000",
    (2, "sensor_msgs/LaserScan"): f"000000{'0000803e' * 7}010000000000003f00000000",
    (1, "nav_msgs/OccupancyGrid"): f"{ZERO}0000803e0300000001000000000000000000f03f{ZERO * 5}"
    "000000000000f03f030000000064ff",
    (2, "nav_msgs/OccupancyGrid"): f"000000{ZERO}0000803e0300000001000000000000000000f03f{ZERO * 5}"
    "000000000000f03f030000000064ff",
}


@pytest.mark.oracle
@pytest.mark.parametrize("version", RosVersion)
def test_bytes_are_those_of_another_implementation(version):
    made = {kind: MessageBytes(version).whole(kind, one).hex() for kind, one in samples(version).items()}
    frames = made.pop("tf2_msgs/TFMessage")
    assert made == {kind: HEADER[version] + rest for (one, kind), rest in REST.items() if one == version}
    if version == RosVersion.ROS2:
        assert hashlib.sha256(bytes.fromhex(frames)).hexdigest().startswith("f062e9b3c06ec2c0")


def test_cbor_has_numbers_in_a_row_as_bytes_with_a_tag():
    version = RosVersion.ROS2
    received = {kind: one for kind, one in samples(version).items() if kind.startswith("sensor")}
    heard = {
        kind: loads(publication("/t", kind, one, version, Compression.CBOR, 0.0))["msg"]
        for kind, one in received.items()
    }
    joints, fix = heard["sensor_msgs/JointState"], heard["sensor_msgs/NavSatFix"]
    assert joints["name"] == ["a", "bcd"]
    assert joints["position"] == CBORTag(86, np.array([1.0, 2.0], "<f8").tobytes())
    assert heard["sensor_msgs/LaserScan"]["ranges"] == CBORTag(85, np.array([0.5], "<f4").tobytes())
    assert heard["sensor_msgs/Image"]["data"] == b"\1\2\3"
    assert fix["altitude"] != fix["altitude"]  # not a number
    assert joints["header"] == {"stamp": {"sec": 1, "nanosec": 500_000_000}, "frame_id": "R1/a"}


def test_cbor_raw_is_ros_bytes_and_the_time():
    version, kind = RosVersion.ROS2, "sensor_msgs/Image"
    received = loads(publication("/t", kind, samples(version)[kind], version, Compression.CBOR_RAW, 2.25))
    raw = bytes.fromhex(HEADER[2] + REST[2, kind])
    assert received == {
        "op": "publish",
        "topic": "/t",
        "msg": {"secs": 2, "nsecs": 250_000_000, "bytes": raw},
    }


@pytest.mark.parametrize("length", [1, 3, 1000])
def test_png_is_the_json_as_pixels(length):
    said = {"data": "\u00e4" * length}
    outer = json.loads(publication("/t", "x", said, RosVersion.ROS2, Compression.PNG, 0.0))
    assert outer["op"] == "png"
    picture = Image.open(io.BytesIO(base64.b64decode(outer["data"])))
    assert json.loads(picture.tobytes()) == {"op": "publish", "topic": "/t", "msg": said}


def test_a_text_in_fragments_is_the_text_again():
    text = json.dumps({"text": "\u00e4" * 200})
    parts = [json.loads(one) for one in fragments(text, 100, "f")]
    assert [(one["op"], one["id"], one["num"], one["total"]) for one in parts] == [
        ("fragment", "f", number, len(parts)) for number in range(-(-len(text) // 100))
    ]
    assert "".join(one["data"] for one in parts) == text
    assert list(fragments(text, len(text), "f")) == [text]


def test_what_no_message_has_is_refused():
    with pytest.raises(TypeError, match="set is nothing"):
        as_json({"a": {1}})
    with pytest.raises(ValueError, match="not JSON compliant"):
        as_json({"a": float("inf")})
