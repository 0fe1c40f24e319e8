"""Pictures of maps at three scales: against loops over points and squares, and turned with the robot."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from usarmjx.train.mapping.maps import FREE, UNKNOWN, WALL, MapGrid
from usarmjx.train.tasks.goal_features import CHANNELS, LEVELS, WIDTH, map_pyramid

CELL = 0.3
GRID = MapGrid(low=(-2.0, 1.0), cell=CELL, shape=(45, 37))
SQUARE = MapGrid(low=(0.0, 0.0), cell=CELL, shape=(64, 64))


def drawn_map(grid, seed):
    draw = np.random.default_rng(seed)
    squares = draw.choice([UNKNOWN, FREE, WALL], grid.shape, p=[0.3, 0.5, 0.2]).astype(np.uint8)
    return squares, (squares == FREE) & (draw.random(grid.shape) < 0.4)


def is_frontier(squares, i, j):
    """A free square beside an unknown one."""
    beside = [(i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)]
    inside = [(a, b) for a, b in beside if 0 <= a < squares.shape[0] and 0 <= b < squares.shape[1]]
    return squares[i, j] == FREE and any(squares[a, b] == UNKNOWN for a, b in inside)


def point_by_loops(grid, squares, news, pose, level, place):
    """The first four numbers of a point, square by square."""
    side = 2 * 2**level
    ahead, aside = ((k - (WIDTH - 1) / 2) * side * grid.cell for k in place)
    x = pose[0] + math.cos(pose[2]) * ahead - math.sin(pose[2]) * aside
    y = pose[1] + math.sin(pose[2]) * ahead + math.cos(pose[2]) * aside
    block = [
        math.floor(((v - low) / grid.cell + 0.5) / side) for v, low in zip((x, y), grid.low, strict=True)
    ]
    total = np.zeros(4)
    for i in range(block[0] * side, (block[0] + 1) * side):
        for j in range(block[1] * side, (block[1] + 1) * side):
            if 0 <= i < grid.shape[0] and 0 <= j < grid.shape[1]:
                kind = squares[i, j]
                total += [kind == FREE, kind == WALL, is_frontier(squares, i, j), news[i, j]]
    return total / side**2


@pytest.mark.oracle
def test_each_point_has_the_shares_of_its_squares():
    squares, news = drawn_map(GRID, 0)
    pose = np.array([3.1, 5.7, 0.83])
    nobody = np.zeros((2, 2)), np.zeros(2, bool)
    found = np.asarray(map_pyramid(GRID, squares, news, pose, *nobody))
    assert found.shape == (LEVELS, WIDTH, WIDTH, len(CHANNELS))
    wanted = np.array(
        [
            [
                [point_by_loops(GRID, squares, news, pose, level, (a, b)) for b in range(WIDTH)]
                for a in range(WIDTH)
            ]
            for level in range(LEVELS)
        ]
    )
    # A point that lies within rounding of the edge of two blocks may be in either: none does here.
    assert_allclose(found[..., :4], wanted, atol=1e-6)
    assert (found[..., 4] == 0).all()
    assert (wanted[2].sum((0, 1)) > 0).all()


def test_others_are_counted_where_they_were_heard_of():
    squares, news = np.zeros(SQUARE.shape, np.uint8), np.zeros(SQUARE.shape, bool)
    pose = np.array([9.0, 9.0, math.pi / 2])  # ahead is y, to the left is -x
    others = np.array([[9.0 + 0.9, 9.0 + 1.5], [9.0 + 0.9, 9.0 + 1.5], [9.0, 90.0], [8.0, 8.0]])
    heard = np.array([True, True, True, False])
    found = np.asarray(map_pyramid(SQUARE, squares, news, pose, others, heard))[..., 4]
    for level in range(LEVELS):
        spacing = 0.6 * 2**level
        place = math.floor(1.5 / spacing + 8), math.floor(-0.9 / spacing + 8)
        assert found[level][place] == 2
        assert found[level].sum() == 2


def test_the_picture_turns_with_the_robot():
    """By quarters of a turn about the middle of a square map, whose blocks fall on each other."""
    squares, news = drawn_map(SQUARE, 1)
    middle = (SQUARE.shape[0] - 1) / 2 * CELL
    pose, others = np.array([middle + 2.23, middle - 1.41, 0.37]), np.array([[middle, middle + 3.3]])
    heard = np.ones(1, bool)
    before = np.asarray(map_pyramid(SQUARE, squares, news, pose, others, heard))

    def turned(at):
        return np.array([middle - (at[1] - middle), middle + (at[0] - middle)])

    # Square (i, j) goes to (n - 1 - j, i): the axes of arrays are x and y.
    maps = [np.rot90(one, -1)[::-1, ::-1] for one in (squares, news)]
    quarter = np.array([*turned(pose), pose[2] + math.pi / 2])
    after = np.asarray(map_pyramid(SQUARE, *maps, quarter, turned(others[0])[None], heard))
    assert before[..., :4].std() > 0.05
    assert_allclose(after, before, atol=1e-6)
