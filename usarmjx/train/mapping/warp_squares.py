"""What `planning.weigh_squares` says of a square, on Warp: a thread each, for all maps in one launch.

XLA works out for every square what only frontiers need: how near each mate is to it, and to where that goes.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import warp as wp

from usarmjx.base.arrays import Array
from usarmjx.base.warp_functions import warp_function
from usarmjx.train.mapping import planning
from usarmjx.train.mapping.belief import RECENT_AGE, STALE_AGE
from usarmjx.train.mapping.maps import FREE, UNKNOWN, WALL, MapGrid
from usarmjx.train.mapping.sweeps import over_maps
from usarmjx.train.mapping.wavefront import UNREACHABLE

wp.set_module_options({"enable_backward": False, "fast_math": False})

THREADS = 256
"""Threads of a block."""
UNSEEN, VISITED, KIND = 4, 8, 3
"""Bits of a square's number, and those that say what it is: unknown, free, a wall or a mark."""
IS_FREE, IS_UNKNOWN, IS_WALL = (wp.constant(wp.int32(kind)) for kind in (FREE, UNKNOWN, WALL))
KIND_BITS, UNSEEN_BIT, VISITED_BIT = (wp.constant(wp.int32(bits)) for bits in (KIND, UNSEEN, VISITED))
NOWHERE, STALE, RECENT = (wp.constant(float(number)) for number in (UNREACHABLE, STALE_AGE, RECENT_AGE))
SAME, AROUND = wp.constant(planning.SAME_GAP), wp.constant(planning.OTHER_ROBOT_RADIUS**2)
NEARER, SHARED = wp.constant(planning.NEARER_ROBOT_COST), wp.constant(planning.SHARED_GOAL_COST)
SHARED_RADIUS, TURN = wp.constant(planning.SHARED_GOAL_RADIUS), wp.constant(planning.TURN_COST)
NARROW, BEEN = wp.constant(planning.NARROW_FRONTIER_COST), wp.constant(planning.VISITED_FRONTIER_COST)
BESIDE_WALL = wp.constant(planning.WALL_COST)


@wp.func
def _kind(code: wp.array[wp.uint8], first: int, rows: int, columns: int, i: int, j: int) -> int:
    """Return what a square is; beyond the map free, which changes nothing."""
    if i < 0 or j < 0 or i >= rows or j >= columns:
        return IS_FREE
    return wp.int32(code[first + i * columns + j]) & KIND_BITS


@wp.func
def _gap(x: float, y: float, places: wp.array[float], k: int) -> float:
    """Return how far a place is from one of some [m]."""
    dx = x - places[k]
    dy = y - places[k + 1]
    return wp.sqrt(dx * dx + dy * dy)


@wp.func
def _squared_gap(x: float, y: float, places: wp.array[float], k: int) -> float:
    dx = x - places[k]
    dy = y - places[k + 1]
    return dx * dx + dy * dy


@wp.func
def _frontier_cost(
    x: float,
    y: float,
    robot: int,
    count: int,
    pose: wp.array[float],
    mates: wp.array[float],
    age: wp.array[float],
    lower: wp.array[int],
) -> float:
    """As `planning.frontier_costs`, of one square."""
    mine = _gap(x, y, pose, 3 * robot)
    low = wp.max(mine - SAME, 0.0)
    high = mine + SAME
    rank = wp.float32(0.0)
    crowd = wp.float32(0.0)
    for m in range(count):
        k = robot * count + m
        if age[k] < STALE:
            theirs = _squared_gap(x, y, mates, 4 * k)
            if theirs < low * low or (theirs < high * high and lower[k] != 0):
                rank += 1.0
            if lower[k] != 0:
                crowd += wp.clamp(1.0 - _gap(x, y, mates, 4 * k + 2) / SHARED_RADIUS, 0.0, 1.0)
    yaw = pose[3 * robot + 2]
    ahead = (x - pose[3 * robot]) * wp.cos(yaw) + (y - pose[3 * robot + 1]) * wp.sin(yaw)
    turn = 1.0 - ahead / wp.max(mine, 1.0e-3)
    return NEARER * rank + SHARED * crowd + TURN * turn / 2.0


@wp.func
def _is_blocked(
    x: float, y: float, robot: int, count: int, mates: wp.array[float], age: wp.array[float]
) -> bool:
    """As `planning.near_others`, of one square."""
    for m in range(count):
        k = robot * count + m
        if age[k] < RECENT and _squared_gap(x, y, mates, 4 * k) < AROUND:
            return True
    return False


@wp.kernel(enable_backward=False, grid_stride=False)
def weigh_square(
    code: wp.array[wp.uint8],
    wanted: wp.array[float],
    pose: wp.array[float],
    mates: wp.array[float],
    age: wp.array[float],
    lower: wp.array[int],
    rows: int,
    columns: int,
    count: int,
    wants: int,
    low_x: float,
    low_y: float,
    cell: float,
    ends: wp.array[float],
    enter: wp.array[float],
) -> None:
    """Find what a way costs that ends in a square, and what it costs to enter it."""
    index = wp.tid()
    robot = index // (rows * columns)
    first = robot * rows * columns
    i = (index - first) // columns
    j = index - first - i * columns
    x = low_x + cell * float(i)
    y = low_y + cell * float(j)
    own = wp.int32(code[index])
    free = (own & KIND_BITS) == IS_FREE
    clear = wp.bool(free)
    border = wp.bool(False)
    for turn in range(9):
        a = turn // 3 - 1
        b = turn % 3 - 1
        kind = _kind(code, first, rows, columns, i + a, j + b)
        clear = clear and kind != IS_WALL
        border = border or (kind == IS_UNKNOWN and (a == 0 or b == 0))

    end = wp.float32(wp.nan)
    if wants != 0:
        end = wanted[index]
    if wp.isnan(end):
        end = NOWHERE
        if (free and border) or (own & UNSEEN_BIT) != 0:
            end = _frontier_cost(x, y, robot, count, pose, mates, age, lower)
            end += wp.where(clear, 0.0, NARROW)
            end += wp.where((own & VISITED_BIT) != 0, BEEN, 0.0)
            end = wp.min(end, NOWHERE)
    ends[index] = end

    here_i = wp.clamp(wp.int32(wp.rint((pose[3 * robot] - low_x) / cell)), 0, rows - 1)
    here_j = wp.clamp(wp.int32(wp.rint((pose[3 * robot + 1] - low_y) / cell)), 0, columns - 1)
    open_ = free and (_gap(x, y, pose, 3 * robot) <= cell or not _is_blocked(x, y, robot, count, mates, age))
    open_ = open_ or (i == here_i and j == here_j)
    enter[index] = wp.where(open_, wp.where(clear, 0.0, BESIDE_WALL), wp.inf)


@warp_function
def _kernel() -> Any:  # noqa: ANN401
    return wp.jax_kernel(weigh_square, num_outputs=2, block_dim=THREADS)


def weigh_of_one(
    grid: MapGrid, pose: Array, seen: planning.Seen, mates: planning.Mates, wanted: Array | None
) -> tuple[jax.Array, jax.Array]:
    """As `planning.weigh_squares`; all maps over it make one launch."""
    code = jnp.asarray(seen.squares, jnp.uint8)
    for bit, which in ((UNSEEN, seen.unseen), (VISITED, seen.visited)):
        code |= jnp.where(which, bit, 0).astype(jnp.uint8)
    places = jnp.asarray(mates.headers)[:, np.array([0, 1, 3, 4])]
    costs = jnp.zeros((1, 1)) if wanted is None else jnp.asarray(wanted, jnp.float32)
    maps = (code, costs, pose, places, mates.ages, mates.lower)
    ends, enter = over_maps(partial(_weighed, grid, wanted is not None))(
        *(jnp.asarray(x)[None] for x in maps)
    )
    return ends[0], enter[0]


def _weighed(grid: MapGrid, wants: bool, *maps: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Weigh the squares of all maps, which lead the axes of all arguments."""
    code, wanted, pose, places, age, lower = maps
    found = _kernel()(
        code.reshape(-1),
        wanted.reshape(-1),
        *(jnp.asarray(x, jnp.float32).reshape(-1) for x in (pose, places, age)),
        lower.astype(jnp.int32).reshape(-1),
        *grid.shape,
        age.shape[1],
        int(wants),
        *grid.low,
        grid.cell,
        output_dims=code.size,
        launch_dims=code.size,
    )
    return found[0].reshape(code.shape), found[1].reshape(code.shape)
