"""Baseline of soccer, see `tasks.soccer_play`."""

import jax

from usarmjx.base.errors import UsageError
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.task import ActionArrays, ObservationArrays, Policy
from usarmjx.train.tasks.soccer import Soccer
from usarmjx.train.tasks.soccer_play import soccer_action


def soccer_policy(env: Env) -> Policy:
    """Return the baseline of `soccer`; its carry is empty.

    Raises:
        UsageError: Another task.
    """
    if not isinstance(env.task, Soccer):
        raise UsageError(f"this policy plays soccer, not {env.name}")

    def act(carry: tuple[()], obs: ObservationArrays, key: jax.Array) -> tuple[tuple[()], ActionArrays]:
        del key
        return carry, (jax.vmap(jax.vmap(soccer_action))(obs[0]),)

    return Policy(initial_carry=lambda worlds: (), act=act)
