"""Set attention with messages: PPO for teams of any size, robots send vectors over their links.

The algorithm is that of `ippo.py` with another network. An agent attends over the set of its team mates as it
observes them, then over the messages of those that have a link to it. A message is `--message` numbers, four
bytes each, sent to all that are linked, once an action. Networks know no number of robots: weights of a team
of four drive teams of two or eight.

The mailbox is differentiable: in the update the loss of a listener's action goes back through the message
into the speaker's weights (Foerster et al., "Learning to communicate with deep multi-agent reinforcement
learning", 2016; Das et al., "TarMAC", 2019). `--message 0` trains without messages. Messages arrive within
the step that they are sent in.

In tasks whose agents choose goals the mates are the nearest ones, and messages are the `vector`s of the task
(`actions=goals+message`, `message_floats`): a policy chooses when to send its `--message` numbers, and to
whom. They take bytes and time, and agents observe the last one of each mate beside it. The sender learns from
rewards alone: a vector arrives in a later step than that of its loss. Play such a run with the task's
settings, as `--set actions=goals+message --set message_floats=8`.

    python examples/marl/attention.py --task explore-v2 --total-steps 20000000 --seed 0 --out runs/attention-0
    usarmjx eval examples/marl/attention.py:load@runs/attention-0 --task explore-v2 --set count=8
"""

from dataclasses import dataclass, field
from functools import partial
from typing import Any

import flax.linen as nn
import ippo
import jax
import jax.numpy as jnp
import marl_games as games
import marl_shared as shared
import numpy as np


@dataclass(frozen=True, kw_only=True)
class AttentionFlags(shared.PpoFlags):
    """Flags of set attention."""

    message: int = field(default=8, metadata={"help": "numbers in a message; 0: none are sent"})


@dataclass(frozen=True)
class Layout:
    """Place of the team mates in an observation.

    Attributes:
        start: First of their numbers.
        features: Numbers about each.
        link: Which of these says whether there is a link; None: mates are no rows of known robots, and the
            first number says whether there is one.
        slots: Slot of each agent among all robots, the base too.
        robots: All robots; where mates are of no known robots, one more than these.
    """

    start: int
    features: int
    link: int | None
    slots: tuple[int, ...]
    robots: int

    @classmethod
    def of(cls, env: Any) -> "Layout":
        """Return that of an environment; the docstring of `TeamTask` has the order of its observations."""
        if (start := getattr(env, "mates_at", None)) is not None:
            agents = len(env.groups[0].agents)
            return cls(start, 2, 0, tuple(range(agents)), agents)
        if (known := env.groups[0].layout) is not None:
            agents = len(env.groups[0].agents)
            return cls(known.own, known.others[1], None, tuple(range(agents)), 1 + known.others[0])
        scene, task = env.scene, env.task
        if hasattr(task, "actions"):  # version 3, with wheels
            raise SystemExit(f"--task: attention.py does not read what robots of {env.name} observe")
        slots = np.concatenate([scene.groups[group].slots for group in task.agent_groups(scene)])
        # Advice 5, progress 1, sectors 12, time left and index; then x, y, age and link of each other robot.
        return cls(20, 4, 3, tuple(int(slot) for slot in slots), scene.num_robots)

    def parts(self, obs: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Return what observations say of the agent itself, of its mates as a set, and links between agents.

        Args:
            obs: Observations (..., agents, obs_size).

        Returns:
            Own numbers (..., agents, m), mates (..., agents, robots - 1, features), and whether an agent
            hears another (..., agents, agents).
        """
        others = self.robots - 1
        end = self.start + others * self.features
        own = jnp.concatenate([obs[..., : self.start], obs[..., end:]], -1)
        mates = obs[..., self.start : end].reshape(*obs.shape[:-1], others, self.features)
        # Row of another robot among the others: those behind the agent's own slot are one place further on.
        places = np.array([[max(t - (t > s), 0) for t in self.slots] for s in self.slots])
        alone = np.eye(len(self.slots), dtype=bool)
        if not others or self.link is None:
            return own, mates, jnp.zeros((*obs.shape[:-1], len(self.slots)), bool)
        rows = np.arange(len(self.slots))[:, None]
        linked = mates[..., self.link][..., rows, np.minimum(places, others - 1)] > 0.5
        return own, mates, linked & ~alone


class SetAttention(nn.Module):
    """Attention of a query over a set with a mask; an empty set gives zeros."""

    width: int

    @nn.compact
    def __call__(self, query: jax.Array, members: jax.Array, there: jax.Array) -> jax.Array:
        """Return what was gathered (..., width).

        Args:
            query: Query (..., n).
            members: Members of the set (..., k, m).
            there: Which of them are there (..., k).
        """
        asked = nn.Dense(self.width, name="query")(query)[..., None, :]
        keys, values = nn.Dense(self.width, name="key")(members), nn.Dense(self.width, name="value")(members)
        score = jnp.where(there, (asked * keys).sum(-1) / self.width**0.5, -1e9)
        weight = jax.nn.softmax(score, -1) * there
        return (weight[..., None] * values).sum(-2)


class Talker(nn.Module):
    """Actor and critic of all agents of a world, which send each other messages."""

    hidden: int
    action_size: int
    message: int
    layout: Layout

    @nn.compact
    def __call__(self, obs: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Return means and log deviations (..., agents, action_size), and values (..., agents)."""
        own, mates, linked = self.layout.parts(obs)
        x = nn.tanh(nn.Dense(self.hidden, name="own")(own))
        there = mates[..., 0] > 0.5 if self.layout.link is None else jnp.ones(mates.shape[:-1], bool)
        x = jnp.concatenate([x, SetAttention(self.hidden, name="mates")(x, mates, there)], -1)
        x = nn.tanh(nn.Dense(self.hidden, name="mixed")(x))
        if self.message:
            said = nn.tanh(nn.Dense(self.message, name="message")(x))
            mail = jnp.broadcast_to(said[..., None, :, :], (*linked.shape, self.message))
            heard = SetAttention(self.hidden, name="mailbox")(x, mail, linked)
            x = jnp.concatenate([x, heard], -1)
        actor, critic = (nn.tanh(nn.Dense(self.hidden, name=name)(x)) for name in ("actor", "critic"))
        mean = nn.Dense(self.action_size, kernel_init=nn.initializers.orthogonal(0.01), name="mean")(actor)
        log_std = self.param("log_std", nn.initializers.constant(-0.5), (self.action_size,))
        value = nn.Dense(1, name="value")(critic)[..., 0]
        return mean, jnp.broadcast_to(log_std, mean.shape), value


def make_env(flags: AttentionFlags) -> Any:
    """Return the worlds of a task or a game; where agents choose goals, they send vectors."""
    if not flags.message or flags.task in games.GAMES:
        return shared.make_env(flags)
    from usarmjx.train import make_task

    vectors = {"actions": "goals+message", "message_floats": flags.message}
    return shared.make_env(flags, **(vectors if hasattr(make_task(flags.task), "message_floats") else {}))


def network(team: shared.Team, flags: AttentionFlags) -> Any:
    """Return the network of a team; flax leaves its types open."""
    layout, own = Layout.of(team.env), flags.message
    if layout.link is None:
        if own != team.vector.size:
            raise SystemExit(
                f"--message {own}: agents of {team.env.name} send vectors of {team.vector.size} numbers"
            )
        # The task carries them, not the network.
        own = 0
    return Talker(flags.hidden, team.action_size, own, layout)


def initial_params(team: shared.Team, flags: AttentionFlags) -> Any:
    """Return weights to begin with."""
    return network(team, flags).init(jax.random.key(flags.seed), jnp.zeros((1, team.agents, team.obs_size)))


def train(flags: AttentionFlags, env: Any = None) -> tuple[shared.Learner, list[dict[str, Any]]]:
    """Train, and return the last state and the lines of the iterations."""
    team = shared.Team(env or make_env(flags))
    params = initial_params(team, flags)
    start = shared.start_learner(team, flags, params, shared.clipped_adam(flags))
    # A row is a whole team: the loss of a listener goes back through messages that are made again.
    step = partial(ippo.iterate, team, network(team, flags), flags, 2)
    return shared.run(flags, "attention", start, jax.jit(step), team.agents)


def policy_of(env: Any, flags: AttentionFlags, params: Any) -> Any:
    """Return the policy for `usarmjx`, for a team of any size: the most probable actions."""
    team = shared.Team(env)
    net = network(team, flags)
    return shared.feed_forward_policy(team, lambda seen: team.best(seen, net.apply(params, seen)[0]))


def load(env: Any, folder: str) -> Any:
    """Return the policy of a run's folder, for `usarmjx eval` and `usarmjx suite`."""
    flags = shared.saved_flags(AttentionFlags, folder)
    return policy_of(env, flags, shared.saved_weights(initial_params(shared.Team(env), flags), folder))


if __name__ == "__main__":
    train(shared.parse(AttentionFlags, "set attention with messages"))
