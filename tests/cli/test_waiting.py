"""What a command says while one waits for it: at once, and while it compiles."""

import json
import os
import subprocess
import sys
import threading
import time

import jax
import jax.numpy as jnp
import pytest

import dev
from tests.scripts import python_path
from usarmjx.cli.common import COMPILED, FIRST, INTERVAL, LOWERED, CompilationWatch, is_compiling

COMMANDS = (
    "list",
    "arena list",
    "arena draw yellow --png x.png",
    "arena check yellow",
    "arena generate",
    "arena gallery --out x",
    "portraits --out x.png",
    "radio-map yellow --from 0,0 --out x.png",
    "demo --no-browser --port 0 --viewer-port 0",
    "demo --headless --out x",
    "doctor",
    "serve --port 0 --no-wireless --no-images",
    "play wander --out x.png",
    "play wander --serve --port 0 --no-wireless --no-images",
    "eval wander",
    "train wander --out x",
    "curves x",
    "sweep teams",
    "sweep show x",
    "sweep compare x y",
    "sweep report x",
    "suite run baseline",
    "suite show x",
    "suite leaderboard x",
    "suite replay x.json",
    "kernels 90",
    "bench radio",
    "bench rays",
    "bench camera",
    "bench step",
    "bench train x",
    "bench compile",
    "bench memory",
    "bench peers",
    "bench report",
)
REFUSED = ("export x --out x.npz",)
"""Commands that refuse a name without JAX."""
WITHOUT_JAX = """
import contextlib, io, json, sys, threading
from importlib.abc import MetaPathFinder

class Met(BaseException):
    pass

class Gate(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "jax" and threading.current_thread() is threading.main_thread():
            raise Met

sys.meta_path.insert(0, Gate())
from usarmjx.cli.app import app
found = {}
for command in json.loads(sys.argv[1]):
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            app(command.split(), standalone_mode=False)
        found[command] = "no JAX"
    except Met:
        found[command] = said.getvalue()
print(json.dumps(found))
"""


def test_every_command_says_something_before_it_imports_jax(tmp_path):
    """That import takes a second or two; here it ends the command."""
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_JAX, json.dumps(COMMANDS + REFUSED)],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": python_path(dev.ROOT)},
    )
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert [said.pop(command) for command in REFUSED] == ["no JAX"] * len(REFUSED)
    assert [command for command in COMMANDS if not said[command].startswith("usarmjx: ")] == []
    assert all(text.count("\n") == 1 and text.endswith(" ...\n") for text in said.values()), said


class Talk:
    """A watch that hears of compilations at times of a clock of its own."""

    def __init__(self):
        self.said, self.now, self.idle = [], 0.0, set()
        self.watch = CompilationWatch(self.said.append, lambda thread: thread not in self.idle)

    def wait(self, seconds):
        """Look twice a second, as the command does."""
        for _ in range(round(2 * seconds)):
            self.now += 0.5
            self.watch.look(self.now)

    def hear(self, event, duration=0.0, thread=0):
        self.watch.heard(f"/jax/core/compile/{event}", duration, self.now, thread)


@pytest.fixture
def talk():
    return Talk()


def test_a_long_compilation_is_spoken_of_until_it_ends(talk):
    talk.wait(20)
    talk.hear(LOWERED, 1.0)
    talk.wait(24)
    talk.hear(COMPILED, 24.0)
    talk.wait(60)
    assert talk.said == ["compiling ... 3 s", "compiling ... 10 s", "compiling ... 20 s", "compiled, 25 s"]


def test_many_short_ones_in_a_row_are_one(talk):
    for _ in range(4):
        talk.wait(1.5)
        talk.hear("jaxpr_trace_duration", 1.5)
    assert talk.said == ["compiling ... 3 s"]
    talk.wait(10)
    assert talk.said[1:] == ["compiled, 6 s"]


def test_nothing_is_said_of_short_ones_nor_of_other_events(talk):
    for _ in range(5):
        talk.hear(LOWERED)
        talk.wait(1)
        talk.hear(COMPILED, 1.0)
        talk.wait(30)
    talk.watch.heard("/jax/compilation_cache/cache_misses", 50.0, talk.now)
    talk.wait(30)
    assert talk.said == []


def test_one_thread_may_wait_for_another(talk):
    talk.hear(LOWERED, thread=1)
    talk.hear(LOWERED, thread=2)
    talk.wait(FIRST)
    talk.hear(COMPILED, FIRST, thread=1)
    talk.wait(INTERVAL)
    assert talk.said == ["compiling ... 3 s", "compiling ... 10 s"]
    talk.hear(COMPILED, FIRST + INTERVAL, thread=2)
    talk.wait(10)
    assert talk.said[2:] == ["compiled, 13 s"]


def test_one_that_follows_a_reported_end_has_a_clock_of_its_own(talk):
    """Tracing is heard of when it ends: under load that is long after the end of what came before."""
    talk.hear(LOWERED)
    talk.wait(4)
    talk.hear(COMPILED, 4.0)
    talk.wait(9)
    talk.hear("jaxpr_trace_duration", 8.0)
    talk.hear(LOWERED)
    talk.wait(4)
    talk.hear(COMPILED, 4.0)
    talk.wait(6)
    assert talk.said == [
        "compiling ... 3 s",
        "compiled, 4 s",
        "compiling ... 8 s",
        "compiling ... 10 s",
        "compiled, 12 s",
    ]


COMPILES = """
from usarmjx.cli.common import announce
announce("a start ...")
import jax
heard = []
jax.monitoring.register_event_listener(lambda event, **_: heard.append(event.rpartition("/")[2]))
assert jax.jit(lambda x: 3 * x @ x.T)(jax.numpy.ones((2, 2))).sum() == 24.0
print(heard.count("cache_misses"), heard.count("cache_hits"))
"""


def test_a_second_start_compiles_nothing_and_what_is_broken_is_compiled_anew(tmp_path):
    """A file is broken as by a writer that was killed: of all of them, one line."""
    ours = {"USARMJX_CACHE": str(tmp_path), "JAX_PLATFORMS": "cpu"}
    theirs = ("USARMJX_CACHE", "JAX_COMPILATION_CACHE_DIR", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS")
    environment = {key: value for key, value in os.environ.items() if key not in theirs} | ours

    def start():
        done = subprocess.run(
            [sys.executable, "-c", COMPILES], capture_output=True, text=True, cwd=dev.ROOT, env=environment
        )
        assert done.returncode == 0, done.stderr
        return [int(word) for word in done.stdout.split()], done.stderr.splitlines()

    (misses, hits), said = start()
    assert misses > 0 == hits
    assert said == ["usarmjx: a start ..."]
    kept = list(tmp_path.glob("jax/*/*-cache"))
    assert len(kept) == misses
    assert start() == ([0, misses], said)
    for path in kept:
        path.write_bytes(path.read_bytes()[:50])
    (again, _), said = start()
    assert again == misses
    assert len(said) == 2
    assert said[1].startswith("usarmjx: note: ")
    assert all(path.stat().st_size > 50 for path in kept)


def test_what_is_lowered_and_never_compiled_is_not_waited_for(talk):
    talk.hear(LOWERED)
    talk.wait(12.0)
    assert talk.said == ["compiling ... 3 s", "compiling ... 10 s"]
    talk.idle.add(0)
    talk.wait(60.0)
    assert [line.split()[0] for line in talk.said] == ["compiling", "compiling", "compiled,"]


def test_whether_a_thread_compiles_is_seen_by_its_stack():
    def long(x):
        for _ in range(150):
            x = jnp.sin(x) + jnp.cos(x)
        return x

    worker = threading.Thread(target=jax.jit(long), args=(1.0,))
    worker.start()
    seen = False
    while worker.is_alive():
        seen |= is_compiling(worker.ident)
        time.sleep(0.002)
    assert seen
    assert not is_compiling(threading.get_ident())
