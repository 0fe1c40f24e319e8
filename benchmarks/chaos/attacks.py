"""The attacks: what each attacker says first, and what it says then without end."""

import json
import math
from dataclasses import dataclass
from importlib.metadata import version

import numpy as np

from benchmarks.onlooker import camera_message
from usarmjx.base.errors import UnknownNameError
from usarmjx.base.registry import unknown_name
from usarmjx.server.protocol.grammar import DEFAULT_LIMIT

CHUNK = 64 * 1024
"""About so much is repeated at a time [bytes]."""
INIT = "INIT {ClassName USARBot.P2AT}"
PIECES = 1000
"""Most pieces of a long line."""
DEEP = 1000
"""Lists within lists in a message of a page."""
MASK = bytes(4)
"""What a page's message is masked with: nothing changes."""


@dataclass(frozen=True)
class Attack:
    """An attacker's behaviour.

    Attributes:
        name: Its name.
        about: Its behaviour, in words.
        first: Lines that it sends once it is connected.
        load: Lines that it repeats without end; empty: it is silent.
        reads: Whether it reads what it is told.
        stay: After how long it goes, to come again at once [s].
        rude: Whether it breaks its connection off then instead of closing it.
        door: Port that it goes to: robots, page, rosbridge, metrics or pictures.
    """

    name: str
    about: str
    first: bytes = b""
    load: bytes = b""
    reads: bool = True
    stay: float = math.inf
    rude: bool = False
    door: str = "robots"


def repeat(*lines: str) -> bytes:
    """Return lines over and over, about a chunk of them."""
    once = "".join(f"{line}\r\n" for line in lines).encode("latin-1")
    return once * max(1, CHUNK // len(once))


def fill(head: str, piece: str, tail: str = "") -> str:
    """Return a line with as many pieces as a line has room for, a thousand at most."""
    room = DEFAULT_LIMIT - len(head) - len(tail)
    return head + piece * min(PIECES, room // len(piece)) + tail


def page_message(data: bytes) -> bytes:
    """Return a page's message as a frame of RFC 6455; it must have 126 to 65535 bytes."""
    return b"\x82\xfe" + len(data).to_bytes(2, "big") + MASK + data


def frame(opcode: int, data: bytes) -> bytes:
    """Return a client's frame of RFC 6455, masked with zeros."""
    size = len(data)
    if size < 126:
        return bytes([opcode, 0x80 | size]) + MASK + data
    form, length = (2, 126) if size < 1 << 16 else (8, 127)
    return bytes([opcode, 0x80 | length]) + size.to_bytes(form, "big") + MASK + data


def _junk() -> bytes:
    noise = np.random.default_rng(0).integers(0, 256, CHUNK // 2, np.uint8).tobytes()
    return (
        noise + b"\r\n" + repeat("DRIVE {Left nan}", "GETGEO {Type X}", "{{{}}}", "SET {Params")[: CHUNK // 2]
    )


JOIN = f"{INIT}\r\n".encode()
NESTED = b"\x91" * DEEP + b"\xc0"
"""Lists within lists, as msgpack."""
REQUEST = b"POST / HTTP/1.1\r\nHost: localhost\r\nContent-Type: text/plain\r\nContent-Length: 65536\r\n\r\n"
UPGRADE = (
    f"GET / HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
    f"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
    f"Sec-WebSocket-Protocol: viser-v{version('viser')}\r\n\r\n"
).encode()
ROS_UPGRADE = UPGRADE.replace(f"Sec-WebSocket-Protocol: viser-v{version('viser')}\r\n".encode(), b"")
GET = b"GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n"
LAST, MORE, TEXT, PING = 0x80, 0x00, 0x81, 0x89
"""Bit of the last frame of a message, and first bytes of frames."""
BIG = json.dumps(
    {"op": "publish", "topic": "/x/cmd_vel", "msg": {f"k{key}": key for key in range(14_000)}}
).encode()
CALL = json.dumps(
    {"op": "call_service", "service": "/rosapi/topics_and_raw_types", "id": "A" * 1000}
).encode()
VECTOR = fill("SET {Type INS} {Name INS} {Opcode POSE} {Params ", "1.2345,", "1}")
POSE = "SET {Type INS} {Name INS} {Opcode POSE} {Params 1,2,3,0,0,0}"

QUIET = Attack("quiet", "nobody does anything, for comparison")
ATTACKS = (
    Attack("junk", "lines that mean nothing", load=_junk()),
    Attack("giant", "one line without an end", load=b"x" * CHUNK),
    Attack("unknown-init", "INIT of a class that there is not", load=repeat("INIT {ClassName Nope}")),
    Attack("init-storm", "INIT, and gone at once", JOIN, stay=0.02),
    Attack("connect-storm", "connections that come and go", stay=0.01),
    Attack("reset-storm", "connections that come and are broken off", stay=0.01, rude=True),
    Attack("deaf", "asks for descriptions and never reads", JOIN, repeat("GETGEO {Type Sonar}"), reads=False),
    Attack("company", "all join and do nothing: the cost of their robots", JOIN),
    Attack("crowd", "all join at once and then SET without a pause", JOIN, repeat(POSE)),
    Attack("vector", "SET with a vector of 8 kB", JOIN, repeat(VECTOR)),
    Attack("segments", "DRIVE with 1,000 segments", JOIN, repeat(fill("DRIVE ", "{Left 1}"))),
    Attack("trace", "Trace with 1,000 segments", JOIN, repeat(fill("TRACE {On True} ", "{C Red}"))),
    Attack("start-poses", "GETSTARTPOSES and never reads", load=repeat("GETSTARTPOSES"), reads=False),
    Attack("silent", "connections on which nothing is said"),
    Attack(
        "http", "a web page's POST with commands in it", REQUEST, repeat(INIT, "DRIVE {Left 1} {Right 1}")
    ),
    Attack(
        "page",
        "a page's messages without a pause: where its camera is",
        UPGRADE,
        page_message(camera_message()) * 100,
        door="page",
    ),
    Attack(
        "page-junk",
        "messages that no page sends, nested deeply",
        UPGRADE,
        page_message(NESTED) * 20,
        door="page",
    ),
    Attack("ros-json", "rosbridge: messages of 216 kB", ROS_UPGRADE, frame(TEXT, BIG), door="rosbridge"),
    Attack(
        "ros-calls",
        "rosbridge: calls of /rosapi without a pause",
        ROS_UPGRADE,
        frame(TEXT, CALL) * 50,
        door="rosbridge",
    ),
    Attack("ros-pings", "rosbridge: pings", ROS_UPGRADE, frame(PING, b"") * 10_000, door="rosbridge"),
    Attack(
        "ros-fragments",
        "rosbridge: a message in pieces of a byte",
        ROS_UPGRADE,
        frame(TEXT & ~LAST, b"{") + frame(MORE, b" ") * 10_000,
        door="rosbridge",
    ),
    Attack("ros-storm", "rosbridge: handshakes, and gone", ROS_UPGRADE, stay=0.01, door="rosbridge"),
    Attack("ros-resets", "rosbridge: connections broken off", stay=0.0, rude=True, door="rosbridge"),
    Attack("metrics-get", "GET /metrics without a pause", GET, door="metrics"),
    Attack("metrics-resets", "metrics: connections broken off", stay=0.0, rude=True, door="metrics"),
    Attack("picture-junk", "pictures: nonsense", load=_junk(), door="pictures"),
    Attack("picture-storm", "pictures: connections that come and go", stay=0.01, door="pictures"),
)
"""All of them, in the order in which they are played."""


def find_attack(name: str) -> Attack:
    """Return the attack of that name.

    Raises:
        UnknownNameError: There is none; lists those known.
    """
    for attack in ATTACKS:
        if attack.name == name.lower():
            return attack
    raise UnknownNameError(unknown_name("attack", name, [one.name for one in ATTACKS]))
