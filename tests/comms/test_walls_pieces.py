"""Meshes and terrain as walls: each counts once, by C MuJoCo's rays; and what materials count."""

from functools import partial

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from tests.lands import Land, hills, land, stones
from usarmjx.comms.walls import arena_solids, count_walls
from usarmjx.models.types.shapes import FENDER, GLASS, MIRROR, OPAQUE, SKY, HeightField, Mesh, Shape

NEAR = 1e-4  # m: segments this close to an edge or a face may count either way ...
FEW = 0.02  # ... and are no more than this share of all
SEGMENTS = 400


def count(arena, start, end):
    points = (jnp.asarray(np.atleast_2d(p), jnp.float32) for p in (start, end))
    return np.asarray(count_walls(arena_solids(arena), *points))


def expected(place, start, end, grow):
    """A segment meets a solid that it starts in, or that a ray from its start meets before its end."""
    length = np.linalg.norm(end - start, axis=-1)
    way = (end - start) / length[:, None]
    counts = np.zeros(len(start), int)
    for geom in range(place.model.ngeom):
        mesh = place.model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH
        ray = partial(mujoco.mj_rayMesh if mesh else mujoco.mj_rayHfield, place.model, place.data, geom)
        far = np.array([ray(a, d, None) for a, d in zip(start, way, strict=True)])
        counts += ((far >= 0) & (far < length + grow)) | place.inside(geom, start, grow)
    return counts


def segments(seed, reach=3.0):
    ends = np.random.default_rng(seed).uniform(-reach, reach, (2, SEGMENTS, 3))
    return ends.astype(np.float32).astype(float)


def clear(place, start, end):
    """C's counts, and which segments have the same if they are moved a little either way."""
    counts = expected(place, start, end, 0.0)
    same = np.ones(len(start), bool)
    for nudge in np.random.default_rng(1).choice([-NEAR, NEAR], (3, 3)):
        for grow in (-NEAR, NEAR):
            same &= expected(place, start + nudge, end + nudge, grow) == counts
    assert same.mean() > 1 - FEW
    return counts, same


@pytest.mark.oracle
@pytest.mark.parametrize("seed", range(2))
def test_meshes_count_as_c_mujocos_rays_say(seed):
    arena = land(*stones(np.random.default_rng(seed), 6, reach=1.5))
    counts, same = clear(Land(arena), *segments(seed, 2.0))
    np.testing.assert_array_equal(count(arena, *segments(seed, 2.0))[same], counts[same])
    assert counts.max() >= 3
    assert {0, 1, 2} <= set(counts)


@pytest.mark.oracle
@pytest.mark.parametrize("tilted", [False, True])
def test_terrain_counts_as_c_mujocos_rays_say(tilted):
    rng = np.random.default_rng(4)
    arena = land(hills(rng, tilted, (0.5, 0.2, -1.0)), hills(rng, tilted, (-0.5, 0.0, 0.5)))
    counts, same = clear(Land(arena), *segments(4, 2.0))
    np.testing.assert_array_equal(count(arena, *segments(4, 2.0))[same], counts[same])
    assert set(counts) == {0, 1, 2}


def test_exchanging_the_ends_changes_nothing():
    rng = np.random.default_rng(6)
    arena = land(*stones(rng), hills(rng))
    start, end = segments(6)
    np.testing.assert_array_equal(count(arena, start, end), count(arena, end, start))


CORNERS = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
CUBE = land(Shape(kind="mesh", mesh=Mesh(vertices=np.array(CORNERS, float))), name="cube")
PLAIN = np.full((5, 5), 0.5)
PLAIN[0, 0] = 0.0
"""Level at 0.5 m but for one corner."""
LEVEL = land(Shape(kind="hfield", size=(2, 2, 0.3), heights=HeightField(heights=PLAIN)), name="level")


@pytest.mark.parametrize(
    ("start", "end", "walls"),
    [
        ((-3, 0.1, 0.2), (3, 0.1, 0.2), 1),  # straight through: two faces, one solid
        ((-3, 0.1, 0.2), (-2, 0.1, 0.2), 0),  # ends before it
        ((-3, 0.1, 0.2), (0, 0.1, 0.2), 1),  # ends inside
        ((-0.5, 0.1, 0), (0.5, 0.2, 0), 1),  # lies inside whole
        ((0, 0, 0), (0, 0, 0), 1),  # both ends in one place inside
        ((2, 0, 0), (2, 0, 0), 0),  # ... outside
        ((-3, 1.5, 0), (3, 1.5, 0), 0),  # beside it
        ((1.5, 0.9, 0), (0.9, 1.5, 0), 0),  # past an edge: nearest (1.2, 1.2)
    ],
)
def test_where_a_segment_meets_a_mesh(start, end, walls):
    assert count(CUBE, start, end) == walls
    assert count(CUBE, end, start) == walls


@pytest.mark.parametrize(
    ("start", "end", "walls"),
    [
        ((-1.0, 0.3, 1.0), (1.0, 0.3, 1.0), 0),  # above
        ((-1.0, 0.3, 0.2), (1.0, 0.3, 0.2), 1),  # below the surface whole
        ((0.3, 0.3, 1.0), (0.3, 0.3, 0.2), 1),  # ends below it
        ((-3.0, 0.0, 0.2), (3.0, 0.0, 0.2), 1),  # in and out by its sides, along the cells' edges
        ((-3.0, -3.0, 0.2), (3.0, 3.0, 0.2), 1),  # along their diagonals
        ((-1.0, -1.0, 1.0), (-1.0, -1.0, 0.0), 1),  # down on a corner of cells
        ((-1.0, 0.3, -0.4), (1.0, 0.3, -0.4), 0),  # under its bottom at -0.3 m
        ((0.3, 0.3, 1.0), (0.3, 0.3, -1.0), 1),  # in by its surface, out by its bottom
        ((2.1, 0.0, 0.2), (3.0, 0.0, 0.2), 0),  # beside it
        ((0.0, 0.3, 0.2), (0.0, 0.3, 0.2), 1),  # both ends in one place below
        ((0.0, 0.3, 0.6), (0.0, 0.3, 0.6), 0),  # ... above
    ],
)
def test_where_a_segment_meets_terrain(start, end, walls):
    assert count(LEVEL, start, end) == walls
    assert count(LEVEL, end, start) == walls


def test_many_solids_in_pieces_count_one_each():
    """More triangles than one pass looks at, and a solid that ends with the last of a chunk or not."""
    for n in (1, 3, 8):
        row = tuple(
            Shape(kind="mesh", mesh=Mesh(vertices=np.array(CORNERS, float)), at=(3.0 * i, 0.0, 0.0))
            for i in range(n)
        )
        line = land(*row, *LEVEL.shapes, name=f"row of {n}")
        assert count(line, (-2, 0.1, 0.2), (3.0 * n, 0.1, 0.2)) == n + 1
        assert count(line, (1.5, 0.1, 0.7), (3.0 * n, 0.1, 0.7)) == n - 1


@pytest.mark.parametrize(("material", "walls"), [(OPAQUE, 1), (GLASS, 1), (MIRROR, 1), (FENDER, 1), (SKY, 0)])
def test_every_material_but_the_sky_is_a_wall(material, walls):
    """Through the middle of a hole of the fender too: a radio's waves are longer than its meshes."""
    pane = Shape(kind="box", size=(0.01, 1, 1), material=material)
    arena = land(pane, name=material)
    assert count(arena, (-1, 0.025, 0.025), (1, 0.025, 0.025)) == walls
    assert count(arena, (-1, 0.0, 0.0), (1, 0.0, 0.0)) == walls
