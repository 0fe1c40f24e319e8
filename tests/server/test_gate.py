"""Who gets in at each port, on real sockets: networks, tokens, so many of an address, and nobody for ever."""

import asyncio
import contextlib
import http.client
import ipaddress
import re
import socket
import time

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from tests.server.all_ports import (
    ELSEWHERE,
    HOST,
    KINDS,
    LINE,
    TCP_KINDS,
    TOKEN,
    all_ports,
    begins,
    black,
    hear,
    server_side,
)
from tests.server.peers import PATIENCE, Peer, serving
from tests.server.radio_servers import client, wait_until
from tests.server.still_world import StillWorld, init
from usarmjx.server import gate, ports
from usarmjx.server.access import AccessRules, parse_networks
from usarmjx.server.gate import KEEPALIVE_COUNT, KEEPALIVE_IDLE, KEEPALIVE_INTERVAL, Gate
from usarmjx.server.pictures.spectator_server import SpectatorServer, SpectatorSettings
from usarmjx.server.ports import bound_socket
from usarmjx.server.web_gate import COOKIE
from usarmjx.server.wireless import sockets
from usarmjx.server.wireless.sockets import ReservedPort

TIMEOUT = 0.3  # s: what a test waits for
ASKING = 2.0  # s: for so long somebody asks without a pause
NOTHING = b""


@pytest.fixture(scope="module")
def guarded():
    """All ports, for one address only."""
    with all_ports(allow=parse_networks([ELSEWHERE])) as found:
        yield found


@pytest.fixture(scope="module")
def locked():
    """All ports, for those who know the token."""
    with all_ports(token=TOKEN) as found:
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


# The token


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_is_obeyed_or_said_before_the_token(locked, kind):
    said, question, answer = KINDS[kind]
    if kind == "page":
        assert begins(locked.connect(kind), said, answer)
        assert hear_refusal(locked, question)
        assert hear_refusal(locked, said.replace(TOKEN.encode(), b"open-sesame_43"))
    else:
        assert locked.answers(kind, said)
        assert not locked.answers(kind, NOTHING)
        assert not locked.answers(kind, said.replace(b"42", b"43"))
        assert not locked.answers(kind, said.replace(TOKEN.encode(), NOTHING))


def hear_refusal(locked, question):
    """Whether a request to the page is forbidden."""
    return begins(locked.connect("page"), question, b"HTTP/1.1 403 ")


@pytest.mark.parametrize("kind", TCP_KINDS)
def test_the_token_may_come_in_pieces(locked, kind):
    said, question, answer = KINDS[kind]
    connection = locked.connect(kind)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connection.settimeout(0.05)
    for piece in (said[:7], said[7:20]):
        connection.sendall(piece)
        with pytest.raises(TimeoutError):  # not a word
            connection.recv(1)
    connection.settimeout(PATIENCE)
    assert begins(connection, said[20:] + question, answer)


@pytest.mark.parametrize("ends", ["\n", "\r", "\n\r", "\r\n\r\n"])
def test_the_line_of_the_token_ends_as_any_other(locked, ends):
    peer = Peer(locked.ports["robots"])
    peer.socket.sendall(f"\r\nauth {{token {TOKEN}}}{ends}{init('Reader')}{ends}".encode())
    assert peer.line().startswith(b"NFO {Gametype")
    assert peer.until(b"STA")
    peer.close()


@pytest.fixture
def log(locked, caplog):
    """The log, in which the next refusal at the robots' port has a line."""
    locked.server._gate._next_log = 0.0
    return caplog


def test_who_keeps_the_token_to_himself_has_to_go(locked, monkeypatch, log):
    monkeypatch.setattr(gate, "AUTH_TIMEOUT", TIMEOUT)
    silent, slow = locked.connect("robots"), locked.connect("position")
    slow.sendall(LINE[:9])
    assert hear(silent, 1) == hear(slow, 1) == b""
    assert f"no token for {TIMEOUT:g} s" in log.text


def test_a_line_without_end_is_not_read_for_a_token(locked, log):
    connection = locked.connect("robots")
    connection.sendall(b"AUTH" + b" " * gate.MAX_AUTH_SIZE)
    assert hear(connection, 1) == b""
    assert f"its first line has more than {gate.MAX_AUTH_SIZE} bytes" in log.text


def test_strangers_keep_nobody_out(locked, monkeypatch):
    """Who owes the token longest yields."""
    monkeypatch.setattr(gate, "MAX_STRANGERS", 3)
    strangers = [locked.connect("robots") for _ in range(3)]
    wait_until(lambda: len(locked.server._gate._strangers) == 3, "three strangers")
    assert locked.answers("robots", LINE)
    assert hear(strangers[0], 1) == b""
    assert begins(strangers[1], LINE, KINDS["robots"][2])


def test_strangers_take_no_seats(monkeypatch):
    with serving(StillWorld(), max_connections=1, access=AccessRules(token=TOKEN)) as (port, server):
        strangers = [Peer(port) for _ in range(4)]
        wait_until(lambda: len(server._gate._strangers) == 4, "four strangers")
        peer = Peer(port, f"AUTH {{Token {TOKEN}}}\r\n{init()}")
        assert peer.until(b"STA")
        for other in (*strangers, peer):
            other.close()


def test_the_bundled_client_says_the_token(locked):
    ports = locked.ports
    with client().UsarsimClient(port=ports["robots"], token=TOKEN) as robot:
        assert robot.start_poses()
    with client().WirelessA(port=ports["wss"], token=TOKEN) as radio:
        radio.register("R1")
    with client().WirelessB("R1", port=ports["wss2"], token=TOKEN) as radio:
        assert radio.door.port
    with client().ImageClient(port=ports["pictures"], token=TOKEN) as camera:
        assert camera.picture().width == 8
    with pytest.raises(ConnectionError):
        client().UsarsimClient(port=ports["robots"], token=TOKEN[:-1])


def page_of(locked, path, **headers):
    """What the page's port answers: status, headers."""
    connection = http.client.HTTPConnection(HOST, locked.ports["page"], timeout=PATIENCE)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    answer.read()
    return answer.status, answer.headers


def test_a_browser_says_the_token_once_and_has_a_cookie_then(locked):
    status, headers = page_of(locked, f"/?token={TOKEN}")
    cookie, *attributes = headers["Set-Cookie"].split("; ")
    assert status == 200
    assert set(attributes) == {"Path=/", "HttpOnly", "SameSite=Strict"}
    assert TOKEN not in cookie
    assert (headers["Referrer-Policy"], headers["Cache-Control"]) == ("no-referrer", "no-store")
    assert page_of(locked, "/", Cookie=f"a=b; {cookie}; c=d")[0] == 200
    assert page_of(locked, "/")[0] == page_of(locked, "/", Cookie=f"{COOKIE}={TOKEN}")[0] == 403
    view = f"ws://{HOST}:{locked.ports['page']}/view"
    for wrong in ({}, {"Cookie": cookie[:-1]}):
        with pytest.raises(InvalidStatus, match="403"):
            connect(view, additional_headers=wrong)
    with connect(view, additional_headers={"Cookie": cookie}) as watcher:
        watcher.send('{"ready": true}')
        assert "caption" in watcher.recv(timeout=PATIENCE)


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


def test_a_page_that_asks_for_nothing_is_closed_and_one_that_waits_is_not():
    world = StillWorld()

    def develop(shots):
        time.sleep(3 * TIMEOUT)
        return [black(shot) for shot in shots]

    world.snapshot = lambda shots: lambda: develop(shots)
    page = SpectatorServer(world, SpectatorSettings(port=0, idle_timeout=TIMEOUT))
    with serving(world, [page]), connect(f"ws://{HOST}:{page.port}/view") as watcher:
        watcher.send('{"ready": true}')
        assert "caption" in watcher.recv(timeout=PATIENCE)
        assert watcher.recv(timeout=PATIENCE)
        with pytest.raises(ConnectionClosed):
            watcher.recv(timeout=PATIENCE)


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
