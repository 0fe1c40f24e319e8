"""Anything that a stranger may send, to each protocol without sockets: nothing raises but what is meant to.

Examples are batches of lines or messages, most of them nearly right: what is parsed furthest finds most.
`dev.py fuzz` tries more.
"""

import dataclasses
import math
import re

from hypothesis import given
from hypothesis import strategies as st
from websockets.server import ServerProtocol

from tests.server.fake_radio import FakeRadio
from usarmjx.base.errors import PeerError
from usarmjx.server.protocol.command_parsers import COMMANDS
from usarmjx.server.protocol.commands import DRIVE_KEYS, LEGAL_COMMANDS, SessionPhase
from usarmjx.server.protocol.grammar import HttpRequestError, Message, format_message, is_auth, parse_message
from usarmjx.server.protocol.images import ImageSession
from usarmjx.server.protocol.session import MAX_FAULTS, RobotSession
from usarmjx.server.viewing.viser_gate import MAX_MESSAGE_SIZE
from usarmjx.server.wireless.dialect_a import ComServer, DataLinkParser, DialectASession
from usarmjx.server.wireless.dialect_b import MAX_LINE_SIZE, DialectBSession, Switchboard
from usarmjx.server.wireless.positions import PositionSession

BATCH = 20
"""Lines or messages in an example."""
ENTROPY = 32
"""Bytes that choose what is in one of them, at most."""
LARGEST = 3.4e38
GREETING = Message("NFO")
HERE = "127.0.0.1"

NUMBERS = (
    *("0", "1", "-1", "0.5", "-0", "+7", ".5", "5.", "1e", "1,5", "1.2.3", "1 2", "1_000", "", "True"),
    *("1e38", "-3e38", "1e39", "1e400", "1e-400", "9" * 400, "nan", "-nan", "inf", "-inf", "0x1p9"),
    *("65535", "65536", "-32769", "\xb2", "\xd9\xa1", "1,2,3", "1,nan,3", "1, 2, 3", ",,,", "9e37,0,0"),
)
WORDS = (
    *("R1", "R2", "P2AT", "USARBot.P2AT", "Nope", "Sonar", "F1", "CameraPanTilt_Link1", "Joint", "Angle"),
    *("POSE", "Viewport1", "QuadView", "127.0.0.1", "10.0.0.2", "::1", "x" * 300, "\x00", "\xff"),
    *("\x85\xa0", "a b", ",", "%s%n", "../..", "POST / HTTP/1.1", "Host:"),
)
VALUES = (*NUMBERS, *WORDS)
KEYS = {
    "INIT": ("ClassName", "Name", "Location", "Rotation", "Start"),
    "DRIVE": (
        *(*DRIVE_KEYS, "Light", "Flip", "Normalized", "Name", "Order", "Value", "Steer"),
        *("WheelNumber", "WheelSpeed", "WheelSteer"),
    ),
    "MULTIDRIVE": ("FRFlipper", "CameraPanTilt_Link1", "\xe4"),
    "MISPKG": ("Name", "Link", "Value", "Order"),
    "SET": ("Type", "Name", "Opcode", "Params", "FOV", "Robot", "Client", "Config", "Viewport1", "Viewport2"),
    "TRACE": ("On", "Interval", "Color"),
    "GETGEO": ("Type", "Name"),
    "GETCONF": ("Type", "Name"),
    "GETSTARTPOSES": ("",),
    "GETOBS": ("From", "To", "Start", "End"),
    "GETPOS": ("",),
    "GETSS": ("Robot",),
    "DNS": ("Robot", "Port"),
    "REVERSEDNS": ("Port",),
}
ANY_KEY = tuple(sorted({key for keys in KEYS.values() for key in keys}))
HEADS = (*KEYS, *COMMANDS.names(), "DRIVE", "SET", "drive", "INIT2", "", "{", "}", "AUTH")
SLIPS = (*[""] * 20, "{", "}", "{}", " {", "}}", "\t", "\x0b", "{{Left 1}}")
VERBS = ("REGISTER", "LISTEN", "GETSS", "OPEN", "open", "CLOSE", "", "SEND 5")


class Tape:
    """Chooses by bytes, which hypothesis finds and shrinks; cheaper by far than a draw for each choice."""

    def __init__(self, data):
        self._bytes = iter(data)

    def number(self, most):
        return next(self._bytes, 0) % (most + 1)

    def pick(self, options):
        return options[self.number(len(options) - 1)]

    def data(self, most):
        return bytes(next(self._bytes, 0) for _ in range(self.number(most)))


def batches(make):
    """Batches of what is made of a tape."""
    tapes = st.lists(st.binary(min_size=ENTROPY, max_size=ENTROPY), min_size=BATCH, max_size=BATCH)
    return tapes.map(lambda datas: [make(Tape(data)) for data in datas])


def line_of(tape):
    """A line that is nearly one of the protocol."""
    head = tape.pick(HEADS)
    own = KEYS.get(head.upper(), ANY_KEY)
    pairs = [
        (tape.pick(own if tape.number(7) else ANY_KEY), tape.pick(VALUES)) for _ in range(tape.number(5))
    ]
    return head + " " + " ".join(f"{{{key} {value}}}" for key, value in pairs) + tape.pick(SLIPS)


def request_of(tape):
    """A message that is nearly one of dialect A, without its end."""
    return " ".join([tape.pick(VERBS), *(tape.pick(VALUES) for _ in range(tape.number(4)))])


BATCHES, REQUESTS = batches(line_of), batches(request_of)


def data_of(batch, end="\r\n"):
    return "".join(line + end for line in batch).encode("latin-1")


def numbers_in(value):
    """All numbers in a command."""
    if isinstance(value, float):
        yield value
    elif isinstance(value, tuple):
        for part in value:
            yield from numbers_in(part)
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            yield from numbers_in(getattr(value, field.name))


@given(BATCHES, st.sampled_from([SessionPhase.GREETED, SessionPhase.ACTIVE]), st.booleans())
def test_lines_to_a_robot(batch, phase, accepted):
    session = RobotSession(GREETING)
    session.phase = phase
    commands, awaited = session.receive_data(data_of(batch)), 0
    while True:
        for command in commands:
            assert type(command) in LEGAL_COMMANDS[session.phase]
            assert all(math.isfinite(number) and abs(number) <= LARGEST for number in numbers_in(command))
        if not session.awaits_answer:
            break
        awaited += 1
        assert awaited <= BATCH
        commands = session.answer_init(accepted)
    assert session.fault_count <= BATCH
    assert len(session.take_faults()) <= MAX_FAULTS + 1
    assert all(ord(letter) >= 0x20 for fault in session.take_faults() for letter in fault)
    assert session.receive_data(b"GETSTARTPOSES\r\n"), "it still works"


@given(BATCHES)
def test_a_line_is_read_back_as_it_is_written(batch):
    for line in batch:
        try:
            message = parse_message(line)
        except PeerError:
            continue
        if not re.search(r"[\x0b\x0c\x85\xa0]", line):
            assert parse_message(format_message(message)) == message


@given(REQUESTS, st.booleans())
def test_messages_of_dialect_a(batch, opens):
    session = DialectASession(ComServer(FakeRadio(["R1", "R2"]), ()), HERE)
    link, replies = session.receive_data(data_of(batch, ";")), b""
    for _ in range(BATCH):
        replies += session.data_to_send()
        if link is None:
            break
        assert link.caller.address == HERE or link.called.address == HERE
        link = session.answer_open(opens)
    replies += session.data_to_send()
    assert replies.count(b";") == BATCH, "each is answered once"
    assert all(reply.startswith((b"OK", b"Fail: ")) for reply in replies.split(b";")[:-1])


@given(BATCHES, st.booleans())
def test_lines_of_dialect_b(batch, joined):
    numbers = iter(range(40_000, 60_000))
    board = Switchboard(FakeRadio(["R1", "R2"]), lambda route: next(numbers, None), lambda: 0.0)
    session = DialectBSession(board, HERE)
    if joined:
        session.receive_data(b"INIT {Robot R1} {Port 1,2}\r\n")
    for line in batch:
        answer = session.receive_data(data_of([line])).decode("latin-1")
        answered = bool(line.strip()) and len(line) <= MAX_LINE_SIZE and not is_auth(line)
        assert answer.count("\r\n") == answered
        for one in answer.split("\r\n")[:-1]:
            assert format_message(parse_message(one)) == one


@given(BATCHES)
def test_lines_to_the_position_service(batch):
    answers = PositionSession(FakeRadio(["R1", "R2"])).receive_data(data_of(batch)).decode("latin-1")
    assert answers.count("\r\n") <= BATCH
    for one in answers.split("\r\n")[:-1]:
        assert parse_message(one).kind in ("POSITIONS", "NUMOBS")


ANNOUNCED = (b"5 hello;", b"0 ;", b"99999999999999999 ", b"1048577 ")
PIECES = st.one_of(st.sampled_from([b"SEND ", b"CLOSE", b";", b"\r\n", *ANNOUNCED]), st.binary(max_size=8))


def messages_of(pieces):
    """The messages on a data link, and whether it ended by a fault."""
    parser, found = DataLinkParser(), []
    try:
        for piece in pieces:
            found += parser.receive_data(piece)
    except PeerError:
        return found, True
    return found, False


@given(st.lists(PIECES, min_size=BATCH, max_size=BATCH))
def test_bytes_on_a_data_link(pieces):
    cut, ended = messages_of([bytes([byte]) for piece in pieces for byte in piece])
    assert (messages_of(pieces)[0] == cut) or ended, "what came with the fault is not told"
    assert messages_of(pieces)[1] == ended
    assert sum(map(len, cut)) <= sum(map(len, pieces))


SIZE = (320, 240)
EDGES = (0, 1, 100, 239, 240, 319, 320, 2**31, 2**32 - 1)
ASKED = (b"OK", b"OK", b"O", b"K", b"OOK", b"U", b"\0")


def acknowledgement_of(tape):
    """What asks for a picture or a part of it, or nearly, and whether a picture is sent then."""
    part = b"U" + b"".join(tape.pick(EDGES).to_bytes(4, "big") for _ in range(4))
    return tape.pick([part, part, *ASKED, tape.data(3)]), tape.pick((True, False))


@given(batches(acknowledgement_of))
def test_acknowledgements_of_pictures(batch):
    session = ImageSession(SIZE, 0.1, 0.0)
    for step, (data, is_sent) in enumerate(batch):
        try:
            session.receive_data(data)
        except HttpRequestError:
            return
        if session.region is not None:
            left, top, width, height = session.region
            assert 0 <= left < left + width <= SIZE[0]
            assert 0 <= top < top + height <= SIZE[1]
        if is_sent and session.wants(float(step)):
            session.sent(float(step))
            assert not session.wants(float(step))


UPGRADE = (
    b"GET / HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
    b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
)


def frame_of(tape):
    """A frame of a websocket, or nearly one."""
    payload, mask = tape.data(20) * tape.pick((1, 1, 10)), tape.pick((0x80, 0x80, 0x80, 0x00))
    first = tape.pick((0x81, 0x82, 0x01, 0x00, 0x80, 0x88, 0x89, 0x8A, 0xC1, 0x83, 0xFF))
    size = tape.pick([*[len(payload)] * 4, 2**63, 2**31, MAX_MESSAGE_SIZE + 1, 0])
    if size < 126:
        head = bytes([first, mask | size])
    elif size < 2**16:
        head = bytes([first, mask | 126]) + size.to_bytes(2, "big")
    else:
        head = bytes([first, mask | 127]) + size.to_bytes(8, "big")
    return head + bytes(4) * (mask > 0) + payload


@given(batches(frame_of), st.booleans())
def test_frames_of_a_page(batch, upgrades):
    """The library reads them, with our bound on their size."""
    protocol = ServerProtocol(max_size=MAX_MESSAGE_SIZE)
    if upgrades:
        protocol.receive_data(UPGRADE)
        (request,) = protocol.events_received()
        protocol.send_response(protocol.accept(request))
    for frame in batch:
        protocol.receive_data(frame)
        for event in protocol.events_received():
            assert len(getattr(event, "data", b"")) <= MAX_MESSAGE_SIZE
        protocol.data_to_send()
