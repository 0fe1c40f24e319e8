"""Proximal policy optimisation (Schulman et al. 2017): one update from a rollout; imitation of a baseline.

The update runs in every process at once, on a mesh with one device of each, over worlds that are local to
a process. Sums over worlds, gradients among them, cross; so all processes learn the same. Worlds are
shuffled within blocks (`Config.shuffle_blocks`) that belong to one process: each minibatch is the same set of
worlds however many processes there are, and only the order of summation differs.

In imitation the policy acts and the teacher labels the states (DAgger; Ross, Gordon and Bagnell 2011), so
that the states are those that the policy gets into. Meanwhile the critic learns what the policy's own actions
bring. A task may hide from the policy inputs of its baseline; the teacher sees them all the same.
"""

from collections.abc import Callable
from copy import copy
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct
from jax.flatten_util import ravel_pytree

from usarmjx.base.errors import UsageError, extra
from usarmjx.train.baselines import BASELINES, PLANNERS
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.state import Memory
from usarmjx.train.envs.task import Carry, ObservationArrays, Policy, Task
from usarmjx.train.learning.config import Config
from usarmjx.train.learning.distributions import ChoiceDistribution, Distribution, MixedDistribution
from usarmjx.train.learning.league import update_league
from usarmjx.train.learning.networks import apply_network, fold_all, fold_each, update_statistics
from usarmjx.train.learning.processes import PROCESS_AXIS
from usarmjx.train.learning.train_state import (
    ActorCriticParams,
    Networks,
    TrainState,
    critic_values,
    make_optimiser,
    policy_params,
)
from usarmjx.train.learning.trajectory import RolloutEnds, Trajectory
from usarmjx.train.policies.sources import load_policy
from usarmjx.train.tasks.goal_team import GoalTeam
from usarmjx.train.tasks.oracle_view import oracle_obs

BASELINE, ORACLE = "baseline", "oracle"
"""Teachers that are no policies of one's own."""


def teacher_of(env: Env, name: str = BASELINE) -> Policy:
    """Return the teacher of an environment's task; it acts on what `teacher_obs` returns.

    Args:
        env: The environment.
        name: See `Config.teacher`.

    Raises:
        UsageError: The task has no baseline, of which it lists those that have; or no such teacher.
        UnknownNameError: No policy of that name.
    """
    if name == ORACLE and not chooses_goals(env):
        raise UsageError(
            f"teacher is oracle, which only tasks whose robots choose goals have, not {env.name}"
        )
    # As a teacher the oracle is the baseline on other observations, see `teacher_obs`.
    if name in PLANNERS and name != ORACLE:
        return PLANNERS[name](env)
    if name not in (BASELINE, ORACLE):
        return load_policy(name).policy(env)
    if env.name not in BASELINES:
        raise UsageError(
            f"{env.name} has no baseline to imitate: set imitation_steps to 0, or add one to BASELINES; "
            f"it has {', '.join(BASELINES.names())}"
        )
    task: Task | None = getattr(env, "task", None)  # environments of one's own need none
    if task is not None and task.for_baseline is not task:
        # A shallow copy: the policy's environment keeps its own task, all arrays are shared.
        env = copy(env)
        env.task = task.for_baseline
    return BASELINES.get(env.name)(env)


def teacher_obs(env: Env, memory: Memory, obs: ObservationArrays, name: str = BASELINE) -> ObservationArrays:
    """Return the teacher's observations, per group (worlds, robots, obs_size).

    Args:
        env: The environment.
        memory: Its task's memory (worlds, ...).
        obs: The policy's observations, per group (worlds, robots, obs_size).
        name: See `Config.teacher`.
    """
    task: Task | None = getattr(env, "task", None)
    if task is None or name not in (BASELINE, ORACLE, *PLANNERS):
        return obs
    see = partial(oracle_obs, task) if name == ORACLE and isinstance(task, GoalTeam) else task.baseline_obs
    return jax.vmap(partial(see, env.scene))(memory, obs)


def chooses_goals(env: Env) -> bool:
    """Return whether robots of an environment choose goals."""
    task: Task | None = getattr(env, "task", None)
    return isinstance(task, GoalTeam) and task.discrete


def reset_carry(teacher: Policy, carry: Carry, done: jax.Array) -> Carry:
    """Return a teacher's carry, as at the start in worlds where the episode is over (worlds,)."""
    initial = teacher.initial_carry(len(done))

    def reset_leaf(start: jax.Array, now: jax.Array) -> jax.Array:
        return jnp.where(done.reshape(-1, *[1] * (now.ndim - 1)), start, now)

    return jax.tree.map(reset_leaf, initial, carry)


def imitation_loss(
    kind: Distribution, logits: jax.Array, teacher_action: jax.Array, deviation: float
) -> jax.Array:
    """Return the imitation loss: distance of modes from the teacher's actions, and of deviations.

    Args:
        kind: The family of distributions.
        logits: Its parameters (..., outputs).
        teacher_action: The teacher's action, from -1 to 1 (..., action_size).
        deviation: Target deviation of actions before they are squashed, see `Config.imitation_std`.

    Returns:
        Half the sum of the squares of both (...); of choices, minus the logarithm of the probability of the
        teacher's, plus that sum of the vector where the teacher sends one.
    """
    if isinstance(kind, ChoiceDistribution):
        return -kind.log_prob(logits, teacher_action)
    if isinstance(kind, MixedDistribution):
        (logits, numbers), (choice, vector) = kind.split(logits), kind.split(teacher_action)
        of_vector = imitation_loss(kind.numbers, numbers, vector, deviation)
        return imitation_loss(kind.choice, logits, choice, deviation) + kind.vector_share(choice) * of_vector
    # A baseline may command beyond the limits, which no squashed action can reach.
    error = kind.mode(logits) - jnp.clip(teacher_action, -1.0, 1.0)
    # The error of the mode alone leaves the deviation free.
    std_error = kind.create_dist(logits).scale - deviation
    return 0.5 * (error**2 + std_error**2).sum(-1)


def advantages(
    reward: jax.Array,
    value: jax.Array,
    bootstrap: jax.Array,
    last_value: jax.Array,
    ends: tuple[jax.Array, ...],
    discount: float,
    gae_lambda: float,
) -> jax.Array:
    """Return the advantage of each action, by generalized advantage estimation (Schulman et al. 2016).

    Args:
        reward: Reward of each step (steps, ...).
        value: The critic's value of the state that each step began in (steps, ...).
        bootstrap: That of the state before the reset, used where truncated (steps, ...).
        last_value: That of the state after the last step (...).
        ends: Whether the episode ended with the step, whether that was by time-out, and whether the
            transition is bad, each (steps, ...).
        discount: Discount factor of the next step's value.
        gae_lambda: Lambda: weight of later temporal-difference errors.
    """
    done, truncated, bad = ends
    # The value of the state after a step is that before the next one, so the critic runs once per step.
    next_value = jnp.concatenate([value[1:], last_value[None]])
    next_value = jnp.where(done, jnp.where(truncated, bootstrap, 0.0), next_value)
    # A bad step teaches nothing: its error is 0, and no later error flows back across it.
    td_error = jnp.where(bad, 0.0, reward + discount * next_value - value)
    decay = jnp.where(done | bad, 0.0, discount * gae_lambda)

    def backward(next_advantage: jax.Array, step: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        current = step[0] + step[1] * next_advantage
        return current, current

    _, advantage = jax.lax.scan(backward, jnp.zeros_like(last_value), (td_error, decay), reverse=True)
    return advantage


with extra("train"):
    import optax


# Far beyond every clip range, while e^20 is still small in single precision.
MAX_LOG_RATIO = 20.0
MAX_LEARNING_RATE, MIN_LEARNING_RATE = 1e-2, 1e-5
"""Bounds of the learning rate that `adaptive` sets."""


class Minibatch(struct.PyTreeNode, kw_only=True):
    """Batch that an update is computed from: steps of some worlds and their targets.

    Attributes:
        trajectory: The steps (steps, worlds, ...).
        ends: The rollout's ends (worlds, ...).
        advantage: Normalised, per group (steps, worlds, robots).
        target: Targets of the critics' values, in the critics' scale, per group (steps, worlds,
            robots).
    """

    trajectory: Trajectory
    ends: RolloutEnds
    advantage: tuple[jax.Array, ...]
    target: tuple[jax.Array, ...]

    def select_worlds(self, worlds: jax.Array) -> "Minibatch":
        """Return the batch of some worlds, by index (worlds,)."""
        timed = (self.trajectory, self.advantage, self.target)
        trajectory, advantage, target = jax.tree.map(lambda leaf: leaf[:, worlds], timed)
        ends = jax.tree.map(lambda leaf: leaf[worlds], self.ends)
        return Minibatch(trajectory=trajectory, ends=ends, advantage=advantage, target=target)


def _total(values: jax.Array) -> jax.Array:
    return jax.lax.psum(values.sum(), PROCESS_AXIS)


def surrogate(log_prob: jax.Array, old: jax.Array, advantage: jax.Array, clip: float) -> jax.Array:
    """Return the clipped surrogate objective of actions, which an update maximises."""
    # Cut before the exponential, which overflows from 89 on, and 0 times infinity is NaN in the gradient.
    ratio = jnp.exp(jnp.clip(log_prob - old, -MAX_LOG_RATIO, MAX_LOG_RATIO))
    # The smaller one: beyond the range nothing is gained, but a change for the worse is still corrected.
    return jnp.minimum(ratio * advantage, jnp.clip(ratio, 1.0 - clip, 1.0 + clip) * advantage)


@jax.named_scope("ppo.targets")
def compute_targets(
    networks: Networks,
    train_state: TrainState,
    trajectory: Trajectory,
    rollout_ends: RolloutEnds,
    config: Config,
) -> tuple[Minibatch, tuple[jax.Array, ...]]:
    """Return the targets of a trajectory, and the returns that were estimated, in the unit of rewards."""
    normal: list[jax.Array] = []
    targets: list[jax.Array] = []
    returns: list[jax.Array] = []
    for g in range(len(networks.groups)):
        ends = trajectory.ends(g)
        advantage = advantages(
            trajectory.reward[g],
            trajectory.value[g],
            trajectory.bootstrap_value[g],
            rollout_ends.last_value[g],
            ends,
            config.gamma,
            config.gae_lambda,
        )
        valid = jnp.broadcast_to(~ends[2], advantage.shape)
        # At least 1: all steps of a batch may be bad.
        count = jnp.maximum(_total(valid), 1)
        # Over the whole batch of all processes: neither minibatches nor processes change the advantages.
        mean = _total(jnp.where(valid, advantage, 0.0)) / count
        deviation = jnp.sqrt(_total(jnp.where(valid, (advantage - mean) ** 2, 0.0)) / count)
        # Equal advantages deviate by 0.
        normal.append(jnp.where(valid, (advantage - mean) / (deviation + 1e-8), 0.0))
        # From the advantage before it is normalised: returns are in the unit of rewards.
        returns.append(advantage + trajectory.value[g])
        # The statistics of the rollout, in which its values were predicted; they are updated after the
        # epochs.
        scale = train_state.return_statistics[g]
        targets.append((returns[g] - scale.mean) / scale.std)
    batch = Minibatch(
        trajectory=trajectory, ends=rollout_ends, advantage=tuple(normal), target=tuple(targets)
    )
    return batch, tuple(returns)


def _sums_of(terms: dict[str, jax.Array], valid: jax.Array) -> dict[str, jax.Array]:
    """Return the sums of terms over valid entries; all are of one shape."""
    # Stacked: a GPU has one kernel for all sums, else one or two for each.
    rows = jnp.stack([jnp.where(valid, one, 0.0).ravel() for one in terms.values()])
    return dict(zip(terms, rows.sum(1), strict=True))


@jax.named_scope("ppo.loss")
def loss(
    weights: ActorCriticParams,
    networks: Networks,
    train_state: TrainState,
    minibatch: Minibatch,
    key: jax.Array,
    config: Config,
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """Return the sum of the losses of a minibatch's steps, and sums for the log.

    Bad steps count as 0. To be divided by `weight` of all processes.

    Args:
        weights: Parameters to differentiate by.
        networks: Shapes.
        train_state: Statistics that observations are normalised by; its weights are not used.
        minibatch: Some worlds.
        key: Key of the random numbers for the entropy estimate.
        config: Settings.
    """
    steps, ends = minibatch.trajectory, minibatch.ends
    # By the worlds' numbers: a minibatch in another order, or process, draws the same.
    keys = fold_each(key, ends.world_index)
    # The critic reads its weights from here: without this no gradient would reach them.
    train_state = train_state.replace(params=weights)
    starts = tuple(steps.starts(g) for g in range(len(steps.obs)))
    values, _ = critic_values(networks, train_state, (steps.obs, steps.privileged), ends.critic_carry, starts)
    sums: dict[str, Any] = {}
    imitating, policies = networks.is_imitating(train_state, config), weights.group_policies
    for g, raw in enumerate(steps.raw_action):
        scale = train_state.obs_statistics[g]
        obs = networks.policy.normalised(g, scale.mean, scale.std, steps.obs[g])
        logits, _ = apply_network(
            networks.policy.network(g), policies[g], obs, None, ends.policy_carry[g], starts[g]
        )
        logits = networks.policy.masked(g, logits, steps.obs[g])
        kind = networks.policy.distribution(g)
        log_prob = kind.log_prob(logits, raw)
        # Entropy of a squashed action has no closed form: it is estimated from one drawn per step.
        entropy = jax.vmap(kind.entropy, in_axes=(1, 0), out_axes=1)(logits, fold_all(keys, g))
        log_ratio = jnp.clip(log_prob - steps.log_prob[g], -MAX_LOG_RATIO, MAX_LOG_RATIO)
        ratio = jnp.exp(log_ratio)
        terms = {
            "policy": -surrogate(log_prob, steps.log_prob[g], minibatch.advantage[g], config.clip_epsilon),
            "value": 0.5 * (values[g] - minibatch.target[g]) ** 2,
            "entropy": entropy,
            "divergence": ratio
            - 1.0
            - log_ratio,  # estimate k3 of the KL divergence: unbiased, never negative
            "clipped": (jnp.abs(ratio - 1.0) > config.clip_epsilon).astype(jnp.float32),
            "weight": jnp.ones_like(ratio),
        }
        # Known when it is traced: without a teacher no loss of imitation is compiled.
        if steps.teacher_action:
            terms["imitation"] = imitation_loss(kind, logits, steps.teacher_action[g], config.imitation_std)
            terms["policy"] = jnp.where(imitating, terms["imitation"], terms["policy"])
        for name, one in _sums_of(terms, steps.valid(g)).items():
            sums[name] = sums.get(name, jnp.float32(0)) + one
    total = sums["policy"] + config.value_coef * sums["value"] - config.entropy_coef * sums["entropy"]
    return total, sums


def _shuffle(key: jax.Array, worlds: int, blocks: int, first: jax.Array, minibatches: int) -> jax.Array:
    """Return which of this process's worlds are in which minibatch (minibatches, worlds / minibatches).

    Args:
        key: Key of the epoch.
        worlds: Worlds of this process.
        blocks: Blocks of this process.
        first: Number of its first block.
        minibatches: Number of minibatches.
    """
    size = worlds // blocks
    keys = fold_each(key, first + jnp.arange(blocks))

    def permutation(key: jax.Array) -> jax.Array:
        return jax.random.permutation(key, size)

    order = jax.vmap(permutation)(keys)
    # A minibatch takes the same share of every block, so that no world moves between processes.
    order = order + size * jnp.arange(blocks)[:, None]
    return order.reshape(blocks, minibatches, -1).swapaxes(0, 1).reshape(minibatches, -1)


def initial_adaptive_rate(rate: jax.Array, config: Config) -> jax.Array:
    """Return the learning rate with which PPO begins on a policy that has learned: an adaptive one grows."""
    return jnp.full_like(rate, MIN_LEARNING_RATE) if config.lr_schedule == "adaptive" else rate


def begin_update(networks: Networks, config: Config, train_state: TrainState) -> TrainState:
    """Return the train state with the learning rate, and Adam's moments, that an update begins with."""
    if config.lr_schedule == "linear":
        remaining = 1.0 - train_state.iteration / config.iterations(networks.agent_count)
        rate = config.learning_rate * jnp.maximum(remaining, 0.0).astype(jnp.float32)
        train_state = train_state.replace(learning_rate=rate)
    imitation_iterations = config.imitations(networks.agent_count)
    if not imitation_iterations:
        return train_state
    # Imitation ends with small gradients: steps by its moments would be many times as long as PPO's own.
    restarted = train_state.replace(
        learning_rate=initial_adaptive_rate(train_state.learning_rate, config),
        opt_state=make_optimiser(config).init(train_state.params),
    )
    # `where` on all leaves, not an `if`: the iteration is traced.
    return jax.tree.map(
        partial(jnp.where, train_state.iteration == imitation_iterations), restarted, train_state
    )


def run_epochs(
    networks: Networks,
    config: Config,
    processes: int,
    train_state: TrainState,
    batch: Minibatch,
    key: jax.Array,
) -> tuple[TrainState, dict[str, jax.Array]]:
    """Go through a batch, `epochs` times, and return what is worth knowing of it, means over minibatches."""
    optimiser = make_optimiser(config)
    worlds, blocks = batch.trajectory.done.shape[1], config.shuffled_blocks // processes
    train_state, as_trees = _as_vectors(begin_update(networks, config, train_state))

    def update_once(
        state: TrainState, epoch_key: tuple[jax.Array, jax.Array]
    ) -> tuple[TrainState, dict[str, jax.Array]]:
        index, key = epoch_key
        gradient, sums = jax.grad(loss, has_aux=True)(
            as_trees(state).params, networks, state, batch.select_worlds(index), key, config
        )
        gradient, _ = _vector(gradient)
        # Sums cross, not means: the processes' numbers of good steps differ.
        gradient, sums = jax.lax.psum((gradient, sums), PROCESS_AXIS)
        # All steps of a minibatch may be bad.
        weight = jnp.maximum(sums.pop("weight"), 1.0)
        gradient, stats = jax.tree.map(lambda one: one / weight, (gradient, sums))
        norm = optax.tree.norm(gradient)
        # An update whose gradient is not finite is skipped and counted, or it would ruin all weights.
        finite = jnp.isfinite(norm)
        steps, moments = optimiser.update(gradient, state.opt_state)
        # Not by optax: the rate is part of the train state, which `adaptive` changes between minibatches.
        params = state.params - state.learning_rate * steps
        updated = state.replace(params=params, opt_state=moments)
        # Adam's moments, too: NaN in them would last for ever.
        updated = jax.tree.map(lambda after, before: jnp.where(finite, after, before), updated, state)
        if config.lr_schedule == "adaptive":
            # Not during imitation, which means to change the policy far in a step.
            rate = _adapt(state.learning_rate, stats["divergence"], config)
            updated = updated.replace(
                learning_rate=jnp.where(networks.is_imitating(state, config), state.learning_rate, rate)
            )
        return updated, {**stats, "gradient": jnp.where(finite, norm, 0.0), "skipped": 1.0 - finite}

    def epoch(state: TrainState, number: jax.Array) -> tuple[TrainState, dict[str, jax.Array]]:
        epoch_key = jax.random.fold_in(key, number)
        # Blocks are numbered over all processes, so the shuffle does not depend on how many there are.
        first_block = jax.lax.axis_index(PROCESS_AXIS) * blocks
        index = _shuffle(epoch_key, worlds, blocks, first_block, config.num_minibatches)
        # Counted on from the blocks' numbers, whose keys shuffle: no key is used twice.
        keys = fold_each(epoch_key, config.shuffled_blocks + jnp.arange(config.num_minibatches))
        return jax.lax.scan(update_once, state, (index, keys))

    train_state, stats = jax.lax.scan(epoch, train_state, jnp.arange(config.num_epochs))
    return as_trees(train_state), jax.tree.map(jnp.mean, stats)


def _vector(tree: Any) -> tuple[jax.Array, Callable[..., Any]]:  # noqa: ANN401 - a PyTree
    """Return the arrays of a PyTree as one vector (n,), and what turns such a vector into the PyTree."""
    return ravel_pytree(tree)


def _as_vectors(state: TrainState) -> tuple[TrainState, Callable[[TrainState], TrainState]]:
    """Return a train state whose parameters, and each of Adam's moments, are one vector (weights,).

    A GPU changes a vector with a few kernels, and a tree with some for each of its arrays.

    Returns:
        That state, and what turns it into one with trees.
    """
    params, unravel = _vector(state.params)

    def is_tree(part: Any) -> bool:  # noqa: ANN401 - part of optax's state
        return isinstance(part, ActorCriticParams)

    def ravel(part: Any) -> Any:  # noqa: ANN401 - as above
        return _vector(part)[0] if is_tree(part) else part

    def as_trees(packed: TrainState) -> TrainState:
        moments = jax.tree.map(
            lambda old, new: unravel(new) if is_tree(old) else new,
            state.opt_state,
            packed.opt_state,
            is_leaf=is_tree,
        )
        return packed.replace(params=unravel(packed.params), opt_state=moments)

    moments = jax.tree.map(ravel, state.opt_state, is_leaf=is_tree)
    return state.replace(params=params, opt_state=moments), as_trees


def _adapt(rate: jax.Array, divergence: jax.Array, config: Config) -> jax.Array:
    """Return a slower rate if the policy changed by much more than wanted, a faster one if by much less."""
    # The rule of RSL-RL (Rudin et al. 2022): factor 1.5 outside of half to twice the target.
    slower = jnp.where(divergence > 2.0 * config.target_kl, rate / 1.5, rate)
    faster = jnp.where(divergence < 0.5 * config.target_kl, rate * 1.5, slower)
    # A divergence that is not finite says nothing of the length of a step.
    return jnp.clip(jnp.where(jnp.isfinite(divergence), faster, rate), MIN_LEARNING_RATE, MAX_LEARNING_RATE)


@jax.named_scope("ppo.update")
def update(
    networks: Networks,
    config: Config,
    processes: int,
    train_state: TrainState,
    experience: tuple[Trajectory, RolloutEnds, dict[str, jax.Array]],
    stream: jax.Array,
) -> tuple[TrainState, dict[str, jax.Array]]:
    """Return the train state after an update, and what is worth knowing; in every process at once.

    Args:
        networks: Shapes.
        config: Settings.
        processes: Number of processes that share the worlds.
        train_state: The same in all.
        experience: Rollout of this process: trajectory (steps, worlds, ...), ends (worlds, ...), and sums
            for the log (1,).
        stream: Data of the key of all updates, see `Trainer`.
    """
    steps, ends, sums = experience
    wrap: Callable[..., jax.Array] = jax.random.wrap_key_data  # pyright: ignore[reportUnknownMemberType]
    # By the iteration in the train state: a resumed run draws as it would have.
    key = jax.random.fold_in(wrap(stream), train_state.iteration)
    batch, returns = compute_targets(networks, train_state, steps, ends, config)
    # Statistics follow the update: log-probabilities and values of the rollout were taken with the old ones.
    old = train_state
    train_state, stats = run_epochs(networks, config, processes, train_state, batch, key)
    valid = ~steps.bad
    valid_robots: list[jax.Array] = [
        jnp.broadcast_to(steps.valid(g), one.shape) for g, one in enumerate(returns)
    ]
    if config.normalize_obs:
        obs = tuple(
            update_statistics(one, seen, mask, PROCESS_AXIS)
            for one, seen, mask in zip(old.obs_statistics, steps.obs, valid_robots, strict=True)
        )
        train_state = train_state.replace(
            obs_statistics=obs,
            privileged_statistics=update_statistics(
                old.privileged_statistics, steps.privileged, valid, PROCESS_AXIS
            ),
        )
    if config.normalize_values:
        value = tuple(
            update_statistics(one, v, w, PROCESS_AXIS)
            for one, v, w in zip(old.return_statistics, returns, valid_robots, strict=True)
        )
        train_state = train_state.replace(return_statistics=value)
    stats = {f"loss/{name}": one for name, one in stats.items()}
    stats["loss/explained"] = _explained_variance(steps, returns, valid_robots)
    stats["loss/rate"] = train_state.learning_rate
    totals = {name: jax.lax.psum(one.sum(), PROCESS_AXIS) for name, one in sums.items()}
    now = train_state.iteration + 1
    if train_state.league is not None:
        league, more = update_league(
            train_state.league, totals, policy_params(train_state), now, config.league_interval
        )
        train_state = train_state.replace(league=league)
        totals = {name: one for name, one in totals.items() if not name.startswith("league/")} | more
    return train_state.replace(iteration=now), {**stats, **totals}


def _explained_variance(
    steps: Trajectory, returns: tuple[jax.Array, ...], valid: list[jax.Array]
) -> jax.Array:
    """Return the share of the returns' variance that the critics explain."""
    count = jnp.maximum(sum(_total(one) for one in valid), 1)

    def variance(values: list[jax.Array]) -> jax.Array:
        pairs = list(zip(values, valid, strict=True))
        mean = sum(_total(jnp.where(mask, one, 0.0)) for one, mask in pairs) / count
        return sum(_total(jnp.where(mask, (one - mean) ** 2, 0.0)) for one, mask in pairs) / count

    errors = [now - then for now, then in zip(returns, steps.value, strict=True)]
    # Returns that are all equal have no variance to explain.
    return 1.0 - variance(errors) / jnp.maximum(variance(list(returns)), 1e-8)
