"""A program beside the server: a Zenoh session of its own, without any code of usarmjx.

Messages are written and read by rosbags; for the test in `test_processes`. It prints one JSON object about
what it has found.
"""

import json
import struct
import sys
import threading
import time

import zenoh
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from zenoh.ext import HistoryConfig, declare_advanced_subscriber

PATIENCE = 60.0  # s
EMPTY = "RIHS01_5888399dedec5ccc85ea6451949fd2c9f97bfdf963f9a588821639fcd31b5d19"
SPAWN = "RIHS01_66860313e11009faddbfc8568e5d410d1a11607fe75eeb1308671dc0406fe3a7"
"""Hashes of services as rosidl has published them, in code that it generated."""
REQUEST = """string name
bool allow_renaming
string uri
string resource_string
string entity_namespace
geometry_msgs/PoseStamped initial_pose
"""
RESPONSE = "uint8 result\nstring error_message\nstring entity_name\n"
GID = bytes(range(16))


class Topic:
    """The messages of a topic."""

    def __init__(self, session, types, name, kind, latched=False):
        self._types, self._kind, self.received = types, kind, []
        self._came = threading.Event()
        package, name_of_type = kind.split("/msg/")
        key = f"5/{name}/{package}::msg::dds_::{name_of_type}_/{types.hash_rihs01(kind)}"
        if latched:
            self._subscriber = declare_advanced_subscriber(
                session, key, self._take, history=HistoryConfig(detect_late_publishers=True)
            )
        else:
            self._subscriber = session.declare_subscriber(key, self._take)

    def _take(self, sample):
        message = self._types.deserialize_cdr(sample.payload.to_bytes(), self._kind)
        self.received.append((message, sample.attachment.to_bytes()))
        self._came.set()

    def next(self, accepts=lambda message: True):
        until = time.monotonic() + PATIENCE
        while time.monotonic() < until:
            self._came.wait(0.1)
            self._came.clear()
            for message, attached in list(self.received):
                if accepts(message):
                    return message, attached
        raise AssertionError("nothing comes")


def main(endpoint):
    config = zenoh.Config()
    for key, value in (
        ("mode", "peer"),
        ("connect/endpoints", [endpoint]),
        ("listen/endpoints", []),
        ("scouting/multicast/enabled", False),
    ):
        config.insert_json5(key, json.dumps(value))
    types = get_typestore(Stores.ROS2_KILTED)
    types.register(get_types_from_msg(REQUEST, "own/msg/SpawnRequest"))
    types.register(get_types_from_msg(RESPONSE, "own/msg/SpawnResponse"))
    made = types.types
    with zenoh.open(config) as session:
        point = made["geometry_msgs/msg/Point"](0.0, 0.0, 0.0)
        turned = made["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
        stamp = made["builtin_interfaces/msg/Time"](0, 0)
        header = made["std_msgs/msg/Header"](stamp, "")
        pose = made["geometry_msgs/msg/PoseStamped"](header, made["geometry_msgs/msg/Pose"](point, turned))
        request = made["own/msg/SpawnRequest"]("R1", False, "P2AT", "", "", pose)
        replies = session.get(
            f"5/spawn_entity/simulation_interfaces::srv::dds_::SpawnEntity_/{SPAWN}",
            payload=bytes(types.serialize_cdr(request, "own/msg/SpawnRequest")),
            attachment=struct.pack("<qqB", 9, time.time_ns(), 16) + GID,
            target=zenoh.QueryTarget.ALL_COMPLETE,
            timeout=PATIENCE,
        )
        reply = next(iter(replies)).ok
        response = types.deserialize_cdr(reply.payload.to_bytes(), "own/msg/SpawnResponse")
        answered = reply.attachment.to_bytes()
        clock, attached = Topic(session, types, "clock", "rosgraph_msgs/msg/Clock").next()
        urdf, _ = Topic(session, types, "R1/robot_description", "std_msgs/msg/String", latched=True).next()
        odom = Topic(session, types, "R1/odom", "nav_msgs/msg/Odometry")
        odom.next()
        vector, twist = made["geometry_msgs/msg/Vector3"], made["geometry_msgs/msg/Twist"]
        ahead = twist(vector(0.3, 0.0, 0.0), vector(0.0, 0.0, 0.0))
        hash_of_twist = types.hash_rihs01("geometry_msgs/msg/Twist")
        session.put(
            f"5/R1/cmd_vel/geometry_msgs::msg::dds_::Twist_/{hash_of_twist}",
            bytes(types.serialize_cdr(ahead, "geometry_msgs/msg/Twist")),
            attachment=struct.pack("<qqB", 1, time.time_ns(), 16) + GID,
        )
        last, _ = odom.next(lambda message: message.twist.twist.linear.x > 0.1)
        tokens = [str(one.ok.key_expr) for one in session.liveliness().get("@ros2_lv/5/**")]
        found = {
            "reply": [response.result, response.entity_name, response.error_message],
            "answered": [struct.unpack_from("<q", answered)[0], answered[-16:] == GID, len(answered)],
            "clock": [clock.clock.sec + clock.clock.nanosec * 1e-9, len(attached), attached[16]],
            "urdf": urdf.data[:60],
            "odom": last.twist.twist.linear.x,
            "tokens": sorted(tokens),
        }
    print(json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1])
