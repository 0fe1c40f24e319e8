"""Leaving out geoms that a bundle of rays cannot meet changes nothing but the time it takes."""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend.core import jaxprs_in_params

from tests.sensors.rays.test_raycast import make_rays, make_room, quick_jit
from usarmjx.sensors.rays import raycast, raycast_cpu
from usarmjx.sensors.rays.bundles import Fans, bounding_cones, bundled
from usarmjx.sensors.rays.raycast import (
    DEFAULT_QUERY,
    EXCLUDE_NONE,
    RayQuery,
    brute_force_hits,
    cast_rays,
    culled_hits,
    indexed_blocks,
    nearest_hits,
    warp_hits,
)
from usarmjx.sensors.rays.targets import concatenated

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


def on_warp(seen, origin, direction, query=DEFAULT_QUERY):
    pytest.importorskip("warp", reason="needs warp-lang")
    return warp_hits(seen, (origin, direction), query)


@jax.jit
def _brute_force(geoms, origin, direction, owner):
    return brute_force_hits(indexed_blocks(geoms), origin, direction, RayQuery(exclude_owner=owner))


def plain_hits(geoms=ROOM.geoms, owner=EXCLUDE_NONE, rays=(ORIGIN, DIRECTION)):
    """Return the hits of rays that are tested with each geom; one program serves all rooms of a size."""
    return _brute_force(geoms, *rays, jnp.int32(owner))


HOW = {"culled": culled_hits, "warp": on_warp}
WAYS = {"brute force": brute_force_hits, **HOW}


@cache
def caster(how, compact):
    """Blocks of the room and a function of rays, compiled once for all that a query leaves out."""
    kinds = ROOM.geoms.kinds
    seen = indexed_blocks(ROOM.geoms.replace(compact=tuple(compact and kind != 0 for kind in kinds)))
    return seen, jax.jit(partial(HOW[how], seen))


@pytest.mark.every_run(
    "culled-exclude_owner0-False",
    "culled-exclude_owner1-False",
    "warp-exclude_owner0-True",
    "warp-exclude_owner1-True",
)
@pytest.mark.parametrize("compact", [False, True])
@pytest.mark.parametrize("exclude_owner", [EXCLUDE_NONE, 0], ids=["exclude_owner0", "exclude_owner1"])
@pytest.mark.parametrize("how", HOW)
def test_what_is_left_out_is_not_met(how, exclude_owner, compact):
    _, cast = caster(how, compact)
    query, plain = RayQuery(exclude_owner=jnp.int32(exclude_owner)), plain_hits(owner=exclude_owner)
    for bundle in (32, 9, 1):
        found = cast(ORIGIN, DIRECTION, query.replace(bundle_size=bundle))
        np.testing.assert_allclose(found.distance, plain.distance, atol=ATOL)
        np.testing.assert_array_equal(found.geom_index, plain.geom_index)


@pytest.mark.every_run("4")
@pytest.mark.parametrize("count", [1, 4])
def test_fans_that_a_gpu_turns_itself_meet_what_their_rays_meet(count):
    pytest.importorskip("warp", reason="needs warp-lang")
    rng = np.random.default_rng(7)
    mat = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0].astype(np.float32)
    lines = rng.normal(size=(count, 45, 3)).astype(np.float32)
    lines /= np.linalg.norm(lines, axis=-1, keepdims=True)
    fans = Fans(jnp.asarray(rng.uniform(-2, 2, (count, 3)), jnp.float32), jnp.asarray(mat), lines)
    origin, direction = fans.rays()
    np.testing.assert_allclose(direction[-1], mat[-1] @ lines[-1, -1], atol=1e-6)
    seen = indexed_blocks(ROOM.geoms)
    plain = plain_hits(rays=(origin, direction))
    found = jax.jit(lambda pos, mat: warp_hits(seen, Fans(pos, mat, lines)))(fans.pos, fans.mat)
    assert np.isfinite(np.asarray(plain.distance)).mean() > 0.5
    np.testing.assert_array_equal(found.geom_index, plain.geom_index)
    np.testing.assert_allclose(found.distance, plain.distance, atol=ATOL)


@pytest.mark.parametrize("how", HOW)
def test_what_is_out_of_reach_is_not_met(how):
    seen, reach, plain = indexed_blocks(ROOM.geoms), 2.5, plain_hits()
    found = jax.jit(partial(HOW[how], seen))(ORIGIN, DIRECTION, RayQuery(max_distance=reach))
    near = np.asarray(plain.distance) < reach
    assert 0.1 < near.mean() < 0.9
    np.testing.assert_array_equal(found.geom_index, np.where(near, plain.geom_index, -1))
    np.testing.assert_allclose(found.distance, np.where(near, plain.distance, np.inf), atol=ATOL)


@pytest.mark.parametrize("how", WAYS)
def test_rays_that_nobody_wants_meet_nothing(how):
    seen, plain = indexed_blocks(ROOM.geoms), plain_hits()
    cast = jax.jit(partial(WAYS[how], seen, ORIGIN, DIRECTION))
    wanted, unwanted = (cast(RayQuery(wanted=jnp.asarray(wanted))) for wanted in (True, False))
    np.testing.assert_array_equal(wanted.geom_index, plain.geom_index)
    np.testing.assert_allclose(wanted.distance, plain.distance, atol=ATOL)
    assert (np.asarray(unwanted.geom_index) == -1).all()
    assert np.isinf(unwanted.distance).all()


def test_a_cast_that_nobody_wants_has_neither_distance_nor_angle():
    room = make_room(5, ("box", "cylinder"))
    cast = quick_jit(partial(cast_rays, room.geoms, *(x.astype(np.float32) for x in make_rays(room, 6))))
    queries = (RayQuery(incidence=True, wanted=wanted) for wanted in (None, np.bool_(True), np.bool_(False)))
    plain, wanted, unwanted = map(cast, queries)
    assert (np.asarray(plain.cosine) > 0).any()
    jax.tree.map(np.testing.assert_array_equal, wanted, plain)
    assert np.isinf(unwanted.distance).all()
    assert not np.asarray(unwanted.cosine).any()


@pytest.mark.every_run("culled", "warp")
@pytest.mark.parametrize("how", WAYS)
def test_each_robot_of_a_batch_meets_what_it_alone_wants(how):
    """Under two maps, with geoms of their own for each world; the GPU's kernels too."""
    rooms = ROOM.geoms, make_room(8).geoms
    near, far = map(indexed_blocks, rooms)
    blocks = jax.tree.map(lambda *x: jnp.stack(x), *([p.block for p in some] for some in (near, far)))
    excluded, wanted = jnp.array([-2, 0, 5]), jnp.array([[True, False, True], [False, False, True]])

    def world(blocks, wanted):
        seen = [part._replace(block=block) for part, block in zip(near, blocks, strict=True)]

        def robot(slot, wanted):
            return WAYS[how](seen, ORIGIN, DIRECTION, RayQuery(exclude_owner=slot, wanted=wanted))

        return jax.vmap(robot)(excluded, wanted)

    cast = jax.jit(jax.vmap(world))
    found, nothing = cast(blocks, wanted), cast(blocks, wanted & False)
    assert (np.asarray(nothing.geom_index) == -1).all()
    for w, geoms in enumerate(rooms):
        for r, slot in enumerate(excluded):
            alone = np.asarray(plain_hits(geoms, slot).geom_index)
            np.testing.assert_array_equal(found.geom_index[w, r], np.where(wanted[w, r], alone, -1))


@pytest.mark.parametrize(("wanted", "near"), [([True] * 3 + [False], False), ([True] + [False] * 3, True)])
def test_a_cpu_looks_for_near_geoms_where_few_want_it(wanted, near, monkeypatch):
    """A search for near geoms that finds none shows who comes by it; the others meet what they do alone."""
    monkeypatch.setattr(raycast, "CULLING_THRESHOLD", 0)
    monkeypatch.setattr(raycast_cpu, "UNCULLED_RAYS_AT_A_TIME", 2 * len(ORIGIN))  # two casts, then one
    monkeypatch.setattr(raycast_cpu, "_test_near", lambda info, block, bundles, cone, found: found)
    monkeypatch.setattr(raycast_cpu, "MAX_UNCULLED_GEOMS", 0)
    slots = jnp.array([-2, 0, 5, 1])

    def cast(slot, wanted):
        return raycast.nearest_hits(
            ROOM.geoms, ORIGIN, DIRECTION, RayQuery(exclude_owner=slot, wanted=wanted)
        )

    found = np.asarray(jax.jit(jax.vmap(cast))(slots, jnp.array(wanted)).geom_index)
    for one, slot, asked in zip(found, slots, wanted, strict=True):
        alone = plain_hits(owner=slot).geom_index
        np.testing.assert_array_equal(one, alone if asked and not near else -1)


@pytest.mark.parametrize("how", ["brute force", "culled"])
def test_a_cpu_saves_what_no_robot_of_any_world_wants(how):
    """Both maps leave one condition, on whether any of them wants it, about all the work."""
    seen = indexed_blocks(ROOM.geoms)

    def one(slot, wanted):
        return WAYS[how](seen, ORIGIN, DIRECTION, RayQuery(exclude_owner=slot, wanted=wanted))

    args = jnp.zeros((2, 3), jnp.int32), jnp.ones((2, 3), bool)
    outside = equations(
        jax.make_jaxpr(jax.vmap(jax.vmap(one)))(*args).jaxpr, into={"jit", "pjit", "custom_vmap_call"}
    )
    assert [e.invars[0].aval.shape for e in outside if e.primitive.name == "cond"] == [()]
    assert not {"scan", "while"} & {e.primitive.name for e in outside}


def test_a_cpu_goes_over_the_robots_of_all_worlds_that_want_it_in_one_loop():
    """Not all of them in each round: who wants nothing costs nothing, and nobody waits for all others."""
    seen = indexed_blocks(ROOM.geoms)

    def one(slot, wanted):
        return culled_hits(seen, ORIGIN, DIRECTION, RayQuery(exclude_owner=slot, wanted=wanted))

    args = jnp.zeros((2, 3), jnp.int32), jnp.ones((2, 3), bool)
    into = {"jit", "pjit", "custom_vmap_call", "cond"}
    outside = equations(jax.make_jaxpr(jax.vmap(jax.vmap(one)))(*args).jaxpr, into=into)
    loops = [e for e in outside if e.primitive.name in ("while", "scan")]
    assert [e.primitive.name for e in loops] == ["while"]


@pytest.mark.parametrize("how", ["cpu", "warp"])
def test_fans_have_slopes_on_all_roads(how, monkeypatch):
    """Lines of fans are known while compiling, also within what is differentiated."""
    if how == "warp":
        pytest.importorskip("warp", reason="needs warp-lang")
    monkeypatch.setattr(raycast, "CULLING_THRESHOLD", 0)
    monkeypatch.setattr(raycast, "CULLING_GEOMS", 0)
    monkeypatch.setattr(raycast, "warp_in_use", lambda: how == "warp")
    lines = np.stack([np.cos(FAN[::8]), np.sin(FAN[::8]), 0 * FAN[::8]], -1)[None].astype(np.float32)

    geoms = make_room(3, ("box",), each=12).geoms

    @quick_jit
    def ranges(pos):
        fans = Fans(pos[None], jnp.eye(3)[None], lines)
        return cast_rays(geoms, *fans.rays(), fans=fans).distance

    distance, slope = jax.jvp(ranges, (jnp.zeros(3),), (jnp.array([1.0, 0.0, 0.0]),))
    plain = brute_force_hits(indexed_blocks(geoms), jnp.zeros((23, 3)), jnp.asarray(lines[0]))
    np.testing.assert_allclose(distance, plain.distance, atol=ATOL)
    assert np.asarray(slope).any()


def equations(jaxpr, into):
    """All equations of a program and of the calls in it, but not those within other equations."""
    found = []
    for equation in jaxpr.eqns:
        found.append(equation)
        if equation.primitive.name in into:
            for inner in jaxprs_in_params(equation.params):
                found += equations(inner, into)
    return found


def test_a_cone_holds_its_rays():
    start, along = ([bundled(x, 9) for x in vector.T] for vector in (ORIGIN, DIRECTION))
    cone = bounding_cones(start, along)
    start, along = jnp.stack(start, -1), jnp.stack(along, -1)
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
    found = nearest_hits(ROOM.geoms, ORIGIN, DIRECTION)
    geom = jax.tree.map(lambda x: np.asarray(x)[np.maximum(found.geom_index, 0)], concatenated(ROOM.geoms))
    point = np.asarray(ORIGIN + found.distance[:, None] * DIRECTION)
    met = (np.asarray(found.geom_index) >= 0) & (geom.size > 0).all(-1)
    away = np.linalg.norm(point - geom.pos, axis=-1)
    assert met.sum() > 50
    assert (away <= 2 * np.linalg.norm(geom.size, axis=-1) + 1e-3)[met].all()
