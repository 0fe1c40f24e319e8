"""Picture of a robot's whole map at several scales, around the robot and in its axes.

Pure functions of one robot; map them over robots.
"""

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.backend import Array
from usarmjx.train.mapping.maps import FREE, WALL, MapGrid, points_around, to_robot_frame
from usarmjx.train.mapping.wavefront import frontier

LEVELS, WIDTH = 3, 16
"""Scales of the picture, and points along a side of each."""
CHANNELS = ("explored", "wall", "frontier", "news", "others")
"""Numbers of a point: the shares of its squares that are known to be free, walls, frontiers, and free but
perhaps not on the base's map; and the number of other robots that were heard of there."""
FINEST = 2
"""Squares along a side of a point at the finest scale; at each other scale there are twice as many."""


def squares_of_point(level: int) -> int:
    """Return the number of squares along a side of a point at a scale, from 0."""
    return FINEST * 2**level


def block_means(layers: Array, side: int) -> jax.Array:
    """Return the means of maps (n, i, j) over square blocks (n, blocks, blocks).

    Args:
        layers: The maps; squares beyond their edges count as 0.
        side: Squares along a side of a block.
    """
    rows, columns = layers.shape[1:]
    missing = ((0, 0), (0, -rows % side), (0, -columns % side))
    whole = jnp.pad(layers.astype(jnp.float32), missing)  # pyright: ignore[reportUnknownMemberType]
    return whole.reshape(len(whole), -1, side, whole.shape[2] // side, side).mean((2, 4))


def layers_of(squares: Array, news: Array) -> jax.Array:
    """Return the layers of a picture (n, i, j), from a map (i, j) and its squares that are news (i, j)."""
    return jnp.stack([squares == FREE, squares == WALL, frontier(squares), news])


def map_pyramid(
    grid: MapGrid, squares: Array, news: Array, pose: Array, others: Array, heard: Array
) -> jax.Array:
    """Return a robot's picture (LEVELS, WIDTH, WIDTH, channels).

    A point shows the block of squares that it lies in, as the whole map is divided into blocks.

    Args:
        grid: The squares.
        squares: Its map (i, j).
        news: Squares that the base may not have (i, j).
        pose: Its pose: x, y [m] and yaw [rad] (3,).
        others: Positions of the others [m] (others, 2).
        heard: Which of them it has heard of lately (others,).
    """
    layers, found = layers_of(squares, news), list[jax.Array]()
    for level in range(LEVELS):
        side = squares_of_point(level)
        spacing = side * grid.cell
        means = block_means(layers, side)
        steps = (points_around(pose, WIDTH, spacing) - np.array(grid.low, np.float32)) / grid.cell
        block = jnp.floor((steps + 0.5) / side).astype(jnp.int32)
        inside = ((block >= 0) & (block < np.array(means.shape[1:]))).all(-1)
        block = jnp.clip(block, 0, np.array(means.shape[1:]) - 1)
        shown = jnp.where(inside, means[:, block[..., 0], block[..., 1]], 0.0)
        found.append(
            jnp.concatenate([jnp.moveaxis(shown, 0, -1), _seen_others(pose, others, heard, spacing)], -1)
        )
    return jnp.stack(found)


def _seen_others(pose: Array, others: Array, heard: Array, spacing: float) -> jax.Array:
    """Return how many others are at each point (WIDTH, WIDTH, 1)."""
    place = jnp.floor(to_robot_frame(pose, others) / spacing + WIDTH / 2).astype(jnp.int32)
    points = np.arange(WIDTH)
    rows, columns = (place[:, axis, None] == points for axis in range(2))
    counted = rows[:, :, None] & columns[:, None, :] & heard[:, None, None]
    return counted.sum(0)[..., None].astype(jnp.float32)
