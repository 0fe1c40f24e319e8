"""On `warp` weight is an applied force, which moves everything as MuJoCo's own gravity does."""

import atexit

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

pytest.importorskip("warp", reason="needs warp-lang")

from usarmjx.engines.base import Inputs
from usarmjx.engines.mjx import MjxEngine
from usarmjx.engines.mjx_warp import WarpEngine, block_until_finished, multi_step
from usarmjx.models.compile.physics import Physics

ROBOT = """
<mujoco>
  <custom><numeric name="max_contact_points" data="8"/><numeric name="max_geom_pairs" data="8"/></custom>
  <worldbody>
    <body pos="0 0 2"><freejoint/><geom type="box" size=".2 .1 .1" mass="3"/>
      <body pos=".2 0 0"><joint axis="0 1 0"/><geom type="box" size=".1 .1 .1" pos=".1 0 0"/></body>
      <body pos="0 .1 0" {compensated}><joint axis="1 0 0"/><geom size=".05" pos="0 .1 0"/></body>
    </body>
    <body pos="1 0 1"><joint axis="0 1 0"/><geom type="box" size=".1 .02 .02" pos=".1 0 0" mass="2"/></body>
  </worldbody>
</mujoco>
"""


def engine_of(compensated=""):
    spec = mujoco.MjSpec.from_string(ROBOT.format(compensated=compensated))
    spec.option.timestep = 0.005
    return WarpEngine(spec, Physics(), 2)


PUSH = np.zeros((2, 5, 6), np.float32)
PUSH[1, 1, 2] = 10.0
"""Force on a body of the second of two worlds, in addition to its weight."""


def fallen(engine, steps):
    """The states after each of some control steps."""
    model = engine.model
    inputs = Inputs(
        ctrl=jnp.zeros((2, 0)),
        act=jnp.zeros((2, 0)),
        xfrc_applied=jnp.asarray(PUSH),
        pinned=jnp.zeros((2, model.nq), bool),
        pinned_dof=jnp.zeros((2, model.nv), bool),
        qpos=jnp.zeros((2, model.nq)),
    )
    states, step = [engine.start()], jax.jit(engine.advance)
    for _ in range(steps):
        states.append(step(states[-1], inputs))
    return states[1:]


@pytest.fixture(scope="module")
def usual():
    """An engine as it is without a word, and its states."""
    engine = engine_of()
    return engine, fallen(engine, 4)


def test_bodies_fall_and_swing_as_in_c_mujoco(usual):
    engine, states = usual
    model, state = engine.model, states[-1]
    assert engine.mx.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
    assert not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
    for world in range(2):
        data = mujoco.MjData(model)
        data.xfrc_applied[:] = PUSH[world]
        mujoco.mj_step(model, data, nstep=4 * engine.physics.substeps)
        assert abs(data.qpos[2] - 2) > 0.02  # it fell
        np.testing.assert_allclose(engine.state(state).qpos[world], data.qpos, atol=2e-5)
        np.testing.assert_allclose(engine.state(state).qvel[world], data.qvel, atol=2e-4)


@pytest.mark.thorough
@pytest.mark.skipif(jax.default_backend() != "cpu", reason="sums are atomic on a GPU; see tests/test_gpu.py")
def test_a_control_step_in_one_call_computes_the_same_bits(usual, monkeypatch):
    """The number of steps in one call of MuJoCo Warp, or in one CUDA graph, does not change the result."""
    engine = engine_of()
    engine.select_graphs("control")
    assert engine._step_and_count() == (multi_step(engine.physics.substeps, engine._own_step), 1)
    monkeypatch.setattr(engine, "_step_and_count", lambda: MjxEngine._step_and_count(engine))
    found = fallen(engine, 2)[-1]
    assert float(found.time[0]) == pytest.approx(2 * engine.physics.period)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(usual[1][1]), strict=True):
        np.testing.assert_array_equal(one, other)


def test_where_a_body_is_compensated_gravity_stays():
    engine = engine_of(compensated="gravcomp='1'")
    assert not engine.mx.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY


def test_on_a_cpu_a_program_s_end_waits_for_the_step_under_way(monkeypatch):
    """Else the interpreter, whom the kernels need, and the step would wait for each other."""
    hooks = []
    monkeypatch.setattr(atexit, "register", hooks.append)
    engine_of()
    assert hooks == [block_until_finished] * (jax.default_backend() == "cpu")
    under_way = jax.jit(lambda x: jax.lax.fori_loop(0, 200, lambda _, y: jnp.sin(y @ x), x))(jnp.eye(400))
    block_until_finished()
    assert under_way.is_ready()


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="kernels are started by Python on a CPU only")
def test_on_a_cpu_a_step_whose_outcome_is_dropped_is_over_when_it_returns():
    """At a program's end nobody could wait for it: what is dropped is not among JAX's live arrays."""
    long = jax.jit(lambda x: jax.lax.fori_loop(0, 200, lambda _, y: jnp.sin(y @ x), x))
    outcome = engine_of().blocking(long)(jnp.eye(400))
    assert outcome.is_ready()
    assert jax.jit(engine_of().blocking(jnp.sin))(0.0) == 0.0  # traced, there is nothing to wait for
