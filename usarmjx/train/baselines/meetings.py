"""Planners that divide the way home: one robot carries what others know, and robots meet at agreed times.

A robot whose news another one carries home, from nearer by, explores on.
"""

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.backend import Array
from usarmjx.train.baselines.goals import policy_of_choices
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.task import Policy
from usarmjx.train.tasks.goal_features import (
    FIRST_GOAL,
    FIRST_MATE,
    GOAL_NUMBERS,
    HOME_MARGIN,
    HOME_SPEED,
    LENGTH_SCALE,
    LITTLE_NEWS,
    MATE_NUMBERS,
    NEAR_SCALE,
    NEWS_SCALE,
    OBSERVED_MATES,
    TIME_SCALE,
    chosen_goal,
)

MEETINGS = (0.5, 1.0)
"""Shares of an episode after which robots are to be at their base."""
EARLIER, LATER = 10.0, 20.0
"""Time to spare, and time after a meeting, with which a robot that goes to its base goes on [s]."""


def courier_goal(seen: Array, square: float) -> jax.Array:
    """Return the goals of robots as `chosen_goal` reports, but that one carries what others know (...,).

    Args:
        seen: Observations (..., n).
        square: Side of a map's squares [m].
    """
    alone, together = (chosen_goal(seen, square, report=report) for report in (True, False))
    return jnp.where(has_courier(seen), together, alone)


def meeting_goal(seen: Array, square: float) -> jax.Array:
    """Return the goals of robots that keep meetings (...,): the base, or what `chosen_goal` explores.

    Args:
        seen: Observations (..., n).
        square: Side of a map's squares [m].
    """
    seen = jnp.asarray(seen)
    explored = chosen_goal(seen, square, report=False)
    left, seconds, news = seen[..., 0], TIME_SCALE * seen[..., 1], NEWS_SCALE * seen[..., 5]
    home = seen[..., FIRST_GOAL : FIRST_GOAL + GOAL_NUMBERS]
    whole = seconds / jnp.maximum(left, 1e-6)
    until = seconds[..., None] - whole[..., None] * (1.0 - np.array(MEETINGS, np.float32))
    since = jnp.where(until > 0.0, jnp.inf, -until).min(-1)
    until = jnp.where(until > 0.0, until, jnp.inf).min(-1)
    spare = until - LENGTH_SCALE * home[..., 2] * square / HOME_SPEED - HOME_MARGIN
    # On its way a robot does not turn back as it gets on faster than planned, or is late.
    going = (home[..., 9] > 0.5) & ((spare < EARLIER) | (since < LATER))
    due = (spare < 0.0) | going
    return jnp.where(due & (news > LITTLE_NEWS) & ~has_courier(seen), 0, explored)


def has_courier(seen: Array) -> jax.Array:
    """Return whether another robot that is nearer to the base goes there with all that a robot knows (...,).

    Args:
        seen: Observations (..., n).
    """
    seen = jnp.asarray(seen)
    rows = seen[..., FIRST_MATE : FIRST_MATE + OBSERVED_MATES * MATE_NUMBERS]
    mates = rows.reshape(*seen.shape[:-1], OBSERVED_MATES, MATE_NUMBERS)
    base = NEAR_SCALE * seen[..., FIRST_GOAL : FIRST_GOAL + 2]
    gap = jnp.linalg.norm(NEAR_SCALE * mates[..., 1:3] - base[..., None, :], axis=-1)
    nearer = gap < jnp.linalg.norm(base, axis=-1)[..., None]
    going, knows = mates[..., 8] > 0.5, NEWS_SCALE * mates[..., 9] < LITTLE_NEWS
    return ((mates[..., 0] > 0.5) & going & knows & nearer).any(-1)


def courier_policy(env: Env) -> Policy:
    """Return the planner of couriers for an environment of a `GoalTeam`; its carry is empty.

    Raises:
        UsageError: Another task, or one whose actions are speeds.
    """
    return policy_of_choices(env, courier_goal)


def rendezvous_policy(env: Env) -> Policy:
    """Return the planner with meetings for an environment of a `GoalTeam`; its carry is empty.

    Raises:
        UsageError: Another task, or one whose actions are speeds.
    """
    return policy_of_choices(env, meeting_goal)
