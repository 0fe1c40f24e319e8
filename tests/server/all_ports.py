"""A server with every kind of port that strangers can reach, and what each answers."""

import contextlib
import os
import socket
import stat
from types import SimpleNamespace

import numpy as np

from tests.server.fake_radio import FakeRadio
from tests.server.peers import PATIENCE, looping
from tests.server.still_world import StillWorld
from tests.view.simple_worlds import HandMadeSource, drawing_of
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.gamebots.settings import BotServerSettings
from usarmjx.server.network.access import AccessRules
from usarmjx.server.network.ports import bound_socket
from usarmjx.server.pictures.image_server import ImageServer, ImageSettings
from usarmjx.server.runtime.metrics import MetricsServer
from usarmjx.server.viewing.viewer_service import ViewerService, ViewerSettings
from usarmjx.server.wireless.net import WirelessService, WirelessSettings

HOST, ELSEWHERE = "127.0.0.1", "127.0.0.2"
"""Two addresses of this machine."""
TOKEN = "open-sesame_42"
LINE = f"AUTH {{Token {TOKEN}}}\r\n".encode()
KINDS = {
    "robots": (LINE, b"GETSTARTPOSES\r\n", b"NFO {Gametype"),
    "wss": (f"AUTH {TOKEN};".encode(), b"GETSS R1 R2;", b"Fail: "),
    "wss2": (LINE, b"GETSS {Robot R1}\r\n", b"ERROR {Reason Must"),
    "position": (LINE, b"GETPOS\r\n", b"POSITIONS {Robots 2}"),
    "pictures": (LINE, b"OK", bytes([0, 0, 0, 0, 4 + 3 * 8 * 6])),
    "page": (
        f"GET /?token={TOKEN} HTTP/1.1\r\nHost: {HOST}\r\n\r\n".encode(),
        f"GET / HTTP/1.1\r\nHost: {HOST}\r\n\r\n".encode(),
        b"HTTP/1.1 200 OK\r\n",
    ),
    "figures": (
        f"GET /metrics?token={TOKEN} HTTP/1.1\r\nHost: {HOST}\r\n\r\n".encode(),
        f"GET /metrics HTTP/1.1\r\nHost: {HOST}\r\n\r\n".encode(),
        b"HTTP/1.1 200 OK\r\n",
    ),
}
"""How each port is told the token, a question to it, and how the answer begins."""
TCP_KINDS = [kind for kind in KINDS if kind not in ("page", "figures")]


class AllPorts:
    """The ports of a running server by their kinds, and connections to them, which are closed with it."""

    def __init__(self, ports, server, host=HOST):
        self.ports, self.server, self._host = ports, server, host
        self._open = contextlib.ExitStack()

    def connect(self, kind, address=HOST):
        """A connection from an address."""
        made = socket.create_connection((self._host, self.ports[kind]), PATIENCE, (address, 0))
        return self._open.enter_context(made)

    def answers(self, kind, said, address=HOST):
        """Whether a port answers its question if something is said before."""
        return begins(self.connect(kind, address), said + KINDS[kind][1], KINDS[kind][2])

    def close(self):
        self._open.close()


def begins(connection, said, start):
    """Whether what comes begins so once something was said; if not, nothing at all may come."""
    with contextlib.suppress(ConnectionError):
        connection.sendall(said)
    heard = hear(connection, len(start))
    assert heard in (start, b""), heard
    return heard == start


def hear(connection, most):
    """The next bytes, fewer if the server hangs up."""
    heard = b""
    with contextlib.suppress(ConnectionError):
        while len(heard) < most and (more := connection.recv(most - len(heard))):
            heard += more
    return heard


def server_side(connection):
    """The server's end of a connection, as the server is in this process; None until it has accepted it."""
    name = connection.getsockname()
    for number in map(int, os.listdir("/proc/self/fd")):
        with contextlib.suppress(OSError):  # it has no peer, or is closed
            if stat.S_ISSOCK(os.fstat(number).st_mode):
                with contextlib.ExitStack() as stack:
                    copy = stack.enter_context(socket.socket(fileno=os.dup(number)))
                    if copy.family == socket.AF_INET and copy.getpeername() == name:
                        stack.pop_all()
                        return copy
    return None


def black(shot):
    return SimpleNamespace(rgb=np.zeros((shot.height, shot.width, 3), np.uint8))


@contextlib.contextmanager
def all_ports(host=HOST, **rules):
    """A running server with all its ports at an address, for those whom rules let in."""
    access, world = AccessRules(**rules), StillWorld()
    world.snapshot = lambda shots: lambda: [black(shot) for shot in shots]
    ports = {"wss_port": 0, "wss2_port": 0, "position_port": 0}
    radio = WirelessService(
        FakeRadio(("R1", "R2")), world, WirelessSettings(access=access, host=host, **ports)
    )
    images = ImageServer(world, ImageSettings(host=host, port=0, size=(8, 6), format=0, access=access))
    page = ViewerService(HandMadeSource(drawing_of()), ViewerSettings(host=host, access=access))
    server = BotServer(world, BotServerSettings(host=host, port=0, access=access), [radio, images, page])
    figures = bound_socket(host, 0)
    server.services.append(MetricsServer([server], 1.0, figures))
    with looping([server]):
        web = {"page": page.port, "figures": figures.getsockname()[1]}
        found = AllPorts({"robots": server.port, **radio.ports, "pictures": images.port, **web}, server, host)
        try:
            yield found
        finally:
            found.close()
