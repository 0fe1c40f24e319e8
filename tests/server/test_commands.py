"""What client lines ask for: the manual's examples and the habits of real controllers."""

import pytest

from usarmjx.errors import PeerError
from usarmjx.server.commands import (
    COMMANDS,
    Drive,
    GetConf,
    GetGeo,
    GetStartPoses,
    Ignored,
    Init,
    LinkCommand,
    MisPkg,
    Set,
    parse_command,
)
from usarmjx.server.grammar import parse

UNDERSTOOD = [
    # The manual's own examples.
    pytest.param(
        "INIT {ClassName USARBot.P2DX} {Location 4.5,1.9,1.8} {Name R1}",
        Init("P2DX", "R1", (4.5, 1.9, 1.8)),
        id="manual 9.4 INIT",
    ),
    pytest.param("GETSTARTPOSES", GetStartPoses(), id="manual 5.3.3 GETSTARTPOSES"),
    pytest.param("DRIVE {Left 1.0} {Right 1.0}", Drive(1.0, 1.0), id="manual 9.4 forward"),
    pytest.param("DRIVE {Left -1.0} {Right 1.0}", Drive(-1.0, 1.0), id="manual 9.4 turn left"),
    pytest.param("DRIVE {Light true}", Drive(light=True), id="manual 9.4 light"),
    pytest.param("DRIVE {Flip true}", Drive(flip=True), id="manual 9.4 flip"),
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
    pytest.param("Drive {Left 0.5} {Right 0.5}", Drive(0.5, 0.5), id="MOAST's head"),
    pytest.param(
        "INIT {Classname USARBot.P2AT} {Start Start1}",
        Init("P2AT", start="Start1"),
        id="MOAST's Classname and Start",
    ),
    pytest.param("GETCONF {Type RFID}", GetConf("RFID"), id="MOAST asks for what is not there"),
    pytest.param("DRIVE {RIGHT 1.0}{LEFT 2.0}", Drive(2.0, 1.0), id="USARGazebo"),
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
        "SET {Type Camera} {Name Camera} {Opcode Zoom} {0.5}",
        Set("Camera", "Camera", "Zoom"),
        id="Player's malformed zoom",
    ),
    pytest.param("DRIVE {Left 1,00} {Right -2,50}", Drive(1.0, -2.0), id="decimal comma of LCM's proxy"),
    pytest.param(
        "DRIVE {Left 50.0} {Right 50.0} {Normalized True} {Light False} {Flip False}",
        Drive(50.0, 50.0, normalized=True, light=False),
        id="AP2DX sends every segment",
    ),
    pytest.param(
        "DRIVE {Left .4} {Right .4} {Normalized 0} {Light 1} {Flip 1}",
        Drive(0.4, 0.4, light=True, flip=True),
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
    pytest.param("DRIVE {Left 1.0}", Drive(left=1.0), id="left only"),
    pytest.param("DRIVE {Left 0} {Right 0}", Drive(0.0, 0.0), id="stop"),
    pytest.param("DRIVE {Left fast} {Right 1}", Drive(0.0, 1.0), id="garbage is 0"),
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
    pytest.param("GETGEO {Name F1} {Type Sonar}", GetGeo("Sonar", "F1"), id="one item"),
    pytest.param("GETCONF {Name F1} {Type Sonar}", GetConf("Sonar", "F1"), id="one item CONF"),
]

IGNORED = [
    ("DRIVE {Speed -1.0}", "Ackermann DRIVE"),
    ("DRIVE {Speed 1.0} {FrontSteer 0.523599}", "Ackermann DRIVE"),
    ("DRIVE {Speed 1.0} {Light true}", "Ackermann DRIVE"),
    ("DRIVE {Propeller 1.0} {Rudder 0.523599}", "underwater DRIVE"),
    ("DRIVE {AltitudeVelocity 1}", "aerial DRIVE"),
    ("DRIVE {WheelNumber 0} {WheelSpeed 3.14} {WheelSteer 0.75}", "omnidirectional DRIVE"),
    ("DRIVE {Name LeftFWheel} {Order 1} {Value 0.175}", "joint DRIVE"),
    ("DRIVE", "anything to do"),
    ("DRIVE {Normalized true}", "anything to do"),
    ("DRIVE {Left } {Right}", "anything to do"),
    ("MULTIDRIVE {FRFlipper -1} {FLFLipper -1}", "'MULTIDRIVE' is not supported"),
    ("Trace {On true} {Interval 1} {Color Red}", "'TRACE' is not supported"),
    ("PAUSE {TIME 10}", "'PAUSE' is not supported"),  # PYRO
    ("GET / HTTP/1.1", "'GET' is not supported"),
    ("SET {Type Joint} {Name UpperArm} {Opcode Angle} {Params 1.25}", "'Joint'"),
    ("SET {Type Viewports} {Config QuadView}", "'Viewports'"),
    ("SET {TypeViewports} {Viewport1 Disable}", "without a Type"),  # manual 9.4, a slip
    ("SET {Type Camera}{Robot R1}{Name Camera}{Client 10.0.0.2}", "viewpoint"),  # SPQR
    ("SET {Type Camera} {Client 10.0.0.2}", "viewpoint"),
    ("SET {Type Camera} {Name Camera} {FOV 1}", "field of view"),
    ("INIT {Name R1}", "without a ClassName"),
    ("INIT {ClassName USARBot.}", "without a ClassName"),
    ("MISPKG {Link 1} {Value 1}", "without a Name"),
    ("MISPKG {Name Arm}", "no Link"),
    ("MISPKG {Name Arm} {Value 1} {Value 2} {Link 2}", "belongs to none"),
    ("MISPKG {Name Cam} {Rotation 0,0.1,0.2} {Order 0}", "no Link"),  # old dialect: Player, SPQR
    ("GETGEO", "without a Type"),
    ("GETCONF {Name F1}", "without a Type"),
]


@pytest.mark.parametrize(("line", "command"), UNDERSTOOD)
def test_understood(line, command):
    assert parse_command(parse(line)) == command


@pytest.mark.parametrize(("line", "reason"), IGNORED)
def test_ignored_with_a_reason(line, reason):
    answer = parse_command(parse(line))
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
    ],
)
def test_numbers_that_are_not_finite_are_refused(line, number):
    with pytest.raises(PeerError, match="not a finite number"):
        parse_command(parse(line.replace("@", number)))


def test_the_registry_lists_what_a_client_can_ask():
    assert COMMANDS.names() == sorted(
        ["INIT", "GETSTARTPOSES", "DRIVE", "MISPKG", "SET", "GETGEO", "GETCONF"]
    )
