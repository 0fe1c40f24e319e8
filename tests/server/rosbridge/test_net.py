"""Robots by rosbridge: over real websockets, with messages held against their definitions."""

import base64
import contextlib
import io
import json
import math
import re
import socket
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from cbor2 import loads
from PIL import Image
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from tests.arenas import COURSE, FLAT
from tests.server.lockstep import LOCKSTEP, waiting
from tests.server.peers import PATIENCE, Peer, looping, wait_until
from usarmjx.base.rotations import mat_from_quat
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.robot import Mount
from usarmjx.sensors.cameras.mounts import cameras_of
from usarmjx.sensors.suite import suite_of
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.gamebots.settings import BotServerSettings
from usarmjx.server.network.access import AccessRules
from usarmjx.server.rosbridge.definitions import RosVersion
from usarmjx.server.rosbridge.net import RosbridgeServer, RosSettings
from usarmjx.server.rosbridge.topics import WorldTopics, sensor_topics
from usarmjx.server.worlds.batch_world import BatchWorld
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import RosterEntry, build_scene

NUMBERS = {
    **dict.fromkeys(("float32", "float64"), (float, int, type(None))),
    **dict.fromkeys(("int8", "int32", "uint8", "uint16", "uint32"), (int,)),
    "string": (str,),
    "bool": (bool,),
}


def check(version, kind, value, where=""):
    """Hold a value against the definition of its type: exactly these fields, of these types."""
    base, _, length = kind.partition("[")
    if kind == "uint8[]":
        assert base64.b64decode(value, validate=True), where
    elif length:
        assert isinstance(value, list), where
        assert length == "]" or len(value) == int(length[:-1]), where
        for one in value[:300]:
            check(version, base, one, where)
    elif base in NUMBERS:
        assert type(value) in NUMBERS[base], (where, value)
    else:
        fields = version.fields(base)
        assert sorted(value) == sorted(fields), where
        for name, its in fields.items():
            check(version, its, value[name], f"{where}.{name}")


class Ros:
    """A client."""

    def __init__(self, port, **how):
        # Without pings: a world that compiles for longer than their timeout answers none.
        how = {"max_size": None, "open_timeout": PATIENCE, "ping_interval": None} | how
        self.socket = connect(f"ws://127.0.0.1:{port}", **how)

    def say(self, op, **more):
        self.socket.send(json.dumps({"op": op, **more}))

    def hear(self, op, **fields):
        """The next message of that op."""
        while True:
            # Its library reads the socket in a thread of its own.
            with waiting():
                message = json.loads(self.socket.recv(PATIENCE))
            if message["op"] == op and all(message.get(key) == value for key, value in fields.items()):
                return message

    def call(self, service, **args):
        self.say("call_service", service=service, args=args, id=service)
        return self.hear("service_response", id=service)

    def topic(self, name, **more):
        """The next message of a topic."""
        self.say("subscribe", topic=name, id="once", **more)
        message = self.hear("publish", topic=name)["msg"]
        self.say("unsubscribe", topic=name, id="once")
        return message


@contextlib.contextmanager
def serving_ros(world, realtime_factor=LOCKSTEP, **settings):
    """A running server's rosbridge port, and the server; not in lockstep for clients in other processes."""
    service = RosbridgeServer(world, RosSettings(port=0, size=(32, 24), **settings))
    server = service.server = BotServer(world, BotServerSettings(port=0), [service])
    with looping([server], realtime_factor):
        yield service.port, server


@pytest.fixture(scope="module")
def served():
    with serving_ros(DynamicWorld(COURSE)) as found:
        yield found


@pytest.fixture
def ros(served):
    client = Ros(served[0])
    yield client
    client.socket.close()
    wait_until(lambda: not served[1].world.robots)  # the next test has the world for itself
    assert served[1].world.robots == {}


def spawn(ros, kind="P2AT", name="R1", x=0.0, y=0.0, **more):
    pose = {"position": {"x": x, "y": y, "z": 0.4}, "orientation": {"w": 1.0}}
    return ros.call("/simulator/spawn", **{"class": kind, "name": name, "pose": pose, **more})


def test_every_topic_has_messages_as_they_are_defined(ros):
    assert spawn(ros)["values"] == {"name": "R1"}
    listed = ros.call("/rosapi/topics_and_raw_types")["values"]
    received = dict(zip(listed["topics"], listed["types"], strict=True))
    own = {"/R1/odom", "/R1/cmd_vel", "/R1/joint_states"}
    assert {"/clock", "/tf", "/tf_static", "/map"} | own <= set(received)
    assert received["/R1/Scanner1"] == "sensor_msgs/msg/LaserScan"
    kinds = set()
    for topic, name in received.items():
        kind = name.replace("/msg/", "/")
        if topic.endswith(("cmd_vel", "joint_trajectory")) or (kind == "sensor_msgs/Range" and kind in kinds):
            continue
        kinds.add(kind)
        check(RosVersion.ROS2, kind, ros.topic(topic, type=name), topic)
    assert len(kinds) == 13
    texts = dict(zip(listed["types"], listed["typedefs_full_text"], strict=True))
    assert "MSG: geometry_msgs/msg/Quaternion\nfloat64 x\n" in texts["nav_msgs/msg/Odometry"]


def test_pictures_come_raw_and_with_what_they_are_of(ros):
    spawn(ros)
    ros.say("subscribe", topic="/R1/odom")
    for _ in range(15):
        ros.hear("publish", topic="/R1/odom")  # it stands on the floor
    ros.say("unsubscribe", topic="/R1/odom")
    raw = ros.topic("/R1/Camera/image_raw")
    assert (raw["width"], raw["height"], raw["step"], raw["encoding"]) == (32, 24, 96, "rgb8")
    pixels = np.frombuffer(base64.b64decode(raw["data"]), np.uint8).reshape(24, 32, 3)
    assert pixels.std() > 5.0
    packed = ros.topic("/R1/Camera/compressed")
    jpeg = np.asarray(Image.open(io.BytesIO(base64.b64decode(packed["data"]))), float)
    assert np.abs(jpeg - pixels).mean() < 12.0  # the same picture, but for what JPEG loses
    info = ros.topic("/R1/Camera/camera_info")
    fov = cameras_of(ROBOTS.get("P2AT"))[0].default_fov
    assert info["k"][0] == pytest.approx(16 / math.tan(fov / 2))
    assert (info["k"][2], info["k"][5], info["width"], info["height"]) == (15.5, 11.5, 32, 24)
    received = ros.topic("/tf_static")["transforms"] + ros.topic("/tf")["transforms"]
    frames = {one["child_frame_id"]: one for one in received}
    assert raw["header"]["frame_id"] == info["header"]["frame_id"] == packed["header"]["frame_id"]
    picture, camera = (axes_of(frames[name]) for name in (raw["header"]["frame_id"], "R1/Camera"))
    assert picture == pytest.approx(np.stack((-camera[1], -camera[2], camera[0])), abs=1e-6)


def axes_of(transform):
    """The x, y and z axis of a frame in its parent's (3, 3)."""
    turned = transform["transform"]["rotation"]
    return np.asarray(mat_from_quat(np.array([turned[axis] for axis in "wxyz"]))).T


def test_cbor_says_what_json_does(ros):
    spawn(ros)
    plain = ros.topic("/map")
    ros.say("subscribe", topic="/map", id="other", compression="cbor")
    received = loads(ros.socket.recv(PATIENCE))
    assert (received["op"], received["topic"]) == ("publish", "/map")
    assert np.frombuffer(received["msg"].pop("data").value, np.int8).tolist() == plain.pop("data")
    assert received["msg"] == plain
    ros.say("unsubscribe", topic="/map")
    ros.say("subscribe", topic="/R1/Camera/image_raw", compression="cbor-raw")
    raw = loads(ros.socket.recv(PATIENCE))["msg"]["bytes"]
    assert raw.startswith(b"\0\1\0\0")
    assert len(raw) > 32 * 24 * 3


def test_ros_1_has_its_own_times_and_headers():
    with serving_ros(DynamicWorld(FLAT), version=RosVersion.ROS1) as (port, _):
        ros = Ros(port)
        spawn(ros)
        assert "nav_msgs/Odometry" in ros.call("/rosapi/topics")["values"]["types"]
        check(RosVersion.ROS1, "rosgraph_msgs/Clock", ros.topic("/clock"))
        check(RosVersion.ROS1, "nav_msgs/Odometry", ros.topic("/R1/odom", type="nav_msgs/Odometry"))
        check(RosVersion.ROS1, "sensor_msgs/Range", ros.topic("/R1/F1"))
        check(RosVersion.ROS2, "nav_msgs/Odometry", ros.topic("/R1/odom", type="nav_msgs/msg/Odometry"))
        ros.socket.close()


def test_a_fix_and_an_imu_are_as_they_are_defined():
    """No robot of the manual has an IMU; both are made of readings here."""
    robot = ROBOTS.get("P2AT")
    mounts = [Mount(kind=kind, name=f"My {kind}") for kind in ("IMU", "GPS")]
    suite = suite_of(replace(robot, name="Other", sensors=tuple(mounts)))
    values = {"IMU": np.arange(6.0), "GPS": np.array([10.0, -20.0, 8.0])}
    made = {}
    for sensor in suite.sensors:
        (topic,) = sensor_topics(sensor, (50.0, 8.0))
        for version in RosVersion:
            made[topic.type] = topic.make(version, 1.5, "R1", values[sensor.kind])
            check(version, topic.type, made[topic.type])
    assert made["sensor_msgs/Imu"]["header"]["frame_id"] == "R1/My_IMU"
    assert made["sensor_msgs/Imu"]["linear_acceleration"] == {"x": 3.0, "y": 4.0, "z": 5.0}
    fix = made["sensor_msgs/NavSatFix"]
    north, east = (fix["latitude"] - 50.0) * 111e3, (fix["longitude"] - 8.0) * 111e3
    assert north == pytest.approx(10.0, rel=0.02)
    assert east > 15.0  # y is to the left, so west


def test_odometry_is_where_the_wheels_have_the_robot_and_the_frames_where_the_world_has_it(ros, served):
    spawn(ros, x=1.0, y=-2.0)
    (robot,) = served[1].world.robots.values()
    ros.say("publish", topic="/R1/cmd_vel", msg={"linear": {"x": 0.2}, "angular": {"z": 0.4}})
    ros.say("subscribe", topic="/R1/odom")
    for _ in range(20):
        odom = ros.hear("publish", topic="/R1/odom")["msg"]
    assert odom["twist"]["twist"]["linear"]["x"] == pytest.approx(0.2, abs=0.03)
    assert odom["twist"]["twist"]["angular"]["z"] > 0.3
    ros.say("publish", topic="/R1/cmd_vel", msg={})
    for _ in range(25):
        odom = ros.hear("publish", topic="/R1/odom")["msg"]
    ros.say("unsubscribe", topic="/R1/odom")
    measured = ros.topic("/R1/Odometry")["pose"]["position"]
    where, turned = odom["pose"]["pose"]["position"], odom["pose"]["pose"]["orientation"]
    assert [where[axis] for axis in "xyz"] == pytest.approx([measured[axis] for axis in "xyz"], abs=2e-3)
    assert turned["z"] > 0.05  # it has turned to the left
    moved = {one["child_frame_id"]: one for one in ros.topic("/tf")["transforms"]}
    assert moved["R1/odom"]["header"]["frame_id"] == "map"
    assert moved["R1/base_link"]["header"]["frame_id"] == odom["header"]["frame_id"] == "R1/odom"
    state = served[1].world.state(robot)
    pos, mat = np.zeros(3), np.eye(3)
    for frame in ("R1/odom", "R1/base_link"):
        shift = moved[frame]["transform"]["translation"]
        pos, mat = pos + mat @ [shift[axis] for axis in "xyz"], mat @ axes_of(moved[frame]).T
    np.testing.assert_allclose(pos, state.pos, atol=2e-3)
    np.testing.assert_allclose(mat, np.asarray(mat_from_quat(state.quat)), atol=2e-3)


def test_a_scan_is_the_gamebots_scan_of_the_same_time(ros, served):
    guest = Peer(
        served[1].port, "INIT {ClassName USARBot.P2AT} {Name R1} {Location 0,0,-0.4} {Rotation 0,0,3}"
    )
    ros.say("subscribe", topic="/R1/Scanner1", type="sensor_msgs/msg/LaserScan")
    scans = {}
    for _ in range(6):
        scan = ros.hear("publish", topic="/R1/Scanner1")["msg"]
        stamp = scan["header"]["stamp"]
        scans[round(stamp["sec"] + stamp["nanosec"] * 1e-9, 2)] = scan
    same = []
    while not same:
        line = guest.until(b"SEN").decode()
        found = re.match(r"SEN {Time ([\d.]+)} {Type RangeScanner}.*{Range ([\d.,]+)}", line)
        same = [scans[float(found[1])]] if found and float(found[1]) in scans else []
    guest.close()
    wire, ranges = [float(one) for one in found[2].split(",")], same[0]["ranges"]
    # The wire's first beam is the rightmost one, and so is ROS's: its angles grow to the left.
    assert ranges == pytest.approx(wire, abs=1.01e-4)  # the wire cuts digits off
    assert same[0]["angle_min"] == pytest.approx(-math.pi / 2, abs=1e-3)
    assert same[0]["angle_max"] == pytest.approx(math.pi / 2, abs=0.02)
    assert min(ranges) < max(ranges)


def test_a_twist_drives_as_far_as_it_says(ros):
    spawn(ros, y=-2.0)

    def place():
        odom = ros.hear("publish", topic="/R1/odom")["msg"]
        stamp, where = odom["header"]["stamp"], odom["pose"]["pose"]["position"]
        return stamp["sec"] + stamp["nanosec"] * 1e-9, where["x"], where["y"]

    ros.say("subscribe", topic="/R1/odom")
    for _ in range(15):
        place()  # it stands on the floor
    ros.say("advertise", topic="/R1/cmd_vel", type="geometry_msgs/msg/Twist")
    ros.say("publish", topic="/R1/cmd_vel", msg={"linear": {"x": 0.3}})
    for _ in range(10):
        began = place()
    while (now := place())[0] < began[0] + 1.0 - 1e-6:
        pass
    span = now[0] - began[0]
    assert now[1] - began[1] == pytest.approx(0.3 * span, rel=0.05)
    assert abs(now[2] - began[2]) < 0.01


def test_robots_are_seen_from_both_sides_and_go_with_their_client(ros, served):
    spawn(ros, name="Here")
    guest = Peer(served[1].port, "INIT {ClassName USARBot.P2AT} {Name There-1} {Location 0,2,-0.4}")
    guest.until(b"STA")
    topics = ros.call("/rosapi/topics")["values"]["topics"]
    assert {"/Here/odom", "/There_1/odom"} <= set(topics)
    assert {robot.name for robot in served[1].world.robots.values()} == {"Here", "There-1"}
    assert ros.call("/simulator/remove", name="There-1")["result"] is False
    assert "already" in spawn(ros, name="Here")["values"]
    assert ros.call("/simulator/remove", name="Here")["result"] is True
    guest.close()


def test_a_map_is_kept_for_who_comes_later(ros):
    grid = ros.topic("/map")
    info = grid["info"]
    squares = np.array(grid["data"]).reshape(info["height"], info["width"])

    def at(x, y):
        low = info["origin"]["position"]
        return squares[int((y - low["y"]) / info["resolution"]), int((x - low["x"]) / info["resolution"])]

    assert (at(-2.0, 1.5), at(-2.0, -1.5)) == (100, 100)  # the wall
    assert (at(-2.0, 2.3), at(-1.5, 0.0), at(-0.6, 2.0)) == (0, 0, 0)  # beside it, and a low step
    assert ros.topic("/map") == grid


def test_pages_from_elsewhere_and_strangers_are_refused(served):
    with pytest.raises(InvalidStatus, match="403"):
        Ros(served[0], origin="http://evil.example")
    Ros(served[0], origin="http://localhost:8080").socket.close()
    with serving_ros(DynamicWorld(FLAT), access=AccessRules(token="open-sesame")) as (port, _):
        with pytest.raises(InvalidStatus, match="403"):
            Ros(port)
        ros = Ros(f"{port}/?token=open-sesame")
        assert ros.call("/rosapi/get_time")["result"] is True
        ros.socket.close()


def test_who_does_not_read_holds_up_nobody(ros, served):
    spawn(ros)
    with socket.create_connection(("127.0.0.1", served[0])) as slow:
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        upgrade = "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        key = "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
        slow.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n{upgrade}{key}\r\n".encode())
        for topic in ("/map", "/tf", "/R1/Scanner1", "/R1/odom"):
            text = json.dumps({"op": "subscribe", "topic": topic})
            slow.sendall(frame(text))
        times = [ros.topic("/clock")["clock"] for _ in range(20)]
        assert len({json.dumps(one) for one in times}) == 20


def frame(text):
    """A client's masked frame; the mask is 0."""
    data = text.encode()
    assert len(data) < 126
    return bytes([0x81, 0x80 | len(data), 0, 0, 0, 0]) + data


@pytest.mark.thorough
def test_a_world_of_a_batch_lends_its_parked_robots():
    scene = build_scene(FLAT, [RosterEntry(robot="P2DX", parked=True)])
    with serving_ros(BatchWorld(Batch(scene, 2, engine="c", seed=4), 1)) as (port, server):
        ros = Ros(port)
        spawn(ros, "P2DX")
        ros.say("publish", topic="/R1/cmd_vel", msg={"angular": {"z": 0.5}})
        ros.say("subscribe", topic="/R1/odom", type="nav_msgs/msg/Odometry")
        while ros.hear("publish", topic="/R1/odom")["msg"]["pose"]["pose"]["orientation"]["z"] < 0.1:
            pass
        assert "parked" in spawn(ros, "P2DX", name="R2")["values"]
        assert ros.call("/simulator/remove", name="R1")["result"] is True
        assert not server.world.robots
        ros.socket.close()


def test_a_map_is_told_anew_when_a_reset_brings_another_arena():
    world = SimpleNamespace(arena=FLAT, robots={}, present={}, time=0.0)
    topic = WorldTopics(world, (32, 24)).all()["/map"]
    before = topic.revision(), topic.make(RosVersion.ROS2)
    assert topic.revision() == before[0]
    world.arena = COURSE
    assert topic.revision() != before[0]
    assert topic.make(RosVersion.ROS2)["data"] != before[1]["data"]


def test_a_client_of_rosbridge_has_the_budget_of_one_at_the_port_for_robots(served, monkeypatch):
    """Of 0.12 s spent 0.05 s were saved up: it is not read until 0.07 s have grown back, at 5 %."""
    port, server = served
    client = Ros(port)
    try:
        readings = iter([0.0, 0.12])
        monkeypatch.setattr(server.budgets, "clock", lambda: next(readings, 0.12))
        client.call("/rosapi/topics")
        began = server.budgets.steps
        client.call("/rosapi/topics")
        assert 0.065 <= (server.budgets.steps - began) * server.budgets.growth <= 0.09
    finally:
        client.socket.close()


def call_spawn(ros, name):
    ros.say("call_service", service="/simulator/spawn", args={"class": "P2AT", "name": name}, id=name)


def make_steps(server, count=10):
    until = server.budgets.steps + count
    wait_until(lambda: server.budgets.steps > until)


def test_robots_of_rosbridge_come_and_go_within_the_share_for_joining(served):
    port, server = served
    client = Ros(port)
    server._joins.spend(1e6)
    call_spawn(client, "Late")
    make_steps(server)
    assert server.world.robots == {}
    server._joins.spend(-1e6)
    assert client.hear("service_response", id="Late")["result"] is True
    server._joins.spend(1e6)
    client.socket.close()
    make_steps(server)
    assert [robot.name for robot in server.world.robots.values()] == ["Late"]
    assert server.guests == []
    server._joins.spend(-1e6)
    wait_until(lambda: not server.world.robots)


def test_a_client_of_rosbridge_that_leaves_before_its_robot_comes_frees_its_seat(served):
    port, server = served
    (service,) = server.services
    client = Ros(port)
    server._joins.spend(1e6)
    try:
        call_spawn(client, "Gone")
        wait_until(server._joining.locked)
        client.socket.close()
        wait_until(lambda: not service._clients)
        assert not server._joining.locked()
    finally:
        server._joins.spend(-1e6)
    make_steps(server)
    assert server.world.robots == {}
