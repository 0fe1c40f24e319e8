"""What is put into one call of MuJoCo Warp, or one CUDA graph, changes nothing of what is computed."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

pytest.importorskip("warp", reason="needs warp-lang")

from tests.engines.test_weight import engine_of
from usarmjx.base.errors import EngineError, UnknownNameError, UnsupportedFeatureError
from usarmjx.engines.base import Inputs
from usarmjx.engines.mjx_warp import multi_step
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import build_scene


def fallen(engine):
    """The state after two control steps, in which the first of two worlds is pushed up."""
    model = engine.model
    push = jnp.zeros((2, model.nbody, 6)).at[0, 1, 2].set(10.0)
    inputs = Inputs(
        ctrl=jnp.zeros((2, 0)),
        act=jnp.zeros((2, 0)),
        xfrc_applied=push,
        pinned=jnp.zeros((2, model.nq), bool),
        pinned_dof=jnp.zeros((2, model.nv), bool),
        qpos=jnp.zeros((2, model.nq)),
    )
    step = jax.jit(lambda state: engine.advance(state, inputs))
    return step(step(engine.start()))


@pytest.fixture(scope="module")
def usual():
    return fallen(engine_of())


@pytest.mark.thorough
@pytest.mark.skipif(jax.default_backend() != "cpu", reason="sums are atomic on a GPU; see tests/test_gpu.py")
def test_a_control_step_in_one_call_computes_the_same_bits(usual):
    engine = engine_of()
    engine.select_graphs("control")
    assert engine._step_and_count() == (multi_step(engine.physics.substeps), 1)
    found = fallen(engine)
    assert float(found.time[0]) == pytest.approx(2 * engine.physics.period)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(usual), strict=True):
        np.testing.assert_array_equal(one, other)


def test_without_a_word_there_is_a_graph_for_each_physics_step():
    engine = engine_of()
    before = engine.mx.opt._impl.graph_mode
    assert engine._step_and_count()[1] == engine.physics.substeps == 4
    engine.select_graphs("step")
    assert engine.mx.opt._impl.graph_mode is before


def test_an_unknown_graph_is_refused_and_engines_without_any_refuse_all():
    with pytest.raises(UnknownNameError, match=r"kind of CUDA graphs 'action'; known: .*control-staged-ex"):
        engine_of().select_graphs("action")
    with pytest.raises(UnsupportedFeatureError, match=r"engine 'c' launches no CUDA graphs .'control'."):
        Batch(build_scene("yellow", ["P2AT"]), 1, engine="c").engine.select_graphs("control")


def test_another_version_of_mjx_is_refused(monkeypatch):
    monkeypatch.setattr("usarmjx.engines.cylinder_box.MJX_VERSION", "3.16.0")
    with pytest.raises(EngineError, match=r"found mujoco-mjx .*; .* needs exactly 3\.16\.0"):
        multi_step(17)
