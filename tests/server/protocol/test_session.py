"""A dialogue without sockets: phases, faults, chunking, the outgoing buffer."""

from itertools import pairwise
from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from usarmjx.base.errors import PeerError
from usarmjx.server.protocol.commands import (
    LEGAL_COMMANDS,
    Command,
    Control,
    DriveJoint,
    DriveRobot,
    DriveWheels,
    GetConf,
    GetGeo,
    GetStartPoses,
    Init,
    InvalidSet,
    LinkCommand,
    MisPkg,
    MultiDrive,
    OwnCommand,
    SessionPhase,
    Set,
    SetFov,
    SetJoint,
    SetStiffness,
    SetView,
    SetViewports,
    Trace,
    TurnCamera,
    WheelCommand,
)
from usarmjx.server.protocol.grammar import Message
from usarmjx.server.protocol.reports import nfo_greeting, nfo_start_poses, res
from usarmjx.server.protocol.session import (
    MAX_FAULTS,
    MAX_WAITING,
    REFUSAL_FAULTS,
    SEND_LIMIT,
    RobotSession,
)

GREETING = nfo_greeting("DM-Test")
INIT_LINE = b"INIT {ClassName USARBot.P2AT} {Name R1}\r\n"
LINES = {
    Init("P2AT", "R1"): INIT_LINE,
    GetStartPoses(): b"GETSTARTPOSES\r\n",
    DriveRobot((("Left", 1.0), ("Right", 1.0))): b"DRIVE {Left 1} {Right 1}\r\n",
    DriveWheels((WheelCommand(0, 1.0, None),)): b"DRIVE {WheelNumber 0} {WheelSpeed 1}\r\n",
    DriveJoint("Arm", 1, 0.5): b"DRIVE {Name Arm} {Order 1} {Value 0.5}\r\n",
    MultiDrive((("FRFlipper", -1.0),)): b"MULTIDRIVE {FRFlipper -1}\r\n",
    MisPkg("Arm", (LinkCommand(1, 0.5),)): b"MISPKG {Name Arm} {Link 1} {Value 0.5}\r\n",
    Set("Odometry", "O", "RESET"): b"SET {Type Odometry} {Name O} {Opcode RESET}\r\n",
    SetJoint("Arm", 0, 1.0, None): b"SET {Type Joint} {Name Arm} {Opcode Angle} {Params 1}\r\n",
    SetStiffness("Arm", 0.5): b"SET {Type Joint} {Name Arm} {Opcode Stiffness} {Params 0.5}\r\n",
    SetFov((("Camera", 1.0),)): b"SET {Type Camera} {Name Camera} {FOV 1}\r\n",
    SetViewports("QuadView"): b"SET {Type Viewports} {Config QuadView}\r\n",
    SetView("10.0.0.2", "R1", "Camera"): b"SET {Type Camera} {Robot R1} {Name Camera} {Client 10.0.0.2}\r\n",
    Trace(True): b"Trace {On True}\r\n",
    TurnCamera((0.0, 0.1, 0.2), 1, 0.5): b"CAMERA {Rotation 0,.1,.2} {Order 1} {Zoom 0.5}\r\n",
    GetGeo("Sonar"): b"GETGEO {Type Sonar}\r\n",
    GetConf("Sonar"): b"GETCONF {Type Sonar}\r\n",
    Control("AbsMove", "R1", location=(1.0, 2.0, -3.0)): (
        b"CONTROL {Type AbsMove} {Name R1} {Location 1,2,-3}\r\n"
    ),
}


def left(speed):
    return DriveRobot((("Left", speed),))


def talk(session, chunks, accepts=lambda init: True):
    """Feed the chunks and answer every Init, as a server does; return all commands."""
    heard = []
    for chunk in chunks:
        commands = session.receive_data(chunk)
        while commands:
            heard += commands
            commands = session.answer_init(accepts(heard[-1])) if session.awaits_answer else []
    return heard


def session_in(phase):
    session = RobotSession(GREETING)
    if phase is SessionPhase.ACTIVE:
        talk(session, [INIT_LINE])
    if phase is SessionPhase.CLOSED:
        session.close()
    assert session.phase is phase
    return session


def test_the_server_speaks_first():
    session = RobotSession(GREETING)
    assert session.phase is SessionPhase.GREETED
    assert session.data_to_send() == (b"NFO {Gametype BotDeathMatch} {Level DM-Test} {TimeLimit 0}\r\n")
    assert session.data_to_send() == b""


# Which commands count in which phase, written out a second time on purpose.
LEGAL = {
    SessionPhase.GREETED: {Init, GetStartPoses, SetView},
    SessionPhase.ACTIVE: {
        *(GetStartPoses, GetGeo, GetConf, Control),
        *(DriveRobot, DriveWheels, DriveJoint, MultiDrive, MisPkg, Set, SetJoint, SetStiffness),
        *(SetFov, SetViewports, SetView, Trace, TurnCamera),
    },
    SessionPhase.CLOSED: set(),
}


@pytest.mark.parametrize("phase", SessionPhase)
@pytest.mark.parametrize("command", LINES, ids=lambda command: type(command).__name__)
def test_every_command_in_every_phase(phase, command):
    session = session_in(phase)
    heard = talk(session, [LINES[command]])
    faults = session.take_faults()
    if type(command) in LEGAL[phase]:
        assert (heard, faults) == ([command], [])
    else:
        assert heard == []
        assert [type(command).__name__ in fault for fault in faults] == (
            [] if phase is SessionPhase.CLOSED else [True]
        )
    joined = phase is SessionPhase.GREETED and isinstance(command, Init)
    assert session.phase is (SessionPhase.ACTIVE if joined else phase)


def test_the_table_covers_every_phase():
    assert set(LEGAL_COMMANDS) == set(SessionPhase)


def test_every_command_has_its_line_here():
    assert {type(command) for command in LINES} == set(get_args(Command)) - {OwnCommand, InvalidSet}, (
        "without a head"
    )


@pytest.mark.parametrize(
    "line",
    [
        "SET {Type Camera} {Name C} {FOV 1} {Name D}",
        "SET {Type Joint} {Name C} {Opcode Spin} {Params 1}",
        "SET {Type Joint} {Name C} {Opcode Angle} {Params x}",
        "SET {Type Joint} {Name C} {Opcode Angle} {Params nan}",
    ],
)
def test_a_set_that_makes_no_sense_can_be_answered_once_there_is_a_robot(line):
    greeted, active = session_in(SessionPhase.GREETED), session_in(SessionPhase.ACTIVE)
    assert greeted.receive_data(line.encode() + b"\r\n") == []
    (command,) = active.receive_data(line.encode() + b"\r\n")
    assert isinstance(command, InvalidSet)
    assert command.name == "C"
    assert [one.fault_count for one in (greeted, active)] == [1, 1]


def test_what_has_no_value_is_not_sent():
    """Manual 9.2: a segment is pairs."""
    session = session_in(SessionPhase.ACTIVE)
    session.data_to_send()
    session.send(Message("RES", (("Type", "Gripper"), ("Name", ""), ("Status", "Failed"))))
    assert session.data_to_send() == b"RES {Type Gripper} {Status Failed}\r\n"


def test_a_refused_init_sends_nothing_and_may_be_tried_again():
    session = RobotSession(GREETING)
    session.data_to_send()
    unknown = b"INIT {ClassName USARBot.Nonsense}\r\n"
    heard = talk(
        session,
        [unknown + b"DRIVE {Left 1}\r\n" + INIT_LINE + b"DRIVE {Left 2}\r\n"],
        accepts=lambda init: init.class_name == "P2AT",
    )
    assert heard == [Init("Nonsense"), Init("P2AT", "R1"), left(2.0)]
    assert session.phase is SessionPhase.ACTIVE
    assert session.data_to_send() == b""
    refused, too_early = session.take_faults()
    assert "INIT" in refused
    assert "Drive" in too_early


def test_the_phase_stays_until_the_init_is_answered():
    session = RobotSession(GREETING)
    assert session.receive_data(INIT_LINE + b"DRIVE {Left 1}\r\n") == [Init("P2AT", "R1")]
    assert session.phase is SessionPhase.GREETED
    assert session.awaits_answer
    assert session.receive_data(b"DRIVE {Left 2}\r\n") == []
    assert session.answer_init(True) == [left(1.0), left(2.0)]
    assert session.phase is SessionPhase.ACTIVE
    assert not session.awaits_answer


def test_an_answer_without_a_question_changes_nothing():
    session = RobotSession(GREETING)
    assert session.answer_init(True) == []
    assert session.phase is SessionPhase.GREETED


def test_a_second_init_is_ignored_and_the_robot_stays():
    session = session_in(SessionPhase.ACTIVE)
    assert talk(session, [b"INIT {ClassName USARBot.Zerg}\r\nDRIVE {Left 1}\r\n"]) == [left(1.0)]
    assert session.phase is SessionPhase.ACTIVE
    assert session.take_faults() == ["Init is ignored when active"]


def test_lines_before_the_answer_are_bounded():
    session = RobotSession(GREETING)
    session.receive_data(INIT_LINE)
    session.receive_data(b"DRIVE {Left 1}\r\n" * (MAX_WAITING + 3))
    assert len(session.take_faults()) == 3
    assert len(session.answer_init(True)) == MAX_WAITING


def test_a_bad_line_never_loses_the_good_one_after_it():
    session = RobotSession(GREETING, line_limit=100)
    session.receive_data(INIT_LINE)
    session.answer_init(True)
    bad = [
        b"DRIVE {Left nan} {Right 1}",
        b"DRIVE {Left 1 {Right 1}",
        b"} {",
        b"PAUSE {TIME 10}",
        bytes(byte for byte in range(40) if byte not in b"\r\n"),
        b"\xff\xfe\x00\x80",
        b"DRIVE {Left " + b"1" * 200 + b"}",
    ]
    for number, line in enumerate(bad):
        good = b"DRIVE {Left %d}\n" % number
        assert session.receive_data(line + b"\r\n" + good) == [left(float(number))]
        assert len(session.take_faults()) == 1, line
    assert session.phase is SessionPhase.ACTIVE


def test_a_number_that_is_not_finite_gives_no_command_at_all():
    session = session_in(SessionPhase.ACTIVE)
    assert session.receive_data(b"DRIVE {Left inf} {Right 1} {Light true}\r\n") == []
    (fault,) = session.take_faults()
    assert "'inf' is not a finite number" in fault


def test_faults_are_bounded_short_and_on_one_line():
    session = RobotSession(GREETING)
    session.receive_data(b"\x00{\x1b[2J" * 900 + b"\n" + b"}\n" * 5000)
    faults = session.take_faults()
    assert len(faults) == MAX_FAULTS + 1
    assert faults[-1] == f"{5001 - MAX_FAULTS} more faults"
    assert all(len(fault) < 600 and fault.isprintable() for fault in faults)
    assert session.take_faults() == []


def test_two_commands_in_one_segment():
    session = RobotSession(GREETING)
    assert talk(session, [b"GETSTARTPOSES\r\n" + INIT_LINE]) == [
        GetStartPoses(),
        Init("P2AT", "R1"),
    ]


def test_pyro_ends_lines_the_other_way_round_and_forgets_a_brace():
    session = RobotSession(GREETING)
    data = (
        b"INIT {ClassName USARBot.P2DX} {Location 4.5, 1.9, 1.8} {Rotation 0.00, 0.00, 0.00\n\r"
        b"PAUSE {TIME 10}\n\rDRIVE {Left 1} {Right 1}\n\r"
    )
    init = Init("P2DX", "", (4.5, 1.9, 1.8), (0.0, 0.0, 0.0))
    assert talk(session, [data]) == [init, DriveRobot((("Left", 1.0), ("Right", 1.0)))]


def test_a_last_line_without_an_end_counts_when_the_peer_stops_sending():
    session = RobotSession(GREETING)
    assert session.receive_data(b"GETSTARTPOSES") == []
    assert session.receive_eof() == [GetStartPoses()]
    assert session.receive_eof() == []


SCRIPT = (
    b"GETSTARTPOSES\r\nDRIVE {Left 9}\r\n" + INIT_LINE + b"\n\r\n"
    b"Drive {Left 1} {Right 1}\rDRIVE {Left nan}\n\rMISPGK {Name Arm}{Link 1}{Value 0.5}\n"
    b"INIT {ClassName USARBot.Zerg}\r\n\x80\x81\r\nGETGEO {Type Sonar}\r\nGETCONF {Type Sonar}\r\n"
)
HEARD = [
    GetStartPoses(),
    Init("P2AT", "R1"),
    DriveRobot((("Left", 1.0), ("Right", 1.0))),
    MisPkg("Arm", (LinkCommand(1, 0.5),)),
    GetGeo("Sonar"),
    GetConf("Sonar"),
]


@given(st.lists(st.integers(0, len(SCRIPT)), max_size=30))
def test_random_chunking_gives_the_same_commands_and_faults(cuts):
    edges = [0, *sorted(cuts), len(SCRIPT)]
    session = RobotSession(GREETING)
    chunks = [SCRIPT[a:b] for a, b in pairwise(edges)]
    assert talk(session, chunks) == HEARD
    assert len(session.take_faults()) == 4


def test_byte_by_byte_gives_the_same_commands():
    session = RobotSession(GREETING)
    assert talk(session, [SCRIPT[i : i + 1] for i in range(len(SCRIPT))]) == HEARD


@given(st.lists(st.binary(max_size=200), max_size=5), st.booleans())
def test_no_bytes_raise_and_the_session_still_works(chunks, accepted):
    session = RobotSession(GREETING, line_limit=64)
    talk(session, [*chunks, b"\r\n"], accepts=lambda init: accepted)
    assert talk(session, [b"GETSTARTPOSES\r\n"]) == [GetStartPoses()]


def test_messages_are_sent_in_order_with_their_ends():
    session = RobotSession(GREETING)
    session.data_to_send()
    session.send(nfo_start_poses([]))
    session.send(res(61.2, "Odometry", "Odo1", "OK"))
    assert session.data_to_send() == (
        b"NFO {StartPoses 0}\r\nRES {Time 61.20} {Type Odometry} {Name Odo1} {Status OK}\r\n"
    )


def test_text_of_a_client_is_echoed_in_the_bytes_it_came_in():
    session = session_in(SessionPhase.ACTIVE)
    session.data_to_send()
    (command,) = session.receive_data(b"GETGEO {Type S\xf6nar}\r\n")
    assert isinstance(command, GetGeo)
    session.send(Message("GEO", (("Type", command.type),)))
    assert session.data_to_send() == b"GEO {Type S\xf6nar}\r\n"


def test_a_peer_that_never_reads_is_dropped_at_the_limit():
    session = RobotSession(GREETING, send_limit=1000)
    message = Message("SEN", (("Type", "x" * 87),))  # 100 bytes with its end
    session.data_to_send()
    for _ in range(10):
        session.send(message)
    with pytest.raises(PeerError, match="does not read: 1000 bytes"):
        session.send(message)
    assert len(session.data_to_send()) == 1000
    session.send(message)  # it has read again


def test_the_default_limit_is_one_mebibyte():
    session = RobotSession(GREETING)
    message = Message("SEN", (("Type", "x" * 10_000),))
    for _ in range(104):  # 104 times 10013 bytes is the most that fits into 1048576
        session.send(message)
    with pytest.raises(PeerError, match="does not read"):
        session.send(message)
    assert SEND_LIMIT == 1 << 20


def test_a_closed_session_is_silent_and_deaf():
    session = RobotSession(GREETING)
    session.receive_data(INIT_LINE + b"DRIVE {Left 1}\r\n")
    session.close()
    assert session.answer_init(True) == []
    session.send(GREETING)
    assert session.data_to_send() == b""
    assert session.receive_data(b"GETSTARTPOSES\r\n") == []
    assert session.receive_eof() == []
    assert session.phase is SessionPhase.CLOSED


def test_a_refused_init_counts_as_many_faults_in_a_row_until_one_is_accepted():
    session = RobotSession(GREETING)
    session.receive_data(b"NONSENSE\r\n" + INIT_LINE)
    session.answer_init(False)
    assert (session.fault_count, session.faults_in_a_row) == (2, 1 + REFUSAL_FAULTS)
    session.receive_data(INIT_LINE)
    session.answer_init(True)
    assert (session.fault_count, session.faults_in_a_row) == (2, 0)
