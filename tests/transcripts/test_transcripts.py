"""What original controllers say and are told, step by step, and what their parsers make of it."""

import math
import re
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from tests.arenas import COURSE
from tests.handy import known
from tests.server.test_adapter import House, heard
from tests.transcripts import strict
from tests.transcripts.readers import (
    ScalarReader,
    controller_numbers,
    controller_pieces,
    controller_state,
    player_mounts,
    player_sonars,
    player_value,
    pyro_first,
    pyro_segments,
    scalars,
    simpleui_sonars,
    simpleui_texts,
)
from tests.transcripts.take import take
from tests.transcripts.transcript import HERE, read_transcript, shapes_of
from usarmjx.cli.console.client import NOTE, RECEIVED, SENT
from usarmjx.cli.console.client import Transcript as ConsoleRecord
from usarmjx.models.compile.physics import Physics
from usarmjx.models.files.load import find_arena
from usarmjx.models.ini.robots import load_robots
from usarmjx.models.robots import ROBOTS
from usarmjx.server.gamebots.adapter import Client
from usarmjx.server.protocol.dialects import find_dialect
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.sim.configure import settings_by_kind

NAMES = sorted(path.stem for path in HERE.glob("*.txt"))
CLOSE = 0.03  # rad: servos get there but for what they carry
FOUR_DECIMALS = 1.01e-4


class Played:
    """A transcript that has been played: the lines heard in each step, and where the robot was after each."""

    def __init__(self, house, name):
        self.transcript = read_transcript(name)
        world = house.world
        client = Client(world, str(name), dialect=find_dialect(self.transcript.dialect))
        house.clients.append(client)
        self.lines, self.poses, self.greeting = [], [], heard(client)[0]
        for step in self.transcript.steps:
            lines = house.say(client, step.say.encode() + self.transcript.ends) if step.say else []
            house.run(round(step.wait / world.period))
            self.lines.append(lines + heard(client))
            state = world.state(client.robot) if client.robot else None
            self.poses.append(state and (*state.pos.tolist(), heading(state.quat)))
        self.joints = dict(zip(client.robot.plan.parts[1:], state.joint_pos.tolist(), strict=True))
        self.faults = client.session.fault_count
        self.robot = client.robot
        house.leave(client)

    @property
    def all(self):
        return [line for lines in self.lines for line in lines]

    def last(self, *parts):
        """The last line that has all these parts."""
        return [line for line in self.all if all(part in line for part in parts)][-1]

    def pose_after(self, say):
        """x, y, z and yaw, in the engine's axes, after the first step that says so."""
        number = next(i for i, step in enumerate(self.transcript.steps) if step.say.startswith(say))
        return np.array(self.poses[number])


def heading(quat):
    w, x, y, z = quat
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


@pytest.fixture(scope="module")
def world():
    world = DynamicWorld(COURSE, Physics(), 1, max_robots=4)
    for name in ("P2AT", "P2DX"):
        world.prepare(ROBOTS.get(name))
    return world


@pytest.fixture(scope="module")
def played(world):
    return {name: Played(House(world), name) for name in NAMES}


@pytest.mark.parametrize("name", NAMES)
def test_each_step_is_answered_as_written_down(played, name):
    for step, lines in zip(played[name].transcript.steps, played[name].lines, strict=True):
        assert shapes_of(lines) == step.answers, step


def test_nothing_that_they_say_is_lost_on_the_server(played):
    """But Pyro's PAUSE, which no version of USARSim knew."""
    assert {name: one.faults for name, one in played.items()} == dict.fromkeys(NAMES, 0) | {"pyro": 1}


# Any client


@pytest.mark.parametrize("name", NAMES)
def test_a_strict_parser_reads_every_line(played, name):
    one = played[name]
    for line in (one.greeting, *one.all):
        strict.parse(line, one.transcript.dialect)


@pytest.mark.parametrize(
    ("line", "age"),
    [
        ("SEN {Time 1.0} {Type Sonar} {Name F1 Range}", strict.MANUAL),
        ("RES {Time 1.0} {Type Gripper} {Name} {Status Failed}", strict.MANUAL),
        ("SEN {Type Sonar} {Name F1 Range 2.5}", strict.LATER),
        ("SEN  {Type Sonar}", strict.MANUAL),
        ("SEN {Type Sonar}{Name F1}", strict.LATER),
        ("SEN {Type  Sonar}", strict.MANUAL),
        ("SEN {Type GPS} {Latitude nan}", strict.MANUAL),
        ("SEN {Type RangeScanner} {Range 1.0,,2.0}", strict.MANUAL),
        ("SEN {Type GPS} {Latitude 39,8.0341}", strict.MANUAL),
        ("SEN {Type GPS} {Longitude 77,13.0001,9}", strict.LATER),
        ("SEN {Type PCL} {Points 1.0,2.0,3.0;1.0,2.0}", strict.LATER),
        ("SEN {Type LineLaser} {Points [1.0,2.0,3.0][x,2.0,3.0]}", strict.LATER),
        ("MISSTA {Name Cam} {Link 1}", strict.LATER),
        ("sen {Type Sonar}", strict.MANUAL),
        ("GEO {Type {Sonar}}", strict.MANUAL),
    ],
)
def test_a_strict_parser_refuses(line, age):
    with pytest.raises(strict.NotStrictError):
        strict.parse(line, age)


SAID = [
    ("GETSTARTPOSES", 0.0),
    ("INIT {ClassName USARBot.P2AT} {Name Rec} {Location 0,-2,-0.3} {Rotation 0,0,0}", 0.4),
    ("GETCONF {Type Sonar} {Name F1}", 0.0),
    ("DRIVE {Left 1.0} {Right 1.0}", 0.6),
]


@pytest.mark.parametrize("dialect", ["manual", "udk"])
def test_what_the_console_records_is_a_test_in_one_step(world, tmp_path, dialect):
    house, record, now = House(world), tmp_path / "record.log", [datetime(2026, 1, 1, tzinfo=UTC)]
    client = Client(world, "Rec", dialect=find_dialect(dialect))
    house.clients.append(client)
    with ConsoleRecord(record, lambda: now[0]) as kept:
        kept.write(NOTE, "connected to 127.0.0.1:3000")
        lines = heard(client)
        for said, wait in SAID:
            for line in lines:
                kept.write(RECEIVED, line)
            kept.write(SENT, said)
            for line in house.say(client, said.encode() + b"\r\n"):
                kept.write(RECEIVED, line)
            house.run(round(wait / world.period))
            now[0] += timedelta(seconds=wait)
            lines = heard(client)
        for line in lines:
            kept.write(RECEIVED, line)
    house.leave(client)
    (tmp_path / "rec.txt").write_text(take(record.read_text(), dialect=dialect))
    again = Played(House(world), tmp_path / "rec.txt")
    assert again.transcript.dialect == dialect
    assert [step.say for step in again.transcript.steps if step.say] == [said for said, _ in SAID]
    assert [step.wait for step in again.transcript.steps if step.wait] == [0.4, 0.6]
    for step, lines in zip(again.transcript.steps, again.lines, strict=True):
        assert shapes_of(lines) == step.answers, step
    assert len(again.all) > 20
    with pytest.raises(ValueError, match="line 1 is none of a record"):
        take("> DRIVE {Left 1}")


RECORDED = """
2026-01-01T00:00:00.000Z < NFO {Level course}
2026-01-01T00:00:00.000Z > INIT {ClassName USARBot.P2AT}
2026-01-01T00:00:00.010Z > GETCONF {Type Robot}
2026-01-01T00:00:00.170Z < CONF {Type GroundVehicle}
2026-01-01T00:00:00.250Z < SEN {Time 1.8600} {Type Sonar}
2026-01-01T00:00:00.450Z < SEN {Time 2.06} {Type RangeScanner}
2026-01-01T00:00:00.610Z > DRIVE {Left 1}
2026-01-01T00:00:00.650Z < SEN {Time 2.2600} {Type Sonar}
2026-01-01T00:00:01.350Z < STA {Time 2.86}
2026-01-01T00:00:01.350Z < SEN {Type Odometry}
"""


def test_pauses_of_a_record_are_simulated_time_however_late_answers_and_reports_come():
    steps = take(RECORDED.strip(), about="Slow.").splitlines()[3:]
    assert steps == [
        "> INIT {ClassName USARBot.P2AT}",
        "> GETCONF {Type Robot}",
        "< CONF {Type GroundVehicle}",
        "~ 0.4",
        "< SEN {Time #} {Type Sonar}",
        "< SEN {Time #} {Type RangeScanner}",
        "> DRIVE {Left 1}",
        "~ 0.8",
        "< SEN {Time #} {Type Sonar}",
        "< STA {Time #}",
        "< SEN {Type Odometry}",
    ]


# MOAST, and NIST's node for ROS


def test_moast_learns_the_arena_from_the_greeting(played):
    assert pyro_first(played["moast"].greeting, "Level") == ["course"]
    reader = ScalarReader(played["moast"].greeting)
    assert (reader.head, reader.key(), reader.value(), reader.key(), reader.value()) == (
        "NFO",
        *("Gametype", "BotDeathMatch"),
        *("Level", "course"),
    )


@pytest.mark.parametrize("name", ["moast", "ros"])
def test_scalars_are_read_where_they_stand(played, name):
    one = played[name]
    sonar = ScalarReader(one.last("{Type Sonar}", "SEN", "F2"))
    while sonar.key() != "Name" or sonar.value() != "F2":
        pass
    sonar.expect("Range")
    assert 0.1 <= sonar.reals(1)[0] <= 5.0
    scan = scalars(one.last("SEN", "{Type RangeScanner}"), {"Resolution": 1, "FOV": 1, "Range": "rest"})
    assert len(scan["Range"]) == 181 <= 192, "no more beams than its buffer has"
    robot = {"Dimensions": 3, "COG": 3, "WheelRadius": 1, "WheelSeparation": 1, "WheelBase": 1}
    geometry = scalars(one.last("GEO", "{Type GroundVehicle}"), robot)
    assert (geometry["WheelRadius"], geometry["WheelSeparation"]) == ((0.13,), (0.4712,))
    drive = {"SteeringType": "word", "Mass": 1, "MaxSpeed": 1, "MaxTorque": 1}
    assert scalars(one.last("CONF", "{Type GroundVehicle}"), drive)["SteeringType"] == "SkidSteered"
    mount = ScalarReader(one.last("GEO", "{Type Sonar}"))
    while mount.key() != "Name":
        mount.value()
    mount.expect("F2")
    mount.expect("Location")
    place = mount.reals(3)
    mount.expect("Orientation")
    turned = mount.reals(3)
    mount.expect("Mount")
    (real,) = (item for item in one.robot.spec.sensors if item.name == "F2")
    assert (*place, *turned) == pytest.approx((*real.at, *real.direction), abs=FOUR_DECIMALS)
    assert mount.value() == {"moast": "HARD", "ros": "P3AT"}[name]


def test_moasts_robot_stands_where_it_was_told_and_drives_and_stops(played):
    moast = played["moast"]
    before, after = moast.pose_after("Drive {Left 2"), np.array(moast.poses[-2])
    assert before[:2] == pytest.approx((0.0, 4.0), abs=0.02), "the wire's y is to the right"
    assert np.linalg.norm(after[:2] - before[:2]) > 0.15
    assert after[3] < before[3] - 0.05, "left faster than right turns to the right"
    assert np.array(moast.poses[-1])[:2] == pytest.approx(after[:2], abs=0.05), "and stands then"
    truth = scalars(moast.last("{Type GroundTruth}"), {"Location": 3, "Orientation": 3})
    x, y, _ = truth["Location"]
    assert (x, -y) == pytest.approx(moast.poses[-1][:2], abs=0.006)


@pytest.mark.parametrize(("name", "head"), [("moast", "MISSTA"), ("ros", "ASTA")])
def test_the_state_of_a_package_is_read_by_links(played, name, head):
    reader, links = ScalarReader(played[name].last(head, "CameraPanTilt")), {}
    while key := reader.key():
        value = reader.value()
        if key == "Link":
            link = int(value)
        elif key == "Value":
            links[link] = float(value)
    joints = played[name].joints
    real = [joints[f"CameraPanTilt_Link{number}"] for number in (1, 2)]
    assert [links[1], links[2]] == pytest.approx(real, abs=FOUR_DECIMALS)
    told = {"moast": (0.1, 0.05), "ros": (0.3, 0.1)}[name]
    assert real == pytest.approx(told, abs=CLOSE)


def test_ros_hears_of_its_actuator_what_it_waits_for(played):
    ros = played["ros"]
    geometry = ScalarReader(ros.last("GEO", "{Type Actuator}"))
    assert [geometry.key(), geometry.value(), geometry.key(), geometry.value()] == [
        *("Type", "Actuator"),
        *("Name", "CameraPanTilt"),
    ]
    for word, count in (("Location", 3), ("Orientation", 3)):
        geometry.expect(word)
        geometry.reals(count)
    geometry.expect("Mount")
    assert geometry.value() == "P3AT", "the class, as the later server's items say it"
    assert [geometry.key(), geometry.value(), geometry.key(), geometry.value()] == [
        "Link",
        "1",
        "Parent",
        "0",
    ]
    links = re.findall(r"{Link (\d)} {JointType (\w+)}", ros.last("CONF", "{Type Actuator}"))
    assert links == [("1", "Revolute"), ("2", "Revolute")]


def test_every_reading_for_ros_has_its_time_and_names_one_item(played):
    for line in played["ros"].all:
        if line.startswith("SEN"):
            assert line.startswith("SEN {Time "), line
            assert line.count("{Name ") == 1, line


# Player


def test_players_position_driver_learns_how_to_drive(played):
    player = played["player"]
    configuration = player.last("CONF", "{Type GroundVehicle}")
    assert player_value(configuration, "SteeringType") == "SkidSteered"
    numbers = [
        float(player_value(configuration, key)) for key in ("Mass", "MaxSpeed", "MaxTorque", "MaxFrontSteer")
    ]
    assert numbers == [14.0, 5.385, 60.0, 0.0]
    geometry = player.last("GEO", "{Type GroundVehicle}")
    assert float(player_value(geometry, "WheelRadius")) == 0.13
    assert float(player_value(geometry, "WheelSeparation")) == 0.4712
    assert len(player_value(geometry, "Dimensions").split(",")) == 3


def test_players_robot_drives_by_it_and_its_odometry_begins_anew(played):
    player = played["player"]
    start, end = player.pose_after("DRIVE {Left 2"), player.pose_after("SET {Type Odometry}")
    assert start[:2] == pytest.approx((0.0, 4.0), abs=0.02), "a vector with spaces"
    assert end[0] - start[0] == pytest.approx(0.26, abs=0.05), "2 rad/s of wheels of 0.13 m for a second"
    poses = [
        player_value(line, "Pose") for line in player.all if "{Type Odometry}" in line and "Pose" in line
    ]
    ways = [float(pose.split(",")[0]) for pose in poses]
    assert max(ways) > 0.2
    assert abs(ways[-1]) < 0.05


def test_players_sonars_come_in_arrays_by_their_first_letter(played):
    player = played["player"]
    line = player.last("SEN", "{Type Sonar}")
    assert [len(player_sonars(line, letter)) for letter in "FR"] == [8, 8]
    assert player_value(line, "Name") == "F1"
    mounts = player_mounts(player.last("GEO", "{Type Sonar}"))
    real = {
        item.name: (item.at, item.direction) for item in player.robot.spec.sensors if item.kind == "Sonar"
    }
    assert mounts.keys() == real.keys()
    for name, (place, turned) in mounts.items():
        expected = (*real[name][0], *real[name][1])
        assert (*place, *turned) == pytest.approx(expected, abs=FOUR_DECIMALS)


def test_players_laser(played):
    player = played["player"]
    scan = [float(text) for text in player_value(player.last("SEN", "RangeScanner"), "Range").split(",")]
    assert len(scan) == 181
    configuration = player.last("CONF", "{Type RangeScanner}")
    fov, step = (float(player_value(configuration, key)) for key in ("Fov", "Resolution"))
    assert (fov, step) == (3.1415, 0.0174)
    assert list(player_mounts(player.last("GEO", "{Type RangeScanner}"))) == ["Scanner1"]


def test_players_camera_turns_and_zooms(played):
    """Its pan is positive to the right on the wire, our link's to the left."""
    player = played["player"]
    pan, tilt = (player.joints[f"CameraPanTilt_Link{link}"] for link in (1, 2))
    assert (pan, tilt) == pytest.approx((0.2, 0.1), abs=CLOSE)
    assert float(player_value(player.last("RES", "Camera"), "Status")) == 0.5
    assert float(player_value(player.last("CONF", "{Type Camera}"), "CameraDefFov")) == 0.8727


# Pyro


def test_pyro_reads_every_line(played):
    for line in played["pyro"].all:
        assert pyro_segments(line), line


def test_pyro_learns_its_sensors_and_hears_them(played):
    pyro = played["pyro"]
    places = [
        segment["Location"]
        for segment in pyro_segments(pyro.last("GEO", "{Type Sonar}"))
        if "Name" in segment
    ]
    assert len(places) == 8
    assert float(pyro_first(pyro.last("CONF", "{Type Sonar}"), "MaxRange")[0]) == 5.0
    assert float(pyro_first(pyro.last("CONF", "{Type RangeScanner}"), "Fov")[0]) == 3.1415
    assert float(pyro_first(pyro.last("CONF", "{Type Encoder}"), "Resolution")[0]) > 0.0
    ranges = [s["Range"] for s in pyro_segments(pyro.last("SEN", "{Type Sonar}")) if "Range" in s]
    assert len(ranges) == 8
    (scan,) = [s["Range"] for s in pyro_segments(pyro.last("SEN", "{Type RangeScanner}")) if "Range" in s]
    assert len(scan) == 181
    assert len([s for s in pyro_segments(pyro.last("{Type Encoder}", "Tick")) if "Tick" in s]) == 2
    assert int(pyro_first(pyro.last("STA {Type"), "Battery")[0]) > 1000
    assert float(pyro_first(pyro.last("RES"), "Status")[0]) == 0.6, "the field of view that it zooms to"


def test_pyros_robot_stands_where_its_world_file_says_and_drives(played):
    pyro = played["pyro"]
    start = pyro.pose_after("GETGEO {Type Sonar}")
    assert start[:2] == pytest.approx((0.0, 4.0), abs=0.02), "INIT without its last brace"
    x, y, turned = (float(text) for text in pyro_first(pyro.last("Odometry"), "Pose"))
    assert np.array(pyro.poses[-1])[0] - start[0] > 0.15
    assert (x, -y, turned) == pytest.approx((*(np.array(pyro.poses[-1])[:2] - start[:2]), 0.0), abs=0.05)


def test_player_reads_the_true_pose(played):
    """Its localization that is none: from STA once, from the sensor for it in later drivers."""
    player = played["player"]
    line = player.last("{Type GroundTruth}")
    x, y, _ = (float(text) for text in player_value(line, "Location").split(","))
    yaw = float(player_value(line, "Orientation").split(",")[2])
    assert (x, -y) == pytest.approx(player.poses[-1][:2], abs=0.006)
    assert math.remainder(-yaw - player.poses[-1][3], math.tau) == pytest.approx(0.0, abs=0.006)


def test_players_position3d_turns_as_its_inu_says(tmp_path):
    """It looks for readings of a type INU, which V3.1.3 calls INS; a class of either name may be mounted."""
    path = tmp_path / "USARBot.ini"
    path.write_text(
        "[USARBot.P2AT]\nAddSensors=(ItemClass=class'USARBot.INUSensor',ItemName=Gyro)\n[USARBot.INU]\nSigma=0\n"
    )
    (robot,) = load_robots([path], ROBOTS, settings=settings_by_kind()).robots
    world = DynamicWorld(COURSE, Physics(), 1, max_robots=1)
    with known(replace(robot, name="Minded")):
        house = House(world)
        client = house.connect("INIT {ClassName Minded} {Location 0,-4,-0.3} {Rotation 0,0,0.5}")
        house.run(30)
        lines = [line for line in heard(client) if "{Type INU}" in line]
        roll, pitch, yaw = (float(text) for text in player_value(lines[-1], "Orientation").split(","))
        told = [math.remainder(angle, math.tau) for angle in (roll, pitch, yaw)]
        assert told == pytest.approx((0.0, 0.0, 0.5), abs=0.02)
        (conf,) = house.say(client, "GETCONF {Type INU}")
        assert conf == "CONF {Type INU} {Name Gyro} {ScanInterval 0.2000}"
        house.leave(client)


def test_two_simulation_devices_of_player_are_two_robots(world):
    """Each has its own connection; what the drivers of one say moves that one alone."""
    house, said = House(world), [step.say for step in read_transcript("player").steps if step.say]
    one, other = (
        house.connect(said[0].replace("robot1", name).replace("-4.0", f"{y}.0"))
        for name, y in (("robot1", -4), ("robot2", -6))
    )
    house.run(10)
    places = [world.state(client.robot).pos.copy() for client in (one, other)]
    house.say(one, next(line for line in said if line.startswith("DRIVE")))
    house.run(50)
    ways = [np.linalg.norm(world.state(c.robot).pos - at) for c, at in zip((one, other), places, strict=True)]
    assert ways == pytest.approx([0.26, 0.0], abs=0.05)
    for client in (one, other):
        assert player_value(next(line for line in heard(client) if "{Type Odometry}" in line), "Pose")
        house.leave(client)


@pytest.mark.parametrize("name", ["DM-USAR_yellow", "DM-USAR_orange", "DM-USAR_red"])
def test_maps_of_pyros_world_files_are_there_and_are_called_so(name):
    """Manual 13.2.1; the greeting tells the name."""
    assert find_arena(name).name == name


def test_pyro_drives_a_p2at_as_well(world):
    house, transcript = House(world), read_transcript("pyro")
    client = house.connect()
    for step in transcript.steps:
        lines = (
            house.say(client, step.say.replace("P2DX", "P2AT").encode() + transcript.ends) if step.say else []
        )
        house.run(round(step.wait / world.period))
        assert all(pyro_segments(line) for line in lines + heard(client))
    assert client.robot.spec.name == "P2AT"
    assert world.state(client.robot).pos[0] > 0.15
    house.leave(client)


# SimpleUI


def test_simpleui_shows_the_state_the_ranges_and_the_place_of_its_robot(played):
    simple = played["simpleui"]
    lit = next(line for line in simple.all if line.startswith("STA") and "{LightToggle True}" in line)
    assert simpleui_texts(lit, "LightIntensity") == ["100"]
    assert simpleui_texts(simple.last("STA {Type"), "LightToggle") == ["False"]
    assert float(simpleui_texts(lit, "Battery")[0]) > 1000.0
    assert len(simpleui_sonars(simple.last("{Type Sonar}"))) == 16
    scan = simple.last("{Type RangeScanner}")
    assert len(simpleui_texts(scan, "Range")[0].split(",")) == 181, "as many as its array has room for"
    truth = simple.last("{Type GroundTruth}")
    (x, y, _), (*_, yaw) = (
        [float(number) for number in simpleui_texts(truth, key)[0].split(",")]
        for key in ("Location", "Orientation")
    )
    assert (x, -y) == pytest.approx(simple.poses[-1][:2], abs=0.006)
    assert math.remainder(yaw + simple.poses[-1][3], math.tau) == pytest.approx(0.0, abs=0.006)


def test_simpleuis_buttons_drive_turn_the_camera_by_steps_and_zoom(played):
    """Its CAMERA has the steps of its arrows, 0.1917 rad each: twice to the right, once up."""
    simple = played["simpleui"]
    start, ahead, turned = (simple.pose_after(say) for say in ("INIT", "DRIVE {Left -0.5", "DRIVE {Left 0}"))
    assert ahead[0] - start[0] > 0.2
    assert turned[3] - ahead[3] > 0.05, "its left arrow"
    pan, tilt = (simple.joints[f"CameraPanTilt_Link{link}"] for link in (1, 2))
    assert (pan, tilt) == pytest.approx((-2 * 0.1917, 0.1917), abs=CLOSE)
    assert simple.robot.fovs[0] == pytest.approx(0.7854)


# USARSimController, a library in Java, and the examples of its author: recorded while the programs ran


@pytest.mark.parametrize("name", ["hellorobot", "moverobot", "usarsimcontroller"])
def test_usarsimcontroller_reads_the_place_and_the_state_of_its_robot(played, name):
    one = played[name]
    kind, _, location, orientation = controller_pieces(one.last("{Type GroundTruth}"))
    (x, y, z), (*_, yaw) = controller_numbers(location), controller_numbers(orientation)
    assert kind == "GroundTruth"
    assert (x, -y, -z) == pytest.approx(one.poses[-1][:3], abs=0.006)
    assert math.remainder(yaw + one.poses[-1][3], math.tau) == pytest.approx(0.0, abs=0.006)
    for line in one.all:
        if line.startswith("STA"):
            state = controller_state(line)
            assert (state["LightIntensity"], state["View"]) == (0, -1)
            assert state["Battery"] > 1000


@pytest.mark.parametrize("name", ["hellorobot", "usarsimcontroller"])
def test_usarsimcontroller_reads_ranges_by_their_places(played, name):
    _, *sonars = controller_pieces(played[name].last("{Type Sonar}"))
    words = [piece.split(" ") for piece in sonars]
    assert [word[1] for word in words] == [f"{side}{number}" for side in "FR" for number in range(1, 9)]
    assert all(0.1 <= float(word[3]) <= 5.0 for word in words)
    _, scanner, step, fov, ranges = controller_pieces(played[name].last("{Type RangeScanner}"))
    assert scanner == "Name Scanner1"
    assert (controller_numbers(step), controller_numbers(fov)) == ([0.0174], [3.1415])
    assert len(controller_numbers(ranges)) == 181, "MAX_LASER of its constants"


def test_hellorobot_falls_from_its_place_on_another_map_to_the_floor(played):
    start, end = played["hellorobot"].pose_after("INIT"), np.array(played["hellorobot"].poses[-1])
    assert start[:3] == pytest.approx((47.17, 55.7, 2.25), abs=0.02)
    assert end[:2] == pytest.approx(start[:2], abs=0.02)
    assert 0.1 < end[2] < 0.3, "on its wheels"


def test_moverobot_climbs_and_flies_ahead_at_a_metre_a_second(played):
    move = played["moverobot"]
    start, end = move.pose_after("DRIVE"), np.array(move.poses[-1])
    assert end[1] == pytest.approx(start[1], abs=0.05)
    assert end[[0, 2]] - start[[0, 2]] == pytest.approx((3.6, 3.6), abs=0.6), "less the time to get up speed"


def test_usarsimcontroller_drives_ahead_turns_to_the_right_and_stops(played):
    one = played["usarsimcontroller"]
    says = ("DRIVE {Left 2.000000} {Right 2", "DRIVE {Left 2.000000} {Right -2", "DRIVE {Left 0")
    start, ahead, turned = (one.pose_after(say) for say in says)
    assert ahead - start == pytest.approx((0.26 * 1.8, 0.0, 0.0, 0.0), abs=0.05), "2 rad/s, wheels of 0.13 m"
    assert turned[3] < ahead[3] - 0.8
    end = np.array(one.poses[-1])
    assert end[:3] == pytest.approx(turned[:3], abs=0.02)
    assert end[3] == pytest.approx(turned[3], abs=0.1), "it brakes from 0.8 rad/s"
    _, _, pose = controller_pieces(one.last("{Type Odometry}"))
    assert controller_numbers(pose)[0] == pytest.approx(ahead[0] - start[0], abs=0.05)
