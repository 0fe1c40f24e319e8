"""Data of a rollout: observations, actions, rewards, carries; and inputs to compute it again."""

from collections.abc import Callable, Iterator
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
from flax import struct
from flax.struct import PyTreeNode

from usarmjx.train.envs.env import Env
from usarmjx.train.envs.state import EnvState
from usarmjx.train.learning.league import Match
from usarmjx.train.learning.networks import LearnedPolicy

GroupArrays = tuple[jax.Array, ...]


class Trajectory(PyTreeNode, kw_only=True):
    """Steps of a rollout.

    Attributes:
        obs: Per group (steps, worlds, robots, obs_size).
        privileged: (steps, worlds, privileged_size).
        raw_action: Actions before they are squashed, per group (steps, worlds, robots, action_size).
        log_prob: Their log-probability, per group (steps, worlds, robots).
        value: The critic's value of the state before the step, per group (steps, worlds, robots).
        reward: Scaled, per group (steps, worlds, robots).
        bootstrap_value: That of the state before the reset, where truncated, per group (steps, worlds,
            robots).
        is_first: Whether an episode began with the step (steps, worlds).
        done: Whether one ended with it (steps, worlds).
        truncated: Whether that was by time-out (steps, worlds).
        bad: Whether the step is not to be trained on (steps, worlds).
        teacher_action: The teacher's action, squashed, per group (steps, worlds, robots,
            action_size); empty without a teacher.
        alive: Which agents acted in the step, per group (steps, worlds, robots); empty: always all.
        survived: Which of them are alive after it, before any reset, likewise.
    """

    obs: GroupArrays
    privileged: jax.Array
    raw_action: GroupArrays
    log_prob: GroupArrays
    value: GroupArrays
    reward: GroupArrays
    bootstrap_value: GroupArrays
    is_first: jax.Array
    done: jax.Array
    truncated: jax.Array
    bad: jax.Array
    teacher_action: GroupArrays
    alive: GroupArrays = ()
    survived: GroupArrays = ()

    def valid(self, group: int) -> jax.Array:
        """Return which steps of which agents of a group are to be trained on (steps, worlds, robots or 1)."""
        valid = ~self.bad[..., None]
        return valid & self.alive[group] if self.alive else valid

    def ends(self, group: int) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Return where agents' episodes end, where by time-out, and which steps are not to be trained on.

        Each (steps, worlds, robots or 1). An agent that is not alive any more has an end of its own.
        """
        done, truncated = self.done[..., None], self.truncated[..., None]
        if self.alive:
            # An agent that dies in the last step has ended by itself: the time-out's bootstrap is not its
            # own.
            done, truncated = done | ~self.survived[group], truncated & self.survived[group]
        return done, truncated, ~self.valid(group)

    def starts(self, group: int) -> jax.Array:
        """Return before which steps the memory of a group's agents is reset (steps, worlds[, robots])."""
        if not self.alive:
            return self.is_first
        # That of an agent that was not alive in the step before, or is not, as in the rollout.
        through = self.alive[group][:-1] & self.alive[group][1:]
        # Before the first step nothing: the rollout hands over a carry that is reset already.
        gaps = jnp.concatenate([jnp.zeros_like(through[:1]), ~through])
        return self.is_first[..., None] | gaps


class RolloutEnds(PyTreeNode, kw_only=True):
    """State of the worlds before the first step and after the last.

    Attributes:
        world_index: Index of each world among those of all processes (worlds,).
        policy_carry: That of the policies before the first step, per group (worlds, robots, memory).
        critic_carry: That of the critics, as `policy_carry`, per group (worlds, robots, memory).
        last_value: The critics' values of the state after the last step, per group (worlds, robots).
    """

    world_index: jax.Array
    policy_carry: GroupArrays
    critic_carry: GroupArrays
    last_value: GroupArrays


class RolloutState(PyTreeNode, kw_only=True):
    """State of this process's worlds from one rollout to the next.

    Attributes:
        env_state: The worlds.
        world_index: Index of each world among those of all processes (worlds,).
        policy_carry: That of the policies, per group (worlds, robots, memory).
        critic_carry: That of the critics, per group (worlds, robots, memory).
        teacher_carry: That of the teacher, if there is one (worlds, ...).
        episode_return: Rewards of the running episode, mean of the robots (worlds,).
        is_first: Whether an episode begins now (worlds,).
        opponent: See `league.Match` (worlds,); None: there is no league.
    """

    env_state: EnvState
    world_index: jax.Array
    policy_carry: GroupArrays
    critic_carry: GroupArrays
    teacher_carry: Any
    episode_return: jax.Array
    is_first: jax.Array
    opponent: jax.Array | None = None


class StepView(PyTreeNode, kw_only=True):
    """Fields of an environment's state that the trainer reads.

    Attributes:
        obs: Per group (worlds, robots, obs_size).
        privileged: (worlds, privileged_size).
        reward: Per group (worlds, robots).
        done: See `TaskState` (worlds,).
        truncated: See `TaskState` (worlds,).
        final_obs: Per group (worlds, robots, obs_size).
        final_privileged: (worlds, privileged_size).
        final_score: (worlds,).
        length: (worlds,).
        bad: (worlds,).
        metrics: By name (worlds,).
        alive: See `TaskState`, per group (worlds, robots); None: always all.
        final_alive: See `TaskState`, likewise.
    """

    obs: GroupArrays
    privileged: jax.Array
    reward: GroupArrays
    done: jax.Array
    truncated: jax.Array
    final_obs: GroupArrays
    final_privileged: jax.Array
    final_score: jax.Array
    length: jax.Array
    bad: jax.Array
    metrics: dict[str, jax.Array]
    alive: GroupArrays | None = None
    final_alive: GroupArrays | None = None


def step_view(env: EnvState) -> StepView:
    """Return the fields that the trainer reads."""
    return StepView(**{name: getattr(env, name) for name in StepView.__dataclass_fields__})


class Decision(PyTreeNode, kw_only=True):
    """Decision of a step, and the carries after it.

    Attributes:
        raw_action: Actions before they are squashed, per group (worlds, robots, action_size).
        log_prob: Their log-probability, per group (worlds, robots).
        value: The critic's, in the unit of rewards, per group (worlds, robots).
        teacher_action: Squashed, per group (worlds, robots, action_size); empty without a teacher.
        policy_carry: Per group (worlds, robots, memory).
        critic_carry: Per group (worlds, robots, memory).
        teacher_carry: The teacher's (worlds, ...).
        match: Games of a league; None: there is none.
    """

    raw_action: GroupArrays
    log_prob: GroupArrays
    value: GroupArrays
    teacher_action: GroupArrays
    policy_carry: GroupArrays
    critic_carry: GroupArrays
    teacher_carry: Any
    match: Match | None = None


class Background(PyTreeNode, kw_only=True):
    """Further inputs of a decision, which the policy does not see.

    Attributes:
        memory: The task's memory, for a teacher (worlds, ...).
        opponent: Opponents so far (worlds,); None: there is no league.
        is_first: Whether an episode begins (worlds,).
    """

    memory: Any
    opponent: jax.Array | None
    is_first: jax.Array


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
        # Only the last repeat has the result, or a reward would count several times.
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
