"""The three engines: the same result, and what the batch promises about worlds and randomness."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from tests.arenas import COURSE, FLAT
from usarmjx.base.errors import EngineError, UnknownNameError, UnsupportedFeatureError, UsageError
from usarmjx.engines.base import check_features
from usarmjx.models.arenas import ARENAS
from usarmjx.models.compile.physics import Physics
from usarmjx.models.generate import generate_many
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import LooseObject
from usarmjx.models.types.shapes import HeightField, Mesh, Shape
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import build_scene

PARITY = 5e-3
"""Poses after 1 s of driving up a ramp and over a step [m]: single against double precision and another
contact function, through a solver that is stopped after 16 iterations, over a path of 0.4 m."""
ALONE = 1e-4
"""Poses of a world alone and in a batch after 1 s [m]: XLA orders sums differently for other batch sizes, and
a solver that is stopped early makes more of it, so these tests let it converge."""
CONVERGED = Physics(iterations=30, ls_iterations=20)
OTHER_ENGINES = ("jax", "warp", "planar")
SECOND = 50  # control steps of 20 ms
BLIND = replace(ROBOTS.get("P2AT"), sensors=(), cameras=())
"""A P2AT with nothing to see by, which compiles faster."""


@pytest.fixture(scope="module")
def scene():
    return build_scene(COURSE, [BLIND, BLIND], CONVERGED)


@pytest.fixture(scope="module")
def flat():
    return build_scene(FLAT, [BLIND], CONVERGED)


@pytest.fixture(scope="module")
def jax_batch(scene):
    return Batch(scene, 2, engine="jax", seed=3)


def drive_for(batch, steps=SECOND, left=4.0, right=4.0):
    state = batch.drive(batch.reset(), 0, {"Left": left, "Right": right})
    for _ in range(steps):
        state = batch.step(state)
    return state


def roots(batch, state):
    return np.asarray(batch.physics(state).qpos)[:, batch.scene.groups[0].root_qposadr]


@pytest.fixture(scope="module")
def driven(jax_batch):
    """One second of driving on `jax`, shared by the tests below."""
    return drive_for(jax_batch)


@pytest.fixture(scope="module")
def reference(scene):
    batch = Batch(scene, 2, engine="c", seed=3)
    return roots(batch, drive_for(batch))


@pytest.mark.oracle
def test_jax_drives_as_c_mujoco_does(jax_batch, driven, reference):
    np.testing.assert_allclose(roots(jax_batch, driven)[..., :3], reference[..., :3], atol=PARITY)
    jax_batch.check_overflow(driven)


@pytest.mark.oracle
def test_solver_block_drives_as_c_mujoco_does(scene, reference):
    """Within 2 % of the way, as an engine of its own solver; C MuJoCo's is stopped early here, too."""
    pytest.importorskip("warp", reason="needs warp-lang")
    batch = Batch(
        build_scene(COURSE, [BLIND, BLIND], replace(CONVERGED, solver="block")), 2, engine="warp", seed=3
    )
    assert (batch.engine.solver, batch.engine.uncovered) == ("block", None)
    state = drive_for(batch)
    np.testing.assert_allclose(roots(batch, state)[..., :3], reference[..., :3], atol=PARITY)
    batch.check_overflow(state)
    *_, iterations = map(np.asarray, batch.engine.solved(state.physics))
    assert (iterations >= 1).all()
    assert (iterations < 15).all()


@pytest.mark.oracle
def test_warp_drives_as_c_mujoco_does(scene, reference):
    pytest.importorskip("warp", reason="needs warp-lang")
    batch = Batch(scene, 2, engine="warp", seed=3)
    state = drive_for(batch)
    np.testing.assert_allclose(roots(batch, state)[..., :3], reference[..., :3], atol=PARITY)
    batch.check_overflow(state)
    contacts, rows, iterations = map(np.asarray, batch.engine.solved(state.physics))
    assert contacts.sum() == int(state.physics._impl.nacon.reshape(-1)[0])
    assert contacts.shape == rows.shape == iterations.shape == (2,)
    assert contacts.min() >= 4, "two robots stand on their wheels in each world"
    assert (rows >= 3 * contacts).all()
    assert iterations.min() >= 1
    # Warp only sets bits of overflow: an old one must not count again in every later step.
    full = state.replace(physics=state.physics.tree_replace({"_impl.overflow": jnp.array([1, 0])}))
    assert np.asarray(batch.engine.overflow(full.physics, None)).tolist() == [1, 0]
    assert np.asarray(batch.step(full).worlds.faults.overflow).tolist() == [0, 0]


def test_the_robots_really_met_the_ramp_and_the_step(reference):
    on_the_flat = 0.26
    assert (reference[0, :, 2] > on_the_flat + 0.01).all(), "one climbs the ramp, the other the step"


def test_c_batch_is_plain_mj_step(scene):
    """The engine adds nothing to MuJoCo: same model, same inputs, same double-precision state."""
    batch = Batch(scene, 1, engine="c", seed=3)
    state = batch.drive(batch.reset(), 0, {"Left": 2.0, "Right": 2.0})
    data = mujoco.MjData(batch.engine.model)
    data.qpos[:] = state.physics.qpos[0]
    for _ in range(5):
        _, inputs = batch._compute_inputs(state.worlds, batch.physics(state))
        data.ctrl[:], data.act[:] = np.asarray(inputs.ctrl[0]), np.asarray(inputs.act[0])
        mujoco.mj_step(batch.engine.model, data, nstep=scene.physics.substeps)
        state = batch.step(state)
        np.testing.assert_array_equal(state.physics.qpos[0], data.qpos)
        met = [int(count[0]) for count in batch.engine.solved(state.physics)]
        assert met == [data.ncon, data.nefc, data.solver_niter[0]]


@pytest.mark.thorough
def test_a_world_alone_is_the_world_in_a_batch(scene, jax_batch, driven):
    alone = Batch(scene, 1, engine="jax", seed=3, first=1)
    state = drive_for(alone)
    np.testing.assert_allclose(roots(alone, state)[0], roots(jax_batch, driven)[1], atol=ALONE)
    np.testing.assert_array_equal(
        jax.random.key_data(state.worlds.key[0]), jax.random.key_data(driven.worlds.key[1])
    )


P2AT = ROBOTS.get("P2AT")
SEEING = replace(P2AT, cameras=(), sensors=(P2AT.sensors[3], *(m for m in P2AT.sensors if m.kind != "Sonar")))
"""One of its sonars, which looks ahead, and the others of its sensors, compile faster than all."""


def first_readings(worlds, first=0):
    """Return the readings of robots at the start of an episode."""
    batch = Batch(build_scene(COURSE, [SEEING]), worlds, engine="c", seed=5, first=first)
    return batch.observe(batch.reset())[1]


@pytest.fixture(scope="module")
def three_worlds():
    return first_readings(3)


def test_noise_draws_do_not_depend_on_the_batch(three_worlds):
    """Bit-equal: same world number, same step, same robot, same sensor; other worlds differ."""
    one = first_readings(1, first=2)
    for a, b in zip(jax.tree.leaves(three_worlds), jax.tree.leaves(one), strict=True):
        np.testing.assert_array_equal(np.asarray(a)[2], np.asarray(b)[0])


def test_worlds_draw_different_noise(three_worlds):
    """In sight of a wall the sonars' noise shows, and no two worlds have the same."""
    sonar = np.asarray(three_worlds[0][0].value)
    assert (sonar[0] != sonar[1]).any()


def test_a_partial_reset_leaves_the_other_worlds_bit_exact(jax_batch, driven):
    mask = jnp.array([False, True])
    after = jax_batch.reset_where(driven, mask)
    qpos = np.asarray(jax_batch.physics(after).qpos)
    np.testing.assert_array_equal(qpos[0], np.asarray(jax_batch.physics(driven).qpos)[0])
    np.testing.assert_array_equal(qpos[1], np.asarray(jax_batch.physics(jax_batch.reset()).qpos)[1])
    for new, old in zip(
        jax.tree.leaves(after.worlds.groups), jax.tree.leaves(driven.worlds.groups), strict=True
    ):
        np.testing.assert_array_equal(np.asarray(new)[0], np.asarray(old)[0])
    assert np.asarray(after.worlds.episode).tolist() == [0, 1]


@pytest.mark.parametrize("engine", ["jax", "c"])
def test_a_world_that_goes_bad_is_counted_and_reset_and_no_other_notices(scene, jax_batch, engine):
    batch = jax_batch if engine == "jax" else Batch(scene, 2, engine="c", seed=3)
    start = batch.drive(batch.reset(), 0, {"Left": 2.0, "Right": 2.0})
    broken_qpos = np.asarray(batch.physics(start).qpos).copy()
    broken_qpos[1, 0] = np.nan
    pinned = np.zeros_like(broken_qpos, bool)
    pinned[1, 0] = True
    no_dof = np.zeros(np.asarray(batch.physics(start).qvel).shape, bool)
    broken = start.replace(physics=batch.engine.set_qpos(start.physics, pinned, no_dof, broken_qpos))
    good, bad = batch.step(start), batch.step(broken)
    assert np.asarray(bad.worlds.faults.not_finite).tolist() == [0, 1]
    assert np.asarray(bad.worlds.episode).tolist() == [0, 1]
    assert np.isfinite(np.asarray(batch.physics(bad).qpos)).all()
    np.testing.assert_array_equal(
        np.asarray(batch.physics(bad).qpos)[0], np.asarray(batch.physics(good).qpos)[0]
    )


@pytest.mark.every_run("c", "planar")
@pytest.mark.parametrize("engine", ["jax", "c", "planar"])
def test_a_world_that_goes_bad_can_go_on_from_where_it_was(flat, engine):
    """For who resets it afterwards: its episode goes on, at rest, and no other world notices."""
    batch = Batch(flat, 2, engine=engine, seed=3)
    start = drive_for(batch, steps=3)
    physics, where = start.physics, np.asarray(batch.physics(start).qpos)[1]
    if engine == "c":
        integration = physics.integration.copy()
        integration[1, 1 + batch.scene.model.nq] = np.nan
        physics = physics._replace(integration=integration)
    elif engine == "jax":
        physics = physics.replace(qvel=physics.qvel.at[1, 0].set(np.nan))
    else:  # there only a place that is not finite stays so: it cannot go on from that
        physics, where = physics.replace(qpos=physics.qpos.at[1].set(np.nan)), np.float32(flat.model.qpos0)
    step = partial(batch.run, steps=1, reset_bad=False)
    if batch.engine.traceable:
        step = jax.jit(step)
    good, bad = (step(state) for state in (start, start.replace(physics=physics)))
    assert np.asarray(bad.worlds.faults.not_finite).tolist() == [0, 1]
    assert np.asarray(bad.worlds.episode).tolist() == [0, 0]
    after = batch.physics(bad)
    np.testing.assert_array_equal(np.asarray(after.qpos)[1], where)
    assert not np.asarray(after.qvel)[1].any()
    np.testing.assert_array_equal(np.asarray(after.qpos)[0], np.asarray(batch.physics(good).qpos)[0])
    again = batch.physics(step(step(bad)))
    assert np.isfinite(np.asarray(again.qpos)).all()


def test_commands_that_are_not_finite_reach_nobody(jax_batch):
    state = jax_batch.drive(
        jax_batch.reset(), 0, {"Left": jnp.array([[jnp.nan, 2.0], [2.0, 2.0]]), "Right": 2.0}
    )
    state = jax_batch.step(state)
    assert np.asarray(state.worlds.faults.refused).tolist() == [2, 0]  # two left wheels of one robot
    assert np.asarray(state.worlds.faults.not_finite).tolist() == [0, 0]


def test_one_compilation_serves_all_steps(jax_batch, driven):
    del driven
    assert jax_batch._step_program._cache_size() == 1


def test_jax_tells_what_its_solver_met(jax_batch, driven):
    contacts, rows, iterations = jax_batch.engine.solved(driven.physics)
    assert np.asarray(contacts).shape == (2,)
    assert np.asarray(contacts).min() >= 4, "each robot stands on its wheels"
    assert (np.asarray(rows) >= 3 * np.asarray(contacts)).all()
    assert iterations is None


def test_overflow_is_an_error_that_names_the_setting(jax_batch, driven):
    jax_batch.check_overflow(driven)
    counted = driven.worlds.faults.replace(overflow=jnp.array([0, 2]))
    with pytest.raises(EngineError, match=r"1 of 2 worlds; raise Physics.contacts_per_robot"):
        jax_batch.check_overflow(driven.replace(worlds=driven.worlds.replace(faults=counted)))


def test_there_is_room_for_the_contacts_of_what_lies_loose():
    """A robot alone in a maze: there are no others whose room is left over."""
    (arena,) = generate_many("maze", 1, seed=0, size=(8, 6), starts=4)
    boxes = len(arena.loose)
    assert boxes >= 4
    lie = 4 * 2 + boxes * 4  # two for each of its wheels, cylinders on a plane, and a box's four corners
    room = build_scene(arena, ["P2AT"]).model.numeric("max_contact_points").data[0]
    assert room > 1.25 * lie


def test_jax_counts_a_full_contact_buffer():
    tight = build_scene(FLAT, ["ComStation"], Physics(contacts_per_robot=2))
    batch = Batch(tight, 1, engine="jax")
    state = batch.step(batch.step(batch.reset()))
    assert int(state.worlds.faults.overflow[0]) > 0
    with pytest.raises(EngineError, match="overflowed"):
        batch.check_overflow(state)


@pytest.mark.parametrize(
    ("names", "cap"),
    [
        (("P2AT", "P2AT"), 10),
        (("Hummer",), 10),
        (("Soryu",), 30),
        (("Talon",), 30),
        (("kenaf", "P2AT"), 30),
        (("P2AT", "Hummer"), 30),
    ],
)
def test_jax_gives_its_solver_more_iterations_for_long_chains_and_uneven_masses(names, cap):
    """With 10 a Soryu turns on the spot almost twice as far as it should, and light robots drift."""
    scene = build_scene(FLAT, [replace(ROBOTS.get(name), sensors=(), cameras=()) for name in names])
    assert Batch(scene, 1, engine="jax").engine.model.opt.iterations == cap
    for other in ("c", "planar"):
        assert Batch(scene, 1, engine=other).engine.model.opt.iterations == 10
    many = replace(scene.physics, iterations=50)
    again = build_scene(FLAT, [ROBOTS.get(name) for name in names], many)
    assert Batch(again, 1, engine="jax").engine.model.opt.iterations == 50


def block(name, mass, at):
    """A cube of 20 cm."""
    return LooseObject(
        name=name, at=at, shapes=(Shape(kind="box", size=(0.1, 0.1, 0.1), surface="loose", mass=mass),)
    )


TREMBLE = 2e-3
"""Speed of a light block that stands beside a heavy one that slides, on `jax` [m/s]. It is 4e-4; by the
solver's forces it was 9e-3."""
SINGLE = 2e-6
"""Rounding of a height that is summed up in single precision [m]. By accelerations alone a block that falls
beside a heavy one is out by 8e-5."""


@pytest.fixture(scope="module")
def blocks_on_jax():
    """Blocks on the floor, a heavy and a light one, and one that falls; both speeds share its programs."""
    heavy, light = block("heavy", 2000.0, (0.0, 0.0, 0.1)), block("light", 0.3, (1.0, 0.0, 0.1))
    arena = replace(FLAT, loose=(heavy, light, block("falls", 0.3, (2.0, 0.0, 2.0))))
    return Batch(build_scene(arena, []), 1, engine="jax")


@pytest.mark.parametrize("speed", [0.0, 2.0])
def test_on_jax_light_things_stand_and_fall_as_alone_beside_a_heavy_one(blocks_on_jax, speed):
    """By C MuJoCo, how deep each sinks in; in closed form, how far one falls."""
    batch = blocks_on_jax
    model = batch.engine.model
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 300)
    joints = [model.body(f"loose/{name}").jntadr[0] for name in ("heavy", "light", "falls")]
    z, vz = model.jnt_qposadr[joints] + 2, model.jnt_dofadr[joints] + 2
    start = model.qpos0.astype(np.float32)
    start[z[:2]] = data.qpos[z[:2]]
    state = batch.reset()
    engine_state = batch.engine.reset(state.physics, np.ones(1, bool), start[None])
    slides = engine_state.qvel.at[0, vz[0] - 2].set(speed)
    state = state.replace(physics=engine_state.replace(qvel=slides))
    for step in range(1, 21):
        state = batch.step(state)
        physics, count = batch.physics(state), step * batch.scene.physics.substeps
        assert np.abs(physics.qvel[0, vz[1] - 2 : vz[1] + 4]).max() < TREMBLE, step
        way = 9.81 * batch.scene.physics.timestep**2 * count * (count + 1) / 2
        assert float(physics.qpos[0, z[2]]) == pytest.approx(2.0 - way, abs=SINGLE), step


def test_on_jax_a_wall_that_reaches_below_the_floor_takes_no_contacts_from_it():
    """MJX alone pairs the floor with the arena, a mocap body; those 2 m deep would fill the buffer."""
    wall = Shape(kind="box", size=(0.1, 5.0, 2.0), at=(1.5, 0.0, 0.0))
    scene = build_scene(replace(FLAT, shapes=(wall,)), ["ComStation"])
    batch = Batch(scene, 1, engine="jax")
    state = batch.reset()
    height = [float(batch.physics(state).qpos[0, scene.groups[0].root_qposadr[0, 2]])]
    for _ in range(25):
        state = batch.step(state)
    height.append(float(batch.physics(state).qpos[0, scene.groups[0].root_qposadr[0, 2]]))
    batch.check_overflow(state)
    assert height[1] == pytest.approx(height[0], abs=1e-3), "it stands"


@pytest.mark.parametrize(
    ("xml", "engine", "named"),
    [
        *(('<geom size=".1" surfacevel="1 0 0 0 0 0"/>', name, "geom_surfacevel") for name in OTHER_ENGINES),
        ('<geom name="pipe" type="cylinder" size=".1 .1"/>', "jax", "pipe"),
    ],
)
def test_features_that_an_engine_ignores_are_refused_by_name(xml, engine, named):
    body = '<body pos="0 0 1"><freejoint/><geom name="ball" size=".1"/></body>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{xml}{body}</worldbody></mujoco>")
    with pytest.raises(UnsupportedFeatureError, match=named):
        check_features(model, engine)
    check_features(model, "c")


def test_joint_armature_is_not_the_actuator_attribute_that_engines_ignore(scene):
    for engine in ("c", "jax", "warp"):
        check_features(scene.model, engine)


def test_bad_requests_say_what_is_allowed(scene):
    with pytest.raises(UsageError, match="at least one world"):
        Batch(scene, 0, engine="c")
    with pytest.raises(UnknownNameError, match="c, jax, planar, warp"):
        Batch(scene, 1, engine="karma")


WEDGE = Mesh(vertices=np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0), (1, 0, 0.3), (1, 1, 0.3)], float))
HILL = HeightField(heights=np.array([(0.0, 0.1), (0.0, 0.0)]))


@pytest.mark.parametrize(
    "shape",
    [
        Shape(kind="mesh", mesh=WEDGE, surface="ground"),
        Shape(kind="hfield", size=(2, 2, 0.1), heights=HILL, surface="ground"),
    ],
    ids=lambda shape: shape.kind,
)
def test_wheels_on_meshes_and_terrain_are_refused_by_jax_alone(shape):
    arena = replace(ARENAS.get("field"), name="uneven", shapes=(shape,))
    model = build_scene(arena, ["P2AT"]).model
    with pytest.raises(UnsupportedFeatureError, match=r"Wheel.*refused"):
        check_features(model, "jax")
    for engine in ("c", "warp"):
        check_features(model, engine)
