"""On `warp` weight is an applied force, which moves everything as MuJoCo's own gravity does."""

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

pytest.importorskip("warp", reason="needs warp-lang")

from usarmjx.engines.base import Inputs
from usarmjx.engines.mjx import WarpEngine
from usarmjx.models.build.compose import Physics

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


def test_bodies_fall_and_swing_as_in_c_mujoco():
    engine = engine_of()
    model = engine.model
    assert engine.mx.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
    assert not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
    push = np.zeros((2, model.nbody, 6), np.float32)
    push[1, 1, 2] = 10.0  # what is applied to a body comes on top
    inputs = Inputs(
        ctrl=jnp.zeros((2, 0)),
        act=jnp.zeros((2, 0)),
        xfrc_applied=jnp.asarray(push),
        pinned=jnp.zeros((2, model.nq), bool),
        pinned_dof=jnp.zeros((2, model.nv), bool),
        qpos=jnp.zeros((2, model.nq)),
    )
    state = engine.start()
    for _ in range(4):
        state = engine.advance(state, inputs)
    for world in range(2):
        data = mujoco.MjData(model)
        data.xfrc_applied[:] = push[world]
        mujoco.mj_step(model, data, nstep=4 * engine.physics.substeps)
        assert abs(data.qpos[2] - 2) > 0.02  # it fell
        np.testing.assert_allclose(engine.state(state).qpos[world], data.qpos, atol=2e-5)
        np.testing.assert_allclose(engine.state(state).qvel[world], data.qvel, atol=2e-4)


def test_where_a_body_is_compensated_gravity_stays():
    engine = engine_of(compensated="gravcomp='1'")
    assert not engine.mx.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
