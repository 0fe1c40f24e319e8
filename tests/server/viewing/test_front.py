"""The live page behind the gate: who does not belong there gets nothing of it."""

import asyncio
import http.client
import socket
import threading
import time
from collections import deque
from types import SimpleNamespace

import msgspec.msgpack
import pytest
import viser
from websockets.exceptions import ConnectionClosed, InvalidHandshake
from websockets.sync.client import connect

from tests.view.simple_worlds import HandMadeSource, drawing_of
from tests.view.visitor import PATIENCE, visiting
from usarmjx.server.network.access import AccessRules, parse_networks
from usarmjx.server.network.gate import Gate
from usarmjx.server.network.ports import bound_socket
from usarmjx.server.network.web_gate import COOKIE
from usarmjx.server.viewing import viser_gate
from usarmjx.server.viewing.viewer_service import ViewerService, ViewerSettings
from usarmjx.server.viewing.viser_gate import MAX_BURST, MAX_MESSAGE_SIZE, MAX_RATE, MessageRate, gated_viser

HOST, TOKEN = "127.0.0.1", "T42"
PROTOCOLS = [f"viser-v{viser.__version__}"]


@pytest.fixture
def served():
    """Makes a server of viser's behind a gate and returns its port; all are stopped in the end."""
    servers = []

    def serve(room=16, names=(), **rules):
        bound = bound_socket(HOST, 0)
        gate = Gate(AccessRules(**rules), room, "viewers")
        servers.append(gated_viser(bound, HOST, gate, names))
        return bound.getsockname()[1]

    yield serve
    for server in servers:
        server.stop()


def get(port, path="/", **headers):
    connection = http.client.HTTPConnection(HOST, port, timeout=20)
    connection.request("GET", path, headers=headers)
    response = connection.getresponse()
    body = response.read()
    connection.close()
    return response.status, response.headers, body


def opens(port, path="/", **how):
    """Whether a websocket is let in."""
    try:
        with connect(f"ws://{HOST}:{port}{path}", subprotocols=PROTOCOLS, max_size=None, **how) as connection:
            return bool(connection.recv(timeout=20))
    except (InvalidHandshake, ConnectionClosed, ConnectionError, EOFError):
        return False


def test_without_rules_the_page_and_its_websocket_are_served(served):
    port = served()
    status, headers, body = get(port)
    assert status == 200
    assert b"<html" in body
    assert opens(port)
    assert "connect-src 'self' data: blob:;" in headers["Content-Security-Policy"]
    assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]


def test_the_token_is_said_once_and_by_cookie_from_then_on(served):
    port = served(token=TOKEN)
    assert [get(port, path)[0] for path in ("/", "/?token=T43", "/index.html")] == [403] * 3
    assert not opens(port)
    assert not opens(port, additional_headers={"Cookie": f"{COOKIE}=T42"})
    status, headers, _ = get(port, f"/?token={TOKEN}")
    assert status == 200
    cookie = headers["Set-Cookie"].partition(";")[0]
    assert get(port, Cookie=cookie)[0] == 200
    assert opens(port, additional_headers={"Cookie": cookie})


@pytest.mark.parametrize("host", ["evil.example", "localhost.evil.example", "10.1.2.3"])
def test_under_a_name_that_is_not_ours_there_is_nothing(served, host):
    port = served(names=("sim.example.org",))
    assert get(port, Host=f"{host}:{port}")[0] == 403
    assert get(port, Host=f"sim.example.org:{port}")[0] == get(port, Host=f"localhost:{port}")[0] == 200


def test_a_page_from_elsewhere_cannot_open_the_websocket(served):
    port = served()
    for origin in ("http://evil.example", f"http://{HOST}:{port + 1}", "null"):
        assert not opens(port, origin=origin)
        assert get(port, Origin=origin)[0] == 403
    assert opens(port, origin=f"http://{HOST}:{port}")


def test_addresses_that_are_not_allowed_are_hung_up_on(served):
    port = served(allow=parse_networks(["10.0.0.0/8"]))
    with pytest.raises((ConnectionError, http.client.HTTPException)):
        get(port)
    assert not opens(port)


def test_no_more_look_than_there_is_room_for(served):
    port = served(room=2)
    how = {"subprotocols": PROTOCOLS, "max_size": None}
    with connect(f"ws://{HOST}:{port}", **how), connect(f"ws://{HOST}:{port}", **how):
        assert get(port)[0] == 503
        assert not opens(port)
    end = time.monotonic() + 20
    while get(port)[0] != 200:  # it takes a moment until a connection is known to have ended
        assert time.monotonic() < end


def test_a_long_message_ends_the_connection(served):
    with connect(f"ws://{HOST}:{served()}", subprotocols=PROTOCOLS, max_size=None) as connection:
        connection.send(b"x" * (MAX_MESSAGE_SIZE + 1))
        with pytest.raises(ConnectionClosed) as closed:
            deque(connection, maxlen=0)
    assert closed.value.rcvd.code == 1009


@pytest.mark.parametrize(
    "message",
    ["text", b"", b"\xc1", b"\x91" * 5000, msgspec.msgpack.encode({"type": "NoSuchMessage"}), b"\x80"],
    ids=["text", "empty", "no msgpack", "nested", "unknown", "no type"],
)
def test_messages_that_no_page_sends_end_the_connection(served, message, caplog):
    """In a line of the log; others are served as before."""
    port = served()
    with connect(f"ws://{HOST}:{port}", subprotocols=PROTOCOLS, max_size=None) as connection:
        connection.send(message)
        with pytest.raises(ConnectionClosed) as closed:
            deque(connection, maxlen=0)
    assert (closed.value.rcvd.code, closed.value.rcvd.reason) == (1008, "it sent what no page sends")
    assert opens(port)
    (record,) = caplog.records
    assert f"viewers: {HOST} is refused: it sent what no page sends" in record.getMessage()
    assert not record.exc_info


def test_who_talks_too_much_is_heard_later():
    rate = MessageRate(now=100.0)
    pauses = [rate.pause(100.0) for _ in range(int(MAX_BURST) + 50)]
    assert not any(pauses[: int(MAX_BURST)])
    assert pauses[-1] == pytest.approx(50 / MAX_RATE)
    assert rate.pause(101.0) == 0.0  # a second later it has been heard, and has some credit again


def test_if_viser_starts_otherwise_nothing_is_served(monkeypatch):
    stopped = []
    otherwise = SimpleNamespace(stop=lambda: stopped.append(True))
    monkeypatch.setattr(viser_gate, "make_viser_server", lambda host, port: otherwise)
    with bound_socket(HOST, 0) as bound, pytest.raises(RuntimeError, match="cannot guard"):
        gated_viser(bound, HOST, Gate(AccessRules(), 4, "viewers"), ())
    assert stopped == [True]


def test_a_visitor_who_comes_too_early_waits_until_viser_is_made(monkeypatch):
    make, early = viser_gate.make_viser_server, []

    def make_slowly(host, port):
        server = make(host, port)
        early.append(connect(f"ws://{host}:{port}", subprotocols=PROTOCOLS, max_size=None))
        with pytest.raises(TimeoutError):
            early[0].recv(timeout=0.5)
        return server

    monkeypatch.setattr(viser_gate, "make_viser_server", make_slowly)
    server = gated_viser(bound_socket(HOST, 0), HOST, Gate(AccessRules(), 4, "viewers"), ())
    try:
        with early[0] as visitor:
            assert visitor.recv(timeout=20), "and is then served as all are"
    finally:
        server.stop()


class Loop:
    """A loop in a thread that ticks a service, as a server's does."""

    def __init__(self, service):
        self.service, self.lines, self._stop = service, [], threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run()))

    async def _run(self):
        self.lines += await self.service.start()
        while not self._stop.is_set():
            self.service.tick()
            await asyncio.sleep(0.01)
        self.service.stop()

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join()


def test_the_page_is_made_when_somebody_first_asks_and_then_shows_the_worlds():
    source = HandMadeSource(drawing_of(robots=2))
    bound = bound_socket(HOST, 0)
    port = bound.getsockname()[1]
    service = ViewerService(source, ViewerSettings(access=AccessRules(token=TOKEN)), bound)
    with Loop(service) as loop:
        time.sleep(0.1)
        assert loop.lines == [f"see it at http://{HOST}:{port}/?token=..."]
        assert service.page is None
        assert source.asked == [0]
        with visiting(port, path=f"/?token={TOKEN}") as visitor:
            end = time.monotonic() + PATIENCE
            while source.asked[0] < 5 or not visitor.of("BatchedGlbMessage"):
                assert time.monotonic() < end
                time.sleep(0.01)
    assert service.page is not None
    with pytest.raises(OSError, match="refused"):
        socket.create_connection((HOST, port), 5)


def test_a_service_that_nobody_asks_for_ends_without_a_page():
    bound = bound_socket(HOST, 0)
    with Loop(ViewerService(HandMadeSource(drawing_of()), ViewerSettings(), bound)) as loop:
        time.sleep(0.05)
    assert loop.service.page is None
    assert bound.fileno() == -1
