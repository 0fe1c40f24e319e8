"""Programs that launch Warp's kernels, read by processes that have traced nothing."""

import os
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("warp")

from usarmjx.base import warp_functions
from usarmjx.train.mapping.warp_waves import _kernel, distances_on_warp

PROGRAM = """
import sys
import jax, numpy as np
from pathlib import Path
from usarmjx.base.program_cache import ProgramCache, compile_program
from usarmjx.train.mapping.warp_waves import distances_on_warp
def ways(start, enter):
    print("traced")
    return jax.vmap(lambda s, e: distances_on_warp(s, e, None))(start, enter)
start, enter = np.full((3, 9, 9), np.inf, np.float32), np.ones((3, 9, 9), np.float32)
start[:, 2, 2], enter[1, 4, :8] = 0, np.inf
if sys.argv[2] == "other":  # which takes the first number of Warp's
    distances_on_warp(start[0, :5, :5], enter[0, :5, :5], None)
found = compile_program(ways, ProgramCache(Path(sys.argv[1]), "x"), "test")(start, enter)
np.save(sys.argv[3], np.asarray(found))
"""


STEPS = """
import sys
import jax, numpy as np
from pathlib import Path
from usarmjx.base.program_cache import ProgramCache, compile_program
from usarmjx.engines.planar import engine, neighbor_search
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import build_scene
for module in (neighbor_search, engine):
    module.warp_in_use = lambda: True
batch = Batch(build_scene("yellow", ["P2AT", "P2AT"]), 2, engine="planar")
state = batch.drive(batch.reset(), 0, {"Left": 3.0, "Right": 4.0})
def go(state):
    print("traced")
    return jax.lax.fori_loop(0, 60, lambda _, now: batch.step(now), state)
found = compile_program(go, ProgramCache(Path(sys.argv[1]), "x"), "test")(state)
np.save(sys.argv[3], np.asarray(batch.physics(found).qpos))
"""
"""Its kernels change arrays in place: what is known of what is around robots."""


@pytest.mark.every_run("program1-other")
@pytest.mark.parametrize(("program", "first"), [(PROGRAM, "nothing"), (PROGRAM, "other"), (STEPS, "nothing")])
def test_a_kept_program_with_kernels_does_the_same_in_another_process(tmp_path, program, first):
    def run(what, name):
        command = [sys.executable, "-c", program, str(tmp_path), what, str(tmp_path / name)]
        done = subprocess.run(
            command, env={**os.environ, "JAX_PLATFORMS": "cpu"}, capture_output=True, text=True, timeout=300
        )
        assert done.returncode == 0, done.stderr
        assert "Error" not in done.stderr
        return "traced" in done.stdout, np.load(tmp_path / name)

    (traced, before), (again, after) = run("nothing", "a.npy"), run(first, "b.npy")
    assert (traced, again) == (True, False)
    np.testing.assert_array_equal(before, after)
    assert np.isfinite(before).any()


def ways(size):
    start, enter = np.full((size, size), np.inf, np.float32), np.ones((size, size), np.float32)
    start[0, 0] = 0
    return np.asarray(distances_on_warp(start, enter, None))


def test_a_launch_has_the_same_number_whatever_came_before():
    ways(6)
    before = dict(warp_functions._LAUNCHES)
    ways(7)
    ways(6)
    more = warp_functions._LAUNCHES.keys() - before.keys()
    assert len(more) == 1, "that of the other size"
    (launch,) = (warp_functions._LAUNCHES[number] for number in more)
    assert launch.number in more
    assert launch.static == (7, 7)
    assert launch.target in warp_functions.targets()


def test_launches_of_others_are_no_launches_here():
    assert warp_functions.launches([-1]) == []


def test_a_kernel_that_xla_knows_by_another_name_is_refused():
    ways(6)
    launch = next(one for one in warp_functions._LAUNCHES.values() if one.static == (6, 6))
    with pytest.raises(ValueError, match="no_such_kernel"):
        warp_functions.expect([launch._replace(target="no_such_kernel")])
    assert _kernel(*launch.given).target == launch.target
