"""Attacks on a server beside a well-behaved neighbour, who must not notice: in numbers, per attack.

What counts is the processor time of the server's thread between two of the neighbour's reports: with more
than 0.2 s of it the world is slower than the clock even on an idle machine.
"""

import json
import logging
import math
import os
import socket
import threading
import time
from dataclasses import replace

import pytest
from typer.testing import CliRunner

from benchmarks.chaos.attacks import ATTACKS, UPGRADE, find_attack
from benchmarks.chaos.neighbour import Gaps, Neighbour, Report, Watch
from benchmarks.chaos.play import (
    ChaosCase,
    Damage,
    Outcome,
    carry_out,
    has_seats,
    play_attack,
    play_attacks,
    table,
)
from benchmarks.chaos.soak import read_metrics
from benchmarks.chaos.target import (
    ThreadClock,
    check_loopback,
    find_process,
    local_process,
    main_thread_clock,
    parse_host_port,
    started,
)
from benchmarks.serving.clients import Crowd
from tests.arenas import FLAT
from tests.server.peers import Peer, looping, serving
from tests.server.still_world import StillWorld
from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.cli.app import app
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.gamebots.settings import BotServerSettings
from usarmjx.server.network.ports import bound_socket
from usarmjx.server.pictures.image_server import ImageServer, ImageSettings
from usarmjx.server.protocol.grammar import DEFAULT_LIMIT
from usarmjx.server.rosbridge.net import RosbridgeServer, RosSettings
from usarmjx.server.runtime.loop import low_latency
from usarmjx.server.runtime.metrics import MetricsServer
from usarmjx.server.viewing.served_source import ServedSource
from usarmjx.server.viewing.viewer_service import ViewerService, ViewerSettings
from usarmjx.server.worlds.dynamic_world import DynamicWorld

MOST = 0.25
"""What the server's thread may use between two reports [s]."""
MAX_FAULTS = 400
"""Who errs so often in a row is dropped: eight refused INITs, which take a few seconds."""
LIMIT = 20.0
"""What takes longer does not come any more [s]."""
SHORT = {"attackers": 4, "seconds": 0.5, "volume": 300_000, "settling": 0.3, "limit": LIMIT}
PAGE_VOLUME = 20_000
"""A page's messages are read one per control step, so that many of them keep a page open for long [bytes]."""


class House:
    """A server in a thread of this process, and the neighbour in another."""

    def __init__(self, world, server, watch, **ports):
        self.world, self.server, self.watch = world, server, watch
        self.case = ChaosCase(host="127.0.0.1", port=server.port, attacks=ATTACKS, **ports, **SHORT)

    def is_empty(self):
        """Whether nobody but the neighbour is there, at the latest after a while."""
        end = time.monotonic() + LIMIT
        while time.monotonic() < end:
            if len(self.server.clients) == 1 and [r.name for r in self.world.robots.values()] == [
                "Neighbour"
            ]:
                return True
            time.sleep(0.02)
        return False


@pytest.fixture(scope="module")
def house():
    world = DynamicWorld(FLAT, seed=1, max_robots=16)
    page = ViewerService(ServedSource([world]), ViewerSettings())
    ros, pictures = RosbridgeServer(world, RosSettings(port=0)), ImageServer(world, ImageSettings(port=0))
    server = BotServer(world, BotServerSettings(port=0, max_faults=MAX_FAULTS), [page, ros, pictures])
    bound = bound_socket("127.0.0.1", 0)
    metrics_port, ros.server = bound.getsockname()[1], server
    server.services.append(MetricsServer([server], 1.0, bound))
    before = set(threading.enumerate())
    # As `serve` does: else this thread looks for garbage among all that the tests before have left behind.
    with low_latency(), looping([server], 1.0):
        (loop,) = (thread for thread in threading.enumerate() if thread not in before)
        clock = ThreadClock(os.getpid(), loop.native_id)
        ports = {"rosbridge_port": ros.port, "metrics_port": metrics_port, "image_port": pictures.port}
        with Watch(server.port, "127.0.0.1", clock, LIMIT) as watch:
            yield House(world, server, watch, page_port=page.port, **ports)


@pytest.mark.alone
@pytest.mark.every_run("junk", "reset-storm", "segments", "page", "ros-json", "ros-storm", "silent")
@pytest.mark.parametrize("attack", ATTACKS, ids=lambda attack: attack.name)
def test_a_neighbour_does_not_notice(house, attack, caplog, record_property):
    case = replace(house.case, volume=PAGE_VOLUME) if attack.door == "page" else house.case
    with caplog.at_level(logging.WARNING):
        outcome = play_attack(case, attack, house.watch)
        assert house.is_empty()
    record_property("gaps", str(outcome.gaps))
    assert outcome.gaps is not None, outcome.trouble
    assert outcome.gaps.reports >= 2
    assert outcome.gaps.processor <= MOST
    assert (outcome.gaps.irregular, outcome.gaps.bad_lines) == (0, 0)
    assert outcome.seats
    assert outcome.damage.connections >= case.attackers
    assert not [record for record in caplog.records if record.exc_info], "a traceback"
    if attack.name == "http":
        assert outcome.damage.hung_up >= case.attackers, "whoever speaks HTTP is hung up on"


@pytest.mark.alone
def test_a_newcomer_gets_in_while_others_join_and_leave(house):
    """Who has left before its robot came holds no seat."""
    storm = threading.Thread(
        target=carry_out, args=(find_attack("init-storm"), ("127.0.0.1", house.case.port), 6, 1.5, 10_000)
    )
    storm.start()
    time.sleep(0.7)
    newcomer = Peer(house.case.port, "INIT {ClassName USARBot.P2AT}")
    assert newcomer.until(b"STA")
    newcomer.close()
    storm.join()
    assert house.is_empty()


# That it would see what there is to see


class SlowWorld(StillWorld):
    """Uses processor time in one of its steps, when it is told to."""

    def __init__(self):
        super().__init__()
        self.burn = 0.0
        self.on_step = self._work

    def _work(self):
        burn, self.burn = self.burn, 0.0
        end = time.thread_time() + burn
        while time.thread_time() < end:
            pass


@pytest.mark.alone
def test_processor_time_and_waits_are_seen(monkeypatch):
    monkeypatch.setattr("benchmarks.chaos.neighbour.CLASS", "ComStation")
    world, before = SlowWorld(), set(threading.enumerate())
    with serving(world, realtime_factor=1.0) as (port, _):
        (loop,) = (thread for thread in threading.enumerate() if thread not in before)
        with Watch(port, "127.0.0.1", ThreadClock(os.getpid(), loop.native_id), LIMIT) as watch:

            def stall():
                world.burn = 0.6
                time.sleep(0.3)

            gaps = watch.during(stall)
            assert 0.55 <= gaps.processor < 0.55 + MOST
            assert gaps.gap >= 0.55
            assert (gaps.irregular, gaps.bad_lines) == (0, 0)
            assert watch.during(lambda: time.sleep(0.3)).processor < 0.3


def talk(lines):
    """Let a neighbour read these; return it."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        neighbour = Neighbour(listener.getsockname()[1], "127.0.0.1", lambda: 0.0)
        neighbour.take("".join(f"{line}\r\n" for line in lines).encode("latin-1"), 1.0)
        neighbour.socket.close()
    return neighbour


STA = "STA {{Type GroundVehicle}} {{Time {:.2f}}} {{LightToggle False}} {{LightIntensity 0}} {{Battery 1200}}"


def test_bad_lines_and_irregular_reports_are_counted():
    good = [STA.format(0.2), STA.format(0.4), "SEN {Time 0.4} {Type Sonar} {Name F1 Range 1.0}"]
    assert talk(good).bad_lines == 0
    bad = ["}{", "SEN {Type Sonar} {Name F1 Range nan}", "SEN  {Type", ""]
    assert talk([*good, *bad]).bad_lines == len(bad)
    neighbour = talk([])
    neighbour.history = [Report(t, t, 0.0) for t in (0.2, 0.4, 0.7, 0.9)]
    gaps = neighbour.gaps(neighbour.history[0], neighbour.history[-1], 0)
    assert (gaps.reports, gaps.irregular) == (3, 1)
    assert gaps.gap == pytest.approx(0.3)


def test_a_neighbour_who_is_dropped_is_told_of_and_another_one_comes(monkeypatch):
    monkeypatch.setattr("benchmarks.chaos.neighbour.CLASS", "ComStation")
    attacks = tuple(find_attack(name) for name in ("silent", "reset-storm"))
    with serving(StillWorld(), realtime_factor=1.0) as (port, server):
        drops = iter([server])

        def say(text):
            if text.startswith("silent"):  # the neighbour has joined by then
                for connection in list(next(drops)._connections.values()):
                    server_loop(connection).call_soon_threadsafe(connection.writer.transport.abort)

        case = ChaosCase(host="127.0.0.1", port=port, attacks=attacks, **{**SHORT, "attackers": 2})
        outcomes = play_attacks(case, None, say)
    assert [outcome.attack for outcome in outcomes] == ["quiet", "silent", "reset-storm"]
    assert [outcome.gaps is None for outcome in outcomes] == [False, True, False]
    assert "closed" in outcomes[1].trouble
    assert outcomes[1].trouble in table(outcomes)
    assert math.isnan(outcomes[2].gaps.processor)
    assert outcomes[2].as_record()["processor"] is None


def server_loop(connection):
    return connection.writer.transport._loop


def test_seats_that_are_held_are_missed():
    with serving(StillWorld(), realtime_factor=1.0, max_connections=3) as (port, _):
        case = ChaosCase(host="127.0.0.1", port=port, attacks=(), **{**SHORT, "limit": 0.5})
        assert has_seats(case, 3)
        guest = Peer(port)
        guest.line()
        assert has_seats(case, 2)
        assert not has_seats(case, 3)
        guest.close()


def test_attackers_keep_their_bounds():
    with serving(StillWorld(), realtime_factor=1.0) as (port, server):
        damage = carry_out(find_attack("giant"), ("127.0.0.1", port), 2, 0.4, 10_000)
        assert damage.connections == 2
        # Each ends the chunk at hand, of which it sends as much as there is room for.
        assert 20_000 <= damage.sent <= 2 * (10_000 + 65_536)
        storm = carry_out(find_attack("connect-storm"), ("127.0.0.1", port), 2, 0.4, 10_000)
        assert storm.connections > 4
        assert storm.sent == 0
        assert server.counts.connections >= 4
    refused = carry_out(find_attack("silent"), ("127.0.0.1", port), 1, 0.1, 0)
    assert refused == Damage(refused=refused.refused)
    assert refused.refused >= 1


def test_long_lines_are_just_short_enough():
    for name in ("vector", "segments", "trace"):
        longest = max(find_attack(name).load.split(b"\r\n"), key=len)
        assert DEFAULT_LIMIT - 1200 < len(longest) <= DEFAULT_LIMIT, name
    with pytest.raises(UnknownNameError, match="unknown attack 'nuke'; known: junk, giant"):
        find_attack("nuke")


def test_the_page_is_reached(house):
    with socket.create_connection(("127.0.0.1", house.case.page_port), LIMIT) as page:
        page.sendall(UPGRADE)
        assert page.recv(100).startswith(b"HTTP/1.1 101 ")


# Whom it attacks


def test_the_process_that_listens_is_found():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        assert find_process(port) == local_process(port) == os.getpid()
    assert local_process(port) is None
    with pytest.raises(UsageError, match=f"listens at port {port}: name it with --pid"):
        find_process(port)


def test_processor_time_is_of_one_thread():
    clock = ThreadClock(os.getpid(), threading.get_native_id())
    before, began = clock(), time.thread_time()
    while time.thread_time() < began + 0.1:
        pass
    assert clock() - before == pytest.approx(time.thread_time() - began, abs=0.02)
    with pytest.raises(UsageError, match="does not tell the processor time"):
        ThreadClock(2**22 + 1)
    said = []
    assert main_thread_clock(2**22 + 1, said.append) is None
    assert "does not tell the processor time" in said[0]


def test_only_loopback_unless_it_is_said():
    check_loopback("127.0.0.1")
    check_loopback("localhost")
    for host in ("192.0.2.1", "8.8.8.8"):
        with pytest.raises(UsageError, match="not this machine's loopback: --own-server"):
            check_loopback(host)
    assert parse_host_port("127.0.0.1:3000") == ("127.0.0.1", 3000)
    for text in ("3000", "localhost", "localhost:0", "localhost:70000", ":3000"):
        with pytest.raises(UsageError, match="not of the form HOST:PORT"):
            parse_host_port(text)


def test_the_command(monkeypatch, tmp_path):
    monkeypatch.setattr("benchmarks.chaos.neighbour.CLASS", "ComStation")
    file = tmp_path / "chaos.jsonl"
    with serving(StillWorld(), realtime_factor=1.0) as (port, _):
        words = ["--attack", "giant", "--attackers", "2", "--seconds", "0.3", "--volume", "0.1"]
        ran = CliRunner().invoke(app, ["chaos", f"127.0.0.1:{port}", *words, "--json", str(file)])
    assert ran.exit_code == 0, ran.output
    rows = [line.split("|") for line in ran.stdout.splitlines()]
    assert [row[1].strip() for row in rows] == ["attack", "---", "quiet", "giant"]
    records = [json.loads(line) for line in file.read_text().splitlines()]
    assert [record["attack"] for record in records] == ["quiet", "giant"]
    assert records[1]["connections"] == 2
    assert records[1]["processor"] is not None, "the process is found by its port"
    for wrong, reason in ((["x"], "HOST:PORT"), ([], "or --self"), (["8.8.8.8:1"], "--own-server")):
        ran = CliRunner().invoke(app, ["chaos", *wrong])
        assert (ran.exit_code, ran.stderr.count("\n")) == (2, 1)
        assert reason in ran.stderr


def test_an_outcome_says_what_was_lost():
    gaps = Gaps(reports=9, gap=0.25, processor=0.1, irregular=1, bad_lines=2)
    row = Outcome("junk", gaps, Damage(sent=2_000_000, connections=3, hung_up=1), seats=False).as_row()
    assert row == ["junk", "0.25", "0.100", "1", "2", "2.0", "3", "1", "LOST"]


def test_a_crowd_can_be_told_who_was_hung_up_on():
    lost = []
    listener = socket.create_server(("127.0.0.1", 0))
    with listener, Crowd(listener.getsockname()[1], lost.append) as crowd:
        client = crowd.robot()
        listener.accept()[0].close()
        crowd.wait(lambda: bool(lost), LIMIT)
    assert lost == [client]


def test_a_server_is_started_for_it_with_a_page_and_figures():
    with started("field", 4) as target:
        assert find_process(target.port) == target.process
        figures = read_metrics(target)
        assert figures["clients"] == figures["robots"] == 0
        assert figures["memory_bytes"] > 5e7
        with socket.create_connection((target.host, target.page_port), LIMIT) as page:
            page.sendall(UPGRADE)
            assert page.recv(100).startswith(b"HTTP/1.1 101 ")
    assert local_process(target.port) is None
