"""A controller that drives a skidding robot along the way that it observes."""

import jax
import jax.numpy as jnp

from usarmjx.train.mapping.belief import SECTOR_COUNT

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
