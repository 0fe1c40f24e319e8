"""Parts that the algorithms beside this file share: flags, teams on one axis, metrics, weights, updates.

Networks, rollouts and losses are in the file of each algorithm.
"""

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct
from flax.serialization import from_bytes, to_bytes

WEIGHTS, RUN, METRICS = "weights.msgpack", "run.json", "metrics.jsonl"


@dataclass(frozen=True, kw_only=True)
class Flags:
    """Flags of all algorithms; each has further ones of its own."""

    task: str = field(
        default="explore-v2", metadata={"help": "name of a task, or of a game in marl_games.py"}
    )
    engine: str = field(default="planar", metadata={"help": "planar, jax or warp: worlds must be traceable"})
    physics: str = field(default="coarse", metadata={"help": "physics settings of the worlds in training"})
    num_worlds: int = field(default=1024, metadata={"help": "worlds"})
    total_steps: int = field(default=20_000_000, metadata={"help": "agent steps in all"})
    rollout_length: int = field(default=32, metadata={"help": "actions between two updates"})
    seed: int = field(default=0, metadata={"help": "seed of all random numbers"})
    out: str = field(default="", metadata={"help": "folder of the run; empty: nothing is written"})
    learning_rate: float = field(default=3e-4, metadata={"help": "learning rate of Adam"})
    gamma: float = field(default=0.99, metadata={"help": "discount factor"})
    reward_scale: float = field(default=1.0, metadata={"help": "factor on rewards"})
    hidden: int = field(default=128, metadata={"help": "width of the two hidden layers"})


@dataclass(frozen=True, kw_only=True)
class PpoFlags(Flags):
    """Flags of PPO."""

    gae_lambda: float = field(default=0.95, metadata={"help": "lambda of the advantages"})
    num_epochs: int = field(default=4, metadata={"help": "passes of an update through a rollout"})
    num_minibatches: int = field(default=4, metadata={"help": "parts of an epoch"})
    clip_epsilon: float = field(default=0.2, metadata={"help": "clip of the ratio of probabilities"})
    entropy_coef: float = field(default=0.0, metadata={"help": "weight of the entropy"})
    value_coef: float = field(default=0.5, metadata={"help": "weight of the critic's loss"})
    max_grad_norm: float = field(default=0.5, metadata={"help": "norm that longer gradients are cut to"})


def parse(kind: type[Any], about: str, words: list[str] | None = None) -> Any:
    """Return the flags of a command line, of a class of them."""
    parser = argparse.ArgumentParser(
        description=about, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    for one in fields(kind):
        name = "--" + one.name.replace("_", "-")
        parser.add_argument(
            name, type=type(one.default), default=one.default, help=one.metadata.get("help", "")
        )
    return kind(**vars(parser.parse_args(words)))


def make_env(flags: Flags, **fields: Any) -> Any:
    """Return the worlds of a task, some of whose fields may be set otherwise, or of a game."""
    import marl_games as games

    if flags.task in games.GAMES:
        return games.GAMES[flags.task](flags.num_worlds)
    import usarmjx

    return usarmjx.make(
        flags.task,
        worlds=flags.num_worlds,
        engine=flags.engine,
        seed=flags.seed,
        physics=flags.physics,
        **fields,
    )


class Team:
    """All agents of an environment on one axis: observations are padded, and tell the classes apart.

    Attributes:
        agents: Number of agents in a world.
        obs_size: Numbers that an agent sees.
        action_size: Numbers in an action.
        chooses: Whether an action is one of as many choices, as of goals; the last numbers of an observation
            say which are there.
        vector: Numbers of a message behind the choices, and with how many of the last choices they count.
        choices: Number of choices.
    """

    def __init__(self, env: Any) -> None:
        self.env, self.groups = env, env.groups
        self.agents = sum(len(group.agents) for group in self.groups)
        self.widest = max(group.obs_size for group in self.groups)
        self.obs_size = self.widest + (len(self.groups) if len(self.groups) > 1 else 0)
        self.action_size = max(group.action_size for group in self.groups)
        self.chooses = any(group.discrete for group in self.groups)
        self.vector = self.groups[0].vector
        self.choices = self.action_size - self.vector.size
        if self.chooses and len(self.groups) > 1:
            raise SystemExit("--task: agents that choose goals are of one class here")

    def merge(self, obs: tuple[jax.Array, ...]) -> jax.Array:
        """Return observations of all agents (worlds, agents, obs_size)."""
        rows: list[jax.Array] = []
        for number, one in enumerate(obs):
            padded = jnp.pad(one, ((0, 0), (0, 0), (0, self.widest - one.shape[-1])))
            if len(obs) > 1:
                kind = jax.nn.one_hot(number, len(obs))
                padded = jnp.concatenate([padded, jnp.broadcast_to(kind, (*one.shape[:2], len(obs)))], -1)
            rows.append(padded)
        return jnp.concatenate(rows, 1)

    def split(self, actions: jax.Array) -> tuple[jax.Array, ...]:
        """Return actions per group, from those of all agents (worlds, agents, action_size)."""
        ends = np.cumsum([len(group.agents) for group in self.groups])[:-1].tolist()
        parts = jnp.split(actions, ends, 1)
        return tuple(one[..., : group.action_size] for one, group in zip(parts, self.groups, strict=True))

    def allowed(self, obs: jax.Array, values: jax.Array) -> jax.Array:
        """Return values of choices (..., choices), far below all where the choice is not there."""
        return jnp.where(obs[..., -self.choices :] > 0.5, values, -1e9) if self.chooses else values

    def parts(self, values: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return what belongs to choices, and to vectors, of numbers of actions (..., action_size)."""
        return values[..., : self.choices], values[..., self.choices :]

    def best(self, obs: jax.Array, mean: jax.Array) -> jax.Array:
        """Return the most probable actions (..., action_size) of a network's means; of choices its logits."""
        if not self.chooses:
            return mean
        logits, numbers = self.parts(mean)
        chosen = jax.nn.one_hot(self.allowed(obs, logits).argmax(-1), self.choices)
        return jnp.concatenate([chosen, numbers], -1)

    def draw(self, key: jax.Array, obs: jax.Array, mean: jax.Array, log_std: jax.Array) -> jax.Array:
        """Return random actions (..., action_size)."""
        spread = jnp.exp(log_std) * jax.random.normal(key, mean.shape)
        if not self.chooses:
            return mean + spread
        other = jax.random.fold_in(key, 1)
        chance = jax.random.gumbel(other, (*mean.shape[:-1], self.choices))
        return self.best(obs, mean + jnp.concatenate([chance, self.parts(spread)[1]], -1))

    def log_probability(
        self, obs: jax.Array, mean: jax.Array, log_std: jax.Array, action: jax.Array
    ) -> jax.Array:
        """Return the log density of actions, or log probability of choices (...).

        The density of a vector counts where it is sent: another one has no effect.
        """
        if not self.chooses:
            return log_probability(mean, log_std, action)
        (logits, means), (_, spread), (chosen, numbers) = map(self.parts, (mean, log_std, action))
        found = (jax.nn.log_softmax(self.allowed(obs, logits)) * chosen).sum(-1)
        return found + self.sends(chosen) * log_probability(means, spread, numbers)

    def sends(self, shares: jax.Array) -> jax.Array:
        """Return the share of choices (..., choices) with which a vector is sent (...)."""
        return shares[..., self.choices - self.vector.choices :].sum(-1)

    def entropy(self, obs: jax.Array, mean: jax.Array, log_std: jax.Array) -> jax.Array:
        """Return the mean entropy (), of normal distributions less a constant."""
        if not self.chooses:
            return log_std.sum(-1).mean()
        (logits, _), (_, spread) = self.parts(mean), self.parts(log_std)
        log_prob = jax.nn.log_softmax(self.allowed(obs, logits))
        share = jnp.exp(log_prob)
        return (self.sends(share) * spread.sum(-1) - (share * log_prob).sum(-1)).mean()

    def reward(self, state: Any) -> jax.Array:
        """Return the rewards of the last step (worlds, agents)."""
        return jnp.concatenate(state.reward, 1)

    def start(self, seed: int) -> Any:
        """Return the worlds at the start, time-outs spread over an episode where the task allows it."""
        if not self.env.traceable:
            raise SystemExit("--engine: these worlds are stepped by the host; use planar, jax or warp")
        state = self.env.reset(seed)
        if (task := getattr(self.env, "task", None)) is None:
            return state
        length = jnp.asarray(np.random.default_rng(seed).integers(0, self.env.episode_steps, self.env.worlds))
        length = length.astype(state.length.dtype)
        return state.replace(length=length, memory=task.started_at(state.memory, length))


class Learner(struct.PyTreeNode, kw_only=True):
    """All that an iteration changes.

    Attributes:
        params: Weights.
        optimiser: State of the optimiser.
        state: Worlds.
        key: Random key.
    """

    params: Any
    optimiser: Any
    state: Any
    key: jax.Array


class Batch(struct.PyTreeNode, kw_only=True):
    """Transitions (steps, worlds, agents, ...); in an update (rows, ...)."""

    obs: jax.Array
    action: jax.Array
    log_prob: jax.Array
    value: jax.Array
    reward: jax.Array
    done: jax.Array


def start_learner(team: Team, flags: Flags, params: Any, optimiser: optax.GradientTransformation) -> Learner:
    """Return a learner before its first iteration."""
    key = jax.random.key(flags.seed + 1)
    return Learner(params=params, optimiser=optimiser.init(params), state=team.start(flags.seed), key=key)


def clipped_adam(flags: PpoFlags) -> optax.GradientTransformation:
    """Return Adam with clipped gradients."""
    return optax.chain(
        optax.clip_by_global_norm(flags.max_grad_norm), optax.adam(flags.learning_rate, eps=1e-5)
    )


def update_in_minibatches(
    learner: Any,
    optimiser: optax.GradientTransformation,
    loss: Callable[[Any, jax.Array], jax.Array],
    count: int,
    *,
    num_epochs: int,
    num_minibatches: int,
) -> tuple[Any, jax.Array]:
    """Pass through rows in random minibatches.

    Args:
        learner: A `Learner`.
        optimiser: The optimiser.
        loss: Takes weights and the numbers of the rows of a minibatch, and returns the loss ().
        count: Number of rows.
        num_epochs: Passes through all rows.
        num_minibatches: Parts of a pass.

    Returns:
        The learner after it, and the mean loss ().
    """

    def minibatch(carry: tuple[Any, Any], chosen: jax.Array) -> tuple[Any, jax.Array]:
        params, state = carry
        value, gradient = jax.value_and_grad(loss)(params, chosen)
        change, state = optimiser.update(gradient, state, params)
        return (optax.apply_updates(params, change), state), value

    def epoch(carry: tuple[Any, Any], key: jax.Array) -> tuple[Any, jax.Array]:
        parts = jax.random.permutation(key, count).reshape(num_minibatches, -1)
        return jax.lax.scan(minibatch, carry, parts)

    key, own = jax.random.split(learner.key)
    start = learner.params, learner.optimiser
    (params, state), losses = jax.lax.scan(epoch, start, jax.random.split(own, num_epochs))
    return learner.replace(params=params, optimiser=state, key=key), losses.mean()


def feed_forward_policy(team: Team, actions: Callable[[jax.Array], jax.Array]) -> Any:
    """Return the policy for `usarmjx` of a network without memory.

    Args:
        team: The team.
        actions: Takes what agents see (worlds, agents, obs_size) and returns their actions.
    """
    from usarmjx.train import Policy

    def act(carry: Any, obs: tuple[jax.Array, ...], key: jax.Array) -> tuple[Any, tuple[jax.Array, ...]]:
        del key
        return carry, team.split(jnp.clip(actions(team.merge(obs)), -1.0, 1.0))

    return Policy(lambda worlds: jnp.zeros((worlds, 1)), act)


def generalised_advantages(
    reward: jax.Array, value: jax.Array, last: jax.Array, done: jax.Array, gamma: float, lam: float
) -> tuple[jax.Array, jax.Array]:
    """Return advantages and targets of the critic (steps, ...).

    Args:
        reward: Rewards, with the value of the last state where an episode was cut off (steps, ...).
        value: Values of the states (steps, ...).
        last: Value of the state after the last step (...).
        done: Whether an episode ended with the step (steps, ...).
        gamma: Discount factor.
        lam: 0 trusts the critic, 1 the sum of rewards.
    """

    def back(carry: tuple[jax.Array, jax.Array], now: tuple[jax.Array, ...]) -> tuple[Any, jax.Array]:
        advantage, after = carry
        reward, value, done = now
        delta = reward + gamma * after * (1 - done) - value
        advantage = delta + gamma * lam * (1 - done) * advantage
        return (advantage, value), advantage

    start = jnp.zeros_like(last), last
    _, advantage = jax.lax.scan(back, start, (reward, value, done.astype(jnp.float32)), reverse=True)
    return advantage, advantage + value


def log_probability(mean: jax.Array, log_std: jax.Array, action: jax.Array) -> jax.Array:
    """Return the log density of a normal distribution, summed over an action's numbers (...)."""
    scaled = (action - mean) / jnp.exp(log_std)
    return (-0.5 * scaled**2 - log_std - 0.5 * jnp.log(2 * jnp.pi)).sum(-1)


def clipped_loss(ratio: jax.Array, advantage: jax.Array, epsilon: float) -> jax.Array:
    """Return PPO's loss of the policy ()."""
    clipped = jnp.clip(ratio, 1 - epsilon, 1 + epsilon)
    return -jnp.minimum(ratio * advantage, clipped * advantage).mean()


def whitened(advantage: jax.Array) -> jax.Array:
    """Return advantages with mean 0 and deviation 1."""
    return (advantage - advantage.mean()) / (advantage.std() + 1e-8)


def episode_sums(state: Any) -> dict[str, jax.Array]:
    """Return sums over the worlds of episodes that ended with the last step."""
    ended = state.done & ~state.bad
    return {"episodes": ended.sum(), "score": jnp.where(ended, state.final_score, 0.0).sum()}


class Recorder:
    """Writes a run: a line of JSON for each iteration as `usarmjx curves` reads it, settings, weights."""

    def __init__(self, flags: Flags, algorithm: str) -> None:
        self.out = Path(flags.out) if flags.out else None
        self.lines: list[dict[str, Any]] = []
        self._began = time.perf_counter()
        if self.out is not None:
            self.out.mkdir(parents=True, exist_ok=True)
            (self.out / METRICS).unlink(missing_ok=True)
            content = {"algorithm": algorithm, "flags": asdict(flags)}
            (self.out / RUN).write_text(json.dumps(content, indent=1) + "\n")

    def write(self, iteration: int, agent_steps: int, sums: dict[str, Any]) -> None:
        """Write the line of an iteration, from its sums."""
        now = time.perf_counter()
        own = {name: float(one) for name, one in jax.device_get(sums).items()}
        before = self.lines[-1]["agent_steps"] if self.lines else 0
        episodes, score = own.pop("episodes"), own.pop("score")
        line = {
            "iteration": iteration,
            "agent_steps": agent_steps,
            "steps_per_s": (agent_steps - before) / max(now - self._began, 1e-9),
            "episodes": episodes,
            "score": score / episodes if episodes else None,
            **{name if "/" in name else f"loss/{name}": one for name, one in own.items()},
        }
        self._began = now
        self.lines.append(line)
        if self.out is not None:
            with (self.out / METRICS).open("a") as file:
                file.write(json.dumps(line) + "\n")
            print(json.dumps(line), flush=True)

    def save(self, params: Any) -> None:
        """Write the weights."""
        if self.out is not None:
            (self.out / WEIGHTS).write_bytes(to_bytes(params))


def run(
    flags: Flags,
    algorithm: str,
    start: Any,
    iterate: Callable[[Any], tuple[Any, dict[str, Any]]],
    agents: int,
) -> Any:
    """Iterate to the end, write the run, and return its last state and its lines; weights are in `params`."""
    # Where some arrays of the start are bound to a device and others are not, as those of an engine and of a
    # network, all of its results are bound, and the second iteration would be compiled anew.
    recorder, state = Recorder(flags, algorithm), jax.device_put(start, jax.devices()[0])
    steps = flags.rollout_length * flags.num_worlds * agents
    for iteration in range(1, -(-flags.total_steps // steps) + 1):
        state, sums = iterate(state)
        recorder.write(iteration, iteration * steps, sums)
        if iteration % 50 == 0:
            recorder.save(state.params)
    recorder.save(state.params)
    return state, recorder.lines


def saved_flags(kind: type[Any], folder: str) -> Any:
    """Return the flags of a run."""
    return kind(**json.loads((Path(folder) / RUN).read_text())["flags"])


def saved_weights(like: Any, folder: str) -> Any:
    """Return the weights of a run, in a tree like this one."""
    return from_bytes(like, (Path(folder) / WEIGHTS).read_bytes())
