"""Engine `planar`: what is known of what is around robots is all that matters to them as long as it holds."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from tests.engines.eager import around
from usarmjx.engines.planar.footprints import Footprints, keep_apart
from usarmjx.engines.planar.neighbours import LAYERS, NEAR, ground_of, places_of, stopping
from usarmjx.engines.planar.solids import ground_under, seen_from_above
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
    return seen_from_above(kinds, *(jnp.asarray(part, jnp.float32) for part in (pos, mat, size)))


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
    room = jnp.clip(jnp.minimum(known.free, known.grounded), 0.0, 1.0) * 0.98
    along, way = rng.uniform(0.2, 0.8, shape), rng.uniform(-3, 3, shape)
    ahead = (along * room)[..., None] * jnp.stack([jnp.cos(way), jnp.sin(way)], -1)
    up = (1 - along) * room * np.sign(rng.normal(size=shape))
    later = prints.replace(
        pos=prints.pos + ahead, yaw=prints.yaw + 1.0, low=prints.low + up, high=prints.high + up
    )
    return solids, prints, known, later, room


def test_solids_that_are_left_out_do_not_matter_as_far_as_is_said(moved):
    """A step from there meets what it meets when all is looked up there."""
    solids, _, known, later, room = moved
    anew, moves = jax.jit(around)(later, solids), jnp.ones(later.yaw.shape, bool)
    assert (np.asarray(room) > 0.2).mean() > 0.3, "some may go far"
    assert SOLIDS > 5 * NEAR
    inside = np.asarray(known.free) > 0
    step = later.replace(pos=later.pos + 0.03)

    @jax.jit
    def end(near):
        return keep_apart(later, step, stopping(later, near), moves)

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
    found = np.asarray(ground_of(known.under, 0.0, feet, limit))
    truth = np.asarray(jax.vmap(ground_under, (None, None, 0, 0))(solids, 0.0, feet, limit))
    near = np.asarray(known.went(places_of(later, later.low + later.step)) < known.grounded)[:, None]
    near = np.broadcast_to(near, found.shape)
    assert near.mean() > 0.5
    assert LAYERS < SOLIDS / 10
    assert (truth[near] != 0).mean() > 0.02, "some stand on plates"
    assert np.array_equal(found[near], truth[near])


def test_nothing_is_known_of_robots_that_went_farther_or_whose_solids_moved(moved):
    solids, prints, known, later, room = moved
    del solids

    def holds(now, scene, reach=0.0):
        return bool(
            known.replace(free=known.free + 9.0, grounded=known.grounded + 9.0).holds(now, scene, reach)
        )

    at, scene = places_of(prints, prints.low + prints.step), known.scene
    assert holds(at, scene)
    assert not bool(jax.tree.map(jnp.zeros_like, known).holds(at, scene, 0.0)), "zeros are nothing known"
    assert not holds(at, scene, jnp.zeros(at.shape[:2]).at[3, 1].set(20.0)), "one may go as far in a step"
    assert not holds(at.at[3, 1, 0].add(20.0), scene), "one robot is elsewhere"
    assert not holds(at.at[3, 1, 3].add(20.0), scene), "one is tilted"
    assert not holds(at, scene, reach=30.0)
    del later, room


@pytest.mark.parametrize("arena", ["field", "yellow"])
def test_a_step_leaves_the_state_as_it_was_typed(arena):
    """A weak type in it would have the next step compiled again."""
    batch = Batch(build_scene(arena, ["P2AT"]), 2, engine="planar")
    before = jax.eval_shape(batch.reset)
    after = jax.eval_shape(batch.step, before)

    def types(state):
        return jax.tree.map(lambda x: (x.shape, x.dtype, x.weak_type), state)

    assert types(before) == types(after)
