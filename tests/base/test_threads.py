"""The guard against the deadlock of JAX's CPU backend; each case in a process of its own."""

import os
import subprocess
import sys

import pytest


def run(code, nproc=None, cores=None):
    """Run code in a fresh process, with NPROC set so and that many cores to run on."""
    environment = {key: value for key, value in os.environ.items() if key != "NPROC"}
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
from usarmjx.models.build.compose import Physics
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


@pytest.mark.parametrize(("before", "nproc"), [(EARLY, "8"), ("import jax\n", "2")])
def test_otherwise_the_engine_is_built(before, nproc):
    """That jax was imported before does no harm while its backend has not started."""
    assert run(before + BUILD, nproc=nproc, cores=2) == "JaxEngine"
