"""Small functions of the search for victims: what sensors met, and the fence of robots that fly."""

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.transforms import flip_angles, flip_vector, mat_from_angles
from usarmjx.train.envs.task import TaskView
from usarmjx.train.mapping.belief import Belief
from usarmjx.train.mapping.maps import MapGrid
from usarmjx.train.mapping.planning import VISITED_FRONTIER_COST
from usarmjx.train.mapping.wavefront import UNREACHABLE, frontier

ABSENT_VICTIM_DISTANCE = 1e5
"""Victims that a world does not have are farther away than this [m]."""
FENCE_MARGIN = 0.25
"""The fence of robots that fly is so far inside the building's outline [m]."""
FENCE_GAIN = 1.3
"""Their speed over the way that is left to it, at most [1/s]."""

SEEKING_COST, OUTWARD_COST = 1000.0, 2.0
"""So many squares longer than any way home seems one to a frontier; and by so many for each square that this
is away from the base."""


def seeking_costs(belief: Belief, gap: jax.Array) -> jax.Array:
    """Return what ways cost at their ends for robots that know none home: frontiers (robots, i, j) [squares].

    Args:
        belief: What they believe.
        gap: How far squares are from the base, as the crow flies [squares] (i, j).
    """
    cost = SEEKING_COST + OUTWARD_COST * gap + VISITED_FRONTIER_COST * belief.visited
    return jnp.where(jax.vmap(frontier)(belief.squares), cost, UNREACHABLE)


def detected_positions(view: TaskView, group: int) -> jax.Array:
    """Return what a group's victim sensors met: whether, then x ahead and y to the left [m].

    The robot is taken to stand level. Shape (robots, boxes, 3).
    """
    members = view.scene.groups[group]
    mount = members.suite.sensors[members.suite.index("VictSensor")].mounts[0]
    boxes = view.sensor(group, "VictSensor")
    mat = mat_from_angles(*flip_angles(mount.direction)).astype(np.float32)
    at = np.array(flip_vector(mount.at), np.float32)
    position = (mat * boxes[..., None, 2:]).sum(-1) + at
    return jnp.concatenate([boxes[..., :1], position[..., :2]], -1)


def mark_squares(grid: MapGrid, pose: jax.Array, met: jax.Array) -> jax.Array:
    """Return the squares in which a robot at a pose (3,) met something (boxes, 3) (i, j)."""
    cos, sin = jnp.cos(pose[2]), jnp.sin(pose[2])
    x, y = met[:, 1], met[:, 2]
    position = pose[:2] + jnp.stack([cos * x - sin * y, sin * x + cos * y], -1)
    there = grid.index(position)
    return jnp.zeros(grid.shape, bool).at[there[:, 0], there[:, 1]].max(met[:, 0] > 0)


def fence_of(extent: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return lowest and highest x and y [m] (2,) within the fence of an arena's extent (2, low or high)."""
    return extent[:, 0] + FENCE_MARGIN, extent[:, 1] - FENCE_MARGIN


def way_left(at: jax.Array, ahead: jax.Array, fence: tuple[jax.Array, jax.Array]) -> jax.Array:
    """Return how far robots may go on before they leave a fence [m] (robots,); 0: not at all.

    Args:
        at: Where they are [m] (robots, 2).
        ahead: Where they are heading: unit vectors (robots, 2).
        fence: Lowest and highest x and y [m] (2,).
    """
    edge = jnp.where(ahead > 0, fence[1], fence[0]) - at
    along = jnp.where(ahead == 0, jnp.inf, edge / jnp.where(ahead == 0, 1.0, ahead))
    return jnp.maximum(along.min(-1), 0.0)
