"""Nearest of a few things on Warp: a warp per row takes the next of its numbers, one after the other.

Its lanes hold the numbers in registers, and strike out what has been taken.
"""

from functools import cache
from typing import Any

import jax
import warp as wp
from jax.custom_batching import custom_vmap

from usarmjx.base.backend import Array
from usarmjx.base.warp_functions import warp_function
from usarmjx.sensors.rays.raycast_warp import thread_index

wp.set_module_options({"enable_backward": False})

MOST = 256
"""Numbers of a row up to which this is faster than sorting it (chosen)."""
LANES = 32
"""Threads of a warp."""
BLOCK_DIM = 128
"""Threads of a block."""


CODE = """
#if defined(__CUDA_ARCH__)
    const int width = 32, lane = threadIdx.x & 31;
#else
    const int width = 1, lane = 0;
#endif
    const wp::uint32 taken = 0xFFFFFFFFu;
    auto least_of_lanes = [](wp::uint32 x) {
#if defined(__CUDA_ARCH__)
#if __CUDA_ARCH__ >= 800
        x = __reduce_min_sync(0xffffffffu, x);
#else
        for (int step = 16; step > 0; step >>= 1) {
            const wp::uint32 other = __shfl_xor_sync(0xffffffffu, x, step);
            x = other < x ? other : x;
        }
#endif
#endif
        return x;
    };
    wp::uint32 left[MOST / width];
    #pragma unroll
    for (int k = 0; k < MOST / width; ++k) {
        const int i = lane + k * width;
        // The bits of floats that are not negative sort like them.
        left[k] = i < size ? reinterpret_cast<const wp::uint32*>(distance.data)[row * size + i] : taken;
    }
    for (int place = 0; place < count; ++place) {
        wp::uint32 best = taken, mine = size - 1;
        #pragma unroll
        for (int k = 0; k < MOST / width; ++k) {
            if (left[k] < best) {
                best = left[k];
                mine = lane + k * width;
            }
        }
        const wp::uint32 least = least_of_lanes(best);
        const int first = (int)least_of_lanes(best == least ? mine : taken);
        #pragma unroll
        for (int k = 0; k < MOST / width; ++k)
            if (lane + k * width == first) left[k] = taken;
        if (lane == 0) index.data[row * count + place] = first;
    }
"""
"""Selection of the smallest numbers of a row of at most `MOST`, of which each lane holds some."""


@cache
def selection_kernel(held: int) -> Any:  # noqa: ANN401 - Warp's kernels have no type
    """Return the kernel that writes the indices of the smallest numbers of rows, none of them negative.

    Equal ones come in their order. Each lane holds `held` numbers.
    """

    @wp.func_native(CODE.replace("MOST", str(held * LANES)))
    def take_nearest(
        distance: wp.array[float], row: int, size: int, count: int, index: wp.array[int]
    ) -> None: ...

    def select_nearest(distance: wp.array[float], size: int, count: int, index: wp.array[int]) -> None:
        # On a CPU each lane is a thread of its own, and does the work of the whole warp.
        take_nearest(distance, thread_index(wp.tid()) >> 5, size, count, index)

    # XLA finds the kernel by this name.
    select_nearest.__qualname__ = f"select_nearest_of_{held * LANES}"
    kernel: Any = wp.kernel
    # A module of its own: each size compiles only its own kernel, and only when it is first needed.
    return kernel(select_nearest, enable_backward=False, grid_stride=False, module="unique")


@warp_function
def _kernel(held: int) -> Any:  # noqa: ANN401 - Warp's kernels have no type
    return wp.jax_kernel(selection_kernel(held), num_outputs=1, block_dim=BLOCK_DIM)


def nearest_of_rows(distance: Array, count: int) -> Array:
    """Return the indices of the smallest distances (..., n), in ascending order (..., count); vmaps merge."""

    @custom_vmap
    def run(rows: Array) -> Array:
        size = rows.shape[0] * count
        flat = rows.reshape(-1)
        (index,) = _kernel(-(-rows.shape[1] // LANES))(
            # A warp for each row.
            flat,
            rows.shape[1],
            count,
            output_dims=size,
            launch_dims=rows.shape[0] * 32,
        )
        return index.reshape(-1, count)

    @run.def_vmap
    def run_mapped(size: int, batched: Any, rows: Array) -> tuple[Array, bool]:  # noqa: ANN401
        del batched
        return nearest_of_rows(rows, count).reshape(size, -1, count), True

    # Indices have no gradient, and JAX cannot derive a kernel of Warp.
    rows = jax.lax.stop_gradient(distance).reshape(-1, distance.shape[-1])
    return run(rows).reshape(*distance.shape[:-1], count)
