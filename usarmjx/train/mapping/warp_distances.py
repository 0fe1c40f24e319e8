"""`wavefront.distances` and `shortest_path` on Warp, for all maps in one launch each."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import warp as wp

from usarmjx.base.arrays import Array
from usarmjx.base.warp_functions import warp_function
from usarmjx.train.mapping import warp_waves
from usarmjx.train.mapping.sweeps import of_one_map, over_maps

WALKERS = 64
"""Threads of a block that walk down ways, a map each."""


def _sweeper(squares: int) -> tuple[str, int]:
    """Return the name of the kernel for maps of so many squares, as they are held, and its threads a map."""
    if squares <= warp_waves.SMALL_ROOM:
        return "sweep_small_maps", warp_waves.SMALL_THREADS
    large = squares <= warp_waves.LARGE_ROOM
    return "sweep_large_maps" if large else "sweep_any_maps", warp_waves.LARGE_THREADS


@warp_function
def _kernel(name: str, threads: int) -> Any:  # noqa: ANN401
    return wp.jax_kernel(getattr(warp_waves, name), block_dim=threads)


def _distances(start: Array, enter: Array, until: Array) -> jax.Array:
    """Return the distances (maps, i, j) of all maps; `until` is (maps, 2), below 0: none is asked for."""
    maps, rows, columns = start.shape
    flat = [x.reshape(-1) for x in (start, enter, until)]
    name, threads = _sweeper(rows * (columns | 1))
    launch = _kernel(name, threads)
    found = launch(*flat, rows, columns, output_dims=start.size, launch_dims=maps * threads)
    return found[0].reshape(start.shape)


def distances_on_warp(start: Array, enter: Array, until: Array | None) -> jax.Array:
    """As `sweeps.swept_distances`, on Warp."""
    return of_one_map(_distances, start, enter, until)


def _paths(steps: int, far: Array, square: Array) -> jax.Array:
    """Return the ways (maps, steps, 2) from squares (maps, 2) down distances (maps, i, j)."""
    maps, rows, columns = far.shape
    found = _kernel("walk_down", WALKERS)(
        far.reshape(-1),
        square.reshape(-1),
        rows,
        columns,
        steps,
        output_dims=maps * steps * 2,
        launch_dims=maps,
    )
    return found[0].reshape(maps, steps, 2)


def path_on_warp(far: Array, square: Array, steps: int) -> jax.Array:
    """As `wavefront.shortest_path`, on Warp."""
    rows = (jnp.asarray(far, jnp.float32), jnp.asarray(square, jnp.int32))
    return over_maps(partial(_paths, steps))(*(x[None] for x in rows))[0]
