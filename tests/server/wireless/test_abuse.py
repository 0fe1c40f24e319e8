"""Peers of the wireless servers that misbehave: nobody else notices, and nothing is left of them.

A bystander in the same world must get its reports in step, and a link of other robots must go on.
"""

import contextlib
import os
import socket
import struct
import sys
import threading
import time

import numpy as np
import pytest

from tests.arenas import FLAT
from tests.server.peers import PATIENCE, Peer, wait_until
from tests.server.radio_servers import client, crowded, drain, on_air, spread
from usarmjx.server.wireless import sockets
from usarmjx.server.wireless.dialect_a import MAX_PAYLOAD
from usarmjx.server.wireless.sockets import MAX_WRITE_BUFFER


@pytest.fixture(scope="module")
def world():
    return crowded(FLAT, "ComStation")


@pytest.fixture
def radio(world):
    """Four times faster than the clock: work that others cause must not cost the world its steps."""
    with on_air(world, realtime_factor=4.0) as radio:
        yield radio


@pytest.fixture
def stations(radio, world):
    """Three base stations that hear each other; the third is a bystander, whose every report must come."""
    peers = [radio.robot(f"Base{i}", *place) for i, place in enumerate(spread(3))]
    yield peers
    now = world.time
    while peers[2].times[-1] < now + 0.2:
        peers[2].sta_times(1)
    np.testing.assert_allclose(np.diff(peers[2].times), 0.2, atol=0.011)  # two decimals


@pytest.fixture
def control(radio, stations):
    """A control connection of dialect A with a good link from Base1 to Base2, which must go on."""
    control = radio.control_a("Base0", "Base1", "Base2")
    near, far = radio.link_a(control, "Base1", "Base2")
    yield control
    near.send(b"still here")
    assert drain(far, 10) == b"still here"


def raw(port, room=None):
    """A bare connection."""
    peer = socket.socket()
    if room:
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, room)
    peer.connect(("127.0.0.1", port))
    peer.settimeout(PATIENCE)
    return peer


def is_over(peer):
    """Whether the server has ended a connection; drops what has come."""
    with contextlib.suppress(TimeoutError):
        try:
            peer.settimeout(0.01)
            return peer.recv(65536) == b""
        except ConnectionError:
            return True
    return False


def pour(peer, data, times):
    """Send as long as it is taken; True if the server broke the connection off."""
    peer.settimeout(0.2)
    try:
        for _ in range(times):
            peer.sendall(data)
    except TimeoutError:
        return False
    except ConnectionError:
        return True
    return False


def backlog(service):
    """What waits in the server for peers to read it [bytes]."""
    writers = [side.writer for link in service._links._links for side in link.sides]
    writers += [
        end for pipes in service._proxies._connections.values() for pipe in pipes for end in pipe.ends
    ]
    writers += [connection.writer for connection in service._connections]
    return max(writer.transport.get_write_buffer_size() for writer in writers)


# Data links


@pytest.mark.parametrize("size", [str(MAX_PAYLOAD + 1).encode(), b"1000000000000", b"9" * 100_000])
def test_an_announcement_of_a_million_million_bytes_ends_the_link(radio, control, size):
    near, far = radio.link_a(control, "Base0", "Base1")
    near._socket.sendall(b"SEND 2 ok;SEND ")
    assert drain(far, 2) == b"ok"
    with contextlib.suppress(ConnectionError):
        near._socket.sendall(size + b" abc")
    assert far.receive(PATIENCE) == b""
    assert near.receive(PATIENCE) == b""


def test_a_link_that_breaks_in_the_middle_of_a_send_delivers_nothing_of_it(radio, control):
    near, far = radio.link_a(control, "Base0", "Base1")
    near.send(b"whole")
    assert drain(far, 5) == b"whole"
    near._socket.sendall(b"SEND 1000 half of it")
    near._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    near.close()
    assert far.receive(PATIENCE) == b""


@pytest.mark.parametrize("dialect", ["a", "b"])
def test_who_never_reads_holds_up_its_sender_only_and_is_dropped(radio, control, monkeypatch, dialect):
    caller, called = radio.control_b("Base0"), radio.control_b("Base1")
    message = b"SEND 60000 " + bytes(60_000) + b";"

    def connect():
        if dialect == "a":
            return radio.link_a(control, "Base0", "Base1")
        return radio.pipe_b(caller, called, "Base1")

    near, _ = connect()
    assert not pour(near._socket, message, 2000), "the sender has to wait"
    assert backlog(radio.service) <= MAX_WRITE_BUFFER + sockets.DATA_READ_SIZE + MAX_PAYLOAD
    monkeypatch.setattr(sockets, "STALL", 0.2)
    near, _ = connect()
    wait_until(lambda: pour(near._socket, message, 2000), "the link to be dropped")


def test_junk_on_a_data_link_is_skipped(radio, control):
    near, far = radio.link_a(control, "Base0", "Base1")
    junk = np.random.default_rng(3).bytes(300_000).replace(b"SEND", b"....").replace(b"CLOSE", b".....")
    near._socket.sendall(junk + b";")
    near._socket.sendall(b"....." + b";SEND 2 ok;")
    assert drain(far, 2) == b"ok"


# Control connections


def everywhere(radio):
    return [radio.ports[name] for name in ("wss", "wss2", "position")]


def test_junk_at_every_door(radio, control):
    random = np.random.default_rng(0)
    for port in everywhere(radio):
        vandal = raw(port)
        pour(vandal, random.bytes(20_000) + b";\r\n;;;{{{}}}\r\n", 20)
        vandal.close()


def test_one_message_without_an_end_at_every_door(radio, control):
    for port in everywhere(radio):
        vandal = raw(port)
        assert not pour(vandal, b"x" * 65536, 40)
        vandal.close()


def test_who_asks_and_never_reads_waits_for_his_answers_and_is_dropped(radio, control, monkeypatch):
    monkeypatch.setattr(sockets, "STALL", 0.2)
    questions = (b"GETSS Base0 Base1;" * 500, b"GETSS {Robot Base1}\r\n" * 500, b"GETPOS\r\n" * 500)
    for port, question in zip(everywhere(radio), questions, strict=True):
        deaf = raw(port, room=4096)
        deadline = time.monotonic() + PATIENCE
        while not pour(deaf, question, 50):
            assert time.monotonic() < deadline
            assert backlog(radio.service) <= MAX_WRITE_BUFFER + 4 * sockets.DATA_READ_SIZE
        deaf.close()


def test_a_flood_of_questions_does_not_stop_the_world_or_the_others(radio, world, control, record_property):
    """Sixteen peers ask as fast as they can; together they get their share of the time and no more."""
    stop = threading.Event()

    def ask(port, question):
        peer = raw(port)
        with contextlib.suppress(OSError):
            while not stop.is_set():
                peer.sendall(question)
                peer.recv(65536)
        peer.close()

    questions = {
        "wss": b"GETSS Base0 Base1;" * 100,
        "position": b"GETOBS {Start 0,0,-1} {End 9,9,-1}\r\n" * 100,
    }
    threads = [
        threading.Thread(target=ask, args=(radio.ports[name], question))
        for name, question in questions.items()
        for _ in range(8)
    ]
    for thread in threads:
        thread.start()
    try:
        first, began, waits = world.time, time.monotonic(), []
        for _ in range(20):
            asked = time.monotonic()
            control.strength("Base0", "Base1")
            waits.append(time.monotonic() - asked)
        wait_until(lambda: world.time > first + 4.0, "four seconds of the world's time")
        pace = (world.time - first) / (time.monotonic() - began)
    finally:
        stop.set()
        for thread in threads:
            thread.join()
    record_property("longest_wait_s", max(waits))
    record_property("pace", pace)
    assert max(waits) < 5.0
    assert pace > 0.2, "of the clock's, not 4: the clients of this test take their part of the machine"


def test_strangers_yield_to_newcomers_and_robots_stay(world):
    with on_air(world, realtime_factor=1.0, max_connections=4) as radio:
        radio.robot("Base0", 0.0)
        mine = radio.control_a("Base0")
        strangers = [radio.keep(raw(radio.ports["position"])) for _ in range(12)]
        wait_until(lambda: sum(map(is_over, strangers[:-3])) == 9, "the oldest strangers to be dropped")
        radio.control_b("Base0")
        with pytest.raises(client().RadioError, match="third party"):
            mine.strength("Base1", "Base2")


def test_silent_strangers_are_dropped_and_robots_may_be_silent(world):
    with on_air(world, idle_timeout=0.2) as radio:
        radio.robot("Base0", 0.0)
        mine = [radio.control_a("Base0"), radio.control_b("Base0")]
        strangers = [radio.keep(raw(port)) for port in everywhere(radio)]
        for stranger in strangers:
            wait_until(lambda stranger=stranger: is_over(stranger), "a silent stranger to be dropped")
        assert [control._socket.fileno() > 0 and not is_over(control._socket) for control in mine] == [
            True,
            True,
        ]


# What it dials


def test_a_robot_that_does_not_take_the_call_fails_the_opening(radio, control):
    with client().RadioDoor(True) as door:
        control.order(f"LISTEN Base1 {door.port}")
    with pytest.raises(client().RadioError, match="Could not establish connection"):
        control.order(f"OPEN Base0 1 Base1 {door.port}")


def test_a_robot_that_does_not_answer_the_call_fails_the_opening_in_time(radio, control, monkeypatch):
    """A listener whose queue is full answers nobody."""
    monkeypatch.setattr(sockets, "CONNECT_TIMEOUT", 0.3)
    with contextlib.ExitStack() as stack:
        full = stack.enter_context(socket.create_server(("127.0.0.1", 0), backlog=0))
        address = full.getsockname()
        for _ in range(4):
            caller = stack.enter_context(socket.socket())
            caller.setblocking(False)
            caller.connect_ex(address)
        control.order(f"LISTEN Base1 {address[1]}")
        with pytest.raises(client().RadioError, match="Could not establish connection"):
            control.order(f"OPEN Base0 1 Base1 {address[1]}")


@pytest.mark.skipif(sys.platform != "linux", reason="127.0.0.2 is an address of its own on Linux only")
def test_another_address_is_dialled_only_if_allowed(world):
    for allow in ((), ("127.0.0.2",)):
        with on_air(world, allow=allow) as radio:
            radio.robot("Base0", 0.0)
            radio.robot("Base1", 1.0)
            control = radio.control_a("Base0")
            if not allow:
                with pytest.raises(client().RadioError, match=r"Address 127\.0\.0\.2 is not yours"):
                    control.order("REGISTER Base1 127.0.0.2")
                continue
            control.order("REGISTER Base1 127.0.0.2")
            door = radio.keep(client().RadioDoor(True, host="127.0.0.2"))
            control.listen_again("Base1", door)
            near = radio.keep(control.connect("Base0", "Base1", door.port))
            near.send(b"hello")
            assert drain(radio.keep(door.accept(PATIENCE)), 5) == b"hello"


@pytest.mark.skipif(sys.platform != "linux", reason="127.0.0.2 is an address of its own on Linux only")
def test_a_number_of_dialect_b_answers_only_the_one_it_was_given_to(radio, stations):
    one, other = radio.control_b("Base0"), radio.control_b("Base1")
    near, _ = radio.pipe_b(one, other, "Base1")
    stranger = radio.keep(socket.create_connection(near._socket.getpeername(), PATIENCE, ("127.0.0.2", 0)))
    assert stranger.recv(1) == b""
    with pytest.raises(TimeoutError):
        other.door.accept(0.2)


def test_pipes_of_dialect_b_are_bounded(radio, stations):
    one, other = radio.control_b("Base0"), radio.control_b("Base1")
    number = int(one.order("DNS", Robot="Base1").value("Port"))
    calls = [radio.keep(raw(number)) for _ in range(40)]
    wait_until(lambda: sum(map(is_over, calls)) == 8, "the calls beyond 32 to be refused")
    assert not is_over(other._socket)


def test_peers_that_come_and_go_at_once(radio, control):
    for port in everywhere(radio):
        for end in (Peer.close, Peer.reset):
            for _ in range(20):
                end(Peer(port))
    wait_until(lambda: len(radio.service._connections) == 1, "only the controller's connection to be left")


# In the long run


def descriptors():
    return len(os.listdir("/proc/self/fd"))


def memory():
    """Resident memory of this process, server and clients [MB]."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def churn(radio, control, base, ugly):
    """Let a link and a pipe come, carry something and go, in an ugly way if asked to."""
    with client().WirelessA(port=radio.ports["wss"]) as once, contextlib.ExitStack() as stack:
        once.register("Base0")
        door = stack.enter_context(control.listen("Base1"))
        near = stack.enter_context(control.connect("Base0", "Base1", door.port))
        far = stack.enter_context(door.accept(PATIENCE))
        caller = stack.enter_context(client().WirelessB("Base0", port=radio.ports["wss2"]))
        there = stack.enter_context(caller.connect("Base2"))
        here = stack.enter_context(base.door.accept(PATIENCE))
        for link, end in ((near, far), (there, here)):
            link.send(b"x" * 1000)
            drain(end, 1000)
        if ugly:
            near._socket.sendall(b"SEND 1000000000000 ")
            there._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    wait_until(lambda: len(radio.service._links._links) == 1, "the link to go")
    wait_until(lambda: not radio.service._proxies._connections, "the pipe to go")
    wait_until(lambda: len(radio.service._proxies._handlers) == 1, "the caller to go")
    wait_until(lambda: not radio.service._proxies._ports, "its number to be given back")


LISTED = pytest.mark.skipif(not os.path.isdir("/proc/self/fd"), reason="counts what /proc lists")


@LISTED
def test_nothing_is_left_of_links_and_pipes(radio, control, record_property):
    """The short version of the soak: one in three ends in an ugly way."""
    base = radio.control_b("Base2")
    counts = []
    for cycle in range(150):
        churn(radio, control, base, ugly=cycle % 3 == 0)
        if cycle >= 10 and cycle % 10 == 0:
            counts.append(descriptors())
    record_property("descriptors", counts)
    assert max(counts) - min(counts) <= 8, counts
    assert abs(counts[-1] - counts[0]) <= 4, "no trend"


@LISTED
@pytest.mark.slow
def test_descriptors_and_memory_stay_flat_for_half_an_hour(world, record_property):
    """`USARMJX_SOAK` says for how many seconds; half an hour if it does not."""
    seconds, counts, sizes, cycle = float(os.environ.get("USARMJX_SOAK", "1800")), [], [], 0
    with on_air(world, realtime_factor=0.5) as radio:  # batteries last 20 minutes of the world's time
        for i, place in enumerate(spread(3)):
            radio.robot(f"Base{i}", *place)
        control, base = radio.control_a("Base0", "Base1", "Base2"), radio.control_b("Base2")
        radio.link_a(control, "Base1", "Base2")
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            churn(radio, control, base, ugly=cycle % 3 == 0)
            time.sleep(0.03)  # the system keeps the ports of closed connections for a minute: let them last
            cycle += 1
            if cycle % 200 == 0:
                counts.append(descriptors())
                sizes.append(memory())
    record_property("cycles", cycle)
    record_property("descriptors", (min(counts), max(counts)))
    record_property("memory_mb", (sizes[0], sizes[len(sizes) // 2], sizes[-1]))
    assert max(counts) - min(counts) <= 8, counts
    # From the middle on, when all pools have their size; in half an hour 300 bytes per cycle would show.
    assert sizes[-1] - sizes[len(sizes) // 2] < 5.0, sizes
