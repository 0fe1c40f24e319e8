"""A browser may send what somebody else's page tells it to, to any port: none of it is carried out."""

import contextlib

import pytest

from tests.arenas import FLAT
from tests.server.peers import PATIENCE, Peer, serving
from tests.server.radio_servers import SHORT, crowded
from usarmjx.server.pictures.image_server import ImageServer, ImageSettings
from usarmjx.server.protocol.grammar import HttpRequestError, LineBuffer, refuse_http
from usarmjx.server.protocol.images import ImageSession
from usarmjx.server.wireless.net import WirelessSettings, make_wireless

HEAD = "Host: 127.0.0.1:3000\r\nAccept: text/html;q=0.9, */*;q=0.8\r\nOrigin: http://evil.example\r\n\r\n"
BODIES = {
    "robots": "INIT {ClassName USARBot.ComStation} {Name Intruder} {Location 0,0,-0.9}\r\nGETSTARTPOSES\r\n",
    "wss": "REGISTER Intruder 127.0.0.1;LISTEN Intruder 4001;",
    "wss2": "INIT {Robot Intruder} {Port 4001}\r\nGETSS {Robot R1}\r\n",
    "position": "GETPOS\r\n",
    "images": "OKOKOK",
}
"""What a page would have done at each port."""
REQUESTS = {
    "POST": "POST / HTTP/1.1\r\n" + HEAD,
    "GET": "GET /REGISTER?x=1 HTTP/1.1\r\n" + HEAD,
    "OPTIONS": "OPTIONS * HTTP/1.1\r\n" + HEAD,
    "its own method": "INIT /x HTTP/1.1\r\n" + HEAD,
    "a long path": f"POST /{'x' * 9000} HTTP/1.1\r\n" + HEAD,
    "only its host": "host: localhost\r\n\r\n",
}


@pytest.mark.parametrize("request_text", REQUESTS.values(), ids=REQUESTS)
@pytest.mark.parametrize("size", [1, 7, 1 << 20])
def test_lines_of_http_are_told_from_any_chunks(request_text, size):
    data = (request_text + BODIES["robots"]).encode()
    pieces, heard = (data[at : at + size] for at in range(0, len(data), size)), []
    buffer = LineBuffer()
    with pytest.raises(HttpRequestError, match="not for browsers"):
        heard.extend(line for piece in pieces for line in buffer.feed(piece))
    assert heard == []


@pytest.mark.parametrize(
    "line",
    [
        "GETSTARTPOSES",
        "GETCONF {Type HTTP/1.1}",
        "GETGEO {Type Robot} HTTP/1.1",
        "GET {Type Sonar}",
        "Trace {On True} {Interval 1}",
        "TRACE {Color Red} / HTTP/1.0",
        "SET {Type Camera} {Robot R1} {Name Camera} {Client Host:1}",
        "DRIVE {Left 1.0}",
        "DRIVE {Name HTTP/1.1}",
        "DNS {Robot R2} {Port 3333}",
        "hosts: 3",
    ],
)
def test_commands_are_not_taken_for_http(line):
    refuse_http(line)


def test_acknowledgements_of_pictures_are_not_taken_for_http():
    session = ImageSession((320, 240), 0.1, 0.0)
    session.receive_data(b"OK\r\nU" + bytes(range(16)) + b"OK" * 9000)
    with pytest.raises(HttpRequestError):
        session.receive_data(b"\r\nGET / HTTP/1.1\r\n")


@pytest.fixture(scope="module")
def world():
    return crowded(FLAT, "ComStation")


@pytest.fixture
def doors(world):
    """All ports that are not for browsers, by name, and the server."""
    pictures = ImageServer(world, ImageSettings(port=0, size=(32, 24)))
    radio = make_wireless(world, SHORT, WirelessSettings(wss_port=0, wss2_port=0, position_port=0))
    with serving(world, [pictures, radio]) as (port, server):
        yield {"robots": port, "images": pictures.port, **radio.ports}, server, radio


@pytest.mark.parametrize("door", BODIES)
@pytest.mark.parametrize("name", ["POST", "a long path"])
@pytest.mark.parametrize("together", [True, False])
def test_a_browser_is_hung_up_on_before_anything_is_done(doors, caplog, door, name, together):
    ports, server, radio = doors
    texts = [REQUESTS[name] + BODIES[door]] if together else [REQUESTS[name], BODIES[door]]
    with contextlib.closing(Peer(ports[door])) as peer:
        if door == "robots":
            assert peer.line().startswith(b"NFO")
        with contextlib.suppress(ConnectionError):
            for text in texts:
                peer.socket.sendall(text.encode())
        peer.socket.settimeout(PATIENCE)
        assert peer.line() == b""
        assert door == "images" or peer._rest == b"", "nothing is answered; a picture comes unasked"
    assert not server.counts.commands
    assert not server.world.robots
    assert not radio._links._server._registrations
    assert not radio._proxies._board.has("Intruder")
    told = [r.getMessage() for r in caplog.records if "HTTP" in r.getMessage()]
    assert len(told) == 1, caplog.text
    assert "it speaks HTTP, and this port is not for browsers" in told[0]
