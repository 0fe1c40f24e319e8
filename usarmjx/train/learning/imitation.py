"""Learning to do what a policy written by hand does, before PPO makes it better.

The policy acts, the teacher says what he would have done (DAgger; Ross, Gordon and Bagnell 2011), so that
the states are those that the policy gets into. Meanwhile the critic learns what the policy's own actions
bring. Where a task hides from the policy what its baseline drives by, the teacher sees it all the same.
"""

from copy import copy
from functools import partial
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp

from usarmjx.base.errors import UsageError
from usarmjx.train.baselines import BASELINES
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.state import Memory
from usarmjx.train.envs.task import Carry, ObservationArrays, Policy, Task

if TYPE_CHECKING:
    from brax.training.distribution import NormalTanhDistribution


def teacher_of(env: Env) -> Policy:
    """Return the baseline of an environment's task; it acts on what `teacher_obs` returns.

    Raises:
        UsageError: The task has none; lists those that have.
    """
    if env.name not in BASELINES:
        raise UsageError(
            f"{env.name} has no policy by hand to imitate: set imitate to 0, or add one to BASELINES, which "
            f"has {', '.join(BASELINES.names())}"
        )
    task: Task | None = getattr(env, "task", None)  # environments of one's own need none
    if task is not None and task.for_baseline is not task:
        env = copy(env)
        env.task = task.for_baseline
    return BASELINES.get(env.name)(env)


def teacher_obs(env: Env, memory: Memory, obs: ObservationArrays) -> ObservationArrays:
    """Return what the teacher observes, per group (worlds, robots, obs_size).

    Args:
        env: The environment.
        memory: Its task's memory (worlds, ...).
        obs: What the policy observes, per group (worlds, robots, obs_size).
    """
    task: Task | None = getattr(env, "task", None)
    return obs if task is None else jax.vmap(partial(task.baseline_obs, env.scene))(memory, obs)


def reset_carry(teacher: Policy, carry: Carry, done: jax.Array) -> Carry:
    """Return a teacher's carry, as at the start in worlds where the episode is over (worlds,)."""
    initial = teacher.initial_carry(len(done))

    def one(start: jax.Array, now: jax.Array) -> jax.Array:
        return jnp.where(done.reshape(-1, *[1] * (now.ndim - 1)), start, now)

    return jax.tree.map(one, initial, carry)


def imitation_loss(
    kind: "NormalTanhDistribution", logits: jax.Array, teacher_action: jax.Array, deviation: float
) -> jax.Array:
    """Return how far the likeliest actions are from the teacher's, and their deviation from what it shall be.

    Args:
        kind: The family of distributions.
        logits: Its parameters (..., 2 action_size).
        teacher_action: What the teacher would have done, from -1 to 1 (..., action_size).
        deviation: Deviation of actions before they are squashed, see `Config.imitation_std`.

    Returns:
        Half the sum of the squares of both (...).
    """
    off = kind.mode(logits) - jnp.clip(teacher_action, -1.0, 1.0)
    spread = kind.create_dist(logits).scale - deviation
    return 0.5 * (off**2 + spread**2).sum(-1)
