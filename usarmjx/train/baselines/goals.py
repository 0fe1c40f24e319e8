"""Planners of teams that choose goals: frontiers, and the way home with what the base wants."""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp

from usarmjx.base.errors import UsageError
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.task import ActionArrays, ObservationArrays, Policy
from usarmjx.train.mapping.planning import frontier_action
from usarmjx.train.tasks.goal_features import GOALS, chosen_goal
from usarmjx.train.tasks.goal_team import GoalTeam

Chooser = Callable[[jax.Array, float], jax.Array]
"""From observations (..., n) and the side of a map's squares [m] to goals (...,)."""


def goal_planner(env: Env, *, report: bool) -> Policy:
    """Return a planner for an environment of a `GoalTeam`; its carry is empty.

    Args:
        env: The environment.
        report: Whether robots go home with news, or to frontiers only. With wheels they always do.

    Raises:
        UsageError: Another task.
    """
    if _task_of(env).discrete:
        return policy_of_choices(env, partial(chosen_goal, report=report))

    def act(carry: tuple[()], obs: ObservationArrays, key: jax.Array) -> tuple[tuple[()], ActionArrays]:
        del key
        return carry, tuple(frontier_action(seen, env.episode_steps) for seen in obs)

    return Policy(initial_carry=lambda worlds: (), act=act)


def policy_of_choices(env: Env, choose: Chooser) -> Policy:
    """Return the policy that takes the goals that a function chooses; its carry is empty.

    Raises:
        UsageError: Another task, or one whose actions are speeds.
    """
    task = _task_of(env)
    if not task.discrete:
        raise UsageError(f"this planner chooses goals, but actions of {env.name} are {task.actions}")

    def act(carry: tuple[()], obs: ObservationArrays, key: jax.Array) -> tuple[tuple[()], ActionArrays]:
        del key
        return carry, tuple(jnp.eye(GOALS)[choose(seen, task.cell)] for seen in obs)

    return Policy(initial_carry=lambda worlds: (), act=act)


def _task_of(env: Env) -> GoalTeam:
    if not isinstance(env.task, GoalTeam):
        raise UsageError(f"this planner chooses goals as explore-v3 has them, not as {env.name} does")
    return env.task


def reporting_policy(env: Env) -> Policy:
    """Return the planner that brings news home; see `goal_planner`."""
    return goal_planner(env, report=True)


def silent_policy(env: Env) -> Policy:
    """Return the planner that only looks for frontiers; see `goal_planner`."""
    return goal_planner(env, report=False)
