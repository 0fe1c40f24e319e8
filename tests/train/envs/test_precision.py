"""Worlds beside libraries that set `jax_enable_x64`, as control and SLAM codes do."""

import subprocess
import sys

import jax
import pytest

CODE = """
import sys
import jax
jax.config.update("jax_enable_x64", sys.argv[2] == "double")
import jax.numpy as jnp
import numpy as np
import usarmjx

env = usarmjx.make("drive-to-goal", worlds=2, engine=sys.argv[1], episode_steps=4, ranges=("Sonar",))
state = env.reset(0)
for actions in (np.full((2, 1, 2), 0.3), jnp.full((2, 1, 2), 0.3)):
    state = env.step(state, (actions,))
if sys.argv[1] == "c":  # MuJoCo's own states are double
    state = state.replace(batch=state.batch.replace(physics=None))
names = {str(leaf.dtype) for leaf in jax.tree.leaves(state)}
assert not names & {"float64", "int64", "uint64"}, names
own = "float64" if sys.argv[2] == "double" else "float32"
assert jnp.zeros(1).dtype == own, "the program keeps its own precision"
print(np.asarray(state.obs[0]).tobytes().hex(), np.asarray(state.reward[0]).tobytes().hex(), sorted(names))
"""


@pytest.mark.parametrize("engine", ["c", pytest.param("planar", marks=pytest.mark.thorough)])
def test_double_precision_of_others_changes_no_type_of_a_world(engine, capsys, monkeypatch):
    """A process sets the flag first; the task has range sensors, whose rays failed to trace.

    The same seed gives the same episode, to the bit.
    """
    run = subprocess.run([sys.executable, "-c", CODE, engine, "double"], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr[-2000:]
    assert "float32" in run.stdout
    before = jax.config.jax_enable_x64
    monkeypatch.setattr(sys, "argv", ["-c", engine, "single"])
    try:
        exec(CODE, {})  # this process is as good as one of its own
    finally:
        jax.config.update("jax_enable_x64", before)
    assert capsys.readouterr().out == run.stdout
