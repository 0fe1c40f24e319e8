"""The server on real sockets: pace, guests that misbehave, and the end.

A world is served from a thread of this process; only the signals need processes of their own. Times that
matter are simulated; wall-clock limits are far above what an idle machine needs.
"""

import contextlib
import gc
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.arenas import FLAT
from tests.handy import known
from tests.server.peers import PATIENCE, Peer, serving, wait_until
from usarmjx.base.errors import UsageError
from usarmjx.cli.app import app
from usarmjx.models.compile.physics import Physics
from usarmjx.models.robots import ROBOTS
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.robot import Mount, options
from usarmjx.server.gamebots.reporter import Reporter
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.gamebots.settings import BotServerSettings
from usarmjx.server.protocol.dialects import UDK
from usarmjx.server.runtime import loop
from usarmjx.server.runtime.loop import GC_THRESHOLD, SWITCH_INTERVAL, low_latency, serve
from usarmjx.server.runtime.signals import StopSignals
from usarmjx.server.worlds.dynamic_world import DynamicWorld

INS_FROM_NOWHERE = Mount(kind="INS", name="Adrift", options=options(Mean=1e30, Sigma=1e30))


@pytest.fixture(scope="module")
def world():
    world = DynamicWorld(FLAT, Physics(), 1, max_robots=16)
    world.prepare(ROBOTS.get("P2AT"))
    return world


@pytest.fixture
def port(world):
    """A server for one test: two at once would step the same world from two threads."""
    with serving(world) as (port, _):
        yield port


@pytest.fixture
def bystander(port):
    """A robot that drives in peace; afterwards its reports must have come in step."""
    peer = Peer(port, "INIT {ClassName USARBot.P2AT} {Name Bystander} {Start S0}")
    peer.sta_times(2)
    yield peer
    peer.sta_times(5)
    np.testing.assert_allclose(np.diff(peer.times), 0.2, atol=0.011)  # two decimals
    peer.close()


def test_greeting_and_reports(port):
    peer = Peer(port)
    assert peer.line() == b"NFO {Gametype BotDeathMatch} {Level flat} {TimeLimit 0}"
    peer.say("INIT {ClassName USARBot.P2AT} {Name R1}")
    np.testing.assert_allclose(np.diff(peer.sta_times(6)), 0.2, atol=0.011)
    peer.close()


def test_half_a_line_and_then_silence(port, bystander):
    rude = Peer(port)
    rude.socket.sendall(b"INIT {ClassName USARB")
    bystander.sta_times(3)
    rude.socket.sendall(b"ot.P2AT} {Start S1}\n")
    assert rude.until(b"STA")
    rude.close()


def test_a_flood_of_junk(port, bystander):
    vandal, random = Peer(port, "INIT {ClassName USARBot.P2AT} {Start S1}"), np.random.default_rng(0)
    vandal.socket.settimeout(0.2)
    lines = b"DRIVE {Left nan}\r\nGETGEO {Type X}\r\n{{{}}}\r\n" * 200
    for _ in range(40):
        with contextlib.suppress(OSError):  # full: the server takes only so much at a time
            vandal.socket.sendall(random.bytes(20_000) + b"\n" + lines)
    assert len(bystander.sta_times(3)) == 3
    vandal.close()


def test_a_flood_of_orders_that_cost_much_does_not_stop_the_world(port, bystander):
    """A client has a turn in each control step; what it asks for beyond that waits."""
    eager = Peer(port, "INIT {ClassName USARBot.P2AT} {Start S1}")
    eager.socket.settimeout(0.2)
    order = b"SET {Type INS} {Name INS} {Opcode POSE} {Params 1,2,3,0,0,0}\r\n"
    with contextlib.suppress(OSError):
        eager.socket.sendall(order * 20_000)
    began = time.monotonic()
    bystander.sta_times(10)
    assert time.monotonic() - began < 20.0, "all the orders together take a minute"
    eager.reset()


def test_one_line_without_an_end(port, bystander):
    vandal = Peer(port)
    vandal.socket.settimeout(0.2)
    for _ in range(100):
        with contextlib.suppress(OSError):
            vandal.socket.sendall(b"x" * 65536)
    bystander.sta_times(2)
    vandal.close()


def test_who_asks_and_never_reads_is_dropped(port, bystander):
    """Its answers would pile up for ever; and a polite close would wait for it for ever."""
    deaf = Peer(port, "INIT {ClassName USARBot.P2AT} {Start S1}", room=4096)
    deaf.until(b"STA")
    deaf.socket.settimeout(1.0)
    deadline = time.monotonic() + PATIENCE
    dropped = False
    while not dropped and time.monotonic() < deadline:
        try:
            deaf.socket.sendall(b"GETGEO {Type Sonar}\r\n" * 500)
        except TimeoutError:
            continue
        except ConnectionError:
            dropped = True
    assert dropped
    assert len(bystander.sta_times(2)) == 2


def test_a_connection_that_breaks_in_the_middle_of_a_line(port, bystander):
    peer = Peer(port, "INIT {ClassName USARBot.P2AT} {Start S1}")
    peer.until(b"STA")
    peer.socket.sendall(b"DRIVE {Left 1")
    peer.reset()
    bystander.sta_times(2)


def test_who_leaves_during_init_leaves_no_robot(port, world, bystander):
    for end in (Peer.close, Peer.reset):
        end(Peer(port, "INIT {ClassName USARBot.P2AT} {Start S2}"))
    bystander.sta_times(3)
    wait_until(lambda: [robot.name for robot in world.robots.values()] == ["Bystander"])


def test_a_sensor_that_cannot_be_told_is_left_out(world, caplog):
    """An ini file that says INS Mean=1e30 makes readings of it that are no numbers."""
    wild = replace(P2AT, name="Wild", sensors=(INS_FROM_NOWHERE, *P2AT.sensors))
    with known(wild), serving(world) as (port, server):
        peer = Peer(port, "INIT {ClassName USARBot.Wild} {Name W}")
        peer.sta_times(1)
        peer.say("DRIVE {Left 1.0} {Right -1.0}")  # at rest it has no error
        for _ in range(1000):
            if server.faults:
                break
            peer.sta_times(1)
        lines = [peer.line().split(b" {")[:3] for _ in range(40)]
        kinds = {part for line in lines for part in line if part.startswith(b"Type ")}
        assert {b"Type Sonar}", b"Type GroundTruth}", b"Type INS}"} <= kinds, "the other INS is told"
        peer.sta_times(3)
        assert not any(b"Name Adrift" in part for line in lines for part in line)
        assert server.faults == 1
        peer.close()
    assert "Wild's INS Adrift is not reported: nan cannot be reported" in caplog.text


def test_a_server_speaks_as_it_is_told(world):
    with serving(world, dialect=UDK) as (port, _):
        peer = Peer(port, "INIT {ClassName USARBot.P3AT} {Name R1} {Start S0}")
        assert peer.until(b"SEN {Time").endswith(b"{Type Sonar} {Name F1} {Range 5.0000}")
        assert peer.until(b"ASTA", b"MISSTA").startswith(b"ASTA {Time")
        peer.close()


def test_who_cannot_be_reported_to_is_dropped_and_others_are_not(port, bystander, monkeypatch):
    real = Reporter.report

    def report(self, robot):
        if robot.name == "Doomed":
            raise RuntimeError("no report")
        real(self, robot)

    monkeypatch.setattr(Reporter, "report", report)
    doomed = Peer(port, "INIT {ClassName USARBot.P2AT} {Name Doomed} {Start S1}")
    while doomed.line():
        pass
    bystander.sta_times(3)


def test_a_disconnected_robot_is_gone_and_its_seat_is_free(port, world, bystander):
    for _ in range(3):
        peer = Peer(port, "INIT {ClassName USARBot.P2AT} {Start S1} {Name Guest}")
        peer.until(b"STA")
        assert {robot.name for robot in world.robots.values()} == {"Bystander", "Guest"}
        peer.close()
        wait_until(lambda: {robot.name for robot in world.robots.values()} == {"Bystander"})


def test_two_robots_hear_each_other(port):
    first = Peer(port, "INIT {ClassName USARBot.P2AT} {Location 0,0,-0.3}")
    assert first.ahead() == 5.0, "nothing there"
    second = Peer(port, "INIT {ClassName USARBot.P2AT} {Location 1,0,-0.3} {Rotation 0,0,3.1416}")
    assert second.ahead() < 1.0
    first.sta_times(1)
    assert first.ahead() < 1.0
    first.close()
    second.close()


def test_a_newcomer_does_not_hold_up_the_others(port, bystander, record_property):
    """The class is prepared, so that all it costs is a new MuJoCo model: tens of milliseconds when idle."""
    stop, arrivals = threading.Event(), []

    def watch():
        while not stop.is_set():
            bystander.until(b"STA")
            arrivals.append(time.monotonic())

    thread = threading.Thread(target=watch)
    thread.start()
    for i in range(1, 4):
        newcomer = Peer(port, f"INIT {{ClassName USARBot.P2AT}} {{Start S{i}}}")
        newcomer.until(b"STA")
        newcomer.close()
    stop.set()
    thread.join(PATIENCE)
    gap = np.diff(arrivals).max()
    record_property("longest_gap_s", float(gap))
    assert gap < 1.0


def test_a_crowd_at_the_door(world):
    with serving(world) as (port, _):
        guests = [Peer(port) for _ in range(16)]
        assert all(guest.line().startswith(b"NFO") for guest in guests)
        late = Peer(port)
        assert late.line() == b"", "the seventeenth is refused"
        guests.pop().close()
        deadline, greeting = time.monotonic() + PATIENCE, b""
        while not greeting and time.monotonic() < deadline:
            again = Peer(port)
            greeting = again.line()
        assert greeting.startswith(b"NFO"), "somebody left"
        for guest in (*guests, again, late):
            guest.close()


def test_realtime_factor_zero_runs_ahead_of_the_clock(world):
    with serving(world, realtime_factor=0.0) as (port, _):
        peer = Peer(port, "INIT {ClassName USARBot.P2AT} {Start S0}")
        (start,), began = peer.sta_times(1), time.monotonic()
        end = peer.sta_times(40)[-1]
        assert end - start == pytest.approx(8.0, abs=0.02)
        assert end - start > time.monotonic() - began
        peer.close()


def test_realtime_factor_one_keeps_the_clock(world):
    with serving(world, realtime_factor=1.0) as (port, _):
        peer = Peer(port, "INIT {ClassName USARBot.P2AT} {Start S0}")
        peer.sta_times(1)
        (start,), began = peer.sta_times(1), time.monotonic()
        end = peer.sta_times(10)[-1]
        # It may fall behind on a busy machine, but never run ahead by more than it catches up (0.5 s).
        assert end - start < time.monotonic() - began + 0.6
        peer.close()


def test_the_server_hangs_up_when_it_stops(world):
    with serving(world) as (port, _):
        peer = Peer(port, "INIT {ClassName USARBot.P2AT} {Start S0}")
        peer.until(b"STA")
    while line := peer.line():
        assert line
    assert not world.robots


def test_a_taken_port_is_one_clear_line_and_exit_code_2(world, monkeypatch):
    monkeypatch.setattr("usarmjx.server.worlds.make.make_worlds", lambda *args, **kwargs: [world])
    with socket.create_server(("127.0.0.1", 0)) as taken:
        number = taken.getsockname()[1]
        result = CliRunner().invoke(app, ["serve", "--port", str(number)])
    assert result.exit_code == 2
    assert re.fullmatch(rf"usarmjx: cannot listen on 127\.0\.0\.1:{number}: .*\n", result.stderr)


def test_serving_leaves_the_process_as_it_was(world):
    """Also when it cannot begin."""
    before = sys.getswitchinterval(), gc.get_threshold()
    with low_latency():
        assert sys.getswitchinterval() == pytest.approx(SWITCH_INTERVAL)
        assert gc.get_threshold() == (*before[1][:2], GC_THRESHOLD)
        frozen = gc.get_freeze_count()
    assert (sys.getswitchinterval(), gc.get_threshold()) == before
    assert gc.get_freeze_count() < frozen
    with socket.create_server(("127.0.0.1", 0)) as taken, pytest.raises(UsageError):
        serve([BotServer(world, BotServerSettings(port=taken.getsockname()[1]))], 1.0, StopSignals())
    assert (sys.getswitchinterval(), gc.get_threshold()) == before


@pytest.fixture
def asked(world, monkeypatch):
    """What settings `usarmjx serve` with some options would serve with."""
    found = []
    monkeypatch.setattr("usarmjx.server.worlds.make.make_worlds", lambda *args, **kwargs: [world])
    monkeypatch.setattr("usarmjx.server.runtime.loop.serve", lambda servers, *_: found.extend(servers))

    def ask(*options):
        found.clear()
        result = CliRunner().invoke(app, ["serve", "--no-wireless", "--no-images", *options])
        return found[0].settings if found else result.stderr

    return ask


def test_port_3000_and_16_connections_unless_the_ini_or_an_option_says_otherwise(asked, tmp_path):
    """Manual 9.1: the defaults, and BotAPI.ini."""
    assert asked() == BotServerSettings(host="127.0.0.1", port=3000, max_connections=16, init_timeout=60.0)
    ini = tmp_path / "BotAPI.ini"
    ini.write_text("[BotAPI.BotServer]\nListenPort=4711\nMaxConnections=2\n")
    told = asked("--ini", str(ini))
    assert (told.port, told.max_connections) == (4711, 2)
    ini.write_text("[USARBotAPI.BotServer]\nListenPort=4711\nMaxConnections=2\n")  # the later versions'
    told = asked("--ini", str(ini), "--port", "4712", "--init-timeout", "5")
    assert (told.port, told.max_connections, told.init_timeout) == (4712, 2, 5.0)
    later = asked("--dialect", "udk")
    assert (later.dialect, later.max_connections) == (UDK, 64)  # DefaultUSAR.ini of the later versions
    assert asked("--dialect", "udk", "--ini", str(ini)).max_connections == 2
    assert asked("--dialect", "dutch") == "usarmjx: unknown dialect 'dutch'; known: manual, udk\n"
    for line, problem in (
        ("ListenPort=70000", "ListenPort is 70000; expected a whole number from 0 to 65535"),
        ("MaxConnections=0", "MaxConnections is 0; expected a whole number from 1 to 4096"),
        ("Port=3000", r"[BotAPI.BotServer] has no key Port; expected ListenPort or MaxConnections"),
    ):
        ini.write_text(f"[BotAPI.BotServer]\n{line}\n")
        assert asked("--ini", str(ini)) == f"usarmjx: {ini}:2: {problem}\n"


def test_so_many_may_come_as_the_server_is_told(world):
    with serving(world, max_connections=2) as (port, _):
        first, second, third = (Peer(port) for _ in range(3))
        assert first.line().startswith(b"NFO")
        assert second.line().startswith(b"NFO")
        assert third.line() == b""
        for guest in (first, second, third):
            guest.close()


@pytest.fixture(scope="module")
def processes(tmp_path_factory):
    """Two servers of their own, started together: (process, port) by the signal that will end each."""
    cache = str(tmp_path_factory.mktemp("cache"))
    command = [sys.executable, "-m", "usarmjx", "serve", "--port", "0", "--engine", "c"]
    command += ["--no-wireless", "--no-images", "--no-view"]
    running = {
        number: subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "XDG_CACHE_HOME": cache, "JAX_PLATFORMS": "cpu"},
        )
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    yield running
    for process in running.values():
        if process.poll() is None:
            process.kill()
        process.communicate()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_it_with_an_account_and_exit_code_0(processes, number):
    process = processes[number]
    first = process.stdout.readline()
    port = int(re.fullmatch(r"usarmjx: listening on 127\.0\.0\.1:(\d+)\n", first)[1])
    assert port > 0
    peer = Peer(port)
    assert peer.line().startswith(b"NFO")
    process.send_signal(number)
    out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, err
    assert re.fullmatch(
        r"usarmjx: stopped after [\d.]+ simulated s; real-time factor [\d.]+, busy \d+ % of the time\n", out
    )
    assert "Traceback" not in err
    peer.close()


@pytest.mark.parametrize(("cost", "interval"), [(0.002, 10.0), (0.03, 30.0), (1.0, 60.0)])
def test_old_objects_are_collected_in_a_thousandth_of_the_time_where_that_is_put_off(
    monkeypatch, cost, interval
):
    collected = []
    monkeypatch.setattr(loop.gc, "collect", lambda: collected.append(True))
    monkeypatch.setattr(loop.time, "thread_time", lambda: cost * len(collected))
    serving = loop.ServerLoop([], 1.0)
    serving._clean(1e9)
    serving._clean_at = 60.0
    serving._clean(100.0)
    assert collected == [], "Python does so by itself"
    with low_latency():
        for now in (59.9, 60.0, 60.1, 59.9 + interval, 60.1 + interval):
            serving._clean(now)
    assert len(collected) == 2
