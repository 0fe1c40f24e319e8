"""A ROS 2 node that hands topics of `usarmjx serve --rosbridge-port` on to ROS 2, and `cmd_vel` back.

It needs rclpy and `pip install websockets`. It has not been run: there was no ROS 2 where it was written. It
is written against the interfaces of ROS 2 Jazzy: rclpy, rosidl_runtime_py, and the usual messages.

    python3 usarmjx_relay.py --ros-args -p url:=ws://127.0.0.1:9090 -p robot:=P2AT -p name:=R1
"""
# pyright: reportMissingImports=false

import base64
import json
import threading
from typing import Any

import rclpy
from geometry_msgs.msg import Twist
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosidl_runtime_py.set_message import set_message_fields
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
        kind_class = get_message(kind)
        profile = QoSProfile(depth=10, durability=lasting)
        self.topics[topic] = kind_class, self.create_publisher(kind_class, topic, profile)
        self.say("subscribe", topic=topic, type=kind, queue_length=10)

    def run(self) -> None:
        """Hand on what comes, until the server closes the connection."""
        for text in self.socket:
            said = json.loads(text)
            if said["op"] == "status":
                self.get_logger().warning(said["msg"])
            if said["op"] != "publish":
                continue
            kind_class, publisher = self.topics[said["topic"]]
            fields, message = said["msg"], kind_class()
            if "altitude" in fields and fields["altitude"] is None:
                fields["altitude"] = float("nan")
            if isinstance(fields.get("data"), str):
                message.data = base64.b64decode(fields.pop("data"))
            if not hasattr(message, "variance"):
                fields.pop("variance", None)  # older Range has none
            set_message_fields(message, fields)
            publisher.publish(message)


def main() -> None:
    """Run the node."""
    rclpy.init()
    rclpy.spin(Relay())


if __name__ == "__main__":
    main()
