"""Completion: by the server's own table of commands, and by what the robot's messages have told."""

import pytest

from tests.cli.console.robots import Driven
from usarmjx.base.errors import PeerError
from usarmjx.cli.console.knowledge import (
    KEYS,
    SENSOR_OPCODES,
    SENSOR_TYPES,
    Completer,
    Knowledge,
    common_beginning,
    heads,
)
from usarmjx.models.robots import ROBOTS
from usarmjx.sensors.base import SENSORS
from usarmjx.server.protocol.command_parsers import COMMANDS
from usarmjx.server.protocol.commands import DRIVE_KEYS, TRACE_COLORS
from usarmjx.server.protocol.grammar import Message, parse_message
from usarmjx.server.protocol.reports import STATUS_OK

ASKED = set()


class Spy(Message):
    """A message that notes which keys are asked for; it answers what it holds."""

    def all(self, key):
        ASKED.add(key.lower())
        return super().all(key)


@pytest.fixture(scope="module")
def talon():
    """A robot with cameras, a gripper, an arm and flippers."""
    return Driven("Talon")


@pytest.fixture(scope="module")
def pioneer():
    return Driven("P2DX")


@pytest.fixture
def bare():
    return Completer(Knowledge(), ROBOTS.names())


@pytest.mark.parametrize("head", COMMANDS.names())
def test_every_command_that_the_server_understands_is_completed(bare, head):
    for length in range(1, len(head)):
        for begun in (head[:length], head[:length].lower()):
            assert head in [found.strip() for found in bare.complete(begun)], begun
    assert head in KEYS


@pytest.mark.parametrize("head", COMMANDS.names())
def test_every_key_that_the_servers_parser_asks_for_is_offered(head):
    """All forms that a command has, by the segments that choose between them."""
    forms = ["", "{Name x}", "{WheelNumber 1}", "{Type Joint} {Name x} {Opcode Angle}", "{Type Viewports}"]
    forms += ["{Type Camera} {Client x}", "{Type Camera} {FOV 1}", "{Type x} {Opcode zoom}", "{ClassName x}"]
    ASKED.clear()
    for form in forms:
        message = parse_message(f"{head} {form}")
        try:
            COMMANDS.get(head)(Spy(message.kind, message.segments))
        except PeerError:
            continue
    known = {key.lower() for key in KEYS[head]}
    assert known >= ASKED
    assert set(map(str.lower, DRIVE_KEYS)) <= known or head != "DRIVE"


@pytest.mark.parametrize(
    ("text", "first"),
    [
        ("getst", "GETSTARTPOSES"),
        ("init", "INIT "),
        ("INIT ", "INIT {ClassName "),
        ("INIT {Cl", "INIT {ClassName "),
        ("INIT {ClassName USARBot.P2D", "INIT {ClassName USARBot.P2DX}"),
        ("INIT {ClassName talo", "INIT {ClassName USARBot.Talon}"),
        ("INIT {ClassName USARBot.P2AT}", "INIT {ClassName USARBot.P2AT} {Name "),
        ("INIT {Name a} {ClassName USARBot.P2AT} ", "INIT {Name a} {ClassName USARBot.P2AT} {Location "),
        ("drive {l", "drive {Left "),
        ("DRIVE {Left 1.0} {Rig", "DRIVE {Left 1.0} {Right "),
        ("DRIVE {Normalized t", "DRIVE {Normalized True}"),
        ("TRACE {Color g", "TRACE {Color Green}"),
        ("TRACE {Color ", f"TRACE {{Color {TRACE_COLORS[0]}}}"),
        ("GETCONF {Type ", "GETCONF {Type Robot}"),
        ("SET {Type Viewports} {Conf", "SET {Type Viewports} {Config "),
        ("SET {Type Viewports} {Config q", "SET {Type Viewports} {Config QuadView}"),
        ("SET {Type Joint} {Name x} {Opcode v", "SET {Type Joint} {Name x} {Opcode Velocity}"),
        ("auth {", "auth {Token "),
    ],
)
def test_words_that_are_known_before_any_robot_is(bare, text, first):
    assert bare.complete(text)[0] == first


@pytest.mark.parametrize("text", ["xyz", "DRIVE {Xyz", "INIT {ClassName Zzz", "SET {Type Sonar} {Name ", "{"])
def test_what_nothing_begins_with_is_left_alone(bare, text):
    assert bare.complete(text) == []


def test_keys_that_may_repeat_are_offered_again_and_others_are_not(bare):
    assert "DRIVE {WheelNumber 0} {WheelNumber " in bare.complete("DRIVE {WheelNumber 0} {Wheel")
    assert bare.complete("DRIVE {Left 1} {Lef") == []
    assert "MISPKG {Name x} {Link 1} {Value 0} {Link " in bare.complete(
        "MISPKG {Name x} {Link 1} {Value 0} {L"
    )


def offered(driven, text):
    """The last words of the lines that a robot's messages make possible."""
    found = Completer(driven.knowledge, (), "127.0.0.1:5").complete(text)
    assert all(line.startswith(text.rpartition("{")[0]) for line in found)
    return [line.rstrip(" }").rpartition("{")[2].split(" ")[-1] for line in found]


def test_names_of_sensors_cameras_effecters_and_packages_are_learned(pioneer, talon):
    spec = pioneer.robot.spec
    for kind in {mount.kind for mount in spec.sensors}:
        assert kind in offered(pioneer, "GETGEO {Type ")
        names = [mount.name for mount in spec.sensors if mount.kind == kind]
        assert offered(pioneer, f"GETCONF {{Type {kind}}} {{Name ") == names, kind
    assert offered(pioneer, "SET {Type Camera} {Name ") == ["Camera"]
    assert offered(talon, "SET {Type Camera} {Name ") == ["Camera", "Camera2", "Camera3", "Camera4"]
    assert offered(pioneer, "MISPKG {Name ") == ["CameraPanTilt"]
    assert offered(pioneer, "MISPKG {Name CameraPanTilt} {Link ") == ["1", "2"]
    assert offered(talon, "SET {Type Viewports} {Viewport2 cam") == [
        "Camera",
        "Camera2",
        "Camera3",
        "Camera4",
    ]
    assert set(offered(talon, "MULTIDRIVE {")) >= {"TalonArm_Link1", *talon.robot.spec.reported_joints}
    assert offered(pioneer, "DRIVE {Name CameraPan") == ["CameraPanTilt_Link1", "CameraPanTilt_Link2"]
    assert offered(pioneer, "SET {Type Camera} {Robot ") == ["R1"]
    assert offered(pioneer, "SET {Type Camera} {Client ") == ["127.0.0.1:5"]


def test_operations_are_those_of_the_effecter(talon):
    opcodes = [opcode.name for opcode in talon.robot.effecters[0].opcodes]
    assert offered(talon, "SET {Type Gripper} {Name Gripper} {Opcode ") == opcodes
    assert offered(talon, "SET {Type Effecter} {Name Gripper} {Opcode ") == opcodes


@pytest.mark.parametrize("kind", ["Odometry", "Encoder", "INS", "RangeScanner"])
def test_operations_of_sensors_are_those_that_the_server_carries_out(pioneer, kind):
    name = next(mount.name for mount in pioneer.robot.spec.sensors if mount.kind == kind)
    (opcode,) = offered(pioneer, f"SET {{Type {kind}}} {{Name {name}}} {{Opcode ")
    params = " {Params 0,0,0,0,0,0}" if opcode == "POSE" else ""
    pioneer.tell()
    line = f"SET {{Type {kind}}} {{Name {name}}} {{Opcode {opcode}}}{params}\r\n"
    for command in pioneer.client.session.receive_data(line.encode()):
        pioneer.client.handle(command)
    answer = parse_message(pioneer.client.session.data_to_send().decode().splitlines()[-1])
    assert (answer.kind, answer.get("Status")) == ("RES", STATUS_OK)


def test_start_poses_are_learned():
    known = Knowledge()
    known.hear(parse_message("NFO {Gametype BotDeathMatch} {Level flat} {TimeLimit 0}"))
    assert known.questions() == ["GETSTARTPOSES"]
    known.hear(
        parse_message("NFO {StartPoses 2} {A 1.00,2.00,3.00 0.00,0.00,1.57 B 4.00,5.00,6.00 0.00,0.00,0.00}")
    )
    completer = Completer(known, ())
    assert completer.complete("INIT {Start ") == ["INIT {Start A}", "INIT {Start B}"]
    assert completer.complete("INIT {Location ")[1] == "INIT {Location 4.00,5.00,6.00}"
    assert completer.complete("INIT {Rotation ")[0] == "INIT {Rotation 0.00,0.00,1.57}"
    assert known.questions() == [], "each question is asked once"


@pytest.mark.parametrize(
    "line",
    [
        "STA",
        "NFO {StartPoses 1} {A}",
        "MISSTA {Link x}",
        "SEN {Type Sonar} {Name }",
        "GEO {Type Sonar} {Name F1}",
        "GEO {Type MisPkg} {Name P} {Link nan}",
        "CONF {Type Camera} {CameraFov x}",
        "CONF {Type Effecter} {Name} {Opcode}",
        "RES {Name A} {FOV inf}",
        "XYZ {Type}",
    ],
)
def test_what_another_server_says_otherwise_ends_nothing(line):
    known = Knowledge()
    known.hear(parse_message(line))
    known.hear(parse_message("SEN {Type Sonar} {Name F1 Range 1.0}"))
    assert known.names("sonar") == ["F1"]


def test_what_lines_have_in_common():
    assert common_beginning(["DRIVE {Left ", "drive {Light "]) == "DRIVE {L"
    assert common_beginning([]) == ""
    assert heads() == sorted({"AUTH", *COMMANDS.names()})


def test_types_of_sensors_are_the_servers():
    ours = [name for name, kind in SENSORS if kind.__module__.startswith("usarmjx.")]
    assert sorted(SENSOR_TYPES) == sorted(ours)
    assert set(SENSOR_OPCODES) <= {*map(str.lower, SENSOR_TYPES), "camera", "joint"}
