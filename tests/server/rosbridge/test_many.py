"""Many connections to rosbridge: those that find no room hold few descriptors, and soaks count visits."""

import socket
import time

from benchmarks.chaos.attacks import PING, ROS_UPGRADE, frame
from benchmarks.chaos.onlookers import Onlookers
from benchmarks.chaos.target import Target
from tests.server.peers import PATIENCE, serving
from tests.server.still_world import StillWorld
from usarmjx.server.network import gate
from usarmjx.server.rosbridge.net import RosbridgeServer, RosSettings


def served(**settings):
    ros = RosbridgeServer(StillWorld(), RosSettings(port=0, **settings))
    return ros, serving(ros._world, [ros], realtime_factor=1.0)


def connected(port):
    """A connection after its handshake, which answers nothing more."""
    made = socket.create_connection(("127.0.0.1", port), PATIENCE)
    made.sendall(ROS_UPGRADE)
    head = b""
    while b"\r\n\r\n" not in head:
        head += made.recv(4096)
    assert head.startswith(b"HTTP/1.1 101 ")
    return made


def test_those_without_room_who_do_not_answer_yield_to_others(monkeypatch):
    """Each was held for ten seconds: two thousand of them left robots no descriptor."""
    monkeypatch.setattr(gate, "MAX_STRANGERS", 3)
    ros, serves = served(max_connections=1)
    with serves as (_, server):
        ros.server = server
        guest = connected(ros.port)
        others = [connected(ros.port) for _ in range(6)]
        for other in others[:3]:
            other.settimeout(PATIENCE)
            while True:  # a frame that closes, and then the end
                try:
                    if not other.recv(4096):
                        break
                except ConnectionResetError:
                    break
        assert len(ros._gate._strangers) <= 3
        guest.sendall(frame(PING, b"here"))
        assert guest.recv(6)[2:] == b"here", "who has room stays"
        for one in (guest, *others):
            one.close()


def test_onlookers_come_and_go():
    ros, serves = served()
    with serves as (port, server):
        ros.server = server
        target = Target("127.0.0.1", port, rosbridge_port=ros.port)
        with Onlookers(target, 2, stay=(0.2, 0.4)) as onlookers:
            deadline = time.monotonic() + PATIENCE
            while onlookers.visits < 6 or not onlookers.received:
                assert time.monotonic() < deadline
                time.sleep(0.05)
        assert onlookers.lost == 0
