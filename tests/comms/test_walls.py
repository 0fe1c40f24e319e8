"""Wall counts against two independent counters, and the answers where a segment only just meets a solid."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.arenas import COURSE
from tests.comms.solids import Geom, Solids, box, random_boxes, ray_count, slab_count, solids
from usarmjx.base.errors import UnsupportedGeomError
from usarmjx.comms.walls import CROSSING_KERNELS, arena_solids, check_wall_types, count_walls
from usarmjx.models.arenas import ARENAS
from usarmjx.models.compile.compose import VICTIM_PREFIX
from usarmjx.models.compile.ray_geoms import FENDER_KIND
from usarmjx.models.types.arena import LooseObject
from usarmjx.models.types.shapes import Shape
from usarmjx.sensors.rays.targets import PADDING_DISTANCE, make_geoms
from usarmjx.sim.scene import build_scene

NEAR = 1e-4  # m: segments this close to an edge, a corner or a face may count either way
FEW = 0.01  # ... and are no more than this share of all
PAIRS, ARENAS_TRIED, WALLS = 10_000, 20, 100
BOX, PLANE = Geom.mjGEOM_BOX, Geom.mjGEOM_PLANE


def ends(rng, n, low=(-10, -10, 0), high=(10, 10, 2)):
    """Random ends, as the device sees them: single precision, in doubles."""
    return rng.uniform(low, high, (2, n, 3)).astype(np.float32).astype(float)


@pytest.mark.oracle
@pytest.mark.parametrize("upright", [True, False])
def test_counts_equal_the_slab_methods(upright: bool):
    rng = np.random.default_rng(7)
    each, excepted, most = PAIRS // ARENAS_TRIED, 0, 0
    for _ in range(ARENAS_TRIED):
        boxes = random_boxes(rng, WALLS, upright)
        start, end = ends(rng, each)
        least, greatest = (slab_count(boxes, start, end, grow) for grow in (-NEAR, NEAR))
        clear = least == greatest
        np.testing.assert_array_equal(boxes.count(start, end)[clear], greatest[clear])
        excepted += (~clear).sum()
        most = max(most, greatest.max())
    assert excepted <= FEW * PAIRS
    assert most > 8  # not only segments with few walls were tried


SHAPES = {
    Geom.mjGEOM_SPHERE: (0.7, 0, 0),
    Geom.mjGEOM_CAPSULE: (0.3, 0.8, 0),
    Geom.mjGEOM_CYLINDER: (0.5, 0.6, 0),
    Geom.mjGEOM_ELLIPSOID: (0.9, 0.3, 0.6),
    Geom.mjGEOM_BOX: (0.6, 0.05, 0.8),
}


@pytest.mark.oracle
@pytest.mark.parametrize("kind", SHAPES, ids=lambda kind: kind.name[7:].lower())
def test_counts_of_every_shape_equal_mujocos_rays(kind: Geom):
    rng = np.random.default_rng(int(kind))
    many = [(kind, rng.uniform(-1.5, 1.5, 3), SHAPES[kind], rng.uniform(-3, 3, 3)) for _ in range(4)]
    things = solids(*many)
    start, end = ends(rng, 1500, (-2, -2, -2), (2, 2, 2))  # many start or end inside
    least, greatest = (ray_count(things, start, end, grow) for grow in (-NEAR, NEAR))
    clear = least == greatest
    np.testing.assert_array_equal(things.count(start, end)[clear], greatest[clear])
    assert (~clear).mean() <= FEW
    assert 0.2 < greatest.mean() < 2.0


def test_shapes_of_all_kinds_count_together():
    line = [(kind, (2.0 * i, 0, 0), size) for i, (kind, size) in enumerate(SHAPES.items())]
    things = solids(*line, (PLANE, (5, 0, 0), (0, 0, 1), (0, np.pi / 2, 0)))
    assert set(CROSSING_KERNELS) == {int(kind) for kind in (*SHAPES, PLANE)}
    assert things.count((-2, 0.01, 0.02), (12, 0.01, 0.02)) == 6
    assert things.count((-2, 5, 0), (12, 5, 0)) == 1  # the plane


CUBE = box((0, 0, 0), (1, 1, 1))


BOX_CASES = [
    ((-3, 0, 0), (3, 0, 0), 1),  # straight through
    ((-3, 0, 0), (-2, 0, 0), 0),  # ends before it
    ((-3, 0, 0), (-1, 0, 0), 0),  # ends on its face
    ((-3, 0, 0), (0, 0, 0), 1),  # ends inside
    ((0, 0, 0), (0, 3, 0), 1),  # starts inside
    ((-0.5, 0, 0), (0.5, 0.2, 0), 1),  # lies inside whole
    ((-1, 0, 0), (1, 0, 0), 1),  # from face to face
    ((-1, 0, 0), (-3, 0, 0), 0),  # from a face away
    ((-3, 1, 0), (3, 1, 0), 0),  # along a face
    ((-0.5, 1, 0), (0.5, 1, 0.5), 0),  # within a face
    ((-3, 1, 1), (3, 1, 1), 0),  # along an edge
    ((-3, 3, 0), (3, -3, 0), 1),  # in over one edge and out over another
    ((-3, -1, 0), (1, 3, 0), 0),  # touches an edge
    ((-3, -1, -1), (-1, 1, 1), 0),  # ends at an edge
    ((2, 2, 2), (0.5, 0.5, 0.5), 1),  # in through a corner
    ((-1, 3, 2), (3, -1, 0), 0),  # touches a corner's edges from outside
    ((2, 1, 0), (1, 2, 0), 0),  # passes by an edge
    ((0, 0, 0), (0, 0, 0), 1),  # both ends in one place inside
    ((1, 0, 0), (1, 0, 0), 0),  # ... on a face
    ((2, 0, 0), (2, 0, 0), 0),  # ... outside
]


@pytest.mark.parametrize(("start", "end", "walls"), BOX_CASES)
def test_where_a_segment_meets_a_box(start: tuple, end: tuple, walls: int):
    assert solids(CUBE).count(start, end) == walls
    assert solids(CUBE).count(end, start) == walls


ROUND = {
    "sphere": (Geom.mjGEOM_SPHERE, (0, 0, 0), (1,)),
    "cylinder": (Geom.mjGEOM_CYLINDER, (0, 0, 0), (1, 1)),
    "capsule": (Geom.mjGEOM_CAPSULE, (0, 0, 0), (1, 1)),
    "ellipsoid": (Geom.mjGEOM_ELLIPSOID, (0, 0, 0), (1, 1, 1)),
}


ROUND_CASES = [
    ((-3, 0, 0), (3, 0, 0), 1),
    ((-3, 0, 0), (-1, 0, 0), 0),  # ends on the surface
    ((-3, 0, 0), (0, 0, 0), 1),
    ((0, 0, 0.5), (0.2, 0, -0.5), 1),  # lies inside whole
    ((-3, 1, 0), (3, 1, 0), 0),  # touches
    ((0, 0, 0), (0, 0, 0), 1),
    ((1, 0, 0), (1, 0, 0), 0),
    ((0, 0, -5), (0, 0, 5), 1),  # along its axis
]


@pytest.mark.parametrize("name", ROUND)
@pytest.mark.parametrize(("start", "end", "walls"), ROUND_CASES)
def test_where_a_segment_meets_something_round(name: str, start: tuple, end: tuple, walls: int):
    assert solids(ROUND[name]).count(start, end) == walls
    assert solids(ROUND[name]).count(end, start) == walls


CYLINDER_CASES = [
    ((1, 0, -3), (1, 0, 3), 0),  # along the side
    ((-3, 0, 1), (3, 0, 1), 0),  # along a cap
    ((0, 0, 3), (0, 0, 1), 0),  # ends on a cap
    ((0, 0, 3), (0, 0, 0.9), 1),
    ((-3, 0, 0.9), (3, 0, 0.9), 1),
]


@pytest.mark.parametrize(("start", "end", "walls"), CYLINDER_CASES)
def test_where_a_segment_meets_a_cylinder(start: tuple, end: tuple, walls: int):
    assert solids(ROUND["cylinder"]).count(start, end) == walls


FLOOR_CASES = [
    ((0, 0, 1), (4, 0, -1), 1),
    ((0, 0, -1), (4, 0, 1), 1),  # from behind too
    ((0, 0, 1), (4, 0, 1), 0),
    ((0, 0, 0), (4, 0, 0), 0),  # along it
    ((0, 0, 0), (4, 0, 1), 0),  # starts on it
    ((0, 0, 0), (0, 0, -1), 0),
    ((0, 0, 0), (0, 0, 0), 0),
    ((0, 0, -1), (4, 0, -2), 0),
]


@pytest.mark.parametrize(("start", "end", "walls"), FLOOR_CASES)
def test_where_a_segment_meets_the_floor(start: tuple, end: tuple, walls: int):
    floor = solids((PLANE, (0, 0, 0), (0, 0, 1)))
    assert floor.count(start, end) == walls
    assert floor.count(end, start) == walls


def test_a_plane_with_an_end_counts_within_it():
    plate = solids((PLANE, (0, 0, 0), (1, 2, 1)))
    assert plate.count((0.9, 1.9, -1), (0.9, 1.9, 1)) == 1
    assert plate.count((1.1, 0, -1), (1.1, 0, 1)) == 0
    assert plate.count((0, 2.1, -1), (0, 2.1, 1)) == 0


def test_thin_and_touching_walls_count_each():
    """The in-engine server marched on by 0.2 m behind each surface, and would have found 2 of these 20."""
    stack = solids(*[box((0.01 * i, 0, 1), (0.005, 2, 1)) for i in range(20)])
    assert stack.count((-1, 0.1, 1), (1, 0.1, 1)) == 20
    foil = solids(box((0, 0, 1), (0.0005, 2, 1)), box((0.1, 0, 1), (0.0005, 2, 1)))
    assert foil.count((-5, 0.1, 1), (5, 0.2, 1)) == 2


def test_solids_within_one_another_count_each():
    nested = solids(CUBE, box((0, 0, 0), (0.5, 0.5, 0.5)), box((0, 0, 0), (1, 1, 1)))
    assert nested.count((-3, 0, 0), (3, 0, 0)) == 3
    assert nested.count((-3, 0.7, 0), (3, 0.7, 0)) == 2


def test_storeys_are_floors_that_count():
    house = solids(
        (PLANE, (0, 0, 0), (0, 0, 1)),
        *[box((0, 0, 3.0 * storey), (10, 10, 0.1)) for storey in (1, 2)],
        box((2, 0, 1.5), (0.1, 10, 1.4)),
    )
    for start, end, walls in (
        ((0, 0, 0.3), (1, 0, 0.3), 0),  # on one storey
        ((0, 0, 0.3), (0, 0, 3.4), 1),  # to the next
        ((0, 0, 0.3), (0, 0, 6.4), 2),
        ((0, 0, 0.3), (4, 0, 3.4), 2),  # and behind the wall of the ground floor
        ((0, 0, 3.4), (4, 0, 3.4), 0),  # above which there is none
        ((0, 0, -0.3), (0, 0, 6.4), 3),  # from the cellar
    ):
        assert house.count(start, end) == walls, (start, end)


def test_a_wall_that_is_turned_counts_where_it_is():
    wall = solids(box((0, 0, 0), (3, 0.1, 1), (0, 0, np.pi / 4)))
    assert wall.count((1, 2, 0), (2, 1, 0)) == 1
    assert wall.count((1, -1, 0), (3, 1, 0)) == 0  # alongside
    assert wall.count((2, -2, 0.99), (-2, 2, 0.99)) == 1
    assert wall.count((2, -2, 1.01), (-2, 2, 1.01)) == 0


def test_parked_solids_do_not_count():
    away = solids(
        CUBE, box((PADDING_DISTANCE,) * 3, (1, 1, 1)), (Geom.mjGEOM_SPHERE, (PADDING_DISTANCE,) * 3, (1,))
    )
    assert away.count((-3, 0, 0), (3, 0, 0)) == 1
    assert away.count((-3, 2, 0), (300, 20, 10)) == 0


coordinates = st.floats(-5, 5, width=32)
points = st.tuples(coordinates, coordinates, coordinates)
JUMBLE = solids(
    *[
        (kind, (i - 2.0, 0.3 * i, 0.2), size, (0.3 * i, 0.2, i))
        for i, (kind, size) in enumerate(SHAPES.items())
    ],
    (PLANE, (0, 0, -0.5), (0, 0, 1)),
    CUBE,
)


@settings(deadline=None)
@given(points, points)
def test_there_are_as_many_walls_there_as_back(start: tuple, end: tuple):
    """Exactly, also where a segment touches: the two ends enter the kernels in the same way."""
    assert JUMBLE.count(start, end) == JUMBLE.count(end, start)


@settings(deadline=None)
@given(points, points, points)
def test_two_legs_cross_at_least_what_a_straight_way_does(start: tuple, end: tuple, share: tuple):
    """Of convex solids: a stop on the way, which is off it by rounding, adds walls or none."""
    stop = np.array(start) + (np.array(end) - np.array(start)) * abs(share[0]) / 5
    grown = Solids(JUMBLE.kind, JUMBLE.pos, JUMBLE.mat, JUMBLE.size - NEAR)
    legs = JUMBLE.count(start, stop) + JUMBLE.count(stop, end)
    assert legs >= grown.count(start, end) - 1  # a stop right on the plane crosses it in neither leg


def test_counts_are_whole_numbers_and_none_without_solids():
    nothing = make_geoms(np.zeros(0, int), *[jnp.zeros((0, *s)) for s in ((3,), (3, 3), (3,))], jnp.zeros(0))
    counts = count_walls(nothing, jnp.zeros((4, 3)), jnp.ones((4, 3)))
    np.testing.assert_array_equal(counts, np.zeros(4, int))
    assert counts.dtype == jnp.int32
    assert solids(CUBE).count(np.zeros((0, 3)), np.zeros((0, 3))).shape == (0,)


def test_one_loop_goes_over_segments_times_solids():
    """One loop and one sum: at most the sum's terms are stored, and not what they are computed from."""
    n = 2000
    geoms = random_boxes(np.random.default_rng(0), WALLS, upright=True).geoms()
    lowered = jax.jit(count_walls).lower(geoms, jnp.zeros((n, 3)), jnp.ones((n, 3)))
    analysis = lowered.compile().memory_analysis()
    assert analysis.temp_size_in_bytes < 1.1 * 4 * n * WALLS


def test_shapes_that_cannot_be_counted_are_refused():
    with pytest.raises(UnsupportedGeomError, match=r"mjGEOM_SDF.*mjGEOM_BOX"):
        check_wall_types([BOX, Geom.mjGEOM_SDF])
    check_wall_types([BOX, Geom.mjGEOM_MESH, Geom.mjGEOM_HFIELD])


@pytest.mark.parametrize("arena", [ARENAS.get("yellow"), COURSE], ids=lambda arena: arena.name)
def test_an_arenas_solids_are_those_that_sensors_see(arena):
    """But for victims, who are none, and grid fenders, which are boxes to the radio."""
    scene = build_scene(arena, ["P2AT"])
    seen, counted = scene.fixed_geoms, arena_solids(arena)
    solid = np.array([not scene.model.geom(geom).name.startswith(VICTIM_PREFIX) for geom in seen.geom])
    kind = np.where(seen.kind == FENDER_KIND, BOX, seen.kind)[solid]
    expected = make_geoms(kind, seen.pos[solid], seen.mat[solid], seen.size[solid], np.full(solid.sum(), -1))
    assert counted.kinds == expected.kinds
    for mine, theirs in zip(counted.blocks, expected.blocks, strict=True):
        np.testing.assert_allclose(mine.pos, theirs.pos, atol=1e-6)
        np.testing.assert_allclose(mine.mat, theirs.mat, atol=1e-6)
        np.testing.assert_allclose(mine.size, theirs.size, atol=1e-6)


def test_loose_objects_do_not_count():
    crate = LooseObject(
        name="crate", at=(1, 1, 0.5), shapes=(Shape(kind="box", size=(0.5, 0.5, 0.5), mass=1.0),)
    )
    strewn = arena_solids(replace(COURSE, name="strewn", loose=(crate,)))
    assert [len(block.owner) for block in strewn.blocks] == [
        len(block.owner) for block in arena_solids(COURSE).blocks
    ]
