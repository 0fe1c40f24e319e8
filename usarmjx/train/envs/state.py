"""What an environment hands out: who acts in it, and how all worlds are after a step."""

from dataclasses import dataclass
from typing import Any

import jax
from flax import struct

Array = jax.Array


@dataclass(frozen=True)
class AgentGroup:
    """Robots of one class that share a policy.

    Attributes:
        name: Robot class.
        agents: Names of the robots.
        obs_size: Numbers in an observation.
        action_size: Numbers in an action, each from -1 to 1.
    """

    name: str
    agents: tuple[str, ...]
    obs_size: int
    action_size: int


class EnvState(struct.PyTreeNode, kw_only=True):
    """A batch of worlds at work on a task.

    Attributes:
        batch: The worlds.
        memory: The task's own (worlds, ...).
        obs: What the agents see, per group (worlds, robots, obs_size).
        privileged: What only critics see (worlds, privileged_size).
        reward: Of the step, per group (worlds, robots); 0 in bad worlds.
        done: Whether the episode ended with this step; the world has started the next one (worlds,).
        truncated: Whether that was because the time was up, and for no other reason (worlds,).
        final_obs: As `obs`, before the restart; the same where not done.
        final_privileged: As `privileged`, before the restart.
        score: The score of the running episode (worlds,).
        final_score: The score of the last episode that ended; where done, of the one that ended now
            (worlds,).
        length: Steps of the running episode (worlds,).
        bad: Whether the physics went wrong in this step (worlds,): not finite, or contacts lost. Such an
            episode is done; its last transition is not to be learned from.
        metrics: As judged in this step, before any restart (worlds,).
        level: How difficult the arenas in play are, from 0 to 1 (); see `Env.at_level`.
    """

    batch: Any
    memory: Any
    obs: tuple[Array, ...]
    privileged: Array
    reward: tuple[Array, ...]
    done: Array
    truncated: Array
    final_obs: tuple[Array, ...]
    final_privileged: Array
    score: Array
    final_score: Array
    length: Array
    bad: Array
    metrics: dict[str, Array]
    level: Array | None = None


class EpisodeStart(struct.PyTreeNode, kw_only=True):
    """What an episode begins with."""

    memory: Any
    obs: tuple[Array, ...]
    privileged: Array
    score: Array
    length: Array
