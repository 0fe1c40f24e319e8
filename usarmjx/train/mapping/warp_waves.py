"""Distances over maps on Warp, and the ways down them: all maps of all worlds and robots in one launch.

A block of threads has a map to itself, its distances in shared memory if there is room, and sweeps the
rectangle around all that can be entered from all four sides as `sweeps` does: each thread has a square of the
row that is entered, and all wait for each other after it. On a CPU, where tests run it, the first thread of a
block does the whole map.
"""

from functools import partial, reduce
from typing import Any

import jax
import jax.numpy as jnp
import warp as wp

from usarmjx.base.backend import Array
from usarmjx.base.warp_functions import warp_function
from usarmjx.train.mapping.fast_sweeping import UNREACHABLE, of_one_map, over_maps

# Nothing may be added in another order than JAX does: fast mathematics might.
wp.set_module_options({"enable_backward": False, "fast_math": False})

SMALL_THREADS, LARGE_THREADS = 64, 128
"""Threads of a block, for small maps and for all others: a thread for each square of a row, or for some."""
SMALL_ROOM, LARGE_ROOM = 1536, 6656
"""Squares that a block holds in shared memory: the fewer, the more blocks there are at a time. Of small maps
these are distances and costs, of large ones distances; still larger ones stay in global memory."""
OUTSIDE = wp.constant(UNREACHABLE)
SLANTING_STEP = wp.constant(2.0**0.5)
TOLERANCE = wp.constant(1e-3)
"""A square is further down a way if it is lower by its step, but for so much of rounding [squares]."""

SWEEPS = """
    const int map = (int)((unsigned)index / THREADS);
    const int squares = rows * columns;
    const size_t first = (size_t)map * squares;
    const float none = 3.4e38f;
    const float slant = 1.41421356237309505f;
    float* const found = distance.data + first;
    const float* const given = enter.data + first;
#if defined(__CUDA_ARCH__)
    const int lane = (int)((unsigned)index % THREADS);
    const int lanes = THREADS;
    const auto wait = []() { __syncthreads(); };
    const auto any = [](bool x) { return __syncthreads_or(x) != 0; };
#else
    if ((unsigned)index % THREADS != 0) return;
    const int lane = 0;
    const int lanes = 1;
    const auto wait = []() {};
    const auto any = [](bool x) { return x; };
#endif
#if defined(__CUDA_ARCH__) && ROOM > 0
    __shared__ float held_far[ROOM];
    float* const far = held_far;
    const int stride = columns | 1;  // odd, so that squares of a column lie in banks of their own
#else
    float* const far = found;
    const int stride = columns;
#endif
#if defined(__CUDA_ARCH__) && ROOM > 0 && HOLDS_COSTS
    __shared__ float held_cost[ROOM];
    const float* const cost = held_cost;
    const int cost_stride = stride;
    for (int k = lane; k < squares; k += lanes) held_cost[k + k / columns * (stride - columns)] = given[k];
#else
    const float* const cost = given;
    const int cost_stride = columns;
#endif
    const float* const begin = start.data + first;
    int low_row = rows, low_column = columns, high_row = -1, high_column = -1;
    for (int k = lane; k < squares; k += lanes) {
        const int row = k / columns;
        const int column = k - row * columns;
        far[row * stride + column] = begin[k];
        if (given[k] < none) {
            low_row = row < low_row ? row : low_row;
            high_row = row > high_row ? row : high_row;
            low_column = column < low_column ? column : low_column;
            high_column = column > high_column ? column : high_column;
        }
    }
#if defined(__CUDA_ARCH__)
    __shared__ int low[2], high[2];
    if (lane == 0) {
        low[0] = rows;
        low[1] = columns;
        high[0] = high[1] = -1;
    }
    wait();
    atomicMin(&low[0], low_row);
    atomicMin(&low[1], low_column);
    atomicMax(&high[0], high_row);
    atomicMax(&high[1], high_column);
    wait();
    low_row = low[0], low_column = low[1], high_row = high[0], high_column = high[1];
#endif
    // All that can be entered, and what is beside it: ways may begin there.
    low_row -= low_row > 0;
    low_column -= low_column > 0;
    const int box_rows = (high_row + 1 < rows ? high_row + 1 : high_row) - low_row + 1;
    const int box_columns = (high_column + 1 < columns ? high_column + 1 : high_column) - low_column + 1;
    const int corner = low_row * stride + low_column;
    const int cost_corner = low_row * cost_stride + low_column;
    const int i = until.data[2 * map];
    const int asked = i < 0 ? -1 : i * stride + until.data[2 * map + 1];
    wait();

    bool go_on = high_row >= 0;
    while (go_on) {
        float least = none;  // of the squares of this thread that came nearer in this turn
        for (int side = 0; side < 4; ++side) {
            const int lines = side < 2 ? box_rows : box_columns;
            const int across = side < 2 ? box_columns : box_rows;
            const bool back = side % 2 != 0;
            const int step = side < 2 ? stride : 1;
            const int beside = side < 2 ? 1 : stride;
            const int on = back ? -step : step;
            int line = corner + (back ? (lines - 1) * step : 0);
            const int cost_step = side < 2 ? cost_stride : 1;
            const int cost_beside = side < 2 ? 1 : cost_stride;
            const int cost_on = back ? -cost_step : cost_step;
            int entered = cost_corner + (back ? (lines - 1) * cost_step : 0) + cost_on;
            // What it costs to enter a thread's first square is read a line ahead.
            float next = lines > 1 && lane < across ? cost[entered + lane * cost_beside] : 0.0f;
            for (int n = 1; n < lines; ++n) {
                const float ahead = next;
                if (n + 1 < lines && lane < across) next = cost[entered + cost_on + lane * cost_beside];
                for (int k = lane; k < across; k += lanes) {
                    const float toll = k == lane ? ahead : cost[entered + k * cost_beside];
                    const int at = line + k * beside;
                    const float right = k + 1 < across ? far[at + beside] : none;
                    const float left = k > 0 ? far[at - beside] : none;
                    const float aslant = (left < right ? left : right) + slant;
                    const float straight = far[at] + 1.0f;
                    const float way = (aslant < straight ? aslant : straight) + toll;
                    if (way < far[at + on]) {
                        far[at + on] = way;
                        least = way < least ? way : least;
                    }
                }
                line += on;
                entered += cost_on;
                wait();
            }
        }
        // What is farther than the square that is asked for lies on no way from there.
        go_on = any(least < none && (asked < 0 || least <= far[asked]));
    }
#if defined(__CUDA_ARCH__) && ROOM > 0
    for (int k = lane; k < squares; k += lanes) found[k] = far[k + k / columns * (stride - columns)];
#endif
"""


def _sweeps_in(room: int, threads: int, *, holds_costs: bool = False) -> str:
    """Return the native code that holds a map of this size in shared memory; 0: in global memory."""
    words = {"ROOM": str(room), "THREADS": f"{threads}u", "HOLDS_COSTS": str(int(holds_costs))}
    return reduce(lambda code, word: code.replace(word, words[word]), words, SWEEPS)


@wp.func_native(_sweeps_in(SMALL_ROOM, SMALL_THREADS, holds_costs=True))
def _sweep_small(
    start: wp.array[float],
    enter: wp.array[float],
    until: wp.array[int],
    index: int,
    rows: int,
    columns: int,
    distance: wp.array[float],
) -> None: ...


@wp.func_native(_sweeps_in(LARGE_ROOM, LARGE_THREADS))
def _sweep_large(
    start: wp.array[float],
    enter: wp.array[float],
    until: wp.array[int],
    index: int,
    rows: int,
    columns: int,
    distance: wp.array[float],
) -> None: ...


@wp.func_native(_sweeps_in(0, LARGE_THREADS))
def _sweep_any(
    start: wp.array[float],
    enter: wp.array[float],
    until: wp.array[int],
    index: int,
    rows: int,
    columns: int,
    distance: wp.array[float],
) -> None: ...


@wp.kernel(enable_backward=False, grid_stride=False)
def sweep_small_maps(
    start: wp.array[float],
    enter: wp.array[float],
    until: wp.array[int],
    rows: int,
    columns: int,
    distance: wp.array[float],
) -> None:
    """Find the distances over maps of up to `SMALL_ROOM` squares."""
    _sweep_small(start, enter, until, wp.tid(), rows, columns, distance)


@wp.kernel(enable_backward=False, grid_stride=False)
def sweep_large_maps(
    start: wp.array[float],
    enter: wp.array[float],
    until: wp.array[int],
    rows: int,
    columns: int,
    distance: wp.array[float],
) -> None:
    """Find the distances over maps of up to `LARGE_ROOM` squares."""
    _sweep_large(start, enter, until, wp.tid(), rows, columns, distance)


@wp.kernel(enable_backward=False, grid_stride=False)
def sweep_any_maps(
    start: wp.array[float],
    enter: wp.array[float],
    until: wp.array[int],
    rows: int,
    columns: int,
    distance: wp.array[float],
) -> None:
    """Find the distances over maps of any size."""
    _sweep_any(start, enter, until, wp.tid(), rows, columns, distance)


@wp.func
def _height(far: wp.array[float], first: int, i: int, j: int, rows: int, columns: int) -> float:
    height = OUTSIDE
    if i >= 0 and i < rows and j >= 0 and j < columns:
        height = far[first + i * columns + j]
    return height


@wp.kernel(enable_backward=False, grid_stride=False)
def walk_down(
    far: wp.array[float],
    square: wp.array[int],
    rows: int,
    columns: int,
    steps: int,
    path: wp.array[int],
) -> None:
    """Find the way from a square of each map, a thread for each.

    Neighbours come as in `wavefront.NEIGHBOURS`: of two that are as good the first is taken.
    """
    t = wp.tid()
    first = t * rows * columns
    i = square[2 * t]
    j = square[2 * t + 1]
    for n in range(steps):
        best = wp.float32(wp.inf)
        next_i = i
        next_j = j
        for k in range(9):
            there_i = i + k // 3 - 1
            there_j = j + k % 3 - 1
            # Of the nine, numbered by rows, the corners have even numbers, and the middle, which is left out
            # below.
            cost = wp.where(k % 2 == 0, SLANTING_STEP, 1.0)
            height = _height(far, first, there_i, there_j, rows, columns) + cost
            if k != 4 and height < best:
                best = height
                next_i = there_i
                next_j = there_j
        # The way has ended if nothing is lower: the last square repeats.
        if best <= _height(far, first, i, j, rows, columns) + TOLERANCE:
            i = next_i
            j = next_j
        path[2 * (t * steps + n)] = i
        path[2 * (t * steps + n) + 1] = j


WALKERS = 64
"""Threads of a block that walk down ways, a map each."""


def _sweeper(squares: int) -> tuple[str, int]:
    """Return the name of the kernel for maps of this size, as they are held, and its threads a map."""
    if squares <= SMALL_ROOM:
        return "sweep_small_maps", SMALL_THREADS
    large = squares <= LARGE_ROOM
    return "sweep_large_maps" if large else "sweep_any_maps", LARGE_THREADS


@warp_function
def _kernel(name: str, threads: int) -> Any:  # noqa: ANN401
    return wp.jax_kernel(globals()[name], block_dim=threads)


def _distances(start: Array, enter: Array, until: Array) -> jax.Array:
    """Return the distances (maps, i, j) of all maps; `until` is (maps, 2), below 0: none is asked for."""
    maps, rows, columns = start.shape
    flat = [x.reshape(-1) for x in (start, enter, until)]
    # By the odd stride: that is the room that the rows take in shared memory.
    name, threads = _sweeper(rows * (columns | 1))
    launch = _kernel(name, threads)
    found = launch(*flat, rows, columns, output_dims=start.size, launch_dims=maps * threads)
    return found[0].reshape(start.shape)


def distances_on_warp(start: Array, enter: Array, until: Array | None) -> jax.Array:
    """As `fast_sweeping.swept_distances`, on Warp."""
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
