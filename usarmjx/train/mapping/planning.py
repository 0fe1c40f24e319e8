"""Where the robots of a team go: to frontiers of their own maps, around walls and each other.

Pure functions; leading axes are over the robots of one world, by roster slot.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.transforms import Array
from usarmjx.train.mapping.knowledge import RECENT, STALE, Knowledge
from usarmjx.train.mapping.maps import FREE, MapGrid
from usarmjx.train.mapping.wavefront import FAR, descend, distances, frontier, passable, place_of

AHEAD = 3
"""So many squares ahead on its way is the place that a robot steers for."""
LONGEST = 40
"""So many squares ahead on its way is, at most, the place that a robot says it is going to."""
TIGHT = 6.0
"""So many squares longer seems a step to a square with a wall beside it: there is just room for a robot."""
NARROW = 20.0
"""So many squares longer seems the way to a frontier with a wall beside it, where there is little to see."""
USELESS = 30.0
"""So many squares longer seems the way to a frontier where a robot has been, and saw no more of it."""
ROOM = 0.6
"""Ways keep so far from other robots' middles [m]."""
LEFT_TO_OTHERS = 6.0
"""So much longer does the way to a frontier seem that another robot is nearer to, in squares."""
CROWDED, CROWD = 20.0, 3.0
"""So much longer, in squares, does the way to a frontier seem where another robot is going; less, the farther
away, and nothing from so far on [m]."""
DOORSTEP = 1.5
"""A robot that comes home comes so close to its base [m]."""
BEHIND = 3.0
"""So much longer, in squares, does the way to a frontier right behind a robot seem: it would have to turn."""


class Minds(NamedTuple):
    """How the robots of a team think about where to go.

    Attributes:
        peers: Whose ways each robot minds: row itself, column the other (robots, robots).
        flyers: Which fly over walls, to squares that they have not looked at (robots,).
    """

    peers: np.ndarray
    flyers: np.ndarray


def alike(robots: int) -> Minds:
    """Return how robots think that all drive and explore."""
    return Minds(peers=~np.eye(robots, dtype=bool), flyers=np.zeros(robots, bool))


def plan(
    grid: MapGrid, mind: Knowledge, time: Array, minds: Minds | None = None, wanted: Array | None = None
) -> Knowledge:
    """Return what robots know after they thought about where to go: to a frontier, by `penalties`.

    Args:
        grid: The squares.
        mind: What they knew.
        time: The time [s] ().
        minds: How they think; None: see `alike`.
        wanted: What the way to squares costs at its end, where they do not look for a frontier; NaN: they do
            (robots, i, j).
    """
    minds = minds or alike(len(mind.pose))
    squares = jnp.where(minds.flyers[:, None, None], FREE, mind.squares)
    unseen = minds.flyers[:, None, None] & (mind.evidence == 0)
    wanted = jnp.full(squares.shape, jnp.nan) if wanted is None else wanted
    ages = jnp.where(minds.peers, time - mind.heard, jnp.inf)

    narrow = jnp.where(jax.vmap(passable)(squares), 0.0, NARROW)
    ends = jnp.where(jax.vmap(frontier)(squares) | unseen, narrow + USELESS * mind.been, FAR)

    def one(
        here: Array, pose: Array, mates: Array, age: Array, me: Array, end: Array, want: Array
    ) -> tuple[jax.Array, ...]:
        end = jnp.minimum(end + penalties(grid, pose, mates, age, me), FAR)
        return way(grid, here, pose, jnp.where(jnp.isnan(want), end, want), taken=taken(grid, mates, age))

    slots = jnp.arange(len(squares))
    ways = jax.vmap(one)(squares, mind.pose, mind.mates, ages, slots, ends, wanted)
    return mind.replace(next=ways[0], goal=ways[1], far=ways[2])


def penalties(grid: MapGrid, pose: Array, mates: Array, age: Array, me: Array) -> jax.Array:
    """Return how much longer the way to each square seems for what it is, in squares (i, j).

    A robot leaves a frontier to those that are nearer to it, as the crow flies, and that it has heard of, of
    two at the same distance to the one of the lower slot; it shuns where others are going, and would rather
    not turn around.

    Args:
        grid: The squares.
        pose: Of the robot (3,).
        mates: What it heard of the others (robots, HEADER).
        age: How long ago [s]; infinite: it does not mind that one (robots,).
        me: Its slot ().
    """
    middles = grid.middles
    known = age < STALE
    mine = jnp.linalg.norm(middles - pose[:2], axis=-1)
    theirs = jnp.linalg.norm(middles[:, :, None] - mates[:, :2], axis=-1)
    first = jnp.arange(len(mates)) < me
    nearer = (theirs < mine[..., None] - 1e-3) | ((theirs < mine[..., None] + 1e-3) & first)
    rank = (known & nearer).sum(-1)
    gap = jnp.linalg.norm(middles[:, :, None] - mates[:, 3:5], axis=-1)
    crowd = jnp.where(known & first, jnp.clip(1 - gap / CROWD, 0.0, 1.0), 0.0).sum(-1)
    along = middles - pose[:2]
    ahead = (along * jnp.stack([jnp.cos(pose[2]), jnp.sin(pose[2])])).sum(-1) / jnp.maximum(mine, 1e-3)
    return LEFT_TO_OTHERS * rank + CROWDED * crowd + BEHIND * (1 - ahead) / 2


def taken(grid: MapGrid, mates: Array, age: Array) -> jax.Array:
    """Return which squares are too close to where another robot said a moment ago to be (i, j)."""
    gap = jnp.linalg.norm(grid.middles[:, :, None] - mates[:, :2], axis=-1)
    return ((gap < ROOM) & (age < RECENT)).any(-1)


def way(
    grid: MapGrid,
    squares: Array,
    pose: Array,
    sources: Array,
    *,
    taken: Array | bool = False,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return the next place on a robot's way to the nearest source, where it leads, and how long it is.

    Args:
        grid: The squares.
        squares: What it knows of them (i, j).
        pose: Of the robot (3,).
        sources: What a way that ends in a square costs at its end; `FAR`: none ends there (i, j).
        taken: Squares that it does not drive through, though they are free (i, j).

    Returns:
        Two places [m] (2,), and the length in squares (); without a way both are where the robot is.
    """
    gap = jnp.linalg.norm(grid.middles - pose[:2], axis=-1)
    open_ = (squares == FREE) & ~(taken & (gap > grid.cell))
    here = grid.index(pose[:2])
    open_ = open_.at[here[0], here[1]].set(True)
    far = distances(sources, open_, jnp.where(passable(squares), 0.0, TIGHT), until=here)
    path = place_of(grid, descend(far, here, LONGEST))
    length = far[here[0], here[1]]
    there = length < FAR
    return jnp.where(there, path[AHEAD - 1], pose[:2]), jnp.where(there, path[-1], pose[:2]), length
