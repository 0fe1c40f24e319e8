"""A ROS 2 node that hands topics of `usarmjx serve --rosbridge-port` on to ROS 2, and commands back.

It needs rclpy and `pip install websockets cbor2`. Messages come as ROS 2's own bytes (`cbor-raw`) and are
published as they are. It has not been run with ROS 2, which was not there where it was written, only with
classes of our own in rclpy's place; bytes and fields of the messages were compared with those of Jazzy.

    python3 usarmjx_relay.py --ros-args -p url:=ws://127.0.0.1:9090 -p robot:=P2AT -p name:=R1
"""
# pyright: reportMissingImports=false

import json
import threading
from collections.abc import Callable
from typing import Any

import cbor2
import rclpy
from geometry_msgs.msg import Twist
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosidl_runtime_py.utilities import get_message
from trajectory_msgs.msg import JointTrajectory
from websockets.sync.client import connect

LATCHED = ("/map", "/tf_static", "/robot_description")
"""Ends of topics whose last message goes to late subscribers, too."""


def twist_fields(twist: Twist) -> dict[str, Any]:
    """Return a Twist as JSON."""
    parts = {"linear": twist.linear, "angular": twist.angular}
    return {name: {axis: getattr(part, axis) for axis in "xyz"} for name, part in parts.items()}


def trajectory_fields(trajectory: JointTrajectory) -> dict[str, Any]:
    """Return a JointTrajectory as JSON: positions, velocities and times of its points."""
    points = [
        {
            "positions": list(point.positions),
            "velocities": list(point.velocities),
            "time_from_start": {"sec": point.time_from_start.sec, "nanosec": point.time_from_start.nanosec},
        }
        for point in trajectory.points
    ]
    return {"joint_names": list(trajectory.joint_names), "points": points}


COMMANDS = {
    "geometry_msgs/msg/Twist": (Twist, twist_fields),
    "trajectory_msgs/msg/JointTrajectory": (JointTrajectory, trajectory_fields),
}
"""Types of the topics that the server listens to and does not publish."""


class Relay(Node):
    """The node: parameters `url`, `robot` (a class; empty: none appears), `name`, and `skip` (topics)."""

    def __init__(self) -> None:
        super().__init__("usarmjx_relay")
        for key, default in (("url", "ws://127.0.0.1:9090"), ("robot", "P2AT"), ("name", "R1")):
            self.declare_parameter(key, default)
        self.declare_parameter("skip", [""])
        self.socket = connect(self.text("url"), max_size=None)
        self.topics: dict[str, Any] = {}
        if self.text("robot"):
            self.call("/simulator/spawn", {"class": self.text("robot"), "name": self.text("name")})
        listed = self.call("/rosapi/topics", {})
        for topic, kind in zip(listed["topics"], listed["types"], strict=True):
            if kind in COMMANDS:
                self.listen(topic, *COMMANDS[kind])
            elif topic not in self.get_parameter("skip").value:
                self.relay(topic, kind)
        threading.Thread(target=self.run, daemon=True).start()

    def text(self, key: str) -> str:
        """Return a parameter."""
        return self.get_parameter(key).get_parameter_value().string_value

    def say(self, op: str, **more: Any) -> None:
        """Send a message."""
        self.socket.send(json.dumps({"op": op, **more}))

    def call(self, service: str, args: dict[str, Any]) -> dict[str, Any]:
        """Return what a service answers.

        Raises:
            RuntimeError: It failed.
        """
        self.say("call_service", service=service, args=args)
        while True:
            answer = json.loads(self.socket.recv())
            if answer["op"] == "service_response":
                if not answer["result"]:
                    raise RuntimeError(f"{service}: {answer['values']}")
                return answer["values"]

    def listen(self, topic: str, kind: type, fields: Callable[[Any], dict[str, Any]]) -> None:
        """Hand commands of ROS on to a robot."""
        self.create_subscription(
            kind, topic, lambda command: self.say("publish", topic=topic, msg=fields(command)), 10
        )

    def relay(self, topic: str, kind: str) -> None:
        """Hand on a topic."""
        lasting = DurabilityPolicy.TRANSIENT_LOCAL if topic.endswith(LATCHED) else DurabilityPolicy.VOLATILE
        profile = QoSProfile(depth=10, durability=lasting)
        profile = QoSProfile(depth=10, durability=lasting)
        self.topics[topic] = self.create_publisher(get_message(kind), topic, profile)
        self.say("subscribe", topic=topic, type=kind, queue_length=10, compression="cbor-raw")

    def run(self) -> None:
        """Hand on what comes, until the server closes the connection."""
        for frame in self.socket:
            said = cbor2.loads(frame) if isinstance(frame, bytes) else json.loads(frame)
            if said["op"] == "publish":
                self.topics[said["topic"]].publish(said["msg"]["bytes"])
            elif said["op"] == "status":
                self.get_logger().warning(said["msg"])


def main() -> None:
    """Run the node."""
    rclpy.init()
    rclpy.spin(Relay())


if __name__ == "__main__":
    main()
