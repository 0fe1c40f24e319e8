"""Paths over maps: distances by waves, frontiers, the next square to drive to. Pure functions of one map."""

import math
from functools import reduce

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.backend import Array, ArrayLike
from usarmjx.base.warp_functions import warp_in_use
from usarmjx.train.mapping.fast_sweeping import UNREACHABLE, swept_distances
from usarmjx.train.mapping.maps import FREE, UNKNOWN, WALL, MapGrid

NEIGHBOURS = tuple((i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j)


def _framed(values: Array, edge: ArrayLike) -> jax.Array:
    """Return a map with a frame of one square (i + 2, j + 2)."""
    return jnp.pad(jnp.asarray(values), 1, constant_values=edge)  # pyright: ignore[reportUnknownMemberType]


def shifted(values: Array, step: tuple[int, int], edge: ArrayLike) -> jax.Array:
    """Return what lies one `step` further from each square (i, j); beyond the map it is `edge`."""
    (i, j), (rows, columns) = step, values.shape
    padded = _framed(values, edge)
    return padded[1 + i : 1 + i + rows, 1 + j : 1 + j + columns]


def has_neighbour(mask: Array, *, corners: bool = True) -> jax.Array:
    """Return which squares have a neighbour in a mask (i, j)."""
    steps = NEIGHBOURS if corners else [step for step in NEIGHBOURS if 0 in step]
    # One after the other, not stacked: so they melt into one loop over the squares.
    return reduce(jnp.logical_or, [shifted(mask, step, False) for step in steps])


def passable(squares: Array) -> jax.Array:
    """Return which squares a robot may drive through: free ones, no neighbour of which is a wall (i, j)."""
    return (squares == FREE) & ~has_neighbour(squares == WALL)


def frontier(squares: Array) -> jax.Array:
    """Return which free squares border on unknown ones (i, j)."""
    return (squares == FREE) & has_neighbour(squares == UNKNOWN, corners=False)


def distances(start: Array, open_: Array, toll: ArrayLike = 0.0, *, until: Array | None = None) -> jax.Array:
    """Return how far each square is from the nearest start, in squares (i, j); from `UNREACHABLE` on: no way.

    Steps go to all eight neighbours, slanting ones count sqrt(2). Distances spread from the starts through
    the open squares until nothing changes.

    Args:
        start: Cost at the beginning of a way that begins in a square; `UNREACHABLE`: none begins there
            (i, j).
        open_: Which squares ways lead through; those that ways begin in need not be (i, j).
        toll: Cost of entering a square, beside the step (i, j).
        until: A square (2,) that is asked for: only for it, and for what lies on the way from it, the
            distances are right, and found the sooner; None: all are right.
    """
    start = jnp.asarray(start, jnp.float32)
    on_warp = warp_in_use()
    if jax.default_backend() == "gpu" and not on_warp:
        return spread_distances(start, open_, toll, until)
    # An infinite cost closes a square: sweeps and kernels need no second array for it.
    enter = jnp.where(open_, jnp.asarray(toll, jnp.float32), jnp.inf)
    enter = jnp.broadcast_to(enter, start.shape)
    if on_warp:
        from usarmjx.train.mapping.warp_waves import distances_on_warp

        return distances_on_warp(start, enter, until)
    return swept_distances(start, enter, until)


def spread_distances(start: jax.Array, open_: Array, toll: ArrayLike, until: Array | None) -> jax.Array:
    """As `distances`, all squares in each round: a GPU without Warp does that at once."""
    costs = [np.float32(math.hypot(*step)) for step in NEIGHBOURS]

    def spread(state: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array, jax.Array]:
        count, far, _ = state
        # One after the other, not stacked: they melt into one loop over the squares, seven times as fast.
        ways = [shifted(far, step, UNREACHABLE) + cost for step, cost in zip(NEIGHBOURS, costs, strict=True)]
        reached = reduce(jnp.minimum, ways) + toll
        # Closed squares keep their own value: a way may begin in one.
        nearer = jnp.where(open_, jnp.minimum(far, reached), far)
        return count + 1, nearer, (nearer < far).any()

    def goes_on(state: tuple[jax.Array, jax.Array, jax.Array]) -> jax.Array:
        count, far, changed = state
        # After n rounds all ways of n steps are known, and each step costs 1 or more.
        return changed if until is None else changed & (count < far[until[0], until[1]])

    return jax.lax.while_loop(goes_on, spread, (jnp.int32(0), start, jnp.ones((), bool)))[1]


def shortest_path(far: Array, square: Array, steps: int) -> jax.Array:
    """Return the squares (steps, 2) that lie on the way from one (2,), by `distances`.

    If the way ends, the last square is repeated.
    """
    if warp_in_use():
        from usarmjx.train.mapping.warp_waves import path_on_warp

        return path_on_warp(far, square, steps)
    return path_on_jax(far, square, steps)


def path_on_jax(far: Array, square: Array, steps: int) -> jax.Array:
    """As `shortest_path`, a step at a time for all maps."""
    moves = np.array(NEIGHBOURS, np.int32)
    costs = np.hypot(*moves.T).astype(np.float32)
    # A frame instead of bounds: a neighbour beyond the edge is never the best one.
    padded = _framed(far, UNREACHABLE)

    def down(here: jax.Array, _: None) -> tuple[jax.Array, jax.Array]:
        there = here + moves
        heights = padded[there[:, 0] + 1, there[:, 1] + 1] + costs
        best = jnp.argmin(heights)
        # The cost of a start is its own; elsewhere it is that of a neighbour, the step and the toll.
        lower = heights[best] <= padded[here[0] + 1, here[1] + 1] + 1e-3
        here = jnp.where(lower, there[best], here)
        return here, here

    return jax.lax.scan(down, jnp.asarray(square, jnp.int32), None, length=steps)[1]


def square_centre(grid: MapGrid, square: Array) -> jax.Array:
    """Return the middle of squares (..., 2) [m]."""
    return jnp.asarray(grid.low, jnp.float32) + grid.cell * jnp.asarray(square, jnp.float32)
