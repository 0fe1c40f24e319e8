"""Inputs of a rollout, by which its worlds can be computed again outside of the training."""

from collections.abc import Callable, Iterator
from typing import TypeAlias

import jax
import jax.numpy as jnp
from flax import struct

from usarmjx.train.envs.env import Env
from usarmjx.train.envs.state import EnvState
from usarmjx.train.learning.networks import LearnedPolicy
from usarmjx.train.learning.trajectory import GroupArrays, Trajectory


class RolloutInputs(struct.PyTreeNode, kw_only=True):
    """Worlds before a rollout, and all that happened to them in it.

    Attributes:
        iteration: Number of the iteration, from 1.
        env_state: The worlds before it.
        actions: Actions, per group (steps, worlds, robots, action_size).
        reward: Rewards of each step, mean of the robots (steps, worlds).
        done: Steps in which an episode ended (steps, worlds).
        bad: Steps in which a world went bad (steps, worlds).
    """

    iteration: int = struct.field(pytree_node=False)
    env_state: EnvState
    actions: GroupArrays
    reward: jax.Array
    done: jax.Array
    bad: jax.Array

    @property
    def steps(self) -> int:
        """Number of actions."""
        return len(self.bad)

    def action(self, step: int) -> GroupArrays:
        """Return the actions of a step, per group (worlds, robots, action_size)."""
        return tuple(one[step] for one in self.actions)


Inspector: TypeAlias = Callable[[RolloutInputs], None]
"""Receives each rollout's inputs while the device is still at work on it."""


def inputs_of(
    policy: LearnedPolicy, iteration: int, env_state: EnvState, trajectory: Trajectory, repeat: int = 1
) -> RolloutInputs:
    """Return the inputs of a rollout.

    Args:
        policy: The policy that acted.
        iteration: Number of the iteration, from 1.
        env_state: The worlds before the rollout.
        trajectory: Its steps.
        repeat: Steps of the worlds in each of them; what happened counts as in the last.
    """
    raw = trajectory.raw_action

    def spread(values: jax.Array) -> jax.Array:
        late = jnp.arange(len(values) * repeat) % repeat == repeat - 1
        return jnp.where(late[:, None], jnp.repeat(values, repeat, 0), jnp.zeros((), values.dtype))

    return RolloutInputs(
        iteration=iteration,
        env_state=env_state,
        actions=tuple(
            jnp.repeat(policy.distribution(g).postprocess(one), repeat, 0) for g, one in enumerate(raw)
        ),
        reward=spread(jnp.concatenate(trajectory.reward, -1).mean(-1)),
        done=spread(trajectory.done),
        bad=spread(trajectory.bad),
    )


def play_again(env: Env, inputs: RolloutInputs, steps: int) -> Iterator[tuple[int, EnvState, EnvState]]:
    """Yield the number of each action with the worlds before and after it, up to a number of actions."""
    state = inputs.env_state
    for step in range(steps):
        before, state = state, env.step(state, inputs.action(step))
        yield step, before, state
