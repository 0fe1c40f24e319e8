"""Dialect B of the wireless server and the position service without sockets.

Replies are those of the stand-alone server and of the position service, as captured from their protocols.
"""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.server.fake_radio import FakeRadio
from usarmjx.server.wireless import dialect_b
from usarmjx.server.wireless.dialect_b import (
    JOIN_TIMEOUT,
    TRANSITIONS,
    WRONG_PHASE_REASONS,
    DialectBPhase,
    DialectBSession,
    Route,
    Switchboard,
    parse_strict,
)
from usarmjx.server.wireless.positions import PositionSession

HERE, THERE = "127.0.0.1", "10.0.0.2"


class Party:
    """A switchboard whose clock stands still and whose port numbers count up from 40000."""

    def __init__(self, *robots, powers=None, ports=64000):
        self.radio = FakeRadio(robots or ("R1", "R2"), powers)
        self.time = 0.0
        numbers = iter(range(40000, 40000 + ports))
        self.board = Switchboard(self.radio, lambda route: next(numbers, None), lambda: self.time)

    def session(self, address=HERE):
        return DialectBSession(self.board, address)

    def joined(self, name, ports="3333", address=HERE):
        session = self.session(address)
        assert ask(session, f"INIT {{Robot {name}}} {{Port {ports}}}") == "INITREPLY {Status OK}"
        return session


def ask(session, line):
    """The reply to a line, which is one line."""
    reply = session.receive_data(line.encode("latin-1") + b"\r\n").decode("latin-1")
    assert reply.endswith("\r\n")
    assert reply.count("\n") == 1
    return reply[:-2]


def error(reason):
    return f"ERROR {{Reason {reason}}}"


# INIT


def test_init_comes_first_and_once():
    party = Party()
    session = party.session()
    for line in ("GETSS {Robot R2}", "DNS {Robot R2}", "REVERSEDNS {Port 1}", "HELLO", "init {Robot R1}"):
        assert ask(session, line) == error("Must.Use.INIT.Method.First")
    assert ask(session, "INIT {Robot R1} {Port 3333,2323}") == "INITREPLY {Status OK}"
    for line in ("INIT {Robot R1} {Port 3333}", "HELLO {There you}", "getss {Robot R2}"):
        assert ask(session, line) == error("Method.Unknown.Or.Can.INIT.only.once")
    assert party.board.ports_of("R1") == (3333, 2323)


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("INIT {Robot R3} {Port x}", "Ports.List.Must.Be.Integer"),
        ("INIT {Robot R3} {Port 1,,2}", "Ports.List.Must.Be.Integer"),
        ("INIT {Robot R3} {Port 1,70000}", "Ports.List.Must.Be.Integer"),
        ("INIT {Robot R3} {Port -1}", "Ports.List.Must.Be.Integer"),
        ("INIT {Robot } {Port 1}", "Robot.Name.Must.Not.Be.Empty"),
        ("INIT {Port 1}", "Robot.Name.Must.Not.Be.Empty"),
        ("INIT", "Robot.Name.Must.Not.Be.Empty"),
        ("INIT {Robot R1} {Port 1}", "Robot.Alread.Exists"),
    ],
)
def test_init_can_fail_and_be_tried_again(line, reason):
    party = Party()
    party.joined("R1")
    session = party.session()
    assert ask(session, line) == error(reason)
    assert session.phase is DialectBPhase.NEW
    assert ask(session, "INIT {Robot R2} {Port 1}") == "INITREPLY {Status OK}"


@pytest.mark.parametrize("ports", ["", " {Port 0}"], ids=["none", "0"])
def test_a_robot_that_only_calls_needs_no_port(ports):
    """It says none, or 0, which the stand-alone server takes."""
    party = Party()
    other, caller = party.joined("R2"), party.session()
    assert ask(caller, f"INIT {{Robot R1}}{ports}") == "INITREPLY {Status OK}"
    for asked in ("DNS {Robot R1}", "DNS {Robot R1} {Port 0}"):
        assert ask(other, asked) == "DNSREPLY {Robot R1} {Port -1} {Error RobotDoesNotListenOnThisPort}"
    assert ask(caller, "DNS {Robot R2}") == "DNSREPLY {Robot R2} {Port 40000}"


@pytest.mark.parametrize(
    ("line", "read"),
    [
        ("INIT {Robot R1} {Port 3333}", ("INIT", {"Robot": "R1", "Port": "3333"})),
        ("INIT {Robot R1}", ("INIT", {"Robot": "R1"})),
        ("INIT{Robot R1} {Port 1}", ("INIT{Robot", {})),  # no space behind the verb
        ("INIT  {Robot R1}", ("INIT", {})),
        ("INIT {Robot R1}{Port 1}", ("INIT", {})),
        ("INIT {Robot R1}  {Port 1}", ("INIT", {"Robot": "R1"})),
        ("INIT {Robot R1} and {Port 1}", ("INIT", {"Robot": "R1"})),
        ("INIT {Robot My Robot} {Port 1}", ("INIT", {"Port": "1"})),
        ("INIT {Robot} {Port 1}", ("INIT", {"Robot": "", "Port": "1"})),
        ("INIT {robot R1}", ("INIT", {"robot": "R1"})),
        ("INIT {Robot a{b}", ("INIT", {})),
        ("", ("", {})),
    ],
)
def test_the_parser_is_strict(line, read):
    assert parse_strict(line) == read


# GETSS


def test_signal_strength():
    """Six figures, as a C++ stream prints a double."""
    party = Party(powers={("R1", "R2"): -51.43094})
    one, _ = party.joined("R1"), party.joined("R2")
    assert ask(one, "GETSS {Robot R2}") == "SS {Robot R2} {Strength -51.4309}"


@pytest.mark.parametrize(
    ("other", "power", "strength"),
    [
        ("R1", -50.0, "INF} {Error SS.To.Self"),
        ("R3", -50.0, "NaN} {Error Robot.Does.Not.Exist"),
        ("r2", -50.0, "NaN} {Error Robot.Does.Not.Exist"),  # names are compared with case here
        ("R2", float("inf"), "INF} {Error Model.Returned.INF"),
        ("R2", float("nan"), "NaN} {Error Model.Returned.NaN"),
        ("R2", 0.5, "NaN} {Error Model.Returned.NaN"),
        ("R2", -200.0, "-200"),
    ],
)
def test_signal_strength_that_is_no_number(other, power, strength):
    party = Party(powers={("R1", "R2"): power})
    one, _ = party.joined("R1"), party.joined("R2")
    assert ask(one, f"GETSS {{Robot {other}}}") == f"SS {{Robot {other}}} {{Strength {strength}}}"


def test_signal_strength_of_a_robot_that_is_not_in_the_world():
    party = Party("R1")
    one, _ = party.joined("R1"), party.joined("R2")
    assert ask(one, "GETSS {Robot R2}") == "SS {Robot R2} {Strength NaN} {Error Model.Returned.NaN}"


# DNS


def test_a_number_is_given_per_caller_called_and_port_and_stays():
    party = Party("R1", "R2", "R3")
    one, two, three = party.joined("R1"), party.joined("R2", "3333,2323"), party.joined("R3")
    first = ask(one, "DNS {Robot R2} {Port 3333}")
    assert first == "DNSREPLY {Robot R2} {Port 40000}"
    assert ask(one, "DNS {Robot R2}") == first, "the first port of INIT"
    assert ask(one, "DNS {Robot R2} {Port 2323}") == "DNSREPLY {Robot R2} {Port 40001}"
    assert ask(three, "DNS {Robot R2} {Port 3333}") == "DNSREPLY {Robot R2} {Port 40002}"
    assert ask(two, "DNS {Robot R1}") == "DNSREPLY {Robot R1} {Port 40003}"
    assert ask(one, "DNS {Robot R2} {Port 3333}") == first


@pytest.mark.parametrize(
    ("line", "reply"),
    [
        ("DNS {Robot R3}", "DNSREPLY {Robot R3} {Port -1} {Error NoSuchRobot}"),
        ("DNS {Robot R1}", "DNSREPLY {Robot R1} {Port -1} {Error NoSuchRobot}"),
        (
            "DNS {Robot R2} {Port 1}",
            "DNSREPLY {Robot R2} {Port -1} {Error RobotDoesNotListenOnThisPort}",
        ),
        ("DNS {Robot R2} {Port x}", error("Port.Must.Be.Integer")),
        ("DNS {Port 3333}", error("Robot.Name.Must.Not.Be.Empty")),
    ],
)
def test_a_number_that_cannot_be_given(line, reply):
    party = Party()
    one, _ = party.joined("R1"), party.joined("R2")
    assert ask(one, line) == reply


def test_no_port_left():
    party = Party(ports=1)
    one, _ = party.joined("R1"), party.joined("R2", "1,2")
    assert ask(one, "DNS {Robot R2} {Port 1}") == "DNSREPLY {Robot R2} {Port 40000}"
    assert ask(one, "DNS {Robot R2} {Port 2}") == error("Could.Not.Allocate.Port")
    assert ask(one, "DNS {Robot R2} {Port 1}") == "DNSREPLY {Robot R2} {Port 40000}"


def test_numbers_per_robot_are_bounded():
    party = Party()
    ports = [str(port) for port in range(1, dialect_b.MAX_PORTS_PER_ROBOT + 2)]
    one, _ = party.joined("R1"), party.joined("R2", ",".join(ports))
    replies = [ask(one, f"DNS {{Robot R2}} {{Port {port}}}") for port in ports]
    assert all(reply.startswith("DNSREPLY") for reply in replies[:-1])
    assert replies[-1] == error("Could.Not.Allocate.Port")


def test_numbers_and_pipes_of_all_robots_together_are_bounded(monkeypatch):
    monkeypatch.setattr(dialect_b, "MAX_PORTS", 2)
    monkeypatch.setattr(dialect_b, "MAX_CONNECTIONS", 1)
    party = Party()
    one, two = party.joined("R1", "1,2"), party.joined("R2", "1,2")
    for session, line in ((one, "DNS {Robot R2}"), (two, "DNS {Robot R1}")):
        assert ask(session, line).startswith("DNSREPLY")
    assert ask(one, "DNS {Robot R2} {Port 2}") == error("Could.Not.Allocate.Port")
    assert party.board.may_call(Route("R1", "R2", 1), HERE)
    party.board.add_connection(Route("R2", "R1", 1), 50000)
    assert not party.board.may_call(Route("R1", "R2", 1), HERE)


# REVERSEDNS


def test_who_calls_is_told_to_the_one_who_is_called():
    party = Party()
    one, two = party.joined("R1"), party.joined("R2")
    unknown = "REVERSEDNSREPLY {Port 51234} {Error UnknownOrIllegalPort}"
    assert ask(two, "REVERSEDNS {Port 51234}") == unknown
    party.board.add_connection(Route("R1", "R2", 3333), 51234)
    assert ask(two, "REVERSEDNS {Port 51234}") == "REVERSEDNSREPLY {Port 51234} {Robot R1}"
    assert ask(one, "REVERSEDNS {Port 51234}") == unknown, "not its call"
    party.board.remove_connections(51234)
    assert ask(two, "REVERSEDNS {Port 51234}") == unknown
    for line in ("REVERSEDNS {Port x}", "REVERSEDNS", "REVERSEDNS {Port -1}"):
        assert ask(two, line) == error("Port.Must.Be.Integer")


# The signal


def open_route(party):
    one, two = party.joined("R1"), party.joined("R2")
    ask(one, "DNS {Robot R2}")
    return one, two, Route("R1", "R2", 3333)


def test_a_number_opens_when_it_is_given_if_the_signal_carries():
    party = Party()
    _, _, route = open_route(party)
    assert party.board.take_opened() == [route]
    assert party.board.take_opened() == []
    assert party.board.is_open(route)


def test_a_number_stays_closed_without_a_signal_and_follows_it():
    party = Party(powers={("R1", "R2"): -93.01})
    one, _, route = open_route(party)
    assert party.board.take_opened() == []
    assert not party.board.is_open(route)
    assert not party.board.poll().opened
    party.radio.powers["R1", "R2"] = -93.0
    assert not party.board.is_open(route), "until somebody looks"
    assert party.board.poll().opened == (route,)
    assert not party.board.poll().opened, "told once"
    party.radio.powers["R1", "R2"] = -93.01
    assert party.board.poll().closed == (route,)
    assert not party.board.poll().closed
    party.radio.powers["R1", "R2"] = -90.0
    assert ask(one, "DNS {Robot R2}") == "DNSREPLY {Robot R2} {Port 40000}"
    assert party.board.take_opened() == [route], "asking is looking"


def test_a_number_that_could_not_be_opened_is_tried_again():
    party = Party()
    _, _, route = open_route(party)
    party.board.failed(route)
    assert party.board.poll().opened == (route,)


def test_only_the_caller_may_call_and_only_with_a_signal():
    party = Party()
    _, _, route = open_route(party)
    assert party.board.may_call(route, HERE)
    assert not party.board.may_call(route, THERE)
    assert not party.board.may_call(Route("R2", "R1", 3333), HERE), "no such number"
    party.radio.powers["R1", "R2"] = -100.0
    assert not party.board.may_call(route, HERE), "though nobody has looked yet"


def test_pipes_per_robot_are_bounded():
    party = Party()
    _, _, route = open_route(party)
    for port in range(dialect_b.MAX_CONNECTIONS_PER_ROBOT):
        assert party.board.may_call(route, HERE)
        party.board.add_connection(route, port)
    assert not party.board.may_call(route, HERE)
    party.board.remove_connections(0)
    assert party.board.may_call(route, HERE)


@pytest.mark.parametrize("end", ["left", "battery"])
def test_a_robot_that_ends_takes_part_no_longer(end):
    party = Party()
    _, _, route = open_route(party)
    party.board.poll()
    if end == "left":
        party.radio.robots.remove("R2")
    else:
        party.radio.empty.add("R2")
    changes = party.board.poll()
    assert (changes.gone, changes.closed) == (("R2",), (route,))


def test_a_robot_may_come_late():
    party = Party("R1")
    party.joined("R1")
    party.joined("R2")
    party.time = JOIN_TIMEOUT
    assert party.board.poll().gone == ()
    party.time = JOIN_TIMEOUT + 0.1
    assert party.board.poll().gone == ("R2",)


def test_a_robot_is_found_in_the_world_in_any_case():
    party = Party("r1", "R2")
    open_route(party)
    party.time = 2 * JOIN_TIMEOUT
    assert party.board.poll().gone == ()


def test_who_leaves_gives_up_his_numbers_and_those_that_lead_to_him_close():
    party = Party()
    one, two, route = open_route(party)
    ask(two, "DNS {Robot R1}")
    back = Route("R2", "R1", 3333)
    assert party.board.leave("R2") == ([back], [route])
    assert not party.board.poll().opened
    assert ask(one, "DNS {Robot R2}") == "DNSREPLY {Robot R2} {Port -1} {Error NoSuchRobot}"
    party.joined("R2", "1")
    assert not party.board.poll().opened, "it does not listen there any more"
    party.board.leave("R2")
    party.joined("R2", "3333")
    assert party.board.poll().opened == (route,), "the same number again"
    assert ask(one, "DNS {Robot R2}") == "DNSREPLY {Robot R2} {Port 40000}"


def test_the_tables_cover_every_phase():
    assert set(TRANSITIONS) == set(WRONG_PHASE_REASONS) == set(DialectBPhase)


# Chunking

DIALOGUE = (
    b"HELLO\r\nINIT {Robot R1} {Port 1}\nGETSS {Robot R2}\r\n\r\nDNS {Robot R2}\r\nREVERSEDNS {Port 7}\r\n"
    + b"x" * 3000
    + b"\r\nGETSS {Robot R1}\r\n"
)


def converse(chunks):
    party = Party(powers={("R1", "R2"): -60.25})
    party.joined("R2")
    session = party.session()
    return b"".join(session.receive_data(chunk) for chunk in chunks)


def cut(data, places):
    edges = sorted({0, len(data), *(place % len(data) for place in places)})
    return [data[a:b] for a, b in pairwise(edges)]


@given(st.lists(st.integers(0, 10_000), max_size=30))
def test_lines_may_be_cut_anywhere(places):
    whole = converse([DIALOGUE])
    assert whole.decode().splitlines() == [
        error("Must.Use.INIT.Method.First"),
        "INITREPLY {Status OK}",
        "SS {Robot R2} {Strength -60.25}",
        "DNSREPLY {Robot R2} {Port 40000}",
        "REVERSEDNSREPLY {Port 7} {Error UnknownOrIllegalPort}",
        "SS {Robot R1} {Strength INF} {Error SS.To.Self}",
    ]
    assert converse(cut(DIALOGUE, places)) == whole


@given(st.binary(max_size=200).filter(lambda data: b"\r" not in data and b"\n" not in data))
def test_junk_is_answered_with_an_error(data):
    session = Party().session()
    reply = session.receive_data(data + b"\r\n")
    blank = not data.decode("latin-1").strip()
    assert reply == (b"" if blank else (error("Must.Use.INIT.Method.First") + "\r\n").encode())


@given(st.text("R1 {}PortDNSGETobx,\t", max_size=60))
def test_almost_lines_never_break_a_session(text):
    session = Party().joined("R1")
    for verb in ("DNS ", "GETSS ", "REVERSEDNS ", "INIT "):
        assert session.receive_data((verb + text + "\r\n").encode()).endswith(b"\r\n")


# The position service


def answer(radio, line):
    return PositionSession(radio).receive_data(line + b"\r\n").decode()


def test_positions_are_in_the_wires_axes():
    radio = FakeRadio(["R1", "Base"])
    radio.positions = {"R1": (4.5, -1.9, -1.8), "Base": (0.0, 0.25, -1.0)}
    radio.empty = {"Base"}
    assert answer(radio, b"GETPOS") == (
        "POSITIONS {Robots 2} {Name R1 Location 4.5000,1.9000,1.8000 BatteryEmpty False}"
        " {Name Base Location 0.0000,-0.2500,1.0000 BatteryEmpty True}\r\n"
    )


def test_positions_of_an_empty_world():
    assert answer(FakeRadio([]), b"getpos") == "POSITIONS {Robots 0}\r\n"


def test_a_name_of_several_words_stays_one_word_in_its_segment():
    assert "{Name My_robot Location 0.0000" in answer(FakeRadio(["My robot"]), b"GETPOS")


def test_obstacles_between_robots_and_between_places():
    radio = FakeRadio(["R1", "R2"])
    radio.walls = {("R1", "R2"): 3, ((0.0, -1.0, -2.0), (3.0, 0.0, -2.0)): 2}
    assert answer(radio, b"GETOBS {From R2} {To r1}") == "NUMOBS {From R2} {To r1} {ObstCount 3.00}\r\n"
    assert answer(radio, b"GETOBS {Start 0,1,2} {End 3,0,2}") == (
        "NUMOBS {Start 0,1,2} {End 3,0,2} {ObstCount 2.00}\r\n"
    )
    assert answer(radio, b"GETOBS {From R1} {To R3}") == "NUMOBS {From R1} {To R3} {ObstCount -1}\r\n"


@pytest.mark.parametrize(
    "line",
    [
        b"GETOBS",
        b"GETOBS {From R1}",
        b"GETOBS {Start 0,1} {End 0,0,0}",
        b"GETOBS {Start a,b,c} {End 0,0,0}",
        b"GETOBS {Start 0,1,2x} {End 0,0,0}",
        b"GETOBS {Start nan,0,0} {End 0,0,0}",
    ],
)
def test_questions_without_sense_are_not_answered(line):
    assert answer(FakeRadio(["R1"]), line) == ""


@given(st.binary(max_size=200), st.lists(st.integers(0, 10_000), max_size=10))
def test_positions_are_told_however_lines_are_cut(junk, places):
    data = b"GETPOS\r\n" + junk.replace(b"\n", b"").replace(b"\r", b"") + b"\r\nGETOBS {From R1} {To R2}\r\n"
    whole = PositionSession(FakeRadio(["R1", "R2"])).receive_data(data)
    assert whole.startswith(b"POSITIONS {Robots 2} ")
    assert whole.endswith(b"NUMOBS {From R1} {To R2} {ObstCount 0.00}\r\n")
    session = PositionSession(FakeRadio(["R1", "R2"]))
    assert b"".join(session.receive_data(piece) for piece in cut(data, places)) == whole
