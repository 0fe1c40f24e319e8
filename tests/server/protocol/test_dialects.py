"""The words of the later versions; those that nodes for ROS were written for."""

import math

import pytest

from tests.models.ini.texts import load_texts
from tests.server.peers import say
from tests.server.still_world import StillWorld
from usarmjx.base.errors import UsageError
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.robots import ROBOTS
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.server.gamebots.adapter import Client
from usarmjx.server.gamebots.sensors import geometry
from usarmjx.server.protocol.commands import (
    DriveRobot,
    GetConf,
    Init,
    LinkCommand,
    MisPkg,
    Set,
    SetJoint,
    SetStiffness,
)
from usarmjx.server.protocol.dialects import DIALECTS, MANUAL, UDK, find_dialect
from usarmjx.server.protocol.grammar import format_message, parse_message
from usarmjx.server.protocol.reports import nfo_greeting
from usarmjx.server.protocol.session import RobotSession

TOLD = [  # the manual's line, and what is heard instead
    (
        "MISSTA {Time 62.01} {Name CameraPanTilt} {Link 1} {Value 0.2000} {Torque -0.50}"
        " {Link 2} {Value 0.0000} {Torque 0.10}",
        ["ASTA {Time 62.01} {Name CameraPanTilt} {Link 1} {Value 0.2000} {Link 2} {Value 0.0000}"],
    ),
    (
        "SEN {Time 62.0100} {Type Sonar} {Name F1 Range 2.5098} {Name F2 Range 5.0000}",
        [
            "SEN {Time 62.0100} {Type Sonar} {Name F1} {Range 2.5098}",
            "SEN {Time 62.0100} {Type Sonar} {Name F2} {Range 5.0000}",
        ],
    ),
    (
        "SEN {Time 1.0000} {Type Encoder} {Name ECLeft Tick 4} {Name ECRight Tick -5}",
        [
            "SEN {Time 1.0000} {Type Encoder} {Name ECLeft} {Tick 4}",
            "SEN {Time 1.0000} {Type Encoder} {Name ECRight} {Tick -5}",
        ],
    ),
    (  # Encoder.uc
        "SEN {Time 1.0000} {Type Encoder} {Name EncTestW1 Tick 4} {Name W2 Tick -5}",
        [
            "SEN {Time 1.0000} {Type Encoder} {Name W1} {Tick 4}",
            "SEN {Time 1.0000} {Type Encoder} {Name W2} {Tick -5}",
        ],
    ),
    (
        "GEO {Type Sonar} {Name F2 Location 0.1850,-0.1150,0.0000"
        " Orientation 0.0000,0.0000,-0.8727 Mount HARD}",
        [
            "GEO {Type Sonar} {Name F2} {Location 0.1850,-0.1150,0.0000}"
            " {Orientation 0.0000,0.0000,-0.8727} {Mount HARD}"
        ],
    ),
    (
        "GEO {Type Camera} {Name Camera Location 0.1,0,0 Orientation 0,0,0 Mount CameraPanTilt_Link2}",
        [
            "GEO {Type Camera} {Name Camera} {Location 0.1,0,0} {Orientation 0,0,0}"
            " {Mount CameraPanTilt} {MountLink 2}"
        ],
    ),
    (
        "GEO {Type Camera} {Name Camera Location 0.1,0,0 Orientation 0,0,0 Mount kenafCameraTilt}",
        ["GEO {Type Camera} {Name Camera} {Location 0.1,0,0} {Orientation 0,0,0} {Mount kenafCameraTilt}"],
    ),
    (
        "GEO {Type Actuator} {Name Cam} {Link 1} {ParentLink -1} {Location 0.1,0,0} {Orientation 3.1,0,0}"
        " {Link 2} {ParentLink 1} {Location 0,0,0.05} {Orientation 1.5,0,0}",
        [
            "GEO {Type Actuator} {Name Cam} {Location 0.0000,0.0000,0.0000}"
            " {Orientation 0.0000,0.0000,0.0000} {Mount HARD}"
            " {Link 1} {Parent 0} {Location 0.1,0,0} {Orientation 3.1,0,0}"
            " {Link 2} {Parent 1} {Location 0,0,0.05} {Orientation 1.5,0,0}"
            " {Tip 0.0000,0.0000,0.0000}"
        ],
    ),
    ("GEO {Type Actuator} {Name Nothing}", ["GEO {Type Actuator} {Name Nothing}"]),
    ("CONF {Type MisPkg} {Name Cam} {Link 1}", ["CONF {Type MisPkg} {Name Cam} {Link 1}"]),
    (
        "CONF {Type Actuator} {Name Cam} {Link 1} {JointType Revolute} {MaxSpeed 0.17} {MaxTorque 20.00}"
        " {MinRange 1.00} {MaxRange 0.00}",
        [
            "CONF {Type Actuator} {Name Cam} {Link 1} {JointType Revolute} {MaxSpeed 0.17}"
            " {MaxTorque 20.00} {MinValue 1.00} {MaxValue 0.00}"
        ],
    ),
    ("SEN {Time 1.0000} {Type Battery} {Name battery} {Time 1199.0000}", []),  # Battery.uc, ClientTimer
    (
        "SEN {Time 1.0000} {Type Touch} {Name T1 Touch True} {Name T2 Touch False}",
        [
            "SEN {Time 1.0000} {Type Touch} {Name T1} {Touch True}",
            "SEN {Time 1.0000} {Type Touch} {Name T2} {Touch False}",
        ],
    ),
    (
        "SEN {Time 1.0000} {Type IR} {Name IR1 Range 0.2000}",
        ["SEN {Time 1.0000} {Type IR} {Name IR1} {Range 0.2000}"],
    ),
    (  # RangeScanner.uc
        "CONF {Type RangeScanner} {Name S} {Resolution 0.0174} {Fov 3.1415} {Paning True} {Tilting False}",
        ["CONF {Type RangeScanner} {Name S} {Resolution 0.0174} {Fov 3.1415} {Panning True} {Tilting False}"],
    ),
    (  # IRScanner.uc
        "CONF {Type IRScanner} {Name S} {Resolution 0.0174} {Fov 3.1415} {Paning True} {Tilting False}",
        ["CONF {Type IRScanner} {Name S} {Resolution 0.0174} {Fov 3.1415} {Paning True} {Tilting False}"],
    ),
    *(  # in which they are the same
        (line, [line])
        for line in (
            "SEN {Time 1.0000} {Type GPS} {Name G} {Latitude 39,8.0341,N} {Longitude 77,13.0001,W}"
            " {Fix 1} {Satellites 11}",  # GPSSensor.uc
            "SEN {Time 1.0000} {Type GPS} {Name G} {Fix 0} {Satellites 3}",
            "SEN {Time 1.0000} {Type IRScanner} {Name S} {Resolution 0.0174} {FOV 3.1415} {Range 1.0,2.0}",
        )
    ),
    ("STA {Type GroundVehicle} {Time 1.00}", ["STA {Type GroundVehicle} {Time 1.00}"]),
    ("SEN {Type Odometry} {Name O} {Pose 1,2,3}", ["SEN {Type Odometry} {Name O} {Pose 1,2,3}"]),
    ("CONF {Type Sonar} {Name F1} {MaxRange 5}", ["CONF {Type Sonar} {Name F1} {MaxRange 5}"]),
    (
        "SEN {Time 5.0} {Type VictSensor} {Status NoVictims}",
        ["SEN {Time 5.0} {Type VictSensor} {Status NoVictims}"],
    ),
]


@pytest.mark.parametrize(("line", "heard"), TOLD, ids=[line.split("} {Name")[0] for line, _ in TOLD])
def test_what_udk_says(line, heard):
    message = parse_message(line)
    assert [format_message(one) for one in UDK.translate(message)] == heard
    assert list(MANUAL.translate(message)) == [message]


def test_a_package_has_the_tip_of_its_section(tmp_path):
    """TipOffset of Actuator.uc is in metres, and the origin unless a file says otherwise."""
    mast = "[USARMisPkg.Mast]\nLinks=(Number=1)\nTipOffset=(X=0.1,Y=0,Z=-0.25)\n"
    robot = (
        "[USARBot.P2AT]\nAddMisPkgs=(PkgName=Pole,Location=(X=0,Y=0,Z=0),PkgClass=Class'USARMisPkg.Mast')\n"
    )
    loaded = load_texts(tmp_path, [mast, robot], (P2AT,))
    (mounted,) = [one for one in loaded.robots if one.name == "P2AT"]
    (actuators,) = geometry(kinematic_tree_of(mounted), "Actuator", "", UDK.package_types)
    (heard,) = UDK.translate(actuators)
    assert heard.all("Name") == ("CameraPanTilt", "Pole")
    assert heard.all("Tip") == ("0.0000,0.0000,0.0000", "0.1000,0.0000,-0.2500")
    assert heard.segments[-1][0] == "Tip"
    (packages,) = geometry(kinematic_tree_of(mounted), "MisPkg", "")
    assert packages.all("Tip") == (), "the manual has none"


ASKED = [
    (
        "ACT {Name Cam} {Link 0} {Value 0.2} {Link 1} {Value -0.1}",
        MisPkg("Cam", (LinkCommand(1, 0.2), LinkCommand(2, -0.1))),
    ),
    ("MISPKG {Name Cam} {Link 1} {Value 0.2} {Order 0}", MisPkg("Cam", (LinkCommand(1, 0.2),))),
    ("GETCONF {Type actuator} {Name Cam}", GetConf("actuator", "Cam")),
    ("GETCONF {Type Gripper}", GetConf("Gripper")),
    ("SET {Type Joint} {Name Arm} {Opcode Target} {Params 0.5}", SetJoint("Arm", 0, 0.5, None)),
    ("SET {Type Joint} {Name Arm} {Opcode Angle} {Params 0.5}", SetJoint("Arm", 0, 0.5, None)),
    ("SET {Type Joint} {Name Arm} {Opcode Stiffness} {Params 0.5}", SetStiffness("Arm", 0.5)),
    ("Drive {Left 1.0} {Right 1.0}", DriveRobot((("Left", 1.0), ("Right", 1.0)))),
    # AerialVehicle.uc: degrees a second, or hundredths of the most
    ("DRIVE {rotationalvelocity 90}", DriveRobot((("RotationalVelocity", math.pi / 2),))),
    (
        "DRIVE {AltitudeVelocity 1} {RotationalVelocity -45} {Normalized false} {PitchAngle 0} {Spin1 9}",
        DriveRobot((("AltitudeVelocity", 1.0), ("RotationalVelocity", -math.pi / 4))),
    ),
    (
        "DRIVE {RotationalVelocity 90} {Normalized True}",
        DriveRobot((("RotationalVelocity", 90.0),), normalized=True),
    ),
    ("SET {Type Camera} {Name C} {Opcode FOV} {Params 0.5}", Set("Camera", "C", "Zoom", "0.5")),
    ("SET {Type Camera} {Name C} {Opcode Zoom} {Params 0.5}", Set("Camera", "C", "Zoom", "0.5")),
    ("SET {Type RangeScanner} {Name S} {Opcode SCAN}", Set("RangeScanner", "S", "SCAN", "")),
]


@pytest.mark.parametrize(("line", "command"), ASKED)
def test_what_udk_understands(line, command):
    session = RobotSession(nfo_greeting("DM-Test"), dialect=UDK)
    (init,) = session.receive_data(b"INIT {Classname USARBot.P3AT} {Name R} {Start Start1}\r\n")
    assert init == Init("P3AT", "R", start="Start1")
    session.answer_init(True)
    assert session.receive_data(line.encode() + b"\r\n") == [command]


def test_items_on_the_chassis_are_mounted_on_the_class_that_init_named():
    session = RobotSession(nfo_greeting("DM-Test"), dialect=UDK)
    session.receive_data(b"INIT {ClassName USARBot.P3AT} {Name R} {Start Start1}\r\n")
    session.answer_init(True)
    session.data_to_send()
    for line in (
        "GEO {Type Sonar} {Name F2 Location 1,2,3 Orientation 0,0,0 Mount HARD}",
        "GEO {Type Actuator} {Name Cam} {Link 1} {ParentLink -1} {Location 0.1,0,0} {Orientation 3.1,0,0}",
    ):
        session.send(parse_message(line))
    sonar, package = session.data_to_send().decode().splitlines()
    assert sonar == "GEO {Type Sonar} {Name F2} {Location 1,2,3} {Orientation 0,0,0} {Mount P3AT}"
    assert (
        "{Name Cam} {Location 0.0000,0.0000,0.0000} {Orientation 0.0000,0.0000,0.0000} {Mount P3AT} {Link 1}"
        in package
    )


@pytest.mark.parametrize(
    ("asked", "told"), [("USARBot.P3AT", "P3AT"), ("usarbot.p3at", "P3AT"), ("p2at", "P2AT")]
)
def test_a_robot_is_named_by_its_class_and_so_is_the_mount_of_its_items(asked, told):
    """`self.Class` in WheeledVehicle.uc and `Platform.Class` in Sensor.uc are one word."""
    client = Client(StillWorld(), "A", dialect=UDK)
    say(client, f"INIT {{ClassName {asked}}} {{Name R}}")
    assert say(client, "GETGEO {Type Sonar} {Name F1}")[0].endswith(f"{{Mount {told}}}")
    for kind in ("GEO", "CONF"):
        (line,) = say(client, f"GET{kind} {{Type Robot}}")
        assert line.startswith(f"{kind} {{Type GroundVehicle}} {{Name {told}}} {{")


@pytest.mark.parametrize("name", ["", " {Name Camera}"])
def test_a_single_camera_has_a_name(name):
    """Item.uc: CONF of every item begins with it."""
    answers = {}
    for dialect in (MANUAL, UDK):
        client = Client(StillWorld(), "A", dialect=dialect)
        say(client, "INIT {ClassName USARBot.P2AT} {Name R}")
        (answers[dialect.name],) = say(client, f"GETCONF {{Type Camera}}{name}")
    assert answers["manual"].startswith("CONF {Type Camera} {CameraDefFov ")
    assert answers["udk"] == answers["manual"].replace("{Type Camera}", "{Type Camera} {Name Camera}")


def test_what_is_no_turning_rate_changes_nothing():
    session = RobotSession(nfo_greeting("DM-Test"), dialect=UDK)
    session.receive_data(b"INIT {ClassName USARBot.AirRobot} {Name R}\r\n")
    session.answer_init(True)
    for turn, normalized in (("fast", ""), ("1e999", ""), ("5", "{Normalized nan}")):
        line = f"DRIVE {{LinearVelocity 1}} {{RotationalVelocity {turn}}} {normalized}\r\n"
        assert session.receive_data(line.encode()) == []
    assert session.fault_count == 3


def test_the_manual_knows_none_of_it():
    session = RobotSession(nfo_greeting("DM-Test"))
    (init,) = session.receive_data(b"INIT {Classname USARBot.P3AT} {Name R}\r\n")
    assert init.class_name == "P3AT"
    session.answer_init(True)
    assert session.receive_data(b"ACT {Name Cam} {Link 0} {Value 0.2}\r\n") == []
    assert session.receive_data(b"GETGEO {Type Actuator}\r\n")[0].type == "Actuator"
    (turn,) = session.receive_data(b"DRIVE {RotationalVelocity 1}\r\n")
    assert turn == DriveRobot((("RotationalVelocity", 1.0),))


@pytest.mark.parametrize("dialect", [MANUAL, UDK])
@pytest.mark.parametrize("name", ["P3AT", "p3at", "P2AT"])
def test_class_names_of_both_ages_are_known_in_both_dialects(name, dialect):
    client = Client(StillWorld(), "A", dialect=dialect)
    assert client.robot_class(Init(name, "R")) is ROBOTS.get("P2AT")
    assert client.robot_class(Init("P4AT", "R")) is None


def test_a_dialect_is_found_by_its_name():
    assert [find_dialect(name) for name in DIALECTS] == [MANUAL, UDK]
    with pytest.raises(UsageError, match="unknown dialect 'b'; known: manual, udk"):
        find_dialect("b")
