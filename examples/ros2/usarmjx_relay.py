"""A ROS 2 node that hands topics of `usarmjx serve --rosbridge-port` on to ROS 2, and `cmd_vel` back.

It needs rclpy and `pip install websockets cbor2`. Messages come as ROS 2's own bytes (`cbor-raw`) and are
published as they are. It has not been run with ROS 2, which was not there where it was written, only with
classes of our own in rclpy's place; bytes and fields of the messages were compared with those of Jazzy.

    python3 usarmjx_relay.py --ros-args -p url:=ws://127.0.0.1:9090 -p robot:=P2AT -p name:=R1
"""
# pyright: reportMissingImports=false

import json
import threading
from typing import Any

import cbor2
import rclpy
from geometry_msgs.msg import Twist
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosidl_runtime_py.utilities import get_message
from websockets.sync.client import connect

LATCHED = ("/map", "/tf_static")
"""Who comes later gets the last message of these."""


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
            if topic.endswith("/cmd_vel"):
                self.listen(topic)
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

    def listen(self, topic: str) -> None:
        """Hand on what ROS says on a robot's cmd_vel."""

        def drive(twist: Twist) -> None:
            linear, angular = (
                {axis: getattr(part, axis) for axis in "xyz"} for part in (twist.linear, twist.angular)
            )
            self.say("publish", topic=topic, msg={"linear": linear, "angular": angular})

        self.create_subscription(Twist, topic, drive, 10)

    def relay(self, topic: str, kind: str) -> None:
        """Hand on a topic."""
        lasting = DurabilityPolicy.TRANSIENT_LOCAL if topic in LATCHED else DurabilityPolicy.VOLATILE
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
