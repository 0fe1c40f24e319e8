"""The ROS 2 relay, with classes of our own in rclpy's place, at a served world."""

import importlib.util
import struct
import sys
import threading
import time
from types import MappingProxyType, ModuleType, SimpleNamespace

import pytest

import dev
from tests.arenas import FLAT
from tests.server.peers import PATIENCE, looping
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.gamebots.settings import BotServerSettings
from usarmjx.server.rosbridge.definitions import RosVersion
from usarmjx.server.rosbridge.net import RosbridgeServer, RosSettings
from usarmjx.server.worlds.dynamic_world import DynamicWorld

FORMATS = {"bool": "?", "int8": "b", "uint8": "B", "uint16": "H", "int32": "i", "uint32": "I"}
FORMATS |= {"float32": "f", "float64": "d"}
FILE = dev.ROOT / "examples" / "ros2" / "usarmjx_relay.py"


class FakeNode:
    """What the relay asks of rclpy's Node, as rclpy.node describes it."""

    given = MappingProxyType({})

    def __init__(self, name):
        self.name, self.values = name, {}
        self.publishers, self.callbacks, self.heard = {}, {}, {}
        self.all_there = threading.Event()

    def declare_parameter(self, name, value):
        self.values[name] = self.given.get(name, value)

    def get_parameter(self, name):
        value = self.values[name]
        return SimpleNamespace(value=value, get_parameter_value=lambda: SimpleNamespace(string_value=value))

    def create_publisher(self, kind, topic, profile):
        self.publishers[topic] = kind, profile

        def publish(message):
            assert type(message) is bytes, "rclpy takes a message of the topic's class, or bytes"
            self.heard.setdefault(topic, message)
            if self.heard.keys() == self.publishers.keys():
                self.all_there.set()

        return SimpleNamespace(publish=publish)

    def create_subscription(self, kind, topic, callback, depth):
        self.callbacks[topic] = kind, callback

    def get_logger(self):
        return SimpleNamespace(warning=lambda text: self.heard.setdefault("warning", text))


class Twist:
    """A geometry_msgs Twist."""

    def __init__(self, ahead=0.0):
        self.linear, self.angular = (SimpleNamespace(x=x, y=0.0, z=0.0) for x in (ahead, 0.0))


class JointTrajectory:
    """A trajectory_msgs JointTrajectory that ends after 0.2 s."""

    def __init__(self, **positions):
        after = SimpleNamespace(sec=0, nanosec=200_000_000)
        self.joint_names = [*positions]
        self.points = [SimpleNamespace(positions=[*positions.values()], velocities=[], time_from_start=after)]


@pytest.fixture
def relay(monkeypatch):
    """The example's module."""

    def fake(name, **has):
        module = ModuleType(name)
        vars(module).update(has)
        monkeypatch.setitem(sys.modules, name, module)

    qos = {"DurabilityPolicy": SimpleNamespace(TRANSIENT_LOCAL="lasting", VOLATILE="passing")}
    fake("rclpy", init=None, spin=None)
    fake("rclpy.node", Node=FakeNode)
    fake("rclpy.qos", QoSProfile=lambda depth, durability: durability, **qos)
    fake("geometry_msgs")
    fake("geometry_msgs.msg", Twist=Twist)
    fake("trajectory_msgs")
    fake("trajectory_msgs.msg", JointTrajectory=JointTrajectory)
    fake("rosidl_runtime_py")
    fake("rosidl_runtime_py.utilities", get_message=lambda name: name)
    found = importlib.util.spec_from_file_location("usarmjx_relay", FILE)
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module


def test_the_relay_hands_on_all_topics_and_drives(relay, monkeypatch):
    world = DynamicWorld(FLAT)
    service = RosbridgeServer(world, RosSettings(port=0, size=(32, 24)))
    server = service.server = BotServer(world, BotServerSettings(port=0), [service])
    with looping([server], 1.0):
        given = {"url": f"ws://127.0.0.1:{service.port}", "skip": ["/map"]}
        monkeypatch.setattr(FakeNode, "given", given)
        node = relay.Relay()
        assert node.all_there.wait(PATIENCE), node.publishers.keys() - node.heard.keys()
        (kind, drive), (robot,) = node.callbacks["/R1/cmd_vel"], world.robots.values()
        assert kind is Twist
        assert {"/tf", "/R1/odom", "/R1/Scanner1", "/R1/Camera/image_raw"} <= node.heard.keys()
        assert "/map" not in node.publishers
        began = world.state(robot).pos[0]
        drive(Twist(0.5))
        deadline = time.monotonic() + PATIENCE
        while world.state(robot).pos[0] < began + 0.1 and time.monotonic() < deadline:
            time.sleep(0.05)
        assert world.state(robot).pos[0] >= began + 0.1
        (kind, move), link = node.callbacks["/R1/joint_trajectory"], "CameraPanTilt_Link1"
        assert kind is JointTrajectory
        assert "/R1/joint_trajectory" not in node.publishers, "the server never publishes it"
        place = robot.plan.joint_index(link)
        move(JointTrajectory(**{link: 0.5}))
        while abs(robot.command.target[place] - 0.5) > 1e-3 and time.monotonic() < deadline:
            time.sleep(0.05)
        assert robot.command.target[place] == pytest.approx(0.5, abs=1e-3)
        node.socket.close()
    assert "warning" not in node.heard
    assert node.publishers["/tf_static"] == ("tf2_msgs/msg/TFMessage", "lasting")
    assert node.publishers["/R1/robot_description"] == ("std_msgs/msg/String", "lasting")
    assert node.publishers["/clock"] == ("rosgraph_msgs/msg/Clock", "passing")
    for topic, (kind, _) in node.publishers.items():
        assert read(kind.replace("/msg/", "/"), Bytes(node.heard[topic])) is not None, topic
    odom = read("nav_msgs/Odometry", Bytes(node.heard["/R1/odom"]))
    assert (odom["header"]["frame_id"], odom["child_frame_id"]) == ("R1/odom", "R1/base_link")
    image = read("sensor_msgs/Image", Bytes(node.heard["/R1/Camera/image_raw"]))
    assert (image["width"], image["height"], len(image["data"])) == (32, 24, 32 * 24 * 3)


class Bytes:
    """CDR, read as its standard has it."""

    def __init__(self, data):
        assert data[:4] == b"\0\1\0\0"
        self.data, self.at = data[4:], 0

    def number(self, kind):
        one = struct.Struct(f"<{FORMATS[kind]}")
        self.at += -self.at % one.size
        (value,) = one.unpack_from(self.data, self.at)
        self.at += one.size
        return value

    def value(self, kind):
        base, _, length = kind.partition("[")
        if length:
            count = self.number("uint32") if length == "]" else int(length[:-1])
            return [self.value(base) for _ in range(count)]
        if base == "string":
            size = self.number("uint32")
            self.at += size
            assert self.data[self.at - 1] == 0
            return self.data[self.at - size : self.at - 1].decode()
        if base in FORMATS:
            return self.number(base)
        return {name: self.value(its) for name, its in RosVersion.ROS2.fields(base).items()}


def read(kind, data):
    """A message, of which nothing may be left over."""
    message = data.value(kind)
    assert data.at == len(data.data)
    return message
