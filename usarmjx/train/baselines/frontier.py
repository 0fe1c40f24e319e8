"""Robots of a team drive to the frontiers of their maps: what team tasks' trained policies have to beat."""

import jax
import jax.numpy as jnp

from usarmjx.base.errors import UsageError
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.task import ActionArrays, ObservationArrays, Policy
from usarmjx.train.mapping.belief import SECTOR_COUNT
from usarmjx.train.mapping.planning import frontier_action


def frontier_policy(env: Env) -> Policy:
    """Return the policy for an environment of a team task; its carry is empty.

    Raises:
        UsageError: The robots do not observe the way that it drives.
    """
    if not getattr(env.task, "advice", True):
        raise UsageError(f"{env.name} with advice=false: its baseline drives the way that this hides")

    def act(carry: tuple[()], obs: ObservationArrays, key: jax.Array) -> tuple[tuple[()], ActionArrays]:
        del key
        return carry, tuple(frontier_action(seen, env.episode_steps) for seen in obs)

    return Policy(initial_carry=lambda worlds: (), act=act)


STOP, SLOW_MARGIN = 0.1, 0.2
"""Power above the cutoff, as observed, at which a robot stops, and up to which it is slow: 2 and 4 dB."""
HOMING_AGE = 2.0 / 60.0
"""Age of the last contact, as observed, from which a robot drives home without looking at powers."""


def relay_policy(env: Env) -> Policy:
    """Return the policy for an environment of `relay-chain-v1`; its carry is empty.

    The robots form a chain in the order of their slots, the base first. Each drives the way that it observes,
    which leads outward, and stops where the signal of the one before it gets weak; so the first ones become
    relays, and the last one goes farthest. If the task's `talk` is none, they do not look at the radio.

    Raises:
        UsageError: See `frontier_policy`.
    """
    robots, greedy = env.scene.num_robots, frontier_policy(env)
    if getattr(env.task, "talk", "all") == "none":
        return greedy

    def act(carry: tuple[()], obs: ObservationArrays, key: jax.Array) -> tuple[tuple[()], ActionArrays]:
        del key
        return carry, tuple(_chained(seen, robots, env.episode_steps) for seen in obs)

    return Policy(initial_carry=lambda worlds: (), act=act)


def _chained(seen: jax.Array, robots: int, steps: int) -> jax.Array:
    action = frontier_action(seen, steps)
    slot = jnp.round(seen[..., 7 + SECTOR_COUNT] * robots).astype(jnp.int32)
    powers = seen[..., -(robots - 1) :]
    before = jnp.take_along_axis(powers, slot[..., None] - 1, -1)[..., 0]
    age = seen[..., -robots]
    go = jnp.where(age > HOMING_AGE, 1.0, jnp.clip((before - STOP) / (SLOW_MARGIN - STOP), 0.0, 1.0))
    return action * go[..., None]
