"""Effecters and loose objects in batches: operations per world and robot, tags, rays, engines."""

import math
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from tests.arenas import FLAT, RAMP, STEP
from tests.handy import GRABBER, TAGGER, block, known
from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.models.compile.parts import joint_names
from usarmjx.models.compile.physics import Physics
from usarmjx.models.effecters import MAX_DROPPED_TAGS
from usarmjx.models.effecters.standard import LEVER
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.arena import StartPose
from usarmjx.models.types.robot import Mount, options
from usarmjx.models.types.shapes import Shape
from usarmjx.sim.batch import Batch
from usarmjx.sim.operate import NO_NUMBER
from usarmjx.sim.scene import build_scene
from usarmjx.sim.world import sense

WORLDS, ROBOTS = 3, 2
STACKER = replace(
    P2AT,
    name="Stacker",
    sensors=(),
    effecters=(Mount(kind="RFIDReleaser", name="Gun", options=options(NumTags=40)),),
)
ANYWHERE = (WORLDS, ROBOTS)


@pytest.fixture(scope="module", autouse=True)
def robots():
    with known(GRABBER, TAGGER, STACKER):
        yield


@pytest.fixture(scope="module")
def batch():
    """Three worlds, two taggers in each: one beside, one on a ramp."""
    starts = (
        StartPose(tag="A", at=(0.0, -2.0, 0.188), yaw=0.5),
        StartPose(tag="B", at=(1.0, 0.0, 0.4), yaw=2.0),
    )
    arena = replace(FLAT, name="ramped", floor=-0.4, shapes=(RAMP, STEP), starts=starts)
    return Batch(build_scene(arena, ["Tagger"] * ROBOTS), WORLDS, engine="c", seed=3)


@pytest.fixture(scope="module")
def fresh(batch):
    return batch.reset()


def members(state):
    return state.worlds.groups[0]


# Operations


def test_a_value_per_world_and_robot_reaches_the_fingers_and_bad_ones_fail(batch, fresh):
    angles = np.array([[0.5, 1.0], [1.7, np.nan], [0.0, 1.57]], np.float32)
    state, outcome = batch.operate(fresh, 0, "gripper", "OPEN", angles)
    fine = np.array([[True, True], [False, False], [True, True]])
    np.testing.assert_array_equal(outcome.done, fine)
    assert (np.asarray(outcome.number) == NO_NUMBER).all()
    expected = np.where(fine, LEVER * np.sin(angles / 2), 0.0)
    for name in ("LeftFinger", "RightFinger"):
        told = members(state).command.target[..., joint_names(TAGGER).index(name)]
        np.testing.assert_allclose(told, expected, atol=1e-6)


def test_the_mask_says_who_does_it(batch, fresh):
    where = np.array([[True, False], [False, False], [True, True]])
    state, outcome = batch.operate(fresh, 0, "Lamp", "activate", where=where)
    np.testing.assert_array_equal(outcome.done, where)
    np.testing.assert_array_equal(members(state).command.light, where)
    state, outcome = batch.operate(state, 0, "Lamp", "Activate", 0.0, where=np.array([True, False]))
    np.testing.assert_array_equal(outcome.done, np.broadcast_to([True, False], ANYWHERE))
    np.testing.assert_array_equal(members(state).command.light, where & np.array([False, True]))


def test_other_joints_keep_their_orders(batch, fresh):
    driven = batch.drive(fresh, 0, {"Left": 2.0, "Right": 1.0})
    state, _ = batch.operate(driven, 0, "Gripper", "Open", 1.0)
    fingers = slice(-2, None)
    np.testing.assert_array_equal(
        np.delete(members(state).command.target, [-2, -1], axis=-1),
        np.delete(members(driven).command.target, [-2, -1], axis=-1),
    )
    assert (np.asarray(members(state).command.target)[..., fingers] > 0).all()


def test_the_command_moves_the_fingers(batch, fresh):
    state, _ = batch.operate(
        fresh, 0, "Gripper", "Open", 1.0, where=np.array([[True, True], [True, False], [False] * 2])
    )
    for _ in range(60):
        state = batch.step(state)
    group = batch.scene.groups[0]
    fingers = np.asarray(batch.physics(state).qpos)[:, group.qposadr[:, -2:]]
    open_ = LEVER * math.sin(0.5)
    expected = np.array([[open_, open_], [open_, 0.0], [0.0, 0.0]])[..., None]
    np.testing.assert_allclose(fingers, np.broadcast_to(expected, fingers.shape), atol=5e-4)


@pytest.mark.parametrize(
    ("name", "opcode", "error", "message"),
    [
        ("Welder", "Open", UnknownNameError, "Tagger has no effecter 'Welder'; it has: Gun, Lamp, Gripper"),
        ("Lamp", "Fire", UnknownNameError, "Headlight Lamp has no opcode 'Fire'; it has: Activate"),
        ("Gripper", "Open", UsageError, "Open of Gripper needs a value"),
    ],
)
def test_what_cannot_be_asked_is_named(batch, fresh, name, opcode, error, message):
    with pytest.raises(error, match=message):
        batch.operate(fresh, 0, name, opcode)


def test_robots_without_power_and_parked_ones_fail(batch, fresh):
    group = members(fresh)
    dead = group.replace(
        active=group.active.at[0, 0].set(False),
        battery_start=group.battery_start.at[1, 1].set(round(-2 * TAGGER.battery_life / 0.02)),
        drowned=group.drowned.at[2, 0].set(True),
    )
    state, outcome = batch.operate(batch.with_group(fresh, 0, dead), 0, "Gun", "Release")
    expected = np.array([[False, True], [True, False], [False, True]])
    np.testing.assert_array_equal(outcome.done, expected)
    np.testing.assert_array_equal(members(state).releases[..., 0], 3 - expected)


# RFID releaser


def test_a_tag_lies_on_the_ground_below_its_releaser(batch, fresh):
    """Oracle: C MuJoCo's forward kinematics of the chassis, and its ray onto floor and ramp."""
    state, outcome = batch.operate(fresh, 0, "Gun", "Release")
    assert np.asarray(outcome.done).all()
    model, group = batch.scene.model, batch.scene.groups[0]
    data = mujoco.MjData(model)
    model = model.__copy__()
    robots = model.geom_bodyid >= 2
    model.geom_rgba[robots, 3] = 0.0  # C's rays pass what is fully transparent
    tags = state.worlds.tags
    for world in range(WORLDS):
        data.qpos[:] = batch.physics(state).qpos[world]
        mujoco.mj_kinematics(model, data)
        for robot, body in enumerate(group.chassis):
            gun = data.xpos[body] + data.xmat[body].reshape(3, 3) @ (-0.3, -0.1, 0.1)
            hit = np.zeros(1, np.int32)
            depth = mujoco.mj_ray(model, data, gun, (0.0, 0.0, -1.0), None, 1, -1, hit)
            np.testing.assert_allclose(tags.pos[world, robot], gun - (0, 0, depth), atol=1e-5)
    assert tags.pos[0, 0, 2] == pytest.approx(-0.4, abs=1e-6), "on the floor"
    assert tags.pos[0, 1, 2] > -0.39, "on the ramp"
    np.testing.assert_array_equal(tags.count, [2] * WORLDS)


def test_a_releaser_counts_runs_out_and_is_reloaded(batch, fresh):
    state, first = fresh, np.array([True, False])
    for left in (3, 2, 1, 0):
        state, outcome = batch.operate(state, 0, "Gun", "TagsRemaining", where=first)
        np.testing.assert_array_equal(outcome.number, np.broadcast_to([left, NO_NUMBER], ANYWHERE))
        state, outcome = batch.operate(state, 0, "Gun", "Release", where=first)
        np.testing.assert_array_equal(outcome.done, np.broadcast_to([left > 0, False], ANYWHERE))
    np.testing.assert_array_equal(state.worlds.tags.count, [3] * WORLDS)
    state, _ = batch.operate(state, 0, "Gun", "Reset")
    np.testing.assert_array_equal(members(state).releases[..., 0], np.full(ANYWHERE, 3))
    state, outcome = batch.operate(state, 0, "Gun", "Release")
    assert np.asarray(outcome.done).all()
    np.testing.assert_array_equal(state.worlds.tags.count, [5] * WORLDS)


def test_restarting_a_world_takes_its_tags_away_and_reloads_its_robots(batch, fresh):
    state, _ = batch.operate(fresh, 0, "Gun", "Release")
    state = batch.reset_where(state, jnp.array([False, True, False]))
    np.testing.assert_array_equal(state.worlds.tags.count, [2, 0, 2])
    np.testing.assert_array_equal(members(state).releases[:, 0, 0], [2, 3, 2])


def test_a_world_has_room_for_so_many_tags_and_each_a_place_of_its_own():
    batch = Batch(build_scene(FLAT, ["Stacker"] * 2), 1, engine="c")
    state, before = batch.reset(), -1
    for _ in range(40):
        state, outcome = batch.operate(state, 0, "Gun", "Release")
        count = int(state.worlds.tags.count[0])
        assert np.asarray(outcome.done).sum() == count - max(before, 0)
        before = count
    assert before == MAX_DROPPED_TAGS
    assert not np.asarray(outcome.done).any()
    expected = np.resize(
        [[0.0, 0.0, 0.0], [0.0, 2.0, 0.0]], (MAX_DROPPED_TAGS, 3)
    )  # the robots' places in turn
    np.testing.assert_allclose(state.worlds.tags.pos[0], expected, atol=1e-5)
    assert np.asarray(members(state).releases).sum() == 80 - MAX_DROPPED_TAGS, (
        "what had no room was not used up"
    )


# Loose objects

PILE = replace(
    FLAT,
    name="pile",
    floor=0.3,
    loose=(
        block((1.0, 0.1, 0.1), (0.05, 0.3, 0.1), 1.0, "plank"),
        replace(
            block((0.0, 1.2), name="heap"),
            rotation=(0.2, -0.4, 1.1),
            at=(0.9, 0.9, 0.4),
            shapes=(
                Shape(kind="box", size=(0.2, 0.05, 0.1), at=(0.1, 0.0, 0.0), mass=0.5, surface="loose"),
                Shape(kind="sphere", size=(0.12,), at=(0.0, 0.1, 0.1), mass=0.5, surface="loose"),
                Shape(
                    kind="capsule",
                    size=(0.05, 0.2),
                    at=(0.0, 0.0, 0.2),
                    rotation=(1.0, 0.3, 0.0),
                    mass=0.2,
                    surface="loose",
                ),
            ),
        ),
        block((-0.8, -0.5, 0.3), (0.1, 0.1, 0.3), 3.0, "post"),
    ),
)


def loose_qpos(batch, state):
    return np.asarray(batch.physics(state).qpos)[:, batch.scene.loose_geoms.root_qposadr]


@pytest.fixture(scope="module")
def pile():
    return Batch(build_scene(PILE, ["P2AT"]), 2, engine="c")


def test_loose_objects_start_where_the_arena_has_them_and_go_back_there(pile):
    state = start = pile.reset()
    for _ in range(25):
        state = pile.step(state)
    assert np.abs(loose_qpos(pile, state)[:, 1] - loose_qpos(pile, start)[:, 1]).max() > 0.1, "the heap fell"
    state = pile.reset_where(state, jnp.array([True, False]))
    back = loose_qpos(pile, state)
    np.testing.assert_array_equal(back[0], loose_qpos(pile, start)[0])
    assert np.abs(back[1] - back[0]).max() > 0.1
    np.testing.assert_allclose(back[0, :, 2] - 0.3, [0.1, 0.4, 0.3], atol=1e-6)  # heights above the floor


@pytest.fixture(scope="module")
def look_around(pile):
    # Without XLA's optimiser, which would take longer than all the rays.
    return jax.jit(partial(sense, pile.scene), compiler_options={"xla_backend_optimization_level": 0})


@pytest.mark.thorough
@pytest.mark.oracle
@pytest.mark.parametrize("seed", [0, 1])
def test_sonar_and_scanner_see_loose_objects_as_c_mujoco_does(pile, look_around, seed):
    """All rays of a P2AT among objects in random poses; those that graze an edge are left out."""
    random, scene = np.random.default_rng(seed), pile.scene
    state = pile.reset()
    physics = jax.tree.map(lambda x: np.array(x[0]), pile.physics(state))
    for root in scene.loose_geoms.root_qposadr:
        quat = random.normal(size=4)
        physics.qpos[root] = (
            *random.uniform(-1.2, 1.2, 2),
            random.uniform(0.4, 0.8),
            *quat / np.linalg.norm(quat),
        )
    world = jax.tree.map(lambda x: x[0], state.worlds)
    (sensor_input,) = look_around(world, physics)
    group = scene.groups[0]
    origins, directions = group.suite.rays(jax.tree.map(lambda x: x[0], sensor_input.bodies))
    seen = np.asarray(sensor_input.hits.distance[0])
    aimed = np.asarray(directions).any(-1)  # no RFID tag is in reach; C would end the process
    assert np.isinf(seen[~aimed]).all()
    origins, directions, seen = origins[aimed], directions[aimed], seen[aimed]
    assert len(seen) == 181 + 144  # the scanner's, and the cones of 16 sonars

    model, data = scene.model, mujoco.MjData(scene.model)
    data.qpos[:] = physics.qpos
    mujoco.mj_kinematics(model, data)
    own = np.isin(model.geom_bodyid, group.indices[0].body_ids)
    model = model.__copy__()
    model.geom_rgba[own, 3] = 0.0  # a robot's own solids are transparent to it, as to C's rays these are

    def oracle(nudge):
        ranges, met = np.zeros(len(seen)), np.zeros(len(seen), bool)
        for i, (origin, along) in enumerate(zip(origins, directions, strict=True)):
            hit = np.zeros(1, np.int32)
            start = np.asarray(origin, float) + nudge
            ranges[i] = mujoco.mj_ray(model, data, start, np.asarray(along, float), None, 1, -1, hit)
            met[i] = hit[0] >= 0 and model.geom(hit[0]).name.startswith("loose/")
        # A robot at rest tilts by 2e-5 rad: its level rays meet the floor 15 km away, beyond every sensor.
        return np.where((ranges < 0) | (ranges > 1000.0), np.inf, ranges), met

    (ranges, met), (nudged, _) = oracle(0.0), oracle(1e-4)
    with np.errstate(invalid="ignore"):
        clear = ~(np.abs(nudged - ranges) > 3e-3) & (np.isinf(nudged) == np.isinf(ranges))
    assert met.sum() > 20
    assert clear.mean() > 0.9
    np.testing.assert_allclose(seen[clear], ranges[clear], atol=2e-4)  # float32 over a few metres


CONVERGED = replace(Physics(), solver="Newton", iterations=100, ls_iterations=50)


@pytest.mark.oracle
@pytest.mark.slow
@pytest.mark.parametrize(
    ("engine", "physics", "on_c", "tolerance"),
    [
        ("jax", Physics(), Physics(), 5e-3),
        # Both solve to the end: apart by 1e-5 after 9 s, in single and in double precision.
        ("warp", replace(Physics(), solver="block"), CONVERGED, 1e-4),
    ],
)
def test_a_block_that_a_robot_pushes_takes_lifts_and_holds_moves_as_on_c(engine, physics, on_c, tolerance):
    """Nine seconds, most in contact with floor, palm and fingers; their gear is among what must agree."""
    arena = replace(FLAT, name="push", loose=(block((0.5, 0.0)),))
    final = []
    for name, settings in (("c", on_c), (engine, physics)):
        batch = Batch(build_scene(arena, ["Grabber"], settings), 1, engine=name)
        group = batch.scene.groups[0]

        def run(state, seconds, batch=batch):
            for _ in range(round(seconds / batch.scene.physics.period)):
                state = batch.step(state)
            return state

        state, _ = batch.operate(batch.reset(), 0, "Gripper", "Open", 1.2)
        state = run(batch.drive(run(state, 1.0), 0, {"Left": 2.0, "Right": 2.0}), 1.2)
        pushed = loose_qpos(batch, state)[0, 0, 0]
        state = batch.drive(state, 0, {"Left": 0.0, "Right": 0.0})
        state, _ = batch.operate(state, 0, "Gripper", "Open", 0.0)
        state = run(batch.move(run(state, 1.2), 0, {"Lift_Link1": -0.2}), 1.6)
        lifted = loose_qpos(batch, state)[0, 0, :3]
        state = run(state, 4.0)
        batch.check_overflow(state)
        qpos = np.asarray(batch.physics(state).qpos)[0]
        held = loose_qpos(batch, state)[0, 0, :3]
        final.append([pushed, *lifted, *held, *qpos[group.root_qposadr[0, :3]], *qpos[group.qposadr[0, -3:]]])
    c, other = final
    assert c[0] > 0.6, "pushed along"
    assert c[3] > 0.2, "lifted"
    assert c[6] > 0.2, "and held"
    np.testing.assert_allclose(other, c, atol=tolerance)
