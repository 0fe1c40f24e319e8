"""A planner of chains: robots go outward while they hear one that is nearer to the base."""

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.backend import Array
from usarmjx.train.baselines.goals import policy_of_choices
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.task import Policy
from usarmjx.train.tasks.goal_features import (
    CONTACT_SCALE,
    FAR_SCALE,
    FIRST_GOAL,
    FIRST_MASK,
    FIRST_MATE,
    GOAL_NUMBERS,
    GOALS,
    LENGTH_SCALE,
    MATE_NUMBERS,
    MATES,
    NEAR_SCALE,
    OBSERVED_MATES,
)
from usarmjx.train.tasks.goal_team import HOLD

STRONG = 0.05
"""Power above the cutoff, as observed, with which a robot goes on: 1 dB."""
LOST = 2.0
"""A robot that has had no contact with the base for so long goes there [s]."""
AHEAD = 0.3
"""A robot that is nearer to the base by so much comes before another one in the chain [m]."""
OUTWARD_WORTH = 3.0
"""Way that a frontier is worth for each square of its distance from the base [squares]."""


def chain_goal(seen: Array, square: float) -> jax.Array:
    """Return the goals of robots that form a chain (...,).

    A robot goes to frontiers far from the base as long as the base, or a robot that is nearer to it, is heard
    well; else it holds its place. Without contact it goes to the base.

    Args:
        seen: Observations (..., n).
        square: Side of a map's squares [m].
    """
    seen = jnp.asarray(seen)
    goals = seen[..., FIRST_GOAL:FIRST_MASK].reshape(*seen.shape[:-1], GOALS, GOAL_NUMBERS)
    away = goals[..., 4] * FAR_SCALE / square
    cost = LENGTH_SCALE * goals[..., 2] - OUTWARD_WORTH * away
    valid = (seen[..., -GOALS:] > 0.5) & (np.arange(GOALS) > MATES)
    cost = jnp.where(valid, cost, jnp.inf)
    outward = jnp.where(valid.any(-1), cost.argmin(-1), HOLD)
    chosen = jnp.where(_heard(seen) > STRONG, outward, HOLD)
    return jnp.where(CONTACT_SCALE * seen[..., 4] > LOST, 0, chosen)


def _heard(seen: jax.Array) -> jax.Array:
    """Return the best signal of the base or a robot that is nearer to it (...,)."""
    rows = seen[..., FIRST_MATE : FIRST_MATE + OBSERVED_MATES * MATE_NUMBERS]
    mates = rows.reshape(*seen.shape[:-1], OBSERVED_MATES, MATE_NUMBERS)
    base = NEAR_SCALE * seen[..., FIRST_GOAL : FIRST_GOAL + 2]
    gap = jnp.linalg.norm(NEAR_SCALE * mates[..., 1:3] - base[..., None, :], axis=-1)
    before = gap < jnp.linalg.norm(base, axis=-1)[..., None] - AHEAD
    signals = jnp.where((mates[..., 0] > 0.5) & before, mates[..., 6], 0.0)
    return jnp.maximum(signals.max(-1), seen[..., 3])


def chain_policy(env: Env) -> Policy:
    """Return the planner for an environment of `relay-chain-v3`; its carry is empty.

    Raises:
        UsageError: Another task, or one whose actions are speeds.
    """
    return policy_of_choices(env, chain_goal)
