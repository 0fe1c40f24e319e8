"""The guard against the deadlock of JAX's CPU backend; each case in a process of its own."""

import os
import subprocess
import sys

import pytest


def run(code, nproc=None, cores=None):
    """Run code in a fresh process, with NPROC set so and that many cores to run on."""
    # JAX's keys of kept programs do not contain the size of the pool.
    without = ("NPROC", "JAX_COMPILATION_CACHE_DIR")
    environment = {key: value for key, value in os.environ.items() if key not in without}
    environment["JAX_PLATFORMS"] = "cpu"
    if nproc is not None:
        environment["NPROC"] = nproc
    if cores is not None:
        code = f"import os; os.sched_getaffinity = lambda _: range({cores})\n" + code
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=300, env=environment, check=True
    ).stdout.strip()


SHOW = "import os, usarmjx; print(os.environ.get('NPROC'))"


@pytest.mark.parametrize(
    ("nproc", "cores", "expected"),
    [
        (None, 2, "8"),
        ("2", 64, "8"),
        ("", 2, "8"),
        ("two", 2, "8"),
        ("8", 2, "8"),
        ("12", 2, "12"),
        (None, 64, "None"),
    ],
)
def test_the_pool_is_made_large_enough(nproc, cores, expected):
    """An NPROC that is large enough, or many cores, are left alone."""
    assert run(SHOW, nproc, cores) == expected


BUILD = """
from usarmjx.engines import make_engine
from usarmjx.base.errors import EngineError
from usarmjx.models.compile.compose import Physics
import mujoco
ball = '<mujoco><worldbody><body pos="0 0 1"><freejoint/><geom size=".1"/></body></worldbody></mujoco>'
spec = mujoco.MjSpec.from_string(ball)
try:
    print(type(make_engine("jax", spec, Physics(), 1)).__name__)
except EngineError as error:
    print(error)
make_engine("c", spec, Physics(), 1)
"""
EARLY = "import jax; jax.devices()\n"


def test_jax_that_ran_before_with_a_small_pool_is_refused_with_advice():
    """The C engine, which solves nothing with JAX, is not."""
    said = run(EARLY + BUILD, nproc="2", cores=2)
    assert "import usarmjx first, or set NPROC=8" in said


@pytest.mark.every_run("import jax\\n-2")
@pytest.mark.parametrize(("before", "nproc"), [(EARLY, "8"), ("import jax\n", "2")])
def test_otherwise_the_engine_is_built(before, nproc):
    """That jax was imported before does no harm while its backend has not started."""
    assert run(before + BUILD, nproc=nproc, cores=2) == "JaxEngine"


FIT = "from usarmjx.base import process; process.fit_pool_to_cores()\n"


@pytest.mark.parametrize(
    ("nproc", "cores", "expected"),
    [(None, 2, "None"), ("2", 2, "2"), ("8", 2, "8"), ("12", 2, "12"), (None, 64, "None")],
)
def test_it_can_be_as_large_as_the_machine(nproc, cores, expected):
    """Who has asked for a number of threads gets it."""
    assert run(FIT + SHOW, nproc, cores) == expected


def test_jax_has_a_thread_for_each_core_then():
    """XLA divides loops among as many tasks as its pool has threads."""
    many = "import jax, jax.numpy as jnp\ncurve = lambda x: sum(jnp.sin(x * k) for k in range(20))\n"
    many += "text = jax.jit(curve).lower(jnp.zeros((64, 10000))).compile().as_text()\n"
    many += "print(text.split('outer_dimension_partitions\":[\"')[1].split('\"')[0])"
    assert run("import usarmjx\n" + many, cores=2) == "8"
    pin = "import os\nos.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:2])\n"  # XLA asks the system
    assert run(pin + FIT + many) == str(min(2, len(os.sched_getaffinity(0))))


def test_it_stays_as_large_as_it_was_once_jax_runs():
    code = "import usarmjx, jax; jax.devices()\n" + FIT + SHOW
    assert run(code, None, 2) == "8"


def test_it_is_small_in_processes_that_are_started_then():
    child = "subprocess.run([sys.executable, '-c', \"import os, usarmjx; print(os.environ.get('NPROC'))\"])"
    assert run(f"{FIT}import subprocess, sys; {child}", cores=2) == "None"


def test_the_engine_that_would_hang_is_refused_then_with_advice():
    said = run(FIT + BUILD, cores=2)
    assert "USARMJX_POOL=cores" in said
    assert "engine jax needs 8" in said


@pytest.mark.thorough
def test_an_engine_whose_pool_was_asked_for_is_built_then():
    assert run(FIT + BUILD, nproc="8", cores=2) == "JaxEngine"


@pytest.mark.parametrize(
    ("engines", "expected"), [(["c", "Planar"], "None"), (["c", "JAX"], "8"), (["auto"], "8"), (None, "8")]
)
def test_commands_that_do_not_need_a_large_pool_have_a_small_one(engines, expected, tmp_path):
    """What they compile is kept by itself: loops are divided otherwise."""
    more = "" if engines is None else f", engines={engines}"
    code = f"import os; os.environ['USARMJX_CACHE'] = {str(tmp_path)!r}\n"
    code += "os.environ.pop('JAX_COMPILATION_CACHE_DIR', None)\n"
    code += f"from usarmjx.cli.common import announce; announce('wait', aloud=False{more})\n{SHOW}\n"
    code += "print(os.environ['JAX_COMPILATION_CACHE_DIR'].endswith('-cores'))"
    assert run(code, cores=2).split() == [expected, str(expected == "None")]
