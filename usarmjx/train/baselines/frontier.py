"""Robots of a team drive to the frontiers of their maps: what team tasks' trained policies have to beat."""

import jax
import jax.numpy as jnp

from usarmjx.train.env import Env
from usarmjx.train.knowledge import SECTORS
from usarmjx.train.policy import Actions, Observations, Policy

TURN, FASTEST_TURN = 0.8, 0.5
"""Turning over the bearing of the next place [1/rad], and the most of it."""
CRUISE = 0.9
CLOSE = 0.35 / 4
"""What is so near ahead stops a robot; as observed (0.35 m)."""
STUCK = 0.3
"""A robot that has come less far lately than this share of 0.5 m, though it should, backs up."""
NOWHERE = 0.99
"""Length of the way, as observed, from which there is none."""


def frontier(env: Env) -> Policy:
    """Return the policy for an environment of a team task; it has no memory."""

    def act(memory: tuple[()], obs: Observations, key: jax.Array) -> tuple[tuple[()], Actions]:
        del key
        return memory, tuple(drive(seen) for seen in obs)

    del env
    return Policy(start=lambda worlds: (), act=act)


def drive(seen: jax.Array) -> jax.Array:
    """Return actions (..., 2) of robots that drive the way they observe (..., n); see `TeamTask`."""
    ahead, left = seen[..., 0], seen[..., 1]
    far, moved = seen[..., 4], seen[..., 5]
    clear, time = seen[..., 6 : 6 + SECTORS], seen[..., 6 + SECTORS]
    bearing = jnp.arctan2(left, ahead)
    turn = jnp.clip(TURN * bearing, -FASTEST_TURN, FASTEST_TURN)
    middle = clear[..., SECTORS // 2 - 2 : SECTORS // 2 + 2].min(-1)
    speed = CRUISE * jnp.clip(jnp.cos(bearing), 0.0, 1.0) ** 3 * jnp.clip((middle - 0.05) / CLOSE, 0.0, 1.0)
    there = jnp.hypot(ahead, left) < 0.05
    idle = there | (far > NOWHERE)
    # Backing up, in turns of some steps, and turning to the side that is freer.
    sides = clear[..., SECTORS // 2 :].min(-1) - clear[..., : SECTORS // 2].min(-1)
    back = (moved < STUCK) & (jnp.mod(time * 40, 1.0) < 0.5) & ~idle
    speed = jnp.where(back, -0.5, speed)
    turn = jnp.where(back, 0.3 * jnp.sign(sides), turn)
    return jnp.where(idle[..., None], 0.0, jnp.stack([speed, turn], -1))
