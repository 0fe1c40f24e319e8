"""Who gets in at each port, on real sockets: networks, so many of an address, and nobody for ever."""

import asyncio
import contextlib
import ipaddress
import re
import socket
import time

import pytest

import dev
from tests.server.all_ports import (
    ELSEWHERE,
    HOST,
    KINDS,
    all_ports,
    begins,
    hear,
    server_side,
)
from tests.server.peers import PATIENCE, Peer, serving, wait_until
from tests.server.still_world import StillWorld, init
from usarmjx.server.gamebots.settings import BotServerSettings
from usarmjx.server.network import gate, ports
from usarmjx.server.network.access import AccessRules, parse_networks
from usarmjx.server.network.gate import KEEPALIVE_COUNT, KEEPALIVE_IDLE, KEEPALIVE_INTERVAL, Gate
from usarmjx.server.network.ports import bound_socket
from usarmjx.server.pictures.image_server import ImageSettings
from usarmjx.server.protocol.dialects import find_dialect
from usarmjx.server.protocol.session import SEND_LIMIT
from usarmjx.server.rosbridge.net import RosSettings
from usarmjx.server.runtime import metrics
from usarmjx.server.viewing.viewer_service import ViewerSettings
from usarmjx.server.wireless import dialect_b, sockets
from usarmjx.server.wireless.net import WirelessSettings
from usarmjx.server.wireless.sockets import ReservedPort

TIMEOUT = 0.3  # s: what a test waits for
ASKING = 2.0  # s: for so long somebody asks without a pause
NOTHING = b""


@pytest.fixture(scope="module")
def guarded():
    """All ports, for one address only."""
    with all_ports(allow=parse_networks([ELSEWHERE])) as found:
        yield found


@pytest.fixture
def remote(monkeypatch):
    """An address that passes for one of another machine."""
    loopback = property(lambda self: str(self) != ELSEWHERE)
    monkeypatch.setattr(ipaddress.IPv4Address, "is_loopback", loopback)
    return ELSEWHERE


# Networks


@pytest.mark.parametrize("kind", KINDS)
def test_only_allowed_addresses_are_let_in(guarded, kind):
    assert guarded.answers(kind, NOTHING, ELSEWHERE)
    assert not guarded.answers(kind, NOTHING, HOST)


def test_a_forwarded_port_is_for_allowed_addresses_too():
    called = []

    async def handler(reader, writer):
        called.append(reader)
        writer.close()

    async def call(address):
        port = ReservedPort(HOST, handler, Gate(AccessRules(parse_networks([ELSEWHERE])), 4, "calls"))
        await port.open()
        reader, writer = await asyncio.open_connection(HOST, port.port, local_addr=(address, 0))
        with contextlib.suppress(ConnectionError):
            assert await reader.read() == b""
        writer.close()
        port.release()
        return len(called)

    assert asyncio.run(call(HOST)) == 0
    assert asyncio.run(call(ELSEWHERE)) == 1


def test_refusals_are_logged_by_rate(caplog):
    with all_ports(allow=parse_networks([ELSEWHERE])) as found:
        for _ in range(30):
            assert not found.answers("robots", NOTHING)
    lines = [record.getMessage() for record in caplog.records if "is refused" in record.getMessage()]
    assert lines == [f"robots: {HOST} is refused: it is not in --allow"]


# Connections of an address


@pytest.mark.parametrize("kind", KINDS)
def test_an_address_has_so_many_connections_and_no_more(remote, kind):
    with all_ports(per_address=2) as found:
        here = [found.connect(kind, remote) for _ in range(2)]
        assert not found.answers(kind, NOTHING, remote)
        assert all(found.answers(kind, NOTHING, HOST) for _ in range(3)), "loopback has no limit"
        here[0].close()
        again = None
        while again is None or not begins(again, *KINDS[kind][1:]):
            again = found.connect(kind, remote)


def test_a_quarter_of_the_seats_is_for_others(remote):
    with serving(StillWorld(), max_connections=5) as (port, _):
        made = [socket.create_connection((HOST, port), PATIENCE, (remote, 0)) for _ in range(5)]
        assert [hear(one, 3) for one in made] == [b"NFO"] * 4 + [b""]
        other = Peer(port)
        assert other.line().startswith(b"NFO")
        for one in (*made, other):
            one.close()


# Nobody for ever


@pytest.mark.parametrize("kind", KINDS)
def test_a_peer_that_has_vanished_is_found_out(guarded, kind):
    connection = guarded.connect(kind, ELSEWHERE)
    wait_until(lambda: asks_for_life(server_side(connection)), "keepalive")


def asks_for_life(end):
    """Whether an end of a connection asks for signs of life as stated; not if there is none yet."""
    if end is None:
        return False
    with end:
        options = socket.TCP_KEEPIDLE, socket.TCP_KEEPINTVL, socket.TCP_KEEPCNT
        asked = [end.getsockopt(socket.IPPROTO_TCP, option) for option in options]
        on = end.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
    return bool(on) and asked == [KEEPALIVE_IDLE, KEEPALIVE_INTERVAL, KEEPALIVE_COUNT]


def test_so_is_one_that_was_dialled():
    async def dial(port):
        _, writer = await sockets.connect(HOST, port)
        return asks_for_life(writer.get_extra_info("socket")._sock)

    with socket.create_server((HOST, 0)) as door:
        assert asyncio.run(dial(door.getsockname()[1]))


def test_who_only_asks_yields_when_no_seat_is_left(caplog):
    """Legal commands keep a seat that nobody wants, for a base station that waits until somebody chooses."""
    with serving(StillWorld(), max_connections=2, init_timeout=ASKING) as (port, _):
        driver, asker = Peer(port, init("R1")), Peer(port)
        driver.until(b"STA")
        deadline = time.monotonic() + 1.2 * ASKING
        while time.monotonic() < deadline:
            asker.say("GETSTARTPOSES")
            assert asker.until(b"NFO {StartPoses")
            time.sleep(ASKING / 50)
        guest = Peer(port, init("R2"))
        assert guest.until(b"STA")
        while asker.line():
            pass
        driver.sta_times(2)
        for peer in (driver, guest):
            peer.close()
    assert "makes room, it has no robot" in caplog.text


def test_nobody_has_to_yield_at_once():
    with serving(StillWorld(), max_connections=1, init_timeout=60.0) as (port, _):
        asker, guest = Peer(port, "GETSTARTPOSES"), Peer(port)
        assert guest.line() == b""
        asker.say(init())
        assert asker.until(b"STA")
        asker.close()


def test_who_waits_for_an_answer_or_has_a_robot_does_not_yield():
    world, slow = StillWorld(), []

    def prepare(robot):
        while not slow:
            time.sleep(0.01)

    world.prepare = prepare
    with serving(world, max_connections=1, init_timeout=TIMEOUT) as (port, _):
        first = Peer(port, init("R1"))
        time.sleep(2 * TIMEOUT)
        assert Peer(port).line() == b""
        slow.append(True)
        assert first.until(b"STA")
        time.sleep(2 * TIMEOUT)
        assert Peer(port).line() == b""
        first.sta_times(1)
        first.close()


# Dialling out

FAILED = b"Fail: Could not establish connection"


def ask(control, text, end=b";"):
    """The answer to a message, without its end."""
    control.sendall(text.encode() + end)
    answer = b""
    while not answer.endswith(end):
        more = hear(control, 1)
        assert more, answer
        answer += more
    return answer.removesuffix(end)


@contextlib.contextmanager
def doors(count=2):
    """Sockets that listen, ordered by their ports."""
    with contextlib.ExitStack() as stack:
        made = [stack.enter_context(socket.create_server((HOST, 0))) for _ in range(count)]
        yield sorted(door.getsockname()[1] for door in made)


def test_neither_the_systems_ports_nor_our_own_are_dialled(monkeypatch):
    with all_ports() as found, doors() as (low, high):
        control = found.connect("wss")
        assert ask(control, f"REGISTER R1 {HOST}") == ask(control, f"REGISTER R2 {HOST}") == b"OK"
        assert ask(control, f"LISTEN R1 {high}") == b"OK"
        for kind in KINDS:
            assert ask(control, f"OPEN R2 {found.ports[kind]} R1 {high}") == FAILED
        with monkeypatch.context() as patch:  # no test may listen at a port that is the system's indeed
            patch.setattr(ports, "FIRST_DIALLED", low + 1)
            assert ask(control, f"OPEN R2 {low} R1 {high}") == FAILED
        assert ask(control, f"OPEN R2 {low} R1 {high}") == b"OK"
    assert [ports.may_dial(HOST, port) for port in (22, 1023, 1024)] == [False, False, True]


def test_a_robot_does_not_listen_at_our_own_ports():
    """Neither those that are open from the beginning nor those that are forwarded."""
    line = b"\r\n"
    with all_ports() as found, doors(1) as (door,):
        one, other, control = found.connect("wss2"), found.connect("wss2"), found.connect("wss")
        own = found.ports["robots"]
        ok = b"INITREPLY {Status OK}"
        assert ask(one, f"INIT {{Robot R1}} {{Port {own},22,{door}}}", line) == ok
        assert ask(other, "INIT {Robot R2} {Port 4001}", line) == ok
        for port in (own, 22):
            answer = ask(other, f"DNS {{Robot R1}} {{Port {port}}}", line)
            assert answer == b"DNSREPLY {Robot R1} {Port -1} {Error RobotDoesNotListenOnThisPort}"
        forwarded = int(re.search(rb"Port (\d+)", ask(other, "DNS {Robot R1}", line))[1])
        for name in ("R1", "R2"):
            assert ask(control, f"REGISTER {name} {HOST}") == b"OK"
        assert ask(control, f"LISTEN R1 {door}") == b"OK"
        assert ask(control, f"OPEN R2 {forwarded} R1 {door}") == FAILED


def test_a_port_of_ours_on_another_machine_is_its_own_affair():
    with bound_socket(HOST, 0) as bound:
        port = bound.getsockname()[1]
        assert not ports.may_dial(HOST, port)
        assert ports.may_dial("192.0.2.1", port)  # an address for documents
    assert ports.may_dial(HOST, port), "it is not ours any more"


# What is written


def test_the_page_on_security_has_the_limits_that_are_in_force():
    text = (dev.ROOT / "docs/security.md").read_text(encoding="utf-8")
    rows = dict(
        re.findall(r"^\| ([^|]+?) \| ([^|]+?) \|[^|\n]*\|$", text.partition("## Limits")[2], re.MULTILINE)
    )
    told = {what: [int(number) for number in re.findall(r"\d+", rows[what])] for what in rows}
    bots, air, calls = BotServerSettings(), WirelessSettings(), dialect_b.MAX_CONNECTIONS
    images, page = ImageSettings(), ViewerSettings()
    held = (bots.max_connections, air.max_connections, images.max_connections, page.max_connections)
    quarters = [
        3 * room // 4 for room in (*held, calls, RosSettings().max_connections, metrics.MAX_CONNECTIONS)
    ]
    found_out = KEEPALIVE_IDLE + KEEPALIVE_INTERVAL * KEEPALIVE_COUNT
    expected = {
        "connections for robots": [held[0], find_dialect("udk").max_connections],
        "without a robot and without asking for anything": [bots.init_timeout],
        "without a robot, but asking, while no seat is left": [bots.init_timeout],
        "connections to the wireless servers and for positions": [held[1]],
        "silent on them, without a robot in the world": [air.idle_timeout],
        "connections for pictures": [held[2]],
        "connections of live pages": [held[3]],
        "connections of one address to one kind of port, but from loopback": quarters,
        "before the token is said": [gate.AUTH_TIMEOUT, gate.MAX_AUTH_SIZE, gate.MAX_STRANGERS],
        "a peer that has vanished without a word": [
            *(found_out, KEEPALIVE_IDLE, KEEPALIVE_INTERVAL, KEEPALIVE_COUNT)
        ],
        "log lines about refused connections": [gate.LOG_INTERVAL],
        "an unread answer": [SEND_LIMIT >> 20, sockets.STALL],
    }
    for what, numbers in expected.items():
        assert [number for number in told[what] if number != 1 or what == "an unread answer"] == numbers, what
