"""Planners that choose goals of `explore-v3`: frontiers, and the way home with what the base wants."""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp

from usarmjx.base.errors import UsageError
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.task import ActionArrays, ObservationArrays, Policy
from usarmjx.train.mapping.way_driving import frontier_action
from usarmjx.train.tasks.explore_base import ExploreBase
from usarmjx.train.tasks.goal_features import GOALS, chosen_goal

Planner = Callable[[jax.Array], jax.Array]
"""From observations (..., n) to actions (..., action_size)."""


def goal_planner(env: Env, *, report: bool) -> Policy:
    """Return a planner for an environment of `explore-v3`; its carry is empty.

    Args:
        env: The environment.
        report: Whether robots go home with news, or to frontiers only. With wheels they always do.

    Raises:
        UsageError: Another task.
    """
    task = env.task
    if not isinstance(task, ExploreBase):
        raise UsageError(f"this planner chooses goals as explore-v3 has them, not as {env.name} does")
    choose = partial(chosen_goal, square=task.cell, report=report)

    def act(carry: tuple[()], obs: ObservationArrays, key: jax.Array) -> tuple[tuple[()], ActionArrays]:
        del key
        if task.discrete:
            return carry, tuple(jnp.eye(GOALS)[choose(seen)] for seen in obs)
        return carry, tuple(frontier_action(seen, env.episode_steps) for seen in obs)

    return Policy(initial_carry=lambda worlds: (), act=act)


def reporting_policy(env: Env) -> Policy:
    """Return the planner that brings news home; see `goal_planner`."""
    return goal_planner(env, report=True)


def silent_policy(env: Env) -> Policy:
    """Return the planner that only looks for frontiers; see `goal_planner`."""
    return goal_planner(env, report=False)
