"""Recurrent IPPO: a GRU between the layers, trained through the steps of a rollout.

python examples/marl/ippo_rnn.py --task explore-v2 --total-steps 20000000 --seed 0 --out runs/ippo-rnn-0
usarmjx eval examples/marl/ippo_rnn.py:load@runs/ippo-rnn-0 --task explore-v2
"""

from dataclasses import dataclass
from functools import partial
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import marl_shared as shared


@dataclass(frozen=True, kw_only=True)
class RecurrentFlags(shared.PpoFlags):
    """Flags of recurrent IPPO."""


class Step(nn.Module):
    """A step of actor and critic, which share a GRU."""

    hidden: int
    action_size: int

    @nn.compact
    def __call__(self, memory: jax.Array, now: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, Any]:
        """Return the memory (..., hidden), and mean, log deviation and value.

        Args:
            memory: Memory before the step (..., hidden).
            now: Observations (..., obs_size), and whether an episode begins (...).
        """
        obs, first = now
        memory = jnp.where(first[..., None], 0.0, memory)
        x = nn.tanh(nn.Dense(self.hidden, kernel_init=nn.initializers.orthogonal(2**0.5))(obs))
        memory, x = nn.GRUCell(self.hidden)(memory, x)
        actor, critic = (
            nn.tanh(nn.Dense(self.hidden, kernel_init=nn.initializers.orthogonal(2**0.5))(x))
            for _ in range(2)
        )
        mean = nn.Dense(self.action_size, kernel_init=nn.initializers.orthogonal(0.01))(actor)
        log_std = self.param("log_std", nn.initializers.constant(-0.5), (self.action_size,))
        value = nn.Dense(1, kernel_init=nn.initializers.orthogonal(1.0))(critic)[..., 0]
        return memory, (mean, jnp.broadcast_to(log_std, mean.shape), value)


class Batch(shared.Batch, kw_only=True):
    """Transitions; `first` says whether an episode began with the step (steps, worlds, agents)."""

    first: jax.Array


class Learner(shared.Learner, kw_only=True):
    """All that an iteration changes; `memory` and `first` are those of the next step."""

    memory: jax.Array
    first: jax.Array


def network(team: shared.Team, flags: RecurrentFlags) -> Any:
    """Return the network of a team; flax leaves its types open."""
    return Step(flags.hidden, team.action_size)


def initial_params(team: shared.Team, flags: RecurrentFlags) -> Any:
    """Return weights to begin with."""
    now = jnp.zeros((1, team.obs_size)), jnp.zeros(1, bool)
    return network(team, flags).init(jax.random.key(flags.seed), jnp.zeros((1, flags.hidden)), now)


def collect(
    team: shared.Team, flags: RecurrentFlags, learner: Learner
) -> tuple[Learner, Batch, jax.Array, dict[str, jax.Array]]:
    """Act for a rollout; return its transitions, the values after it, and sums of episodes."""
    net = network(team, flags)

    def step(carry: tuple[Any, ...], _: None) -> tuple[Any, Any]:
        state, memory, first, key = carry
        key, own = jax.random.split(key)
        obs = team.merge(state.obs)
        memory, (mean, log_std, value) = net.apply(learner.params, memory, (obs, first))
        action = team.draw(own, obs, mean, log_std)
        after = team.env.step(state, team.split(action))
        # An episode that the time limit cuts off would have gone on: its last state has a value.
        final = team.merge(after.final_obs), jnp.zeros_like(first)
        cut = net.apply(learner.params, memory, final)[1][-1]
        reward = flags.reward_scale * team.reward(after) + flags.gamma * cut * after.truncated[:, None]
        done = jnp.broadcast_to(after.done[:, None], reward.shape)
        row = Batch(
            obs=obs,
            action=action,
            log_prob=team.log_probability(obs, mean, log_std, action),
            value=value,
            reward=reward,
            done=done,
            first=first,
        )
        return (after, memory, done, key), (row, shared.episode_sums(after))

    start = learner.state, learner.memory, learner.first, learner.key
    (state, memory, first, key), (batch, sums) = jax.lax.scan(step, start, None, flags.rollout_length)
    _, (*_, last) = net.apply(learner.params, memory, (team.merge(state.obs), first))
    after = learner.replace(state=state, memory=memory, first=first, key=key)
    return after, batch, last, jax.tree.map(jnp.sum, sums)


Rows = tuple[Batch, jax.Array, jax.Array, jax.Array]
"""Transitions, advantages, targets (steps, worlds, agents), and memory before (worlds, agents, hidden)."""


def loss(params: Any, team: shared.Team, flags: RecurrentFlags, rows: Rows) -> jax.Array:
    """Return PPO's loss (), the network run through all steps again."""
    batch, advantage, target, memory = rows
    net = network(team, flags)

    def step(memory: jax.Array, now: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, Any]:
        return net.apply(params, memory, now)

    _, (mean, log_std, value) = jax.lax.scan(step, memory, (batch.obs, batch.first))
    ratio = jnp.exp(team.log_probability(batch.obs, mean, log_std, batch.action) - batch.log_prob)
    policy = shared.clipped_loss(ratio, shared.whitened(advantage), flags.clip_epsilon)
    critic = jnp.square(value - target).mean()
    return policy + flags.value_coef * critic - flags.entropy_coef * team.entropy(batch.obs, mean, log_std)


def iterate(
    team: shared.Team, flags: RecurrentFlags, learner: Learner
) -> tuple[Learner, dict[str, jax.Array]]:
    """Act for a rollout and learn from it; minibatches are whole sequences of some worlds."""
    memory = learner.memory
    learner, batch, last, sums = collect(team, flags, learner)
    advantage, target = shared.generalised_advantages(
        batch.reward, batch.value, last, batch.done, flags.gamma, flags.gae_lambda
    )

    def minibatch_loss(params: Any, chosen: jax.Array) -> jax.Array:
        part = jax.tree.map(lambda one: one[:, chosen], (batch, advantage, target))
        return loss(params, team, flags, (*part, memory[chosen]))

    learner, total = shared.update_in_minibatches(
        learner,
        shared.clipped_adam(flags),
        minibatch_loss,
        flags.num_worlds,
        num_epochs=flags.num_epochs,
        num_minibatches=flags.num_minibatches,
    )
    return learner, {**sums, "total": total}


def train(flags: RecurrentFlags, env: Any = None) -> tuple[Learner, list[dict[str, Any]]]:
    """Train, and return the last state and the lines of the iterations."""
    team = shared.Team(env or shared.make_env(flags))
    params, shape = initial_params(team, flags), (flags.num_worlds, team.agents)
    usual = shared.start_learner(team, flags, params, shared.clipped_adam(flags))
    start = Learner(**vars(usual), memory=jnp.zeros((*shape, flags.hidden)), first=jnp.ones(shape, bool))
    return shared.run(flags, "ippo-rnn", start, jax.jit(partial(iterate, team, flags)), team.agents)


def policy_of(env: Any, flags: RecurrentFlags, params: Any) -> Any:
    """Return the policy for `usarmjx`: the most probable actions. Its memory is reset with each episode."""
    from usarmjx.train import Policy

    team = shared.Team(env)
    net = network(team, flags)

    def act(carry: Any, obs: tuple[jax.Array, ...], key: jax.Array) -> tuple[Any, tuple[jax.Array, ...]]:
        del key
        first = jnp.zeros(carry.shape[:2], bool)
        seen = team.merge(obs)
        carry, (mean, *_) = net.apply(params, carry, (seen, first))
        return carry, team.split(jnp.clip(team.best(seen, mean), -1.0, 1.0))

    return Policy(lambda worlds: jnp.zeros((worlds, team.agents, flags.hidden)), act)


def load(env: Any, folder: str) -> Any:
    """Return the policy of a run's folder, for `usarmjx eval` and `usarmjx suite`."""
    flags = shared.saved_flags(RecurrentFlags, folder)
    return policy_of(env, flags, shared.saved_weights(initial_params(shared.Team(env), flags), folder))


if __name__ == "__main__":
    train(shared.parse(RecurrentFlags, "recurrent IPPO"))
