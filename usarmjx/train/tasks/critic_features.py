"""True facts about a world that critics of teams see: coarse maps, and victims."""

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.backend import Array
from usarmjx.models.types.arena import ArenaSpec

TRUTH_WIDTH, OWN_WIDTH = 16, 8
"""Blocks along a side of a true map, and of a robot's own map."""
VICTIM_NUMBERS = 4
"""Numbers of a victim beside those of the robots: whether there is one, x, y, and whether it is reported."""


def coarse(mask: Array, width: int) -> jax.Array:
    """Return the share of a mask (i, j) in each block of a map (width, width)."""
    sides = [-(-side // width) for side in mask.shape]
    # Blocks are whole: squares beyond the map count as not in the mask.
    missing = [(0, side * width - length) for side, length in zip(sides, mask.shape, strict=True)]
    whole = jnp.pad(mask.astype(jnp.float32), missing)  # pyright: ignore[reportUnknownMemberType]
    return whole.reshape(width, sides[0], width, sides[1]).mean((1, 3))


def victim_features(arena: ArenaSpec, at: Array, there: Array, reported: Array, known: Array) -> jax.Array:
    """Return what critics see of victims (victims * (VICTIM_NUMBERS + robots),); zeros of those not there.

    Args:
        arena: The arena; positions are shares of its sides.
        at: Positions [m] (victims, 2).
        there: Which victims the world has (victims,).
        reported: Which the base knows (victims,).
        known: Which victims each robot has on its map (robots, victims).
    """
    extent = np.array(arena.extent, np.float32)
    place = (jnp.asarray(at) - extent[:, 0]) / (extent[:, 1] - extent[:, 0])
    columns = [jnp.ones_like(place[:, :1]), place, reported[:, None], jnp.asarray(known).T]
    return jnp.where(there[:, None], jnp.concatenate(columns, -1), 0.0).ravel()
