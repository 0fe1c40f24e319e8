"""A task in a batch of worlds: functional reset and step, brax's way."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.batch import Batch, choose
from usarmjx.engines import PhysicsState
from usarmjx.errors import UsageError
from usarmjx.models.arena_set import Site
from usarmjx.radio import present_links
from usarmjx.sensors.base import Reading
from usarmjx.train.orders import carry_out
from usarmjx.train.recipe import Generated
from usarmjx.train.task import TASK_STREAM, Task, Verdict, View
from usarmjx.world import Status, World, episode_key, first_episode, observe

Array = jax.Array


@dataclass(frozen=True)
class AgentGroup:
    """Robots of one class that share a policy.

    Attributes:
        name: Robot class.
        agents: Names of the robots.
        obs_size: Numbers in an observation.
        action_size: Numbers in an action, each from -1 to 1.
    """

    name: str
    agents: tuple[str, ...]
    obs_size: int
    action_size: int


class EnvState(struct.PyTreeNode, kw_only=True):
    """A batch of worlds at work on a task.

    Attributes:
        batch: The worlds.
        memory: The task's own (worlds, ...).
        obs: What the agents see, per group (worlds, robots, obs_size).
        privileged: What only critics see (worlds, privileged_size).
        reward: Of the step, per group (worlds, robots); 0 in bad worlds.
        done: Whether the episode ended with this step; the world has started the next one (worlds,).
        truncated: Whether that was because the time was up, and for no other reason (worlds,).
        final_obs: As `obs`, before the restart; the same where not done.
        final_privileged: As `privileged`, before the restart.
        score: The score of the running episode (worlds,).
        final_score: The score of the last episode that ended; where done, of the one that ended now
            (worlds,).
        length: Steps of the running episode (worlds,).
        bad: Whether the physics went wrong in this step (worlds,): not finite, or contacts lost. Such an
            episode is done; its last transition is not to be learned from.
        metrics: As judged in this step, before any restart (worlds,).
        level: How difficult the arenas in play are, from 0 to 1 (); see `Env.at_level`.
    """

    batch: Any
    memory: Any
    obs: tuple[Array, ...]
    privileged: Array
    reward: tuple[Array, ...]
    done: Array
    truncated: Array
    final_obs: tuple[Array, ...]
    final_privileged: Array
    score: Array
    final_score: Array
    length: Array
    bad: Array
    metrics: dict[str, Array]
    level: Array | None = None


class Opening(struct.PyTreeNode, kw_only=True):
    """What an episode begins with."""

    memory: Any
    obs: tuple[Array, ...]
    privileged: Array
    score: Array
    length: Array


class Env:
    """A task in many worlds. Its functions are pure where the engine can be traced.

    Args:
        task: The task.
        worlds: How many.
        engine: `warp`, `jax`, `c`, or `auto`.
        seed: Of all random numbers, unless `reset` is given another.
        first: Number of the first world. World k is the same alone as in a batch.

    Attributes:
        name: Of the task.
        groups: The agents.
        privileged_size: Numbers that only critics see.
        episode_steps: Steps after which the time is up.
        period: Simulated time of a step [s].
        traceable: Whether `step` may be traced (jit, scan); else it is called step by step, its inner
            parts compiled.

    Raises:
        UsageError: The task cannot be built, or not run on this engine.
    """

    def __init__(
        self, task: Task, worlds: int, *, name: str = "", engine: str = "auto", seed: int = 0, first: int = 0
    ) -> None:
        if task.repeat < 1 or task.episode_steps < 1:
            raise UsageError(
                f"repeat {task.repeat}, episode_steps {task.episode_steps}: both must be at least 1"
            )
        self.task, self.name = task, name or type(task).__name__
        self.scene = task.scene()
        self.batch = Batch(self.scene, worlds, engine=engine, seed=seed, first=first, shuffle=task.shuffle)
        self.worlds, self.traceable = worlds, self.batch.engine.traceable
        self.episode_steps, self.period = task.episode_steps, task.repeat * self.scene.physics.period
        self.seed = seed
        arenas = task.arenas
        self._levels = arenas if isinstance(arenas, Generated) else None
        self._tell = self._compile(jax.vmap(self._told))
        self._open = self._compile(jax.vmap(self._opened))
        self._finish = self._compile(self._finished)
        self._reopen = self._compile(self._reopened)
        self._library = self._compile(self._library_at)
        self.step: Callable[[EnvState, tuple[Array, ...]], EnvState] = (
            self._compile(self._step) if self.traceable else self._step
        )
        """Advance every world by one action, per group (worlds, robots, action_size).

        Numbers beyond +-1 count as +-1, those that are not numbers as 0.
        """
        self.groups, self.privileged_size, self._metrics = self._shapes()

    @staticmethod
    def _compile(function: Callable[..., Any]) -> Callable[..., Any]:
        return jax.jit(jax.default_matmul_precision("highest")(function))

    def _shapes(self) -> tuple[tuple[AgentGroup, ...], int, tuple[str, ...]]:
        """Return the agents, the size of `privileged` and the names of the metrics."""
        scene, task = self.scene, self.task

        def once(key: Array) -> tuple[Opening, Verdict]:
            sites = None if scene.arenas is None else jax.tree.map(jnp.asarray, scene.arenas.sites)
            world, qpos = first_episode(scene, key, jnp.int32(0), sites, shuffle=task.shuffle)
            model = scene.model
            physics = PhysicsState(qpos=qpos, qvel=jnp.zeros(model.nv), act=jnp.zeros(model.na))
            world, opening = self._opened(world, physics)
            return opening, task.judge(self._look(world, physics)[1], opening.memory)

        opening, verdict = jax.eval_shape(once, jax.random.key(0))
        groups = []
        for number, obs, actions in zip(
            task.groups(scene), opening.obs, task.action_sizes(scene), strict=True
        ):
            team = scene.teams[number]
            names = tuple(scene.roster[slot].name or f"{team.robot.name}{slot}" for slot in team.slots)
            groups.append(AgentGroup(team.robot.name, names, obs.shape[-1], actions))
        return tuple(groups), opening.privileged.shape[-1], tuple(verdict.metrics)

    # What follows up to `_reopened` is traced; the first four are of one world.

    def _look(self, world: World, physics: PhysicsState) -> tuple[World, View]:
        """Read sensors and links."""
        world, readings = observe(self.scene, world, physics)
        if self.scene.radio is not None:
            world = world.replace(links=present_links(self.scene, world, physics))
        return world, View(world=world, physics=physics, readings=readings, scene=self.scene)

    def _see(self, view: View, memory: Any) -> tuple[tuple[Array, ...], Array]:  # noqa: ANN401
        """Return what agents and critics see."""
        obs = tuple(jnp.asarray(seen, jnp.float32) for seen in self.task.observe(view, memory))
        return obs, jnp.asarray(self.task.privileged(view, memory), jnp.float32)

    def _opened(self, world: World, physics: PhysicsState) -> tuple[World, Opening]:
        """Begin an episode."""
        world, view = self._look(world, physics)
        memory = self.task.start(view, episode_key(world, TASK_STREAM))
        obs, privileged = self._see(view, memory)
        zero = jnp.zeros((), jnp.int32)
        return world, Opening(memory=memory, obs=obs, privileged=privileged, score=jnp.zeros(()), length=zero)

    def _told(self, world: World, physics: PhysicsState, memory: Any, actions: tuple[Array, ...]) -> World:  # noqa: ANN401
        """Give the robots their orders."""
        told = tuple(jnp.clip(jnp.where(jnp.isfinite(a), a, 0.0), -1.0, 1.0) for a in actions)
        last = tuple(
            tuple(
                Reading(value=value, fresh=jnp.zeros(state.active.shape, bool)) for value in state.memory.last
            )
            for state in world.teams
        )
        view = View(world=world, physics=physics, readings=last, scene=self.scene)
        return carry_out(self.scene, world, physics, self.task.act(view, memory, told))

    def _finished(
        self, state: EnvState, worlds: World, physics: PhysicsState, before: Status
    ) -> tuple[World, EnvState]:
        """Judge a step of all worlds; `state` is that before it, without its batch."""
        now = worlds.status
        bad = (now.not_finite > before.not_finite) | (now.overflow > before.overflow)
        worlds, views = jax.vmap(self._look)(worlds, physics)
        verdict = jax.vmap(self.task.judge)(views, state.memory)
        obs, privileged = jax.vmap(self._see)(views, verdict.memory)
        length = state.length + 1
        terminated, late = verdict.terminated & ~bad, length >= self.episode_steps
        done = terminated | late | bad
        score = jnp.where(bad, state.score, verdict.score)
        return worlds, state.replace(
            memory=verdict.memory,
            obs=obs,
            privileged=privileged,
            reward=tuple(jnp.where(bad[:, None], 0.0, reward) for reward in verdict.reward),
            done=done,
            truncated=late & ~terminated & ~bad,
            final_obs=obs,
            final_privileged=privileged,
            score=score,
            final_score=jnp.where(done, score, state.final_score),
            length=length,
            bad=bad,
            metrics={name: jnp.asarray(verdict.metrics[name], jnp.float32) for name in self._metrics},
        )

    def _reopened(self, state: EnvState, worlds: World, physics: PhysicsState) -> tuple[World, EnvState]:
        """Begin an episode in the worlds that are done; `state` is without its batch."""
        fresh, opening = jax.vmap(self._opened)(worlds, physics)
        here = partial(choose, state.done)
        changed = {
            name: jax.tree.map(here, getattr(opening, name), getattr(state, name))
            for name in ("memory", "obs", "privileged", "score", "length")
        }
        return jax.tree.map(here, fresh, worlds), state.replace(**changed)

    def _library_at(self, library: Site, level: Array) -> Site:
        """Return a library in which only the arenas in play are, over and over."""
        assert self._levels is not None  # as the caller says
        easy = (jnp.array(self._levels.levels) <= level + 1e-6).sum()
        places = jnp.arange(len(library.starts)) % (self._levels.count * jnp.maximum(easy, 1))
        return jax.tree.map(lambda rows: rows[places], library)

    def _arenas(self, level: Array) -> Site | None:
        if self._levels is None or self.scene.arenas is None:
            return None
        return self._library(jax.tree.map(jnp.asarray, self.scene.arenas.sites), level)

    def reset(self, seed: int | None = None, level: float = 1.0) -> EnvState:
        """Return all worlds at the start of their first episode.

        Args:
            seed: Of all random numbers; None: the environment's own.
            level: How difficult the generated arenas in play are, from 0 to 1; see `at_level`.
        """
        level_now = jnp.float32(level)
        batch = self.batch.reset(self.seed if seed is None else seed, self._arenas(level_now))
        worlds, opening = self._open(batch.worlds, self.batch.physics(batch))
        no = jnp.zeros(self.worlds, bool)
        zero = jnp.zeros(self.worlds)
        return EnvState(
            batch=batch.replace(worlds=worlds),
            memory=opening.memory,
            obs=opening.obs,
            privileged=opening.privileged,
            reward=tuple(jnp.zeros((self.worlds, len(group.agents))) for group in self.groups),
            done=no,
            truncated=no,
            final_obs=opening.obs,
            final_privileged=opening.privileged,
            score=opening.score,
            final_score=zero,
            length=opening.length,
            bad=no,
            metrics=dict.fromkeys(self._metrics, zero),
            level=level_now,
        )

    def at_level(self, state: EnvState, level: float | Array) -> EnvState:
        """Return the state with other generated arenas in play: worlds meet them at their next reset.

        Those are in play whose difficulty is at most the level, and always the easiest. Nothing is compiled
        again. Other arenas than generated ones have no levels: there it changes nothing.
        """
        level = jnp.asarray(level, jnp.float32)
        library = self._arenas(level)
        batch = state.batch if library is None else state.batch.replace(library=library)
        return state.replace(batch=batch, level=level)

    def _step(self, state: EnvState, actions: tuple[Array, ...]) -> EnvState:
        self._check(actions)
        batch, before = state.batch, state.batch.worlds.status
        worlds = self._tell(batch.worlds, self.batch.physics(batch), state.memory, actions)
        batch = self.batch.run(batch.replace(worlds=worlds), self.task.repeat)
        worlds, state = self._finish(
            state.replace(batch=None), batch.worlds, self.batch.physics(batch), before
        )
        state = state.replace(batch=batch.replace(worlds=worlds))
        if self.traceable:
            return jax.lax.cond(state.done.any(), self._restart, lambda s: s, state)
        return self._restart(state) if np.asarray(state.done).any() else state

    def _restart(self, state: EnvState) -> EnvState:
        batch = self.batch.reset_where(state.batch, state.done)
        worlds, state = self._reopen(state.replace(batch=None), batch.worlds, self.batch.physics(batch))
        return state.replace(batch=batch.replace(worlds=worlds))

    def _check(self, actions: tuple[Array, ...]) -> None:
        """Refuse actions of another shape."""
        wanted = [(self.worlds, len(group.agents), group.action_size) for group in self.groups]
        given = [tuple(np.shape(action)) for action in actions]
        if given != wanted:
            raise UsageError(f"actions of shapes {given}, expected {wanted}: one array per group")
