"""IPPO: independent PPO with shared parameters; each agent's critic sees what the agent sees.

    python examples/marl/ippo.py --task explore-v2 --total-steps 20000000 --seed 0 --out runs/ippo-0
    usarmjx eval examples/marl/ippo.py:load@runs/ippo-0 --task explore-v2

De Witt et al., "Is independent learning all you need in the StarCraft multi-agent challenge?" (2020).
"""

from dataclasses import dataclass
from functools import partial
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import marl_shared as shared


@dataclass(frozen=True, kw_only=True)
class IppoFlags(shared.PpoFlags):
    """Flags of IPPO."""


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


def network(team: shared.Team, flags: IppoFlags) -> Any:
    """Return the network of a team; flax leaves its types open."""
    return ActorCritic(flags.hidden, team.action_size)


def initial_params(team: shared.Team, flags: IppoFlags) -> Any:
    """Return weights to begin with."""
    return network(team, flags).init(jax.random.key(flags.seed), jnp.zeros((1, team.obs_size)))


def collect(
    team: shared.Team, net: Any, flags: shared.PpoFlags, learner: shared.Learner
) -> tuple[shared.Learner, shared.Batch, jax.Array, dict[str, jax.Array]]:
    """Act for a rollout; return its transitions, the values after it, and sums of episodes."""

    def step(carry: tuple[Any, jax.Array], _: None) -> tuple[Any, Any]:
        state, key = carry
        key, own = jax.random.split(key)
        obs = team.merge(state.obs)
        mean, log_std, value = net.apply(learner.params, obs)
        action = team.draw(own, obs, mean, log_std)
        after = team.env.step(state, team.split(action))
        # An episode that the time limit cuts off would have gone on: its last state has a value.
        cut = net.apply(learner.params, team.merge(after.final_obs))[-1]
        reward = flags.reward_scale * team.reward(after) + flags.gamma * cut * after.truncated[:, None]
        done = jnp.broadcast_to(after.done[:, None], reward.shape)
        row = shared.Batch(
            obs=obs,
            action=action,
            log_prob=team.log_probability(obs, mean, log_std, action),
            value=value,
            reward=reward,
            done=done,
        )
        return (after, key), (row, shared.episode_sums(after))

    (state, key), (batch, sums) = jax.lax.scan(step, (learner.state, learner.key), None, flags.rollout_length)
    *_, last = net.apply(learner.params, team.merge(state.obs))
    return learner.replace(state=state, key=key), batch, last, jax.tree.map(jnp.sum, sums)


def loss(
    params: Any,
    team: shared.Team,
    net: Any,
    flags: shared.PpoFlags,
    rows: tuple[shared.Batch, jax.Array, jax.Array],
) -> jax.Array:
    """Return PPO's loss ()."""
    batch, advantage, target = rows
    mean, log_std, value = net.apply(params, batch.obs)
    ratio = jnp.exp(team.log_probability(batch.obs, mean, log_std, batch.action) - batch.log_prob)
    policy = shared.clipped_loss(ratio, shared.whitened(advantage), flags.clip_epsilon)
    critic = jnp.square(value - target).mean()
    return policy + flags.value_coef * critic - flags.entropy_coef * team.entropy(batch.obs, mean, log_std)


def iterate(
    team: shared.Team, net: Any, flags: shared.PpoFlags, row_axes: int, learner: shared.Learner
) -> tuple[shared.Learner, dict[str, jax.Array]]:
    """Act for a rollout and learn from it.

    Args:
        team: The team.
        net: Network: observations to means, log deviations and values.
        flags: The flags.
        row_axes: 3: a row of a minibatch is an agent; 2: a whole team.
        learner: The learner before it.
    """
    learner, batch, last, sums = collect(team, net, flags, learner)
    advantage, target = shared.generalised_advantages(
        batch.reward, batch.value, last, batch.done, flags.gamma, flags.gae_lambda
    )
    rows = jax.tree.map(lambda one: one.reshape(-1, *one.shape[row_axes:]), (batch, advantage, target))

    def minibatch_loss(params: Any, chosen: jax.Array) -> jax.Array:
        return loss(params, team, net, flags, jax.tree.map(lambda one: one[chosen], rows))

    learner, total = shared.update_in_minibatches(
        learner,
        shared.clipped_adam(flags),
        minibatch_loss,
        rows[1].shape[0],
        num_epochs=flags.num_epochs,
        num_minibatches=flags.num_minibatches,
    )
    return learner, {**sums, "total": total}


def train(flags: IppoFlags, env: Any = None) -> tuple[shared.Learner, list[dict[str, Any]]]:
    """Train, and return the last state and the lines of the iterations."""
    team = shared.Team(env or shared.make_env(flags))
    params = initial_params(team, flags)
    start = shared.start_learner(team, flags, params, shared.clipped_adam(flags))
    return shared.run(
        flags, "ippo", start, jax.jit(partial(iterate, team, network(team, flags), flags, 3)), team.agents
    )


def policy_of(env: Any, flags: IppoFlags, params: Any) -> Any:
    """Return the policy for `usarmjx`: the most probable actions."""
    team = shared.Team(env)
    net = network(team, flags)
    return shared.feed_forward_policy(team, lambda seen: team.best(seen, net.apply(params, seen)[0]))


def load(env: Any, folder: str) -> Any:
    """Return the policy of a run's folder, for `usarmjx eval` and `usarmjx suite`."""
    flags = shared.saved_flags(IppoFlags, folder)
    return policy_of(env, flags, shared.saved_weights(initial_params(shared.Team(env), flags), folder))


if __name__ == "__main__":
    train(shared.parse(IppoFlags, "IPPO"))
