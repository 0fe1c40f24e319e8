"""Several worlds in one loop, and who may keep a seat in one: on real sockets, in worlds that stand still."""

import asyncio
import contextlib
import re
import threading
import time

import numpy as np
import pytest

from tests.server.peers import PATIENCE, Peer, looping, serving, wait_until
from tests.server.still_world import StillWorld, init
from usarmjx.base.errors import SpecError
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.gamebots.settings import BotServerSettings
from usarmjx.server.runtime.loop import ServerLoop

CLOCK_ATOL = 0.011  # s: reports tell the time with two decimals
TIMEOUT = 0.5  # s: a stated time after which a silent client goes
SLACK = 10.0  # s: what the machine may be late


def servers_of(*worlds, **settings):
    return [
        BotServer(world, BotServerSettings(port=0, **settings), title=f"world {number}")
        for number, world in enumerate(worlds)
    ]


def names(world):
    return sorted(robot.name for robot in world.robots.values())


def wait_for_end(peer):
    """Read until the server hangs up; return how long that took [s]."""
    began = time.monotonic()
    while peer.line():
        pass
    return time.monotonic() - began


# Several worlds


def test_each_world_has_its_own_port_clients_and_clock():
    worlds = StillWorld(), StillWorld(), StillWorld()
    servers = servers_of(*worlds)
    with looping(servers):
        assert len({server.port for server in servers}) == 3
        first, third = Peer(servers[0].port, init("R1")), Peer(servers[2].port, init("R1"))
        np.testing.assert_allclose(np.diff(first.sta_times(6)), 0.2, atol=CLOCK_ATOL)
        np.testing.assert_allclose(np.diff(third.sta_times(6)), 0.2, atol=CLOCK_ATOL)
        assert [names(world) for world in worlds] == [["R1"], [], ["R1"]]
        first.close()
        wait_until(lambda: [names(world) for world in worlds] == [[], [], ["R1"]])
        third.close()
    steps = [round(world.time / world.period) for world in worlds]
    assert max(steps) - min(steps) <= 1, "one clock"


def test_a_full_world_does_not_fill_another():
    worlds = StillWorld(max_robots=1), StillWorld(max_robots=1)
    servers = servers_of(*worlds, max_connections=1)
    with looping(servers):
        here, there = Peer(servers[0].port, init("R1")), Peer(servers[1].port, init("R1"))
        here.sta_times(1)
        there.sta_times(1)
        assert Peer(servers[0].port).line() == b"", "the second is refused"
        here.close()
        there.close()


def test_a_line_tells_where_each_world_is(capfd):
    servers = servers_of(StillWorld(), StillWorld())
    with looping(servers):
        lines = capfd.readouterr().out.splitlines()
    expected = [
        f"usarmjx: world {i}: listening on 127.0.0.1:{server.port}" for i, server in enumerate(servers)
    ]
    assert lines == expected


def test_a_single_world_needs_no_name(capfd):
    with serving(StillWorld()) as (port, _):
        assert capfd.readouterr().out == f"usarmjx: listening on 127.0.0.1:{port}\n"


def test_the_log_names_the_world(caplog):
    servers = servers_of(StillWorld(), StillWorld(max_robots=0))
    with looping(servers):
        peer = Peer(servers[1].port, init("R1"))
        peer.line()
        peer.say("GETSTARTPOSES")
        peer.until(b"NFO {StartPoses")
        peer.close()
    assert re.search(r"world 1, 127\.0\.0\.1:\d+: INIT refused", caplog.text)


def test_as_fast_as_it_can_holds_for_all_worlds():
    worlds = StillWorld(), StillWorld()
    with looping(servers_of(*worlds), realtime_factor=0.0):
        deadline = time.monotonic() + PATIENCE
        began = [world.time for world in worlds], time.monotonic()
        while min(world.time for world in worlds) < 60.0 and time.monotonic() < deadline:
            time.sleep(0.01)
        passed = time.monotonic() - began[1]
    assert min(world.time for world in worlds) - max(began[0]) > 2 * passed


def test_serving_ends_when_the_time_limit_of_the_greeting_is_up(capfd):
    """Manual 5.1: TimeLimit is in minutes; a client hears of it, and of the end by the connection's."""
    world = StillWorld()
    world.step()  # a world that is older than the serving of it
    (server,) = servers_of(world, time_limit=1)

    async def main():
        loop = ServerLoop([server], clock=0.0)
        running = asyncio.create_task(loop.run())
        while not loop.listening:
            await asyncio.sleep(0)
        reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
        told = await reader.read()
        writer.close()
        await running
        return told

    assert asyncio.run(main()).startswith(b"NFO {Gametype BotDeathMatch} {Level flat} {TimeLimit 1}")
    assert world.time == pytest.approx(60.0 + world.period)
    assert "stopped after 60.0 simulated s" in capfd.readouterr().out


def test_a_world_that_lags_says_so_once(caplog):
    world = StillWorld()
    world.on_step = lambda: time.sleep(2.5 * world.period)
    with serving(world, realtime_factor=1.0) as (port, _):
        peer = Peer(port, init())
        peer.sta_times(8)  # 1.6 s of its time, 4 s of ours
        peer.close()
    lines = [record.getMessage() for record in caplog.records if "behind the clock" in record.getMessage()]
    assert len(lines) == 2
    assert re.match(r"[\d.]+ s behind the clock", lines[0])
    lost = float(re.match(r"no longer behind the clock: ([\d.]+) s lost", lines[1])[1])
    assert lost > 1.0, "of 4 s or more three fifths, less what may be caught up"


# Who may keep a seat


def test_who_asks_for_no_robot_makes_room(caplog):
    with serving(StillWorld(), max_connections=1, init_timeout=TIMEOUT) as (port, _):
        silent = Peer(port)
        assert silent.line().startswith(b"NFO")
        assert TIMEOUT * 0.5 < wait_for_end(silent) < TIMEOUT + SLACK
        guest = Peer(port, init())
        assert guest.until(b"STA")
        guest.close()
    assert "no INIT for 0.5 s: its connection is closed" in caplog.text


def test_who_has_a_robot_may_be_silent():
    with serving(StillWorld(), init_timeout=TIMEOUT) as (port, _):
        peer = Peer(port, init())
        assert len(peer.sta_times(10)) == 10  # 2 s
        peer.close()


def test_junk_is_no_sign_of_life_but_questions_are():
    """A base station may ask for the start poses and wait until somebody chooses one."""
    with serving(StillWorld(), init_timeout=TIMEOUT) as (port, _):
        vandal, asker = Peer(port), Peer(port)
        stop, gone = threading.Event(), threading.Event()

        def chatter():
            with contextlib.suppress(OSError):
                while not stop.wait(TIMEOUT / 5):
                    asker.say("GETSTARTPOSES")
                    if not gone.is_set():
                        vandal.say("DRIVE {Left 1}\r\nHELLO\r\n")

        thread = threading.Thread(target=chatter)
        thread.start()
        try:
            wait_for_end(vandal)
            gone.set()
            time.sleep(2 * TIMEOUT)
            asker.say(init())
            assert asker.until(b"STA")
        finally:
            stop.set()
            thread.join(PATIENCE)
        asker.close()


def test_nobody_has_to_go_without_a_timeout():
    with serving(StillWorld(), init_timeout=0.0) as (port, _):
        peer = Peer(port)
        time.sleep(2 * TIMEOUT)
        peer.say(init())
        assert peer.until(b"STA")
        peer.close()


def test_who_was_refused_may_try_again_and_else_makes_room():
    world = StillWorld(max_robots=1)
    with serving(world, init_timeout=TIMEOUT) as (port, _):
        first, second, third = Peer(port, init("R1")), Peer(port), Peer(port)
        first.sta_times(1)
        second.say(init("R2"))  # the world is full
        third.say(init(ClassName="USARBot.Dalek"))
        third.say("GETSTARTPOSES")
        third.until(b"NFO {StartPoses")
        first.close()
        while names(world) == ["R1"]:
            time.sleep(0.01)
        second.say(init("R2"))
        assert second.until(b"STA")
        assert names(world) == ["R2"]
        wait_for_end(third)
        second.close()


def test_who_waits_for_the_answer_to_init_stays():
    """Some classes take their time."""
    world = StillWorld()
    world.prepare = lambda robot: time.sleep(3 * TIMEOUT)
    with serving(world, init_timeout=TIMEOUT) as (port, _):
        peer = Peer(port, init())
        assert peer.until(b"STA")
        peer.close()


def test_a_class_that_cannot_be_prepared_is_refused(caplog):
    world = StillWorld()

    def prepare(robot):
        world.prepare = lambda robot: None
        raise SpecError("its camera sees nothing")

    world.prepare = prepare
    with serving(world) as (port, _):
        peer = Peer(port, init("First"))
        peer.say(init("Second"))
        assert peer.until(b"STA")
        assert names(world) == ["Second"]
        peer.close()
    assert "INIT refused: its camera sees nothing" in caplog.text
