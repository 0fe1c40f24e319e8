"""The meter of the loop: shares, debts and turns on a clock of its own, and what it does to real sockets."""

import asyncio
import resource
import selectors
import socket

import pytest

from usarmjx.server.network import ports
from usarmjx.server.network.loop_meter import (
    EVENTS_AT_ONCE,
    MOST_DEBT,
    PREFERRED_AT_ONCE,
    ROUNDS,
    SHARE,
    LoopMeter,
    MeteredSelector,
    loop_meter,
    run_metered,
)
from usarmjx.server.network.ports import (
    ACCEPTS_AT_ONCE,
    RESERVE,
    bound_socket,
    keep_reserve,
    most_descriptors,
)

PERIOD = 0.02
READ = selectors.EVENT_READ


class Work:
    """A meter and a selector on a clock of their own, and pairs of sockets of which one end is ready."""

    def __init__(self):
        self.now = 0.0
        self.meter = LoopMeter(clock=lambda: self.now)
        self.selector = MeteredSelector(self.meter)
        self.pairs = []
        self.own = self.pair()  # the first is the loop's own

    def pair(self):
        near, far = socket.socketpair()
        far.send(b"x")
        self.pairs.append((near, far))
        self.selector.register(near, READ, near)
        return near

    def round(self, cost=0.0):
        """Make a round of the loop; return the sockets whose turn it is, but its own."""
        ready = [key.data for key, _ in self.selector.select(0)]
        self.now += cost
        return [one for one in ready if one is not self.own]

    def close(self):
        self.selector.close()
        for near, far in self.pairs:
            near.close()
            far.close()


@pytest.fixture
def work():
    found = Work()
    yield found
    found.close()


def test_what_is_spent_waits_for_the_next_step(work):
    guest = work.pair()
    work.meter.refill(PERIOD)
    assert work.round(cost=2.5 * SHARE * PERIOD) == [guest]
    assert [work.round() for _ in range(3)] == [[], [], []]
    assert work.selector.get_key(guest).data is guest, "it is registered, and held back"
    work.meter.refill(PERIOD)
    assert work.round() == []
    work.meter.refill(PERIOD)
    assert work.round() == [guest]


def test_a_debt_is_paid_in_bounded_time(work):
    guest = work.pair()
    work.meter.refill(PERIOD)
    assert work.round(cost=100.0) == [guest]
    work.round()
    for _ in range(MOST_DEBT):
        assert work.round() == []
        work.meter.refill(PERIOD)
    work.meter.refill(PERIOD)
    assert work.round() == [guest]


def test_few_have_a_turn_at_once_and_all_have_one(work):
    guests = [work.pair() for _ in range(3 * EVENTS_AT_ONCE)]
    rounds = [work.round() for _ in range(3)]
    assert [len(one) for one in rounds] == [EVENTS_AT_ONCE] * 3
    assert {one for turn in rounds for one in turn} == set(guests)


def test_preferred_ones_come_first_but_not_alone(work):
    guests = [work.pair() for _ in range(8)]
    for guest in guests[:5]:
        work.meter.prefer(guest.fileno())
    for _ in range(6):
        turn = work.round()
        assert sum(one in guests[:5] for one in turn) == PREFERRED_AT_ONCE
        assert len(turn) == EVENTS_AT_ONCE


def test_exempt_ones_are_never_held_back_and_cost_nothing(work):
    robot, guest = work.pair(), work.pair()
    work.meter.exempt(robot.fileno())
    work.selector.unregister(guest)
    work.meter.refill(PERIOD)
    for _ in range(5):
        assert work.round(cost=10.0) == [robot]
    assert not work.meter.is_spent, "no metered socket had a turn"
    work.selector.register(guest, READ, guest)
    assert set(work.round(cost=10.0)) == {robot, guest}
    assert work.round() == [robot]
    assert work.meter.is_spent
    work.meter.forget(robot.fileno())
    assert work.round() == []


def test_rounds_that_follow_count_and_budgets_of_others_do_not(work):
    work.pair()
    work.meter.refill(PERIOD)
    work.round()
    work.meter.exclude(5.0)
    work.now += 5.0
    work.round()
    assert not work.meter.is_spent
    (guest,) = (near for near, _ in work.pairs if near is not work.own)
    guest.recv(1)
    for _ in range(ROUNDS - 1):
        work.round(cost=SHARE * PERIOD / ROUNDS / 2)
    work.round(cost=10.0)
    assert not work.meter.is_spent
    work.round()
    assert not work.meter.is_spent, "long after its event"


def test_sockets_change_and_go_while_they_are_held_back(work):
    one, other = work.pair(), work.pair()
    work.round(cost=1.0)
    assert work.round() == []
    late = work.pair()
    assert work.round() == []
    work.selector.modify(one, selectors.EVENT_READ | selectors.EVENT_WRITE, one)
    work.selector.unregister(other)
    with pytest.raises(KeyError, match="already registered"):
        work.selector.register(one, READ)
    for _ in range(MOST_DEBT + 1):
        work.meter.refill(PERIOD)
    found = {key.data: events for key, events in work.selector.select(0)}
    assert found[one] == selectors.EVENT_READ | selectors.EVENT_WRITE
    assert late in found
    assert other not in found


def test_a_port_hands_connections_over_a_few_at_a_time():
    with bound_socket("127.0.0.1", 0) as listener:
        listener.listen()
        listener.setblocking(False)
        clients = [socket.create_connection(listener.getsockname()) for _ in range(5)]
        taken, turns = [], []
        while len(taken) < len(clients):
            before = len(taken)
            while True:
                try:
                    taken.append(listener.accept()[0])
                except BlockingIOError:
                    break
            turns.append(len(taken) - before)
        assert max(turns) == ACCEPTS_AT_ONCE
        for one in (*clients, *taken):
            one.close()


def test_browsers_leave_descriptors_to_robots(monkeypatch):
    monkeypatch.setattr(ports, "most_descriptors", lambda: 0)
    with bound_socket("127.0.0.1", 0) as web, bound_socket("127.0.0.1", 0) as robots:
        keep_reserve(web)
        for listener in (web, robots):
            listener.listen()
            listener.setblocking(False)
        with socket.create_connection(web.getsockname()) as client:
            client.settimeout(10)
            with pytest.raises(BlockingIOError, match="for robots"):
                web.accept()
            assert client.recv(1) == b""
        with socket.create_connection(robots.getsockname()):
            robots.accept()[0].close()


def test_the_reserve_is_a_quarter_at_most(monkeypatch):
    for limit, most in ((1024, 1024 - RESERVE), (256, 192), (resource.RLIM_INFINITY, float("inf"))):
        monkeypatch.setattr(resource, "getrlimit", lambda _, limit=limit: (limit, limit))
        assert most_descriptors() == most


def test_a_loop_has_its_meter():
    async def main():
        meter = loop_meter()
        assert loop_meter() is meter
        near, far = socket.socketpair()
        reader, writer = await asyncio.open_connection(sock=near)
        far.send(b"hello\n")
        assert await reader.readline() == b"hello\n"
        meter.refill(-1.0)  # spends all
        assert meter.is_spent
        far.send(b"again\n")
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.05):
                await reader.readline()
        meter.refill(1.0)
        meter.refill(1.0)
        assert await reader.readline() == b"again\n"
        writer.close()
        far.close()

    run_metered(main())
    assert asyncio.run(_no_meter()) is False


async def _no_meter():
    loop_meter().refill(-1.0)
    return loop_meter().is_spent
