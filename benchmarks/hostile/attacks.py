"""The attacks, by port. The lines follow the manual, chapters 3, 9 and 10, and docs/radio.md."""

from collections.abc import Sequence

from benchmarks.hostile import acts, frames
from benchmarks.hostile.frames import (
    BINARY,
    CONTINUATION,
    PING,
    TEXT,
    http_request,
    ros_message,
    websocket_frame,
)
from benchmarks.hostile.stage import PortAttack, Sends, Stage

MANY = 200
UPGRADED = b"\r\n\r\n"


def constant(data: bytes) -> Sends:
    """Return a sender of the same bytes each time."""
    return lambda stage, number: data


def upgrade(port: str) -> Sends:
    """Return a sender of the opening handshake of a websocket."""
    return lambda stage, number: frames.upgrade_request(stage.ports[port])


def get(port: str, path: str, times: int = 1, *extra: str) -> Sends:
    """Return a sender of `times` GET requests in one piece."""
    return lambda stage, number: http_request(path, stage.ports[port], *extra) * times


def robot(stage: Stage, number: int) -> bytes:
    """Return INIT of an attacker's own robot."""
    return frames.init_line(f"H{number}x{stage.connections}", number)


def lines(*texts: str, times: int = MANY) -> Sends:
    """Return a sender of lines of Gamebots, repeated `times` times."""
    return constant("".join(f"{text}\r\n" for text in texts).encode() * times)


def registrations(stage: Stage, number: int) -> bytes:
    """Return REGISTER messages with new names."""
    return b"".join(b"REGISTER N%dx%dx%d 127.0.0.1;" % (number, stage.sent, i) for i in range(MANY))


def topic_names(stage: Stage, number: int) -> bytes:
    """Return subscriptions of topics that do not exist, each with a new name."""
    return b"".join(
        ros_message("subscribe", topic=f"/n{number}/{stage.sent}/{i}", type="std_msgs/String")
        for i in range(MANY)
    )


NESTED = b"DRIVE " + b"{" * 4000 + b"}" * 4000 + b"\r\n"
DRIVE = "DRIVE {Left 1.0} {Right -1.0}"
STRANGE = (
    b"\x00\xff\xfe\xc0\xaf\xed\xa0\x80 {\x00} \r\nINIT {Name \xf0\x9f\x92\xa3} {ClassName \x00}\r\n" * 100
)
EXTREME = ("INIT {ClassName USARBot.P2AT} {Name X} {Location nan,inf,1e309}", "INIT {ClassName USARBot.None}")
AREA = b"U" + b"\x7f\xff\xff\xff" * 4 + b"OK" + b"U" + bytes(16) + b"OK"

ROBOTS = (
    PortAttack("drip", "robots", "INIT a byte at a time", constant(b"I"), pause=0.1),
    PortAttack("single bytes", "robots", "legal lines in packets of a byte", lines(DRIVE), robot, piece=1),
    PortAttack("endless line", "robots", "a line without an end", constant(b"A" * 65536)),
    PortAttack("nested", "robots", "DRIVE with 4,000 braces in each other", constant(NESTED)),
    PortAttack("binary", "robots", "random bytes", lambda _, n: frames.noise(65536, n)),
    PortAttack("strange text", "robots", "NUL, broken UTF-8, names of neither", constant(STRANGE)),
    PortAttack("empty lines", "robots", "line ends only", constant(b"\r\n" * 30000)),
    PortAttack("init and gone", "robots", "INIT, then the connection is closed", robot, times=1),
    PortAttack("init and reset", "robots", "INIT, then broken off", robot, times=1, reset=True),
    PortAttack("extreme init", "robots", "INIT at nan and inf, of no class", lines(*EXTREME, times=20)),
    PortAttack(
        "geometry",
        "robots",
        "a robot asks GETGEO, GETCONF",
        lines(
            "GETGEO {Type Robot}",
            "GETCONF {Type Robot}",
            "GETGEO {Type Sonar}",
            "GETCONF {Type RangeScanner}",
        ),
        robot,
    ),
    PortAttack(
        "geometry, deaf",
        "robots",
        "the same, never reads",
        lines("GETGEO {Type Sonar}", "GETCONF {Type MisPkg}"),
        robot,
        reads=False,
    ),
    PortAttack("drive flood", "robots", "DRIVE without a pause", lines(DRIVE), robot),
    PortAttack("start poses", "robots", "GETSTARTPOSES, never reads", lines("GETSTARTPOSES"), reads=False),
    PortAttack("auth", "robots", "AUTH again and again", lines("AUTH {Token " + "a" * 100 + "}")),
)
RADIO = (
    PortAttack("drip a", "wireless-a", "a byte at a time", constant(b"R"), pause=0.1),
    PortAttack("names a", "wireless-a", "REGISTER of ever new names", registrations),
    PortAttack("signal a", "wireless-a", "GETSS", constant(b"GETSS A B;" * MANY)),
    PortAttack(
        "endless a", "wireless-a", "a message without an end", constant(b"SEND 1048577 " + b"x" * 65536)
    ),
    PortAttack("dial a", "wireless-a", "OPEN to ports where nobody answers", act=acts.dial),
    PortAttack("link a", "wireless-a", "a link's SEND, never read", act=acts.flood_link, attackers=4),
    PortAttack("drip b", "wireless-b", "a byte at a time", constant(b"I"), pause=0.1),
    PortAttack(
        "talk b",
        "wireless-b",
        "GETSS, DNS, REVERSEDNS",
        lines(
            "INIT {Robot Z} {Port 3333}",
            "GETSS {Robot Neighbour}",
            "DNS {Robot Neighbour} {Port 1}",
            "REVERSEDNS {Port 1}",
        ),
    ),
    PortAttack("endless b", "wireless-b", "a line without an end", constant(b"{" * 65536)),
    PortAttack("positions", "positions", "GETPOS", lines("GETPOS")),
    PortAttack("positions, deaf", "positions", "GETPOS, never reads", lines("GETPOS"), reads=False),
    PortAttack(
        "walls",
        "positions",
        "GETOBS through the arena, nan, 1e300",
        lines("GETOBS {Start -50,-50,0.5} {End 50,50,0.5}", "GETOBS {Start nan,0,0} {End 1e300,0,0}"),
    ),
    PortAttack("drip p", "positions", "a byte at a time", constant(b"G"), pause=0.1),
)
PICTURES = (
    PortAttack("ok flood", "images", "OK without a pause", constant(b"OK" * 8000)),
    PortAttack("ok, deaf", "images", "OK, never reads", constant(b"OK"), reads=False, pause=0.01),
    PortAttack("areas", "images", "parts of pictures with extreme corners", constant(AREA * 500)),
    PortAttack("binary i", "images", "random bytes", lambda _, n: frames.noise(65536, n)),
    PortAttack("drip i", "images", "half a request a byte at a time", constant(b"U"), pause=0.1),
)


def handshake_attacks(port: str, tag: str) -> Sequence[PortAttack]:
    """Return the attacks before a websocket is open; the tag makes their names differ."""
    return (
        PortAttack(
            f"half handshake {tag}",
            port,
            "a header that never ends",
            constant(b"X-A: b\r\n"),
            get(port, "/", 1, "X-A: " + "b" * 100),
            pause=0.05,
        ),
        PortAttack(
            f"resets {tag}", port, "handshakes, broken off", upgrade(port), times=1, reset=True, reads=False
        ),
    )


def websocket_attacks(port: str, tag: str) -> Sequence[PortAttack]:
    """Return the attacks on a port for websockets; the tag makes their names differ."""
    opened = {"port": port, "hello": upgrade(port), "answer": UPGRADED}
    start = websocket_frame(b"x", TEXT, final=False)
    return (
        *handshake_attacks(port, tag),
        PortAttack(
            f"pings {tag}", what="pings", sends=constant(websocket_frame(b"p" * 125, PING) * MANY), **opened
        ),
        PortAttack(
            f"fragments {tag}",
            what="a message in frames of a byte",
            sends=constant(frames.byte_fragments(b'{"op":"x"}' * 50)),
            **opened,
        ),
        PortAttack(
            f"empty fragments {tag}",
            what="a message of empty frames",
            hello=lambda s, _: frames.upgrade_request(s.ports[port]) + start,
            sends=constant(websocket_frame(b"", CONTINUATION, final=False) * MANY),
            port=port,
            answer=UPGRADED,
        ),
        PortAttack(
            f"no start {tag}",
            what="continuation without a start",
            sends=constant(websocket_frame(b"x", CONTINUATION)),
            times=1,
            **opened,
        ),
        PortAttack(
            f"no mask {tag}",
            what="frames without a mask",
            sends=constant(websocket_frame(b"x" * 100, masked=False)),
            times=1,
            **opened,
        ),
        PortAttack(
            f"oversize {tag}",
            what="a frame of 2^62 bytes",
            sends=constant(websocket_frame(b"x" * 65536, BINARY, length=1 << 62)),
            **opened,
        ),
        PortAttack(
            f"bomb {tag}",
            what="compressed frames of 16 MB",
            sends=constant(websocket_frame(frames.deflate_bomb(1 << 24), compressed=True)),
            **opened,
        ),
        PortAttack(
            f"deep JSON {tag}",
            what="lists 50,000 deep",
            sends=constant(websocket_frame(frames.deep_json(50_000))),
            **opened,
        ),
    )


ROSBRIDGE = (
    *websocket_attacks("rosbridge", "r"),
    PortAttack(
        "wide JSON",
        "rosbridge",
        "objects with 10,000 numbers",
        constant(websocket_frame(frames.wide_json(10_000))),
        upgrade("rosbridge"),
        UPGRADED,
    ),
    PortAttack(
        "calls",
        "rosbridge",
        "/rosapi/topics, never reads",
        constant(ros_message("call_service", service="/rosapi/topics") * MANY),
        upgrade("rosbridge"),
        UPGRADED,
        reads=False,
    ),
    PortAttack(
        "details",
        "rosbridge",
        "/rosapi/message_details",
        constant(
            ros_message("call_service", service="/rosapi/message_details", args={"type": "nav_msgs/Odometry"})
            * MANY
        ),
        upgrade("rosbridge"),
        UPGRADED,
    ),
    PortAttack(
        "topics", "rosbridge", "subscriptions of ever new topics", topic_names, upgrade("rosbridge"), UPGRADED
    ),
    PortAttack(
        "maps, deaf",
        "rosbridge",
        "subscribes and leaves /map, never reads",
        constant(
            (
                ros_message("subscribe", topic="/map", type="nav_msgs/OccupancyGrid")
                + ros_message("unsubscribe", topic="/map")
            )
            * 50
        ),
        upgrade("rosbridge"),
        UPGRADED,
        reads=False,
    ),
    PortAttack(
        "pieces",
        "rosbridge",
        "fragments of messages that never end",
        constant(ros_message("fragment", id="f", data="x" * 1000, num=0, total=1 << 40) * 50),
        upgrade("rosbridge"),
        UPGRADED,
    ),
    PortAttack(
        "spawn",
        "rosbridge",
        "spawns and leaves",
        constant(ros_message("call_service", service="/simulator/spawn", args={"class": "P2AT"})),
        upgrade("rosbridge"),
        UPGRADED,
        pause=0.05,
        times=3,
    ),
    PortAttack(
        "twists",
        "rosbridge",
        "cmd_vel for the neighbour, with NaN",
        constant(
            websocket_frame(b'{"op":"publish","topic":"/Neighbour/cmd_vel","msg":{"linear":{"x":NaN}}}')
            * MANY
        ),
        upgrade("rosbridge"),
        UPGRADED,
    ),
)
PAGES = (
    *websocket_attacks("page", "v"),
    PortAttack("page pipeline", "page", "GET / without reading between", act=acts.page_storm),
    PortAttack("figures pipeline", "metrics", "100 GET /metrics in a piece", get("metrics", "/metrics", 100)),
    PortAttack(
        "figures, deaf", "metrics", "the same, never reads", get("metrics", "/metrics", 100), reads=False
    ),
    PortAttack(
        "figures header",
        "metrics",
        "a header of a megabyte",
        get("metrics", "/metrics", 1, "X-A: " + "b" * (1 << 20)),
    ),
    PortAttack("drip f", "metrics", "a header a byte at a time", constant(b"G"), pause=0.1),
    PortAttack(
        "old HTTP",
        "metrics",
        "HTTP/0.9, PUT, bodies of no length",
        constant(b"GET /\r\n\r\nPUT /metrics HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\nFFFFFFFFF\r\n"),
        times=1,
    ),
)
PORTS = ("robots", "wireless-a", "wireless-b", "positions", "images", "page", "metrics", "rosbridge")
HOARDED = tuple(port for port in PORTS if port != "robots")
EVERYWHERE = (
    PortAttack(
        "reset storm",
        "any",
        "connections to all ports, broken off",
        times=1,
        reset=True,
        reads=False,
        sends=constant(b"G"),
    ),
    PortAttack(
        "connect storm", "any", "connections to all ports, closed", times=1, reads=False, sends=constant(b"")
    ),
    *(
        PortAttack(
            f"hoard {port}",
            port,
            f"{acts.HELD} held connections; a robot joins",
            act=acts.hold(port),
            attackers=1,
        )
        for port in HOARDED
    ),
    PortAttack(
        "hoard all",
        "any",
        "1,500 held connections to all ports but robots'; a robot joins",
        act=acts.hold("hoarded"),
        attackers=6,
    ),
)
QUIET = PortAttack(
    "quiet", "", "nobody does anything", act=lambda stage, number: stage.rest(0.5), attackers=1
)
DATAGRAMS = PortAttack(
    "datagrams", "dds", "random datagrams to the ports of DDS", act=acts.datagrams, attackers=2
)
ATTACKS = (QUIET, *ROBOTS, *RADIO, *PICTURES, *ROSBRIDGE, *PAGES, *EVERYWHERE)
