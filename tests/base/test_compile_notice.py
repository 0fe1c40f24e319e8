"""The line about compilations that a script gets: once, on the error stream, only where it takes a while."""

import os
import subprocess
import sys
import threading
import time

import pytest

from usarmjx.base import compilation
from usarmjx.base.compilation import AFTER, COMPILE_EVENT_PREFIX, IDLE, POLL, QUIET, CompileNotice, silence

PATIENCE = 30.0  # s
EVENT = f"{COMPILE_EVENT_PREFIX}jaxpr_trace_duration"
SCRIPT = """
import usarmjx
from usarmjx.base import compilation
compilation.AFTER = 0.0  # however fast the machine is
batch = usarmjx.Batch("yellow", worlds=2, engine="c")
state = batch.reset()
print("done")
"""


@pytest.fixture
def lines():
    return []


@pytest.fixture
def busy():
    return set()


@pytest.fixture
def notice(lines, busy, monkeypatch):
    monkeypatch.setattr(compilation, "IDLE", 0.3)
    return CompileNotice(lines.append, busy.__contains__)


def wait_for(condition):
    end = time.monotonic() + PATIENCE
    while not condition() and time.monotonic() < end:
        time.sleep(POLL / 4)
    assert condition()


def test_what_is_built_for_long_is_named_once_while_it_is(notice, lines):
    with notice.building("make('explore')"):
        notice.expect("its batch")
        wait_for(lambda: lines)
    assert notice.shown
    with notice.building("make('soccer')"):
        time.sleep(AFTER + 3 * POLL)
    (line,) = lines
    assert "make('explore')" in line
    assert QUIET in line


def test_a_long_compilation_is_reported_while_it_lasts(notice, lines, busy):
    notice.expect("Batch()")
    notice._hear(EVENT, 0.01)  # traced; no event comes while XLA compiles it
    busy.add(threading.get_ident())
    wait_for(lambda: lines)
    assert "Batch()" in lines[0]


def test_short_work_and_other_events_are_not_worth_a_line(notice, lines):
    notice.expect("Batch()")
    notice._hear("/jax/compilation_cache/cache_hits", 9.0)
    assert not notice._watched
    notice._hear(EVENT, 0.01)
    with notice.building("make()"):
        pass
    wait_for(lambda: not notice._watched)  # nobody looks on
    assert (lines, notice.shown) == ([], False)


def test_a_line_comes_within_a_second():
    assert AFTER + 2 * POLL < 1.0 < IDLE


def test_silence_reaches_children(monkeypatch):
    monkeypatch.setattr(compilation.NOTICE, "shown", False)
    environment = {}
    silence(environment)
    assert (environment, compilation.NOTICE.shown) == ({QUIET: "1"}, True)


@pytest.mark.parametrize(("asked", "count"), [("0", 1), ("1", 0)])
def test_a_script_gets_one_line_on_the_error_stream(asked, count):
    environment = {**os.environ, QUIET: asked, "JAX_ENABLE_COMPILATION_CACHE": "false"}
    ran = subprocess.run(
        [sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True, timeout=300
    )
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout == "done\n"
    lines = [line for line in ran.stderr.splitlines() if "building and compiling" in line]
    assert len(lines) == count
    assert all("Batch(worlds=2, engine='c')" in line for line in lines)
