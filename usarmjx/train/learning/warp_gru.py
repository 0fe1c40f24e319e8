"""The recurrent part of a GRU on Warp: a whole sequence, forward or backward, in one launch.

A block of threads has a few sequences to itself. Each thread keeps one column of the recurrent weights in
registers, and the carry passes between threads through shared memory, so that a step needs neither a launch
nor device memory but for its gates. XLA runs the same loop as some launches a step. `networks.recur` is the
JAX twin and the oracle. On a CPU, where tests run it, the first thread of a block does the work of all.
"""

from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import warp as wp

from usarmjx.base.warp_functions import warp_function

wp.set_module_options({"enable_backward": False, "fast_math": False})

ROWS = 3
"""Sequences of a block: as three threads have a unit, each has one unit of one sequence between products."""
MAX_UNITS = 128
"""Most units of memory: a thread keeps a weight of each in registers."""
UNITS_STEP = 32
"""Units are a multiple of this, the threads of a warp."""

FORWARD = """
    const int block = (int)((unsigned)index / THREADS);
    const int row0 = block * ROWS;
#if defined(__CUDA_ARCH__)
    const int lane = (int)((unsigned)index % THREADS);
    const int lanes = THREADS;
    const auto wait = []() { __syncthreads(); };
    __shared__ float before[ROWS * UNITS];
    __shared__ float own[ROWS * THREADS];
    float column[UNITS];
#pragma unroll
    for (int k = 0; k < UNITS; ++k) column[k] = weights.data[k * THREADS + lane];
#else
    if ((unsigned)index % THREADS != 0) return;
    const int lane = 0;
    const int lanes = 1;
    const auto wait = []() {};
    float before[ROWS * UNITS];
    float own[ROWS * THREADS];
#endif
    for (int e = lane; e < ROWS * UNITS; e += lanes) {
        const int row = row0 + e / UNITS;
        const bool blank = row >= rows || is_first.data[row / robots] != 0;
        before[e] = blank ? 0.0f : carry.data[row * UNITS + e % UNITS];
    }
    for (int t = 0; t < steps; ++t) {
        wait();
#if defined(__CUDA_ARCH__)
        float sum[ROWS] = {};
#pragma unroll
        for (int k = 0; k < UNITS; ++k)
#pragma unroll
            for (int r = 0; r < ROWS; ++r) sum[r] += before[r * UNITS + k] * column[k];
        for (int r = 0; r < ROWS; ++r) own[r * THREADS + lane] = sum[r];
#else
        for (int r = 0; r < ROWS; ++r)
            for (int j = 0; j < THREADS; ++j) {
                float sum = 0.0f;
                for (int k = 0; k < UNITS; ++k) sum += before[r * UNITS + k] * weights.data[k * THREADS + j];
                own[r * THREADS + j] = sum;
            }
#endif
        wait();
        for (int e = lane; e < ROWS * UNITS; e += lanes) {
            const int row = row0 + e / UNITS;
            const int unit = e % UNITS;
            if (row >= rows) continue;
            const size_t at = (size_t)t * rows + row;
            const float* const gate = gates.data + at * THREADS;
            const float* const mine = own + e / UNITS * THREADS;
            const float reset = 1.0f / (1.0f + expf(-(gate[unit] + mine[unit])));
            const float update = 1.0f / (1.0f + expf(-(gate[UNITS + unit] + mine[UNITS + unit])));
            const float fresh =
                tanhf(gate[2 * UNITS + unit] + reset * (mine[2 * UNITS + unit] + bias.data[unit]));
            const float result = (1.0f - update) * fresh + update * before[e];
            after.data[at * UNITS + unit] = result;
            const bool ends = t + 1 < steps && is_first.data[(t + 1) * (rows / robots) + row / robots] != 0;
            before[e] = ends ? 0.0f : result;
        }
    }
"""
"""`index` is the thread; row is a sequence, `robots` of them a world; see `recur_on_warp` for the arrays."""

BACKWARD = """
    const int block = (int)((unsigned)index / THREADS);
    const int row0 = block * ROWS;
#if defined(__CUDA_ARCH__)
    const int lane = (int)((unsigned)index % THREADS);
    const int lanes = THREADS;
    const auto wait = []() { __syncthreads(); };
    __shared__ float slope_of_own[ROWS * THREADS];
    __shared__ float part[ROWS * THREADS];
    float later[1];  // the slope of this thread's unit that goes to the step before
    const int gate = lane / UNITS;
    float column[UNITS];
#pragma unroll
    for (int i = 0; i < UNITS; ++i)
        column[i] = weights.data[(lane - gate * UNITS) * THREADS + gate * UNITS + i];
#else
    if ((unsigned)index % THREADS != 0) return;
    const int lane = 0;
    const int lanes = 1;
    const auto wait = []() {};
    float slope_of_own[ROWS * THREADS];
    float part[ROWS * THREADS];
    float later[ROWS * UNITS];
#endif
    for (int e = lane, n = 0; e < ROWS * UNITS; e += lanes, ++n) later[n] = 0.0f;
    for (int t = steps - 1; t >= 0; --t) {
        for (int e = lane, n = 0; e < ROWS * UNITS; e += lanes, ++n) {
            const int r = e / UNITS;
            const int unit = e % UNITS;
            const bool there = row0 + r < rows;
            const size_t at = (size_t)t * rows + row0 + r;
            const float slope = there ? slopes.data[at * UNITS + unit] + later[n] : 0.0f;
            for (int g = 0; g < 3; ++g) {
                const int j = g * UNITS + unit;
                slope_of_own[r * THREADS + j] = there ? slope * by_own.data[at * THREADS + j] : 0.0f;
            }
            later[n] = there ? slope * update.data[at * UNITS + unit] : 0.0f;
            if (there) found.data[(at + rows) * UNITS + unit] = slope;
        }
        wait();
#if defined(__CUDA_ARCH__)
        float sum[ROWS] = {};
#pragma unroll
        for (int i = 0; i < UNITS; ++i)
#pragma unroll
            for (int r = 0; r < ROWS; ++r) sum[r] += slope_of_own[r * THREADS + gate * UNITS + i] * column[i];
        for (int r = 0; r < ROWS; ++r) part[r * THREADS + lane] = sum[r];
#else
        for (int r = 0; r < ROWS; ++r)
            for (int j = 0; j < THREADS; ++j) {
                const int first = j / UNITS * UNITS;
                float sum = 0.0f;
                for (int i = 0; i < UNITS; ++i)
                    sum += slope_of_own[r * THREADS + first + i]
                        * weights.data[j % UNITS * THREADS + first + i];
                part[r * THREADS + j] = sum;
            }
#endif
        wait();
        for (int e = lane, n = 0; e < ROWS * UNITS; e += lanes, ++n) {
            const int r = e / UNITS;
            const int unit = e % UNITS;
            if (row0 + r >= rows) continue;
            const float* const mine = part + r * THREADS + unit;
            const bool begins = is_first.data[t * (rows / robots) + (row0 + r) / robots] != 0;
            later[n] = begins ? 0.0f : later[n] + mine[0] + mine[UNITS] + mine[2 * UNITS];
            if (t == 0) found.data[(size_t)(row0 + r) * UNITS + unit] = later[n];
        }
    }
"""
"""Row 0 of `found` is the slope of the first carry, row t + 1 that of the carry after step t."""


def native_code(code: str, units: int) -> str:
    """Return native code for a number of units of memory."""
    # A thread for each number of the three gates.
    threads = 3 * units
    words = {"THREADS": str(threads), "UNITS": str(units), "ROWS": str(ROWS)}
    for word, value in words.items():
        code = code.replace(word, value)
    return code


@cache
def forward_kernel(units: int) -> Any:  # noqa: ANN401 - Warp's kernels have no type
    """Return the kernel that runs a sequence forward, for a number of units."""

    @wp.func_native(native_code(FORWARD, units))
    def run(
        gates: wp.array[float],
        weights: wp.array[float],
        bias: wp.array[float],
        carry: wp.array[float],
        is_first: wp.array[int],
        index: int,
        steps: int,
        rows: int,
        robots: int,
        after: wp.array[float],
    ) -> None: ...

    def gru_forward(
        gates: wp.array[float],
        weights: wp.array[float],
        bias: wp.array[float],
        carry: wp.array[float],
        is_first: wp.array[int],
        steps: int,
        rows: int,
        robots: int,
        after: wp.array[float],
    ) -> None:
        run(gates, weights, bias, carry, is_first, wp.tid(), steps, rows, robots, after)

    gru_forward.__qualname__ = f"gru_forward_of_{units}"  # XLA knows the kernel by this name
    kernel: Any = wp.kernel
    return kernel(gru_forward, enable_backward=False, grid_stride=False, module="unique")


@cache
def backward_kernel(units: int) -> Any:  # noqa: ANN401 - Warp's kernels have no type
    """Return the kernel that hands slopes back through a sequence, for a number of units."""

    @wp.func_native(native_code(BACKWARD, units))
    def run(
        slopes: wp.array[float],
        by_own: wp.array[float],
        update: wp.array[float],
        weights: wp.array[float],
        is_first: wp.array[int],
        index: int,
        steps: int,
        rows: int,
        robots: int,
        found: wp.array[float],
    ) -> None: ...

    def gru_backward(
        slopes: wp.array[float],
        by_own: wp.array[float],
        update: wp.array[float],
        weights: wp.array[float],
        is_first: wp.array[int],
        steps: int,
        rows: int,
        robots: int,
        found: wp.array[float],
    ) -> None:
        run(slopes, by_own, update, weights, is_first, wp.tid(), steps, rows, robots, found)

    gru_backward.__qualname__ = f"gru_backward_of_{units}"  # XLA knows the kernel by this name
    kernel: Any = wp.kernel
    return kernel(gru_backward, enable_backward=False, grid_stride=False, module="unique")


@warp_function
def _forward(units: int) -> Any:  # noqa: ANN401 - Warp's own
    # The native code shares memory within a block of exactly that many threads.
    return wp.jax_kernel(forward_kernel(units), block_dim=3 * units)


@warp_function
def _backward(units: int) -> Any:  # noqa: ANN401 - Warp's own
    # As of the forward kernel: the native code assumes blocks of that size.
    return wp.jax_kernel(backward_kernel(units), block_dim=3 * units)


def fits(units: int, dtype: Any) -> bool:  # noqa: ANN401 - what NumPy takes for a dtype
    """Return whether the kernels can run a GRU of that many units in that precision."""
    return dtype == jnp.float32 and 0 < units <= MAX_UNITS and units % UNITS_STEP == 0


def _launch(rows: int, units: int) -> int:
    # Rounded up to whole blocks: the kernel skips rows beyond the last one.
    return -(-rows // ROWS) * 3 * units


def recur_on_warp(
    gates: jax.Array, weights: jax.Array, bias: jax.Array, carry: jax.Array, is_first: jax.Array
) -> jax.Array:
    """Return the carry after each step (steps, worlds, robots, units); arguments as of `networks.recur`."""
    steps, worlds, robots, units = (*gates.shape[:3], carry.shape[-1])
    rows = worlds * robots
    # Warp's kernels take flat arrays; its booleans have another size than JAX's, hence int32.
    flat = [x.reshape(-1) for x in (gates, weights, bias, carry, is_first.astype(jnp.int32))]
    after = _forward(units)(
        *flat, steps, rows, robots, output_dims=steps * rows * units, launch_dims=_launch(rows, units)
    )
    return after[0].reshape(steps, worlds, robots, units)


def gradients_on_warp(
    slopes: jax.Array, by_own: jax.Array, update: jax.Array, weights: jax.Array, is_first: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return the slopes of the first carry (worlds, robots, units) and of that after each step (steps, ...).

    Args:
        slopes: Gradient of the loss by the output of each step (steps, worlds, robots, units).
        by_own: Derivative of a step's carry by its products with the weights (steps, worlds, robots, 3
            units).
        update: Derivative of a step's carry by the one before it, those products held (steps, worlds,
            robots, units).
        weights: From the carry to the gates (units, 3 units).
        is_first: Whether the carry is reset before the step (steps, worlds).
    """
    steps, worlds, robots, units = slopes.shape
    rows = worlds * robots
    flat = [x.reshape(-1) for x in (slopes, by_own, update, weights, is_first.astype(jnp.int32))]
    found = _backward(units)(
        *flat, steps, rows, robots, output_dims=(steps + 1) * rows * units, launch_dims=_launch(rows, units)
    )
    all_slopes = found[0].reshape(steps + 1, worlds, robots, units)
    return all_slopes[0], all_slopes[1:]
