"""MAPPO: PPO with shared parameters and a critic that knows more than the agents do.

The critic sees the environment's privileged numbers, which are true (poses, what is explored, time), what all
agents see, and which agent it values. The actors see what agents see, so the policy needs no critic when it
is played.

    python examples/marl/mappo.py --task explore-v2 --total-steps 20000000 --seed 0 --out runs/mappo-0
    usarmjx eval examples/marl/mappo.py:load@runs/mappo-0 --task explore-v2

Yu et al., "The surprising effectiveness of PPO in cooperative multi-agent games" (NeurIPS 2022).
"""

from dataclasses import dataclass
from functools import partial
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import marl_shared as shared


@dataclass(frozen=True, kw_only=True)
class MappoFlags(shared.PpoFlags):
    """Flags of MAPPO."""


def hidden_layers(x: jax.Array, width: int) -> jax.Array:
    """Return what two hidden layers make of inputs (..., width); called within a module."""
    for _ in range(2):
        x = nn.tanh(nn.Dense(width, kernel_init=nn.initializers.orthogonal(2**0.5))(x))
    return x


class Actor(nn.Module):
    """Mean and log deviation of an agent's action."""

    hidden: int
    action_size: int

    @nn.compact
    def __call__(self, obs: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return means and log deviations (..., action_size)."""
        x = hidden_layers(obs, self.hidden)
        mean = nn.Dense(self.action_size, kernel_init=nn.initializers.orthogonal(0.01))(x)
        log_std = self.param("log_std", nn.initializers.constant(-0.5), (self.action_size,))
        return mean, jnp.broadcast_to(log_std, mean.shape)


class CentralCritic(nn.Module):
    """Value of an agent, from the true state."""

    hidden: int

    @nn.compact
    def __call__(self, truth: jax.Array) -> jax.Array:
        """Return values (...)."""
        return nn.Dense(1)(hidden_layers(truth, self.hidden))[..., 0]


class Batch(shared.Batch, kw_only=True):
    """Transitions, and what the critic sees (steps, worlds, agents, n)."""

    truth: jax.Array


def truth_of(team: shared.Team, obs: tuple[jax.Array, ...], privileged: jax.Array) -> jax.Array:
    """Return what the critic sees (worlds, agents, n): true state, all observations, whose value it is."""
    seen = team.merge(obs)
    worlds, agents, _ = seen.shape
    whole = jnp.concatenate([privileged, seen.reshape(worlds, -1)], -1)
    whole = jnp.broadcast_to(whole[:, None], (worlds, agents, whole.shape[-1]))
    which = jnp.broadcast_to(jnp.eye(agents), (worlds, agents, agents))
    return jnp.concatenate([whole, which], -1)


def networks(team: shared.Team, flags: MappoFlags) -> tuple[Any, Any]:
    """Return the networks of a team; flax leaves their types open."""
    return Actor(flags.hidden, team.action_size), CentralCritic(flags.hidden)


def initial_params(team: shared.Team, flags: MappoFlags) -> dict[str, Any]:
    """Return weights to begin with."""
    actor, critic = networks(team, flags)
    one, other = jax.random.split(jax.random.key(flags.seed))
    truth = team.env.privileged_size + team.agents * (team.obs_size + 1)
    return {
        "actor": actor.init(one, jnp.zeros((1, team.obs_size))),
        "critic": critic.init(other, jnp.zeros((1, truth))),
    }


def collect(
    team: shared.Team, flags: MappoFlags, learner: shared.Learner
) -> tuple[shared.Learner, Batch, jax.Array, dict[str, jax.Array]]:
    """Act for a rollout; return its transitions, the values after it, and sums of episodes."""
    actor, critic = networks(team, flags)

    def step(carry: tuple[Any, jax.Array], _: None) -> tuple[Any, Any]:
        state, key = carry
        key, own = jax.random.split(key)
        obs, truth = team.merge(state.obs), truth_of(team, state.obs, state.privileged)
        mean, log_std = actor.apply(learner.params["actor"], obs)
        action = team.draw(own, obs, mean, log_std)
        after = team.env.step(state, team.split(action))
        # An episode that the time limit cuts off would have gone on: its last state has a value.
        final = truth_of(team, after.final_obs, after.final_privileged)
        cut = critic.apply(learner.params["critic"], final) * after.truncated[:, None]
        reward = flags.reward_scale * team.reward(after) + flags.gamma * cut
        row = Batch(
            obs=obs,
            truth=truth,
            action=action,
            log_prob=team.log_probability(obs, mean, log_std, action),
            value=critic.apply(learner.params["critic"], truth),
            reward=reward,
            done=jnp.broadcast_to(after.done[:, None], reward.shape),
        )
        return (after, key), (row, shared.episode_sums(after))

    (state, key), (batch, sums) = jax.lax.scan(step, (learner.state, learner.key), None, flags.rollout_length)
    last = critic.apply(learner.params["critic"], truth_of(team, state.obs, state.privileged))
    return learner.replace(state=state, key=key), batch, last, jax.tree.map(jnp.sum, sums)


def loss(
    params: Any, team: shared.Team, flags: MappoFlags, rows: tuple[Batch, jax.Array, jax.Array]
) -> jax.Array:
    """Return PPO's loss ()."""
    (actor, critic), (batch, advantage, target) = networks(team, flags), rows
    mean, log_std = actor.apply(params["actor"], batch.obs)
    ratio = jnp.exp(team.log_probability(batch.obs, mean, log_std, batch.action) - batch.log_prob)
    policy = shared.clipped_loss(ratio, shared.whitened(advantage), flags.clip_epsilon)
    error = jnp.square(critic.apply(params["critic"], batch.truth) - target).mean()
    return policy + flags.value_coef * error - flags.entropy_coef * team.entropy(batch.obs, mean, log_std)


def iterate(
    team: shared.Team, flags: MappoFlags, learner: shared.Learner
) -> tuple[shared.Learner, dict[str, jax.Array]]:
    """Act for a rollout and learn from it."""
    learner, batch, last, sums = collect(team, flags, learner)
    advantage, target = shared.generalised_advantages(
        batch.reward, batch.value, last, batch.done, flags.gamma, flags.gae_lambda
    )
    rows = jax.tree.map(lambda one: one.reshape(-1, *one.shape[3:]), (batch, advantage, target))

    def minibatch_loss(params: Any, chosen: jax.Array) -> jax.Array:
        return loss(params, team, flags, jax.tree.map(lambda one: one[chosen], rows))

    learner, total = shared.update_in_minibatches(
        learner,
        shared.clipped_adam(flags),
        minibatch_loss,
        rows[1].shape[0],
        num_epochs=flags.num_epochs,
        num_minibatches=flags.num_minibatches,
    )
    return learner, {**sums, "total": total}


def train(flags: MappoFlags, env: Any = None) -> tuple[shared.Learner, list[dict[str, Any]]]:
    """Train, and return the last state and the lines of the iterations."""
    team = shared.Team(env or shared.make_env(flags))
    params = initial_params(team, flags)
    start = shared.start_learner(team, flags, params, shared.clipped_adam(flags))
    return shared.run(flags, "mappo", start, jax.jit(partial(iterate, team, flags)), team.agents)


def policy_of(env: Any, flags: MappoFlags, params: Any) -> Any:
    """Return the policy for `usarmjx`: the most probable actions."""
    team = shared.Team(env)
    actor, _ = networks(team, flags)

    def act(seen: jax.Array) -> jax.Array:
        return team.best(seen, actor.apply(params["actor"], seen)[0])

    return shared.feed_forward_policy(team, act)


def load(env: Any, folder: str) -> Any:
    """Return the policy of a run's folder, for `usarmjx eval` and `usarmjx suite`."""
    flags = shared.saved_flags(MappoFlags, folder)
    return policy_of(env, flags, shared.saved_weights(initial_params(shared.Team(env), flags), folder))


if __name__ == "__main__":
    train(shared.parse(MappoFlags, "MAPPO"))
