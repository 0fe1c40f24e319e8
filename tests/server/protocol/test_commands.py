"""What client lines ask for: the manual's examples and the habits of real controllers."""

import pytest

from usarmjx.base.errors import PeerError
from usarmjx.server.protocol.command_parsers import COMMANDS, parse_command
from usarmjx.server.protocol.commands import (
    DRIVE_KEYS,
    DriveJoint,
    DriveRobot,
    DriveWheels,
    GetConf,
    GetGeo,
    GetStartPoses,
    Ignored,
    Init,
    LinkCommand,
    MisPkg,
    MultiDrive,
    Set,
    SetFov,
    SetJoint,
    SetView,
    SetViewports,
    Trace,
    TurnCamera,
    WheelCommand,
)
from usarmjx.server.protocol.grammar import parse_message


def skid(left, right, **switches):
    return DriveRobot((("Left", left), ("Right", right)), **switches)


UNDERSTOOD = [
    # The manual's own examples.
    pytest.param(
        "INIT {ClassName USARBot.P2DX} {Location 4.5,1.9,1.8} {Name R1}",
        Init("P2DX", "R1", (4.5, 1.9, 1.8)),
        id="manual 9.4 INIT",
    ),
    pytest.param("GETSTARTPOSES", GetStartPoses(), id="manual 5.3.3 GETSTARTPOSES"),
    pytest.param("DRIVE {Left 1.0} {Right 1.0}", skid(1.0, 1.0), id="manual 9.4 forward"),
    pytest.param("DRIVE {Left -1.0} {Right 1.0}", skid(-1.0, 1.0), id="manual 9.4 turn left"),
    pytest.param("DRIVE {Light true}", DriveRobot(light=True), id="manual 9.4 light"),
    pytest.param("DRIVE {Flip true}", DriveRobot(flip=True), id="manual 9.4 flip"),
    pytest.param("DRIVE {Speed -1.0}", DriveRobot((("Speed", -1.0),)), id="manual 9.4 Ackermann backward"),
    pytest.param(
        "DRIVE {Speed 1.0} {FrontSteer -0.523599}",
        DriveRobot((("Speed", 1.0), ("FrontSteer", -0.523599))),
        id="manual 9.4 Ackermann right",
    ),
    pytest.param(
        "DRIVE {Propeller 1.0} {Rudder 0.523599}",
        DriveRobot((("Propeller", 1.0), ("Rudder", 0.523599))),
        id="manual 9.4 underwater right",
    ),
    pytest.param(
        "DRIVE {AltitudeVelocity 1}", DriveRobot((("AltitudeVelocity", 1.0),)), id="manual 9.4 aerial up"
    ),
    pytest.param(
        "DRIVE {RotationalVelocity 0.1}",
        DriveRobot((("RotationalVelocity", 0.1),)),
        id="manual 9.4 aerial turn",
    ),
    pytest.param(
        "DRIVE {LinearVelocity -3}", DriveRobot((("LinearVelocity", -3.0),)), id="manual 9.4 aerial backward"
    ),
    pytest.param("DRIVE { XZAngle 0.5}", DriveRobot((("XZAngle", 0.5),)), id="manual 12.21.3 bars"),
    pytest.param(
        "DRIVE { ThrustPropeller 1}", DriveRobot((("ThrustPropeller", 1.0),)), id="manual 12.21.3 thrust"
    ),
    pytest.param(
        "DRIVE { TailPropeller -0.3}", DriveRobot((("TailPropeller", -0.3),)), id="manual 12.21.3 turn"
    ),
    pytest.param(
        "DRIVE {WheelNumber 0} {WheelSpeed 3.14} {WheelSteer 0.75} {WheelNumber 1} {WheelSpeed -3.14}"
        " {WheelSteer 0.75}",
        DriveWheels((WheelCommand(0, 3.14, 0.75), WheelCommand(1, -3.14, 0.75))),
        id="manual 9.4 OmniDrive",
    ),
    pytest.param(
        "DRIVE {Name LeftFWheel} {Steer 1.57}",
        DriveJoint("LeftFWheel", 0, None, 1.57),
        id="manual 9.4 joint steer, the spin stays",
    ),
    pytest.param(
        "DRIVE {Name LeftFWheel} {Order 1} {Value 0.175}",
        DriveJoint("LeftFWheel", 1, 0.175),
        id="manual 9.4 joint speed",
    ),
    pytest.param(
        "MULTIDRIVE {FRFlipper -1} {FLFLipper -1}",
        MultiDrive((("FRFlipper", -1.0), ("FLFLipper", -1.0))),
        id="manual 9.4 MULTIDRIVE",
    ),
    pytest.param(
        "MULTIDRIVE {kenafCameraPan -1.0}{kenafCameraTilt 0.0}",
        MultiDrive((("kenafCameraPan", -1.0), ("kenafCameraTilt", 0.0))),
        id="manual 12.23 MULTIDRIVE",
    ),
    pytest.param(
        "SET {Type Joint} {Name UpperArm} {Opcode Angle} {Params 1.25}",
        SetJoint("UpperArm", 0, 1.25, None),
        id="manual 9.4 SET Joint",
    ),
    pytest.param(
        "MISPKG {Name CameraPanTilt} {Link 1} {Value 1.5} {Link 2} {Value 0}",
        MisPkg("CameraPanTilt", (LinkCommand(1, 1.5), LinkCommand(2, 0.0))),
        id="manual 9.4 MISPKG camera",
    ),
    pytest.param(
        "MISPKG {Name TalonArm} {Link 1} {Value 0.70} {Link 3} {Value 0.1} {Order 1}",
        MisPkg("TalonArm", (LinkCommand(1, 0.7), LinkCommand(3, 0.1, 1))),
        id="manual 9.4 MISPKG arm",
    ),
    pytest.param(
        "MISPKG {Name Cam} {Rotation 0,0.1,0.2} {Order 1}",
        MisPkg("Cam", (LinkCommand(1, -0.1, 1), LinkCommand(2, 0.2, 1))),
        id="the older MISPKG of Player and SPQR: pan to the right, tilt up",
    ),
    pytest.param(
        "MISPGK {Name Arm} {Link 1} {Value 1}{Order 2}",
        MisPkg("Arm", (LinkCommand(1, 1.0, 2),)),
        id="manual 9.4 heading MISPGK",
    ),
    pytest.param(
        "SET {Type Odometry} {Name Odo1} {Opcode RESET} {Params 1}",
        Set("Odometry", "Odo1", "RESET", "1"),
        id="manual 9.4 SET Odometry",
    ),
    pytest.param(
        "SET {Type Gripper} {Name Gripper} {Opcode Open} {Params 0.8}",
        Set("Gripper", "Gripper", "Open", "0.8"),
        id="manual 9.4 SET Gripper",
    ),
    pytest.param("GETGEO {Type Sonar}", GetGeo("Sonar"), id="manual 9.4 GETGEO Sonar"),
    pytest.param("GETGEO {Type MisPkg}", GetGeo("MisPkg"), id="manual 9.4 GETGEO MisPkg"),
    pytest.param("GETGEO {Type Robot}", GetGeo("Robot"), id="manual 9.4 GETGEO Robot"),
    pytest.param("GETGEO {Type Effecter}", GetGeo("Effecter"), id="manual 9.4 GETGEO Effecter"),
    pytest.param("GETCONF {Type RangeScanner}", GetConf("RangeScanner"), id="manual 9.4 GETCONF scanner"),
    pytest.param("GETCONF {Type MisPkg}", GetConf("MisPkg"), id="manual 9.4 GETCONF MisPkg"),
    pytest.param("GETCONF {Type Robot}", GetConf("Robot"), id="manual 9.4 GETCONF Robot"),
    pytest.param("GETCONF {Type Effecter}", GetConf("Effecter"), id="manual 9.4 GETCONF Effecter"),
    # What controllers really send.
    pytest.param("Drive {Left 0.5} {Right 0.5}", skid(0.5, 0.5), id="MOAST's head"),
    pytest.param(
        "INIT {Classname USARBot.P2AT} {Start Start1}",
        Init("P2AT", start="Start1"),
        id="MOAST's Classname and Start",
    ),
    pytest.param("GETCONF {Type RFID}", GetConf("RFID"), id="MOAST asks for what is not there"),
    pytest.param("DRIVE {RIGHT 1.0}{LEFT 2.0}", DriveRobot((("Right", 1.0), ("Left", 2.0))), id="USARGazebo"),
    pytest.param(
        "INIT {ClassName USARBot.P2AT} {Location 4.5, 1.9, 1.8} {Rotation 0.00, 0.00, 1.57",
        Init("P2AT", "", (4.5, 1.9, 1.8), (0.0, 0.0, 1.57)),
        id="PYRO's missing brace",
    ),
    pytest.param(
        "INIT {ClassName USARBot.P2DX} {Location 4.5 1.9 1.8} {Rotation 0 0 0}",
        Init("P2DX", "", (4.5, 1.9, 1.8), (0.0, 0.0, 0.0)),
        id="Player's vectors",
    ),
    pytest.param(
        "SET {Type Odometry} {Name Odometry} {Opcode RESET}",
        Set("Odometry", "Odometry", "RESET"),
        id="Player's reset without Params",
    ),
    pytest.param(
        "DRIVE {Left 50.0} {Right 50.0} {Normalized True} {Light False} {Flip False}",
        skid(50.0, 50.0, normalized=True, light=False),
        id="AP2DX sends every segment",
    ),
    pytest.param(
        "DRIVE {Left .4} {Right .4} {Normalized 0} {Light 1} {Flip 1}",
        skid(0.4, 0.4, light=True, flip=True),
        id="booleans as digits",
    ),
    pytest.param(
        "MISPKG {Name Arm} {Link 1} {Order 1} {Value 0.2} {Link 2} {Order 0} {Value 0.3}",
        MisPkg("Arm", (LinkCommand(1, 0.2, 1), LinkCommand(2, 0.3))),
        id="Iridium's Link, Order, Value",
    ),
    pytest.param(
        "MISPKG {Name CameraPanTilt} {Link 1} {Value 0.1} {Order 10}",
        MisPkg("CameraPanTilt", (LinkCommand(1, 0.1, 10),)),
        id="UsarCommander's relative order",
    ),
    pytest.param(
        "MISPKG {Name Arm} {Link 1} {Order 0.5} {Value 1}",
        MisPkg("Arm", (LinkCommand(1, 1.0, 0),)),
        id="the AUT toolbox's Order 0.5",
    ),
    # Partial and odd forms that still have one sense.
    pytest.param("DRIVE {Left 1.0}", DriveRobot((("Left", 1.0),)), id="left only"),
    pytest.param("DRIVE {Left 0} {Right 0}", skid(0.0, 0.0), id="stop"),
    pytest.param("INIT {ClassName P2AT}", Init("P2AT"), id="class without USARBot"),
    pytest.param("INIT {ClassName usarbot.p2at}", Init("p2at"), id="class in lower case"),
    pytest.param(
        "INIT {Rotation 0,0,0,1} {Location 1,2} {Name R} {ClassName USARBot.Zerg}",
        Init("Zerg", "R", (1.0, 2.0, 0.0), (0.0, 0.0, 0.0)),
        id="short and long vectors, any order",
    ),
    pytest.param(
        "MISPKG {Value 1} {Link 1} {Value 2} {Link 2} {Name Arm}",
        MisPkg("Arm", (LinkCommand(1, 1.0), LinkCommand(2, 2.0))),
        id="Value before Link, Name last",
    ),
    pytest.param(
        "MISPKG {Name Arm} {Link 1} {Link 2} {Value 2}",
        MisPkg("Arm", (LinkCommand(1, 0.0), LinkCommand(2, 2.0))),
        id="a link without a Value",
    ),
    pytest.param(
        "DRIVE {Speed 10} {FrontSteer 50} {RearSteer -50} {Normalized true} {Light false} {Flip true}",
        DriveRobot((("Speed", 10.0), ("FrontSteer", 50.0), ("RearSteer", -50.0)), True, False, True),
        id="Ackermann with every switch",
    ),
    pytest.param(
        "DRIVE {sternplane 1} {RUDDER 2}",
        DriveRobot((("SternPlane", 1.0), ("Rudder", 2.0))),
        id="keys in any case, in the message's order",
    ),
    pytest.param(
        "DRIVE {Left 1} {Right 2} {LEFT 3} {Left }",
        skid(1.0, 2.0),
        id="the first of two counts",
    ),
    pytest.param(
        "DRIVE {Speed 1} {Left 2}",
        DriveRobot((("Speed", 1.0), ("Left", 2.0))),
        id="keys of two forms: the robot knows its own",
    ),
    pytest.param(
        "DRIVE {Name Arm} {Value 3} {Speed 1}", DriveRobot((("Speed", 1.0),)), id="a drive key beats a joint"
    ),
    pytest.param("DRIVE {Light 0} {Left}", DriveRobot(light=False), id="an empty value, but a light"),
    pytest.param(
        "DRIVE {WheelSteer 1} {WHEELNUMBER 2} {WheelNumber 0} {WheelSpeed 5} {Normalized 1} {Flip 1}",
        DriveWheels((WheelCommand(2, None, 1.0), WheelCommand(0, 5.0, None)), True, None, True),
        id="wheels in any order of keys, partial, with switches",
    ),
    pytest.param(
        "DRIVE {WheelNumber 3} {WheelSpeed} {WheelSteer .5}",
        DriveWheels((WheelCommand(3, None, 0.5),)),
        id="an empty WheelSpeed keeps the speed",
    ),
    pytest.param(
        "DRIVE {Left 9} {WheelNumber 1} {WheelSpeed 2} {Name Arm} {Value 1}",
        DriveWheels((WheelCommand(1, 2.0, None),)),
        id="a wheel number beats all other forms",
    ),
    pytest.param(
        "DRIVE {WheelNumber 0} {Light true}",
        DriveWheels((WheelCommand(0, None, None),), light=True),
        id="a wheel with nothing to do, but a light",
    ),
    pytest.param("DRIVE {Name Arm}", DriveJoint("Arm", 0, 0.0, None), id="KRobot.uc: order 0, value 0"),
    pytest.param(
        "DRIVE {Name Arm} {Order 2} {Steer} {Value}",
        DriveJoint("Arm", 2, 0.0, None),
        id="an empty Value is 0 when nothing is steered",
    ),
    pytest.param(
        "DRIVE {Steer -1} {Value 2} {Order 1} {Name W}",
        DriveJoint("W", 1, 2.0, -1.0),
        id="a joint's speed and steering together, any order of keys",
    ),
    pytest.param(
        "DRIVE {Name Arm} {Order 0.5} {Value 1}",
        DriveJoint("Arm", 0, 1.0),
        id="the AUT toolbox's Order 0.5 for a joint",
    ),
    pytest.param("DRIVE {Name Arm} {Order 11} {Value 1}", DriveJoint("Arm", 11, 1.0), id="a relative order"),
    pytest.param("MULTIDRIVE {A} {B 1}", MultiDrive((("B", 1.0),)), id="a joint without an angle"),
    pytest.param(
        "SET {Type joint}{Name W}{Opcode velocity}{Params 2.5,-0.3}",
        SetJoint("W", 1, 2.5, -0.3),
        id="SET Joint with a steering angle, without spaces",
    ),
    pytest.param(
        "SET {Type Joint} {Name W} {Opcode 12}", SetJoint("W", 12, 0.0, None), id="KRobot.uc: no Params is 0"
    ),
    pytest.param("GETGEO {Name F1} {Type Sonar}", GetGeo("Sonar", "F1"), id="one item"),
    pytest.param(
        "SET {Type Viewports} {Config QuadView}", SetViewports("QuadView"), id="manual 9.4 viewports config"
    ),
    pytest.param(
        "SET {Type Viewports} {Config QuadView} {Viewport1 Camera1} {Viewport2 Camera2} {Viewport3 Disable} "
        "{Viewport4 Disable}",
        SetViewports("QuadView", ((1, "Camera1"), (2, "Camera2"), (3, "Disable"), (4, "Disable"))),
        id="manual 9.4 viewports cameras",
    ),
    pytest.param(
        "SET {TypeViewports} {Viewport1 Disable}",
        SetViewports("", ((1, "Disable"),)),
        id="manual 9.4, a slip",
    ),
    pytest.param(
        "SET {Type Camera} {Name Camera} {FOV 1}", SetFov((("Camera", 1.0),)), id="manual 9.4 field of view"
    ),
    pytest.param(
        "SET {Type Camera} {FOV 1} {Name A} {Name B} {FOV 0}",
        SetFov((("A", 1.0), ("B", 0.0))),
        id="fields of view in any order",
    ),
    pytest.param(
        "SET {Type Camera}{Robot R1}{Name Camera}{Client 10.0.0.2}",
        SetView("10.0.0.2", "R1", "Camera"),
        id="SPQR viewpoint",
    ),
    pytest.param(
        "SET {Type Camera} {Client 10.0.0.2}", SetView("10.0.0.2"), id="manual 9.4 viewpoint released"
    ),
    pytest.param(
        "SET {Type Camera} {Robot R1} {Name C} {Client 10.0.0.2} {FOV 1}",
        SetView("10.0.0.2", "R1", "C"),
        id="a viewpoint does not zoom",
    ),
    pytest.param(
        "SET {Type Camera} {Name Camera} {Opcode Zoom} {Params 0.5}",
        Set("Camera", "Camera", "Zoom", "0.5"),
        id="the older form of zooming",
    ),
    pytest.param(
        "SET {Type Camera} {Name Camera} {Opcode Zoom} {0.5}",
        Set("Camera", "Camera", "Zoom", "0.5"),
        id="Player zooms without Params",
    ),
    pytest.param(
        "SET {Type Lamp} {Name L} {Opcode Dim} {FOV 1}", Set("Lamp", "L", "Dim"), id="FOV of no camera"
    ),
    pytest.param("Trace {On true} {Interval 1.5} {Color Green}", Trace(True, 1.5, "Green"), id="trace"),
    pytest.param("TRACE {On 1} {Color 6}", Trace(True, 0.0, "Purple"), id="trace by number"),
    pytest.param("Trace {On True} {Interval -1} {Color 7}", Trace(True), id="trace of no such colour"),
    pytest.param(
        "CAMERA {Rotation 0,0.100000,-0.200000} {Zoom 0.872700}",
        TurnCamera((0.0, 0.1, -0.2), 0, 0.8727),
        id="camera as SimpleUI has it",
    ),
    pytest.param("Camera {zoom 0}", TurnCamera(None, 0, 0.0), id="camera that only zooms"),
    pytest.param("CAMERA {Order 1} {Rotation 0 .1 0}", TurnCamera((0.0, 0.1, 0.0), 1), id="camera by speed"),
    pytest.param("Trace", Trace(False), id="trace with the manual's defaults"),
    pytest.param("GETCONF {Name F1} {Type Sonar}", GetConf("Sonar", "F1"), id="one item CONF"),
]

IGNORED = [
    ("DRIVE", "anything to do"),
    ("DRIVE {Normalized true}", "anything to do"),
    ("DRIVE {Left } {Right}", "anything to do"),
    ("DRIVE {Name}", "anything to do"),
    ("DRIVE {WheelNumber} {WheelSpeed 1}", "anything to do"),
    ("DRIVE {WheelNumber 0} {Normalized true}", "anything to do"),
    ("DRIVE {WheelNumber 0} {WheelSpeed}", "anything to do"),
    ("DRIVE {WheelSpeed 1} {WheelSpeed 2} {WheelNumber 0}", "belongs to no WheelNumber"),
    ("DRIVE {WheelNumber 0} {WheelSpeed 1} {WheelSpeed 2}", "belongs to no WheelNumber"),
    ("MULTIDRIVE", "anything to do"),
    ("MULTIDRIVE {FRFlipper}", "anything to do"),
    ("PAUSE {TIME 10}", "'PAUSE' is not supported"),  # PYRO
    ("GET / HTTP/1.1", "'GET' is not supported"),
    ("SET {Type Joint} {Opcode Angle} {Params 1.25}", "without a Name"),
    ("SET {Type Joint} {Name UpperArm} {Params 1.25}", "opcode ''; known: angle, velocity, torque"),
    ("SET {Type Joint} {Name UpperArm} {Opcode 3} {Params 1.25}", "opcode '3'"),
    ("SET {Type Joint} {Name UpperArm} {Opcode Spin} {Params 1.25}", "opcode 'Spin'"),
    ("SET {Type Camera} {FOV 1}", "lacks the other"),
    ("SET {Type Camera} {Name C} {FOV 1} {Name D}", "lacks the other"),
    ("SET {Type Camera} {Robot R1} {Name Camera}", "without a Client"),
    ("INIT {Name R1}", "without a ClassName"),
    ("INIT {ClassName USARBot.}", "without a ClassName"),
    ("MISPKG {Link 1} {Value 1}", "without a Name"),
    ("MISPKG {Name Arm}", "no Link"),
    ("MISPKG {Name Arm} {Value 1} {Value 2} {Link 2}", "belongs to none"),
    ("MISPKG {Name Cam} {Rotation}", "no Link"),
    ("GETGEO", "without a Type"),
    ("GETCONF {Name F1}", "without a Type"),
]


@pytest.mark.parametrize(("line", "command"), UNDERSTOOD)
def test_understood(line, command):
    assert parse_command(parse_message(line)) == command


@pytest.mark.parametrize(("line", "reason"), IGNORED)
def test_ignored_with_a_reason(line, reason):
    answer = parse_command(parse_message(line))
    assert isinstance(answer, Ignored)
    assert reason in answer.reason


@pytest.mark.parametrize("number", ["nan", "NaN", "inf", "-Infinity", "1e999"])
@pytest.mark.parametrize(
    "line",
    [
        "DRIVE {Left @} {Right 1}",
        "DRIVE {Right @}",
        "INIT {ClassName P2AT} {Location 1,@,3}",
        "INIT {ClassName P2AT} {Rotation 0 0 @}",
        "MISPKG {Name Arm} {Link 1} {Value @}",
        "MISPKG {Name Arm} {Link @} {Value 1}",
        "MISPKG {Name Arm} {Link 1} {Value 1} {Order @}",
        "DRIVE {Speed 1} {FrontSteer @}",
        "DRIVE {TailPropeller @} {TailPropeller 1}",
        "DRIVE {WheelNumber @} {WheelSpeed 1}",
        "DRIVE {WheelNumber 0} {WheelSpeed 1} {WheelNumber 1} {WheelSteer @}",
        "DRIVE {Name Arm} {Value @}",
        "DRIVE {Name Arm} {Order @} {Value 1}",
        "DRIVE {Name Arm} {Steer @}",
        "MULTIDRIVE {FRFlipper 1} {FLFlipper @}",
        "SET {Type Joint} {Name Arm} {Opcode 0} {Params @}",
        "SET {Type Joint} {Name Arm} {Opcode 0} {Params 1,@}",
    ],
)
def test_numbers_that_are_not_finite_are_refused(line, number):
    with pytest.raises(PeerError, match="not a finite number"):
        parse_command(parse_message(line.replace("@", number)))


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("INIT {ClassName P2AT} {Location 4,5 1,9 1,8}", "'4,5 1,9 1,8'; expected numbers"),
        ("INIT {ClassName P2AT} {Location 4,5,1,9,1,8}", "has 6 numbers, expected 3"),
        ("DRIVE {Left 2,5} {Right 2,5}", "'2,5'; expected a number"),
        ("CAMERA {Zoom 0,5}", "'0,5'; expected a number"),
    ],
)
def test_decimal_commas_are_refused_not_cut(line, why):
    with pytest.raises(PeerError, match=why):
        parse_command(parse_message(line))


@pytest.mark.parametrize(
    ("line", "command"),
    [
        ("INIT {ClassName P2AT} {classname P2DX} {Name A} {Name B}", Init("P2AT", "A")),
        ("DRIVE {Left 1} {LEFT 2} {Right 3} {Right x}", DriveRobot((("Left", 1.0), ("Right", 3.0)))),
        ("DRIVE {Left} {Left 2} {Right 3}", DriveRobot((("Right", 3.0),))),
        ("DRIVE {Light True} {Light False}", DriveRobot(light=True)),
        ("DRIVE {Name A} {Name B} {Value 1} {Value 2}", DriveJoint("A", 0, 1.0)),
        ("MULTIDRIVE {A 1} {B 2} {a 3}", MultiDrive((("A", 1.0), ("B", 2.0)))),
        ("SET {Type Odometry} {Type INS} {Name O} {Opcode RESET}", Set("Odometry", "O", "RESET")),
    ],
)
def test_of_a_key_that_is_repeated_the_first_counts(line, command):
    """As in the original, whose GetArgVal returns the first argument of a name, whatever its value."""
    assert parse_command(parse_message(line)) == command


@pytest.mark.parametrize("key", DRIVE_KEYS)
def test_every_drive_key_is_known_in_any_case(key):
    for spelling in (key, key.lower(), key.upper()):
        assert parse_command(parse_message(f"DRIVE {{{spelling} -0.5}}")) == DriveRobot(((key, -0.5),))


def test_the_drive_keys_are_those_of_the_manual():
    assert set(DRIVE_KEYS) == {
        *("Left", "Right"),  # manual 9.4, skid-steered
        *("Speed", "FrontSteer", "RearSteer"),  # Ackermann
        *("Propeller", "Rudder", "SternPlane"),  # underwater
        *("AltitudeVelocity", "LinearVelocity", "LateralVelocity", "RotationalVelocity"),  # aerial
        *("XZAngle", "ThrustPropeller", "TailPropeller"),  # manual 12.21.3
    }


# KRobot.uc, ProcessCarInput: a name in any case or the number of the order.
@pytest.mark.parametrize(
    ("opcode", "order"),
    [
        ("Angle", 0),
        ("Velocity", 1),
        ("Torque", 2),
        ("RelAngle", 10),
        ("RelVelocity", 11),
        ("RelTorque", 12),
    ],
)
def test_every_opcode_of_a_joint_by_name_and_by_number(opcode, order):
    for spelling in (opcode, opcode.upper(), str(order)):
        line = f"SET {{Type Joint}} {{Name Arm}} {{Opcode {spelling}}} {{Params -1}}"
        assert parse_command(parse_message(line)) == SetJoint("Arm", order, -1.0, None)


def test_the_registry_lists_what_a_client_can_ask():
    assert COMMANDS.names() == sorted(
        [
            "INIT",
            "GETSTARTPOSES",
            "DRIVE",
            "MULTIDRIVE",
            "MISPKG",
            "SET",
            "TRACE",
            "CAMERA",
            "GETGEO",
            "GETCONF",
            "CONTROL",
        ]
    )
