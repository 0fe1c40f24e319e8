"""PQN with value decomposition: Q-learning without replay, the team's value is the sum of its agents'.

Actions are discrete: goals, in tasks whose agents choose one; else `--levels` values for each number of an
action, in all combinations. All agents share a network with layer normalisation.
Targets are lambda-returns of the team's value.

    python examples/marl/pqn_vdn.py --task explore-v2 --total-steps 20000000 --seed 0 --out runs/pqn-vdn-0
    usarmjx eval examples/marl/pqn_vdn.py:load@runs/pqn-vdn-0 --task explore-v2

Gallici et al., "Simplifying deep temporal difference learning" (2024); Sunehag et al., "Value-decomposition
networks" (2018).
"""

import itertools
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import marl_shared as shared
import numpy as np
import optax
from flax import struct


@dataclass(frozen=True, kw_only=True)
class PqnFlags(shared.Flags):
    """Flags of PQN-VDN."""

    levels: int = field(default=3, metadata={"help": "values of each number of an action, from -1 to 1"})
    trace: float = field(default=0.65, metadata={"help": "lambda of the returns"})
    epsilon_start: float = field(default=1.0, metadata={"help": "share of random actions at the start"})
    epsilon_end: float = field(default=0.05, metadata={"help": "share of random actions in the end"})
    epsilon_decay: float = field(default=0.3, metadata={"help": "share of the run in which it falls"})
    num_epochs: int = field(default=4, metadata={"help": "passes of an update through a rollout"})
    num_minibatches: int = field(default=8, metadata={"help": "parts of an epoch"})
    max_grad_norm: float = field(default=10.0, metadata={"help": "norm that longer gradients are cut to"})


class QNetwork(nn.Module):
    """Values of all actions of an agent."""

    hidden: int
    actions: int

    @nn.compact
    def __call__(self, obs: jax.Array) -> jax.Array:
        """Return values (..., actions)."""
        x = obs
        for _ in range(2):
            x = nn.relu(nn.LayerNorm()(nn.Dense(self.hidden)(x)))
        return nn.Dense(self.actions)(x)


class Batch(struct.PyTreeNode, kw_only=True):
    """Transitions of teams (steps, worlds, ...); `best` is the team's best value in the state."""

    obs: jax.Array
    action: jax.Array
    reward: jax.Array
    done: jax.Array
    best: jax.Array


class Learner(shared.Learner, kw_only=True):
    """All that an iteration changes; `iteration` counts them."""

    iteration: jax.Array


def action_table(team: shared.Team, flags: PqnFlags) -> np.ndarray:
    """Return the actions (actions, action_size)."""
    if team.vector.size:
        raise SystemExit("--task: values of choices say nothing of the vectors that agents send here")
    if team.chooses:
        return np.eye(team.action_size, dtype=np.float32)
    return np.array(
        [*itertools.product(np.linspace(-1, 1, flags.levels), repeat=team.action_size)], np.float32
    )


def network(team: shared.Team, flags: PqnFlags) -> Any:
    """Return the network of a team; flax leaves its types open."""
    return QNetwork(flags.hidden, len(action_table(team, flags)))


def initial_params(team: shared.Team, flags: PqnFlags) -> Any:
    """Return weights to begin with."""
    return network(team, flags).init(jax.random.key(flags.seed), jnp.zeros((1, team.obs_size)))


def iterations(team: shared.Team, flags: PqnFlags) -> int:
    """Return the number of iterations."""
    return -(-flags.total_steps // (flags.rollout_length * flags.num_worlds * team.agents))


def best_of(team: shared.Team, net: Any, params: Any, obs: tuple[jax.Array, ...]) -> jax.Array:
    """Return the team's best value (worlds,)."""
    seen = team.merge(obs)
    return team.allowed(seen, net.apply(params, seen)).max(-1).sum(-1)


def collect(
    team: shared.Team, flags: PqnFlags, learner: Learner
) -> tuple[Learner, Batch, jax.Array, dict[str, jax.Array]]:
    """Act for a rollout; return its transitions, the best values after it, and sums of episodes."""
    net, table = network(team, flags), jnp.asarray(action_table(team, flags))
    falling = jnp.minimum(learner.iteration / (flags.epsilon_decay * iterations(team, flags) + 1e-9), 1.0)
    epsilon = flags.epsilon_start + falling * (flags.epsilon_end - flags.epsilon_start)

    def step(carry: tuple[Any, jax.Array], _: None) -> tuple[Any, Any]:
        state, key = carry
        key, one, other = jax.random.split(key, 3)
        obs = team.merge(state.obs)
        value = team.allowed(obs, net.apply(learner.params, obs))
        drawn = jax.random.categorical(one, team.allowed(obs, jnp.zeros_like(value)))
        explores = jax.random.uniform(other, drawn.shape) < epsilon
        action = jnp.where(explores, drawn, value.argmax(-1))
        after = team.env.step(state, team.split(table[action]))
        # An episode that the time limit cuts off would have gone on: its last state has a value.
        cut = best_of(team, net, learner.params, after.final_obs)
        reward = flags.reward_scale * team.reward(after).sum(-1) + flags.gamma * cut * after.truncated
        row = Batch(obs=obs, action=action, reward=reward, done=after.done, best=value.max(-1).sum(-1))
        return (after, key), (row, shared.episode_sums(after))

    (state, key), (batch, sums) = jax.lax.scan(step, (learner.state, learner.key), None, flags.rollout_length)
    last = best_of(team, net, learner.params, state.obs)
    return learner.replace(state=state, key=key), batch, last, jax.tree.map(jnp.sum, sums)


def lambda_returns(batch: Batch, last: jax.Array, gamma: float, trace: float) -> jax.Array:
    """Return targets of the team's value (steps, worlds): Peng's Q(lambda)."""

    def back(carry: tuple[jax.Array, jax.Array], now: tuple[jax.Array, ...]) -> tuple[Any, jax.Array]:
        target, best = carry
        reward, done, own = now
        target = reward + gamma * (1 - done) * (trace * target + (1 - trace) * best)
        return (target, own), target

    rows = batch.reward, batch.done.astype(jnp.float32), batch.best
    return jax.lax.scan(back, (last, last), rows, reverse=True)[1]


def loss(params: Any, team: shared.Team, flags: PqnFlags, rows: tuple[Batch, jax.Array]) -> jax.Array:
    """Return the squared error of the team's value ()."""
    batch, target = rows
    value = network(team, flags).apply(params, batch.obs)
    own = jnp.take_along_axis(value, batch.action[..., None], -1)[..., 0]
    return 0.5 * jnp.square(own.sum(-1) - target).mean()


def optimiser(flags: PqnFlags) -> optax.GradientTransformation:
    """Return rectified Adam with clipped gradients."""
    return optax.chain(optax.clip_by_global_norm(flags.max_grad_norm), optax.radam(flags.learning_rate))


def iterate(team: shared.Team, flags: PqnFlags, learner: Learner) -> tuple[Learner, dict[str, jax.Array]]:
    """Act for a rollout and learn from it."""
    learner, batch, last, sums = collect(team, flags, learner)
    target = lambda_returns(batch, last, flags.gamma, flags.trace)
    rows = jax.tree.map(lambda one: one.reshape(-1, *one.shape[2:]), (batch, target))

    def minibatch_loss(params: Any, chosen: jax.Array) -> jax.Array:
        return loss(params, team, flags, jax.tree.map(lambda one: one[chosen], rows))

    learner, total = shared.update_in_minibatches(
        learner,
        optimiser(flags),
        minibatch_loss,
        rows[1].shape[0],
        num_epochs=flags.num_epochs,
        num_minibatches=flags.num_minibatches,
    )
    return learner.replace(iteration=learner.iteration + 1), {**sums, "total": total}


def train(flags: PqnFlags, env: Any = None) -> tuple[Learner, list[dict[str, Any]]]:
    """Train, and return the last state and the lines of the iterations."""
    team = shared.Team(env or shared.make_env(flags))
    params = initial_params(team, flags)
    usual = shared.start_learner(team, flags, params, optimiser(flags))
    start = Learner(**vars(usual), iteration=jnp.int32(0))
    return shared.run(flags, "pqn-vdn", start, jax.jit(partial(iterate, team, flags)), team.agents)


def policy_of(env: Any, flags: PqnFlags, params: Any) -> Any:
    """Return the policy for `usarmjx`: the best actions."""
    team = shared.Team(env)
    net, table = network(team, flags), jnp.asarray(action_table(team, flags))

    def act(seen: jax.Array) -> jax.Array:
        return table[team.allowed(seen, net.apply(params, seen)).argmax(-1)]

    return shared.feed_forward_policy(team, act)


def load(env: Any, folder: str) -> Any:
    """Return the policy of a run's folder, for `usarmjx eval` and `usarmjx suite`."""
    flags = shared.saved_flags(PqnFlags, folder)
    return policy_of(env, flags, shared.saved_weights(initial_params(shared.Team(env), flags), folder))


if __name__ == "__main__":
    train(shared.parse(PqnFlags, "PQN-VDN"))
