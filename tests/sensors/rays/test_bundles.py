"""Leaving out geoms that a bundle of rays cannot meet changes nothing but the time it takes."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.sensors.rays.test_raycast import NOBODY, make_rays, make_room
from usarmjx.sensors.rays.bundles import Fans, bounding_cones, bundled
from usarmjx.sensors.rays.raycast import (
    DEFAULT_QUERY,
    RayQuery,
    brute_force_hits,
    concatenated,
    culled_hits,
    gpu_hits,
    indexed_blocks,
    nearest_hits,
)

ATOL = 1e-5  # m: the same kernels, differently contracted by the compiler

ROOM = make_room(5)
FAN = np.linspace(-1.5, 1.5, 181)


def rays():
    """A fan from the middle of the room, a narrow bundle along a floor, and rays of all sorts."""
    fan = np.stack([np.cos(FAN), np.sin(FAN), 0 * FAN], -1)
    flat = np.stack([np.ones(64), np.linspace(-1e-3, 1e-3, 64), np.zeros(64)], -1)
    flat /= np.linalg.norm(flat, axis=-1, keepdims=True)
    origin, direction = make_rays(ROOM, 6, 200)
    starts = np.concatenate([np.zeros((len(fan), 3)), np.tile([-3.0, 0.0, -2.4999], (64, 1)), origin])
    return (jnp.asarray(x, jnp.float32) for x in (starts, np.concatenate([fan, flat, direction])))


ORIGIN, DIRECTION = rays()


def on_a_gpu(seen, origin, direction, exclude_owner, query=DEFAULT_QUERY, **how):
    return gpu_hits(seen, (origin, direction), exclude_owner, query, interpret=True, **how)


HOW = {"culled": culled_hits, "gpu": on_a_gpu}


@pytest.mark.parametrize("compact", [False, True])
@pytest.mark.parametrize("exclude_owner", [NOBODY, jnp.int32(0)])
@pytest.mark.parametrize("how", HOW)
def test_what_is_left_out_is_not_met(how, exclude_owner, compact):
    kinds = ROOM.geoms.kinds
    seen = indexed_blocks(ROOM.geoms.replace(compact=tuple(compact and kind != 0 for kind in kinds)))
    plain = brute_force_hits(seen, ORIGIN, DIRECTION, exclude_owner)
    for bundle in (32, 9, 1):
        found = jax.jit(partial(HOW[how], seen, query=RayQuery(bundle_size=bundle)))(
            ORIGIN, DIRECTION, exclude_owner
        )
        np.testing.assert_allclose(found.distance, plain.distance, atol=ATOL)
        np.testing.assert_array_equal(found.geom_index, plain.geom_index)


@pytest.mark.parametrize("count", [1, 4])
def test_fans_that_a_gpu_turns_itself_meet_what_their_rays_meet(count):
    rng = np.random.default_rng(7)
    mat = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0].astype(np.float32)
    lines = rng.normal(size=(count, 45, 3)).astype(np.float32)
    lines /= np.linalg.norm(lines, axis=-1, keepdims=True)
    fans = Fans(jnp.asarray(rng.uniform(-2, 2, (count, 3)), jnp.float32), jnp.asarray(mat), lines)
    origin, direction = fans.rays()
    np.testing.assert_allclose(direction[-1], mat[-1] @ lines[-1, -1], atol=1e-6)
    seen = indexed_blocks(ROOM.geoms)
    plain = brute_force_hits(seen, origin, direction, NOBODY)
    found = jax.jit(lambda fans: gpu_hits(seen, fans, NOBODY, interpret=True))(fans)
    assert np.isfinite(np.asarray(plain.distance)).mean() > 0.5
    np.testing.assert_array_equal(found.geom_index, plain.geom_index)
    np.testing.assert_allclose(found.distance, plain.distance, atol=ATOL)


@pytest.mark.parametrize("how", HOW)
def test_what_is_out_of_reach_is_not_met(how):
    seen, reach = indexed_blocks(ROOM.geoms), 2.5
    plain = brute_force_hits(seen, ORIGIN, DIRECTION, NOBODY)
    found = jax.jit(partial(HOW[how], seen, query=RayQuery(max_distance=reach)))(ORIGIN, DIRECTION, NOBODY)
    near = np.asarray(plain.distance) < reach
    assert 0.1 < near.mean() < 0.9
    np.testing.assert_array_equal(found.geom_index, np.where(near, plain.geom_index, -1))
    np.testing.assert_allclose(found.distance, np.where(near, plain.distance, np.inf), atol=ATOL)


@pytest.mark.parametrize("wanted", [False, True])
def test_on_a_gpu_rays_that_nobody_wants_are_not_cast(wanted):
    seen = indexed_blocks(ROOM.geoms)
    found = on_a_gpu(seen, ORIGIN, DIRECTION, NOBODY, wanted=jnp.asarray(wanted))
    assert (np.asarray(found.geom_index) >= 0).any() == wanted


def test_each_world_and_robot_of_a_batch_is_as_alone():
    """The GPU's kernel under two maps, with geoms of their own for each world."""
    near, far = indexed_blocks(ROOM.geoms), indexed_blocks(make_room(8).geoms)
    blocks = jax.tree.map(lambda *x: jnp.stack(x), *([p.block for p in some] for some in (near, far)))
    excluded = jnp.array([-2, 0, 5])

    def world(blocks):
        seen = [part._replace(block=block) for part, block in zip(near, blocks, strict=True)]
        return jax.vmap(lambda v: on_a_gpu(seen, ORIGIN, DIRECTION, v))(excluded)

    found = jax.jit(jax.vmap(world))(blocks)
    for w, seen in enumerate((near, far)):
        for r, exclude_owner in enumerate(excluded):
            alone = brute_force_hits(seen, ORIGIN, DIRECTION, exclude_owner)
            np.testing.assert_array_equal(found.geom_index[w, r], alone.geom_index)


def test_a_cone_holds_its_rays():
    start, along = bundled(ORIGIN, 9), bundled(DIRECTION, 9)
    cone = bounding_cones(start, along)
    tip, axis = jnp.stack(cone.tip, -1)[:, None], jnp.stack(cone.axis, -1)[:, None]
    narrow = np.asarray(cone.slope) >= 0
    assert 0.3 < narrow.mean() < 1
    for reach in (0.0, 1.0, 30.0):
        point = start + reach * along - tip
        height = (point * axis).sum(-1)
        aside = jnp.linalg.norm(point - height[..., None] * axis, axis=-1)
        width = cone.tip_radius[:, None] + jnp.maximum(height, 0) * cone.slope[:, None]
        assert (aside <= width + 1e-4 * reach)[narrow].all()  # 1e-4: rounding of single precision


def test_places_are_those_of_all_blocks_in_a_row():
    found = nearest_hits(ROOM.geoms, ORIGIN, DIRECTION, NOBODY, RayQuery())
    geom = jax.tree.map(lambda x: np.asarray(x)[np.maximum(found.geom_index, 0)], concatenated(ROOM.geoms))
    point = np.asarray(ORIGIN + found.distance[:, None] * DIRECTION)
    met = (np.asarray(found.geom_index) >= 0) & (geom.size > 0).all(-1)
    away = np.linalg.norm(point - geom.pos, axis=-1)
    assert met.sum() > 50
    assert (away <= 2 * np.linalg.norm(geom.size, axis=-1) + 1e-3)[met].all()
