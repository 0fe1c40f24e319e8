"""Goals that a robot may choose on its own map: frontiers, its base, other robots; and ways to them.

Pure functions of one robot. Distances are computed when a choice is due, not with every step.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct
from jax.custom_batching import custom_vmap

from usarmjx.base.arrays import Array
from usarmjx.train.mapping.maps import FREE, UNKNOWN, MapGrid
from usarmjx.train.mapping.planning import WALL_COST, WAYPOINT_SQUARES
from usarmjx.train.mapping.wavefront import UNREACHABLE, distances, passable, shortest_path, square_centre

BLOCK = 8
"""Side of the blocks of a map of which each offers one frontier [squares]."""
GAIN_RADIUS = 7
"""Unknown squares so far around a frontier, along both axes, are what may be seen there [squares]."""
WAY_SQUARES = 32
"""Squares of a way that a robot keeps until its next choice."""


class Goals(struct.PyTreeNode, kw_only=True):
    """Goals of a robot.

    Attributes:
        position: Where they are [m] (goals, 2).
        length: Length of the ways there, walls beside them included; `UNREACHABLE`: none [squares] (goals,).
        gain: Share of the squares around that are unknown (goals,).
        valid: Which there are (goals,).
    """

    position: jax.Array
    length: jax.Array
    gain: jax.Array
    valid: jax.Array


def box_sum(values: Array, radius: int) -> jax.Array:
    """Return the sum over the squares within a radius along both axes, of a map (i, j)."""
    total = jnp.asarray(values, jnp.float32)
    for axis in range(2):
        padding = [(0, 0), (0, 0)]
        padding[axis] = (radius + 1, radius)
        sums = jnp.cumsum(jnp.pad(total, padding), axis)  # pyright: ignore[reportUnknownMemberType]
        length = total.shape[axis]
        high = jax.lax.slice_in_dim(sums, 2 * radius + 1, 2 * radius + 1 + length, axis=axis)
        total = high - jax.lax.slice_in_dim(sums, 0, length, axis=axis)
    return total


def open_squares(grid: MapGrid, squares: Array, pose: Array, blocked: Array | bool) -> jax.Array:
    """Return which squares a robot at a pose (3,) drives through: free ones that are not blocked (i, j)."""
    free = (squares == FREE) & ~(blocked & (grid.gaps(pose[:2]) > grid.cell))
    here = grid.index(pose[:2])
    return free.at[here[0], here[1]].set(True)


def block_minima(costs: Array, count: int) -> tuple[jax.Array, jax.Array]:
    """Return the squares (count, 2) and costs (count,) of the lowest costs, at most one in each block.

    Args:
        costs: Of the squares; `UNREACHABLE` and more: not this one (i, j).
        count: Number of squares.
    """
    rows, columns = costs.shape
    missing = ((0, -rows % BLOCK), (0, -columns % BLOCK))
    whole = jnp.pad(costs, missing, constant_values=UNREACHABLE)  # pyright: ignore[reportUnknownMemberType]
    down, across = whole.shape[0] // BLOCK, whole.shape[1] // BLOCK
    blocks = whole.reshape(down, BLOCK, across, BLOCK).swapaxes(1, 2).reshape(down * across, -1)
    inside, lowest = blocks.argmin(-1), blocks.min(-1)
    if down * across < count:
        lowest = jnp.concatenate([lowest, jnp.full(count - down * across, UNREACHABLE)])
        inside = jnp.concatenate([inside, jnp.zeros(count - down * across, inside.dtype)])
    found, block = jax.lax.top_k(-lowest, count)
    square = jnp.stack(
        [block // across * BLOCK + inside[block] // BLOCK, block % across * BLOCK + inside[block] % BLOCK], -1
    )
    return jnp.minimum(square, jnp.array(costs.shape) - 1), -found


def find_goals(
    grid: MapGrid,
    squares: Array,
    pose: Array,
    ends: Array,
    places: Array,
    *,
    blocked: Array | bool = False,
    count: int = 12,
) -> Goals:
    """Return a robot's goals: some places, then the nearest frontiers, of each block of the map one.

    Args:
        grid: The squares.
        squares: Its belief of them (i, j).
        pose: Of the robot (3,).
        ends: Which squares are frontiers (i, j).
        places: Positions of the base and of others [m] (places, 2).
        blocked: Squares that it does not drive through (i, j).
        count: Number of frontiers.
    """
    here, open_ = grid.index(pose[:2]), open_squares(grid, squares, pose, blocked)
    start = jnp.full(grid.shape, UNREACHABLE).at[here[0], here[1]].set(0.0)
    far = distances(start, open_ | ends, jnp.where(passable(squares), 0.0, WALL_COST))
    square, length = block_minima(jnp.where(ends, far, UNREACHABLE), count)
    there = grid.index(places)
    # A place may lie in a square that is not known to be free: its free neighbours count.
    near = jnp.stack([there + jnp.array([i, j]) for i in (-1, 0, 1) for j in (-1, 0, 1)], 1)
    near = jnp.clip(near, 0, jnp.array(grid.shape) - 1)
    to_places = far[near[..., 0], near[..., 1]]
    best = to_places.argmin(-1)
    near = jnp.take_along_axis(near, best[:, None, None].repeat(2, -1), 1)[:, 0]
    all_squares = jnp.concatenate([near, square])
    length = jnp.concatenate([to_places.min(-1), length])
    unknown = box_sum(squares == UNKNOWN, GAIN_RADIUS) / (2 * GAIN_RADIUS + 1) ** 2
    return Goals(
        position=square_centre(grid, all_squares),
        length=jnp.minimum(length, UNREACHABLE),
        gain=unknown[all_squares[:, 0], all_squares[:, 1]],
        valid=length < UNREACHABLE,
    )


def way_to(
    grid: MapGrid, squares: Array, pose: Array, goal: Array, *, blocked: Array | bool = False
) -> jax.Array:
    """Return the next positions on a robot's way to a goal (2,) [m] (WAY_SQUARES, 2); where it is: no way."""
    here, there = grid.index(pose[:2]), grid.index(goal)
    open_ = open_squares(grid, squares, pose, blocked)
    start = jnp.full(grid.shape, UNREACHABLE).at[there[0], there[1]].set(0.0)
    far = distances(start, open_, jnp.where(passable(squares), 0.0, WALL_COST), until=here)
    way = square_centre(grid, shortest_path(far, here, WAY_SQUARES))
    return jnp.where(far[here[0], here[1]] < UNREACHABLE, way, pose[:2])


def next_on_way(way: Array, position: Array) -> jax.Array:
    """Return the position on a way (n, 2) that a robot at a position (2,) steers for [m] (2,)."""
    nearest = ((way - position) ** 2).sum(-1).argmin()
    return way[jnp.minimum(nearest + WAYPOINT_SQUARES - 1, len(way) - 1)]


def where_due(compute: Callable[..., Any], due: Array, old: Any, *args: Any) -> Any:  # noqa: ANN401 - PyTrees
    """Return what a function computes of its arguments where that is due (), else the old.

    Mapped over worlds it is computed only if it is due in any.
    """
    leaves, tree = jax.tree.flatten((old, args))

    def choose(due: jax.Array, *leaves: jax.Array) -> tuple[jax.Array, ...]:
        old, args = jax.tree.unflatten(tree, leaves)
        return tuple(jax.tree.leaves(jax.lax.cond(due, lambda: compute(*args), lambda: old)))

    call = custom_vmap(choose)

    @call.def_vmap
    def mapped(
        size: int, batched: list[bool], due: jax.Array, *leaves: jax.Array
    ) -> tuple[tuple[jax.Array, ...], tuple[bool, ...]]:
        rows = [
            x if own else jnp.broadcast_to(x, (size, *x.shape))
            for x, own in zip((due, *leaves), batched, strict=True)
        ]
        due, (old, args) = rows[0], jax.tree.unflatten(tree, rows[1:])

        def anew() -> Any:  # noqa: ANN401 - a PyTree
            found = jax.vmap(compute)(*args)
            return jax.tree.map(
                lambda new, before: jnp.where(due.reshape(-1, *[1] * (new.ndim - 1)), new, before), found, old
            )

        found = tuple(jax.tree.leaves(jax.lax.cond(due.any(), anew, lambda: old)))
        return found, (True,) * len(found)

    return jax.tree.unflatten(jax.tree.structure(old), call(jnp.asarray(due), *leaves))
