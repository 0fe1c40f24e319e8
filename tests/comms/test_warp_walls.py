"""Walls counted on Warp, whose kernel runs here on its CPU device."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.comms.solids import Solids, random_boxes, slab_count, solids
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
from usarmjx.comms.warp_walls import count_on_warp, pack_solids

counted, counted_on_jax = jax.jit(count_on_warp), jax.jit(count_on_jax)
"""Counts by one program: each operation of theirs would be another."""


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
    np.testing.assert_array_equal(counted(geoms, *single(start, end)), expected)
    np.testing.assert_array_equal(counted(geoms, *single(end, start)), expected)


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
    found = np.asarray(counted(boxes.geoms(), *single(start, end)))
    np.testing.assert_array_equal(found[clear], greatest[clear])


def agrees(geoms, start, end, few=2e-3):
    """Counts are those of JAX, but for a few segments that only just meet something; they are no constant."""
    here, there = (np.asarray(count(geoms, *single(start, end))) for count in (counted, counted_on_jax))
    back = np.asarray(counted(geoms, *single(end, start)))
    np.testing.assert_array_equal(back, here)
    assert (here != there).mean() <= few
    assert len(set(there)) > 2


def test_shapes_of_all_kinds_count_as_on_jax():
    rng = np.random.default_rng(3)
    many = [(kind, rng.uniform(-2, 2, 3), SHAPES[kind], rng.uniform(-3, 3, 3)) for kind in SHAPES] * 3
    plate = (PLANE, (0.3, 0, 0), (1, 2, 1), (0.4, 1.2, 0))
    agrees(solids(*many, plate).geoms(), *ends(rng, 1000, (-3, -3, -3), (3, 3, 3)))


def around(distance):
    """Boxes, upright and not, in more groups than a list holds, and segments about a place so far off."""
    rng = np.random.default_rng(11)
    boxes = [random_boxes(rng, 90, upright) for upright in (True, False)]
    at = np.array([distance, -distance, 0])
    both = [
        Solids(one.kind, one.pos + at, one.mat, one.size.astype(np.float32).astype(float)) for one in boxes
    ]
    whole = Solids(
        *(np.concatenate(part) for part in zip(*(vars(one).values() for one in both), strict=True))
    )
    return whole, *(end + at for end in ends(rng, 300))


@pytest.mark.oracle
@pytest.mark.parametrize("distance", [0.0, 2000.0])
def test_no_list_lacks_a_box_that_is_crossed(distance):
    """Against the slab method in double precision; coordinates of 2 km are exact to 0.2 mm."""
    near = max(NEAR, 4 * np.spacing(np.float32(distance)))
    boxes, start, end = around(distance)
    start, end = start.astype(np.float32).astype(float), end.astype(np.float32).astype(float)
    boxes.pos = boxes.pos.astype(np.float32).astype(float)
    least, greatest = (slab_count(boxes, start, end, grow) for grow in (-near, near))
    clear = least == greatest
    assert clear.mean() > 0.6
    assert greatest.max() > 12
    found = np.asarray(counted(boxes.geoms(), *single(start, end)))
    np.testing.assert_array_equal(found[clear], greatest[clear])


@pytest.mark.oracle
def test_upright_segments_cross_what_is_above_each_other():
    """A segment without a horizontal direction has a list, too."""
    boxes, start, end = around(0.0)
    end[:, :2] = start[:, :2]
    end[:, 2] = start[:, 2] + 3
    least, greatest = (slab_count(boxes, start, end, grow) for grow in (-NEAR, NEAR))
    clear = least == greatest
    found = np.asarray(counted(boxes.geoms(), *single(start, end)))
    np.testing.assert_array_equal(found[clear], greatest[clear])
    assert greatest.max() > 2


def test_what_all_evaluations_share_is_packed_once():
    """Solids reach the kernel as they are packed: a transposed copy would be made in every step."""
    geoms = random_boxes(np.random.default_rng(8), 40, True).geoms()
    packed, wholes, count = pack_solids(geoms)
    assert (wholes, count, packed.shape) == (40, 40, (7, 64, 4))
    assert (np.asarray(packed[0, 40:, 2]) == -np.inf).all()
    two = jax.tree.map(lambda x: jnp.stack([x, x]), geoms)
    text = jax.jit(jax.vmap(count_on_warp)).lower(two, jnp.zeros((2, 3, 3)), jnp.ones((2, 3, 3))).as_text()
    assert "x7x64x4xf32>" in text
    assert not [line for line in text.splitlines() if "transpose" in line and "x7x64x4" in line]


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
        alone = counted_on_jax(many[0 if shared else w], start[w], end[w])
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
