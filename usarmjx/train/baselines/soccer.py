"""Soccer by hand, see `tasks.soccer_play`."""

import jax

from usarmjx.base.errors import UsageError
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.policy import Actions, Observations, Policy
from usarmjx.train.tasks.soccer import Soccer
from usarmjx.train.tasks.soccer_play import play


def players(env: Env) -> Policy:
    """Return the baseline of `soccer`; it has no memory.

    Raises:
        UsageError: Another task.
    """
    if not isinstance(env.task, Soccer):
        raise UsageError(f"this policy plays soccer, not {env.name}")

    def act(memory: tuple[()], obs: Observations, key: jax.Array) -> tuple[tuple[()], Actions]:
        del key
        return memory, (jax.vmap(jax.vmap(play))(obs[0]),)

    return Policy(start=lambda worlds: (), act=act)
