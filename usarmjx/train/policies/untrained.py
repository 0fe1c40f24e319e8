"""Policies without training: robots that do nothing, and robots that act at random."""

from collections.abc import Callable, Mapping

import jax
import jax.numpy as jnp

from usarmjx.base.errors import UnknownNameError
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.task import ActionArrays, Carry, ObservationArrays, Policy


def zero_policy(env: Env) -> Policy:
    """Return the policy of actions that are all 0."""

    def act(carry: Carry, obs: ObservationArrays, key: jax.Array) -> tuple[Carry, ActionArrays]:
        del key
        sizes = [group.action_size for group in env.groups]
        return carry, tuple(jnp.zeros((*o.shape[:2], n)) for o, n in zip(obs, sizes, strict=True))

    return Policy(initial_carry=_no_memory, act=act)


def random_policy(env: Env) -> Policy:
    """Return the policy of actions that are uniform from -1 to 1, new at each step."""

    def act(carry: Carry, obs: ObservationArrays, key: jax.Array) -> tuple[Carry, ActionArrays]:
        groups = zip(obs, env.groups, jax.random.split(key, len(obs)), strict=True)
        return carry, tuple(
            jax.random.uniform(k, (*o.shape[:2], group.action_size), minval=-1.0) for o, group, k in groups
        )

    return Policy(initial_carry=_no_memory, act=act)


def _no_memory(worlds: int) -> Carry:
    return jnp.zeros((worlds, 1))


UNTRAINED: Mapping[str, Callable[[Env], Policy]] = {"zero": zero_policy, "random": random_policy}
"""Untrained policies by name."""


def check_untrained(name: str) -> None:
    """Refuse other names.

    Raises:
        UnknownNameError: Lists the names.
    """
    if name not in UNTRAINED:
        raise UnknownNameError(f"no agent {name!r}; known: {', '.join(UNTRAINED)}")
