"""Engine `planar`: what is known of what is around robots is all that matters to them as long as it holds."""

import math

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from tests.engines.eager import around
from usarmjx.engines.planar.footprints import Footprints, separate_footprints
from usarmjx.engines.planar.neighbor_lists import (
    GROUND_LIST_LENGTH,
    LARGE_LIST_LENGTH,
    LIST_LENGTH,
    Margin,
    ground_from_list,
    list_poses,
    neighbor_capacity,
    obstacle_outlines,
)
from usarmjx.engines.planar.neighbor_search import SUBSET_DIVISOR, masked_update
from usarmjx.engines.planar.solids import ground_heights, project_geoms
from usarmjx.models.types.arena import ArenaSpec, StartPose, Victim
from usarmjx.models.types.shapes import Shape
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import build_scene

ROBOTS, WORLDS, SOLIDS = 3, 200, 60
REACH = 0.1
"""What `around` counts as near [m]."""


def town(rng):
    """Boxes and drums anywhere, of any height; every third is a plate to drive on, some of these slope."""
    kinds = np.where(np.arange(SOLIDS) % 5 == 4, mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_BOX)
    pos, size = rng.uniform(-4, 4, (SOLIDS, 3)), rng.uniform(0.05, 0.5, (SOLIDS, 3))
    plates = np.arange(SOLIDS) % 3 == 0
    kinds[plates] = mujoco.mjtGeom.mjGEOM_BOX
    size[plates, 2] = 0.05
    pos[:, 2] = np.where(plates, rng.uniform(-0.1, 0.3, SOLIDS), size[:, 2])
    tilt = np.where(plates & (np.arange(SOLIDS) % 2 == 0), rng.uniform(-0.4, 0.4, SOLIDS), 0.0)
    yaw, zero = rng.uniform(-3, 3, SOLIDS), np.zeros(SOLIDS)
    c, s, ct, st = np.cos(yaw), np.sin(yaw), np.cos(tilt), np.sin(tilt)
    mat = np.array([[c * ct, -s, c * st], [s * ct, c, s * st], [-st, zero, ct]]).transpose(2, 0, 1)
    return project_geoms(kinds, *(jnp.asarray(part, jnp.float32) for part in (pos, mat, size)))


@pytest.fixture(scope="module")
def moved():
    """Robots anywhere in the town, what is around them, and the same robots as far away as that may hold."""
    rng = np.random.default_rng(1)
    solids, shape = town(rng), (WORLDS, ROBOTS)
    spread = np.tile([[-2.0, -2.0], [2.0, 0.0], [0.0, 2.0]], (WORLDS, 1, 1))
    low = rng.uniform(0.0, 0.3, shape).astype(np.float32)
    prints = Footprints(
        pos=jnp.asarray(spread + rng.uniform(-1.0, 1.0, (*shape, 2)), jnp.float32),
        yaw=jnp.asarray(rng.uniform(-3, 3, shape), jnp.float32),
        half=jnp.tile(jnp.array([0.3, 0.2]), (*shape, 1)),
        low=jnp.asarray(low),
        high=jnp.asarray(low + 0.3),
        step=jnp.full(shape, 0.03),
        mass=jnp.ones(shape),
    )
    known = jax.jit(around)(prints, solids)
    room = jax.tree.map(
        lambda *each: jnp.clip(jnp.minimum(*each), 0.0, 1.0) * 0.98,
        known.obstacle_margin,
        known.ground_margin,
    )
    way = rng.uniform(-3, 3, shape)
    ahead = room.aside[..., None] * jnp.stack([jnp.cos(way), jnp.sin(way)], -1)
    up = room.height * np.sign(rng.normal(size=shape))
    later = prints.replace(
        pos=prints.pos + ahead, yaw=prints.yaw + 1.0, low=prints.low + up, high=prints.high + up
    )
    return solids, prints, known, later, room


def test_solids_that_are_left_out_do_not_matter_as_far_as_is_said(moved):
    """A step from there meets what it meets when all is looked up there."""
    solids, _, known, later, room = moved
    anew, moves = jax.jit(around)(later, solids), jnp.ones(later.yaw.shape, bool)
    assert (np.asarray(room.aside) > 0.2).mean() > 0.3, "some may go far"
    assert (np.asarray(room.height) > 0.1).mean() > 0.3, "or high"
    assert SOLIDS > 5 * LIST_LENGTH
    inside = np.asarray((known.obstacle_margin.aside > 0) & (known.obstacle_margin.height > 0))
    step = later.replace(pos=later.pos + 0.03)

    @jax.jit
    def end(near):
        return separate_footprints(later, step, obstacle_outlines(later, near), moves)

    (kept, touched), (truth, also) = end(known.near), end(anew.near)
    all_inside = inside.all(-1)
    assert all_inside.mean() > 0.5
    assert np.asarray(also)[all_inside].mean() > 0.05, "some meet something"
    assert np.array_equal(np.asarray(touched)[all_inside], np.asarray(also)[all_inside])
    assert np.asarray(kept.pos)[all_inside] == pytest.approx(np.asarray(truth.pos)[all_inside], abs=1e-5)


def test_the_ground_is_as_high_as_that_under_all_solids(moved):
    solids, _, known, later, _ = moved
    signs = np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)]) * [0.24, 0.16]
    feet = jnp.asarray(later.pos[:, None] + signs[:, None])
    limit = jnp.broadcast_to((later.low + later.step)[:, None], feet.shape[:-1])
    found = np.asarray(ground_from_list(known.under, 0.0, feet, limit))
    truth = np.asarray(jax.vmap(ground_heights, (None, None, 0, 0))(solids, 0.0, feet, limit))
    near = np.asarray(known.ground_is_valid(list_poses(later, later.low + later.step)))[:, None]
    near = np.broadcast_to(near, found.shape)
    assert near.mean() > 0.5
    assert GROUND_LIST_LENGTH < SOLIDS / 10
    assert (truth[near] != 0).mean() > 0.02, "some stand on plates"
    assert np.array_equal(found[near], truth[near])


def test_nothing_is_known_of_robots_that_went_farther_or_whose_solids_moved(moved):
    _, prints, known, _, _ = moved
    assumed, none = known.replace(room=jnp.full_like(known.room, 9.0)), Margin(aside=0.0, height=0.0)
    at, scene = list_poses(prints, prints.low + prints.step), known.scene.loose

    def lost(now, reach=none, around=assumed):
        return np.flatnonzero(~np.asarray(around.stays_valid(now, scene, reach))).tolist()

    every, far = list(range(WORLDS)), jnp.zeros(at.shape[:2]).at[3, 1].set(20.0)
    assert lost(at) == []
    assert lost(at, around=jax.tree.map(jnp.zeros_like, known)) == every, "zeros are nothing known"
    assert lost(at, Margin(aside=far, height=0.0)) == [3], "one may go as far in a step"
    assert lost(at, Margin(aside=0.0, height=far)) == [3], "or as high"
    assert lost(at.at[3, 1, 0].add(20.0)) == [3], "one robot is elsewhere"
    assert lost(at.at[3, 1, 3].add(20.0)) == [3], "one is tilted"
    assert lost(at, Margin(aside=30.0, height=0.0)) == every
    loose = jnp.zeros((WORLDS, 1))
    lying = assumed.replace(scene=known.scene.replace(loose=loose))
    assert np.flatnonzero(~np.asarray(lying.stays_valid(at, loose.at[7].set(1.0), none))) == [7]


def test_what_hangs_over_a_robot_or_is_parked_far_below_keeps_nobody_from_going_on():
    """A lintel 0.1 m over it and more parked boxes than there are layers: only rising, or a wall, ends it."""
    count = LIST_LENGTH + 2 * GROUND_LIST_LENGTH
    pos, size = np.tile([0.0, 0.0, -1000.0], (count, 1)), np.full((count, 3), 0.01)
    pos[: LIST_LENGTH + 1], size[: LIST_LENGTH + 1] = (
        (0.0, 0.0, 0.56),
        (2.0, 2.0, 0.16),
    )  # lintels, from 0.4 to 0.72
    pos[-1], size[-1] = (3.0, 0.0, 0.5), (0.1, 9.0, 0.5)  # a wall, 2.9 m away
    kinds = np.full(count, mujoco.mjtGeom.mjGEOM_BOX)
    solids = project_geoms(kinds, jnp.asarray(pos), jnp.tile(jnp.eye(3), (count, 1, 1)), jnp.asarray(size))
    prints = Footprints(
        pos=jnp.zeros((1, 1, 2)),
        yaw=jnp.zeros((1, 1)),
        half=jnp.full((1, 1, 2), 0.25),
        low=jnp.zeros((1, 1)),
        high=jnp.full((1, 1), 0.3),
        step=jnp.full((1, 1), 0.03),
        mass=jnp.ones((1, 1)),
    )
    look = jax.jit(around)
    known = look(prints, solids)
    assert float(known.obstacle_margin.height[0, 0]) == pytest.approx(0.4 - 0.3, abs=1e-6)
    assert float(known.obstacle_margin.aside[0, 0]) > 100.0, "the wall is among those that are known"
    assert float(known.ground_margin.aside[0, 0]) > 1.0
    assert float(known.ground_margin.height[0, 0]) == pytest.approx(0.72 - 0.03, abs=1e-6)
    assert (np.asarray(known.under.highest) > 0).all(), "none of what is parked"
    there = look(prints.replace(low=prints.low + 0.2, high=prints.high + 0.2), solids)
    assert float(there.obstacle_margin.aside[0, 0]) < 0, "among the lintels: more than it can know"


@pytest.mark.parametrize("needing", [0, 1, 5, 6, 40])
def test_what_worlds_need_is_worked_out_as_if_in_all_and_leaves_the_others_alone(needing):
    worlds = 5 * SUBSET_DIVISOR
    needed = np.random.default_rng(needing).permutation(np.arange(worlds) < needing)
    values = jnp.asarray(np.random.default_rng(1).normal(size=(worlds, 3)), jnp.float32)
    known = {"a": jnp.full((worlds, 3), -1.0), "b": jnp.full(worlds, -1, jnp.int32)}

    def function(row, none):
        assert none is None
        return {"a": row * 2, "b": (row > 0).sum(-1).astype(jnp.int32)}

    found = jax.jit(lambda needed: masked_update(needed, function, known, values, None))(needed)
    for name, truth in function(values, None).items():
        expected = np.where(needed.reshape(-1, *[1] * (truth.ndim - 1)), truth, -1)
        assert np.array_equal(np.asarray(found[name]), expected)


@pytest.mark.every_run("yellow")
@pytest.mark.parametrize("arena", ["field", "yellow"])
def test_a_step_leaves_the_state_as_it_was_typed(arena):
    """A weak type in it would have the next step compiled again."""
    batch = Batch(build_scene(arena, ["P2AT"]), 2, engine="planar")
    before = jax.eval_shape(batch.reset)
    after = jax.eval_shape(batch.step, before)

    def types(state):
        return jax.tree.map(lambda x: (x.shape, x.dtype, x.weak_type), state)

    assert types(before) == types(after)


def test_an_airrobot_takes_off_in_a_corner_beside_a_sitting_victim_whose_limbs_are_all_looked_at():
    """Eleven solids are near it: two walls and nine parts of the victim at its height."""
    corner = ArenaSpec(
        name="corner",
        starts=(StartPose(tag="S", at=(0.0, 0.0, 0.3)),),
        extent=((-4, 4), (-4, 4)),
        shapes=(
            Shape(kind="box", size=(2.0, 0.05, 0.5), at=(0.0, 0.6, 0.5), surface="wall"),
            Shape(kind="box", size=(0.05, 2.0, 0.5), at=(-0.6, 0.0, 0.5), surface="wall"),
        ),
        victims=(Victim(name="Ada", at=(0.7, 0.0, 0.3), rotation=(0.0, 0.0, math.pi), posture="sitting"),),
    )
    batch = Batch(build_scene(corner, ["AirRobot"]), 1, engine="planar")
    state = batch.drive(batch.reset(), 0, {"AltitudeVelocity": 1.0})
    begun = float(batch.physics(state).qpos[0, 2])
    for _ in range(10):
        state = batch.step(state)
        assert not np.asarray(state.physics.omitted).any()
    assert state.physics.neighbors.near.outline.x.shape[1] == LARGE_LIST_LENGTH > LIST_LENGTH
    assert float(batch.physics(state).qpos[0, 2]) > begun + 0.02, "it rises"
    assert not np.asarray(state.worlds.faults.overflow).any()


def test_only_with_a_large_robot_more_is_looked_at():
    assert neighbor_capacity(np.array([[0.25, 0.2], [0.3, 0.3]])) == LIST_LENGTH
    assert neighbor_capacity(np.array([[0.25, 0.2], [0.4, 0.4]])) == LARGE_LIST_LENGTH
