"""Paths over maps: distances by waves, frontiers, the next square to drive to. Pure functions of one map.

On a CPU sweeps in turns from all four sides, row by row, find distances over many maps at once. A sweep from
one side carries a distance along its whole way until that turns back, where a wave needs a round for each
step. Of all maps together the same square is looked at: maps are the last axis.
"""

import math
from collections.abc import Callable
from functools import reduce

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap

from usarmjx.base.backend import Array, ArrayLike
from usarmjx.base.warp_functions import warp_in_use
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
        # Where a way begins its cost is its own; elsewhere it is that of a neighbour, the step and the toll.
        lower = heights[best] <= padded[here[0] + 1, here[1] + 1] + 1e-3
        here = jnp.where(lower, there[best], here)
        return here, here

    return jax.lax.scan(down, jnp.asarray(square, jnp.int32), None, length=steps)[1]


def square_centre(grid: MapGrid, square: Array) -> jax.Array:
    """Return the middle of squares (..., 2) [m]."""
    return jnp.asarray(grid.low, jnp.float32) + grid.cell * jnp.asarray(square, jnp.float32)


MAPS_AT_A_TIME = 64
"""Maps that are swept together: this number stays in a core's own cache, and wait for each other."""
UNREACHABLE = 1e6
"""Distance of squares that no path leads to [squares]."""
SLANT = np.float32(math.sqrt(2))
"""Cost of a slanting step [squares]."""


def _entered(before: jax.Array, row: jax.Array, enter: jax.Array) -> jax.Array:
    """Return a row (squares, maps) after steps from the row before it, straight and slanting ones."""
    beside = jnp.full((1, before.shape[1]), jnp.inf)
    slanting = jnp.minimum(jnp.concatenate([before[1:], beside]), jnp.concatenate([beside, before[:-1]]))
    return jnp.minimum(row, jnp.minimum(before + 1.0, slanting + SLANT) + enter)


def _sweep(far: jax.Array, enter: jax.Array, axis: int, *, back: bool) -> jax.Array:
    """Return distances (i, j, maps) after one sweep along an axis."""
    # Steps along a row are left out: the sweeps along the other axis make them.
    length = far.shape[axis]

    def row(values: jax.Array, i: Array | int) -> jax.Array:
        return jax.lax.dynamic_index_in_dim(values, i, axis, keepdims=False)  # pyright: ignore[reportUnknownVariableType] - half typed

    def step(k: jax.Array, state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        far, before = state
        i = length - 1 - k if back else k
        now = _entered(before, row(far, i), row(enter, i))
        return jax.lax.dynamic_update_index_in_dim(far, now, i, axis), now  # pyright: ignore[reportUnknownVariableType] - half typed

    return jax.lax.fori_loop(1, length, step, (far, row(far, length - 1 if back else 0)))[0]


def _sweeps(start: jax.Array, enter: jax.Array, until: jax.Array) -> jax.Array:
    """Return the distances of some maps; all are (i, j, maps), but `until`, which is (2, maps)."""
    which = jnp.arange(start.shape[-1])

    def turn(state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        before, _ = state
        far = before
        for axis in range(2):
            for back in (False, True):
                far = _sweep(far, enter, axis, back=back)
        # What is farther than the square that is asked for lies on no way from there.
        asked = jnp.where(until[0] < 0, jnp.inf, far[until[0], until[1], which])
        return far, ((far < before) & (far <= asked)).any()

    return jax.lax.while_loop(lambda state: state[1], turn, (start, jnp.ones((), bool)))[0]


def _of_all(start: jax.Array, enter: jax.Array, until: jax.Array) -> jax.Array:
    """Return the distances of maps (maps, i, j)."""
    count = len(start)
    together = min(count, MAPS_AT_A_TIME)
    missing = -count % together

    def grouped(values: jax.Array) -> jax.Array:
        # Padding repeats the last map, so that it needs no more turns than that one.
        whole = jnp.concatenate([values, jnp.broadcast_to(values[-1:], (missing, *values.shape[1:]))])
        return jnp.moveaxis(whole.reshape(-1, together, *values.shape[1:]), 1, -1)

    def some(maps: tuple[jax.Array, jax.Array, jax.Array]) -> jax.Array:
        return _sweeps(*maps)

    far = jax.lax.map(some, tuple(map(grouped, (start, enter, until))))
    return jnp.moveaxis(far, -1, 1).reshape(-1, *start.shape[1:])[:count]


def over_maps(run: Callable[..., jax.Array]) -> Callable[..., jax.Array]:
    """Return a function of arrays over maps such that all maps over it make one call, with a longer axis.

    Args:
        run: Its arguments and its result have a first axis over maps.
    """
    call = custom_vmap(run)

    @call.def_vmap
    def mapped(size: int, batched: list[bool], *args: jax.Array) -> tuple[jax.Array, bool]:
        rows = [
            x if own else jnp.broadcast_to(x, (size, *x.shape)) for x, own in zip(args, batched, strict=True)
        ]
        found = over_maps(run)(*(x.reshape(-1, *x.shape[2:]) for x in rows))
        return found.reshape(*rows[0].shape[:2], *found.shape[1:]), True

    return call


def of_one_map(run: Callable[..., jax.Array], start: Array, enter: Array, until: Array | None) -> jax.Array:
    """As `swept_distances`, by what `over_maps` takes, as `_of_all`."""
    asked = jnp.full(2, -1, jnp.int32) if until is None else jnp.asarray(until, jnp.int32)
    rows = (jnp.asarray(start, jnp.float32), jnp.asarray(enter, jnp.float32), asked)
    return over_maps(run)(*(x[None] for x in rows))[0]


def swept_distances(start: Array, enter: Array, until: Array | None) -> jax.Array:
    """Return how far each square is from the nearest start, as `wavefront.distances` (i, j).

    Args:
        start: Cost at the beginning of a way that begins in a square (i, j).
        enter: Cost of entering a square, beside the step; infinite: none leads through it (i, j).
        until: See there.
    """
    return of_one_map(_of_all, start, enter, until)
