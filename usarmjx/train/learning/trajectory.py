"""What robots do, see and get in a rollout, as data."""

from typing import Any

import jax
from flax import struct

from usarmjx.train.envs.env import EnvState

Groups = tuple[jax.Array, ...]


class Steps(struct.PyTreeNode, kw_only=True):
    """What happened, step by step.

    Attributes:
        obs: Per group (steps, worlds, robots, obs_size).
        privileged: (steps, worlds, privileged_size).
        raw: Actions before they are squashed, per group (steps, worlds, robots, action_size).
        log_prob: How probable they were, per group (steps, worlds, robots).
        value: What the critic thought before the step, per group (steps, worlds, robots).
        reward: Scaled, per group (steps, worlds, robots).
        bootstrap: What it thought of the state before the restart, where truncated, per group as `value`.
        fresh: Whether an episode began with the step (steps, worlds).
        done: Whether one ended with it (steps, worlds).
        truncated: Whether that was by time-out (steps, worlds).
        bad: Whether there is nothing to learn from the step (steps, worlds).
        shown: What the teacher would have done, as `raw` but squashed; nothing without a teacher.
    """

    obs: Groups
    privileged: jax.Array
    raw: Groups
    log_prob: Groups
    value: Groups
    reward: Groups
    bootstrap: Groups
    fresh: jax.Array
    done: jax.Array
    truncated: jax.Array
    bad: jax.Array
    shown: Groups


class Bounds(struct.PyTreeNode, kw_only=True):
    """What is known of the worlds before the first step and after the last.

    Attributes:
        number: Of each world, among those of all processes (worlds,).
        policy: What the policies remembered before the first step, per group (worlds, robots, memory).
        critic: What the critics remembered, as `policy`.
        last_value: What the critics think after the last step, per group (worlds, robots).
    """

    number: jax.Array
    policy: Groups
    critic: Groups
    last_value: Groups


class Collector(struct.PyTreeNode, kw_only=True):
    """The worlds of this process, and what goes on in them from one rollout to the next.

    Attributes:
        env: The worlds.
        number: Of each of them, among those of all processes (worlds,).
        policy: What the robots remember, per group (worlds, robots, memory).
        critic: What their critics remember, as `policy`.
        teacher: What the teacher remembers, if there is one (worlds, ...).
        gained: Rewards of the running episode, mean of the robots (worlds,).
        fresh: Whether an episode begins now (worlds,).
    """

    env: EnvState
    number: jax.Array
    policy: Groups
    critic: Groups
    teacher: Any
    gained: jax.Array
    fresh: jax.Array


class Seen(struct.PyTreeNode, kw_only=True):
    """What of an environment's state the trainer looks at; see `EnvState`."""

    obs: Groups
    privileged: jax.Array
    reward: Groups
    done: jax.Array
    truncated: jax.Array
    final_obs: Groups
    final_privileged: jax.Array
    final_score: jax.Array
    length: jax.Array
    bad: jax.Array
    metrics: dict[str, jax.Array]


def look(env: EnvState) -> Seen:
    """Return what the trainer looks at."""
    return Seen(**{name: getattr(env, name) for name in Seen.__dataclass_fields__})


class Decision(struct.PyTreeNode, kw_only=True):
    """What is decided in a step, and what is remembered after it; see `Steps` and `Collector`."""

    raw: Groups
    log_prob: Groups
    value: Groups
    shown: Groups
    policy: Groups
    critic: Groups
    teacher: Any
