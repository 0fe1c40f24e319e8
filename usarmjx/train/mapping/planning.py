"""Targets of robots on their own maps: frontiers, their base, other robots; ways to them, and driving along.

Pure functions. Leading axes of a team's are over the robots of one world, by roster slot. Distances to a
robot's goals are computed when a choice is due, not with every step.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax.custom_batching import custom_vmap

from usarmjx.base.backend import Array, get_rows, set_rows
from usarmjx.base.compilation import materialize
from usarmjx.train.mapping.belief import RECENT_AGE, SECTOR_COUNT, STALE_AGE, Belief
from usarmjx.train.mapping.maps import FREE, UNKNOWN, MapGrid
from usarmjx.train.mapping.wavefront import (
    UNREACHABLE,
    distances,
    frontier,
    passable,
    shortest_path,
    square_centre,
)

WAYPOINT_SQUARES = 3
"""Distance ahead on its way of the position that a robot steers for [squares]."""
LONGEST = 40
"""Largest distance ahead on its way of the position that a robot says it is going to [squares]."""
WALL_COST = 6.0
"""Addition to a step to a square with a wall beside it, where there is just room for a robot [squares]."""
NARROW_FRONTIER_COST = 20.0
"""Addition to the way to a frontier with a wall beside it, where there is little to see [squares]."""
VISITED_FRONTIER_COST = 30.0
"""Addition to the way to a frontier where a robot has been, and saw no more of it [squares]."""
OTHER_ROBOT_RADIUS = 0.6
"""Distance of ways from other robots' middles [m]."""
NEARER_ROBOT_COST = 6.0
"""Addition to the way to a frontier that another robot is nearer to [squares]."""
SHARED_GOAL_COST, SHARED_GOAL_RADIUS = 20.0, 3.0
"""Addition to the way to a frontier where another robot is going [squares], and the distance from there at
which it has fallen to nothing [m]."""
SAME_GAP = 1e-3
"""Robots whose distances differ by less count as equally near [m]."""
HOME_RADIUS = 1.5
"""Distance from its base at which a robot is home [m]."""
TURN_COST = 3.0
"""Addition to the way to a frontier right behind a robot, which would have to turn [squares]."""
TURN, FASTEST_TURN = 0.8, 0.5
"""Turning over the bearing of the next position [1/rad], and the most of it."""
CRUISE = 0.9
STOP_RANGE = 0.35 / 4
"""Range ahead at which a robot stops; as observed (0.35 m)."""
STUCK = 0.3
"""A robot that has come less far lately than this share of 0.5 m, though it should, backs up."""
BACK_UP_PERIOD, BACK_UP_STEPS = 20, 5
"""Steps of a period, and steps of it in which it backs up before it tries again."""
ARRIVED = 0.05
"""The next position is so near, as observed, only where there is no path (6 cm)."""
BLOCK = 8
"""Side of the blocks of a map of which each offers one frontier [squares]."""
GAIN_RADIUS = 7
"""Unknown squares so far around a frontier, along both axes, are what may be seen there [squares]."""
WAY_SQUARES = 32
"""Squares of a way that a robot keeps until its next choice."""


class PlannerSettings(NamedTuple):
    """Settings of the planner of a team's robots.

    Attributes:
        peers: Whose paths each robot heeds: row itself, column the other (robots, robots).
        flyers: Which fly over walls, to squares that they have not seen (robots,).
        planners: Slots of those that plan, one after another; the others stay where they go (n,).
    """

    peers: np.ndarray
    flyers: np.ndarray
    planners: np.ndarray

    @property
    def heeded(self) -> np.ndarray:
        """Slots of those whose paths each planner heeds (n, most); -1: nobody more."""
        rows = [np.flatnonzero(self.peers[planner]) for planner in self.planners]
        heeded = np.full((len(rows), max(map(len, rows), default=0)), -1)
        for place, row in zip(heeded, rows, strict=True):
            place[: len(row)] = row
        return heeded


def default_settings(robots: int) -> PlannerSettings:
    """Return settings for robots that all drive and explore."""
    return PlannerSettings(~np.eye(robots, dtype=bool), np.zeros(robots, bool), np.arange(robots))


def plan_paths(
    grid: MapGrid,
    belief: Belief,
    time: Array,
    settings: PlannerSettings | None = None,
    wanted: Array | None = None,
) -> Belief:
    """Return the belief after robots planned where to go: to a frontier, by `frontier_costs`.

    Args:
        grid: The squares.
        belief: That before it.
        time: The time [s] ().
        settings: Settings of their planner; None: see `default_settings`.
        wanted: Cost at the end of the way to squares, where they do not look for a frontier; NaN: they do
            (robots, i, j).
    """
    settings = settings or default_settings(len(belief.pose))
    planners, heeded = settings.planners, settings.heeded
    if not planners.size:
        return belief
    known = materialize(belief)  # else sums over these maps, for a score, become part of the planner's kernel
    flyers, visited = settings.flyers[planners, None, None], get_rows(known.visited, planners)
    # Robots that fly pass over walls.
    squares = jnp.where(flyers, FREE, get_rows(known.squares, planners))
    unseen = flyers & (get_rows(known.evidence, planners) == 0)
    given = jnp.full(squares.shape, jnp.nan) if wanted is None else get_rows(wanted, planners)
    ages = jnp.where(heeded >= 0, time - known.heard_time[planners[:, None], heeded], jnp.inf)
    # An index of -1 reads the last robot, which does not count: its age is infinite.
    mates = known.mate_headers[planners[:, None], heeded]

    narrow = jnp.where(jax.vmap(passable)(squares), 0.0, NARROW_FRONTIER_COST)
    ends = jnp.where(
        jax.vmap(frontier)(squares) | unseen, narrow + VISITED_FRONTIER_COST * visited, UNREACHABLE
    )

    def one(
        here: jax.Array,
        pose: jax.Array,
        mates: jax.Array,
        age: jax.Array,
        first: Array,
        end: jax.Array,
        want: Array,
    ) -> tuple[jax.Array, ...]:
        # Costs must not lift an end above `UNREACHABLE`: lengths are compared with it.
        end = jnp.minimum(end + frontier_costs(grid, pose, mates, age, first), UNREACHABLE)
        return path_to_nearest(
            grid, here, pose, jnp.where(jnp.isnan(want), end, want), blocked=near_others(grid, mates, age)
        )

    # Only those of lower slots: if two shunned each other's goals, both would turn away.
    first = heeded < planners[:, None]
    ways = jax.vmap(one)(squares, get_rows(known.pose, planners), mates, ages, first, ends, given)
    before = belief.waypoint, belief.goal, belief.path_length
    after = [set_rows(old, (planners, new)) for old, new in zip(before, ways, strict=True)]
    return belief.replace(waypoint=after[0], goal=after[1], path_length=after[2])


def frontier_costs(grid: MapGrid, pose: Array, mates: Array, age: Array, first: Array) -> jax.Array:
    """Return how much longer the way to each square seems for what it is, in squares (i, j).

    A robot leaves a frontier to those that are nearer to it, as the crow flies, and that it has heard of, of
    two at the same distance to the one of the lower slot; it shuns where others are going, and would rather
    not turn around.

    Args:
        grid: The squares.
        pose: Of the robot (3,).
        mates: Headers that it received from others (mates, HEADER_SIZE).
        age: Age [s]; infinite: it does not heed that one (mates,).
        first: Whether their slots are lower than its own (mates,).
    """
    known, first = (age < STALE_AGE)[:, None, None], first[:, None, None]
    mine, theirs = grid.gaps(pose[:2]), grid.squared_gaps(mates[:, :2])
    # Compared as squares, which saves a root for each pair of robots and squares.
    low, high = jnp.maximum(mine - SAME_GAP, 0.0), mine + SAME_GAP
    nearer = (theirs < low * low) | ((theirs < high * high) & first)
    rank = (known & nearer).sum(0)
    gap = grid.gaps(mates[:, 3:5])
    crowd = jnp.where(known & first, jnp.clip(1 - gap / SHARED_GOAL_RADIUS, 0.0, 1.0), 0.0).sum(0)
    cos, sin = jnp.cos(pose[2]), jnp.sin(pose[2])
    ahead = (grid.centres[..., 0] - pose[0]) * cos + (grid.centres[..., 1] - pose[1]) * sin
    # On its own square a robot has no direction.
    turn = 1 - ahead / jnp.maximum(mine, 1e-3)
    return NEARER_ROBOT_COST * rank + SHARED_GOAL_COST * crowd + TURN_COST * turn / 2


def near_others(grid: MapGrid, mates: Array, age: Array) -> jax.Array:
    """Return which squares are too close to where another robot said a moment ago to be (i, j)."""
    near = grid.squared_gaps(mates[:, :2]) < OTHER_ROBOT_RADIUS**2
    return (near & (age < RECENT_AGE)[:, None, None]).any(0)


def path_to_nearest(
    grid: MapGrid,
    squares: Array,
    pose: Array,
    sources: Array,
    *,
    blocked: Array | bool = False,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return the next position on a robot's path to the nearest source, where that leads, and its length.

    Args:
        grid: The squares.
        squares: Its belief of them (i, j).
        pose: Of the robot (3,).
        sources: Cost at the end of a way that ends in a square; `UNREACHABLE`: none ends there (i, j).
        blocked: Squares that it does not drive through, though they are free (i, j).

    Returns:
        Two positions [m] (2,), and the length in squares (); without a path both are where the robot is.
    """
    # The robot's surroundings stay open: another one next to it must not wall it in.
    open_ = (squares == FREE) & ~(blocked & (grid.gaps(pose[:2]) > grid.cell))
    here = grid.index(pose[:2])
    # Its own square, too, whatever the map says: a way could not end there.
    open_ = open_ | grid.only(here)
    far = distances(sources, open_, jnp.where(passable(squares), 0.0, WALL_COST), until=here)
    path = square_centre(grid, shortest_path(far, here, LONGEST))
    length = far[here[0], here[1]]
    there = length < UNREACHABLE
    return (
        jnp.where(there, path[WAYPOINT_SQUARES - 1], pose[:2]),
        jnp.where(there, path[-1], pose[:2]),
        length,
    )


def frontier_action(seen: jax.Array, steps: int) -> jax.Array:
    """Return actions (..., 2) of robots that drive the way they observe (..., n); see `TeamTask`.

    Args:
        seen: Their observations.
        steps: Of an episode.
    """
    ahead, left = seen[..., 0], seen[..., 1]
    moved = seen[..., 5]
    clear, time = seen[..., 6 : 6 + SECTOR_COUNT], seen[..., 6 + SECTOR_COUNT]
    bearing = jnp.arctan2(left, ahead)
    turn = jnp.clip(TURN * bearing, -FASTEST_TURN, FASTEST_TURN)
    middle = clear[..., SECTOR_COUNT // 2 - 2 : SECTOR_COUNT // 2 + 2].min(-1)
    speed = (
        CRUISE * jnp.clip(jnp.cos(bearing), 0.0, 1.0) ** 3 * jnp.clip((middle - 0.05) / STOP_RANGE, 0.0, 1.0)
    )
    idle = jnp.hypot(ahead, left) < ARRIVED
    # Backing up and turning to the side that is freer.
    sides = clear[..., SECTOR_COUNT // 2 :].min(-1) - clear[..., : SECTOR_COUNT // 2].min(-1)
    back = (moved < STUCK) & (jnp.mod(jnp.round(time * steps), BACK_UP_PERIOD) < BACK_UP_STEPS) & ~idle
    speed = jnp.where(back, -0.5, speed)
    turn = jnp.where(back, 0.3 * jnp.sign(sides), turn)
    return jnp.where(idle[..., None], 0.0, jnp.stack([speed, turn], -1))


class Goals(struct.PyTreeNode, kw_only=True):
    """Goals of a robot.

    Attributes:
        position: Positions [m] (goals, 2).
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
        # One more in front: a difference of cumulative sums needs the sum before the first square.
        padding[axis] = (radius + 1, radius)
        # A difference of two running sums costs the same for any radius.
        sums = jnp.cumsum(jnp.pad(total, padding), axis)  # pyright: ignore[reportUnknownMemberType]
        length = total.shape[axis]
        high = jax.lax.slice_in_dim(sums, 2 * radius + 1, 2 * radius + 1 + length, axis=axis)
        total = high - jax.lax.slice_in_dim(sums, 0, length, axis=axis)
    return total


def open_squares(grid: MapGrid, squares: Array, pose: Array, blocked: Array | bool) -> jax.Array:
    """Return which squares a robot at a pose (3,) drives through: free ones that are not blocked (i, j)."""
    # The robot's surroundings stay open: another one next to it must not wall it in.
    free = (squares == FREE) & ~(blocked & (grid.gaps(pose[:2]) > grid.cell))
    here = grid.index(pose[:2])
    # Its own square, too, whatever the map says: a way could not end there.
    return free | grid.only(here)


def block_minima(costs: Array, count: int) -> tuple[jax.Array, jax.Array]:
    """Return the squares (count, 2) and costs (count,) of the lowest costs, at most one in each block.

    Args:
        costs: Of the squares; `UNREACHABLE` and more: not this one (i, j).
        count: Number of squares.
    """
    rows, columns = costs.shape
    missing = ((0, -rows % BLOCK), (0, -columns % BLOCK))
    # Whole blocks: what is added is reached by nobody.
    whole = jnp.pad(costs, missing, constant_values=UNREACHABLE)  # pyright: ignore[reportUnknownMemberType]
    down, across = whole.shape[0] // BLOCK, whole.shape[1] // BLOCK
    blocks = whole.reshape(down, BLOCK, across, BLOCK).swapaxes(1, 2).reshape(down * across, -1)
    inside, lowest = blocks.argmin(-1), blocks.min(-1)
    # A small map has fewer blocks than goals; shapes must not depend on that.
    if down * across < count:
        lowest = jnp.concatenate([lowest, jnp.full(count - down * across, UNREACHABLE)])
        inside = jnp.concatenate([inside, jnp.zeros(count - down * across, inside.dtype)])
    # Negated: `lax.top_k` finds the largest.
    found, block = jax.lax.top_k(-lowest, count)
    square = jnp.stack(
        [block // across * BLOCK + inside[block] // BLOCK, block % across * BLOCK + inside[block] % BLOCK], -1
    )
    # A goal that a small map lacks is of a block beyond the map.
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
    start = jnp.where(grid.only(here), 0.0, UNREACHABLE)
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
    start = jnp.where(grid.only(there), 0.0, UNREACHABLE)
    far = distances(start, open_, jnp.where(passable(squares), 0.0, WALL_COST), until=here)
    way = square_centre(grid, shortest_path(far, here, WAY_SQUARES))
    return jnp.where(far[here[0], here[1]] < UNREACHABLE, way, pose[:2])


def next_on_way(way: Array, position: Array) -> jax.Array:
    """Return the position on a way (n, 2) that a robot at a position (2,) steers for [m] (2,)."""
    # By position, not by steps since the way was found: robots turn and back up on it.
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

        # One condition for all worlds: mapped, a condition of each would become a `where` that computes both.
        found = tuple(jax.tree.leaves(jax.lax.cond(due.any(), anew, lambda: old)))
        return found, (True,) * len(found)

    return jax.tree.unflatten(jax.tree.structure(old), call(jnp.asarray(due), *leaves))
