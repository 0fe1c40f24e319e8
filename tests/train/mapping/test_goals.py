"""Goals on small maps of known squares: positions, lengths and ways."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from usarmjx.train.mapping.maps import FREE, UNKNOWN, WALL, MapGrid
from usarmjx.train.mapping.planning import (
    BLOCK,
    GAIN_RADIUS,
    WAY_SQUARES,
    WAYPOINT_SQUARES,
    block_minima,
    box_sum,
    find_goals,
    next_on_way,
    way_to,
    where_due,
)
from usarmjx.train.mapping.wavefront import UNREACHABLE, frontier

CELL = 0.3
GRID = MapGrid(low=(0.0, 0.0), cell=CELL, shape=(5, 40))


@pytest.fixture(scope="module")
def corridor():
    """A corridor along y of free squares 1 to 3, walls beside it; from j = 30 on all is unknown."""
    squares = np.full(GRID.shape, WALL, np.uint8)
    squares[1:4] = FREE
    squares[:, 30:] = UNKNOWN
    return jnp.asarray(squares)


def pose_at(i, j):
    """Pose of a robot in the middle of a square."""
    return jnp.array([i * CELL, j * CELL, 0.0])


def test_sums_over_boxes_are_those_of_numpy():
    values = np.random.default_rng(0).integers(0, 5, (9, 13)).astype(float)
    padded = np.pad(values, 2)
    wanted = np.lib.stride_tricks.sliding_window_view(padded, (5, 5)).sum((2, 3))
    np.testing.assert_allclose(box_sum(values, 2), wanted)


def test_each_block_offers_its_lowest_square():
    costs = np.full((20, 2 * BLOCK), UNREACHABLE)
    costs[1, 2], costs[2, 2] = 5.0, 4.0  # one block
    costs[19, 15] = 3.0  # the last one, cut short by the map
    square, cost = block_minima(jnp.asarray(costs), 8)  # there are six blocks
    assert square[:2].tolist() == [[19, 15], [2, 2]]
    assert cost[:2].tolist() == [3.0, 4.0]
    assert (np.asarray(cost[2:]) >= UNREACHABLE).all()


def test_goals_are_the_base_others_and_the_frontier_at_the_end_of_the_corridor(corridor):
    places = jnp.array([[2 * CELL, 4 * CELL], [2 * CELL, 36 * CELL]])  # behind, and in the unknown
    goals = find_goals(GRID, corridor, pose_at(2, 10), frontier(corridor), places, count=3)
    assert goals.valid.tolist() == [True, False, True, False, False]
    # The middle of the corridor has no wall beside it; a base counts from the nearest free square to it.
    assert goals.length[0] == pytest.approx(5.0)
    assert goals.length[2] == pytest.approx(19.0)
    np.testing.assert_allclose(goals.position[2], [2 * CELL, 29 * CELL], rtol=1e-6)
    unknown = 5 * GAIN_RADIUS  # of the box, the squares of the map beyond j = 29
    assert goals.gain[2] == pytest.approx(unknown / (2 * GAIN_RADIUS + 1) ** 2)


def test_ways_lead_square_by_square_to_the_goal_and_end_there(corridor):
    goal = jnp.array([2 * CELL, 14 * CELL])
    way = np.asarray(way_to(GRID, corridor, pose_at(2, 10), goal))
    assert way.shape == (WAY_SQUARES, 2)
    np.testing.assert_allclose(way[:4, 1], CELL * np.arange(11, 15), rtol=1e-6)
    np.testing.assert_allclose(way[4:], np.broadcast_to(goal, way[4:].shape), rtol=1e-6)
    nowhere = way_to(
        GRID, corridor, pose_at(2, 10), jnp.array([0.0, 0.0]), blocked=jnp.ones(GRID.shape, bool)
    )
    np.testing.assert_allclose(nowhere, np.broadcast_to([2 * CELL, 10 * CELL], way.shape), rtol=1e-6)


def test_a_robot_steers_for_a_position_ahead_of_the_nearest_on_its_way():
    way = jnp.stack([jnp.zeros(8), CELL * jnp.arange(8)], -1)
    ahead = next_on_way(way, jnp.array([0.05, 2 * CELL]))
    assert ahead[1] == pytest.approx((2 + WAYPOINT_SQUARES - 1) * CELL)
    assert next_on_way(way, jnp.array([0.0, 7 * CELL]))[1] == pytest.approx(7 * CELL)


def test_what_is_not_due_stays_and_is_not_computed():
    calls = []

    def double(x):
        jax.debug.callback(lambda: calls.append(1))
        return 2 * x

    def run(due, old, x):
        return where_due(double, due, old, x)

    old, x = jnp.array([1.0, 2.0]), jnp.array([10.0, 20.0])
    mapped = jax.jit(jax.vmap(run))
    assert mapped(jnp.array([False, True]), old, x).tolist() == [1.0, 40.0]
    jax.effects_barrier()
    assert calls
    calls.clear()
    assert mapped(jnp.zeros(2, bool), old, x).tolist() == [1.0, 2.0]
    jax.effects_barrier()
    assert not calls
    assert run(jnp.array(True), old[0], x[0]) == 20.0
