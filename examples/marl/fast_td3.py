"""FastTD3 for teams: off-policy, many worlds, large batches, one actor, two critics that see the true state.

Worlds explore with noise of different strength. Critics see an agent's observation and action and the
environment's privileged numbers; targets are smoothed and take the lower critic. The replay buffer is on the
device.

    python examples/marl/fast_td3.py --task explore-v2 --total-steps 20000000 --seed 0 --out runs/fast-td3-0
    usarmjx eval examples/marl/fast_td3.py:load@runs/fast-td3-0 --task explore-v2

Seo et al., "FastTD3" (2025), without its distributional critic; Fujimoto et al., "Addressing function
approximation error in actor-critic methods" (2018).
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
class Td3Flags(shared.Flags):
    """Flags of FastTD3; the rollout's length is the number of actions between two updates of all worlds."""

    rollout_length: int = field(default=8, metadata={"help": "actions between two series of updates"})
    buffer_steps: int = field(default=256, metadata={"help": "actions of every world that are kept"})
    batch_size: int = field(default=8192, metadata={"help": "transitions of agents in a batch"})
    num_updates: int = field(default=16, metadata={"help": "updates of the critics after a rollout"})
    policy_delay: int = field(default=2, metadata={"help": "updates of the critics for one of the actor"})
    tau: float = field(
        default=0.05, metadata={"help": "share of the new weights in the targets' at an update"}
    )
    noise_low: float = field(default=0.05, metadata={"help": "deviation of actions in the calmest world"})
    noise_high: float = field(default=0.6, metadata={"help": "deviation of actions in the wildest world"})
    smoothing: float = field(default=0.1, metadata={"help": "deviation of the targets' actions"})


class Actor(nn.Module):
    """Action of an agent."""

    hidden: int
    action_size: int

    @nn.compact
    def __call__(self, obs: jax.Array) -> jax.Array:
        """Return actions from -1 to 1 (..., action_size)."""
        x = obs
        for _ in range(2):
            x = nn.relu(nn.LayerNorm()(nn.Dense(self.hidden)(x)))
        return nn.tanh(nn.Dense(self.action_size, kernel_init=nn.initializers.normal(0.01))(x))


class TwinCritic(nn.Module):
    """Two values of an agent's action."""

    hidden: int

    @nn.compact
    def __call__(self, obs: jax.Array, truth: jax.Array, action: jax.Array) -> jax.Array:
        """Return values (2, ...)."""
        whole, found = jnp.concatenate([obs, truth, action], -1), list[jax.Array]()
        for _ in range(2):
            x = whole
            for _ in range(2):
                x = nn.relu(nn.LayerNorm()(nn.Dense(self.hidden)(x)))
            found.append(nn.Dense(1)(x)[..., 0])
        return jnp.stack(found)


class Replay(struct.PyTreeNode, kw_only=True):
    """Transitions (buffer steps, worlds, ...), the oldest overwritten first.

    Attributes:
        end: Whether the episode ended there for good; one that was cut off goes on in `next_obs`.
    """

    obs: jax.Array
    truth: jax.Array
    action: jax.Array
    reward: jax.Array
    next_obs: jax.Array
    next_truth: jax.Array
    end: jax.Array


class Learner(struct.PyTreeNode, kw_only=True):
    """All that an iteration changes; `params` and `targets` are those of actor and critic."""

    params: Any
    targets: Any
    optimiser: Any
    state: Any
    replay: Replay
    key: jax.Array
    steps: jax.Array


def networks(team: shared.Team, flags: Td3Flags) -> tuple[Any, Any]:
    """Return the networks of a team; flax leaves their types open."""
    return Actor(flags.hidden, team.action_size), TwinCritic(flags.hidden)


def initial_params(team: shared.Team, flags: Td3Flags) -> dict[str, Any]:
    """Return weights to begin with."""
    actor, critic = networks(team, flags)
    one, other = jax.random.split(jax.random.key(flags.seed))
    obs, truth = jnp.zeros((1, team.obs_size)), jnp.zeros((1, team.env.privileged_size))
    return {
        "actor": actor.init(one, obs),
        "critic": critic.init(other, obs, truth, jnp.zeros((1, team.action_size))),
    }


def empty_replay(team: shared.Team, flags: Td3Flags) -> Replay:
    """Return a buffer without transitions."""
    shape = flags.buffer_steps, flags.num_worlds
    obs = jnp.zeros((*shape, team.agents, team.obs_size))
    truth = jnp.zeros((*shape, team.env.privileged_size))
    action, reward = jnp.zeros((*shape, team.agents, team.action_size)), jnp.zeros((*shape, team.agents))
    end = jnp.zeros(shape, bool)
    return Replay(obs=obs, truth=truth, action=action, reward=reward, next_obs=obs, next_truth=truth, end=end)


def collect(team: shared.Team, flags: Td3Flags, learner: Learner) -> tuple[Learner, dict[str, jax.Array]]:
    """Act for a rollout, and keep its transitions; return sums of episodes."""
    actor, _ = networks(team, flags)
    noise = jnp.linspace(flags.noise_low, flags.noise_high, flags.num_worlds)[:, None, None]

    def step(carry: tuple[Any, Replay, jax.Array, jax.Array], _: None) -> tuple[Any, Any]:
        state, replay, key, place = carry
        key, own = jax.random.split(key)
        obs = team.merge(state.obs)
        mean = actor.apply(learner.params["actor"], obs)
        action = jnp.clip(mean + noise * jax.random.normal(own, mean.shape), -1.0, 1.0)
        after = team.env.step(state, team.split(action))
        row = Replay(
            obs=obs,
            truth=state.privileged,
            action=action,
            reward=flags.reward_scale * team.reward(after),
            next_obs=team.merge(after.final_obs),
            next_truth=after.final_privileged,
            end=after.done & ~after.truncated,
        )
        # The last states are those of ended episodes; of the others they are what is seen now.
        going = ~after.done
        row = row.replace(
            next_obs=jnp.where(going[:, None, None], team.merge(after.obs), row.next_obs),
            next_truth=jnp.where(going[:, None], after.privileged, row.next_truth),
        )
        here = place % flags.buffer_steps
        replay = jax.tree.map(lambda old, new: old.at[here].set(new), replay, row)
        return (after, replay, key, place + 1), shared.episode_sums(after)

    start = learner.state, learner.replay, learner.key, learner.steps
    (state, replay, key, steps), sums = jax.lax.scan(step, start, None, flags.rollout_length)
    after = learner.replace(state=state, replay=replay, key=key, steps=steps)
    return after, jax.tree.map(jnp.sum, sums)


def sample(team: shared.Team, flags: Td3Flags, learner: Learner, key: jax.Array) -> Replay:
    """Return transitions of agents (rows, ...), drawn from the buffer."""
    keys = jax.random.split(key, 3)
    filled = jnp.minimum(learner.steps, flags.buffer_steps)
    when = jax.random.randint(keys[0], (flags.batch_size,), 0, filled)
    world = jax.random.randint(keys[1], when.shape, 0, flags.num_worlds)
    agent = jax.random.randint(keys[2], when.shape, 0, team.agents)
    replay = learner.replay
    return Replay(
        truth=replay.truth[when, world],
        next_truth=replay.next_truth[when, world],
        end=replay.end[when, world],
        obs=replay.obs[when, world, agent],
        action=replay.action[when, world, agent],
        reward=replay.reward[when, world, agent],
        next_obs=replay.next_obs[when, world, agent],
    )


def critic_loss(
    params: Any, team: shared.Team, flags: Td3Flags, targets: Any, rows: Replay, key: jax.Array
) -> jax.Array:
    """Return the squared error of both critics ()."""
    actor, critic = networks(team, flags)
    action = actor.apply(targets["actor"], rows.next_obs)
    noise = jnp.clip(flags.smoothing * jax.random.normal(key, action.shape), -0.3, 0.3)
    action = jnp.clip(action + noise, -1.0, 1.0)
    after = critic.apply(targets["critic"], rows.next_obs, rows.next_truth, action).min(0)
    target = rows.reward + flags.gamma * (1.0 - rows.end) * after
    value = critic.apply(params, rows.obs, rows.truth, rows.action)
    return jnp.square(value - jax.lax.stop_gradient(target)).mean()


def actor_loss(
    params: Any, team: shared.Team, flags: Td3Flags, critic_params: Any, rows: Replay
) -> jax.Array:
    """Return less the value of the actor's actions ()."""
    actor, critic = networks(team, flags)
    action = actor.apply(params, rows.obs)
    return -critic.apply(critic_params, rows.obs, rows.truth, action)[0].mean()


def optimiser(flags: Td3Flags) -> optax.GradientTransformation:
    """Return Adam."""
    return optax.adam(flags.learning_rate)


def update(
    team: shared.Team, flags: Td3Flags, learner: Learner, now: tuple[jax.Array, jax.Array]
) -> tuple[Learner, jax.Array]:
    """Update the critics, and the actor if it is its turn; `now` is a key and the number of the update."""
    one, other = jax.random.split(now[0])
    rows = sample(team, flags, learner, one)
    args = team, flags, learner.targets, rows, other
    params, states = dict(learner.params), dict(learner.optimiser)

    def learn(name: str, gradient: Any) -> None:
        change, states[name] = optimiser(flags).update(gradient, states[name], params[name])
        params[name] = optax.apply_updates(params[name], change)

    value, gradient = jax.value_and_grad(critic_loss)(params["critic"], *args)
    learn("critic", gradient)
    before = params["actor"], states["actor"]
    learn("actor", jax.grad(actor_loss)(params["actor"], team, flags, params["critic"], rows))
    turn = now[1] % flags.policy_delay == 0
    params["actor"], states["actor"] = jax.tree.map(
        lambda new, old: jnp.where(turn, new, old), (params["actor"], states["actor"]), before
    )
    targets = optax.incremental_update(params, learner.targets, flags.tau)
    return learner.replace(params=params, targets=targets, optimiser=states), value


def iterate(team: shared.Team, flags: Td3Flags, learner: Learner) -> tuple[Learner, dict[str, jax.Array]]:
    """Act for a rollout, then learn from what is kept."""
    learner, sums = collect(team, flags, learner)
    key, own = jax.random.split(learner.key)
    turns = jax.random.split(own, flags.num_updates), jnp.arange(flags.num_updates)
    learner, losses = jax.lax.scan(partial(update, team, flags), learner.replace(key=key), turns)
    return learner, {**sums, "total": losses.mean()}


def train(flags: Td3Flags, env: Any = None) -> tuple[Learner, list[dict[str, Any]]]:
    """Train, and return the last state and the lines of the iterations."""
    team = shared.Team(env or shared.make_env(flags))
    params = initial_params(team, flags)
    start = Learner(
        params=params,
        targets=params,
        optimiser={name: optimiser(flags).init(one) for name, one in params.items()},
        state=team.start(flags.seed),
        replay=empty_replay(team, flags),
        key=jax.random.key(flags.seed + 1),
        steps=jnp.int32(0),
    )
    return shared.run(flags, "fast-td3", start, jax.jit(partial(iterate, team, flags)), team.agents)


def policy_of(env: Any, flags: Td3Flags, params: Any) -> Any:
    """Return the policy for `usarmjx`, without noise."""
    team = shared.Team(env)
    actor, _ = networks(team, flags)
    return shared.feed_forward_policy(team, lambda seen: actor.apply(params["actor"], seen))


def load(env: Any, folder: str) -> Any:
    """Return the policy of a run's folder, for `usarmjx eval` and `usarmjx suite`."""
    flags = shared.saved_flags(Td3Flags, folder)
    return policy_of(env, flags, shared.saved_weights(initial_params(shared.Team(env), flags), folder))


if __name__ == "__main__":
    train(shared.parse(Td3Flags, "FastTD3 for teams"))
