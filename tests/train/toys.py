"""Toy environments of the training contract, to learn in seconds; each has a closed form to compare with."""

from functools import partial

import jax
import jax.numpy as jnp
from flax import struct

from tests.train.shared_programs import SharedPrograms
from usarmjx.base import random
from usarmjx.train.envs.state import AgentGroup, EnvState
from usarmjx.train.learning.config import Config


def small_config(**settings):
    """Settings of a learner that compiles in seconds; one minibatch and epoch unless given."""
    sizes = {"hidden_sizes": (8,), "critic_hidden_sizes": (8,), "gru_size": 4}
    return Config(**{"num_minibatches": 1, "num_epochs": 1, **sizes, **settings})


class ToyMemory(struct.PyTreeNode, kw_only=True):
    x: object  # of the task
    key: jax.Array  # of the world
    episode: jax.Array


class Toy:
    """The contract around a few functions of one world, which the kinds below have.

    start(key) -> x; see(x, time) -> obs per group, privileged; go(x, time, actions) -> x, rewards,
    terminated, score, bad
    """

    name, period, privileged_size = "toy", 0.1, 1

    def __init__(self, worlds=8, first=0, traceable=True):
        self.worlds, self.first, self.traceable = worlds, first, traceable
        self.step = jax.jit(self._step) if traceable else self._step_by_step
        self._jitted = jax.jit(self._step)

    def _step_by_step(self, state, actions):
        assert not any(isinstance(a, jax.core.Tracer) for a in actions)
        return self._jitted(state, actions)

    def reset(self, seed):
        seeds = jnp.atleast_1d(random.key(seed))
        number = self.first + jnp.arange(self.worlds // len(seeds))
        key = random.fold_in(seeds, number).reshape(-1)
        episode, zero = jnp.zeros(self.worlds, jnp.int32), jnp.zeros(self.worlds)
        x = jax.vmap(lambda k: self.start(jax.random.fold_in(k, 0)))(key)
        obs, privileged = jax.vmap(self.see)(x, episode)
        no = jnp.zeros(self.worlds, bool)
        return EnvState(
            batch=None,
            memory=ToyMemory(x=x, key=key, episode=episode),
            obs=obs,
            privileged=privileged,
            reward=tuple(jnp.zeros((self.worlds, len(g.agents))) for g in self.groups),
            done=no,
            truncated=no,
            final_obs=obs,
            final_privileged=privileged,
            score=zero,
            final_score=zero,
            length=episode,
            bad=no,
            metrics={"success": zero},
        )

    def arenas_at(self, level):
        return None  # all worlds have the same

    def _step(self, state, actions):
        state = self.advance(state, actions)
        return self.restart(state, state.done)

    def advance(self, state, actions):
        x, reward, terminated, score, bad = jax.vmap(self.go)(state.memory.x, state.length, actions)
        length = state.length + 1
        late = length >= self.episode_steps
        terminated = terminated & ~bad
        done = terminated | late | bad
        final, final_privileged = jax.vmap(self.see)(x, length)
        return state.replace(
            memory=state.memory.replace(x=x),
            obs=final,
            privileged=final_privileged,
            reward=reward,
            done=done,
            truncated=late & ~terminated & ~bad,
            final_obs=final,
            final_privileged=final_privileged,
            score=score,
            final_score=jnp.where(done, score, state.final_score),
            length=length,
            bad=bad,
            metrics={"success": score},
        )

    def restart(self, state, where):
        memory = state.memory
        episode = memory.episode + where
        fresh = jax.vmap(lambda k, e: self.start(jax.random.fold_in(k, e)))(memory.key, episode)
        x = jax.tree.map(partial(_pick, where), fresh, memory.x)
        length = jnp.where(where, 0, state.length)
        obs, privileged = jax.vmap(self.see)(x, length)
        return state.replace(
            memory=memory.replace(x=x, episode=episode),
            obs=obs,
            privileged=privileged,
            score=jnp.where(where, 0.0, state.score),
            length=length,
        )


def group(name, robots, obs_size, action_size):
    return AgentGroup(name, tuple(f"{name}{i}" for i in range(robots)), obs_size, action_size)


class DriveToy(Toy):
    """Point robots, two of class A and one of class B, are to be at their own goals all at once.

    An action is a step of at most 0.2; goals are within +-1; near is 0.25. Score: 1 when all are near. With
    `rotten`, a robot A beyond 0.6 to the right makes its world bad: observations and rewards are NaN. With
    `shared`, trainers take programs that others with equal settings have traced in this process.
    """

    name, episode_steps, privileged_size = "drive-toy", 25, 6
    groups = (group("A", 2, 2, 2), group("B", 1, 2, 2))

    def __init__(self, *args, rotten=False, shared=False, **more):
        self.rotten = rotten
        super().__init__(*args, **more)
        if shared:
            self.program_cache = SharedPrograms(self.worlds, self.first, self.traceable, rotten)

    def start(self, key):
        draw = jax.random.uniform(key, (2, 3, 2), minval=-1.0, maxval=1.0)
        return {"at": 0.3 * draw[0], "goal": draw[1]}

    def see(self, x, time):
        way = x["goal"] - x["at"]
        return (way[:2], way[2:]), jnp.ravel(way)

    def go(self, x, time, actions):
        before = jnp.linalg.norm(x["goal"] - x["at"], axis=-1)
        at = x["at"] + 0.2 * jnp.concatenate(actions)
        bad = self.rotten & (at[:2, 0] > 0.6).any()
        at = jnp.where(bad, jnp.nan, at)
        after = jnp.linalg.norm(x["goal"] - at, axis=-1)
        near = (after < 0.25).all()
        reward = before - after + near
        return {**x, "at": at}, (reward[:2], reward[2:]), near, near.astype(jnp.float32), bad


class MemoryToy(Toy):
    """A light is on or off in the first moment; the last action's sign must tell which. Score: 1 if so.

    Without memory nobody does better than 1/2.
    """

    name, episode_steps, privileged_size = "memory-toy", 5, 1
    groups = (group("A", 1, 2, 1),)

    def start(self, key):
        return {"light": jnp.where(jax.random.bernoulli(key), 1.0, -1.0)}

    def see(self, x, time):
        first, last = time == 0, time == self.episode_steps - 1
        return (jnp.stack([jnp.where(first, x["light"], 0.0), last.astype(jnp.float32)])[None],), x["light"][
            None
        ]

    def go(self, x, time, actions):
        last = time == self.episode_steps - 1
        right = last & (actions[0][0, 0] * x["light"] > 0)
        score = right.astype(jnp.float32)
        return x, (score[None],), last, score, jnp.zeros((), bool)


class EndlessToy(Toy):
    """A reward of 1 at every step, for ever; the time limit only interrupts. Worth 1 / (1 - discount)."""

    name, episode_steps, privileged_size = "endless-toy", 4, 0
    groups = (group("A", 1, 1, 1),)

    def start(self, key):
        return {"nothing": jnp.zeros(1)}

    def see(self, x, time):
        return (jnp.ones((1, 1)),), jnp.zeros(0)

    def go(self, x, time, actions):
        return x, (jnp.ones(1),), jnp.zeros((), bool), jnp.zeros(()), jnp.zeros((), bool)


END = 1.5
"""Where an episode of `LineToy` ends."""


class LineToy:
    """Robots on lines, whose numbers a test can work out by hand; without the class above.

    Each robot stands on a line at `x`. A world starts with robot i at (number + 1) / 8 + i + episode / 16; an
    action moves by a tenth of its first number. Reward: the new x. An episode ends when the first robot is
    beyond `END`, or after `episode_steps`. Observed: x, and the steps so far. There are `robots` of class A,
    each with an action of 2 numbers, and one of class B with 1 if `mixed`.
    """

    name = "toy"
    privileged_size = 1
    episode_steps = 6
    period = 0.1

    def __init__(self, worlds=1, robots=2, mixed=True, traceable=True):
        self.worlds, self.traceable = worlds, traceable
        first = group("A", robots, 2, 2)
        self.groups = (first, group("B", 1, 2, 1)) if mixed else (first,)
        self.calls = 0

    def _start(self, number, episode):
        first = (number + 1) / 8 + episode / 16
        return tuple(first[:, None] + jnp.arange(len(g.agents), dtype=jnp.float32) for g in self.groups)

    def _obs(self, x, length):
        steps = length.astype(jnp.float32)[:, None]
        return tuple(jnp.stack([p, jnp.broadcast_to(steps, p.shape)], -1) for p in x)

    def reset(self, seed):
        zero, no = jnp.zeros(self.worlds), jnp.zeros(self.worlds, bool)
        number = jnp.arange(self.worlds) + jnp.asarray(seed, jnp.int32) % 7
        episode = jnp.zeros(self.worlds, jnp.int32)
        x, length = self._start(number, episode), jnp.zeros(self.worlds, jnp.int32)
        obs = self._obs(x, length)
        return EnvState(
            batch={"key": jax.random.key(seed), "episode": episode},
            memory={"number": number, "x": x},
            obs=obs,
            privileged=x[0][:, :1],
            reward=tuple(jnp.zeros_like(p) for p in x),
            done=no,
            truncated=no,
            final_obs=obs,
            final_privileged=x[0][:, :1],
            score=zero,
            final_score=zero,
            length=length,
            bad=no,
            metrics={"way": zero},
        )

    def step(self, state, actions):
        state = self.advance(state, actions)
        return self.restart(state, state.done)

    def arenas_at(self, level):
        return None

    def restart(self, state, where):
        episode = state.batch["episode"] + where
        fresh = self._start(state.memory["number"], episode)
        x = jax.tree.map(partial(_pick, where), fresh, state.memory["x"])
        length = jnp.where(where, 0, state.length)
        return state.replace(
            batch={**state.batch, "episode": episode},
            memory={**state.memory, "x": x},
            obs=self._obs(x, length),
            privileged=x[0][:, :1],
            score=jnp.where(where, 0.0, state.score),
            length=length,
        )

    def advance(self, state, actions):
        self.calls += 1
        assert [a.shape for a in actions] == [
            (self.worlds, len(g.agents), g.action_size) for g in self.groups
        ], [a.shape for a in actions]
        x = tuple(p + 0.1 * a[..., 0] for p, a in zip(state.memory["x"], actions, strict=True))
        length, score = state.length + 1, state.score + x[0][:, 0]
        ended = x[0][:, 0] > END
        truncated = ~ended & (length >= self.episode_steps)
        done = ended | truncated
        obs = self._obs(x, length)
        return state.replace(
            memory={**state.memory, "x": x},
            obs=obs,
            privileged=x[0][:, :1],
            reward=x,
            done=done,
            truncated=truncated,
            final_obs=obs,
            final_privileged=x[0][:, :1],
            score=score,
            final_score=jnp.where(done, score, state.final_score),
            length=length,
            bad=jnp.zeros(self.worlds, bool),
            metrics={"way": x[0][:, 0]},
        )


def _pick(done, new, old):
    return jnp.where(done.reshape(-1, *[1] * (new.ndim - 1)), new, old)
