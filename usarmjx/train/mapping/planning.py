"""Targets of a team's robots: to frontiers of their own maps, around walls and each other.

Pure functions; leading axes are over the robots of one world, by roster slot.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import set_rows
from usarmjx.base.compilation import materialize
from usarmjx.train.mapping.belief import RECENT_AGE, STALE_AGE, Belief
from usarmjx.train.mapping.maps import FREE, MapGrid
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
    mine = _rows_of(planners)
    known = materialize(belief)  # else sums over these maps, for a score, become part of the planner's kernel
    flyers, visited = settings.flyers[mine, None, None], known.visited[mine]
    squares = jnp.where(flyers, FREE, known.squares[mine])
    unseen = flyers & (known.evidence[mine] == 0)
    wanted = jnp.full(squares.shape, jnp.nan) if wanted is None else wanted[mine]
    ages = jnp.where(heeded >= 0, time - known.heard_time[planners[:, None], heeded], jnp.inf)
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
        end = jnp.minimum(end + frontier_costs(grid, pose, mates, age, first), UNREACHABLE)
        return path_to_nearest(
            grid, here, pose, jnp.where(jnp.isnan(want), end, want), blocked=near_others(grid, mates, age)
        )

    first = heeded < planners[:, None]
    ways = jax.vmap(one)(squares, known.pose[mine], mates, ages, first, ends, wanted)
    before = belief.waypoint, belief.goal, belief.path_length
    after = [set_rows(old, (planners, new)) for old, new in zip(before, ways, strict=True)]
    return belief.replace(waypoint=after[0], goal=after[1], path_length=after[2])


def _rows_of(planners: np.ndarray) -> slice | np.ndarray:
    """Return what takes the planners' rows: a slice if it can be, as that copies no maps."""
    low, count = int(planners[0]), len(planners)
    return slice(low, low + count) if (planners == low + np.arange(count)).all() else planners


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
    low, high = jnp.maximum(mine - SAME_GAP, 0.0), mine + SAME_GAP
    nearer = (theirs < low * low) | ((theirs < high * high) & first)
    rank = (known & nearer).sum(0)
    gap = grid.gaps(mates[:, 3:5])
    crowd = jnp.where(known & first, jnp.clip(1 - gap / SHARED_GOAL_RADIUS, 0.0, 1.0), 0.0).sum(0)
    cos, sin = jnp.cos(pose[2]), jnp.sin(pose[2])
    ahead = (grid.centres[..., 0] - pose[0]) * cos + (grid.centres[..., 1] - pose[1]) * sin
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
    open_ = (squares == FREE) & ~(blocked & (grid.gaps(pose[:2]) > grid.cell))
    here = grid.index(pose[:2])
    open_ = open_.at[here[0], here[1]].set(True)
    far = distances(sources, open_, jnp.where(passable(squares), 0.0, WALL_COST), until=here)
    path = square_centre(grid, shortest_path(far, here, LONGEST))
    length = far[here[0], here[1]]
    there = length < UNREACHABLE
    return (
        jnp.where(there, path[WAYPOINT_SQUARES - 1], pose[:2]),
        jnp.where(there, path[-1], pose[:2]),
        length,
    )
