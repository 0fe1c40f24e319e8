"""Whole dialogues without sockets: bytes in, a stepped world, lines out.

Line formats come from lines captured from UT2004 servers (MOAST's usarsiminf.c, UsarCommander) and the
manual, 9.3 and 9.4.
"""

import logging
import math
import re
from dataclasses import replace

import jax
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.arenas import FLAT
from usarmjx.base.rotations import mat_from_quat
from usarmjx.base.transforms import mat_from_angles
from usarmjx.models.arenas import ARENAS
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.standing import stance_of
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import START_ELEVATION, StartPose
from usarmjx.server.gamebots.adapter import Client
from usarmjx.server.protocol.commands import SessionPhase
from usarmjx.server.worlds.dynamic_world import DynamicWorld

TABLE_2 = "{Location 4.5,1.9,1.8} {Rotation 0,0,0}"  # manual 5.3.6: the yellow arena
OPEN_FLOOR = "{Start Start2}"  # 0.8 m or more of free floor around it
TICK = 10  # control steps between two reports: 0.2 s

F4, F2 = r"-?\d+\.\d{4}", r"-?\d+\.\d\d"
STA = (
    rf"STA {{Type GroundVehicle}} {{Time {F2}}} {{FrontSteer {F4}}} {{RearSteer {F4}}} "
    r"{LightToggle (?:True|False)} {LightIntensity \d+} {Battery (?P<battery>\d+)} {View -1}"
)
SONAR = rf"SEN {{Time {F4}}} {{Type Sonar}}(?: {{Name [FR][1-8] Range {F4}}}){{%d}}"
SCANNER = (
    rf"SEN {{Time {F2}}} {{Type RangeScanner}} {{Name Scanner1}} {{Resolution 0\.0174}} {{FOV 3\.1415}} "
    rf"{{Range {F4}(?:,{F4}){{180}}}}"
)
ODOMETRY = rf"SEN {{Type Odometry}} {{Name Odometry}} {{Pose {F4},{F4},{F4}}}"
INS = rf"SEN {{Type INS}} {{Name INS}} {{Location {F2},{F2},{F2}}} {{Orientation {F2},{F2},{F2}}}"
TRUTH = (
    rf"SEN {{Time {F4}}} {{Type GroundTruth}} {{Name GroundTruth}} {{Location {F2},{F2},{F2}}} "
    rf"{{Orientation {F2},{F2},{F2}}}"
)
ENCODER = r"SEN {Type Encoder} {Name ECLeft Tick -?\d+} {Name ECRight Tick -?\d+}"
MISSTA = (
    rf"MISSTA {{Time {F2}}} {{Name CameraPanTilt}} {{Link 1}} {{Value {F4}}} {{Torque {F2}}} "
    rf"{{Link 2}} {{Value {F4}}} {{Torque {F2}}}"
)
TAGS = r"SEN \{Type RFID\} \{Name RFID\}( \{ID \d+\} \{Location -?\d+\.\d\d,-?\d+\.\d\d,-?\d+\.\d\d\})+"
"""A tag lies 2 m from the yellow arena's start."""
P2AT_REPORT = [STA, SONAR % 16, SCANNER, ODOMETRY, INS, TRUTH, TAGS, MISSTA]
P2DX_REPORT = [STA, SONAR % 8, SCANNER, ODOMETRY, INS, TRUTH, ENCODER, MISSTA]


class House:
    """A served world and its clients, stepped by hand; what `net.BotServer` does without the sockets."""

    def __init__(self, world):
        self.world = world
        self.clients = []

    def connect(self, text=""):
        client = Client(self.world, f"peer{len(self.clients)}")
        self.clients.append(client)
        if text:
            client.session.data_to_send()
            self.say(client, text)
        return client

    def say(self, client, data):
        """Feed bytes (or lines of text) and return the lines that are answered at once."""
        data = data.encode() + b"\r\n" if isinstance(data, str) else data
        commands = client.session.receive_data(data)
        while commands:
            for command in commands:
                if not client.session.awaits_answer or command is not commands[-1]:
                    client.handle(command)
            commands = (
                client.session.answer_init(self._init(client, commands[-1]))
                if client.session.awaits_answer
                else []
            )
        client.log_faults()
        return heard(client)

    @staticmethod
    def _init(client, init):
        spec = client.robot_class(init)
        return spec is not None and client.spawn(init, spec)

    def run(self, steps=TICK):
        for _ in range(steps):
            self.world.step()
            due = [client for client in self.clients if client.due()]
            if due:
                self.world.observe([client.robot for client in due])
            for client in due:
                client.report()

    def leave(self, client):
        client.leave()
        self.clients.remove(client)


def heard(client):
    text = client.session.data_to_send().decode("latin-1")
    assert text == "" or text.endswith("\r\n")
    return text.split("\r\n")[:-1]


def pick(lines, start):
    """The last of the lines that start so."""
    return [line for line in lines if re.match(rf"(\w+ )({{Time [^}}]*}} )?({{Type )?{start}|{start}", line)][
        -1
    ]


def numbers(line, key):
    return [float(text) for text in re.search(rf"{{{key} ([^}}]*)}}", line)[1].split(",")]


def look(lines):
    """What the last report says: odometry pose, INS and true location and orientation."""
    return (
        numbers(pick(lines, "Odometry"), "Pose"),
        numbers(pick(lines, "INS"), "Location") + numbers(pick(lines, "INS"), "Orientation"),
        numbers(pick(lines, "GroundTruth"), "Location") + numbers(pick(lines, "GroundTruth"), "Orientation"),
    )


@pytest.fixture(scope="module")
def yellow():
    world = DynamicWorld(ARENAS.get("yellow"), Physics(), 1, max_robots=4)
    for name in ("P2AT", "P2DX"):
        world.prepare(ROBOTS.get(name))
    return world


@pytest.fixture
def house(yellow):
    house = House(yellow)
    yield house
    for client in list(house.clients):
        house.leave(client)
    assert not yellow.robots


@pytest.fixture
def robot(house):
    """A P2AT called R1 at the manual's start, which has heard nothing since INIT."""
    return house.connect(f"INIT {{ClassName USARBot.P2AT}} {{Name R1}} {TABLE_2}")


# Greeting, start poses, INIT


def test_the_server_speaks_first(house):
    assert heard(house.connect()) == ["NFO {Gametype BotDeathMatch} {Level DM-USAR_yellow} {TimeLimit 0}"]


def test_start_poses_are_told_before_init(house):
    client = house.connect()
    heard(client)
    (line,) = house.say(client, "GETSTARTPOSES")
    count = len(ARENAS.get("yellow").starts)
    triple = rf"{F2},{F2},{F2}"
    assert re.fullmatch(
        rf"NFO {{StartPoses {count}}} {{PlayerStart {triple} {triple}"
        rf"(?: Start\d+ {triple} {triple}){{{count - 1}}}}}",
        line,
    )
    assert "{PlayerStart 4.50,1.90,1.8" in line


def test_a_start_pose_may_lie_on_a_slope():
    """Manual 5.3.2: it has an orientation; the nose down is a negative pitch on the wire, whose z is down."""
    slope = replace(
        FLAT, starts=(StartPose(tag="Slope", at=(1.0, 2.0, START_ELEVATION), yaw=1.0, pitch=0.1, roll=0.2),)
    )
    house = House(DynamicWorld(slope, seed=1))
    client = house.connect()
    heard(client)
    (line,) = house.say(client, "GETSTARTPOSES")
    assert line == "NFO {StartPoses 1} {Slope 1.00,-2.00,-0.19 0.20,-0.10,-1.00}"
    house.say(client, "INIT {ClassName P2AT} {Start Slope}")
    mat = mat_from_quat(client._world.state(client.robot).quat)
    stance = mat_from_quat(stance_of(ROBOTS.get("P2AT")).tilt)  # its heavier end sinks
    np.testing.assert_allclose(mat, mat_from_angles(0.2, 0.1, 1.0) @ stance, atol=1e-6)
    house.leave(client)


@pytest.mark.parametrize(
    "line",
    [
        "INIT {ClassName USARBot.P2AT} {Name R1} {Location 4.5,1.9,1.8} {Rotation 0,0,0}",
        "init {CLASSNAME usarbot.p2at} {location 4.5 1.9 1.8}",
        "INIT {Location 4.5, 1.9, 1.8}{Classname P2AT}",
        "INIT {ClassName USARBot.P2AT}",
        "INIT {ClassName USARBot.P2AT} {Start playerstart} {Location 900,900,900}",
        "INIT {ClassName USARBot.P2AT} {Location 4.5,1.9,1.8} {Rotation 0.00, 0.00, 0.00",
    ],
)
def test_forms_of_init_that_put_a_robot_at_the_start(house, line):
    client = house.connect()
    heard(client)
    assert house.say(client, line) == []
    house.run()
    truth = look(heard(client))[2]
    assert truth[:2] == pytest.approx([4.5, 1.9], abs=0.011)
    assert truth[2] == pytest.approx(1.82, abs=0.03)


def test_ground_truth_at_the_manuals_start(house, robot):
    house.run(5 * TICK)
    _, _, truth = look(heard(robot))
    assert truth[:2] == [4.5, 1.9]
    assert truth[2] == pytest.approx(1.82, abs=0.011)
    assert [math.remainder(angle, 2 * math.pi) for angle in truth[3:]] == pytest.approx([0, 0, 0], abs=0.011)


def test_robots_without_a_name_get_one_each(house):
    names = [house.connect(f"INIT {{ClassName USARBot.P2AT}} {{Start Start{i}}}").robot.name for i in (1, 2)]
    assert names == ["P2AT_0", "P2AT_1"]


def test_a_rotation_is_in_the_wires_sense(house):
    client = house.connect("INIT {ClassName P2DX} {Location 4.5,1.9,1.8} {Rotation 0,0,0.5}")
    house.run()
    assert look(heard(client))[2][5] == pytest.approx(0.5, abs=0.011)
    quat = client._world.state(client.robot).quat
    assert 2 * math.atan2(quat[3], quat[0]) == pytest.approx(-0.5, abs=0.01), "clockwise is negative here"


def test_without_a_location_the_first_free_start_is_taken_and_a_rotation_counts(house):
    starts = house.world.arena.starts
    lines = ("INIT {ClassName P2DX}", "INIT {ClassName P2DX} {Rotation 0,0,0.5}", "INIT {ClassName P2DX}")
    states = [house.world.state(house.connect(line).robot) for line in lines]
    for state, start, yaw in zip(states, starts, (starts[0].yaw, -0.5, starts[2].yaw), strict=False):
        assert state.pos[:2] == pytest.approx(start.at[:2], abs=1e-3)
        turned = 2 * math.atan2(state.quat[3], state.quat[0]) - yaw
        assert math.remainder(turned, 2 * math.pi) == pytest.approx(0.0, abs=1e-3)


def test_a_robot_inside_the_floor_is_raised_and_that_is_logged(house, caplog):
    caplog.set_level(logging.INFO, "usarmjx")
    client = house.connect("INIT {ClassName P2AT} {Name Mole} {Location 4.5,1.9,3.0}")
    assert "Mole: no room at 4.50,1.90,3.00: it stands at 4.50,1.90,1.8" in caplog.text
    house.run()
    assert look(heard(client))[2][2] == pytest.approx(1.82, abs=0.02)


@pytest.mark.parametrize(
    ("line", "logged"),
    [
        ("INIT {ClassName P2AT} {Location 1e6,2,-0.5}", "position 1000000.00,2.00,-0.50 is out of reach"),
        ("INIT {ClassName P2AT} {Location nan,0,0}", "not a finite number"),
        ("INIT {ClassName P2AT} {Location 4,5 1,9 1,8}", "expected numbers"),
        ("INIT {ClassName P2AT} {Location 4,5,1,9,1,8}", "has 6 numbers, expected 3"),
        ("INIT {ClassName P2AT} {Start Nowhere}", "no start pose"),
        ("INIT {ClassName USARBot.Dalek} {Name R1}", "P2AT"),
        ("INIT {Name R1}", "without a ClassName"),
    ],
)
def test_an_init_that_cannot_be_is_logged_and_another_one_works(house, caplog, line, logged):
    client = house.connect()
    heard(client)
    assert house.say(client, line) == []
    assert logged in caplog.text
    assert client.robot is None
    house.run()
    assert heard(client) == [], "nothing is sent"
    house.say(client, "INIT {ClassName P2AT}")
    house.run()
    assert heard(client)


@pytest.mark.parametrize("name", ["R1", "r1"])
def test_a_second_robot_of_a_name_is_refused_by_name_until_the_first_leaves(house, robot, caplog, name):
    second = house.connect(f"INIT {{ClassName P2AT}} {{Name {name}}} {{Start Start1}}")
    assert second.robot is None
    assert f"there is a robot {name} already" in caplog.text
    assert [one.name for one in house.world.robots.values()] == ["R1"]
    house.say(second, "INIT {ClassName P2AT} {Name R2} {Start Start1}")
    assert second.robot.name == "R2"
    house.leave(robot)
    third = house.connect(f"INIT {{ClassName P2AT}} {{Name {name}}} {{Start Start2}}")
    assert third.robot.name == name


def test_commands_before_init_do_nothing(house):
    client = house.connect()
    heard(client)
    for line in (
        "DRIVE {Left 1} {Right 1}",
        "GETGEO {Type Robot}",
        "SET {Type INS} {Name INS} {Opcode POSE}",
    ):
        assert house.say(client, line) == []


def test_a_drive_with_decimal_commas_moves_nobody_and_is_logged(house, robot, caplog):
    house.say(robot, "DRIVE {Left 2,5} {Right 2,5}")
    assert "'2,5'; expected a number" in caplog.text
    before = house.world.state(robot.robot).pos[:2]
    house.run(50)
    assert house.world.state(robot.robot).pos[:2] == pytest.approx(before, abs=1e-3)


def test_a_second_init_is_ignored(house, robot):
    first = robot.robot
    assert house.say(robot, "INIT {ClassName USARBot.P2DX} {Name R2}") == []
    assert robot.robot is first
    assert len(house.world.robots) == 1


def test_a_full_house_refuses_and_lets_in_after_a_departure(house, caplog):
    guests = [house.connect(f"INIT {{ClassName P2AT}} {{Start Start{i}}}") for i in range(1, 6)]
    assert [guest.robot is not None for guest in guests] == [True] * 4 + [False]
    assert "no seat left" in caplog.text
    house.leave(guests[0])
    house.say(guests[4], "INIT {ClassName P2AT} {Start Start1}")
    assert guests[4].robot is not None


# Reports


@pytest.mark.parametrize(("name", "report"), [("P2AT", P2AT_REPORT), ("P2DX", P2DX_REPORT)])
def test_the_first_report_has_every_line_in_the_original_order_and_form(house, name, report):
    client = house.connect(f"INIT {{ClassName USARBot.{name}}} {{Name R1}} {TABLE_2}")
    house.run(TICK - 1)
    assert heard(client) == [], "the first report comes after msgTimer, 0.2 s"
    house.run(1)
    lines = heard(client)
    assert len(lines) == len(report)
    for pattern, line in zip(report, lines, strict=True):
        assert re.fullmatch(pattern, line), line
        assert len(line) < 2048, "clients have buffers of that size"


def test_reports_come_every_msg_timer_and_sensors_at_their_own_pace(house, robot):
    times, scans, odometry = [], [], []
    start = house.world.time
    for _ in range(11 * TICK):
        house.run(1)
        lines = heard(robot)
        now = house.world.time - start
        times += [now for line in lines if line.startswith("STA")]
        scans += [now for line in lines if "RangeScanner" in line]
        odometry += [now for line in lines if "Odometry" in line]
    np.testing.assert_allclose(times, 0.2 * np.arange(1, 12), atol=1e-6)
    np.testing.assert_allclose(odometry, times, atol=1e-6)  # ScanInterval 0.2
    np.testing.assert_allclose(scans, [0.2, 0.6, 1.0, 1.6, 2.0], atol=1e-6)  # every 0.5, at the next report


def test_the_time_on_the_wire_is_the_worlds(house, robot):
    house.run()
    lines = heard(robot)
    assert numbers(lines[0], "Time")[0] == pytest.approx(house.world.time, abs=0.006)
    assert numbers(pick(lines, "Sonar"), "Time")[0] == pytest.approx(house.world.time, abs=1e-3)


def test_the_battery_counts_down_from_full(house, robot):
    house.run(TICK)
    assert re.match(STA, heard(robot)[0])["battery"] == "3600"
    house.run(9 * TICK + 1)
    levels = [re.match(STA, line)["battery"] for line in heard(robot) if line.startswith("STA")]
    assert levels == ["3600"] * 3 + ["3599"] * 5 + ["3598"]


def test_an_empty_battery_leaves_only_sta_and_brakes(house, robot):
    house.say(robot, "DRIVE {Left 2} {Right 2}")
    house.run(5 * TICK)
    heard(robot)
    house.world.edit(robot.robot, battery_start=round(-robot.robot.spec.battery_life / house.world.period))
    assert house.say(robot, "GETGEO {Type Robot}") == []
    assert house.say(robot, "GETCONF {Type Robot}") == []
    assert house.say(robot, "SET {Type Odometry} {Name Odometry} {Opcode RESET}") == []
    house.run(5 * TICK)
    lines = heard(robot)
    assert [re.match(STA, line)["battery"] for line in lines] == ["0"] * 5
    before = house.world.state(robot.robot).joint_pos.copy()
    house.run(TICK)
    np.testing.assert_allclose(house.world.state(robot.robot).joint_pos, before, atol=1e-3)


# Driving


def test_odometry_and_ground_truth_agree_on_a_straight_drive(house, robot):
    house.run()
    start = look(heard(robot))
    house.say(robot, "DRIVE {Left 2.0} {Right 2.0}")
    house.run(10 * TICK)
    odometry, ins, truth = look(heard(robot))
    way = truth[0] - start[2][0]
    assert way == pytest.approx(2.0 * 0.13 * 2.0, rel=0.1)
    assert odometry[0] == pytest.approx(way, abs=0.02)
    assert odometry[1] == pytest.approx(0.0, abs=0.02)
    assert ins[0] - start[1][0] == pytest.approx(way, rel=0.2), "10 % noise on each step's distance"
    assert truth[1] == pytest.approx(1.9, abs=0.02)


def test_a_left_turn_has_the_wires_signs_everywhere(house, robot):
    house.say(robot, "Drive {LEFT 0.5}{right 2.5}")
    house.run(10 * TICK)
    odometry, ins, truth = look(heard(robot))
    turned = math.remainder(truth[5], 2 * math.pi)
    assert -2.5 < turned < -0.2, "yaw falls in a left turn"
    assert math.pi < truth[5] < 2 * math.pi
    assert math.pi < ins[5] < 2 * math.pi, "reported in a full turn"
    assert odometry[2] < -0.2
    assert truth[1] < 1.9 - 0.02, "y is to the right"
    assert odometry[1] < -0.02
    assert ins[1] < 1.9 - 0.02


def test_normalized_speeds_are_percents(house, robot):
    house.say(robot, "DRIVE {Left 100} {Right -50} {Normalized True}")
    top = robot.robot.spec.drive.max_speed
    np.testing.assert_allclose(robot.robot.command.target[:4], [top, -top / 2, top, -top / 2], rtol=1e-6)


def test_a_partial_drive_keeps_the_other_side(house, robot):
    house.say(robot, "DRIVE {Left 1.0} {Right 2.0}")
    house.say(robot, "DRIVE {Right 3.0}")
    assert robot.robot.command.target[:4].tolist() == [1, 3, 1, 3]
    house.say(robot, "DRIVE {Light True}")
    assert robot.robot.command.target[:4].tolist() == [1, 3, 1, 3]


def test_of_commands_between_two_steps_the_last_one_counts(house, robot):
    """Manual 14.5. Unlike the original's, a command about something else is not lost."""
    house.say(
        robot,
        "DRIVE {Left 1} {Right 1}\r\nMISPKG {Name CameraPanTilt} {Link 1} {Value 0.3}\r\nDRIVE {Left 3}",
    )
    pan = robot.robot.plan.joint_index("CameraPanTilt_Link1")
    np.testing.assert_allclose(robot.robot.command.target[[0, 1, pan]], [3.0, 1.0, 0.3], rtol=1e-6)


def test_the_headlight(house, robot):
    house.run()
    assert "{LightToggle False} {LightIntensity 0}" in heard(robot)[0]
    house.say(robot, "DRIVE {Light true}")
    house.run()
    assert "{LightToggle True} {LightIntensity 100}" in heard(robot)[0]
    house.say(robot, "DRIVE {Light False}")
    house.run()
    assert "{LightToggle False} {LightIntensity 0}" in heard(robot)[0]


def test_flip_rights_an_overturned_robot(house):
    client = house.connect("INIT {ClassName P2AT} {Location 4.5,1.9,1.6} {Rotation 3.1416,0,0}")
    house.run(5 * TICK)
    assert abs(math.remainder(look(heard(client))[2][3], 2 * math.pi)) > 2.5
    house.say(client, "DRIVE {Flip True}")
    house.run(20 * TICK)
    truth = look(heard(client))[2]
    assert truth[2] == pytest.approx(1.82, abs=0.02)
    assert [math.remainder(a, 2 * math.pi) for a in truth[3:5]] == pytest.approx([0, 0], abs=0.03)


@pytest.mark.parametrize("bad", ["nan", "inf", "-inf", "1e999", "1e300"])
def test_numbers_that_no_float_holds_change_nothing(house, robot, bad):
    house.say(robot, "DRIVE {Left 1.0} {Right 2.0}")
    house.say(robot, "MISPKG {Name CameraPanTilt} {Link 1} {Value 0.25}")
    told = robot.robot.command
    for line in (
        f"DRIVE {{Left {bad}}} {{Right 0}}",
        f"MISPKG {{Name CameraPanTilt}} {{Link 1}} {{Value {bad}}}",
        f"SET {{Type INS}} {{Name INS}} {{Opcode POSE}} {{Params {bad},0,0,0,0,0}}",
    ):
        house.say(robot, line)
    np.testing.assert_array_equal(robot.robot.command.target, told.target)
    np.testing.assert_array_equal(robot.robot.command.mode, told.mode)
    heard(robot)
    house.run()
    assert len(heard(robot)) == len(P2AT_REPORT)


# Mission packages


def pan_tilt(house, robot, *lines, seconds=0):
    for line in lines:
        house.say(robot, "MISPKG {Name CameraPanTilt} " + line)
    house.run(round(seconds / 0.02))
    return house.world.state(robot.robot).joint_pos[4:]


def test_order_0_is_an_angle_as_missta_says(house, robot):
    pan_tilt(house, robot, "{Link 1} {Value 0.3} {Order 0} {Link 2} {Value 0.2}", seconds=3)
    values = re.findall(r"{Value ([^}]*)}", pick(heard(robot), "MISSTA"))
    assert [float(v) for v in values] == pytest.approx([0.3, 0.2], abs=0.01)


def test_order_1_is_a_speed_and_order_3_a_brake(house, robot):
    moved = pan_tilt(house, robot, "{Link 1} {Value 0.1} {Order 1}", seconds=2)
    assert moved[0] == pytest.approx(0.2, abs=0.02)
    stopped = pan_tilt(house, robot, "{Link 1} {Order 3}", seconds=0.4).copy()
    later = pan_tilt(house, robot, seconds=1)
    assert later == pytest.approx(stopped, abs=2e-3)


def test_orders_10_and_11_are_relative(house, robot):
    pan_tilt(house, robot, "{Link 1} {Value 0.2}", seconds=2)
    there = pan_tilt(house, robot, "{Link 1} {Value -0.1} {Order 10}", seconds=2)
    assert there[0] == pytest.approx(0.1, abs=0.01)
    pan_tilt(house, robot, "{Link 1} {Value 0.1} {Order 1}", "{Link 1} {Value -0.04} {Order 11}")
    assert robot.robot.command.target[4] == pytest.approx(0.06)
    pan_tilt(house, robot, "{Link 2} {Value 0.05} {Order 11}")
    assert robot.robot.command.target[5] == pytest.approx(0.05), "it was not told a speed before"


@pytest.mark.parametrize("line", ["{Link 7} {Value 1}", "{Link 0} {Value 1}", "{Link 1} {Value 1} {Order 7}"])
def test_unknown_links_and_orders_are_logged_and_change_nothing(house, robot, caplog, line):
    before = robot.robot.command.target.copy()
    assert house.say(robot, "MISPKG {Name CameraPanTilt} " + line) == []
    np.testing.assert_array_equal(robot.robot.command.target, before)
    assert "no link" in caplog.text or "not supported" in caplog.text


def test_torque_orders_push_and_add_up(house, robot):
    """Order 2 is a torque, 12 adds to the torque in force (KRobot.uc); the pan turns on without a limit."""
    pan_tilt(house, robot, "{Link 1} {Value 0.02} {Order 2}")
    assert robot.robot.command.target[4] == pytest.approx(0.02)
    there = pan_tilt(house, robot, "{Link 1} {Value 0.03} {Order 12}", seconds=1)
    assert robot.robot.command.target[4] == pytest.approx(0.05)
    assert there[0] > 0.1


def test_a_joint_is_driven_by_name_in_any_case(house, robot):
    """Manual 9.4: DRIVE {Name}{Order}{Value}, MULTIDRIVE, SET {Type Joint}, which has no RES (KRobot.uc)."""
    house.say(robot, "DRIVE {Name leftfwheel} {Order 1} {Value 0.175}")
    assert robot.robot.command.target[:4].tolist() == pytest.approx([0.175, 0, 0, 0])
    house.say(robot, "MULTIDRIVE {CameraPanTilt_LINK1 0.3} {cameraPanTilt_link2 0.1}")
    house.run(13 * TICK)
    joints = house.world.state(robot.robot).joint_pos
    assert joints[4:] == pytest.approx([0.3, 0.1], abs=0.01)
    heard(robot)
    assert house.say(robot, "SET {Type Joint} {Name RightFWheel} {Opcode Velocity} {Params 0.5}") == []
    assert robot.robot.command.target[1] == pytest.approx(0.5)
    house.say(robot, "DRIVE {Left 1} {Right 1}")
    assert robot.robot.command.target[:4].tolist() == [1, 1, 1, 1]


@pytest.mark.parametrize(
    ("line", "word"),
    [
        ("DRIVE {Speed 1} {FrontSteer 0.2}", "DRIVE {Speed} {FrontSteer}"),
        ("DRIVE {Name Nose} {Value 1}", "no joint 'Nose'"),
        ("DRIVE {Name LeftFWheel} {Steer 1.57}", "no joint 'LeftFWheel_Steer'"),
        ("MULTIDRIVE {FRFlipper 1}", "no joint 'FRFlipper'"),
        ("DRIVE {Name LeftFWheel} {Order 9} {Value 1}", "no such order as 9"),
        ("DRIVE {WheelNumber 0} {WheelSpeed 1}", "DRIVE {WheelSpeed0}"),
    ],
)
def test_what_another_robot_could_do_is_logged_and_changes_nothing(house, robot, caplog, line, word):
    before = robot.robot.command.target.copy()
    assert house.say(robot, line) == []
    np.testing.assert_array_equal(robot.robot.command.target, before)
    assert word in caplog.text


def test_an_unknown_package_is_logged(house, robot, caplog):
    house.say(robot, "MISPKG {Name Gripper} {Link 1} {Value 1}")
    assert "'Gripper'" in caplog.text


# SET, GETGEO, GETCONF


@pytest.mark.parametrize(
    ("line", "status"),
    [
        ("{Type Odometry} {Name Odometry} {Opcode RESET}", "OK"),
        ("{Type odometry} {Name ODOMETRY} {Opcode reset} {Params }", "OK"),
        ("{Type INS} {Name INS} {Opcode POSE} {Params 1,2,3,0,0,0.5}", "OK"),
        ("{Type INS} {Name INS} {Opcode POSE} {Params 1,2,3}", "Failed"),
        ("{Type RangeScanner} {Name Scanner1} {Opcode SCAN}", "OK"),
        ("{Type Odometry} {Name Odometry} {Opcode SCAN}", "Failed"),
        ("{Type Odometry} {Name Odometry}", "Failed"),
        ("{Type Odometry} {Name Nobody} {Opcode RESET}", "Failed"),
        ("{Type RFID} {Name Gun} {Opcode Release}", "Failed"),
    ],
)
def test_a_set_is_answered_with_an_echo_and_its_status(house, robot, line, status):
    (answer,) = house.say(robot, f"SET {line}")
    kind, name = (re.search(rf"{{{key} ([^}}]*)}}", line)[1] for key in ("Type", "Name"))
    assert re.fullmatch(rf"RES {{Time {F2}}} {{Type {kind}}} {{Name {name}}} {{Status {status}}}", answer)


def test_odometry_starts_anew_at_a_reset(house, robot):
    house.say(robot, "DRIVE {Left 2} {Right 1}")
    house.run(5 * TICK)
    assert math.hypot(*look(heard(robot))[0][:2]) > 0.1
    house.say(robot, "DRIVE {Left 0} {Right 0}")
    house.run(5 * TICK)
    house.say(robot, "SET {Type Odometry} {Name Odometry} {Opcode RESET}")
    house.run()
    assert look(heard(robot))[0] == pytest.approx([0, 0, 0], abs=0.02)


def test_an_ins_pose_comes_back_as_it_was_set(house, robot):
    house.run()
    house.say(robot, "SET {Type INS} {Name INS} {Opcode POSE} {Params 1.0,-2.0,0.5,0.1,0.2,5.0}")
    house.run()
    _, ins, truth = look(heard(robot))
    assert ins == pytest.approx([1.0, -2.0, 0.5, 0.1, 0.2, 5.0], abs=0.011)
    assert truth[:2] == pytest.approx([4.5, 1.9], abs=0.011), "the truth stays"


def test_a_scan_on_demand_is_in_the_next_report(house, robot):
    house.run(TICK)
    assert "RangeScanner" in " ".join(heard(robot))
    house.run(TICK)
    assert "RangeScanner" not in " ".join(heard(robot))
    house.run(2 * TICK)
    heard(robot)
    house.say(robot, "SET {Type RangeScanner} {Name Scanner1} {Opcode SCAN}")
    house.run(TICK)
    assert "RangeScanner" in " ".join(heard(robot))


POSE4 = rf"Location {F4},{F4},{F4} Orientation {F4},{F4},{F4}"


@pytest.mark.parametrize(
    ("asked", "answer"),
    [
        (
            "GETGEO {Type Robot}",
            r"GEO {Type GroundVehicle} {Name P2AT} {Dimensions 0\.5238,0\.4968,0\.2913} "
            r"{COG 0\.0048,-?0\.0000,0\.1032} {WheelRadius 0\.1300} "  # the built one's; captured: 0,0,0
            r"{WheelSeparation 0\.4712} {WheelBase 0\.2884}",
        ),
        ("getgeo {Type Robot} {Name Anything}", r"GEO {Type GroundVehicle} {Name P2AT} .*"),
        ("GETGEO {Type Sonar}", rf"GEO {{Type Sonar}}(?: {{Name [FR][1-8] {POSE4} Mount HARD}}){{16}}"),
        ("GETGEO {Type Sonar} {Name f2}", rf"GEO {{Type Sonar}} {{Name F2 {POSE4} Mount HARD}}"),
        ("GETGEO {Type Camera}", rf"GEO {{Type Camera}} {{Name Camera {POSE4} Mount CameraPanTilt_Link2}}"),
        ("GETGEO {Type MisPkg}", r"GEO {Type MisPkg} {Name CameraPanTilt} {Link 1} .*{Link 2} .*"),
        ("GETGEO {Type Gripper}", r"GEO {Type Gripper}"),
        ("GETGEO {Type Sonar} {Name F9}", r"GEO {Type Sonar} {Name F9}"),
        (
            "GETCONF {Type Robot}",
            r"CONF {Type GroundVehicle} {Name P2AT} {SteeringType SkidSteered} {Mass 14\.0000} "
            r"{MaxSpeed 5\.3850} {MaxTorque 60\.0000} {MaxFrontSteer 0\.0000} {MaxRearSteer 0\.0000}",
        ),
        (
            "GETCONF {Type Sonar} {Name R8}",
            r"CONF {Type Sonar} {Name R8} {MaxRange 5\.0000} {MinRange 0\.1000} {BeamAngle 0\.3491}",
        ),
        (
            "GETCONF {Type RangeScanner}",
            r"CONF {Type RangeScanner} {Name Scanner1} {MaxRange 20\.0000} {MinRange 0\.1000} "
            r"{Resolution 0\.0174} {Fov 3\.1415} {Paning True} {Tilting False}",
        ),
        (
            "GETCONF {Type MisPkg} {Name camerapantilt}",
            r"CONF {Type MisPkg} {Name CameraPanTilt} {Link 1} .*",
        ),
        (
            "GETCONF {Type Camera}",
            r"CONF {Type Camera} {CameraDefFov 0\.8727} {CameraMinFov 0\.3491} {CameraMaxFov 2\.0944} "
            r"{CameraFov 0\.8727}",
        ),
        ("GETCONF {Type RFID}", r"CONF {Type RFID} {Name RFID} {MaxRange 3\.0000}"),
        ("GETCONF {Type Gripper}", r"CONF {Type Gripper}"),
    ],
)
def test_geometry_and_configuration_read_as_captured(house, robot, asked, answer):
    (line,) = house.say(robot, asked)
    assert re.fullmatch(answer, line), line


# Company


def test_two_robots_hear_each_other(house):
    left = house.connect("INIT {ClassName P2AT} {Location 4.5,1.9,1.8}")
    house.run()
    alone = float(re.search(r"F4 Range ([\d.]+)", pick(heard(left), "Sonar"))[1])
    house.connect("INIT {ClassName P2AT} {Location 5.3,1.9,1.8} {Rotation 0,0,3.1416}")
    house.run()
    together = float(re.search(r"F4 Range ([\d.]+)", pick(heard(left), "Sonar"))[1])
    assert together < min(alone, 0.6)


def test_a_departure_leaves_the_others_bit_identical(house, robot):
    house.say(robot, "DRIVE {Left 1.5} {Right 2.0}")
    other = house.connect("INIT {ClassName P2DX} {Start Start2}")
    last = house.connect("INIT {ClassName P2AT} {Start Start5}")
    house.say(last, "DRIVE {Left 1} {Right 1}")
    house.run(2 * TICK)
    before = [house.world.state(client.robot) for client in (robot, last)]
    sonar_count = heard(robot)
    assert sonar_count
    house.leave(other)
    after = [house.world.state(client.robot) for client in (robot, last)]
    for old, new in zip(jax.tree.leaves(before), jax.tree.leaves(after), strict=True):
        np.testing.assert_array_equal(old, new)
    assert len(house.world.robots) == 2
    house.run(TICK)
    assert len(heard(robot)) >= len(P2AT_REPORT) - 1
    assert other.session.phase is SessionPhase.CLOSED


WORDS = st.sampled_from(
    [
        b"INIT ",
        b"DRIVE ",
        b"SET ",
        b"GETGEO ",
        b"GETCONF ",
        b"MISPKG ",
        b"GETSTARTPOSES",
        b"STOP ",
        b"{ClassName ",
        b"USARBot.P2AT}",
        b"{Name ",
        b"CameraPanTilt} ",
        b"{Type ",
        b"INS} ",
        b"Odometry} ",
        b"Sonar} ",
        b"Robot} ",
        b"{Opcode POSE} ",
        b"{Opcode RESET} ",
        b"{Params 1,2,3,1,1,1} ",
        b"{Params 9e37,-9e37,0,1e30,1e30,9e37} ",
        b"{Left 1e38} ",
        b"{Right -3e38} ",
        b"{Flip True} ",
        b"{Light 1} ",
        b"{Normalized True} ",
        b"{Link 1} ",
        b"{Value 3e38} ",
        b"{Order 10} ",
        b"{Order 1} ",
        b"{",
        b"}",
        b"\r",
        b"\n",
        b"\r\n",
        b"\x85\xa0",
        b"\0",
        b"{Rotation 1e30,2,3} ",
        b"{Start Start5} ",
    ]
)
JUNK = st.lists(st.one_of(WORDS, st.binary(max_size=12)), max_size=40).map(b"".join)
LINES = st.sampled_from(
    [
        b"INIT {ClassName P2AT} {Start Start5} {Name \xff}\r\n",
        b"SET {Type INS} {Name INS} {Opcode POSE} {Params 9e37,-9e37,0,1e30,1e30,9e37}\r\n",
        b"DRIVE {Left 3e38} {Right -3e38} {Normalized True}\r\n",
        b"MISPKG {Name CameraPanTilt} {Link 1} {Value 3e38} {Order 10}\r\n",
        b"MISPKG {Name CameraPanTilt} {Link 1} {Value 3e38} {Order 11}\r\n",
        b"GETGEO {Type \x85\xa0}\r\n",
    ]
)


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.one_of(LINES, JUNK), max_size=6))
def test_junk_never_raises_and_never_disturbs_a_neighbour(house, chunks):
    """The neighbour stands at the manual's start; what it reports does not depend on the junk."""
    vandal, neighbour = house.connect(), house.connect(f"INIT {{ClassName P2AT}} {TABLE_2}")
    for chunk in chunks:
        house.say(vandal, chunk)
    house.run(2 * TICK)
    first = heard(neighbour)
    house.leave(vandal)
    house.run()
    assert [line.split()[0] for line in first] == [
        "STA",
        *["SEN"] * 6,
        "MISSTA",
        "STA",
        *["SEN"] * 5,
        "MISSTA",
    ]
    for pattern, line in zip(P2AT_REPORT, first, strict=False):
        assert re.fullmatch(pattern, line), line
    truth = look(heard(neighbour))[2]
    assert truth[:3] == pytest.approx([4.5, 1.9, 1.82], abs=0.015)
    house.leave(neighbour)
