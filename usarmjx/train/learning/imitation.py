"""Imitation of a task's baseline before PPO improves the policy.

The policy acts and the teacher labels the states (DAgger; Ross, Gordon and Bagnell 2011), so that
the states are those that the policy gets into. Meanwhile the critic learns what the policy's own actions
bring. A task may hide from the policy inputs of its baseline; the teacher sees them all the same.
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
from usarmjx.train.learning.choices import ChoiceDistribution

if TYPE_CHECKING:
    from usarmjx.train.learning.networks import Distribution


def teacher_of(env: Env) -> Policy:
    """Return the baseline of an environment's task; it acts on what `teacher_obs` returns.

    Raises:
        UsageError: The task has none; lists those that have.
    """
    if env.name not in BASELINES:
        raise UsageError(
            f"{env.name} has no baseline to imitate: set imitation_steps to 0, or add one to BASELINES; "
            f"it has {', '.join(BASELINES.names())}"
        )
    task: Task | None = getattr(env, "task", None)  # environments of one's own need none
    if task is not None and task.for_baseline is not task:
        env = copy(env)
        env.task = task.for_baseline
    return BASELINES.get(env.name)(env)


def teacher_obs(env: Env, memory: Memory, obs: ObservationArrays) -> ObservationArrays:
    """Return the teacher's observations, per group (worlds, robots, obs_size).

    Args:
        env: The environment.
        memory: Its task's memory (worlds, ...).
        obs: The policy's observations, per group (worlds, robots, obs_size).
    """
    task: Task | None = getattr(env, "task", None)
    return obs if task is None else jax.vmap(partial(task.baseline_obs, env.scene))(memory, obs)


def reset_carry(teacher: Policy, carry: Carry, done: jax.Array) -> Carry:
    """Return a teacher's carry, as at the start in worlds where the episode is over (worlds,)."""
    initial = teacher.initial_carry(len(done))

    def reset_leaf(start: jax.Array, now: jax.Array) -> jax.Array:
        return jnp.where(done.reshape(-1, *[1] * (now.ndim - 1)), start, now)

    return jax.tree.map(reset_leaf, initial, carry)


def imitation_loss(
    kind: "Distribution", logits: jax.Array, teacher_action: jax.Array, deviation: float
) -> jax.Array:
    """Return the imitation loss: distance of modes from the teacher's actions, and of deviations.

    Args:
        kind: The family of distributions.
        logits: Its parameters (..., 2 action_size).
        teacher_action: The teacher's action, from -1 to 1 (..., action_size).
        deviation: Target deviation of actions before they are squashed, see `Config.imitation_std`.

    Returns:
        Half the sum of the squares of both (...); of choices, minus the logarithm of the probability of the
        teacher's.
    """
    if isinstance(kind, ChoiceDistribution):
        return -kind.log_prob(logits, teacher_action)
    error = kind.mode(logits) - jnp.clip(teacher_action, -1.0, 1.0)
    std_error = kind.create_dist(logits).scale - deviation
    return 0.5 * (error**2 + std_error**2).sum(-1)
