"""MovingAI's maps and scenarios, and covers of grids by rectangles."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from tests.models.files.worlds import write
from usarmjx.base.errors import ArenaFileError
from usarmjx.models.check import check_arena
from usarmjx.models.files.load import load_arena, read_arena
from usarmjx.models.files.maps import MAX_DISJOINT, cover, overlapping_rectangles, rectangles
from usarmjx.models.files.mesh_solids import convex_parts

MAP = """type octile
height 4
width 6
map
@@@@@@
@.G.S@
@.TW.@
@@@@@@
"""


def test_letters_are_walls_floor_and_barriers(tmp_path):
    arena, notes = read_arena(write(tmp_path / "a.map", MAP))
    height = np.zeros((4, 6))
    for shape in arena.shapes:
        (x0, y0), (x1, y1) = (
            np.rint(np.array(shape.at[:2]) + s * np.array(shape.size[:2])).astype(int) for s in (-1, 1)
        )
        height[y0:y1, x0:x1] = 2 * shape.size[2]
    letters = np.array([list(row) for row in MAP.splitlines()[4:]])[::-1]
    wanted = np.select([np.isin(letters, ["@", "T"]), letters == "W"], [1.2, 0.3], 0.0)
    np.testing.assert_allclose(height, wanted)
    assert arena.extent == ((0, 6), (0, 4))
    assert [note.rpartition("a.map:")[2] for note in notes] == [
        "6: 1 cells S are swamp: floor here",
        "7: 1 cells W are water: a barrier of 0.3 m here",
    ]
    _, notes = read_arena(write(tmp_path / "a.map", f"{MAP}\n@@@@@@\n"))
    assert notes[-1].endswith("a.map:10: lines after the 4 rows are left out")
    scaled = load_arena(write(tmp_path / "a.yaml", "moving_ai: {file: a.map, cell: 2.5, height: 3}"))
    assert scaled.extent == ((0, 15), (0, 10))
    assert max(shape.size[2] for shape in scaled.shapes) == 1.5


def scenario(*rows):
    return "version 1\n" + "\n".join(f"0\tmaps/a.map\t6\t4\t{row}\t3.4" for row in rows) + "\n"


def test_rows_of_a_scenario_are_starts_and_goals(tmp_path):
    (tmp_path / "maps").mkdir()
    write(tmp_path / "maps/a.map", MAP)
    text = scenario("1 1 4 2", "1 1 3 1", "2 1 4 1")
    arena, notes = read_arena(write(tmp_path / "a.map.scen", text))
    assert [(start.tag, start.at[:2]) for start in arena.starts] == [
        ("Start1", (1.5, 2.5)),
        ("Start2", (2.5, 2.5)),
        ("Goal1", (4.5, 1.5)),
        ("Goal2", (4.5, 2.5)),
    ]
    assert "a.map.scen:3: 1 of 3 rows are left out: a cell of theirs is taken, or" in notes[-1]
    assert check_arena(arena) == []


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (MAP.replace("S@", "S@@"), r"a\.map:6: 7 cells in the row, expected 6"),
        (MAP.replace("G", "x"), r"a\.map:6: no cell is 'x'; allowed: \., G, S, @, O, T, W"),
        (MAP[:-14], r"a\.map: ends after 2 of 4 rows"),
        (MAP.replace("height 4", "height four"), r"a\.map:2: 'four' is no whole number"),
        ("type octile\n", "has no line `map`"),
        ("P2\n1 1\n", r"a\.map:1: 'P2' is no line of a map's head"),
        (MAP.replace("height 4\n", ""), "height and width come before `map`"),
    ],
)
def test_a_mistake_in_a_map_is_named(text, says, tmp_path):
    with pytest.raises(ArenaFileError, match=says):
        load_arena(write(tmp_path / "a.map", text))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (scenario("1 1 0 0"), r"a\.scen:2: the cell 0 0 is not free on a\.map"),
        (scenario("1 1 9 9"), r"a\.scen:2: the cell 9 9 is not free"),
        (
            scenario("1 1 4 2").replace("a.map", "gone.map"),
            r"a\.scen:2: the map 'maps/gone.map' is not there",
        ),
        (scenario("1 1"), r"a\.scen:2: 7 words, expected 9"),
        ("0 a.map", "a scenario begins with `version`"),
        ("version 1\n", "names no map"),
    ],
)
def test_a_mistake_in_a_scenario_is_named(text, says, tmp_path):
    write(tmp_path / "a.map", MAP)
    with pytest.raises(ArenaFileError, match=says):
        load_arena(write(tmp_path / "a.scen", text))


@given(arrays.arrays(bool, st.tuples(st.integers(1, 8), st.integers(1, 8))))
def test_overlapping_rectangles_cover_what_is_filled_and_nothing_else(filled):
    count = np.zeros(filled.shape, int)
    found = overlapping_rectangles(filled)
    for r0, r1, c0, c1 in found:
        count[r0:r1, c0:c1] += 1
    np.testing.assert_array_equal(count > 0, filled)
    assert all((count[r0:r1, c0:c1] == 1).any() for r0, r1, c0, c1 in found)  # none is to spare


def test_lines_that_cross_are_a_rectangle_each():
    filled = np.zeros((200, 200), bool)
    filled[5::10] = filled[:, 5::10] = True
    assert len(rectangles(filled)) == 20 + 20 * 21
    assert sorted(cover(filled)) == sorted(
        [(i, i + 1, 0, 200) for i in range(5, 200, 10)] + [(0, 200, i, i + 1) for i in range(5, 200, 10)]
    )


def jagged(size, seed=0):
    """A plan of walls as SLAM draws them: askew, one to three cells thick, with holes."""
    rng = np.random.default_rng(seed)
    filled = np.zeros((size, size), bool)
    for _ in range(size // 12):
        x, y, angle = *rng.uniform(0, size, 2), rng.uniform(0, np.pi)
        along = np.arange(0, size / 3, 0.5)
        for width in range(int(rng.integers(1, 4))):
            i, j = (np.rint(y + along * np.sin(angle) + width), np.rint(x + along * np.cos(angle)))
            inside = (i >= 0) & (i < size) & (j >= 0) & (j < size) & (rng.random(len(along)) < 0.95)
            filled[i[inside].astype(int), j[inside].astype(int)] = True
    return filled


def test_a_jagged_plan_takes_no_more_boxes_than_a_partition():
    filled = jagged(300)
    apart = min(len(rectangles(filled)), len(rectangles(filled.T)))
    found = cover(filled)
    assert apart > MAX_DISJOINT
    assert len(found) <= apart
    covered = np.zeros(filled.shape, bool)
    for r0, r1, c0, c1 in found:
        covered[r0:r1, c0:c1] = True
    np.testing.assert_array_equal(covered, filled)


@given(st.integers(0, 10_000))
def test_polygons_are_cut_into_convex_ones_of_the_same_area(seed):
    """A star-shaped polygon: corners at growing angles, at any distance."""
    rng = np.random.default_rng(seed)
    angles = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 12)))
    corners = rng.uniform(0.2, 2.0, len(angles))[:, None] * np.stack([np.cos(angles), np.sin(angles)], 1)
    if max(np.diff(angles, append=angles[0] + 2 * np.pi)) > np.pi - 0.01:
        return  # the middle is not inside

    def area(ring):
        x, y = ring.T
        return (x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2

    parts = convex_parts(corners)
    assert sum(area(part) for part in parts) == pytest.approx(area(corners), abs=1e-9)
    for part in parts:
        sides = np.roll(part, -1, 0) - part
        after = np.roll(sides, -1, 0)
        turns = sides[:, 0] * after[:, 1] - sides[:, 1] * after[:, 0]
        assert (turns > -1e-9).all()
