"""Services that stock web clients of ROS call beside topics: rosapi, parameters, tf2_web_republisher."""

import json
import math
from xml.etree.ElementTree import fromstring

import numpy as np
import pytest

from tests.arenas import FLAT
from tests.server.rosbridge.test_net import Ros, serving_ros, spawn
from usarmjx.base.backend import numpy_backend
from usarmjx.base.rotations import mat_from_quat, mat_from_rotation_vector
from usarmjx.base.transforms import mat_from_angles, quat_from_angles
from usarmjx.models.compile.kinematic_tree import forward_kinematics, kinematic_tree_of
from usarmjx.models.drives.base import RobotState
from usarmjx.models.robots import ROBOTS
from usarmjx.server.rosbridge.definitions import RosVersion
from usarmjx.server.rosbridge.motion import footprint_transform, frame_name
from usarmjx.server.rosbridge.republisher import TransformRequest, TransformRequests, resolve
from usarmjx.server.rosbridge.robot_description import urdf
from usarmjx.server.rosbridge.service_types import SERVICE_TYPES
from usarmjx.server.worlds.dynamic_world import DynamicWorld

CLOSE = 1e-5  # m and rad: texts of a URDF have six digits


@pytest.fixture(scope="module")
def ros():
    with serving_ros(DynamicWorld(FLAT)) as (port, _):
        client = Ros(port)
        assert spawn(client)["values"] == {"name": "R1"}
        yield client
        client.socket.close()


def values(ros, name, /, **args):
    ros.say("call_service", service=f"/rosapi/{name}", args=args, id=name)
    answer = ros.hear("service_response", id=name)
    assert answer["result"] is True, answer
    return answer["values"]


def test_nodes_and_services_are_listed_with_their_types(ros):
    assert values(ros, "nodes") == {"nodes": ["/usarmjx"]}
    details = values(ros, "node_details", node="/usarmjx")
    assert "/R1/cmd_vel" in details["subscribing"]
    assert {"/clock", "/R1/odom"} <= set(details["publishing"])
    assert values(ros, "service_type", service="/simulator/spawn") == {"type": "usarmjx_msgs/Spawn"}
    assert set(values(ros, "services")["services"]) == set(SERVICE_TYPES)
    for service in SERVICE_TYPES:
        kind = values(ros, "service_type", service=service)["type"]
        assert service in values(ros, "services_for_type", type=kind)["services"]
        assert values(ros, "service_node", service=service) == {"node": "/usarmjx"}
    assert values(ros, "service_type", service="/nobody") == {"type": ""}
    assert values(ros, "publishers", topic="/R1/odom") == {"publishers": ["/usarmjx"]}
    assert values(ros, "subscribers", topic="/R1/cmd_vel") == {"subscribers": ["/usarmjx"]}
    assert values(ros, "publishers", topic="/R1/cmd_vel") == {"publishers": []}


def test_message_details_are_those_of_rosapi(ros):
    """As rosapi's typedefs: -1 is no list, 0 one of any length; types inside follow."""
    twist, vector = values(ros, "message_details", type="geometry_msgs/Twist")["typedefs"]
    assert (twist["type"], twist["fieldnames"]) == ("geometry_msgs/Twist", ["linear", "angular"])
    assert twist["fieldtypes"] == ["geometry_msgs/Vector3"] * 2
    assert twist["fieldarraylen"] == [-1, -1]
    assert vector["fieldnames"] == ["x", "y", "z"]
    scan, *_ = values(ros, "message_details", type="sensor_msgs/msg/LaserScan")["typedefs"]
    assert scan["type"] == "sensor_msgs/msg/LaserScan"
    assert dict(zip(scan["fieldnames"], scan["fieldarraylen"], strict=True))["ranges"] == 0
    odometry = values(ros, "message_details", type="nav_msgs/Odometry")["typedefs"]
    assert "geometry_msgs/PoseWithCovariance" in {one["type"] for one in odometry}
    assert ros.call("/rosapi/message_details", type="no/Such")["result"] is False


ARGUMENTS = {
    "message_details": {"type": "geometry_msgs/Twist"},
    "service_request_details": {"type": "rosapi/Nodes"},
    "service_response_details": {"type": "rosapi/Nodes"},
    "set_param": {"name": "/mine", "value": "1"},
}
"""Arguments of those services that answer no empty request."""


@pytest.mark.parametrize("service", [name for name in SERVICE_TYPES if name.startswith("/rosapi/")])
def test_every_service_answers_with_the_fields_of_its_type(ros, service):
    name = service.removeprefix("/rosapi/")
    kind = values(ros, "service_type", service=service)["type"]
    assert kind.startswith("rosapi_msgs/srv/")
    (request, *_), (response, *_) = (
        values(ros, f"service_{part}_details", type=kind)["typedefs"] for part in ("request", "response")
    )
    assert (request["type"], response["type"]) == (f"{kind}_Request", f"{kind}_Response")
    arguments = ARGUMENTS.get(name, {})
    assert set(arguments) <= set(request["fieldnames"])
    assert set(values(ros, name, **arguments)) == set(response["fieldnames"])


def test_details_of_services_are_those_that_roslib_and_roslibpy_ask(ros):
    """In ROS 1's form `Request` and `Response` follow the name, as rospy's classes are called."""
    request, pose, *_ = values(ros, "service_request_details", type="usarmjx_msgs/Spawn")["typedefs"]
    assert request["type"] == "usarmjx_msgs/SpawnRequest"
    assert dict(zip(request["fieldnames"], request["fieldtypes"], strict=True)) == {
        "class": "string",
        "name": "string",
        "pose": "geometry_msgs/Pose",
        "start": "string",
    }
    assert pose["type"] == "geometry_msgs/Pose"
    (response,) = values(ros, "service_response_details", type="usarmjx_msgs/Spawn")["typedefs"]
    assert (response["type"], response["fieldnames"]) == ("usarmjx_msgs/SpawnResponse", ["name"])
    details, definition = values(ros, "service_response_details", type="rosapi/MessageDetails")["typedefs"]
    assert (details["fieldtypes"], details["fieldarraylen"]) == (["rosapi/TypeDef"], [0])
    twist, *_ = values(ros, "message_details", type="geometry_msgs/Twist")["typedefs"]
    assert list(twist) == definition["fieldnames"]
    _, later = values(ros, "service_response_details", type="rosapi_msgs/srv/MessageDetails")["typedefs"]
    assert later["type"] == "rosapi_msgs/msg/TypeDef"
    (same,) = values(ros, "message_details", type=later["type"])["typedefs"]
    assert same == later
    assert ros.call("/rosapi/service_request_details", type="no/Such")["result"] is False


def test_parameters_are_kept_and_the_robots_description_is_one(ros):
    for name in ("robot_description", "/robot_description", "/R1/robot_description"):
        text = json.loads(values(ros, "get_param", name=name)["value"])
        assert fromstring(text).get("name") == "P2AT"
    assert values(ros, "get_param", name="/R9/robot_description")["value"] == "null"
    assert values(ros, "get_param", name="nothing", default="5")["value"] == "5"
    assert values(ros, "get_param", name="use_sim_time")["value"] == "true"
    assert values(ros, "set_param", name="/mine", value='{"a": [1, 2]}')["successful"]
    assert json.loads(values(ros, "get_param", name="mine")["value"]) == {"a": [1, 2]}
    assert values(ros, "has_param", name="mine") == {"exists": True}
    assert {"/mine", "/R1/robot_description"} <= set(values(ros, "get_param_names")["names"])
    values(ros, "delete_param", name="mine")
    assert values(ros, "has_param", name="mine") == {"exists": False}
    assert ros.call("/rosapi/set_param", name="bad", value="{")["result"] is False
    assert ros.call("/rosapi/set_param", name="long", value="1" * 70_000)["result"] is False


def test_time_has_the_names_of_both_versions(ros):
    """roslibpy's get_time reads secs and nsecs of any server."""
    time = values(ros, "get_time")["time"]
    assert (time["sec"], time["nanosec"]) == (time["secs"], time["nsecs"])


def axes(transform):
    turn = transform["rotation"]
    with numpy_backend():
        mat = mat_from_quat(np.array([turn[axis] for axis in "wxyz"]))
    return np.array([transform["translation"][axis] for axis in "xyz"]), np.asarray(mat)


def at_rest(ros):
    """Wait until the robot, which begins above the floor, has settled to a millimetre."""
    ros.say("subscribe", topic="/R1/GroundTruth", id="settling")
    before, now = math.inf, 0.0
    while abs(now - before) > 1e-3:
        before = now
        now = ros.hear("publish", topic="/R1/GroundTruth")["msg"]["pose"]["position"]["z"]
    ros.say("unsubscribe", topic="/R1/GroundTruth", id="settling")


def test_transforms_come_by_the_action_as_roslibs_tf_client_asks(ros):
    """roslib 1: a goal, then feedback of TransformStamped in the fixed frame."""
    at_rest(ros)
    ros.say("subscribe", topic="/tf2_web_republisher/feedback", id="tf")
    goal = {"source_frames": ["R1/base_link", "/R1/base_footprint"], "target_frame": "map", "rate": 10.0}
    message = {"goal_id": {"stamp": {"secs": 0, "nsecs": 0}, "id": "goal_1"}, "goal": goal}
    ros.say(
        "advertise", topic="/tf2_web_republisher/goal", type="tf2_web_republisher/TFSubscriptionActionGoal"
    )
    ros.say("publish", topic="/tf2_web_republisher/goal", msg=message)
    heard = ros.hear("publish", topic="/tf2_web_republisher/feedback")["msg"]
    assert heard["status"]["goal_id"]["id"] == "goal_1"
    base, foot = heard["feedback"]["transforms"]
    assert (base["child_frame_id"], base["header"]["frame_id"]) == ("R1/base_link", "map")
    pose = ros.topic("/R1/GroundTruth")["pose"]["position"]
    place, _ = axes(base["transform"])
    assert place == pytest.approx([pose[axis] for axis in "xyz"], abs=0.05)
    on_floor, level = axes(foot["transform"])
    assert on_floor[:2] == pytest.approx(place[:2], abs=0.02)
    assert level[2, 2] == pytest.approx(1.0, abs=1e-6)
    ros.say("publish", topic="/tf2_web_republisher/goal", msg={**message, "goal_id": {"id": "goal_2"}})
    for name in ("goal_1", "goal_2"):  # both are due in the same steps
        while (
            ros.hear("publish", topic="/tf2_web_republisher/feedback")["msg"]["status"]["goal_id"]["id"]
            != name
        ):
            pass
    ros.say("publish", topic="/tf2_web_republisher/cancel", msg={"id": ""})
    ros.say("unsubscribe", topic="/tf2_web_republisher/feedback", id="tf")


def test_transforms_come_by_the_service_too(ros):
    args = {"source_frames": ["map"], "target_frame": "R1/base_link", "rate": 20}
    topic = ros.call("/republish_tfs", **args)["values"]["topic_name"]
    (one,) = ros.topic(topic, type="tf2_web_republisher/TFArray")["transforms"]
    assert (one["child_frame_id"], one["header"]["frame_id"]) == ("map", "R1/base_link")
    assert ros.call("/republish_tfs", source_frames=[1], target_frame="map")["result"] is False


def stamped(parent, child, shift, angles=(0.0, 0.0, 0.0)):
    w, x, y, z = quat_from_angles(*angles)
    transform = {
        "translation": dict(zip("xyz", shift, strict=True)),
        "rotation": {"w": w, "x": x, "y": y, "z": z},
    }
    return {"header": {"frame_id": parent}, "child_frame_id": child, "transform": transform}


def test_frames_are_told_in_each_other_along_the_tree():
    """A quarter turn at (1, 0, 0), and 2 m ahead of it: (1, 2, 0) in the root."""
    tree = [stamped("map", "a", (1, 0, 0), (0, 0, np.pi / 2)), stamped("a", "b", (2, 0, 0))]
    tree.append(stamped("map", "c", (0, 0, 1)))
    request = TransformRequest("g", ("b", "map", "nowhere"), "map", 0.1)
    (b, (_, at)), (root, (mat, origin)) = resolve(tree, request)
    assert (b, root) == ("b", "map")
    assert at == pytest.approx([1, 2, 0])
    assert origin == pytest.approx([0, 0, 0])
    assert mat == pytest.approx(np.eye(3))
    ((_, (_, from_c)),) = resolve(tree, TransformRequest("g", ("b",), "c", 0.1))
    assert from_c == pytest.approx([1, 2, -1])


def test_a_client_keeps_few_goals_and_cancels_all_without_an_id():
    requests = TransformRequests()
    for number in range(40):
        goal = {"source_frames": ["a"], "target_frame": "map", "rate": 1}
        requests.take("/tf2_web_republisher/goal", {"goal_id": {"id": str(number)}, "goal": goal})
    assert len(requests.goals) == 16
    requests.take("/tf2_web_republisher/cancel", {"id": ""})
    assert requests.goals == {}


@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.7), (0.1, -0.2, 2.0)])
def test_the_footprint_is_level_below_the_robot(angles):
    spec = ROBOTS.get("P2AT")
    mat = mat_from_angles(*angles)
    pos = mat @ np.array([0.0, 0.0, spec.origin_height]) + (1.0, 2.0, 0.5)  # it stands on (1, 2, 0.5)
    state = RobotState(
        pos=pos, quat=np.array(quat_from_angles(*angles)), linear=np.zeros(3), angular=np.zeros(3),
        joint_pos=np.zeros(0), joint_vel=np.zeros(0),
    )  # fmt: skip
    one = footprint_transform(RosVersion.ROS2, 0.0, "R", spec, state, 0.0)
    at, turn = axes(one["transform"])
    assert mat @ at + pos == pytest.approx([1.0, 2.0, 0.5], abs=CLOSE)
    assert mat @ turn == pytest.approx(mat_from_angles(0.0, 0.0, np.arctan2(mat[1, 0], mat[0, 0])), abs=CLOSE)


@pytest.mark.parametrize("name", ["P2AT", "Talon", "kenaf", "TeleMax", "Submarine"])
def test_a_description_has_the_joints_and_the_frames_of_its_robot(name):
    spec = ROBOTS.get(name)
    plan, root = kinematic_tree_of(spec), fromstring(urdf(spec))
    joints = {one.get("name"): one for one in root.findall("joint")}
    assert list(joints) == list(plan.parts[1:])
    joint_pos = np.linspace(-0.9, 0.8, len(joints))
    state = RobotState(
        pos=np.zeros(3), quat=np.eye(4)[0], linear=np.zeros(3), angular=np.zeros(3),
        joint_pos=joint_pos, joint_vel=np.zeros(len(joints)),
    )  # fmt: skip
    with numpy_backend():
        bodies = forward_kinematics(plan, state)
    poses = {"base_link": (np.eye(3), np.zeros(3))}
    for index, (part, joint) in enumerate(joints.items(), 1):
        mat, pos = poses[joint.find("parent").get("link")]
        origin = joint.find("origin")
        xyz, rpy = (np.array(origin.get(key).split(), float) for key in ("xyz", "rpy"))
        axis = np.array(joint.find("axis").get("xyz").split(), float)
        assert np.linalg.norm(axis) == pytest.approx(1.0, abs=CLOSE)
        turn, shift = np.eye(3), joint_pos[index - 1] * axis
        if joint.get("type") != "prismatic":
            with numpy_backend():
                turn, shift = np.asarray(mat_from_rotation_vector(shift)), np.zeros(3)
        own = mat @ mat_from_angles(*rpy)
        poses[frame_name(part)] = (own @ turn, pos + mat @ xyz + own @ shift)
        assert poses[frame_name(part)][1] == pytest.approx(np.asarray(bodies.pos)[index], abs=CLOSE)
        assert poses[frame_name(part)][0] == pytest.approx(np.asarray(bodies.mat)[index], abs=CLOSE)
        assert joint.get("type") in ("continuous", "revolute", "prismatic")
    assert len(root.findall("link")) == 1 + len(joints)
