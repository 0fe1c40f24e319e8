"""Fans of which only the nearest hit counts, on Warp: the kernel runs here on its CPU device."""

import re
import sys
from functools import partial
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.engines.gpu_threads import ptx_of
from tests.sensors.rays.test_raycast import quick_jit
from tests.sensors.rays.test_warp import geoms_of, rays_at
from usarmjx.models.compile.kinematic_tree import BodyPoses
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.sensors.ranging import beam_directions
from usarmjx.sensors.rays import raycast
from usarmjx.sensors.rays.bundles import Fans
from usarmjx.sensors.rays.kernels import RAY_KERNELS
from usarmjx.sensors.rays.raycast import RayQuery, brute_force_hits, indexed_blocks, warp_hits
from usarmjx.sensors.rays.targets import normals
from usarmjx.sensors.suite import query_of, suite_of

pytest.importorskip("warp", reason="needs warp-lang")
import warp as wp

from usarmjx.sensors import nearest_warp
from usarmjx.sensors.rays import first_of_fans_warp
from usarmjx.sensors.rays.first_of_fans_warp import MOST_GEOMS
from usarmjx.sensors.rays.warp_launches import finds_first_only

ATOL = 1e-5  # m: the same arithmetic, differently contracted by the compilers
LEAST = (-1.0, 0.26, 0.6, 0.9)
REACH = 3.0


def fans_at(rng, beam_angle=0.35, reach=2.0):
    """Beams of a few sonars close together, as on a robot."""
    count = len(LEAST)
    pos = rng.uniform(-reach, reach, 3) + rng.uniform(-0.3, 0.3, (count, 3))
    mat = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    lines = np.stack([beam_directions(beam_angle)] * count)
    return Fans(jnp.asarray(pos, jnp.float32), jnp.asarray(mat, jnp.float32), lines)


def firsts(seen, fans, geoms, query):
    """The nearest hit that counts of each fan, of all rays by brute force on JAX (fans,)."""
    start, along = fans.rays()
    first = brute_force_hits(seen, start, along, query)
    cosine = jnp.abs((normals(geoms, first, start, along) * along).sum(-1))
    counts = cosine >= np.repeat(LEAST, fans.directions.shape[1])
    return jnp.where(counts, first.distance, jnp.inf).reshape(len(LEAST), -1).min(-1)


@pytest.mark.parametrize("kind", RAY_KERNELS)
def test_the_first_hit_that_counts_is_that_of_all_rays(kind):
    rng = np.random.default_rng(kind)
    geoms = geoms_of(kind, rng, 50)
    seen, query = (
        indexed_blocks(geoms),
        RayQuery(max_distance=REACH, least_cosines=LEAST, exclude_owner=np.int32(1)),
    )
    everything = quick_jit(partial(firsts, seen, geoms=geoms, query=query))
    met = 0
    for _ in range(12):
        fans = fans_at(rng)
        found = warp_hits(seen, fans, query)
        nearest = np.asarray(found.distance).reshape(len(LEAST), -1).min(-1)
        np.testing.assert_allclose(nearest, everything(fans), atol=ATOL)
        met += np.isfinite(nearest).sum()
    assert 6 <= met <= 42


def test_more_geoms_than_a_warp_lists_are_cast_as_other_fans_are():
    rng = np.random.default_rng(3)
    lines = fans_at(rng).directions
    assert finds_first_only(indexed_blocks(geoms_of(6, rng, MOST_GEOMS)), lines, LEAST)
    geoms = geoms_of(6, rng, MOST_GEOMS + 1, reach=6.0)
    seen, fans = indexed_blocks(geoms), fans_at(rng)
    assert not finds_first_only(seen, lines, LEAST)
    assert not finds_first_only(seen[:0], lines, ())
    found = warp_hits(seen, fans, RayQuery(max_distance=REACH, least_cosines=LEAST))
    plain = brute_force_hits(seen, *fans.rays(), RayQuery(max_distance=REACH))
    np.testing.assert_array_equal(found.geom_index, plain.geom_index)


def test_fans_of_all_robots_and_worlds_make_one_launch():
    rng = np.random.default_rng(9)
    worlds = [geoms_of(6, rng, 9) for _ in range(3)]
    blocks = jax.tree.map(lambda *x: jnp.stack(x), *(geoms.blocks[0] for geoms in worlds))
    info = indexed_blocks(worlds[0])[0]
    fans = [[fans_at(rng) for _ in range(2)] for _ in worlds]
    pos, mat = (
        jnp.stack([jnp.stack([getattr(f, name) for f in row]) for row in fans]) for name in ("pos", "mat")
    )
    wanted = jnp.asarray([[True, False], [True, True], [False, True]])

    def one(block, pos, mat, slot, wanted):
        query = RayQuery(exclude_owner=slot, wanted=wanted, max_distance=REACH, least_cosines=LEAST)
        return warp_hits([info._replace(block=block)], Fans(pos, mat, fans[0][0].directions), query)

    robots = jax.vmap(one, in_axes=(None, 0, 0, 0, 0))
    cast = jax.jit(jax.vmap(robots, in_axes=(0, 0, 0, None, 0)))
    given = (blocks, pos, mat, jnp.arange(2), wanted)
    assert cast.lower(*given).as_text().count("stablehlo.custom_call @") == 1
    found = np.asarray(cast(*given).distance).reshape(3, 2, len(LEAST), -1).min(-1)
    for w, geoms in enumerate(worlds):
        for r in range(2):
            query = RayQuery(exclude_owner=jnp.int32(r), max_distance=REACH)
            alone = firsts(indexed_blocks(geoms), fans[w][r], geoms, query)
            np.testing.assert_allclose(found[w, r], alone if wanted[w, r] else np.inf, atol=ATOL)


@pytest.mark.parametrize("rays", [1, 16, 70])
def test_rays_that_have_nothing_in_common_are_cast_one_by_one(rays):
    rng = np.random.default_rng(rays)
    seen, (start, along) = indexed_blocks(geoms_of(6, rng, 60)), rays_at(rng, rays)
    along = jnp.where((jnp.arange(rays) % 3 == 1)[:, None], 0.0, along)
    plain = brute_force_hits(seen, start, along, RayQuery(max_distance=REACH))
    found = warp_hits(seen, (start, along), RayQuery(max_distance=REACH, bundle_size=1))
    aimed = np.asarray((along != 0).any(-1))
    np.testing.assert_array_equal(found.geom_index, np.where(aimed, plain.geom_index, -1))
    np.testing.assert_allclose(found.distance, np.where(aimed, plain.distance, np.inf), atol=ATOL)


def test_sonars_read_on_warp_what_they_read_on_jax(monkeypatch):
    """A P2AT among boxes and tilted, whose sonars do not hear surfaces at large angles of incidence."""
    suite, rng = suite_of(P2AT), np.random.default_rng(8)
    sonar = suite.sensors[suite.index("Sonar")]
    assert sonar.needs_incidence
    geoms = geoms_of(6, rng, 60, reach=5.0)
    parts = len(suite.plan.parts)
    turns = np.linalg.qr(rng.normal(size=(6, 3, 3)))[0]

    def readings():
        found = []
        for turn in turns:
            bodies = BodyPoses(
                pos=jnp.zeros((parts, 3)), mat=jnp.tile(jnp.asarray(turn, jnp.float32), (parts, 1, 1))
            )
            fans = sonar.fans(bodies)
            assert fans is not None
            hits = raycast.cast_rays(geoms, *fans.rays(), query_of(sonar, np.int32(5)), fans)
            sense: Any = SimpleNamespace(hits=hits)
            found.append(sonar.read(sense, (), jax.random.key(0))[1])
        return np.stack(found)

    plain = readings()
    monkeypatch.setattr(raycast, "warp_in_use", lambda: True)
    np.testing.assert_allclose(readings(), plain, atol=ATOL)
    assert 20 < (plain < sonar.max_distance).sum() < 90


@pytest.mark.skipif(sys.platform == "darwin", reason="Warp compiles for no GPU there")
@pytest.mark.parametrize("which", ["first of fans", "nearest of few", "nearest of many"])
def test_kernels_compile_for_a_gpu(which, tmp_path):
    """Data that a CPU's thread keeps for itself are in no GPU's memory."""
    made = {
        "first of fans": lambda: wp.get_module(first_of_fans_warp.__name__),
        "nearest of few": lambda: nearest_warp.selection_kernel(1).module,
        "nearest of many": lambda: nearest_warp.selection_kernel(nearest_warp.MOST // 32).module,
    }[which]()
    assert made.kernels
    text = ptx_of(made, tmp_path)
    assert text.count(".entry") >= 1
    assert not re.search(r"\.local .*__local_depot", text)
    held = [
        int(size)
        for name, size in re.findall(r"\.shared .*? (\S+)\[(\d+)\];", text)
        if "smem_base" not in name
    ]
    assert sum(held) <= 48 * 1024
