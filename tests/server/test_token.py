"""The token on real sockets: at every kind of port it comes first, and a browser says it once."""

import http.client
import socket

import pytest
import viser
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from tests.server.all_ports import HOST, KINDS, LINE, TCP_KINDS, TOKEN, all_ports, begins, hear
from tests.server.peers import PATIENCE, Peer, serving, wait_until
from tests.server.radio_servers import client
from tests.server.still_world import StillWorld, init
from usarmjx.server.network import gate
from usarmjx.server.network.access import AccessRules
from usarmjx.server.network.web_gate import COOKIE

TIMEOUT = 0.3  # s: what a test waits for
NOTHING = b""


@pytest.fixture(scope="module")
def locked():
    """All ports, for those who know the token."""
    with all_ports(token=TOKEN) as found:
        yield found


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_is_obeyed_or_said_before_the_token(locked, kind):
    said, question, answer = KINDS[kind]
    if kind not in TCP_KINDS:
        assert begins(locked.connect(kind), said, answer)
        for wrong in (question, said.replace(b"42", b"43")):
            assert begins(locked.connect(kind), wrong, b"HTTP/1.1 403 ")
    else:
        assert locked.answers(kind, said)
        assert not locked.answers(kind, NOTHING)
        assert not locked.answers(kind, said.replace(b"42", b"43"))
        assert not locked.answers(kind, said.replace(TOKEN.encode(), NOTHING))


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
    locked.server._gate._lines._ends = 0.0
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


def test_the_bundled_client_says_the_token(locked, monkeypatch):
    ports = locked.ports
    with client().UsarsimClient(port=ports["robots"], token=TOKEN) as robot:
        assert robot.start_poses()
    with client().WirelessA(port=ports["wss"], token=TOKEN) as radio:
        radio.register("R1")
    with client().WirelessB("R1", port=ports["wss2"], token=TOKEN) as radio:
        assert radio.door.port
    with client().CameraClient(port=ports["pictures"], token=TOKEN) as camera:
        assert camera.picture().width == 8
    with pytest.raises(ConnectionError):
        client().UsarsimClient(port=ports["robots"], token=TOKEN[:-1])
    with monkeypatch.context() as patch:
        patch.setattr(gate, "AUTH_TIMEOUT", TIMEOUT)
        with pytest.raises(ConnectionError):
            client().UsarsimClient(port=ports["robots"], timeout=PATIENCE)
    monkeypatch.setenv("USARMJX_TOKEN", TOKEN)
    with client().UsarsimClient(port=ports["robots"]) as robot:
        assert robot.start_poses()


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
    how = {"subprotocols": [f"viser-v{viser.__version__}"], "max_size": None}
    view = f"ws://{HOST}:{locked.ports['page']}/"
    for wrong in ({}, {"Cookie": cookie[:-1]}):
        with pytest.raises(InvalidStatus, match="403"):
            connect(view, additional_headers=wrong, **how)
    with connect(view, additional_headers={"Cookie": cookie}, **how) as watcher:
        assert watcher.recv(timeout=PATIENCE)


def test_a_token_that_is_said_again_has_no_effect_and_stays_out_of_the_log(caplog):
    with all_ports(token=TOKEN) as fresh:
        for kind in TCP_KINDS:
            said, question, answer = KINDS[kind]
            assert begins(fresh.connect(kind), said + said + question, answer), kind
    assert TOKEN not in caplog.text


def test_a_server_without_a_token_takes_one_without_effect(caplog):
    with all_ports() as open_to_all:
        for kind in TCP_KINDS:
            said, question, answer = KINDS[kind]
            for whole in (said + question, question):
                assert begins(open_to_all.connect(kind), whole, answer), kind
    assert TOKEN not in caplog.text
    assert "fault" not in caplog.text


@pytest.mark.parametrize("kind", ["page", "figures"])
@pytest.mark.parametrize("pieces", [1, 1000])
def test_a_proxy_may_speak_http_1_0(locked, kind, pieces, log):
    """As `ab` and proxies in their usual settings do. The log has neither token nor traceback."""
    request = KINDS[kind][0].replace(b"HTTP/1.1", b"HTTP/1.0")
    connection = locked.connect(kind)
    for start in range(0, len(request), -(-len(request) // pieces)):
        connection.sendall(request[start : start + -(-len(request) // pieces)])
    assert hear(connection, 17) == b"HTTP/1.1 200 OK\r\n"
    assert hear(connection, 10**6)
    assert log.text == ""


@pytest.mark.parametrize("kind", ["page", "figures"])
def test_browsers_that_never_finish_their_request_keep_nobody_out(monkeypatch, kind):
    """The oldest of too many yields, before its time is up, so that they do not take all file descriptors."""
    monkeypatch.setattr(gate, "MAX_STRANGERS", 3)
    monkeypatch.setattr(gate, "AUTH_TIMEOUT", 2 * PATIENCE)
    with all_ports(token=TOKEN) as fresh:  # strangers of other tests would be the oldest
        held = [fresh.connect(kind) for _ in range(3)]
        for one in held:
            one.sendall(b"GET /?slow HTTP/1.1\r\nHost: ")
        assert fresh.connect(kind)  # one more
        held[0].settimeout(PATIENCE)
        assert hear(held[0], 1) == b""
        said, _, answer = KINDS[kind]
        assert begins(fresh.connect(kind), said, answer)
