"""SIGINT and SIGTERM end a process soon, whatever it is doing: processes of their own."""

import os
import re
import signal
import subprocess
import sys
import threading
import time

import pytest

import dev
from tests.scripts import python_path
from tests.server.peers import PATIENCE, Peer
from usarmjx.server.runtime.signals import StopSignals

pytestmark = pytest.mark.alone

LIMIT = 6.0  # s: 2 s on an idle machine; what is stuck here would take ten minutes
STOPPED = re.compile(r"usarmjx: stopped after [\d.]+ simulated s; .*\n")
SIGNALS = [signal.SIGINT, signal.SIGTERM]
ID = {number: number.name for number in SIGNALS}

SERVING = """
import hashlib, sys, time
from concurrent.futures import ThreadPoolExecutor
from tests.server.still_world import StillWorld
from usarmjx.server.gamebots.server import BotServerSettings
from usarmjx.server.runtime.loop import serve
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.runtime.signals import StopSignals

world = StillWorld()
{before}
with StopSignals() as signals:
    {within}
    serve([BotServer(world, BotServerSettings(port=0))], 1.0, signals)
"""
COMPILE = "hashlib.pbkdf2_hmac('sha256', b'', b'', 2**31 - 1)"
"""Takes minutes, hears no signal, and lets other threads run: as when XLA compiles."""
WORK = {"compiling": COMPILE, "sleeping": "time.sleep(600)"}


def start(before="", within=""):
    """A process that serves a world, once it has said its first word."""
    process = launch(SERVING.format(before=before, within=within))
    return process, process.stdout.readline()


def launch(code):
    """A process that runs code."""
    return subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=dev.ROOT,
        env={
            **os.environ,
            "PYTHONPATH": python_path(dev.ROOT),
            "JAX_PLATFORMS": "cpu",
            "PYTHONUNBUFFERED": "",
        },
    )


def end(process, number):
    """Send a signal; return standard output, standard error, and how long the end took [s]."""
    began = time.monotonic()
    process.send_signal(number)
    rescue = threading.Timer(PATIENCE, process.kill)
    rescue.start()
    with process:  # `communicate` would forget what `readline` has read ahead
        out, err = process.stdout.read(), process.stderr.read()
        process.wait()
    rescue.cancel()
    return out, err, time.monotonic() - began


@pytest.mark.every_run(ID[signal.SIGTERM])
@pytest.mark.parametrize("number", SIGNALS, ids=ID.get)
def test_a_thread_that_compiles_is_not_waited_for(number):
    before = f"ThreadPoolExecutor(1).submit(lambda: {COMPILE})"
    process, line = start(before)
    peer = Peer(int(re.search(r":(\d+)$", line)[1]))
    assert peer.line().startswith(b"NFO")
    out, err, took = end(process, number)
    assert (process.returncode, err) == (0, "")
    assert STOPPED.fullmatch(out)
    assert peer.line() == b"", "its connection was closed"
    assert took < LIMIT


@pytest.mark.every_run(ID[signal.SIGINT])
@pytest.mark.parametrize("number", SIGNALS, ids=ID.get)
def test_a_loop_that_is_stuck_is_left_and_what_was_said_is_written(number):
    first = "print('stuck soon', flush=True); sys.stdout.write('last words')"
    process, line = start(within=f"{first}; world.on_step = lambda: {COMPILE}")
    assert line == "stuck soon\n"
    assert re.fullmatch(r"last wordsusarmjx: listening on .*\n", process.stdout.readline())
    time.sleep(0.5)  # the first step has begun
    out, err, took = end(process, number)
    assert (process.returncode, out, err) == (0, "", "")
    assert took < LIMIT


def test_more_signals_change_nothing_and_files_are_finished():
    """A file that takes longer than a second, of a loop that is stuck; whoever waits presses Ctrl-C again."""
    slow = "time.sleep(1.0); print('the file is complete', flush=True)"
    within = f"signals.finish_files(lambda: exec({slow!r})); world.on_step = lambda: {COMPILE}"
    process, _ = start(within=within)
    time.sleep(0.5)  # the first step has begun
    process.send_signal(signal.SIGINT)
    time.sleep(0.5)
    out, err, took = end(process, signal.SIGINT)
    assert (process.returncode, out, err) == (0, "the file is complete\n", "")
    assert took < LIMIT + 1.0


@pytest.mark.every_run("compiling-SIGINT", "sleeping-SIGTERM")
@pytest.mark.parametrize("number", SIGNALS, ids=ID.get)
@pytest.mark.parametrize("work", WORK.values(), ids=WORK)
def test_before_it_serves_it_ends_as_shells_expect(number, work):
    process, line = start(within=f"print('building', flush=True); sys.stdout.write('last words'); {work}")
    assert line == "building\n"
    time.sleep(0.5)  # the work has begun
    out, err, took = end(process, number)
    said = f"usarmjx: stopped by {signal.Signals(number).name}\n"
    assert (process.returncode, out, err) == (128 + number, "last words", said)
    assert took < LIMIT


def test_a_reader_who_has_gone_to_sleep_holds_up_nobody():
    """What is printed into a full pipe waits for ever."""
    chatter = "print('here', flush=True); print('x' * 2**20, flush=True)"
    process, line = start(within=chatter)
    assert line == "here\n"
    time.sleep(0.5)  # the pipe is full
    began = time.monotonic()
    process.send_signal(signal.SIGTERM)
    try:
        assert process.wait(PATIENCE) == 128 + signal.SIGTERM
    finally:
        process.kill()
        process.communicate()
    assert time.monotonic() - began < LIMIT


def test_afterwards_signals_mean_what_they_did():
    before = [signal.getsignal(number) for number in SIGNALS]
    with StopSignals() as signals:
        assert signals.number == 0
        assert all(signal.getsignal(number) == signals._interrupt for number in SIGNALS)
    assert [signal.getsignal(number) for number in SIGNALS] == before
    assert signal.set_wakeup_fd(-1) == -1


TRAINING = """
import hashlib, sys, time
from usarmjx.cli.train_plan import stop_request

with stop_request() as stop:
    {before}
    stop.arm()
    print("armed", flush=True)
    end = time.monotonic() + 60.0
    while not stop.requested and time.monotonic() < end:
        time.sleep(0.01)
    time.sleep(1.5)  # longer than a signal's grace while nothing is caught
    print("checkpoint", stop.number, flush=True)
"""


@pytest.mark.every_run(ID[signal.SIGTERM])
@pytest.mark.parametrize("number", SIGNALS, ids=ID.get)
def test_a_training_that_compiles_ends_at_once(number):
    process = launch(TRAINING.format(before=f"print('compiling', flush=True); {COMPILE}"))
    assert process.stdout.readline() == "compiling\n"
    time.sleep(0.5)  # the work has begun
    out, err, took = end(process, number)
    said = f"usarmjx: stopped by {signal.Signals(number).name}\n"
    assert (process.returncode, out, err) == (128 + number, "", said)
    assert took < LIMIT


@pytest.mark.every_run(ID[signal.SIGINT])
@pytest.mark.parametrize("number", SIGNALS, ids=ID.get)
def test_a_training_that_iterates_ends_with_its_checkpoint(number):
    process = launch(TRAINING.format(before=""))
    assert process.stdout.readline() == "armed\n"
    out, err, _ = end(process, number)
    assert (process.returncode, out) == (0, f"checkpoint {int(number)}\n")
    assert "ending with a checkpoint" in err


COMMAND = """
import hashlib, sys, time
import usarmjx.cli.play, usarmjx.sweeps.run
from usarmjx.base.progress import StatusLine
from usarmjx.cli.app import app

class Terminal:
    write, flush, isatty = sys.stderr.write, sys.stderr.flush, lambda self: {terminal}

def work(*args, **more):
    StatusLine(Terminal()).show("3 of 4 cells") if {terminal} else None
    print("compiling", flush=True)
    {work}

usarmjx.cli.play._draw_episode = usarmjx.sweeps.run.play_prepared = work
app({words}, standalone_mode=True)
"""
SWEEP = ["sweep", "teams", "--set", "task=drive-to-goal", "--set", "roster=[P2AT]", "--part", "1/99"]


@pytest.mark.every_run("sweep-sleeping", "play-compiling")
@pytest.mark.parametrize("work", WORK.values(), ids=WORK)
@pytest.mark.parametrize("words", [SWEEP, ["play", "drive-to-goal"]], ids=["sweep", "play"])
def test_commands_that_compile_end_at_once_with_a_line(words, work, tmp_path):
    words = [*words, "--out", str(tmp_path / ("x.png" if words[0] == "play" else "x"))]
    process = launch(COMMAND.format(words=words, work=work, terminal=False))
    assert process.stdout.readline() == "compiling\n"
    time.sleep(0.5)  # the work has begun
    _, err, took = end(process, signal.SIGINT)
    assert process.returncode == 130
    assert err.splitlines()[-1] == "usarmjx: stopped by SIGINT"
    assert "Traceback" not in err
    assert took < LIMIT


def test_a_line_of_progress_is_cleared_before_the_last_line(tmp_path):
    words = [*SWEEP, "--out", str(tmp_path)]
    process = launch(COMMAND.format(words=words, work=COMPILE, terminal=True))
    assert process.stdout.readline() == "compiling\n"
    time.sleep(0.5)
    _, err, _ = end(process, signal.SIGINT)
    assert err.endswith("\n\033[K3 of 4 cells\n\033[Kusarmjx: stopped by SIGINT\n")


def test_a_recorded_episode_closes_its_file():
    code = (
        "import pathlib, sys, time; from usarmjx.cli.play import drawing_signals\n"
        "with drawing_signals(pathlib.Path('x.mcap')):\n"
        "    try: print('at work', flush=True); time.sleep(600)\n"
        "    finally: print('closed', flush=True)"
    )
    process = launch(code)
    assert process.stdout.readline() == "at work\n"
    out, err, took = end(process, signal.SIGINT)
    said = "usarmjx: stopped by SIGINT: x.mcap ends there\n"
    assert (process.returncode, out, err) == (130, "closed\n", said)
    assert took < LIMIT
