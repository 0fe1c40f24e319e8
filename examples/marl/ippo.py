"""IPPO: independent PPO with shared parameters; each agent's critic sees what the agent sees.

    python examples/marl/ippo.py --task explore-v2 --total-steps 20000000 --seed 0 --out runs/ippo-0
    usarmjx eval examples/marl/ippo.py:load@runs/ippo-0 --task explore-v2

De Witt et al., "Is independent learning all you need in the StarCraft multi-agent challenge?" (2020).
"""

from dataclasses import dataclass, field
from functools import partial
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import marl_shared as shared
import optax
from flax import struct


@dataclass(frozen=True, kw_only=True)
class IppoFlags(shared.Flags):
    """Flags of IPPO."""

    gae_lambda: float = field(default=0.95, metadata={"help": "lambda of the advantages"})
    num_epochs: int = field(default=4, metadata={"help": "passes of an update through a rollout"})
    num_minibatches: int = field(default=4, metadata={"help": "parts of an epoch"})
    clip_epsilon: float = field(default=0.2, metadata={"help": "clip of the ratio of probabilities"})
    entropy_coef: float = field(default=0.0, metadata={"help": "weight of the entropy"})
    value_coef: float = field(default=0.5, metadata={"help": "weight of the critic's loss"})
    max_grad_norm: float = field(default=0.5, metadata={"help": "norm that longer gradients are cut to"})


class Mlp(nn.Module):
    """Two hidden layers."""

    hidden: int
    outputs: int
    scale: float

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        """Return the outputs (..., outputs)."""
        for _ in range(2):
            x = nn.tanh(nn.Dense(self.hidden, kernel_init=nn.initializers.orthogonal(2**0.5))(x))
        return nn.Dense(self.outputs, kernel_init=nn.initializers.orthogonal(self.scale))(x)


class ActorCritic(nn.Module):
    """Mean of the actions, their log deviation, and the value."""

    hidden: int
    action_size: int

    @nn.compact
    def __call__(self, obs: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Return means and log deviations (..., action_size), and values (...)."""
        mean = Mlp(self.hidden, self.action_size, 0.01)(obs)
        log_std = self.param("log_std", nn.initializers.constant(-0.5), (self.action_size,))
        value = Mlp(self.hidden, 1, 1.0)(obs)[..., 0]
        return mean, jnp.broadcast_to(log_std, mean.shape), value


class Batch(struct.PyTreeNode, kw_only=True):
    """Transitions (steps, worlds, agents, ...); in an update (rows, ...)."""

    obs: jax.Array
    action: jax.Array
    log_prob: jax.Array
    value: jax.Array
    reward: jax.Array
    done: jax.Array


class Learner(struct.PyTreeNode, kw_only=True):
    """All that an iteration changes."""

    params: Any
    optimiser: Any
    state: Any
    key: jax.Array


def network(team: shared.Team, flags: IppoFlags) -> Any:
    """Return the network of a team; flax leaves its types open."""
    return ActorCritic(flags.hidden, team.action_size)


def initial_params(team: shared.Team, flags: IppoFlags) -> Any:
    """Return weights to begin with."""
    return network(team, flags).init(jax.random.key(flags.seed), jnp.zeros((1, team.obs_size)))


def collect(
    team: shared.Team, flags: IppoFlags, learner: Learner
) -> tuple[Learner, Batch, jax.Array, dict[str, jax.Array]]:
    """Act for a rollout; return its transitions, the values after it, and sums of episodes."""
    net = network(team, flags)

    def step(carry: tuple[Any, jax.Array], _: None) -> tuple[Any, Any]:
        state, key = carry
        key, own = jax.random.split(key)
        obs = team.merge(state.obs)
        mean, log_std, value = net.apply(learner.params, obs)
        action = mean + jnp.exp(log_std) * jax.random.normal(own, mean.shape)
        after = team.env.step(state, team.split(action))
        # An episode that the time limit cuts off would have gone on: its last state has a value.
        cut = net.apply(learner.params, team.merge(after.final_obs))[-1]
        reward = flags.reward_scale * team.reward(after) + flags.gamma * cut * after.truncated[:, None]
        done = jnp.broadcast_to(after.done[:, None], reward.shape)
        row = Batch(
            obs=obs,
            action=action,
            log_prob=shared.log_probability(mean, log_std, action),
            value=value,
            reward=reward,
            done=done,
        )
        return (after, key), (row, shared.episode_sums(after))

    (state, key), (batch, sums) = jax.lax.scan(step, (learner.state, learner.key), None, flags.rollout_length)
    *_, last = net.apply(learner.params, team.merge(state.obs))
    return learner.replace(state=state, key=key), batch, last, jax.tree.map(jnp.sum, sums)


def loss(
    params: Any, team: shared.Team, flags: IppoFlags, rows: tuple[Batch, jax.Array, jax.Array]
) -> jax.Array:
    """Return PPO's loss ()."""
    batch, advantage, target = rows
    mean, log_std, value = network(team, flags).apply(params, batch.obs)
    ratio = jnp.exp(shared.log_probability(mean, log_std, batch.action) - batch.log_prob)
    policy = shared.clipped_loss(ratio, shared.whitened(advantage), flags.clip_epsilon)
    critic = jnp.square(value - target).mean()
    return policy + flags.value_coef * critic - flags.entropy_coef * log_std.sum(-1).mean()


def optimiser(flags: IppoFlags) -> optax.GradientTransformation:
    """Return Adam with clipped gradients."""
    return optax.chain(
        optax.clip_by_global_norm(flags.max_grad_norm), optax.adam(flags.learning_rate, eps=1e-5)
    )


def iterate(team: shared.Team, flags: IppoFlags, learner: Learner) -> tuple[Learner, dict[str, jax.Array]]:
    """Act for a rollout and learn from it."""
    learner, batch, last, sums = collect(team, flags, learner)
    advantage, target = shared.generalised_advantages(
        batch.reward, batch.value, last, batch.done, flags.gamma, flags.gae_lambda
    )
    rows = jax.tree.map(lambda one: one.reshape(-1, *one.shape[3:]), (batch, advantage, target))
    count = rows[1].shape[0]

    def minibatch(carry: tuple[Any, Any], chosen: jax.Array) -> tuple[Any, jax.Array]:
        params, state = carry
        part = jax.tree.map(lambda one: one[chosen], rows)
        value, gradient = jax.value_and_grad(loss)(params, team, flags, part)
        change, state = optimiser(flags).update(gradient, state, params)
        return (optax.apply_updates(params, change), state), value

    def epoch(carry: tuple[Any, Any], key: jax.Array) -> tuple[Any, jax.Array]:
        parts = jax.random.permutation(key, count).reshape(flags.num_minibatches, -1)
        return jax.lax.scan(minibatch, carry, parts)

    key, own = jax.random.split(learner.key)
    keys = jax.random.split(own, flags.num_epochs)
    (params, state), losses = jax.lax.scan(epoch, (learner.params, learner.optimiser), keys)
    return learner.replace(params=params, optimiser=state, key=key), {**sums, "total": losses.mean()}


def train(flags: IppoFlags, env: Any = None) -> tuple[Learner, list[dict[str, Any]]]:
    """Train, and return the last state and the lines of the iterations."""
    team = shared.Team(env or shared.make_env(flags))
    params, key = initial_params(team, flags), jax.random.key(flags.seed + 1)
    start = Learner(
        params=params, optimiser=optimiser(flags).init(params), state=team.start(flags.seed), key=key
    )
    return shared.run(flags, "ippo", start, jax.jit(partial(iterate, team, flags)), team.agents)


def policy_of(env: Any, flags: IppoFlags, params: Any) -> Any:
    """Return the policy for `usarmjx`: the most probable actions."""
    from usarmjx.train import Policy

    team = shared.Team(env)

    def act(carry: Any, obs: tuple[jax.Array, ...], key: jax.Array) -> tuple[Any, tuple[jax.Array, ...]]:
        del key
        mean, *_ = network(team, flags).apply(params, team.merge(obs))
        return carry, team.split(jnp.clip(mean, -1.0, 1.0))

    return Policy(lambda worlds: jnp.zeros((worlds, 1)), act)


def load(env: Any, folder: str) -> Any:
    """Return the policy of a run's folder, for `usarmjx eval` and `usarmjx suite`."""
    flags = shared.saved_flags(IppoFlags, folder)
    return policy_of(env, flags, shared.saved_weights(initial_params(shared.Team(env), flags), folder))


if __name__ == "__main__":
    train(shared.parse(IppoFlags, "IPPO"))
