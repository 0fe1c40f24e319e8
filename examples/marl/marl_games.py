"""Small games with a known best score, to test the algorithms beside this file in seconds.

They have the part of `usarmjx.Env` that the algorithms use. Every step an agent's action should be its
target; the score of an episode is 1 less the mean squared distance, so 1 is the best. Targets are -0.8 or 0.8
with equal chance: an agent that does not know its target does best with 0, and its score is 1 - 0.64 = 0.36.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from usarmjx.train import AgentGroup

FAR = 0.8
BLIND = 1.0 - FAR**2
"""Best score without knowledge of the target."""
MATE_FEATURES = 2
"""Numbers about each team mate: whether there is a link, and whether it is a speaker."""


class GameState(struct.PyTreeNode, kw_only=True):
    """State of all worlds; fields are those of the environment's state.

    Attributes:
        key: Random key.
        target: Targets (worlds, agents).
        total: Sum of the scores of the episode's steps (worlds,).
    """

    key: jax.Array
    target: jax.Array
    total: jax.Array
    length: jax.Array
    obs: tuple[jax.Array, ...]
    privileged: jax.Array
    reward: tuple[jax.Array, ...]
    done: jax.Array
    truncated: jax.Array
    final_obs: tuple[jax.Array, ...]
    final_privileged: jax.Array
    final_score: jax.Array
    bad: jax.Array


class Game:
    """Agents see their targets.

    Attributes:
        knows: Which agents see the target, and until which step of an episode.
    """

    name, period, traceable, episode_steps = "match", 0.2, True, 4
    mates_at = 3
    own_targets, speakers, shown_until = True, 99, 99

    def __init__(self, worlds: int, agents: int = 3) -> None:
        self.worlds, self.agents = worlds, agents
        size = self.mates_at + MATE_FEATURES * (agents - 1)
        self.groups = (AgentGroup("P2AT", tuple(f"P2AT{i}" for i in range(agents)), size, 1),)
        self.privileged_size = agents
        self.step = jax.jit(self._step)

    def _draw(self, key: jax.Array) -> jax.Array:
        shape = (self.worlds, self.agents if self.own_targets else 1)
        signs = jnp.where(jax.random.bernoulli(key, 0.5, shape), FAR, -FAR)
        return jnp.broadcast_to(signs, (self.worlds, self.agents))

    def _see(self, target: jax.Array, length: jax.Array) -> jax.Array:
        speaks = jnp.arange(self.agents) < self.speakers
        shown = speaks & (length < self.shown_until)[:, None]
        other = jnp.array([[j for j in range(self.agents) if j != i] for i in range(self.agents)], int)
        mates = jnp.stack([jnp.ones(other.shape), speaks[other]], -1).reshape(self.agents, -1)
        mates = jnp.broadcast_to(mates, (self.worlds, *mates.shape))
        time = jnp.broadcast_to((length / self.episode_steps)[:, None], target.shape)
        own = [jnp.where(shown, target, 0.0), time, jnp.broadcast_to(speaks, target.shape)]
        return jnp.concatenate([jnp.stack(own, -1), mates], -1).astype(jnp.float32)

    def reset(self, seed: int) -> GameState:
        """Return all worlds at the start."""
        key, own = jax.random.split(jax.random.key(seed))
        target, zero = self._draw(own), jnp.zeros(self.worlds)
        obs, no = (self._see(target, zero),), jnp.zeros(self.worlds, bool)
        return GameState(
            key=key, target=target, total=zero, length=jnp.zeros(self.worlds, jnp.int32), obs=obs,
            privileged=target,
            reward=(jnp.zeros_like(target),), done=no, truncated=no, final_obs=obs, final_privileged=target,
            final_score=zero, bad=no,
        )  # fmt: skip

    def _reward(self, close: jax.Array) -> jax.Array:
        return close

    def _points(self, reward: jax.Array) -> jax.Array:
        return reward.mean(1)

    def _step(self, state: GameState, actions: tuple[jax.Array, ...]) -> GameState:
        reward = self._reward(1.0 - (jnp.clip(actions[0][..., 0], -1.0, 1.0) - state.target) ** 2)
        length, total = state.length + 1, state.total + self._points(reward)
        done = length >= self.episode_steps
        key, own = jax.random.split(state.key)
        target = jnp.where(done[:, None], self._draw(own), state.target)
        final, begun = self._see(state.target, length), jnp.where(done, 0, length)
        return state.replace(
            key=key, target=target, total=jnp.where(done, 0.0, total), length=begun,
            obs=(self._see(target, begun),), privileged=target, reward=(reward,), done=done,
            truncated=jnp.zeros_like(done), final_obs=(final,), final_privileged=state.target,
            final_score=jnp.where(done, total / self.episode_steps, state.final_score),
        )  # fmt: skip


class Recall(Game):
    """Agents see their targets in the first of four steps only: without memory the best is 0.52."""

    name, shown_until = "recall", 1


class Whisper(Game):
    """One agent sees the target of all; the others get it by a message only.

    Without messages the best score is (1 + (agents - 1) 0.36) / agents.
    """

    name, own_targets, speakers = "whisper", False, 1


class Duel(Game):
    """Half of the agents plays against the other half: a team gains what it is closer than the other.

    The score is that of the first half: 0 between equals, 0.64 against a team that does nothing.
    """

    name = "duel"

    def __init__(self, worlds: int, agents: int = 4) -> None:
        super().__init__(worlds, agents)

    def _reward(self, close: jax.Array) -> jax.Array:
        first, second = (close[:, half].mean(1, keepdims=True) for half in self._halves)
        return jnp.concatenate([close[:, self._halves[0]] - second, close[:, self._halves[1]] - first], 1)

    def _points(self, reward: jax.Array) -> jax.Array:
        return reward[:, self._halves[0]].mean(1)

    @property
    def _halves(self) -> tuple[slice, slice]:
        return slice(self.agents // 2), slice(self.agents // 2, None)


GAMES: dict[str, Callable[..., Any]] = {one.name: one for one in (Game, Recall, Whisper, Duel)}
