"""Walls counted on Warp, whose kernel runs here on its CPU device."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.comms.solids import random_boxes, slab_count, solids
from tests.comms.test_walls import (
    BOX_CASES,
    CUBE,
    CYLINDER_CASES,
    FLOOR_CASES,
    NEAR,
    PLANE,
    ROUND,
    ROUND_CASES,
    SHAPES,
    ends,
)
from tests.lands import hills, land, stones
from usarmjx.comms import walls
from usarmjx.comms.links import pair_powers
from usarmjx.comms.walls import arena_solids, count_on_jax, count_walls
from usarmjx.models.arenas import ARENAS

pytest.importorskip("warp", reason="needs warp-lang")
from usarmjx.comms.warp_walls import count_on_warp


def single(*points):
    return tuple(jnp.asarray(np.atleast_2d(p), jnp.float32) for p in points)


TABLES = [
    (CUBE, BOX_CASES),
    *((ROUND[name], ROUND_CASES) for name in ROUND),
    (ROUND["cylinder"], CYLINDER_CASES),
    ((PLANE, (0, 0, 0), (0, 0, 1)), FLOOR_CASES),
]


@pytest.mark.parametrize(("solid", "cases"), TABLES, ids=lambda x: x[0].name if isinstance(x, tuple) else "")
def test_where_a_segment_only_just_meets_a_solid(solid, cases):
    start, end, expected = (np.array(column, float) for column in zip(*cases, strict=True))
    geoms = solids(solid).geoms()
    np.testing.assert_array_equal(count_on_warp(geoms, *single(start, end)), expected)
    np.testing.assert_array_equal(count_on_warp(geoms, *single(end, start)), expected)


@pytest.mark.oracle
@pytest.mark.parametrize("upright", [True, False])
def test_counts_equal_the_slab_methods(upright):
    rng = np.random.default_rng(7)
    boxes = random_boxes(rng, 100, upright)
    start, end = ends(rng, 400)
    least, greatest = (slab_count(boxes, start, end, grow) for grow in (-NEAR, NEAR))
    clear = least == greatest
    assert clear.mean() > 0.95
    assert greatest.max() > 8
    found = np.asarray(count_on_warp(boxes.geoms(), *single(start, end)))
    np.testing.assert_array_equal(found[clear], greatest[clear])


def agrees(geoms, start, end, few=2e-3):
    """Counts are those of JAX, but for a few segments that only just meet something; they are no constant."""
    here, there = (np.asarray(count(geoms, *single(start, end))) for count in (count_on_warp, count_on_jax))
    back = np.asarray(count_on_warp(geoms, *single(end, start)))
    np.testing.assert_array_equal(back, here)
    assert (here != there).mean() <= few
    assert len(set(there)) > 2


def test_shapes_of_all_kinds_count_as_on_jax():
    rng = np.random.default_rng(3)
    many = [(kind, rng.uniform(-2, 2, 3), SHAPES[kind], rng.uniform(-3, 3, 3)) for kind in SHAPES] * 3
    plate = (PLANE, (0.3, 0, 0), (1, 2, 1), (0.4, 1.2, 0))
    agrees(solids(*many, plate).geoms(), *ends(rng, 1000, (-3, -3, -3), (3, 3, 3)))


def test_meshes_and_terrain_count_as_on_jax():
    """A solid in many pieces counts once, and its neighbour of the same kind for itself."""
    rng = np.random.default_rng(5)
    arena = land(*stones(rng, 6, reach=1.5), hills(rng, True, (0.5, 0.2, -1.0)), hills(rng, False))
    agrees(arena_solids(arena), *ends(rng, 600, (-2, -2, -2), (2, 2, 2)))


def test_an_arena_counts_as_on_jax():
    arena = ARENAS.get("yellow")
    (x0, x1), (y0, y1) = arena.extent
    low, high = (x0, y0, arena.floor + 0.1), (x1, y1, arena.floor + 1.0)
    agrees(arena_solids(arena), *ends(np.random.default_rng(6), 500, low, high))


@pytest.mark.parametrize("shared", [True, False])
def test_all_worlds_are_one_launch(shared):
    rng = np.random.default_rng(8)
    many = [random_boxes(rng, 40, True).geoms() for _ in range(3)]
    start, end = (x.reshape(3, 2, 25, 3) for x in single(*ends(rng, 150)))
    geoms = many[0] if shared else jax.tree.map(lambda *x: jnp.stack(x), *many)
    inner = jax.vmap(count_on_warp, in_axes=(None, 0, 0))
    count = jax.jit(jax.vmap(inner, in_axes=(None if shared else 0, 0, 0)))
    assert count.lower(geoms, start, end).as_text().count("stablehlo.custom_call @") == 1
    found = count(geoms, start, end)
    for w in range(3):
        alone = count_on_jax(many[0 if shared else w], start[w], end[w])
        np.testing.assert_array_equal(found[w], alone)


def test_the_radio_counts_on_warp_where_rays_are_cast_there(monkeypatch):
    """Powers keep their slopes: walls count as if they stayed as they are."""
    monkeypatch.setattr(walls, "warp_in_use", lambda: True)
    monkeypatch.setattr("usarmjx.comms.links.count_walls", count_walls.__wrapped__)
    from usarmjx.comms.attenuation import RadioSettings

    power = partial(pair_powers, RadioSettings(), solids(CUBE).geoms())
    at = jnp.array([(-3.0, 0, 0), (3.0, 0, 0), (3.0, 3, 0)])
    assert "count_crossings" in jax.jit(power).lower(at).as_text()
    assert power(at)[1].tolist() == [1, 0, 0]
    slope = jax.jit(jax.grad(lambda a: power(a)[0].sum()))(at)
    assert np.isfinite(slope).all()
    assert slope[0, 0] > 0
