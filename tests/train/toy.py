"""A toy environment of the training contract, whose numbers a test can work out by hand.

Each robot stands on a line at `x`. A world starts with robot i at (number + 1) / 8 + i + episode / 16; an
action moves by a tenth of its first number. Reward: the new x. An episode ends when the first robot is
beyond 1.5, or after `episode_steps`. Observed: x, and the steps so far.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct


@dataclass(frozen=True)
class Group:
    name: str
    agents: tuple
    obs_size: int
    action_size: int


class ToyState(struct.PyTreeNode, kw_only=True):
    batch: Any
    memory: Any
    obs: Any
    privileged: Any
    reward: Any
    done: Any
    truncated: Any
    final_obs: Any
    final_privileged: Any
    score: Any
    final_score: Any
    length: Any
    bad: Any
    metrics: Any


END = 1.5


class ToyEnv:
    """`team` robots of class A, each with an action of 2 numbers, and one of class B with 1 if `mixed`."""

    name = "toy"
    privileged_size = 1
    episode_steps = 6
    period = 0.1

    def __init__(self, worlds=1, team=2, mixed=True, traceable=True):
        self.worlds, self.traceable = worlds, traceable
        group = Group("A", tuple(f"A{i}" for i in range(team)), 2, 2)
        self.groups = (group, Group("B", ("B0",), 2, 1)) if mixed else (group,)
        self.calls = 0

    def _start(self, number, episode):
        first = (number + 1) / 8 + episode / 16
        return tuple(
            first[:, None] + jnp.arange(len(group.agents), dtype=jnp.float32) for group in self.groups
        )

    def _obs(self, x, length):
        steps = length.astype(jnp.float32)[:, None]
        return tuple(jnp.stack([p, jnp.broadcast_to(steps, p.shape)], -1) for p in x)

    def reset(self, seed):
        zero, no = jnp.zeros(self.worlds), jnp.zeros(self.worlds, bool)
        number = jnp.arange(self.worlds) + jnp.asarray(seed, jnp.int32) % 7
        episode = jnp.zeros(self.worlds, jnp.int32)
        x, length = self._start(number, episode), jnp.zeros(self.worlds, jnp.int32)
        obs = self._obs(x, length)
        return ToyState(
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
        self.calls += 1
        assert [a.shape for a in actions] == [
            (self.worlds, len(g.agents), g.action_size) for g in self.groups
        ], [a.shape for a in actions]
        x = tuple(p + 0.1 * a[..., 0] for p, a in zip(state.memory["x"], actions, strict=True))
        length, score = state.length + 1, state.score + x[0][:, 0]
        ended = x[0][:, 0] > END
        truncated = ~ended & (length >= self.episode_steps)
        done = ended | truncated
        episode = state.batch["episode"] + done
        fresh = self._start(state.memory["number"], episode)
        final_obs, pick = self._obs(x, length), partial(_pick, done)
        now, left = jax.tree.map(pick, fresh, x), jnp.where(done, 0, length)
        return state.replace(
            batch={**state.batch, "episode": episode},
            memory={**state.memory, "x": now},
            obs=self._obs(now, left),
            privileged=now[0][:, :1],
            reward=x,
            done=done,
            truncated=truncated,
            final_obs=final_obs,
            final_privileged=x[0][:, :1],
            score=jnp.where(done, 0.0, score),
            final_score=jnp.where(done, score, state.final_score),
            length=left,
            bad=jnp.zeros(self.worlds, bool),
            metrics={"way": x[0][:, 0]},
        )


def _pick(done, new, old):
    return jnp.where(done.reshape(-1, *[1] * (new.ndim - 1)), new, old)
