"""On `warp` loose objects that lie still sleep, and nobody can tell but by what the solver is asked."""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

pytest.importorskip("warp", reason="needs warp-lang")

from usarmjx.engines.base import Inputs
from usarmjx.engines.mjx_warp import SLEEP_DELAY, WarpEngine
from usarmjx.models.compile.physics import Physics
from usarmjx.server.worlds.make import parse_roster
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import build_scene

SCENE = """
<mujoco>
  <option cone="elliptic" impratio="2" solver="CG" iterations="50" timestep="0.01"/>
  <custom><numeric name="max_contact_points" data="40"/><numeric name="max_geom_pairs" data="40"/></custom>
  <worldbody>
    <geom type="plane" size="9 9 1"/>
    <geom name="victim/arm" type="sphere" size=".05" pos="0 -2.2 .1"/>
    <body name="arena" mocap="true"><geom name="arena/0" type="box" size="3 .1 .5" pos="0 2.3 .5"/></body>
    <body name="r0/chassis" pos="-.6 0 .1"><joint name="ahead" type="slide" axis="1 0 0" damping="1"/>
      <geom type="box" size=".1 .2 .09" mass="20"/></body>
    <body name="loose/far" pos="0 2 .05"><freejoint/><geom type="box" size=".05 .05 .05" mass="1"/></body>
    <body name="loose/under" pos="0 0 .05"><freejoint/><geom type="box" size=".05 .05 .05" mass="1"/></body>
    <body name="loose/upon" pos="0 0 .15"><freejoint/><geom type="box" size=".05 .05 .05" mass="1"/></body>
    <body name="loose/high" pos="2 2 .5"><freejoint/><geom type="box" size=".05 .05 .05" mass="1"/></body>
    <body name="loose/armed" pos="0 -2 .05"><freejoint/><geom type="box" size=".05 .05 .05" mass="1"/></body>
  </worldbody>
  <actuator><velocity joint="ahead" kv="200"/></actuator>
</mujoco>
"""
FAR, UNDER, UPON, HIGH, ARMED = range(5)
PHYSICS = Physics(timestep=0.01, substeps=2, iterations=50, sleep_tolerance=0.005)
SECOND = round(1 / PHYSICS.period)
"""In control steps."""
TOLD = round(1.6 * SECOND)
"""For how long the robot is told to drive [control steps]."""
AWAKE = replace(PHYSICS, sleep_tolerance=0.0)
CONVERGED = replace(PHYSICS, solver="block", timestep=0.0025, substeps=8)
"""By CG at 10 ms a start that is 0.01 mm apart moves a pushed stack by 13 cm, on C MuJoCo, too."""
PUSHED = 0.02
"""How far a pushed stack may lie from where one lies that never slept: sums are atomic, and contacts stick
and slip [m]."""


@cache
def engine_of_two_worlds(physics):
    scene = SCENE.replace('timestep="0.01"', f'timestep="{physics.timestep}"')
    engine = WarpEngine(mujoco.MjSpec.from_string(scene), physics, 2)
    return engine, engine.blocking(jax.jit(engine.advance))


class Worlds:
    """Two worlds; in the second one the robot drives when it is told."""

    def __init__(self, physics=PHYSICS):
        self.engine, self.advance = engine_of_two_worlds(physics)
        self.state, model = self.engine.start(), self.engine.model
        self.inputs = Inputs(
            ctrl=jnp.zeros((2, 1)),
            act=jnp.zeros((2, 0)),
            xfrc_applied=jnp.zeros((2, model.nbody, 6)),
            pinned=jnp.zeros((2, model.nq), bool),
            pinned_dof=jnp.zeros((2, model.nv), bool),
            qpos=jnp.asarray(np.tile(model.qpos0, (2, 1)), jnp.float32),
        )

    def run(self, steps, speed=0.0, force=0.0):
        push = self.inputs.xfrc_applied.at[1, self.engine.model.body("loose/far").id, 0].set(force)
        told = self.inputs.replace(ctrl=jnp.asarray([[0.0], [speed]]), xfrc_applied=push)
        for _ in range(steps):
            self.state = self.advance(self.state, told)
        return self.at()

    def at(self):
        """Where the loose objects are (worlds, objects, 3) [m]."""
        return np.asarray(self.state.qpos)[:, 1:].reshape(2, 5, 7)[..., :3]

    def asleep(self):
        return np.asarray(self.engine._sleep.asleep(self.state.userdata))

    def rows(self):
        return np.asarray(self.engine.solved(self.state).constraint_rows)


@cache
def rested_state(physics):
    worlds = Worlds(physics)
    worlds.run(SECOND)
    return worlds.state


@pytest.fixture
def rested():
    """Worlds after a second in which nothing is told."""
    worlds = Worlds()
    worlds.state = rested_state(PHYSICS)
    return worlds


def c_mujoco(steps):
    """Where C MuJoCo has the loose objects after so many control steps (objects, 3) [m]."""
    model = mujoco.MjModel.from_xml_string(SCENE)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=steps * PHYSICS.substeps)
    return data.qpos[1:].reshape(5, 7)[:, :3]


def test_what_lies_still_has_no_contacts_and_stays_to_the_bit(rested):
    assert rested.asleep().tolist() == [[True, True, True, True, False]] * 2  # a limb may hit the last
    assert (rested.rows() == 3 * 4).all()  # of that one's four corners
    before = rested.at()
    np.testing.assert_allclose(before, np.broadcast_to(c_mujoco(SECOND), before.shape), atol=1e-3)
    assert (rested.run(SECOND // 2)[:, :ARMED] == before[:, :ARMED]).all()


def test_what_falls_is_awake_and_lands_first():
    worlds = Worlds()
    worlds.run(round(SLEEP_DELAY / PHYSICS.period))
    assert not worlds.asleep().any()
    lands = worlds.run(8)  # what is near is known after a step, and they settle by 0.1 mm
    assert worlds.asleep()[0].tolist() == [True, True, True, False, False]
    assert lands[0, HIGH, 2] < 0.06


@pytest.mark.thorough
def test_a_robot_pushes_what_slept_as_if_it_had_been_awake():
    physics = replace(CONVERGED, sleep_tolerance=0.0)
    rested, awake = Worlds(CONVERGED), Worlds(physics)
    rested.state, awake.state = rested_state(CONVERGED), rested_state(physics)
    expected, after = awake.run(TOLD, speed=0.6), rested.run(TOLD, speed=0.6)
    assert expected[1, UNDER, 0] > 0.12  # that far it was pushed
    np.testing.assert_allclose(after[1], expected[1], atol=PUSHED)
    assert rested.asleep()[:, UNDER].tolist() == [True, False]
    assert not awake.engine._sleep


def test_what_lies_on_it_falls_once_it_is_taken_away(rested):
    """Nothing is near what lies upon it, but what moves."""
    below = rested.engine.model.body("loose/under")
    force = rested.inputs.xfrc_applied.at[1, below.id, 0].set(60.0)
    rested.inputs = rested.inputs.replace(xfrc_applied=force)
    assert rested.run(SECOND // 2)[1, UNDER, 0] > 0.3
    rested.inputs = rested.inputs.replace(xfrc_applied=0 * force)
    fallen = rested.run(SECOND)
    assert fallen[1, UPON, 2] < 0.06
    assert np.isclose(fallen[0, UPON, 2], 0.15, atol=1e-3)


def test_what_is_put_into_the_air_falls(rested):
    place = rested.engine.model.joint(rested.engine.model.body("loose/far").jntadr[0]).qposadr[0]
    pinned = np.zeros((2, rested.engine.model.nq), bool)
    pinned[1, place : place + 7] = True
    qpos = jnp.asarray(rested.state.qpos).at[1, place + 2].set(0.5)
    rested.state = rested.engine.set_qpos(
        rested.state, pinned, np.zeros((2, rested.engine.model.nv), bool), qpos
    )
    assert rested.asleep()[:, FAR].tolist() == [True, False]
    assert np.isclose(rested.at()[1, FAR, 2], 0.5)
    assert rested.run(SECOND)[1, FAR, 2] < 0.06


def test_a_force_from_outside_wakes(rested):
    before = rested.at()
    moved = rested.run(SECOND // 2, force=20.0)
    assert moved[1, FAR, 0] - before[1, FAR, 0] > 0.5
    assert (moved[0, FAR] == before[0, FAR]).all()


def test_worlds_begin_awake_and_a_reset_leaves_the_others_asleep(rested):
    model = rested.engine.model
    start = jnp.asarray(np.tile(model.qpos0, (2, 1)), jnp.float32)
    rested.state = rested.engine.reset(rested.state, np.array([False, True]), start)
    assert rested.asleep().tolist() == [[True, True, True, True, False], [False] * 5]


def test_objects_of_an_arena_sleep_beside_its_solids():
    """A second after the start no contact is left but those of the wheels."""
    physics = replace(Physics.sleeping(), solver="block")
    scene = build_scene("yellow", parse_roster("P2AT:1"), physics)
    batch = Batch(scene, 1, engine="warp")
    step, state = jax.jit(batch.step), batch.reset()
    for _ in range(SECOND):
        state = step(state)
    assert np.asarray(batch.engine._sleep.asleep(state.physics.userdata)).tolist() == [[True] * 4]
    assert 4 <= int(batch.engine.solved(state.physics).contacts[0]) <= 8


def test_nothing_sleeps_unless_it_is_asked_for():
    engine = WarpEngine(mujoco.MjSpec.from_string(SCENE), Physics(), 1)
    assert engine.model.nuserdata == 0
    assert engine._sleep is None


def test_where_gravity_is_mujoco_s_own_nothing_sleeps():
    compensated = SCENE.replace('name="r0/chassis"', 'name="r0/chassis" gravcomp="1"')
    assert WarpEngine(mujoco.MjSpec.from_string(compensated), PHYSICS, 1)._sleep is None
