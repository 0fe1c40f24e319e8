"""The node of ROS 2 with a transport that keeps what it is given: topics, commands, services, parameters."""

import asyncio
import contextlib
import math

import numpy as np
import pytest

from tests.arenas import FLAT
from usarmjx.base.errors import UsageError
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.robots import ROBOTS
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.gamebots.settings import BotServerSettings
from usarmjx.server.ros2.server import Ros2Server, Ros2Settings
from usarmjx.server.ros2.worker import MOST_JOBS, TransportWorker
from usarmjx.server.rosbridge.definitions import RosVersion
from usarmjx.server.rosbridge.encodings import CdrReader, MessageBytes
from usarmjx.server.rosbridge.motion import TrajectoryRun, read_trajectory
from usarmjx.server.worlds.dynamic_world import DynamicWorld

BYTES = MessageBytes(RosVersion.ROS2)
TURNS = 2000  # of the event loop, 1 ms each: the worker is another thread


class KeptTopic:
    def __init__(self, qos, closed):
        self.qos, self.sent, self.close = qos, [], closed

    def write(self, data):
        self.sent.append(data)
        return True

    def has_readers(self):
        return True


class Gone:
    def __init__(self, close):
        self.close = close


class KeepingTransport:
    """Keeps publishers, and calls services as a middleware would."""

    def __init__(self):
        self.topics, self.heard, self.services, self.announced = {}, {}, {}, 0

    def publisher(self, topic, kind, qos):
        self.topics[topic, kind] = made = KeptTopic(qos, lambda: self.topics.pop((topic, kind)))
        return made

    def subscription(self, topic, kind, qos, take):
        self.heard[topic, kind] = take
        return Gone(lambda: self.heard.pop((topic, kind)))

    def service(self, name, kind, take):
        self.services[name] = kind, take
        return Gone(lambda: self.services.pop(name))

    def announce(self):
        self.announced += 1

    def close(self):
        self.topics.clear()


class Node:
    """A node whose loop a test turns step by step."""

    def __init__(self, **settings):
        self.transport = KeepingTransport()
        # As over Zenoh, requests have no header here.
        self.world = DynamicWorld(FLAT)
        about = Ros2Settings(transport="zenoh", size=(32, 24), **settings)
        self.service = Ros2Server(self.world, about, lambda: self.transport)
        self.server = BotServer(self.world, BotServerSettings(port=0), [self.service])
        self.service.server = self.server

    async def until(self, found, steps=TURNS):
        """Return the first true result of `found`; the world steps meanwhile."""
        for _ in range(steps):
            self.server.tick()
            if result := found():
                return result
            await asyncio.sleep(0.001)
        raise AssertionError("nothing comes")

    async def call(self, service, /, **request):
        kind, take = await self.until(lambda: self.transport.services.get(service))
        replies = []
        take(BYTES.whole(f"{kind}_Request", request), replies.append)
        await self.until(lambda: replies)
        return CdrReader(replies[0]).message(f"{kind}_Response")

    async def spawn(self, name="R1", kind="P2AT", frame="", x=0.0, **more):
        stamp = {"sec": 0, "nanosec": 0}
        turned = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
        pose = {"position": {"x": x, "y": 0.0, "z": 0.4}, "orientation": turned}
        if not frame:
            pose["position"]["z"] = 0.0
        asked = {
            "name": name,
            "allow_renaming": False,
            "entity_resource": {"uri": kind, "resource_string": ""},
            "entity_namespace": "",
            "initial_pose": {"header": {"stamp": stamp, "frame_id": frame}, "pose": pose},
        }
        return await self.call("/spawn_entity", **{**asked, **more})

    async def message(self, topic, kind, part=""):
        """The next message of a topic; of a latched one the first whose `part` is not empty."""
        kept = await self.until(lambda: self.transport.topics.get((topic, kind)))
        before = 0 if kept.qos.is_latched else len(kept.sent)

        def found():
            # The worker's thread may still be behind the world: an older message comes first.
            for data in kept.sent[before:]:
                message = CdrReader(data).message(kind)
                if not part or message[part]:
                    return message
            return None

        return await self.until(found)

    def hear(self, topic, kind, message):
        self.transport.heard[topic, kind](BYTES.whole(kind, message))


def run(test, **settings):
    async def main():
        node = Node(**settings)
        await node.service.start()
        try:
            await test(node)
        finally:
            node.service.stop()

    asyncio.run(main())


def twist(x):
    still = {"x": 0.0, "y": 0.0, "z": 0.0}
    return {"linear": {**still, "x": x}, "angular": still}


def test_robots_come_drive_move_joints_and_go():
    async def story(node):
        answer = await node.spawn(frame="map", x=1.0)
        assert answer == {"result": {"result": 1, "error_message": ""}, "entity_name": "R1"}
        odom = await node.message("/R1/odom", "nav_msgs/Odometry")
        assert odom["pose"]["pose"]["position"]["x"] == pytest.approx(0.0, abs=0.05), "where it starts"
        moved = await node.message("/tf", "tf2_msgs/TFMessage", "transforms")
        (drift,) = (one for one in moved["transforms"] if one["child_frame_id"] == "R1/odom")
        assert drift["header"]["frame_id"] == "map"
        assert drift["transform"]["translation"]["x"] == pytest.approx(1.0, abs=0.05)
        heard = node.transport.heard
        await node.until(lambda: ("/R1/joint_trajectory", "trajectory_msgs/JointTrajectory") in heard)
        (robot,) = node.world.robots.values()
        node.hear("/R1/cmd_vel", "geometry_msgs/Twist", twist(0.2))
        await node.until(lambda: robot.command.target[0] > 0.5)
        header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
        stamped = {"header": header, "twist": twist(0.0)}
        node.hear("/R1/cmd_vel", "geometry_msgs/TwistStamped", stamped)
        await node.until(lambda: robot.command.target[0] == 0.0)
        joint = robot.plan.parts[-1]
        point = {
            "positions": [0.3],
            "velocities": [],
            "accelerations": [],
            "effort": [],
            "time_from_start": {"sec": 0, "nanosec": 200_000_000},
        }
        path = {"header": header, "joint_names": [joint], "points": [point]}
        node.hear("/R1/joint_trajectory", "trajectory_msgs/JointTrajectory", path)
        targets = []
        await node.until(lambda: targets.append(float(robot.command.target[-1])) or targets[-1] >= 0.3 - 1e-6)
        assert len({target for target in targets if 0.01 < target < 0.29}) >= 5, "it moves gradually"
        battery = await node.message("/R1/battery_state", "sensor_msgs/BatteryState")
        assert battery["percentage"] == pytest.approx(1.0, abs=0.01)
        assert math.isnan(battery["voltage"])
        gone = await node.call("/delete_entity", entity="R1")
        assert gone["result"]["result"] == 1
        await node.until(lambda: not any(topic.startswith("/R1/") for topic, _ in node.transport.topics))
        assert not node.transport.heard
        assert (await node.call("/delete_entity", entity="R1"))["result"]["result"] == 2

    run(story)


def test_what_cannot_be_is_said():
    async def story(node):
        await node.spawn()
        for asked, said in (
            ({"name": "R1"}, "there is a robot R1 already"),
            ({"name": "R2", "kind": "Nothing"}, "unknown robot 'Nothing'"),
            ({"name": "R2", "frame": "R1/base_link"}, "initial_pose is in frame 'R1/base_link'"),
            ({"name": "R2", "entity_namespace": "/other"}, "entity_namespace is 'other'"),
        ):
            answer = await node.spawn(**asked)
            assert answer["result"]["result"] == 4
            assert said in answer["result"]["error_message"]
        renamed = await node.spawn(name="R1", allow_renaming=True)
        assert renamed["result"]["result"] == 1
        assert renamed["entity_name"] != "R1"
        assert len(node.world.robots) == 2
        assert (await node.call("/reset_simulation", scope=1))["result"]["result"] == 0
        assert (await node.call("/reset_simulation", scope=4))["result"]["result"] == 1
        assert not node.world.robots
        assert (await node.call("/reset", structure_needs_at_least_one_member=0)) == {
            "structure_needs_at_least_one_member": 0
        }
        node.transport.services["/reset"][1](b"nonsense", lambda data: None)
        await node.call("/reset_simulation", scope=2)

    run(story)


def test_parameters_are_read_set_and_described():
    async def story(node):
        await node.spawn()
        names = ["use_sim_time", "R1.robot_description", "infinite_ranges", "nothing"]
        values = (await node.call("/usarmjx/get_parameters", names=names))["values"]
        assert [one["type"] for one in values] == [1, 4, 1, 0]
        assert values[0]["bool_value"] is True
        assert values[1]["string_value"].startswith("<?xml")
        types = (await node.call("/usarmjx/get_parameter_types", names=names))["types"]
        assert types == bytes([1, 4, 1, 0])
        listed = await node.call("/usarmjx/list_parameters", prefixes=[], depth=0)
        assert set(listed["result"]["names"]) == {"arena", *names[:3]}
        assert listed["result"]["prefixes"] == ["R1"]
        below = await node.call("/usarmjx/list_parameters", prefixes=["R1"], depth=0)
        assert below["result"]["names"] == ["R1.robot_description"]
        shallow = await node.call("/usarmjx/list_parameters", prefixes=[], depth=1)
        assert "R1.robot_description" not in shallow["result"]["names"]
        described = (await node.call("/usarmjx/describe_parameters", names=names))["descriptors"]
        assert [one["read_only"] for one in described] == [True, True, False, False]

        def assignment(name, kind, **value):
            empty = values[3] | {"type": kind} | value
            return {"name": name, "value": empty}

        wishes = [
            assignment("infinite_ranges", 1, bool_value=True),
            assignment("infinite_ranges", 2, integer_value=1),
            assignment("use_sim_time", 1),
            assignment("nothing", 1),
        ]
        results = (await node.call("/usarmjx/set_parameters", parameters=wishes))["results"]
        assert [one["successful"] for one in results] == [True, False, False, False]
        assert [one["reason"] for one in results[1:3]] == [
            "infinite_ranges is a bool",
            "use_sim_time is read-only",
        ]
        scan = await node.message("/R1/scan", "sensor_msgs/LaserScan")
        assert math.inf in scan["ranges"], "FLAT has no walls"
        whole = await node.call("/usarmjx/set_parameters_atomically", parameters=wishes)
        assert whole["result"]["successful"] is False

    run(story)


def test_a_node_that_maps_may_have_the_map_and_its_frame_for_itself():
    async def story(node):
        await node.spawn()
        # Before the robot came, the frames were none.
        fixed = await node.message("/tf_static", "tf2_msgs/TFMessage", "transforms")
        moved = await node.message("/tf", "tf2_msgs/TFMessage", "transforms")
        both = fixed["transforms"] + moved["transforms"]
        parents = {one["header"]["frame_id"] for one in both}
        assert ("R1/odom", "R1/base_link") in [
            (one["header"]["frame_id"], one["child_frame_id"]) for one in both
        ]
        publishes = node.service._settings.publishes_map
        assert ("map" in parents) == publishes
        # The worker makes the publishers in the order of the topics, the map's before those of robots.
        await node.until(lambda: ("/R1/odom", "nav_msgs/Odometry") in node.transport.topics)
        assert (("/map", "nav_msgs/OccupancyGrid") in node.transport.topics) == publishes

    run(story, publishes_map=False)
    run(story)


def test_messages_that_nobody_takes_are_bounded_and_counted():
    worker = TransportWorker(KeepingTransport)  # which is not started
    from usarmjx.server.ros2.transport import SENSOR

    outlet = worker.advertise("/a", "std_msgs/String", SENSOR)
    for number in range(20):
        worker.send(outlet, {"data": str(number)})
    assert [one["data"] for one in outlet.waiting] == ["15", "16", "17", "18", "19"]
    assert worker.counts.dropped == 15
    for _ in range(MOST_JOBS):
        worker.advertise("/b", "std_msgs/String", SENSOR)
    assert worker.counts.dropped == 16


def test_a_transport_that_cannot_be_opened_is_said():
    def refuse():
        raise UsageError("no network")

    async def main():
        node = Node()
        node.service._worker = TransportWorker(refuse)
        with pytest.raises(UsageError, match="no network"):
            await node.service.start()
        node.service.stop()

    asyncio.run(main())


@pytest.mark.parametrize(
    ("settings", "said"),
    [({"domain": 233}, "domain is 233"), ({"transport": "carrier"}, "transport is 'carrier'")],
)
def test_settings_are_checked(settings, said):
    with pytest.raises(UsageError, match=said):
        Ros2Settings(**settings)


ARM = kinematic_tree_of(ROBOTS.get("P2AT"))
JOINT = ARM.parts[-1]


def trajectory(*points, names=(JOINT,)):
    return {
        "joint_names": list(names),
        "points": [
            {"positions": [position], "velocities": speeds, "time_from_start": {"sec": 0, "nanosec": nano}}
            for nano, position, speeds in points
        ],
    }


def test_a_trajectory_is_followed_along_lines_or_cubics():
    half, whole = 500_000_000, 999_999_999
    path = read_trajectory(trajectory((half, 1.0, []), (whole, 2.0, [])), ARM)
    line = TrajectoryRun(path, 10.0, np.array([0.0]))
    assert [line.at(time)[JOINT] for time in (9.0, 10.25, 10.5, 11.5)] == pytest.approx([0.0, 0.5, 1.0, 2.0])
    assert (line.is_over(10.9), line.is_over(11.1)) == (False, True)
    smooth = TrajectoryRun(read_trajectory(trajectory((half, 1.0, [0.0])), ARM), 0.0, np.array([0.0]))
    # The cubic that stands still at both ends: 3 s^2 - 2 s^3.
    assert [smooth.at(0.5 * s)[JOINT] for s in (0.25, 0.5, 0.75)] == pytest.approx(
        [3 * s**2 - 2 * s**3 for s in (0.25, 0.5, 0.75)]
    )


@pytest.mark.parametrize(
    ("message", "said"),
    [
        ("text", "has joint_names and points"),
        (trajectory((1, 0.0, []), names=("Nose",)), "has no joint 'Nose'"),
        (trajectory((1, 0.0, []), names=()), "is empty"),
        (trajectory((1, 0.0, []), names=(JOINT, JOINT)), "names a joint twice"),
        (trajectory((5, 0.0, []), (5, 1.0, [])), "must rise"),
        (trajectory((5, math.nan, [])), "are 1 finite numbers"),
        ({"joint_names": 3, "points": [{}]}, "is no list"),
        (trajectory((0.5, 0.0, [])), "whole numbers"),
    ],
)
def test_nonsense_is_no_trajectory(message, said):
    with pytest.raises(UsageError, match=said):
        read_trajectory(message, ARM)


def test_a_trajectory_without_points_stops_the_robot():
    assert read_trajectory({"joint_names": [], "points": []}, ARM) is None
    with contextlib.suppress(UsageError):
        read_trajectory({}, ARM)
