"""Where robots get to: gaps, steps, slopes, floors above each other; rasters against C MuJoCo's rays."""

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from usarmjx.base.transforms import mat_from_angles, quat_from_angles
from usarmjx.models.arenas.yellow import START_CELLS, YELLOW
from usarmjx.models.compile.compose import new_spec
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.raster import Grid, rasterize
from usarmjx.models.compile.reachability import footprint_of, reach_map, shapes_in_arena, victims_reached
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.arena import ArenaSpec, LooseObject, StartPose, Victim
from usarmjx.models.types.shapes import HeightField, Mesh, Shape

SPLIT = settings(max_examples=20, deadline=None)
FAST = 0.1  # m: squares of the small arenas here
RADIUS, STEP = 0.3, 0.06
FINE = 1e-4  # m
SINGLE = 1e-5  # victims' tables are in single precision
ROUNDING = 1e-6  # m: MuJoCo keeps a mesh's corners in single precision


def block(low, high, **keys):
    """A box between two corners."""
    low, high = np.array(low, float), np.array(high, float)
    at, size = (low + high) / 2, (high - low) / 2
    return Shape(kind="box", at=tuple(at), size=tuple(size), surface="ground", **keys)


def place(x, y, z=0.0):
    return StartPose(tag="S", at=(x, y, z + 0.188))


def arena(*shapes, start=(-2.0, 0.0), **keys):
    return ArenaSpec(
        name="test", shapes=shapes, starts=(place(*start),), extent=((-3.0, 3.0), (-2.0, 2.0)), **keys
    )


def reach(*shapes, radius=RADIUS, step=STEP, cell=FAST, start=(-2.0, 0.0), keys=None, **more):
    return reach_map(arena(*shapes, start=start, **(keys or {})), radius, step, cell=cell, **more)


def gap(width, turn=0.0, thick=0.05, height=1.0):
    """Two walls across the arena, `turn` from the y axis, with a gap in the middle."""
    mat = mat_from_angles(0.0, 0.0, np.float64(turn))
    for side in (1, -1):
        at = mat @ (0.0, side * (width / 2 + 3.0), height / 2)
        yield Shape(
            kind="box", size=(thick / 2, 3.0, height / 2), at=tuple(at), rotation=(0, 0, turn), surface="wall"
        )


@SPLIT
@given(
    radius=st.floats(0.15, 0.6),
    turn=st.floats(-0.7, 0.7),
    cell=st.sampled_from([0.05, 0.1]),
    spare=st.floats(0.0, 0.3),
)
def test_a_gap_passes_robots_that_are_narrower_by_three_squares_and_none_that_is_wider(
    radius, turn, cell, spare
):
    # A turned gap: an octagon may stick out of its circle by a twelfth (1/cos(22.5) is 1.082).
    wide, tight = 2 * radius * 1.09 + 4.3 * cell + spare, 2 * radius / 1.09 - spare
    assert reach(*gap(wide, turn), radius=radius, cell=cell).reachable(2.0, 0.0)
    assert not reach(*gap(tight, turn), radius=radius, cell=cell).reachable(2.0, 0.0)


@SPLIT
@given(radius=st.floats(0.15, 0.6), cell=st.sampled_from([0.05, 0.1]), shift=st.floats(0.0, 0.1))
def test_straight_gaps_are_as_the_docstring_says(radius, cell, shift):
    walls = [replace(wall, at=(wall.at[0], wall.at[1] + shift, 0.5)) for wall in gap(2 * radius + 3 * cell)]
    assert reach(*walls, radius=radius, cell=cell).reachable(2.0, 0.0)
    walls = [replace(wall, at=(wall.at[0], wall.at[1] + shift, 0.5)) for wall in gap(2 * radius - 1e-3)]
    assert not reach(*walls, radius=radius, cell=cell).reachable(2.0, 0.0)


def test_places_all_at_once_are_those_one_by_one():
    there = reach(*gap(0.4, 0.3), radius=0.25)
    places = np.random.default_rng(0).uniform(-6.0, 6.0, (40, 25, 2))
    found = there.reachable_points(places)
    assert found.tolist() == [[there.reachable(*place) for place in row] for row in places.tolist()]
    assert found.any()
    assert not found.all()


@SPLIT
@given(thick=st.floats(0.001, 0.3), at=st.floats(-1.0, 1.0), turn=st.floats(-0.7, 0.7))
def test_no_wall_is_too_thin_to_be_seen(thick, at, turn):
    walls = [
        replace(wall, at=(wall.at[0] + at, wall.at[1], 0.5)) for wall in gap(0.0, turn=turn, thick=thick)
    ]
    assert not reach(*walls, radius=0.1).reachable(2.0, 0.0)


@pytest.mark.parametrize(("height", "passes"), [(0.05, True), (0.06, True), (0.061, False), (0.3, False)])
def test_a_board_is_climbed_up_to_the_step(height, passes):
    board = block((-0.1, -3.0, 0.0), (0.1, 3.0, height))
    assert reach(board).reachable(2.0, 0.0) is passes


@pytest.mark.parametrize(("height", "passes"), [(0.39, False), (0.41, True)])
def test_a_beam_leaves_room_or_does_not(height, passes):
    beam = block((-0.1, -3.0, height), (0.1, 3.0, 1.0))
    assert reach(beam, height=0.4).reachable(2.0, 0.0) is passes


def ramp(degrees, top):
    """A slope from the floor at x = -0.5 up to that height, and a deck behind it."""
    angle = math.radians(degrees)
    length, half = top / math.sin(angle), 0.02
    x = -0.5 + length / 2 * math.cos(angle) + half * math.sin(angle)
    z = length / 2 * math.sin(angle) - half * math.cos(angle)
    slope = Shape(
        kind="box", size=(length / 2, 1.0, half), at=(x, 0, z), rotation=(0, -angle, 0), surface="ground"
    )
    edge = -0.5 + top / math.tan(angle)
    return slope, block((edge, -1.0, top - 0.04), (3.0, 1.0, top))


@pytest.mark.parametrize(("degrees", "passes"), [(15, True), (29, True), (31, False), (45, False)])
def test_slopes_are_climbed_up_to_their_limit(degrees, passes):
    deck = reach(*ramp(degrees, 0.5), cell=0.05, slope=math.radians(30))
    assert deck.reachable(2.0, 0.0, 0.5) is passes
    assert deck.fits(2.0, 0.0, 0.5)


@pytest.mark.parametrize(("top", "under"), [(0.6, True), (0.4, False)])
def test_a_deck_can_be_driven_on_and_under(top, under):
    deck = reach(*ramp(20, top), height=0.4, cell=0.05)
    assert deck.reachable(2.0, 0.0, top)
    assert deck.reachable(2.5, 0.0, 0.0) is under


def test_without_a_floor_robots_stay_on_what_there_is():
    pier = block((-3.0, -1.0, -0.1), (0.0, 1.0, 0.0))
    island = block((0.5, -1.0, -0.1), (3.0, 1.0, 0.0))
    bridge = block((-0.5, -0.5, -0.1), (1.0, 0.5, 0.02))
    alone = reach(pier, island, keys={"has_floor": False})
    assert alone.reachable(-1.0, 0.0)
    assert not alone.reachable(2.0, 0.0)
    assert alone.fits(2.0, 0.0)
    assert not alone.fits(-0.1, 0.0)  # over the edge
    assert reach(pier, island, bridge, keys={"has_floor": False}).reachable(2.0, 0.0)


def test_near_is_measured_around_walls():
    wall = block((0.0, -3.0, 0.0), (0.1, 3.0, 1.0))
    assert not reach(wall).reaches_within(0.3, 0.0)  # 0.6 m from where the robot gets, behind a wall
    end = block((0.0, -3.0, 0.0), (0.1, 0.0, 1.0))
    corner = block((0.0, -0.5, 0.0), (3.0, -0.4, 1.0))
    around = reach(end, corner, cell=0.05)
    assert not around.reachable(0.3, -0.2)
    assert around.reaches_within(0.3, -0.2)
    assert not around.reaches_within(0.3, -1.5, distance=0.3)


def test_a_start_inside_a_wall_reaches_nothing():
    lost = reach(block((-2.5, -0.5, 0.0), (-1.5, 0.5, 1.0)))
    assert lost.start_area == -1
    assert not lost.fits(-2.0, 0.0, 0.0)
    assert not lost.reachable(2.0, 0.0)
    assert not lost.reaches_within(2.0, 0.0)
    assert lost.fits(2.0, 0.0)


def test_places_outside_the_grid_are_not_reached():
    assert not reach().reachable(10.0, 0.0)
    assert not reach().reaches_within(10.0, 0.0)


def test_loose_objects_stand_in_the_way_and_what_is_only_seen_does_not():
    wall = block((-0.1, -3.0, -0.5), (0.1, 3.0, 0.5))
    assert reach(replace(wall, surface="fixture")).reachable(2.0, 0.0)
    assert reach(replace(wall, material="sky")).reachable(2.0, 0.0)
    beside = Shape(kind="box", size=(3.0, 0.1, 0.5), at=(1.0, 0.0, 0.0), mass=1.0, surface="loose")
    turned = LooseObject(name="beam", at=(0.0, -1.0, 0.5), rotation=(0, 0, math.pi / 2), shapes=(beside,))
    assert not reach(keys={"loose": (turned,)}).reachable(2.0, 0.0)


def test_victims_stand_in_the_way_and_are_reached_beside_any_part():
    walls = [replace(wall, at=(wall.at[0], wall.at[1], 0.5)) for wall in gap(0.9, thick=2.4)]
    # Lying across a corridor 0.9 m wide, which ends behind it: beside its hip it cannot be passed.
    victim = Victim(name="V", at=(0.0, 0.2, 0.11))
    there = reach(*walls, cell=0.05, keys={"victims": (victim,)})
    assert reach(*walls, cell=0.05).reachable(2.0, 0.0)
    assert not there.reachable(2.0, 0.0)
    with_victim = arena(*walls, victims=(victim,))
    assert victims_reached(with_victim, there) == [True]
    # Its head, towards -x, ends 0.79 m from its pelvis; robots from there stop 0.3 m before it.
    assert victims_reached(with_victim, there, distance=0.3) == [False]
    assert not there.reaches_within(0.0, 0.2, distance=0.5)


def test_a_victims_solids_are_where_the_compiled_arena_has_them():
    victim = Victim(name="V", at=(0.3, -0.2, 0.12), rotation=(0.1, -0.2, 2.0), posture="sitting")
    model = new_spec(arena(victims=(victim,)), Physics()).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    parts = list(shapes_in_arena(victim))
    assert len(parts) == 11
    for part in parts:
        gaps = np.abs(data.geom_xpos - part.at).max(1)
        geom = gaps.argmin()
        assert gaps[geom] < SINGLE
        np.testing.assert_allclose(model.geom_size[geom], part.size, atol=SINGLE)
        turned = mat_from_angles(*np.array(part.rotation))
        np.testing.assert_allclose(data.geom_xmat[geom].reshape(3, 3), turned, atol=SINGLE)


def test_all_starts_of_the_yellow_arena_are_reached_by_a_p2at():
    size = footprint_of(P2AT)
    there = reach_map(YELLOW, size.radius, size.step, height=size.height)
    assert size.radius == pytest.approx(math.hypot(0.5238, 0.4968) / 2)  # captured GEO
    assert [start.tag for start in YELLOW.starts if not there.reachable(*start.at[:2])] == []


def test_robots_that_climb_no_board_miss_what_lies_behind_the_yellow_arenas_boards():
    # As tests/models/arenas/test_yellow.py finds with distances from boxes instead of squares.
    behind = {(7, 0), (8, 0), (8, 1), (7, 2), (8, 2), (9, 3)}
    there = reach_map(YELLOW, footprint_of(P2AT).radius, 0.03)
    starts = zip(START_CELLS, YELLOW.starts[1:], strict=True)
    assert {cell for cell, start in starts if not there.reachable(*start.at[:2])} == behind


def test_large_arenas_get_coarser_squares():
    wide = replace(arena(), extent=((-400.0, 400.0), (-400.0, 400.0)))
    made = reach_map(wide, RADIUS, STEP)
    assert made.grid.cell == pytest.approx(0.8)
    assert made.reachable(399.0, -399.0)


def rays(shape, x, y):
    """Upper and lower end of a solid over places, by C MuJoCo's rays; None where they miss."""
    spec = mujoco.MjSpec()
    keys = {"pos": shape.at, "quat": quat_from_angles(*shape.rotation)}
    if shape.kind == "mesh":
        mesh = spec.add_mesh(name="m", uservert=shape.mesh.vertices.ravel())
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="m", **keys)
    else:
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=shape.size, **keys)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)

    def end(side):
        ids = np.zeros(1, np.int32)
        origin, down = np.array([x, y, 10.0 * side]), np.array([0.0, 0.0, -1.0 * side])
        distance = mujoco.mj_ray(model, data, origin, down, None, 1, -1, ids)
        return None if distance < 0 else side * (10.0 - distance)

    return end(-1), end(1)


def column(shape, x, y):
    grid = Grid(low=(x - FINE / 2, y - FINE / 2), cell=FINE, shape=(1, 1))
    found = rasterize([shape], grid)
    return (None, None) if not len(found.low) else (found.low[0], found.high[0])


ANGLES = st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
SPOT = st.floats(-0.4, 0.4)


@SPLIT
@given(angles=ANGLES, x=SPOT, y=SPOT, a=st.floats(0.1, 0.5), b=st.floats(0.1, 0.5), c=st.floats(0.1, 0.5))
def test_boxes_are_cut_where_c_mujocos_rays_meet_them(angles, x, y, a, b, c):
    shape = Shape(kind="box", size=(a, b, c), at=(0.1, 0.0, 0.3), rotation=angles, surface="ground")
    compare(shape, x, y)


@SPLIT
@given(angles=ANGLES, x=SPOT, y=SPOT, seed=st.integers(0, 99))
def test_meshes_are_cut_where_c_mujocos_rays_meet_their_hulls(angles, x, y, seed):
    vertices = np.random.default_rng(seed).uniform(-0.5, 0.5, (8, 3))
    shape = Shape(kind="mesh", mesh=Mesh(vertices), at=(0.1, 0.0, 0.3), rotation=angles, surface="ground")
    compare(shape, x, y)


def compare(shape, x, y):
    """Solids are wider by half a square: that moves an end by no more than the next squares' ends differ."""
    seen, found = rays(shape, x, y), column(shape, x, y)
    around = [
        rays(shape, x + dx, y + dy) for dx, dy in ((FINE, 0.0), (-FINE, 0.0), (0.0, FINE), (0.0, -FINE))
    ]
    inside = [None not in ends for ends in (seen, *around)]
    if not any(inside):
        assert found == (None, None)
    elif all(inside):
        change = np.abs(np.array(around, float) - np.array(seen, float)).max(0)
        assert (np.abs(np.array(found) - seen) <= ROUNDING + 2 * change).all()


@pytest.mark.parametrize(
    ("kind", "size", "ends"),
    [
        ("sphere", (0.3,), (0.2, 0.8)),
        ("capsule", (0.1, 0.3), (0.1, 0.9)),
        ("cylinder", (0.1, 0.3), (0.2, 0.8)),
        ("ellipsoid", (0.1, 0.2, 0.4), (0.1, 0.9)),
    ],
)
def test_round_solids_are_the_boxes_around_them(kind, size, ends):
    shape = Shape(kind=kind, size=size, at=(0.0, 0.0, 0.5), surface="ground")
    assert column(shape, 0.09, 0.09) == pytest.approx(ends)


def test_terrain_is_passable_where_it_is_not_too_steep():
    along = np.linspace(0.0, 6.0, 61)
    for rise, passes in ((0.5, True), (0.7, False)):  # tan 30 degrees is 0.577
        heights = np.tile(np.maximum(0.0, 0.8 - rise * np.abs(along - 3.0)), (41, 1))
        hill = Shape(kind="hfield", size=(3.0, 2.0, 1.0, 0.1), heights=HeightField(heights), surface="ground")
        there = reach(hill, cell=FAST)
        assert there.reachable(2.0, 0.0) is passes
        height = 0.8 - rise * 0.5
        assert there.fits(-0.5, 0.0, height) is passes
        assert not there.fits(-0.5, 0.0, height + 0.2)
