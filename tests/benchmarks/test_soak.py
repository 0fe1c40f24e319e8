"""The soak: robots come and go and drive, samples are those of the metrics, and growth is told from noise."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import dev
from benchmarks.chaos import soak as module
from benchmarks.chaos.soak import (
    CLASSES,
    SHOWN,
    TOTALS,
    SoakCase,
    read_metrics,
    sample_times,
    soak,
    summarise,
)
from benchmarks.chaos.target import Target
from tests.scripts import python_path
from tests.server.peers import PATIENCE, looping
from tests.server.still_world import StillWorld
from usarmjx.base.errors import UsageError
from usarmjx.cli.app import app
from usarmjx.models.robots import ROBOTS
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.gamebots.settings import BotServerSettings
from usarmjx.server.network.ports import bound_socket
from usarmjx.server.runtime.metrics import MetricsServer


@pytest.fixture
def served(monkeypatch):
    monkeypatch.setattr(module, "QUESTIONS", ("GETSTARTPOSES", "GETCONF {Type Sonar}"))
    server = BotServer(StillWorld(), BotServerSettings(port=0))
    bound = bound_socket("127.0.0.1", 0)
    server.services.append(MetricsServer([server], 1.0, bound))
    target = Target("127.0.0.1", 0, metrics_port=bound.getsockname()[1])
    with looping([server], 1.0):
        yield server, Target(target.host, server.port, metrics_port=target.metrics_port)


def test_robots_come_drive_and_go(served, monkeypatch, tmp_path):
    monkeypatch.setattr(module, "VISIT", (2.0, 2.5))
    monkeypatch.setattr(module, "OUT", (0.05, 0.1))
    server, target = served
    file = tmp_path / "soak.jsonl"
    result = soak(SoakCase(target=target, seconds=7.0, clients=3, every=2.0), file)
    lines = [json.loads(line) for line in file.read_text().splitlines()]
    *samples, last = lines
    assert last.keys() == result.keys()
    assert [sample["elapsed_s"] for sample in samples] == sorted(sample["elapsed_s"] for sample in samples)
    assert {sample["robots"] for sample in samples} <= {0, 1, 2, 3}
    assert max(sample["robots"] for sample in samples) >= 1
    assert result["visits"] >= 6
    assert result["visits"] >= samples[-1]["visits"]
    assert (result["hung_up"], result["put_back"], result["world_resets"]) == (0, 0, 0)
    assert 0.0 < result["longest_gap_s"] < 10.0
    commands = {command.__name__: count for command, count in server.counts.commands.items()}
    assert commands["Init"] >= 6
    assert commands["DriveRobot"] > 10


def test_who_is_hung_up_on_comes_again(served, monkeypatch):
    server, target = served
    dropped = []

    def say(line):
        if not dropped and json.loads(line)["robots"] == 1:
            (connection,) = server._connections.values()
            connection.writer.transport._loop.call_soon_threadsafe(connection.writer.transport.abort)
            dropped.append(connection)

    result = soak(SoakCase(target=target, seconds=2.5, clients=1, every=0.2), say=say)
    assert dropped
    assert (result["hung_up"], result["visits"]) == (1, 2)


def test_all_classes_can_be_driven():
    assert all("Left" in ROBOTS.get(name).drive.full_scale for name in CLASSES)


def made(memory, count=40):
    """Samples each 30 s with that memory [MB] as a function of time [h]."""
    times = np.arange(count) * 30.0
    rest = dict.fromkeys((*SHOWN, *TOTALS), 1.0) | {"visits": 9, "hung_up": 0, "longest_gap_s": 0.3}
    totals = [{"simulated_s": t, "processor_s": t / 2} for t in times]
    return [
        rest | {"elapsed_s": t, "memory_bytes": 1e6 * memory(t / 3600)} | total
        for t, total in zip(times, totals, strict=True)
    ]


def test_growth_is_told_from_noise():
    noise = np.random.default_rng(0)
    growing = summarise(made(lambda hours: 250 + 12 * hours + noise.normal(0, 0.1)))["memory_MB_per_hour"]
    assert growing["low"] < 12 < growing["high"]
    assert growing["low"] > 6
    flat = summarise(made(lambda hours: 250 + noise.normal(0, 0.1)))["memory_MB_per_hour"]
    assert flat["low"] < 0 < flat["high"]
    start = summarise(made(lambda hours: 250 if hours > 0.05 else 100))
    assert start["memory_MB_per_hour"]["median"] == 0.0, "the beginning does not count"
    assert start["memory_MB"] == {"first": 100.0, "settled": 250.0, "last": 250.0, "most": 250.0}
    assert start["cpu_per_simulated_s"] == pytest.approx(0.5)
    with pytest.raises(UsageError, match="2 samples are too few"):
        summarise(made(lambda hours: 1, 2))


def test_samples_do_not_beat_with_what_a_server_does_at_regular_times():
    """One in each interval; samples each 30 s saw two phases only of a collection each minute."""
    times = np.array(sample_times(3600.0, 30.0))
    assert times[0] == 0.0
    assert np.array_equal(times[1:] // 30.0, np.arange(1, 120))
    counts = np.bincount((times[1:] % 60.0 // 10.0).astype(int), minlength=6)
    assert counts.min() >= 10  # of 119 samples, 20 in each sixth of a minute if the phases are even
    assert sample_times(90.0, 30.0, seed=4) == sample_times(90.0, 30.0, seed=4) != sample_times(90.0, 30.0)


def test_a_server_without_metrics_is_refused():
    with pytest.raises(UsageError, match="start it with --metrics-port"):
        read_metrics(Target("127.0.0.1", 1))
    with pytest.raises(UsageError, match="/metrics: "):
        read_metrics(Target("127.0.0.1", 1, metrics_port=1))


def test_the_command(served):
    server, target = served
    words = ["--soak", "1.5", "--clients", "1", "--every", "0.3", "--metrics-port", str(target.metrics_port)]
    ran = CliRunner().invoke(app, ["chaos", f"127.0.0.1:{server.port}", *words])
    assert ran.exit_code == 0, ran.output
    assert json.loads(ran.stdout)["samples"] >= 4


SERVER = """
import os, time
from usarmjx.server.runtime.signals import StopSignals

with StopSignals() as signals:
    signals.on_stop(lambda: os._exit(0))
    lines = ("listening on", "pictures on", "rosbridge at ws://", "metrics at http://", "see it at http://")
    print(*(f"{line}{' ' * line.endswith('on')}127.0.0.1:1" for line in lines), sep="\\n", flush=True)
    time.sleep(600)
"""
CHAOS = f"""
import benchmarks.chaos.soak, benchmarks.serving.process as process
import sys, time
from usarmjx.cli.app import app

def work(case, *rest):
    print(case.target.process, flush=True)
    time.sleep(600)

process.COMMAND = (sys.executable, "-c", {SERVER!r})
benchmarks.chaos.soak.soak = work
app(["chaos", "--self", "--soak", "600", "--record"])
"""


@pytest.mark.every_run(str(int(signal.SIGTERM)))
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL], ids=int)
def test_its_own_server_ends_with_it(number, tmp_path):
    settings = {"PYTHONPATH": python_path(dev.ROOT), "TMPDIR": str(tmp_path)}
    chaos = subprocess.Popen(
        [sys.executable, "-c", CHAOS],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, **settings},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    with chaos:
        server = Path("/proc") / chaos.stdout.readline().strip()
        assert server.joinpath("cmdline").read_text()
        chaos.send_signal(number)
        said = chaos.stderr.read()
        end = time.monotonic() + PATIENCE
    while server.exists() and time.monotonic() < end:
        time.sleep(0.02)
    assert not server.exists()
    if number == signal.SIGKILL:
        return
    assert (chaos.returncode, said) == (128 + number, f"usarmjx: stopped by {number.name}\n")
    assert not list(tmp_path.iterdir()), "the recording is removed"
