"""Elements of the NIST arenas against closed forms, by rays of C MuJoCo from above."""

import math

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.rig import Rig
from tests.terrain import arena_of, heights, loose_qpos, loose_speeds
from usarmjx.base.errors import SpecError
from usarmjx.base.transforms import mat_from_angles
from usarmjx.models.arenas.pieces import (
    CELL,
    CINDER_SIZE,
    PIPE_DIAMETER,
    POST,
    RISE,
    STEEP,
    STEEPER,
    STEP_FIELDS,
    STEP_PIPE_DIAMETER,
    brick,
    cinder_block,
    cover_boxes,
    deck,
    drum,
    loose_board,
    loose_cinder_block,
    loose_pipe,
    pallet,
    paper,
    pipe,
    pipe_steps,
    plank,
    ramp,
    ramps,
    rubble,
    slab,
    slope,
    stairs,
    step_field,
)
from usarmjx.models.arenas.pieces import heights as posts_of

ATOL = 1e-9  # m: rays in double precision
SINK = 1e-3  # m: how deep MuJoCo's soft contacts let things sink
FIFTEEN = math.tan(math.radians(15))
INSET = 1e-4  # m: off an edge

HEADINGS = pytest.mark.parametrize("uphill", [0.0, math.pi / 2, math.pi, -math.pi / 2, 0.6])


def along(start, heading, distances):
    """Points at distances from `start` on a line."""
    ahead = np.array([math.cos(heading), math.sin(heading)])
    return np.asarray(start) + np.outer(distances, ahead)


# Slopes


@HEADINGS
def test_a_ramp_rises_out_of_the_floor_at_15_degrees(uphill):
    foot = along((0.3, -0.2), uphill, [-0.55 - 0.1 * math.sin(math.radians(15))])[0]
    run = np.array([-0.1, INSET, 0.3, 0.9, 1.1 - INSET])
    found = heights(arena_of(ramp((0.3, -0.2), uphill)), along(foot, uphill, run))
    np.testing.assert_allclose(found, np.maximum(run, 0.0) * FIFTEEN, atol=ATOL)


def test_a_slope_goes_from_the_edge_that_is_given_to_the_other():
    foot, head = np.array([-1.0, 0.5, 0.2]), np.array([1.4, -1.3, 0.9])  # 3.0 m in plan
    uphill = math.atan2(-1.8, 2.4)
    share = np.array([INSET, 0.25, 0.8, 1.0 - INSET])
    arena = arena_of(slope(tuple(foot), tuple(head), 0.8))
    expected = 0.2 + 0.7 * share
    for side in (-0.4 + INSET, 0.0, 0.4 - INSET):
        points = foot[:2] + np.outer(share, head[:2] - foot[:2])
        points += side * np.array([-math.sin(uphill), math.cos(uphill)])
        np.testing.assert_allclose(heights(arena, points), expected, atol=ATOL)
    beside = foot[:2] + 0.5 * (head - foot)[:2] + 0.41 * np.array([-math.sin(uphill), math.cos(uphill)])
    assert heights(arena, [beside]) == pytest.approx([0.0])


def test_arrows_are_ramps_of_a_cell_that_climb_their_way():
    arena = arena_of(*ramps("><\n.^", (-1.2, -1.2)))
    half = [(-0.6, 0.6), (0.6, 0.6), (0.6, -0.6), (-0.6, -0.6)]
    np.testing.assert_allclose(heights(arena, half), [0.6 * FIFTEEN] * 3 + [0.0], atol=ATOL)
    ridge = heights(arena, [(-INSET, 0.6), (INSET, 0.6)])  # the hill is as high on both sides: continuous
    np.testing.assert_allclose(ridge, (CELL - INSET) * FIFTEEN, atol=ATOL)
    # Where arrows cross it is not; the end of a slab leans out by 10 cm x sin 15.
    tooth = heights(arena, [(0.3, -INSET), (0.3, 0.03)])
    np.testing.assert_allclose(tooth, [(CELL - INSET) * FIFTEEN, 0.9 * FIFTEEN], atol=ATOL)


def test_half_ramps_are_half_as_high():
    arena = arena_of(*ramps("<", (0.0, 0.0), side=CELL / 2))
    assert heights(arena, [(INSET, 0.3)]) == pytest.approx([(CELL / 2 - INSET) * FIFTEEN], abs=ATOL)


def test_other_letters_in_a_plan_of_ramps_are_refused():
    with pytest.raises(SpecError, match="'x'"):
        ramps("><\nx>", (0.0, 0.0))


# Stairs


@HEADINGS
@pytest.mark.parametrize(("angle", "degrees"), [(STEEP, 35.0), (STEEPER, 40.0)])
def test_stairs_have_equal_rises_and_their_edges_lie_on_a_line_of_that_angle(uphill, angle, degrees):
    count, going = 6, RISE / math.tan(math.radians(degrees))
    arena = arena_of(*stairs((0.5, 0.1), uphill, count, angle=angle))
    assert len(arena.shapes) == count - 1, "the last rise is the edge of the floor above"
    edges = -going * np.arange(count - 1, 0, -1)  # of the steps, seen from the top
    for offset, rises in ((INSET, 1), (going / 2, 1), (-INSET, 0)):
        found = heights(arena, along((0.5, 0.1), uphill, edges + offset))
        np.testing.assert_allclose(found, RISE * (np.arange(count - 1) + rises), atol=ATOL)
    beyond = heights(arena, along((0.5, 0.1), uphill, [-going * (count - 1) - INSET, INSET]))
    np.testing.assert_allclose(beyond, 0.0, atol=ATOL)


def test_a_deck_has_room_under_it():
    arena = arena_of(deck((0.0, 0.0), (2.4, 1.2), 1.26))
    assert heights(arena, [(1.0, 1.0), (2.4 + INSET, 1.0)]) == pytest.approx([1.26, 0.0], abs=ATOL)
    (shape,) = arena.shapes
    assert shape.at[2] - shape.size[2] == pytest.approx(1.16)


# Step fields


def middles(count):
    return POST * (np.arange(count) - (count - 1) / 2)


@pytest.mark.parametrize("pattern", STEP_FIELDS)
@pytest.mark.parametrize("unit", [POST, POST / 2])
@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_every_post_of_a_step_field_is_as_high_as_drawn(pattern, unit, turns):
    drawn = np.array([[int(digit) for digit in row] for row in STEP_FIELDS[pattern].split()])
    assert drawn.shape == (12, 12), "1.2 m of posts 10 cm wide"
    assert drawn.max() <= 4
    seen = np.rot90(drawn, turns)  # counter-clockwise in the picture and from above
    at = np.array([0.4, -0.7])
    arena = arena_of(*step_field(tuple(at), pattern, unit=unit, turns=turns))
    points = [
        at + np.array((x, y)) for y in middles(12)[::-1] for x in middles(12)
    ]  # rows of text from the top on
    for offset in ((0.0, 0.0), (POST / 2 - INSET, INSET - POST / 2)):
        found = heights(arena, np.add(points, offset)).reshape(12, 12)
        np.testing.assert_allclose(found, seen * unit, atol=ATOL)


@pytest.mark.parametrize("pattern", STEP_FIELDS)
def test_patterns_are_the_same_after_half_a_turn(pattern):
    grid = np.array(posts_of(STEP_FIELDS[pattern]))
    np.testing.assert_array_equal(grid, grid[::-1, ::-1])


def test_a_hill_has_its_ridge_across_and_a_diagonal_one_from_corner_to_corner():
    hill, diagonal = (np.array(posts_of(STEP_FIELDS[name])) for name in ("hill", "diagonal"))
    assert (hill.argmax(axis=0) >= 4).all()
    assert (hill.argmax(axis=0) <= 6).all()
    assert hill[:4].max() < 4
    assert (np.diag(diagonal[:, ::-1]) == 4).all()
    assert diagonal[0, 0] == diagonal[-1, -1] == 0
    assert np.array(posts_of(STEP_FIELDS["flat"])).max() - 1 == 1, "flat: by no more than a unit"


@settings(deadline=None)
@given(
    st.integers(1, 6).flatmap(
        lambda width: st.lists(
            st.lists(st.integers(0, 4), min_size=width, max_size=width), min_size=1, max_size=6
        )
    )
)
def test_few_boxes_have_the_same_top_as_one_per_post(grid):
    top = np.zeros_like(grid)
    boxes = cover_boxes(grid)
    for height, x0, x1, y0, y1 in boxes:
        top[x0:x1, y0:y1] = np.maximum(top[x0:x1, y0:y1], height)
    np.testing.assert_array_equal(top, grid)
    assert len(boxes) <= np.count_nonzero(grid)


def test_step_fields_are_few_boxes():
    assert {name: len(step_field((0.0, 0.0), name)) for name in STEP_FIELDS} == {
        "flat": 1 + sum(row.count("2") for row in STEP_FIELDS["flat"].split()),  # a box, and one per post
        "hill": 10,
        "diagonal": 18,
    }


@pytest.mark.parametrize("pattern", ["12\n1", "1a\n11", ""])
def test_step_fields_that_are_not_drawn_right_are_refused(pattern):
    with pytest.raises(SpecError, match="rows of digits"):
        step_field((0.0, 0.0), pattern)


# Pipes


def test_the_edges_of_a_pipe_lie_on_its_circle_and_it_lies_on_a_side():
    bars = pipe((0.0, 0.0), 1.0, diameter=0.2, z=0.3)
    corners = []
    for bar in bars:
        mat = np.array(mat_from_angles(*np.array(bar.rotation)))
        corners += [
            mat @ (0.0, y, z) for y in (-bar.size[1], bar.size[1]) for z in (-bar.size[2], bar.size[2])
        ]
    radii = np.hypot(*np.array(corners)[:, 1:].T)
    np.testing.assert_allclose(radii, 0.1, atol=ATOL)
    angles = np.sort(np.mod(np.degrees(np.arctan2(*np.array(corners)[:, 1:].T)), 360.0))
    np.testing.assert_allclose(np.diff(angles), 45.0, atol=1e-6)
    low = min(corner[2] for corner in corners) + bars[0].at[2]
    assert low == pytest.approx(0.3)
    assert sum(abs(corner[2] + bars[0].at[2] - low) < ATOL for corner in corners) == 2


def test_pipe_steps_are_level_with_their_pipes():
    arena = arena_of(*pipe_steps((0.0, 0.0), 0.0, 2, rise=0.2))
    points = [(0.3, 0.5), (0.9, -0.5), (0.0, 0.0), (0.6, 0.0)]
    # Over its axis a pipe of eight edges is highest by its upper side.
    np.testing.assert_allclose(heights(arena, points), [0.2, 0.4, 0.2, 0.4], atol=ATOL)
    reach = STEP_PIPE_DIAMETER / 2 * math.cos(math.pi / 8)  # to its sides, as to its top
    nose = heights(arena, [(INSET - reach, 0.0), (-INSET - reach, 0.0)])
    np.testing.assert_allclose(
        nose, [0.2 - reach + STEP_PIPE_DIAMETER / 2 * math.sin(math.pi / 8), 0.0], atol=2 * INSET
    )


# Debris


def test_sizes_of_debris():
    def full(shape):
        return tuple(2 * half for half in shape.size)

    assert full(cinder_block((0, 0))) == pytest.approx((0.39, 0.19, 0.19))
    assert full(plank((0, 0), 1.5)) == pytest.approx((1.5, 0.089, 0.038))
    assert full(paper((0, 0))) == pytest.approx((0.6, 0.42, 0.005))
    assert full(slab((0, 0, 1), (1.0, 0.8, 0.1))) == pytest.approx((1.0, 0.8, 0.1))
    arena = arena_of(*pallet((0.0, 0.0), yaw=math.pi / 2))
    found = heights(arena, [(0.4 - INSET, 0.6 - INSET), (0.4 + INSET, 0.0), (0.0, 0.6 + INSET)])
    np.testing.assert_allclose(found, [0.144, 0.0, 0.0], atol=ATOL)


def test_masses_of_loose_debris():
    def mass(loose):
        return sum(shape.mass for shape in loose.shapes)

    assert mass(loose_cinder_block("a", (0, 0))) == 13.0
    assert mass(loose_pipe("a", (0, 0), 0.5)) == pytest.approx(2.7)  # 5.4 kg/m
    assert mass(loose_board("a", (0, 0), (1.0, 0.5, 0.02))) == pytest.approx(6.0)  # 600 kg/m3


def test_a_rubble_pile_is_the_same_for_the_same_seed_and_reaches_the_ground():
    pile = rubble((1.0, 2.0), 0.9, 0.6, 16, seed=4)
    assert pile == rubble((1.0, 2.0), 0.9, 0.6, 16, seed=4)
    assert pile != rubble((1.0, 2.0), 0.9, 0.6, 16, seed=5)
    for chunk in pile:
        mat = np.abs(mat_from_angles(*np.array(chunk.rotation)))
        assert chunk.at[2] - mat[2] @ chunk.size < 0.0, "none floats"
    over = np.random.default_rng(0).uniform(-1.3, 1.3, (400, 2))
    found = heights(arena_of(*pile), over + np.array((1.0, 2.0)))
    far = np.hypot(*over.T)
    assert 0.6 <= found.max() < 0.85, "tilted chunks stick out by some of their half width"
    assert found[far < 0.3].mean() > 3 * found[far > 0.7].mean(), "a cone"


def test_corners_of_a_drum_lie_on_its_circle():
    for shape in drum("a", (0, 0), 15.0, radius=0.2, height=0.6).shapes:
        assert np.hypot(*shape.size[:2]) == pytest.approx(0.2)
        assert shape.size[2] == 0.3


def test_loose_debris_lies_where_it_is_put_and_stays():
    loose = (
        loose_cinder_block("block", (1.0, 0.0), yaw=0.3),
        brick("brick", (1.0, 0.0), z=CINDER_SIZE[2], yaw=1.0),  # on the block
        loose_pipe("pipe", (2.0, 0.0), 0.8, yaw=0.7),
        loose_board("board", (3.0, 0.0), (0.6, 0.4, 0.012), yaw=2.0),
    )
    rig = Rig("P2AT", loose=loose)
    mujoco.mj_kinematics(rig.model, rig.data)
    before = loose_qpos(rig)
    rig.run(3.0)
    np.testing.assert_allclose(loose_qpos(rig), before, atol=SINK)
    fastest = 0.0
    for _ in range(50):
        rig.step()
        fastest = max(fastest, loose_speeds(rig).max())
    assert fastest < 1e-3
    half = PIPE_DIAMETER / 2 * math.cos(math.pi / 8)
    assert rig.data.body("loose/pipe").xpos[2] == pytest.approx(half, abs=SINK)
