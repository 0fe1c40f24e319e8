"""All ports by IPv6, and wall clocks that jump: neither robots nor budgets notice."""

import socket
import time
from itertools import pairwise

import pytest

from tests.server.all_ports import KINDS, all_ports
from tests.server.lockstep import LOCKSTEP
from tests.server.peers import Peer, serving
from tests.server.still_world import StillWorld, init

LOOPBACK = "::1"
HOUR = 3600.0


def has_ipv6():
    try:
        with socket.create_server((LOOPBACK, 0), family=socket.AF_INET6):
            return True
    except OSError:
        return False


@pytest.fixture(scope="module")
def ports():
    with all_ports(host=LOOPBACK) as found:
        yield found


@pytest.mark.skipif(not has_ipv6(), reason="no IPv6")
@pytest.mark.parametrize("kind", KINDS)
def test_a_port_answers_by_ipv6(ports, kind):
    head = b"[::1]" if kind in ("page", "figures") else b"127.0.0.1"
    question = KINDS[kind][1].replace(b"127.0.0.1", head)
    with socket.create_connection((LOOPBACK, ports.ports[kind]), 60.0) as connection:
        connection.sendall(question)
        assert connection.recv(len(KINDS[kind][2])) == KINDS[kind][2][: len(KINDS[kind][2])]


@pytest.mark.parametrize("jump", [-1e6 * HOUR, -HOUR, HOUR, 1e6 * HOUR])
def test_a_jump_of_the_wall_clock_is_not_noticed(monkeypatch, jump):
    """By NTP or a suspended machine: reports stay 0.2 s apart, nobody is silent for too long."""
    usual = time.time
    with serving(StillWorld(), realtime_factor=LOCKSTEP, init_timeout=5.0) as (port, server):
        waits, drives = Peer(port), Peer(port, init("R1"))
        before = drives.sta_times(3)
        monkeypatch.setattr(time, "time", lambda: usual() + jump)
        monkeypatch.setattr(time, "time_ns", lambda: round((usual() + jump) * 1e9))
        times = before + drives.sta_times(5)
        apart = [after - first for first, after in pairwise(times)]
        assert apart == pytest.approx([0.2] * 7, abs=0.011)  # times have two decimals
        assert len(server.clients) == 2
        waits.say("GETSTARTPOSES")
        assert waits.until(b"NFO {StartPoses")
        for peer in (waits, drives):
            peer.close()
