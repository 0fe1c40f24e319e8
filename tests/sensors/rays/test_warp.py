"""Rays on Warp, whose kernels run here on its CPU device: kind by kind, under maps, and who uses them."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.sensors.rays.test_raycast import KINDS, make_rays, make_room, quick_jit
from usarmjx.base import warp_functions
from usarmjx.base.errors import UsageError
from usarmjx.base.installation import install_command
from usarmjx.models.compile.ray_geoms import FENDER_KIND, TRIANGLE_KIND
from usarmjx.sensors.rays.bundles import Fans
from usarmjx.sensors.rays.kernels import RAY_KERNELS
from usarmjx.sensors.rays.raycast import RayQuery, brute_force_hits, indexed_blocks, warp_hits
from usarmjx.sensors.rays.targets import Geoms, make_geoms, normals

pytest.importorskip("warp", reason="needs warp-lang")
from usarmjx.sensors.rays.incidence_warp import cosines_of_hits

ATOL = 1e-5  # m: the same arithmetic, differently contracted by the compilers
RAYS = 300


def geoms_of(kind, rng, count, reach=2.0):
    """Random ones, every other one straight, so that rays along the axes are parallel to faces."""
    turned = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    mat = np.where((np.arange(count) % 2 == 0)[:, None, None], turned, np.eye(3))
    size = rng.uniform(0.1, 1.0, (count, 3))
    pos = rng.uniform(-reach, reach, (count, 3))
    single = (jnp.asarray(x, jnp.float32) for x in (pos, mat, size))
    return make_geoms(np.full(count, kind), *single, jnp.arange(count) % 3 - 1)


def rays_at(rng, count=RAYS, reach=2.0):
    start, along = rng.uniform(-reach, reach, (count, 3)), rng.normal(size=(count, 3))
    along[::5] = np.eye(3)[rng.integers(3, size=len(along[::5]))]
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    return (jnp.asarray(x, jnp.float32) for x in (start, along))


@pytest.mark.parametrize("kind", RAY_KERNELS)
def test_each_kind_is_met_as_on_jax(kind):
    rng = np.random.default_rng(kind)
    seen, rays = indexed_blocks(geoms_of(kind, rng, 50)), tuple(rays_at(rng))
    plain = quick_jit(partial(brute_force_hits, seen))(*rays)
    assert 0.05 < np.isfinite(np.asarray(plain.distance)).mean() < 1
    found = warp_hits(seen, rays)
    same = np.asarray(found.geom_index) == plain.geom_index
    assert (~same).sum() <= 1  # a ray along an edge may slip by on one of them
    np.testing.assert_allclose(found.distance[same], plain.distance[same], atol=ATOL)


def test_kinds_are_those_of_jax():
    """One that is missing would be met by no ray."""
    assert set(RAY_KERNELS) == {*map(int, KINDS.values()), TRIANGLE_KIND, FENDER_KIND}


@pytest.mark.oracle
def test_casts_match_c_mujoco():
    room = make_room(3)
    rays = make_rays(room, 103)
    distance, _, clear = room.oracle(*rays)
    single = tuple(jnp.asarray(x, jnp.float32) for x in rays)
    found = np.asarray(warp_hits(indexed_blocks(room.geoms), single).distance)
    np.testing.assert_allclose(found[clear], distance[clear], atol=1e-4)


def test_more_geoms_than_a_pass_looks_at():
    rng = np.random.default_rng(5)
    seen, rays = indexed_blocks(geoms_of(6, rng, 600, reach=9.0)), tuple(rays_at(rng, reach=9.0))
    plain, found = brute_force_hits(seen, *rays), warp_hits(seen, rays)
    np.testing.assert_array_equal(found.geom_index, plain.geom_index)
    assert len(set(np.asarray(plain.geom_index) // 256)) == 4  # all three passes, and misses


@pytest.mark.parametrize("outer", ["robots", "worlds"])
def test_all_maps_make_one_launch(outer):
    """Robots in worlds, or worlds of each robot: geoms have an axis over worlds, queries one over robots."""
    rng = np.random.default_rng(9)
    worlds, robots = 3, 2
    kinds = [geoms_of(6, rng, 7) for _ in range(worlds)]
    blocks = jax.tree.map(lambda *x: jnp.stack(x), *(g.blocks[0] for g in kinds))
    info = indexed_blocks(kinds[0])[0]
    start, along = rays_at(rng, worlds * robots * 40)
    rays = tuple(x.reshape(worlds, robots, 40, 3) for x in (start, along))
    slots = jnp.arange(robots)

    def one(block, start, along, slot):
        return warp_hits([info._replace(block=block)], (start, along), RayQuery(exclude_owner=slot))

    if outer == "worlds":
        cast = jax.vmap(jax.vmap(one, in_axes=(None, 0, 0, 0)), in_axes=(0, 0, 0, None))
    else:
        cast = jax.vmap(jax.vmap(one, in_axes=(0, 0, 0, None)), in_axes=(None, 1, 1, 0), out_axes=1)
    found = jax.jit(cast)(blocks, *rays, slots)
    lowered = jax.jit(cast).lower(blocks, *rays, slots).as_text()
    assert lowered.count("stablehlo.custom_call @") == 1
    for w in range(worlds):
        for r in range(robots):
            alone = brute_force_hits(
                indexed_blocks(kinds[w]), rays[0][w, r], rays[1][w, r], RayQuery(exclude_owner=slots[r])
            )
            np.testing.assert_array_equal(found.geom_index[w, r], alone.geom_index)
            np.testing.assert_allclose(found.distance[w, r], alone.distance, atol=ATOL)


def test_more_threads_than_can_be_numbered_are_refused():
    """Before anything is allocated: 2^23 casts of 9 bundles are 2.4 billion threads."""
    seen = indexed_blocks(geoms_of(6, np.random.default_rng(1), 3))
    rays = tuple(jnp.ones((9 * 32, 3)) for _ in range(2))
    many = jax.ShapeDtypeStruct((2**23,), jnp.int32)
    cast = jax.vmap(lambda owner: warp_hits(seen, rays, RayQuery(exclude_owner=owner, bundle_size=32)))
    with pytest.raises(UsageError, match=r"8,388,608 casts of 288 rays .* at most 2,147,483,647"):
        jax.eval_shape(cast, many)


def test_where_there_is_nothing_nothing_is_met():
    rays = tuple(rays_at(np.random.default_rng(1)))
    found = warp_hits([], rays)
    assert np.isinf(found.distance).all()
    assert (np.asarray(found.geom_index) == -1).all()


def test_a_gpu_takes_warp_and_says_where_it_is_missing(monkeypatch, caplog):
    def used(backend, installed):
        caplog.clear()
        monkeypatch.setattr(jax, "default_backend", lambda: backend)
        monkeypatch.setattr(warp_functions, "find_spec", lambda module: object() if installed else None)
        return warp_functions.warp_in_use.__wrapped__(), caplog.messages

    assert used("cpu", True) == used("cpu", False) == (False, [])
    assert used("gpu", True) == (True, [])
    in_use, (line,) = used("gpu", False)
    assert not in_use
    assert f"plain JAX casts rays on this GPU, which is slow; {install_command('cuda')}" in line


def test_rays_are_cast_by_what_is_in_use(monkeypatch):
    from usarmjx.sensors.rays import raycast

    rng = np.random.default_rng(2)
    geoms, rays = geoms_of(6, rng, 5), tuple(rays_at(rng))
    asked = []
    monkeypatch.setattr(raycast, "warp_hits", lambda *_: asked.append("warp"))
    monkeypatch.setattr(raycast, "_hits_on_a_cpu", lambda *_: asked.append("jax"))
    for there in (True, False):
        monkeypatch.setattr(raycast, "warp_in_use", lambda there=there: there)
        raycast.nearest_hits(geoms, *rays)
    assert asked == ["warp", "jax"]


def same_angles(geoms, rays, lines=None):
    """Compare cosines on Warp with those of JAX, of what the same rays meet."""
    start, along = rays if lines is None else lines.rays()
    seen = indexed_blocks(geoms)

    @quick_jit
    def by_jax(start, along):
        first = brute_force_hits(seen, start, along)
        return first, jnp.abs((normals(geoms, first, start, along) * along).sum(-1))

    first, plain = by_jax(start, along)
    met = np.asarray(first.geom_index) >= 0
    assert 0.05 < met.mean() < 1
    found = np.asarray(cosines_of_hits(seen, rays if lines is None else lines, first))
    assert (found[~met] == 0).all()
    # Where a box's faces meet, or a cylinder's side its cap, rounding decides which is looked at.
    assert (np.abs(found - plain) > ATOL).sum() <= 2
    return found[met]


@pytest.mark.parametrize("kind", RAY_KERNELS)
def test_angles_are_those_of_jax(kind):
    rng = np.random.default_rng(kind)
    cosines = same_angles(geoms_of(kind, rng, 50), tuple(rays_at(rng)))
    assert np.ptp(cosines) > 0.5


def test_angles_of_fans_among_several_kinds():
    rng = np.random.default_rng(4)
    directions = rng.normal(size=(3, 50, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    mat = np.linalg.qr(rng.normal(size=(3, 3, 3)))[0]
    pos = jnp.asarray(rng.uniform(-3, 3, (3, 3)), jnp.float32)
    fans = Fans(pos, jnp.asarray(mat, jnp.float32), directions.astype(np.float32))
    same_angles(make_room(3).geoms, None, fans)


def test_angles_of_all_maps_make_one_launch():
    rng = np.random.default_rng(9)
    worlds = [geoms_of(6, rng, 7) for _ in range(3)]
    blocks = jax.tree.map(lambda *x: jnp.stack(x), *(g.blocks[0] for g in worlds))
    info = indexed_blocks(worlds[0])[0]
    rays = tuple(x.reshape(3, 40, 3) for x in rays_at(rng, 3 * 40))

    def one(block, start, along):
        seen = [info._replace(block=block)]
        return cosines_of_hits(seen, (start, along), warp_hits(seen, (start, along)))

    cast = jax.jit(jax.vmap(one))
    assert cast.lower(blocks, *rays).as_text().count("stablehlo.custom_call @") == 2
    found = cast(blocks, *rays)
    for w, geoms in enumerate(worlds):
        seen, own = indexed_blocks(geoms), (rays[0][w], rays[1][w])
        np.testing.assert_allclose(found[w], cosines_of_hits(seen, own, warp_hits(seen, own)), atol=1e-6)


def test_rays_without_a_direction_meet_nothing():
    rng = np.random.default_rng(6)
    seen, (start, along) = indexed_blocks(geoms_of(6, rng, 50)), tuple(rays_at(rng))
    aimed = rng.random(len(along)) < 0.5
    found = warp_hits(seen, (start, jnp.where(aimed[:, None], along, 0.0)))
    assert (np.asarray(found.geom_index)[~aimed] == -1).all()
    assert np.isinf(np.asarray(found.distance)[~aimed]).all()
    whole = warp_hits(seen, (start, along))
    np.testing.assert_array_equal(found.geom_index[aimed], whole.geom_index[aimed])


def test_triangles_that_are_culled_by_boxes_are_met():
    """As panes of pictures are, all of which are."""
    rng = np.random.default_rng(1)
    seen, (start, along) = indexed_blocks(geoms_of(TRIANGLE_KIND, rng, 40)), rays_at(rng, 64)
    boxed = [part._replace(info=part.info._replace(compact=False)) for part in seen]
    plain = brute_force_hits(seen, start, along)
    np.testing.assert_array_equal(warp_hits(boxed, (start, along)).geom_index, plain.geom_index)
    assert (plain.geom_index >= 0).any()


@pytest.mark.parametrize("incidence", [False, True])
def test_fixed_geoms_are_met_among_those_of_each_world(incidence):
    """Walls that all worlds share, of two kinds, and what is in each of them; they are packed once."""
    rng = np.random.default_rng(11)
    walls = [geoms_of(kind, rng, 40) for kind in (6, TRIANGLE_KIND)]
    worlds = [[geoms_of(kind, rng, 7) for kind in (5, 2)] for _ in range(3)]
    stacked = [jax.tree.map(lambda *x: jnp.stack(x), *(w[i].blocks[0] for w in worlds)) for i in range(2)]
    rays = tuple(x.reshape(3, 100, 3) for x in rays_at(rng, 300))

    def geoms(blocks):
        still = tuple(wall.blocks[0] for wall in walls)
        return Geoms(
            blocks=still + tuple(blocks),
            kinds=(6, TRIANGLE_KIND, 5, 2),
            materials=("opaque",) * 4,
            fixed=(True, True, False, False),
            compact=(False, False, True, True),
        )

    def one(blocks, start, along):
        seen = indexed_blocks(geoms(blocks))
        first = warp_hits(seen, (start, along))
        return first, cosines_of_hits(seen, (start, along), first) if incidence else first.distance

    cast = jax.jit(jax.vmap(one))
    found, cosine = cast(stacked, *rays)
    text = cast.lower(stacked, *rays).as_text()
    assert text.count("tensor<3x1x6x32x4xf32>") > 0
    for w, world in enumerate(worlds):
        here, own = geoms([part.blocks[0] for part in world]), (rays[0][w], rays[1][w])
        alone = brute_force_hits(indexed_blocks(here), *own)
        np.testing.assert_array_equal(found.geom_index[w], alone.geom_index)
        assert len({0, 1, 2, 3} & set(np.digitize(alone.geom_index, [40, 80, 87]))) == 4
        if incidence:
            plain = jnp.abs((normals(here, alone, *own) * own[1]).sum(-1))
            assert (np.abs(cosine[w] - plain) > ATOL).sum() <= 2
