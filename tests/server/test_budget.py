"""What clients may cost: budgets on a clock of their own, and on sockets what comes of floods."""

import asyncio
import contextlib
import logging
import math
import socket
import time

import numpy as np
import pytest

from tests.server.peers import PATIENCE, Peer, serving, wait_until
from tests.server.still_world import StillWorld, init
from usarmjx.base.errors import PeerError
from usarmjx.server.gamebots import adapter
from usarmjx.server.gamebots.budget import (
    BURST,
    CLIENT_SHARE,
    INIT_COST,
    JOIN_SHARE,
    SHARE_BESIDE_JOINS,
    TOTAL_SHARE,
    BudgetPool,
    ClientBudget,
)
from usarmjx.server.gamebots.server import MOST_STEPS_AFTER_LEAVING, READ_SIZE
from usarmjx.server.protocol.commands import GetConf, GetStartPoses, Init, Trace
from usarmjx.server.protocol.session import REFUSAL_FAULTS
from usarmjx.server.runtime.logs import INTERVAL, MAX_LINES, FaultLog, summary

PERIOD, MS = 0.02, 1e-3  # s
GROWTH = CLIENT_SHARE * PERIOD
ROUNDING = 1e-9
PACE = 20.0
"""Times real time."""


class Work:
    """Clients whose turns cost what they say, on a clock of their own."""

    def __init__(self):
        self.now = 0.0
        self.pool = BudgetPool(PERIOD, clock=lambda: self.now)

    async def turns(self, budget, cost, count, done):
        """Have turns; note in which control step each was."""
        for _ in range(count):
            async with budget:
                self.now += cost
            done.append(self.pool.steps)

    def begin(self, cost, count, budget=None):
        """Let a client have turns in the background; return its task and what it notes."""
        done = []
        turns = self.turns(budget or ClientBudget(self.pool), cost, count, done)
        return asyncio.create_task(turns), done

    async def step(self, count=1):
        """Make control steps; in each all clients go on until nobody can."""
        for _ in range(count):
            self.pool.refill()
            await settle()


async def settle():
    for _ in range(100):
        await asyncio.sleep(0)


def test_floods_share_what_there_is_and_who_asks_for_little_is_first():
    async def main():
        work, steps = Work(), 100
        floods = [work.begin(2 * MS, 10**6) for _ in range(15)]
        modest, answered = ClientBudget(work.pool), []
        await work.step(20)
        for _ in range(steps - 20):
            task, done = work.begin(0.1 * MS, 2, modest)
            await settle()
            assert not done, "all have taken what there was in this step"
            await work.step()
            assert task.done()
            answered += done
        costs = [2 * MS * len(done) for _, done in floods]
        everybody = sum(costs) + 0.1 * MS * len(answered)
        assert TOTAL_SHARE * PERIOD * (steps - 5) <= everybody <= TOTAL_SHARE * PERIOD * (steps + 1) + 2 * MS
        assert max(costs) <= BURST + GROWTH * steps + 2 * MS + ROUNDING
        for task, _ in floods:
            task.cancel()

    asyncio.run(main())


def test_turns_and_joins_together_leave_the_world_its_time():
    """Ten control steps, between two reports, in which all that may join joins, and floods take the rest."""

    async def main():
        work, join_cost, window = Work(), 20 * MS, 10
        joins = BudgetPool(PERIOD, JOIN_SHARE, clock=lambda: work.now)
        work.pool = BudgetPool(PERIOD, clock=lambda: work.now, joins=joins)
        floods = [work.begin(0.5 * MS, 10**6)[0] for _ in range(15)]
        spent = []
        for _ in range(200):
            began = work.now
            await work.step()
            joins.refill()
            if not joins.is_spent:
                with joins.spending():
                    work.now += join_cost
            spent.append(work.now - began)
        most = max(sum(spent[i : i + window]) for i in range(20, len(spent) - window))
        assert most <= (JOIN_SHARE + SHARE_BESIDE_JOINS) * PERIOD * window + join_cost + 5 * MS
        assert most < 80 * MS
        for task in floods:
            task.cancel()

    asyncio.run(main())


def test_nobody_honest_waits():
    """16 robots are driven 50 times a second, one 100 times; one asks sixty things as soon as it is there."""

    async def main():
        work = Work()
        drivers = [ClientBudget(work.pool) for _ in range(16)]
        for _ in range(200):
            await work.step()
            asked = [work.begin(0.22 * MS, 1, driver)[0] for driver in (*drivers, drivers[0])]
            await settle()
            assert all(task.done() for task in asked)
        newcomer = ClientBudget(work.pool)
        newcomer.charge(INIT_COST)
        _, done = work.begin(0.16 * MS, 60, newcomer)
        await work.step(4)
        assert len(done) == 60

    asyncio.run(main())


def test_who_is_in_debt_waits_for_as_many_steps_as_that_takes():
    async def main():
        work = Work()
        _, done = work.begin(BURST + 20.5 * GROWTH, 2)
        await settle()
        await work.step(30)
        assert done == [0, 21]

    asyncio.run(main())


def test_who_goes_while_waiting_does_not_hold_up_the_next():
    async def main():
        work = Work()
        gone, goes, stays = (ClientBudget(work.pool) for _ in range(3))
        work.begin(TOTAL_SHARE * PERIOD, 1)
        await settle()
        assert work.pool.is_spent
        for budget, cost in ((gone, 0.0), (goes, 1 * MS), (stays, 2 * MS)):
            budget.charge(cost)
        (first, _), (second, _), (_, done) = (work.begin(1 * MS, 1, b) for b in (gone, goes, stays))
        await settle()
        goes.dismiss("it has left")
        await settle()
        with pytest.raises(PeerError, match="it has left"):
            second.result()
        work.pool.refill()  # calls the first, which has most left of its budget
        first.cancel()
        await settle()
        assert done == [1]

    asyncio.run(main())


# The log


def test_faults_are_summed_up_and_lines_are_bounded(caplog):
    now = [0.0]
    fault_log = FaultLog(logging.getLogger("usarmjx.test"), lambda: now[0])
    for i in range(1000):
        fault_log.warning("%d: %s", i, "nonsense")
    assert [record.getMessage() for record in caplog.records] == [f"{i}: nonsense" for i in range(MAX_LINES)]
    fault_log.flush()
    assert len(caplog.records) == MAX_LINES
    now[0] += INTERVAL
    fault_log.flush()
    fault_log.warning("again")
    assert [record.getMessage() for record in caplog.records[MAX_LINES:]] == [
        f"{1000 - MAX_LINES} more lines about clients' faults are left out",
        "again",
    ]


@pytest.mark.parametrize(
    ("faults", "count", "line"),
    [
        (["a"], 1, "a"),
        (["a"] * 32, 4712, "a (and 4,711 more like it)"),
        (["a", "b", "a"], 3, "a; b (and 1 more)"),
        (["a", "b", "c", "d"], 100, "a; b; c (and 97 more)"),
    ],
)
def test_many_faults_are_one_line(faults, count, line):
    assert summary(faults, count) == line


# On sockets


class Ticking:
    """A clock on which each turn takes as long."""

    def __init__(self, cost=MS):
        self.now, self.cost = 0.0, cost

    def __call__(self):
        self.now += self.cost
        return self.now


@pytest.fixture
def world():
    return StillWorld()


@contextlib.contextmanager
def ticking(world, **settings):
    """A server on which each turn takes a millisecond: (port, server)."""
    with serving(world, realtime_factor=PACE, **settings) as (port, server):
        server.budgets.clock = Ticking()
        yield port, server


def flood(peers, data, until):
    """Let clients say something without end, and not read, until something is true."""
    deadline = time.monotonic() + PATIENCE
    rests = dict.fromkeys(peers, data)
    for peer in peers:
        peer.socket.setblocking(False)
    while not until():
        assert time.monotonic() < deadline
        for peer in peers:
            with contextlib.suppress(OSError):  # it is full, or was hung up on
                rests[peer] = rests[peer][peer.socket.send(rests[peer]) :] or data
        time.sleep(0.002)


VECTOR = "1," * 4000 + "1"
COSTLY = {
    GetStartPoses: "GETSTARTPOSES\r\n",
    Trace: "Trace {On True} " + "{Interval 1} " * 600 + "\r\n",
    GetConf: "GETCONF {Type " + "x" * 8000 + "}\r\n",
}
"""What costs more to answer than to say."""


@pytest.mark.parametrize("kind", COSTLY, ids=lambda kind: kind.__name__)
def test_every_command_is_paid_for(world, kind):
    with ticking(world) as (port, server):
        peer = Peer(port, init())
        peer.until(b"STA")
        first = world.time

        def is_over():
            # While its join is paid for, a client has less: on a slow machine its first command waits.
            late = world.time > first + 400 * PERIOD
            return late or (world.time > first + 40 * PERIOD and server.counts.commands[kind])

        flood([peer], COSTLY[kind].encode(), is_over)
        done, steps = server.counts.commands[kind], (world.time - first) / PERIOD
        pieces = len(COSTLY[kind]) // READ_SIZE  # each of which is a turn
        assert 1 <= done <= ((BURST + GROWTH * steps) / MS + 1) / (1 + pieces)


LONG = "{Location 1,2,3} " * 450
UNKNOWN = "INIT refused: unknown robot 'Nope'"
ASKED = {
    "INIT {ClassName Nope}": UNKNOWN,
    f"INIT {{ClassName Nope}} {LONG}": UNKNOWN,
    f"INIT {{ClassName Nope}} {{Location {VECTOR}}}": "has 4001 numbers, expected 3",
}


@pytest.mark.parametrize(("asked", "reason"), ASKED.items(), ids=["short", "long", "illegal"])
def test_inits_without_end_are_few_and_leave_one_line(world, caplog, monkeypatch, asked, reason):
    monkeypatch.setattr(adapter, "INTERVAL", math.inf)  # lines: of the first fault, and of all later ones
    with serving(world, realtime_factor=PACE, max_faults=0) as (port, server):
        peers = [Peer(port) for _ in range(5)]
        wait_until(lambda: len(server.clients) == len(peers))
        first = world.time

        def are_refused():
            refusals = [client.session.fault_count for client in server.clients]
            return world.time > first + 60 * PERIOD and min(refusals) >= 3

        flood(peers, (asked + "\r\n").encode() * 10, are_refused)
        for peer in peers:
            peer.reset()
        wait_until(lambda: not server.clients)
        steps = (world.time - first) / PERIOD
        assert server.faults >= 15
        done = server.counts.commands[Init]
        assert done == 0 or reason == UNKNOWN, "what is no legal line is no INIT"
        assert done >= 15 or reason != UNKNOWN
        assert done <= 5 * ((BURST + GROWTH * steps) / INIT_COST + 1)
    logged = [record.getMessage() for record in caplog.records if reason in record.getMessage()]
    assert 5 <= sum("more like it" in line for line in logged) <= len(logged) <= 10
    assert max(map(len, logged)) < 1500


def test_a_newcomer_is_slowed_by_nobody(world):
    """Fifteen join at once, and ask for start poses as fast as they can."""
    with serving(world, realtime_factor=1.0) as (port, _):
        peers = [Peer(port, f"{init(f'R{i}')}\r\n" + "GETSTARTPOSES\r\n" * 5) for i in range(15)]
        for peer in peers:
            for _ in range(5):
                peer.until(b"NFO {StartPoses")
        wait_until(lambda: len(world.robots) == 15)
        for peer in peers:
            spawned = peer.sta_times(1)[0]
            assert spawned < 2.0, "a control step for each, and a report's time"
            peer.close()


def test_a_crowd_leaves_one_by_one_and_whoever_comes_waits_for_its_seats(monkeypatch):
    """To take sixteen robots out at once would hold the world up for a fifth of a second."""
    world, left = StillWorld(), []
    remove = world.remove
    monkeypatch.setattr(world, "remove", lambda robot: left.append(world.time) or remove(robot))
    with serving(world, realtime_factor=PACE) as (port, server):
        peers = [Peer(port, init(f"R{i}")) for i in range(16)]
        wait_until(lambda: len(world.robots) == 16)
        server._joins.clock = Ticking(5 * MS)  # more than a control step's share
        for peer in peers:
            peer.close()
        wait_until(lambda: not server.clients)
        newcomer = Peer(port, init("Newcomer"))
        newcomer.until(b"STA")
        assert [robot.name for robot in world.robots.values()] == ["Newcomer"]
        newcomer.close()
    assert len(left) == 17
    assert np.diff(left[:16]).min() >= PERIOD - ROUNDING


def test_who_left_while_others_join_keeps_no_connection():
    """However long the one before takes: here as long as the test wants."""
    world = StillWorld()
    with serving(world, realtime_factor=PACE) as (port, server):
        server._joins.spend(1e6)
        first = Peer(port, init("First"))
        wait_until(lambda: server.counts.commands[Init] == 1)
        gone = [Peer(port, init(f"Gone{i}")) for i in range(10)]
        wait_until(lambda: server.counts.commands[Init] == 11)
        for peer in gone:
            peer.close()
        wait_until(lambda: len(server.clients) == 1)
        server._joins.spend(-1e6)
        first.until(b"STA")
        assert [robot.name for robot in world.robots.values()] == ["First"]
        first.close()


def test_who_only_errs_is_dropped_and_a_legal_command_makes_good(world, caplog):
    with serving(world, realtime_factor=PACE, max_faults=REFUSAL_FAULTS + 1) as (port, _):
        peer = Peer(port)
        assert peer.line().startswith(b"NFO")
        for _ in range(5):
            peer.say("nonsense\r\n" * REFUSAL_FAULTS + "GETSTARTPOSES")
            assert peer.line().startswith(b"NFO {StartPoses")
        peer.say("nonsense\r\n" * REFUSAL_FAULTS + "nonsense")
        assert peer.line() == b""
        other = Peer(port, "INIT {ClassName Nope}\r\nGETSTARTPOSES")
        assert other.line().startswith(b"NFO")
        assert other.line().startswith(b"NFO {StartPoses"), "it may try another class"
        other.say("INIT {ClassName Nope}\r\n" * 2)
        assert other.line() == b""
        polite = Peer(port, "nonsense\r\n" * REFUSAL_FAULTS + init() + "\r\n" + "INIT\r\n" * REFUSAL_FAULTS)
        assert polite.sta_times(3)
        polite.close()
    assert caplog.text.count(": dropped: too many faults in a row") == 2


@pytest.mark.parametrize("end", ["half-closed", "reset"])
def test_what_a_client_left_unread_is_not_carried_out(world, end):
    """A thousand turns would take a thousand control steps; ten it has saved up."""
    with ticking(world) as (port, server):
        for count, most in ((10, 10), (1000, BURST / MS + 30)):
            before, peer = server.counts.commands[GetStartPoses], Peer(port)
            peer.line()
            wait_until(lambda: server.clients)
            peer.socket.sendall(b"GETSTARTPOSES\r\n" * count)
            if end == "reset":
                peer.reset()
            else:
                peer.socket.shutdown(socket.SHUT_WR)
            left = world.time
            wait_until(lambda: not server.clients)
            assert world.time < left + 100 * PERIOD
            done = server.counts.commands[GetStartPoses] - before
            assert done <= most
            assert done == count or count > most or end == "reset"
            peer.close()


def test_a_crowd_that_leaves_keeps_its_seats_for_half_a_second(world):
    """Five turns a step for sixteen: none runs out of its own budget, and all would take 640 steps."""
    with ticking(world) as (port, server):
        peers = [Peer(port) for _ in range(16)]
        for peer in peers:
            peer.line()
        wait_until(lambda: len(server.clients) == 16)
        for peer in peers:
            peer.socket.sendall(b"GETSTARTPOSES\r\n" * 200)
            peer.socket.shutdown(socket.SHUT_WR)
        left = world.time
        wait_until(lambda: not server.clients)
        assert world.time < left + (MOST_STEPS_AFTER_LEAVING + 50) * PERIOD
        for peer in peers:
            peer.close()
