"""Nearest of a few things on Warp: a warp per row takes the next of its numbers, one after the other."""

from typing import Any

import jax
import warp as wp
from jax.custom_batching import custom_vmap

from usarmjx.base.backend import Array
from usarmjx.base.warp_functions import warp_function
from usarmjx.sensors.rays.raycast_warp import LAST_KEY, lanes, least_key_of_lanes, thread_index

wp.set_module_options({"enable_backward": False})

MOST = 256
"""Numbers of a row up to which this is faster than sorting it (chosen)."""
BLOCK_DIM = 128
"""Threads of a block."""


@wp.kernel(enable_backward=False, grid_stride=False)
def select_nearest(distance: wp.array[float], size: int, count: int, index: wp.array[int]) -> None:
    """Write the indices of the smallest numbers of rows, none of them negative; equal ones in their order."""
    t = thread_index(wp.tid())
    row = t >> 5
    lane = t & 31
    last = wp.uint32(0)
    last_index = wp.int32(-1)
    place = wp.int32(0)
    while place < count:
        best = wp.uint32(LAST_KEY)
        mine = wp.int32(size - 1)
        i = wp.int32(lane & (lanes() - 1))
        while i < size:
            # The bits of floats that are not negative sort like them.
            bits = wp.cast(distance[row * size + i], wp.uint32)
            if (bits > last or (bits == last and i > last_index)) and bits < best:
                best = bits
                mine = i
            i += lanes()
        last = least_key_of_lanes(best)
        last_index = wp.int32(least_key_of_lanes(wp.where(best == last, wp.uint32(mine), LAST_KEY)))
        if lane == 0:
            index[row * count + place] = last_index
        place += 1


@warp_function
def _kernel() -> Any:  # noqa: ANN401 - Warp's kernels have no type
    return wp.jax_kernel(select_nearest, num_outputs=1, block_dim=BLOCK_DIM)


def nearest_of_rows(distance: Array, count: int) -> Array:
    """Return the indices of the smallest distances (..., n), in ascending order (..., count); vmaps merge."""

    @custom_vmap
    def run(rows: Array) -> Array:
        size = rows.shape[0] * count
        flat = rows.reshape(-1)
        (index,) = _kernel()(flat, rows.shape[1], count, output_dims=size, launch_dims=rows.shape[0] * 32)
        return index.reshape(-1, count)

    @run.def_vmap
    def run_mapped(size: int, batched: Any, rows: Array) -> tuple[Array, bool]:  # noqa: ANN401
        del batched
        return nearest_of_rows(rows, count).reshape(size, -1, count), True

    rows = jax.lax.stop_gradient(distance).reshape(-1, distance.shape[-1])
    return run(rows).reshape(*distance.shape[:-1], count)
