"""Dialect A of the wireless server without sockets: messages, replies, tables, and the framing of links.

Replies are those of the in-engine server, as captured from its protocol; the manual's text (3.2.4.3) prints
`OK:` where it sends `OK;`.
"""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.server.fake_radio import FakeRadio
from usarmjx.base.errors import PeerError
from usarmjx.server.wireless import dialect_a
from usarmjx.server.wireless.dialect_a import (
    MAX_MESSAGE_SIZE,
    MAX_PAYLOAD,
    TRANSITIONS,
    VERBS,
    ComServer,
    DataLinkParser,
    DialectAPhase,
    DialectASession,
    Endpoint,
    EndpointPair,
    Refusal,
    Register,
    parse_request,
)
from usarmjx.server.wireless.dialect_a import DataLinkPhase as Part

HERE, THERE = "127.0.0.1", "10.0.0.2"


class Party:
    """A server with some robots in its world, and sessions with it."""

    def __init__(self, *robots, powers=None, allowed=()):
        self.radio = FakeRadio(robots or ("R1", "R2"), powers)
        self.server = ComServer(self.radio, allowed)
        self.sessions = {}

    def session(self, caller=HERE):
        return self.sessions.setdefault(caller, DialectASession(self.server, caller))

    def ask(self, text, caller=HERE):
        """The reply to messages that open no link."""
        session = self.session(caller)
        assert session.receive_data(text.encode("latin-1")) is None
        return session.data_to_send().decode("latin-1")

    def open(self, text, caller=HERE):
        """The link that messages open; no reply yet."""
        session = self.session(caller)
        endpoints = session.receive_data(text.encode())
        assert session.data_to_send() == b""
        return endpoints

    def answer(self, done, caller=HERE):
        session = self.session(caller)
        assert session.answer_open(done) is None
        return session.data_to_send().decode()


def registered(*robots, powers=None, allowed=()):
    party = Party(*robots, powers=powers, allowed=allowed)
    for robot in ("R1", "R2"):
        assert party.ask(f"REGISTER {robot} {HERE};") == "OK;"
    return party


# Requests and their replies


def test_a_robot_is_registered_once_per_address():
    party = Party()
    assert party.ask(f"REGISTER R1 {HERE};") == "OK;"
    assert party.ask(f"REGISTER R1 {HERE};") == "OK;", "again, as a controller that starts anew does"
    assert party.ask(f"REGISTER R1 {THERE};", THERE) == "Fail: Robot with name R1 already registered;"
    assert party.ask(f"REGISTER r1 {THERE};", THERE) == "OK;", "names are compared with case here"


def test_registering_does_not_need_a_living_robot():
    party = Party("R1")
    assert party.ask(f"REGISTER Nobody {HERE};LISTEN Nobody 4000;") == "OK;OK;"


def test_listening_needs_registration_and_happens_once_per_port():
    party = registered()
    assert party.ask("LISTEN R3 4000;") == "Fail: Robot R3 not registered;"
    assert party.ask("LISTEN R1 4000;") == "OK;"
    assert party.ask("LISTEN R1 4000;") == "Fail: Robot with name R1 already listening at port 4000;"
    assert party.ask("LISTEN R1 4001;LISTEN R2 4000;") == "OK;OK;"


def test_opening_dials_both_robots_and_uses_up_the_listening():
    party = registered()
    party.ask("LISTEN R2 4002;")
    endpoints = party.open("OPEN R1 4001 R2 4002;")
    assert endpoints == EndpointPair(Endpoint("R1", HERE, 4001), Endpoint("R2", HERE, 4002))
    assert party.answer(True) == "OK;"
    assert party.ask("OPEN R1 4001 R2 4002;") == "Fail: R2 not listening on port 4002;"


def test_opening_needs_a_robot_to_listen():
    party = registered()
    party.ask("LISTEN R1 4003;LISTEN R2 4003;")
    assert party.ask("OPEN R1 4001 R2 4002;") == "Fail: R2 not listening on port 4002;"


def test_the_robot_that_listens_may_be_named_first():
    """Manual 3.2.4.3: RobotName "is listening for connections at Port", HostRobot sets the link up."""
    party = registered()
    party.ask("LISTEN R1 4001;")
    endpoints = party.open("OPEN R1 4001 R2 4002;")
    assert endpoints == EndpointPair(Endpoint("R2", HERE, 4002), Endpoint("R1", HERE, 4001))
    assert party.answer(False) == "Fail: Could not establish connection;"
    assert party.open("OPEN R1 4001 R2 4002;") is not None, "R1 goes on listening"
    assert party.answer(True) == "OK;"
    assert party.ask("OPEN R1 4001 R2 4002;") == "Fail: R2 not listening on port 4002;"


def test_opening_below_the_cutoff_fails():
    """Manual 3.2.4: below -93 dBm the attempt at opening a connection fails."""
    party = registered(powers={("R1", "R2"): -93.01})
    party.ask("LISTEN R2 4002;")
    assert party.ask("OPEN R1 4001 R2 4002;") == "Fail: Cannot connect to R2;"
    party.radio.powers["R1", "R2"] = -93.0
    assert party.open("OPEN R1 4001 R2 4002;") is not None


def test_opening_to_a_robot_that_is_not_in_the_world_fails():
    party = registered("R1")
    party.ask("LISTEN R2 4002;")
    assert party.ask("OPEN R1 4001 R2 4002;") == "Fail: Cannot connect to R2;"


def test_an_end_that_does_not_answer_leaves_the_other_listening():
    party = registered()
    party.ask("LISTEN R2 4002;")
    party.open("OPEN R1 4001 R2 4002;")
    assert party.answer(False) == "Fail: Could not establish connection;"
    assert party.open("OPEN R1 4001 R2 4002;") is not None


def test_opening_without_registration_of_the_first_robot_fails():
    party = Party()
    party.ask(f"REGISTER R2 {HERE};LISTEN R2 4002;")
    assert party.ask("OPEN R1 4001 R2 4002;") == "Fail: Could not establish connection;"


def test_messages_behind_an_opening_wait_for_it():
    party = registered(powers={("R1", "R2"): -60.0})
    party.ask("LISTEN R2 4002;LISTEN R2 4003;")
    assert party.open("OPEN R1 1 R2 4002;GETSS R1 R2;OPEN R1 2 R2 4003;GETSS R2 R1;").first.port == 1
    session = party.session()
    assert session.phase is DialectAPhase.OPENING
    second = session.answer_open(True)
    assert (second.first.port, session.data_to_send()) == (2, b"OK;OK:-60.00;")
    assert session.answer_open(False) is None
    assert session.data_to_send() == b"Fail: Could not establish connection;OK:-60.00;"


def test_signal_strength_has_two_decimals_as_unrealscript_prints_floats():
    party = registered(powers={("R1", "R2"): -51.43094})
    assert party.ask("GETSS R1 R2;GETSS R2 R1;") == "OK:-51.43;OK:-51.43;"


def test_signal_strength_below_the_cutoff_is_told_too():
    party = registered(powers={("R1", "R2"): -120.0})
    assert party.ask("GETSS R1 R2;") == "OK:-120.00;"


@pytest.mark.parametrize(
    ("robots", "power"), [(("R1",), -50.0), (("R1", "R2"), 0.5)], ids=["not there", "on top of each other"]
)
def test_signal_strength_that_cannot_be_told(robots, power):
    party = registered(*robots, powers={("R1", "R2"): power})
    assert party.ask("GETSS R1 R2;") == "Fail: Could not calculate signal strength;"


def test_signal_strength_is_told_to_the_two_robots_only():
    party = registered(powers={("R1", "R2"): -50.0})
    refusal = "Fail: Server does not accept third party requests;"
    assert party.ask("GETSS R1 R2;", THERE) == refusal
    party.ask(f"REGISTER R3 {THERE};", THERE)
    assert party.ask("GETSS R1 R2;", THERE) == refusal
    assert party.ask("GETSS R3 R4;") == refusal, "neither is the caller's"


@pytest.mark.parametrize(
    "text",
    [
        "REGISTER R1;",
        "REGISTER R1 127.0.0.1 7;",
        "LISTEN R1;",
        "OPEN R1 1 R2;",
        "GETSS R1;",
        "GETSS R1 R2 R3;",
        "LISTEN R1 port;",
        "LISTEN R1 0;",
        "LISTEN R1 65536;",
        "LISTEN R1 -1;",
        "LISTEN R1 ²;",
        "OPEN R1 1 R2 1e3;",
        "REGISTER R1 nowhere;",
        "REGISTER R1 127.0.0.1.5;",
    ],
)
def test_the_wrong_words_are_an_incorrect_message(text):
    assert registered().ask(text) == "Fail: Incorrect Message;"


@pytest.mark.parametrize(
    "text", [";", " ;", "SEND 1 a;", "CLOSE;", "HELO R1 R2;", "GETSSR1 R2;", "\xff\x00;"]
)
def test_an_unknown_verb(text):
    assert registered().ask(text) == "Fail: Unknown Message;"


def test_the_verb_is_taken_in_any_case_and_line_ends_are_dropped():
    party = Party(powers={("R1", "R2"): -50.0})
    text = f"register R1 {HERE};\r\nRegister R2 {HERE};\n  listen R1 4000 ;\rgetSS R1 R2\r\n;"
    assert party.ask(text) == "OK;OK;OK;OK:-50.00;"


def test_a_message_that_is_too_long_is_refused_once_and_skipped():
    party = registered(powers={("R1", "R2"): -50.0})
    session = party.session()
    for _ in range(100):
        assert session.receive_data(b"x" * MAX_MESSAGE_SIZE) is None
        assert session.data_to_send() == b""
        assert len(session._pending) <= MAX_MESSAGE_SIZE
    assert party.ask(";GETSS R1 R2;") == "Fail: Incorrect Message;OK:-50.00;"


# What a peer may and may not make the server do


def test_only_the_own_address_may_be_registered():
    party = Party()
    assert party.ask(f"REGISTER R1 {THERE};") == f"Fail: Address {THERE} is not yours;"
    assert party.ask("REGISTER R1 0.0.0.0;") == "Fail: Address 0.0.0.0 is not yours;"
    assert party.ask("LISTEN R1 4000;") == "Fail: Robot R1 not registered;"


def test_an_allowed_address_may_be_registered_by_anybody():
    party = Party(allowed=[THERE])
    assert party.ask(f"REGISTER R1 {THERE};LISTEN R1 4001;") == "OK;OK;"
    assert party.ask(f"REGISTER R2 {HERE};") == "OK;"
    assert party.open("OPEN R2 4002 R1 4001;").second == Endpoint("R1", THERE, 4001)


@pytest.mark.parametrize(
    ("told", "caller"),
    [("localhost", HERE), ("::1", "::1"), ("0:0:0:0:0:0:0:1", "::1"), (HERE, "::ffff:127.0.0.1")],
)
def test_an_address_has_several_spellings(told, caller):
    assert Party().ask(f"REGISTER R1 {told};", caller) == "OK;"


def test_nobody_listens_for_somebody_else():
    party = registered()
    assert party.ask("LISTEN R1 22;", THERE) == "Fail: Server does not accept third party requests;"


def test_nobody_opens_a_link_between_others():
    party = registered()
    party.ask("LISTEN R1 4001;LISTEN R2 4002;")
    assert party.ask("OPEN R1 4001 R2 4002;", THERE) == "Fail: Server does not accept third party requests;"


def test_a_stranger_cannot_have_a_port_dialled_that_was_not_offered():
    """R1's machine may have other services, which are none of R3's business."""
    party = registered("R1", "R2", "R3")
    party.ask(f"REGISTER R3 {THERE};LISTEN R3 4003;", THERE)
    assert party.ask("OPEN R1 22 R3 4003;", THERE) == "Fail: R1 not listening on port 22;"
    party.ask("LISTEN R1 4001;")
    assert party.open("OPEN R1 4001 R3 4003;", THERE) is not None


def test_links_per_robot_are_bounded():
    party = registered()
    for port in range(1, dialect_a.MAX_LINKS_PER_ROBOT + 2):
        party.ask(f"LISTEN R2 {port};")
        if port <= dialect_a.MAX_LINKS_PER_ROBOT:
            endpoints = party.open(f"OPEN R1 9 R2 {port};")
            assert party.answer(True) == "OK;"
    last = dialect_a.MAX_LINKS_PER_ROBOT + 1
    assert party.ask(f"OPEN R1 9 R2 {last};") == "Fail: Could not establish connection;"
    party.server.closed(endpoints)
    assert party.open(f"OPEN R1 9 R2 {last};") is not None


def test_links_of_all_robots_together_are_bounded(monkeypatch):
    monkeypatch.setattr(dialect_a, "MAX_LINKS", 2)
    party = registered()
    for port in (1, 2, 3):
        party.ask(f"LISTEN R2 {port};")
    for port in (1, 2):
        party.open(f"OPEN R1 9 R2 {port};")
        party.answer(True)
    assert party.ask("OPEN R1 9 R2 3;") == "Fail: Could not establish connection;"


def test_ports_per_robot_are_bounded():
    party = registered()
    replies = [party.ask(f"LISTEN R1 {port};") for port in range(1, dialect_a.MAX_LISTEN_PORTS + 2)]
    assert set(replies[:-1]) == {"OK;"}
    assert replies[-1].startswith("Fail: Robot with name R1 already listening at ")


def test_registrations_without_a_robot_make_room():
    party = registered()
    for i in range(3 * dialect_a.MAX_REGISTRATIONS):
        assert party.ask(f"REGISTER Junk{i} {HERE};") == "OK;"
    assert len(party.server._registrations) == dialect_a.MAX_REGISTRATIONS
    assert party.ask("LISTEN R1 4000;LISTEN R2 4000;") == "OK;OK;", "robots in the world keep theirs"


def test_a_name_is_free_for_another_address_once_its_robot_has_left():
    party = registered()
    party.server.poll_presence()
    taken = "Fail: Robot with name R1 already registered;"
    assert party.ask(f"REGISTER R1 {THERE};", THERE) == taken
    party.radio.robots = ["R2"]
    party.server.poll_presence()
    assert party.ask("LISTEN R1 4000;") == "OK;", "its own controller may come back"
    assert party.ask(f"REGISTER R1 {THERE};", THERE) == "OK;"
    assert party.ask("LISTEN R1 4000;") == "Fail: Server does not accept third party requests;"


def test_a_connection_is_alive_through_robots_that_it_registered():
    party = Party("R1")
    assert not party.session().alive
    party.ask(f"REGISTER R2 {HERE};")
    assert not party.session().alive
    party.ask(f"REGISTER R1 {HERE};")
    assert party.session().alive
    assert not party.session(THERE).alive


def test_every_request_has_a_transition():
    assert {request for _, request in TRANSITIONS} == {
        type(parse_request(text))
        for text in (f"REGISTER R1 {HERE}", "LISTEN R1 1", "OPEN R1 1 R2 2", "GETSS R1 R2")
    }
    assert len(TRANSITIONS) == len(VERBS)


# Chunking

DIALOGUE = (
    f"REGISTER R1 {HERE};REGISTER R2 {HERE};\r\nLISTEN R2 4002;nonsense;OPEN R1 4001 R2 4002;"
    f"GETSS R1 R2;{'x' * (MAX_MESSAGE_SIZE + 5)};LISTEN R1 1;"
).encode()


def converse(chunks):
    party, replies = Party(powers={("R1", "R2"): -60.0}), b""
    session = party.session()
    for chunk in chunks:
        endpoints = session.receive_data(chunk)
        while endpoints:
            endpoints = session.answer_open(True)
        replies += session.data_to_send()
    return replies


def cut(data, places):
    edges = sorted({0, len(data), *(place % len(data) for place in places)})
    return [data[a:b] for a, b in pairwise(edges)]


@given(st.lists(st.integers(0, 10_000), max_size=30))
def test_control_messages_may_be_cut_anywhere(places):
    whole = converse([DIALOGUE])
    assert whole == (b"OK;OK;OK;Fail: Unknown Message;OK;OK:-60.00;Fail: Incorrect Message;OK;")
    assert converse(cut(DIALOGUE, places)) == whole


@given(st.binary(max_size=300))
def test_junk_never_breaks_a_session(data):
    session = Party().session()
    session.receive_data(data + b";")
    replies = session.data_to_send()
    assert replies.count(b";") == data.count(b";") + 1


# Data links


def framed(messages, trailer=b";"):
    return b"".join(b"SEND %d %b%b" % (len(message), message, trailer) for message in messages)


def test_a_send_arrives_bare():
    assert DataLinkParser().receive_data(b"SEND 5 hello;SEND 0 ;SEND 3 a;b;") == [b"hello", b"", b"a;b"]


def test_a_message_counts_when_its_trailer_is_there():
    parser = DataLinkParser()
    assert parser.receive_data(b"SEND 5 hello") == []
    assert parser.receive_data(b"!SEND") == [b"hello"], "any byte does as a trailer"


def test_close_ends_the_link_and_what_follows_is_dropped():
    parser = DataLinkParser()
    assert parser.receive_data(b"SEND 1 a;CLOSE;SEND 1 b;") == [b"a"]
    assert parser.phase is Part.CLOSED
    assert parser.receive_data(b"SEND 1 c;") == []


@pytest.mark.parametrize("word", [b"send 1 a;", b"close;", b"HELLO WORLD;", b"SEND\t1 a;", b"SENDX 4 abcd;"])
def test_other_words_are_skipped_up_to_the_semicolon(word):
    assert DataLinkParser().receive_data(word + b"SEND 1 b;") == [b"b"]


@pytest.mark.parametrize("length", [b"-1", b"x", b"", b"1x", b"0x10", b"1.5"])
def test_a_length_that_is_none_is_skipped_up_to_the_semicolon(length):
    assert DataLinkParser().receive_data(b"SEND " + length + b" abc;SEND 1 b;") == [b"b"]


def test_line_ends_between_messages_are_dropped():
    assert DataLinkParser().receive_data(b"\r\nSEND 1 a;\r\n\nSEND 2 \r\n;\rSEND 1 c;") == [
        b"a",
        b"\r\n",
        b"c",
    ]


@pytest.mark.parametrize(
    "length", [str(MAX_PAYLOAD + 1).encode(), b"1000000000000", b"1" * 5000, b"0" * 5000]
)
def test_an_announcement_beyond_the_limit_is_refused_at_once(length):
    """10^12 bytes are never waited for, and nothing is set aside for them."""
    parser = DataLinkParser()
    with pytest.raises(PeerError, match=f"more than {MAX_PAYLOAD} bytes"):
        parser.receive_data(b"SEND " + length + b" x")


def test_the_longest_message_passes():
    message = bytes(range(256)) * (MAX_PAYLOAD // 256)
    parser, out = DataLinkParser(), []
    data = framed([message])
    for start in range(0, len(data), 60_000):
        out += parser.receive_data(data[start : start + 60_000])
    assert out == [message]


@given(
    st.lists(st.binary(max_size=600), max_size=8),
    st.lists(st.integers(0, 10_000), max_size=30),
    st.binary(min_size=1, max_size=1),
)
def test_messages_survive_any_chunking(messages, places, trailer):
    data = framed(messages, trailer) + b"CLOSE;"
    parser, out = DataLinkParser(), []
    for chunk in cut(data, places):
        out += parser.receive_data(chunk)
    assert out == messages
    assert parser.phase is Part.CLOSED


@given(st.binary(max_size=300), st.lists(st.integers(0, 10_000), max_size=10))
def test_chunking_makes_no_difference_to_junk_either(data, places):
    def read(chunks):
        parser, out = DataLinkParser(most=50), []
        try:
            for chunk in chunks:
                out += parser.receive_data(chunk)
        except PeerError:
            return "refused"
        return out, parser.phase

    data = b"SEND " + data
    assert read([data]) == read(cut(data, places))


def test_refusals_are_the_peers_fault():
    with pytest.raises(Refusal) as refusal:
        ComServer(FakeRadio(["R1"])).register(HERE, Register("R1", THERE))
    assert isinstance(refusal.value, PeerError)


def test_the_framing_table_is_closed():
    """Every phase that can be reached has its way out, but CLOSED."""
    table = dialect_a.DATA_LINK_TRANSITIONS
    assert set().union(*table.values()) <= set(table)
    assert [phase for phase, following in table.items() if not following] == [Part.CLOSED]
    assert dialect_a.DialectAPhase is DialectAPhase
