"""Robots act for a while under the present policy; what they see and get is written down."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.train.config import Config
from usarmjx.train.env import Env, EnvState
from usarmjx.train.learner import STAGGER_STREAM, Learner, Networks, in_reward, judge, policy_params
from usarmjx.train.networks import draw, fold_each

Groups = tuple[jax.Array, ...]


class Steps(struct.PyTreeNode, kw_only=True):
    """What happened, step by step.

    Attributes:
        obs: Per group (steps, worlds, robots, obs_size).
        privileged: (steps, worlds, privileged_size).
        raw: Actions before they are squashed, per group (steps, worlds, robots, action_size).
        log_prob: How probable they were, per group (steps, worlds, robots).
        value: What the critic thought before the step, per group (steps, worlds, robots).
        reward: Scaled, per group (steps, worlds, robots).
        bootstrap: What it thought of the state before the restart, where truncated, per group as `value`.
        fresh: Whether an episode began with the step (steps, worlds).
        done: Whether one ended with it (steps, worlds).
        truncated: Whether that was by time-out (steps, worlds).
        bad: Whether there is nothing to learn from the step (steps, worlds).
    """

    obs: Groups
    privileged: jax.Array
    raw: Groups
    log_prob: Groups
    value: Groups
    reward: Groups
    bootstrap: Groups
    fresh: jax.Array
    done: jax.Array
    truncated: jax.Array
    bad: jax.Array


class Bounds(struct.PyTreeNode, kw_only=True):
    """What is known of the worlds before the first step and after the last.

    Attributes:
        number: Of each world, among those of all processes (worlds,).
        policy: What the policies remembered before the first step, per group (worlds, robots, memory).
        critic: What the critics remembered, as `policy`.
        last_value: What the critics think after the last step, per group (worlds, robots).
    """

    number: jax.Array
    policy: Groups
    critic: Groups
    last_value: Groups


class Collector(struct.PyTreeNode, kw_only=True):
    """The worlds of this process, and what goes on in them from one rollout to the next.

    Attributes:
        env: The worlds.
        number: Of each of them, among those of all processes (worlds,).
        policy: What the robots remember, per group (worlds, robots, memory).
        critic: What their critics remember, as `policy`.
        gained: Rewards of the running episode, mean of the robots (worlds,).
        fresh: Whether an episode begins now (worlds,).
    """

    env: EnvState
    number: jax.Array
    policy: Groups
    critic: Groups
    gained: jax.Array
    fresh: jax.Array


class Seen(struct.PyTreeNode, kw_only=True):
    """What of an environment's state the trainer looks at; see `EnvState`."""

    obs: Groups
    privileged: jax.Array
    reward: Groups
    done: jax.Array
    truncated: jax.Array
    final_obs: Groups
    final_privileged: jax.Array
    final_score: jax.Array
    length: jax.Array
    bad: jax.Array
    metrics: dict[str, jax.Array]


def _seen(env: EnvState) -> Seen:
    return Seen(**{name: getattr(env, name) for name in Seen.__dataclass_fields__})


class Decision(struct.PyTreeNode, kw_only=True):
    """What is decided in a step, and what is remembered after it; see `Steps`."""

    raw: Groups
    log_prob: Groups
    value: Groups
    policy: Groups
    critic: Groups


def _stacked(rows: list[tuple[Steps, dict[str, jax.Array]]]) -> tuple[Steps, dict[str, jax.Array]]:
    """Return steps with a leading axis over them, and what they sum up to."""
    steps, sums = jax.tree.map(lambda *leaves: jnp.stack(leaves), *rows)
    return steps, jax.tree.map(lambda one: one.sum(0), sums)


class Rollout:
    """Lets robots act.

    Args:
        env: The worlds of this process.
        networks: Shapes of policy and critics.
        config: Settings.
        first: Number of the first world.
    """

    def __init__(self, env: Env, networks: Networks, config: Config, first: int = 0) -> None:
        self.env, self.networks, self.config, self.first = env, networks, config, first
        self._decide = jax.jit(self._decided)
        self._account = jax.jit(self._accounted)
        self._stack = jax.jit(_stacked)
        self._bound = jax.jit(self._bounded)
        self.collect: Callable[..., tuple[Collector, Steps, Bounds, dict[str, jax.Array]]] = (
            jax.jit(self._scan) if env.traceable else self._loop
        )
        """From learner, worlds and key to worlds, what happened, and sums over it for the log."""

    def start(self, level: float) -> Collector:
        """Return the worlds at the start of their first episodes, some of which will be short."""
        config = self.config
        generated = {} if not config.curriculum else {"level": level}
        env = self.env.reset(config.seed, **generated)
        number, late, blank = jax.jit(self._opened)()
        if config.stagger:
            env = env.replace(length=late.astype(env.length.dtype))
        return Collector(
            env=env,
            number=number,
            policy=blank,
            critic=blank,
            gained=jnp.zeros(self.env.worlds),
            fresh=jnp.ones(self.env.worlds, bool),
        )

    def _opened(self) -> tuple[jax.Array, jax.Array, Groups]:
        """Return the worlds' numbers, how late their first episodes are, and blank memories."""
        number = self.first + jnp.arange(self.env.worlds)
        keys = fold_each(jax.random.fold_in(jax.random.key(self.config.seed), STAGGER_STREAM), number)
        late = jax.vmap(lambda key: jax.random.randint(key, (), 0, self.env.episode_steps))(keys)
        return number, late, self.networks.policy.start(self.env.worlds)

    def _decided(
        self,
        learner: Learner,
        seen: Seen,
        memory: tuple[Groups, Groups],
        worlds: jax.Array,
        key: Any,  # noqa: ANN401
    ) -> tuple[Groups, Decision]:
        """Return actions, and what led to them; `key` is the rollout's and the number of the step."""
        policy = self.networks.policy
        logits, after = policy.parameters(policy_params(learner), seen.obs, memory[0])
        raw = draw(policy, logits, fold_each(jax.random.fold_in(*key), worlds))
        kinds = [policy.distribution(g) for g in range(len(raw))]
        value, critic = self._value(learner, seen.obs, seen.privileged, memory[1])
        return tuple(kind.postprocess(action) for kind, action in zip(kinds, raw, strict=True)), Decision(
            raw=raw,
            log_prob=tuple(k.log_prob(p, a) for k, p, a in zip(kinds, logits, raw, strict=True)),
            value=value,
            policy=after,
            critic=critic,
        )

    def _value(
        self, learner: Learner, obs: Groups, privileged: jax.Array, carry: Groups
    ) -> tuple[Groups, Groups]:
        seen = tuple(one[None] for one in obs)
        no = jnp.zeros((1, len(privileged)), bool)
        value, after = judge(self.networks, learner, (seen, privileged[None]), carry, no)
        return in_reward(learner, tuple(one[0] for one in value)), after

    def _accounted(
        self,
        learner: Learner,
        told: tuple[jax.Array, jax.Array],
        decision: Decision,
        before: Seen,
        after: Seen,
    ) -> tuple[Steps, tuple[Groups, Groups], jax.Array, dict[str, jax.Array]]:
        """Write down a step; `told` is what was gained in the episode, and whether it began with the step."""
        gained, fresh = told
        seen = (*before.obs, before.privileged[:, None], *(reward[..., None] for reward in after.reward))
        sound = jnp.stack([jnp.isfinite(one).all((1, 2)) for one in seen]).all(0)
        bad = after.bad | ~sound
        done = after.done | bad
        truncated = after.truncated & ~bad
        blank = tuple(jnp.zeros_like(value) for value in decision.value)
        bootstrap = jax.lax.cond(
            truncated.any(),
            lambda: self._value(learner, after.final_obs, after.final_privileged, decision.critic)[0],
            lambda: blank,
        )
        reward = tuple(jnp.where(bad[:, None], 0.0, one) for one in after.reward)
        robots = sum(one.shape[1] for one in reward)
        gained = gained + sum(one.sum(1) for one in reward) / robots
        ended = done & ~bad
        forget = self.networks.policy.forget
        step = Steps(
            obs=before.obs,
            privileged=before.privileged,
            raw=decision.raw,
            log_prob=decision.log_prob,
            value=decision.value,
            reward=tuple(one * self.config.reward_scale for one in reward),
            bootstrap=bootstrap,
            fresh=fresh,
            done=done,
            truncated=truncated,
            bad=bad,
        )
        sums = {
            "episodes": ended.sum(),
            "return": jnp.where(ended, gained, 0.0).sum(),
            "score": jnp.where(ended, after.final_score, 0.0).sum(),
            "length": jnp.where(ended, before.length + 1, 0).sum(),
            "timeouts": truncated.sum(),
            "bad": bad.sum(),
            **{f"step/{name}": jnp.where(bad, 0.0, one).sum() for name, one in after.metrics.items()},
            **{f"end/{name}": jnp.where(ended, one, 0.0).sum() for name, one in after.metrics.items()},
        }
        sums = {name: jnp.asarray(one, jnp.float32) for name, one in sums.items()}
        memory = (forget(decision.policy, done), forget(decision.critic, done))
        return step, memory, jnp.where(done, 0.0, gained), sums

    def _bounded(self, learner: Learner, before: tuple[Groups, Groups], after: Any, seen: Seen) -> Bounds:  # noqa: ANN401
        """Return what is known at the ends; `after` is the worlds' numbers, and the critics' memories."""
        last, _ = self._value(learner, seen.obs, seen.privileged, after[1])
        return Bounds(number=after[0], policy=before[0], critic=before[1], last_value=last)

    def _step(
        self,
        learner: Learner,
        now: Collector,
        key: jax.Array,
        step: Any,  # noqa: ANN401 - int32 of any make
    ) -> tuple[Collector, tuple[Steps, Any]]:
        before = _seen(now.env)
        memory = (now.policy, now.critic)
        actions, decision = self._decide(learner, before, memory, now.number, (key, step))
        env = self.env.step(now.env, actions)
        row, (policy, critic), gained, sums = self._account(
            learner, (now.gained, now.fresh), decision, before, _seen(env)
        )
        return now.replace(env=env, policy=policy, critic=critic, gained=gained, fresh=row.done), (row, sums)

    def _scan(self, learner: Learner, start: Collector, key: jax.Array) -> Any:  # noqa: ANN401
        numbers = jnp.arange(self.config.rollout)
        now, (steps, sums) = jax.lax.scan(lambda now, i: self._step(learner, now, key, i), start, numbers)
        return now, steps, self._ends(learner, start, now), jax.tree.map(lambda one: one.sum(0), sums)

    def _loop(self, learner: Learner, start: Collector, key: jax.Array) -> Any:  # noqa: ANN401
        now, rows = start, []
        for step in range(self.config.rollout):
            now, row = self._step(learner, now, key, np.int32(step))
            rows.append(row)
        steps, sums = self._stack(rows)
        return now, steps, self._ends(learner, start, now), sums

    def _ends(self, learner: Learner, start: Collector, end: Collector) -> Bounds:
        after = (end.number, end.critic)
        return self._bound(learner, (start.policy, start.critic), after, _seen(end.env))
