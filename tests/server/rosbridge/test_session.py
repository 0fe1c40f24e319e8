"""Dialogues in the rosbridge protocol without sockets, and what Twist means to drives."""

import json
import math

import pytest

from usarmjx.base.errors import UsageError
from usarmjx.models.robots import ROBOTS
from usarmjx.server.rosbridge.definitions import RosVersion
from usarmjx.server.rosbridge.encodings import fragments
from usarmjx.server.rosbridge.motion import Velocity, can_follow, drive_keys, read_twist
from usarmjx.server.rosbridge.services import read_spawn
from usarmjx.server.rosbridge.session import (
    MAX_LENGTH,
    MAX_REPLIES,
    MAX_SUBSCRIPTIONS,
    MAX_UNFINISHED,
    BridgeSession,
    Published,
    ServiceCall,
)

TOPICS = {"/clock": "rosgraph_msgs/Clock", "/R1/cmd_vel": "geometry_msgs/Twist"}


@pytest.fixture
def session():
    return BridgeSession(RosVersion.ROS2, TOPICS.get)


def say(session, **message):
    return session.receive(json.dumps(message))


def heard(session):
    found = []
    while (text := session.take()) is not None:
        found.append(json.loads(text))
    return found


@pytest.mark.parametrize(
    ("message", "words"),
    [
        ("{", "no JSON"),
        ("[" * 100_000, "no JSON"),
        ("[]", "object with op"),
        ('{"op": "dance"}', "no such op as 'dance'; known: advertise"),
        ('{"op": "subscribe"}', "subscribe needs topic"),
        ('{"op": "subscribe", "topic": "/nowhere"}', "no topic '/nowhere' yet: name its type"),
        ('{"op": "subscribe", "topic": "/clock", "type": "std_msgs/String"}', "rosgraph_msgs/Clock, not"),
        (
            '{"op": "subscribe", "topic": "/clock", "compression": "zip"}',
            "no compression 'zip'; known: none, png",
        ),
        (
            '{"op": "subscribe", "topic": "/clock", "fragment_size": 7}',
            "fragment_size is 7, expected 0 or at",
        ),
        ('{"op": "subscribe", "topic": "/clock", "throttle_rate": -1}', "throttle_rate is '-1'"),
        (
            '{"op": "advertise", "topic": "/chat", "type": "std_msgs/String"}',
            "nobody here listens to '/chat'",
        ),
        (
            '{"op": "advertise", "topic": "/R1/cmd_vel", "type": "std_msgs/String"}',
            "geometry_msgs/Twist, not",
        ),
    ],
)
def test_what_is_wrong_is_said(session, message, words):
    assert session.receive(message) is None
    (status,) = heard(session)
    assert (status["op"], status["level"]) == ("status", "error")
    assert words in status["msg"]


def test_a_status_has_the_id_of_what_it_is_about_and_may_be_unwanted(session):
    say(session, op="unsubscribe", topic="/clock", id="u1")
    assert [(one["level"], one["id"]) for one in heard(session)] == [("warning", "u1")]
    say(session, op="set_level", level="error")
    say(session, op="unsubscribe", topic="/clock")
    assert heard(session) == []
    say(session, op="set_level", level="none")
    say(session, op="dance")
    assert heard(session) == []


def test_a_client_that_does_not_read_keeps_the_latest(session):
    say(session, op="subscribe", topic="/clock", queue_length=3)
    one = session.subscriptions["/clock"]
    for number in range(1, 9):
        one.put(f"[{number}]", number, 0.0)
    assert heard(session) == [[6], [7], [8]]
    for _ in range(2 * MAX_REPLIES):
        say(session, op="dance")
    assert len(heard(session)) == MAX_REPLIES


def test_a_client_advertises_a_limited_number_of_topics():
    session = BridgeSession(RosVersion.ROS2, lambda topic: "std_msgs/String")
    for number in range(MAX_SUBSCRIPTIONS):
        say(session, op="advertise", topic=f"/tf_repub/{number}", type="std_msgs/String")
    say(session, op="advertise", topic="/tf_repub/0", type="std_msgs/String")
    assert heard(session) == []
    say(session, op="advertise", topic="/tf_repub/more", type="std_msgs/String")
    (status,) = heard(session)
    assert f"more than {MAX_SUBSCRIPTIONS} topics" in status["msg"]


def test_long_texts_go_in_fragments_one_after_the_other(session):
    say(session, op="subscribe", topic="/clock", id="a", fragment_size=300)
    say(session, op="subscribe", topic="/clock", id="b", fragment_size=100)
    session.subscriptions["/clock"].put(json.dumps("x" * 248), 1, 0.0)
    first = json.loads(session.take())
    say(session, op="dance")  # its answer waits until the message is whole
    *rest, status = heard(session)
    assert [one["num"] for one in (first, *rest)] == [0, 1, 2]
    assert "".join(one["data"] for one in (first, *rest)) == json.dumps("x" * 248)
    assert status["op"] == "status"
    session.subscriptions["/clock"].put(b"x" * 248, 2, 0.0)
    assert session.take() == b"x" * 248


def test_the_latest_of_a_topics_subscriptions_says_how_messages_travel(session):
    for name, how in (("a", "cbor"), ("b", "png"), ("a", "cbor-raw")):
        say(session, op="subscribe", topic="/clock", id=name, compression=how)
        assert session.subscriptions["/clock"].compression == how
    say(session, op="unsubscribe", topic="/clock", id="a")
    assert session.subscriptions["/clock"].compression == "png"


def test_the_shortest_throttle_of_a_topics_subscriptions_counts(session):
    for name, pause in (("a", 500), ("b", 100)):
        say(session, op="subscribe", topic="/clock", id=name, throttle_rate=pause)
    one = session.subscriptions["/clock"]
    one.put("1", 1, 10.0)
    assert [list(session.due_topics(now)) != [] for now in (10.09, 10.1)] == [False, True]
    say(session, op="unsubscribe", topic="/clock", id="b")
    one.put("2", 2, 10.1)
    assert [list(session.due_topics(now)) != [] for now in (10.5, 10.6)] == [False, True]
    say(session, op="unsubscribe", topic="/clock")
    assert session.subscriptions == {}


def test_topics_take_turns_and_answers_come_first(session):
    for topic in TOPICS:
        say(session, op="subscribe", topic=topic, queue_length=2)
        for number in range(2):
            session.subscriptions[topic].put(json.dumps(f"{topic} {number}"), number, 0.0)
    call = say(session, op="call_service", service="/rosapi/topics", id=7)
    assert isinstance(call, ServiceCall)
    call.answer({"topics": []})
    first, *rest = heard(session)
    assert first == {
        "op": "service_response",
        "service": "/rosapi/topics",
        "values": {"topics": []},
        "result": True,
        "id": 7,
    }
    assert rest == ["/clock 0", "/R1/cmd_vel 0", "/clock 1", "/R1/cmd_vel 1"]


def test_the_version_is_the_servers_unless_the_type_says_two():
    session = BridgeSession(RosVersion.ROS1, TOPICS.get)
    say(session, op="subscribe", topic="/clock", type="rosgraph_msgs/Clock")
    say(session, op="subscribe", topic="/R1/cmd_vel", type="geometry_msgs/msg/Twist")
    assert [one.version for one in session.subscriptions.values()] == [RosVersion.ROS1, RosVersion.ROS2]
    assert RosVersion.ROS1.stamp(1.9999999999) == {"secs": 2, "nsecs": 0}
    assert RosVersion.ROS2.stamp(1.25) == {"sec": 1, "nanosec": 250_000_000}


def test_what_is_published_is_handed_on(session):
    assert say(session, op="publish", topic="/R1/cmd_vel", msg={"linear": {}}) == Published(
        "/R1/cmd_vel", {"linear": {}}
    )


# Twist


def test_a_twist_may_leave_out_what_is_zero():
    twist = {"linear": {"x": 1, "y": 2.5, "z": -1}, "angular": {"x": 9, "z": 0.5}}
    assert read_twist(twist) == Velocity(1.0, 2.5, -1.0, 0.5)
    assert read_twist({}) == Velocity(0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("twist", [3, {"linear": 3}, {"linear": {"x": "fast"}}, {"angular": {"z": math.nan}}])
def test_what_is_no_twist_is_refused(twist):
    with pytest.raises(UsageError, match="geometry_msgs/Twist"):
        read_twist(twist)


def test_skid_steered_robots_get_both_sides_speeds():
    robot = ROBOTS.get("P2AT")
    straight = drive_keys(robot, Velocity(0.3, 0.0, 0.0, 0.0))
    assert straight == pytest.approx({key: 0.3 / robot.wheel_radius for key in ("Left", "Right")})
    turn = drive_keys(robot, Velocity(0.0, 0.0, 0.0, 1.0))
    assert turn["Right"] == -turn["Left"] > 0  # to the left
    across = (turn["Right"] - turn["Left"]) * robot.wheel_radius
    assert across == pytest.approx(robot.drive.lever)
    assert across >= robot.wheel_separation


def test_cars_steer_along_the_curve_and_do_not_turn_on_the_spot():
    robot = next(ROBOTS.get(name) for name in ROBOTS.names() if "FrontSteer" in ROBOTS.get(name).drive.keys)
    keys = drive_keys(robot, Velocity(-1.0, 0.0, 0.0, 0.2))
    assert keys["Speed"] == pytest.approx(-1.0 / robot.drive.radius)
    assert math.tan(keys["FrontSteer"]) / robot.drive.wheel_base == pytest.approx(-0.2)
    assert drive_keys(robot, Velocity(0.0, 0.0, 0.0, 1.0))["FrontSteer"] == 0.0
    assert drive_keys(robot, Velocity(0.01, 0.0, 0.0, 9.0))["FrontSteer"] == robot.drive.max_front_steer


def test_what_flies_moves_up_left_and_round_to_the_left():
    keys = drive_keys(ROBOTS.get("AirRobot"), Velocity(1.0, 2.0, 3.0, 0.5))
    assert keys == {
        "AltitudeVelocity": 3.0,
        "LinearVelocity": 1.0,
        "LateralVelocity": -2.0,
        "RotationalVelocity": -0.5,
    }


def test_every_drive_gets_keys_that_it_has_or_says_so():
    for name in ROBOTS.names():
        robot = ROBOTS.get(name)
        if can_follow(robot.drive):
            keys = drive_keys(robot, Velocity(0.2, 0.1, 0.1, 0.1))
            assert set(keys) <= {*robot.drive.keys, *robot.drive.other_keys}, name
            assert keys, name
        else:
            with pytest.raises(UsageError, match=name):
                drive_keys(robot, Velocity(0.2, 0.0, 0.0, 0.0))


# Fragments


def in_fragments(size, **message):
    """The fragments of a message, as a client sends them."""
    return [json.loads(text) for text in fragments(json.dumps(message), size, "long")]


def test_what_comes_in_fragments_is_put_together_in_whatever_order_they_come(session):
    twist = {"linear": {"x": 0.2}}
    parts = in_fragments(20, op="publish", topic="/R1/cmd_vel", msg=twist)
    assert len(parts) > 3
    for part in parts[:0:-1]:
        assert say(session, **part) is None
    assert say(session, **{**parts[2], "id": "other"}) is None  # of another message
    assert say(session, **parts[0]) == Published("/R1/cmd_vel", twist)
    assert heard(session) == []
    assert say(session, **parts[0]) is None  # the message is over: this begins it anew


def test_unfinished_messages_take_up_no_more_than_a_little_room(session):
    first, *rest = in_fragments(50, op="publish", topic="/R1/cmd_vel", msg={"linear": {"x": 0.2}})
    say(session, **first)
    for number in range(MAX_UNFINISHED):
        say(session, op="fragment", id=str(number), data="x", num=0, total=2)
    for part in rest:
        assert say(session, **part) is None  # the first one had to go
    data = "x" * (MAX_LENGTH // 2 + 1)
    say(session, op="fragment", id="huge", data=data, num=0, total=9)
    assert heard(session) == []
    say(session, op="fragment", id="huge", data=data, num=1, total=9)
    assert "longer than" in heard(session)[0]["msg"]


@pytest.mark.parametrize(
    "wrong",
    [
        {"total": 10_000_000},
        {"num": 2},
        {"num": -1},
        {"num": 0.5},
        {"total": True},
        {"data": 3},
        {"id": None},
        {"total": 0},
    ],
)
def test_a_fragment_that_is_none_is_refused(session, wrong):
    assert say(session, **{"op": "fragment", "id": "a", "data": "{}", "num": 0, "total": 2, **wrong}) is None
    assert "a fragment has " in heard(session)[0]["msg"]


def test_what_is_put_together_is_a_message_and_no_fragment(session):
    inner = {"op": "fragment", "id": "b", "data": "{}", "num": 0, "total": 1}
    for whole, words in ((json.dumps(inner), "fragments of fragments"), ("{", "no JSON")):
        assert say(session, op="fragment", id="a", data=whole, num=0, total=1) is None
        assert words in heard(session)[0]["msg"]


# Spawning


def test_a_pose_is_turned_into_the_wires_frame():
    half = math.sqrt(0.5)
    orientation = {"z": half, "w": half}
    pose = {"position": {"x": 1.0, "y": 2.0, "z": 3.0}, "orientation": orientation}
    init, spec = read_spawn({"class": "P2AT", "name": "R1", "pose": pose})
    assert (init.class_name, init.name, spec.name) == ("P2AT", "R1", "P2AT")
    assert init.location == pytest.approx((1.0, -2.0, -3.0))
    assert init.rotation == pytest.approx((0.0, 0.0, -math.pi / 2), abs=1e-6)


@pytest.mark.parametrize(
    ("args", "words"),
    [
        ({}, "unknown robot"),
        ({"class": "P2AT", "name": "a b"}, "letters, digits"),
        ({"class": "P2AT", "pose": 3}, "a pose has position"),
        ({"class": "P2AT", "pose": {"position": {"x": 1}}}, "a pose has orientation"),
        ({"class": "P2AT", "pose": {"position": {"x": "1"}, "orientation": {"w": 1}}}, "numbers x, y, z"),
        ({"class": "P2AT", "pose": {"position": {}, "orientation": {}}}, "length 0"),
        ({"class": "P2AT", "pose": {"position": {}, "orientation": {"w": 1}}, "start": "S0"}, "either"),
    ],
)
def test_what_is_wrong_with_a_spawn_is_said(args, words):
    with pytest.raises(UsageError, match=words):
        read_spawn(args)
