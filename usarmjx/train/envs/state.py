"""State that an environment returns: its agents, and all worlds after a step."""

from dataclasses import dataclass
from dataclasses import fields as fields_of
from typing import Any, TypeAlias

import jax
from flax import struct

from usarmjx.sim.batch import BatchState
from usarmjx.sim.world import World
from usarmjx.train.envs.layout import NO_VECTOR, ActionVector, ObservationLayout

Memory: TypeAlias = Any
"""A task's own state within an episode: any tree of arrays; only the task knows what is in it."""


@dataclass(frozen=True)
class AgentGroup:
    """Robots of one class that share a policy.

    Attributes:
        name: Robot class.
        agents: Names of the robots.
        obs_size: Numbers in an observation.
        action_size: Numbers in an action, each from -1 to 1.
        discrete: Whether the greatest number of an action is a choice. The last numbers of an observation
            then say which choices there are (1, else 0), as many as an action has.
        layout: Parts of an observation; None: they are not known, and networks of sets cannot read it.
        vector: Numbers behind those of the choices, which are no choices; of `discrete` ones only.
    """

    name: str
    agents: tuple[str, ...]
    obs_size: int
    action_size: int
    discrete: bool = False
    layout: ObservationLayout | None = None
    vector: ActionVector = NO_VECTOR

    @property
    def choices(self) -> int:
        """Choices of an action, if it is `discrete`."""
        return self.action_size - self.vector.size

    @property
    def outputs(self) -> int:
        """Parameters of the distribution of an action."""
        # A choice has a logit; a number of a normal distribution has a mean and a deviation.
        return self.choices + 2 * self.vector.size if self.discrete else 2 * self.action_size


class TaskState(struct.PyTreeNode, kw_only=True):
    """State of a task in a batch of worlds: all of an `EnvState` but the worlds.

    Attributes:
        memory: The task's own (worlds, ...).
        obs: Observations of the agents, per group (worlds, robots, obs_size).
        privileged: Observations of critics only (worlds, privileged_size).
        reward: Reward of the step, per group (worlds, robots); 0 in bad worlds.
        done: Whether the episode ended with this step; the world has started the next one (worlds,).
        truncated: Whether it was only cut off: the time was up, for no other reason, in a task whose
            `time_limit` is no end (worlds,).
        final_obs: As `obs` before the reset, the same where not done, per group (worlds, robots, obs_size).
        final_privileged: As `privileged`, before the reset (worlds, privileged_size).
        score: The score of the running episode (worlds,).
        final_score: The score of the last episode that ended; where done, of the one that ended now
            (worlds,).
        length: Steps of the running episode (worlds,).
        bad: Whether the physics was not finite or lost contacts in this step, or a number of the task was not
            finite (worlds,); such an episode is done, and its last transition is not to be trained on.
        metrics: As evaluated in this step, before any reset (worlds,).
        alive: Which agents take part from now on, per group (worlds, robots); others observe 0, do nothing
            and get no reward. None: always all, see `Task.presence`.
        final_alive: As `alive` before the reset, the same where not done, per group (worlds, robots).
        level: Difficulty of the arenas in play, from 0 to 1 (); see `Env.at_level`.
    """

    memory: Memory
    obs: tuple[jax.Array, ...]
    privileged: jax.Array
    reward: tuple[jax.Array, ...]
    done: jax.Array
    truncated: jax.Array
    final_obs: tuple[jax.Array, ...]
    final_privileged: jax.Array
    score: jax.Array
    final_score: jax.Array
    length: jax.Array
    bad: jax.Array
    metrics: dict[str, jax.Array]
    alive: tuple[jax.Array, ...] | None = None
    final_alive: tuple[jax.Array, ...] | None = None
    level: jax.Array | None = None


class EnvState(TaskState, kw_only=True):
    """A batch of worlds at work on a task: the worlds, beside the fields of `TaskState`.

    Attributes:
        batch: The worlds.
    """

    batch: BatchState

    @property
    def task_state(self) -> TaskState:
        """State of the task, without the worlds."""
        # Not by `asdict`, which copies all arrays.
        return TaskState(**{field.name: getattr(self, field.name) for field in fields_of(TaskState)})

    def with_task(self, batch: BatchState, task: TaskState) -> "EnvState":
        """Return the state with other worlds in which the task stands so."""
        return self.replace(batch=batch, **{one.name: getattr(task, one.name) for one in fields_of(task)})

    @property
    def episode_start(self) -> "EpisodeStart":
        """The part that a new episode begins with."""
        return EpisodeStart(**{one.name: getattr(self, one.name) for one in fields_of(EpisodeStart)})

    def with_start(self, batch: BatchState, begun: "EpisodeStart") -> "EnvState":
        """Return the state with other worlds, and with that part."""
        return self.replace(batch=batch, **{one.name: getattr(begun, one.name) for one in fields_of(begun)})


class EpisodeStart(struct.PyTreeNode, kw_only=True):
    """State at the start of an episode in one world; `TaskState` has the same fields for all worlds.

    Attributes:
        memory: The task's own.
        obs: Observations of the agents, per group (robots, obs_size).
        privileged: Observations of critics only (privileged_size,).
        score: 0 ().
        length: 0 ().
        alive: See `TaskState`, per group (robots,); None: always all.
    """

    memory: Memory
    obs: tuple[jax.Array, ...]
    privileged: jax.Array
    score: jax.Array
    length: jax.Array
    alive: tuple[jax.Array, ...] | None = None


class Restart(struct.PyTreeNode, kw_only=True):
    """Worlds of which some are about to begin their next episode.

    Attributes:
        worlds: All worlds (worlds, ...).
        begun: State at the start of their episodes (worlds, ...).
        qpos: Start positions of those that have begun theirs (worlds, nq).
        left: Which are still to begin it (worlds,).
    """

    worlds: World
    begun: EpisodeStart
    qpos: jax.Array
    left: jax.Array
