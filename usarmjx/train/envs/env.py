"""A task in a batch of worlds: functional reset and step, brax's way."""

import math
from collections.abc import Callable, Sequence
from dataclasses import fields
from functools import cached_property, partial
from typing import Any, get_args

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base import random
from usarmjx.base.backend import Array, jax_entry_points, traced_once
from usarmjx.base.compilation import NOTICE, enable_cache_after_import
from usarmjx.base.errors import UnsupportedFeatureError, UsageError
from usarmjx.base.program_cache import ProgramCache, compile_program, open_program_cache
from usarmjx.base.tables import facts_line, facts_table
from usarmjx.engines import PhysicsState, choose_engine, engine_class
from usarmjx.models.compile.arena_set import ArenaState
from usarmjx.sensors.base import Reading
from usarmjx.sim.actions import Actions, apply_actions
from usarmjx.sim.batch import Batch, BatchState, select_worlds
from usarmjx.sim.radio import update_links
from usarmjx.sim.reset import init_world, reset
from usarmjx.sim.scene import Scene
from usarmjx.sim.world import FaultCounts, Stream, World, episode_key, observe
from usarmjx.train.envs.presence import (
    alive_agents,
    begin_team,
    come_and_go,
    masked,
    regroup,
    share_alive,
)
from usarmjx.train.envs.recipe import GeneratedArenas
from usarmjx.train.envs.state import AgentGroup, EnvState, EpisodeStart, Memory, Restart, TaskState
from usarmjx.train.envs.task import StepResult, Task, TaskView, TimeLimit

ALIVE = "alive"
"""Metric of tasks with `Task.presence`: share of the agents that are alive."""
SCATTER_MIN_SIZE = 1024
"""Least size of a leaf per world [numbers] whose rows are scattered. Of smaller leaves all worlds' are
written again: a GPU has one kernel for many such, and for each that writes rows one of its own."""


@traced_once()
def _read(scene: Scene, world: World, physics: PhysicsState) -> tuple[World, tuple[tuple[Reading, ...], ...]]:
    """Read sensors and links; return also the readings per group and sensor."""
    world, readings = observe(scene, world, physics)
    if scene.radio is not None:
        world = world.replace(links=update_links(scene, world, physics))
    return world, readings


def make_view(scene: Scene, world: World, physics: PhysicsState) -> tuple[World, TaskView]:
    """Read sensors and links."""
    world, readings = _read(scene, world, physics)
    return world, TaskView(world=world, physics=physics, readings=readings, scene=scene)


@jax.named_scope("task.observe")
def _observe(
    task: Task, view: TaskView, memory: Memory, alive: tuple[jax.Array, ...] | None = None
) -> tuple[tuple[jax.Array, ...], jax.Array]:
    """Return the observations of agents and critics, who know which agents are alive."""
    obs = tuple(jnp.asarray(one, jnp.float32) for one in task.observe(view, memory))
    privileged = jnp.asarray(task.privileged(view, memory), jnp.float32)
    if alive is not None:
        privileged = jnp.concatenate([privileged, *(one.astype(jnp.float32) for one in alive)])
    return masked(alive, obs), privileged


def all_finite(values: Sequence[Array]) -> jax.Array:
    """Return in which worlds all numbers are finite (worlds,), of arrays (worlds, ...)."""
    return jnp.stack([jnp.isfinite(one).reshape(len(one), -1).all(1) for one in values]).all(0)


def finite_or_zero(values: jax.Array) -> jax.Array:
    """Return the values, with 0 where one is not finite."""
    return jnp.where(jnp.isfinite(values), values, 0.0)


@traced_once("task")
def start_episode(
    scene: Scene, task: Task, world: World, physics: PhysicsState
) -> tuple[World, EpisodeStart]:
    """Begin an episode."""
    world, view = make_view(scene, world, physics)
    memory = task.start(view, jnp.asarray(episode_key(world, Stream.TASK_START)))
    presence = task.presence(view, memory)
    alive = None if presence is None else alive_agents(task, view, presence)
    obs, privileged = _observe(task, view, memory, alive)
    unsound = jnp.stack([~jnp.isfinite(one).all() for one in (*obs, privileged)]).any()
    # Counted, not raised: a compiled program cannot raise, and the other worlds are sound.
    world = world.replace(faults=world.faults.replace(task=world.faults.task + unsound))
    obs, privileged = jax.tree.map(finite_or_zero, (obs, privileged))
    zero = jnp.zeros((), jnp.int32)
    return world, EpisodeStart(
        memory=memory, obs=obs, privileged=privileged, score=jnp.zeros(()), length=zero, alive=alive
    )


def command(
    task: Task,
    view: TaskView,
    memory: Memory,
    actions: tuple[Array, ...],
    alive: tuple[jax.Array, ...] | None = None,
) -> tuple[Actions, Memory]:
    """Return the commands of actions per group (robots, action_size), and the task's memory of them."""
    bounded = _bounded(actions, alive)
    if task.decides:
        memory = task.decide(view, memory, bounded)
    return task.act(view, memory, bounded), memory


def apply_policy_actions(
    scene: Scene,
    task: Task,
    world: World,
    physics: PhysicsState,
    memory: Memory,
    actions: tuple[Array, ...],
    alive: tuple[jax.Array, ...] | None = None,
) -> tuple[World, Memory]:
    """Command the robots, from a policy's actions per group (robots, action_size); see `command`."""
    commands, memory = command(task, _view_at_action(scene, world, physics), memory, actions, alive)
    return apply_actions(scene, world, physics, commands), memory


def _bounded(actions: tuple[Array, ...], alive: tuple[jax.Array, ...] | None) -> tuple[jax.Array, ...]:
    """Return finite actions from -1 to 1, 0 for agents that are not alive."""
    # NaN first: clip passes it on.
    return masked(alive, tuple(jnp.clip(jnp.where(jnp.isfinite(a), a, 0.0), -1.0, 1.0) for a in actions))


def _view_at_action(scene: Scene, world: World, physics: PhysicsState) -> TaskView:
    # Sensors are read once a step, at its end: actions are chosen and carried out on what was read then.
    # Nothing is fresh: a task that draws scans into maps has drawn these already.
    last = tuple(
        tuple(Reading(value=value, fresh=jnp.zeros(state.active.shape, bool)) for value in state.memory.last)
        for state in world.groups
    )
    return TaskView(world=world, physics=physics, readings=last, scene=scene)


def evaluate_step(
    scene: Scene, task: Task, state: TaskState, worlds: World, physics: PhysicsState, before: FaultCounts
) -> tuple[World, TaskState, jax.Array | None]:
    """Evaluate a step of all worlds, and observe.

    Args:
        scene: The scene.
        task: The task.
        state: State of the task before the step.
        worlds: The worlds after it.
        physics: Their physics.
        before: Counts of faults before the step.

    Returns:
        The worlds, the state of the task, and which robots are present from now on (worlds, robots); None:
        all.
    """
    now = worlds.faults
    # Counts, compared with those before: a flag would stay up after the fault.
    bad = (now.not_finite > before.not_finite) | (now.overflow > before.overflow)
    worlds, views = jax.vmap(partial(make_view, scene))(worlds, physics)
    with jax.named_scope("task.evaluate"):
        result = jax.vmap(task.evaluate)(views, state.memory)
    alive, present = _presence(task, state, views, result.memory)
    obs, privileged = jax.vmap(partial(_observe, task))(views, result.memory, alive)
    # A task's own NaN would spread from a learner's weights to everything.
    unsound = ~all_finite((*result.reward, result.score, *obs, privileged))
    # Blamed on the task only where the physics was sound: NaN there spreads into every reward.
    worlds = worlds.replace(faults=worlds.faults.replace(task=worlds.faults.task + (unsound & ~bad)))
    bad |= unsound
    obs, privileged = jax.tree.map(finite_or_zero, (obs, privileged))
    length = state.length + 1
    terminated, late = result.terminated & ~bad, length >= task.episode_steps
    done = terminated | late | bad
    # A bad step's score is not known: the last good one stands.
    score = jnp.where(bad, state.score, result.score)
    metrics = result.metrics if alive is None else {**result.metrics, ALIVE: share_alive(alive)}
    after = state.replace(
        memory=result.memory,
        obs=obs,
        privileged=privileged,
        # By the agents alive before the step: one that has just died gets the reward of its last step.
        reward=tuple(jnp.where(bad[:, None], 0.0, reward) for reward in masked(state.alive, result.reward)),
        done=done,
        # With `end` the time limit is part of the task: the state at it has no further value.
        truncated=late & ~terminated & ~bad & (task.time_limit == "truncation"),
        final_obs=obs,
        final_privileged=privileged,
        score=score,
        final_score=jnp.where(done, score, state.final_score),
        length=length,
        bad=bad,
        # A loop over steps must keep its types, and the blank state has metrics of this one.
        metrics={name: jnp.asarray(value, jnp.float32) for name, value in metrics.items()},
        alive=alive,
        final_alive=alive,
    )
    return worlds, after, present


def _presence(
    task: Task, state: TaskState, views: TaskView, memory: Memory
) -> tuple[tuple[jax.Array, ...] | None, jax.Array | None]:
    """Return which agents are alive, per group, and which robots are present, by slot (worlds, robots).

    Both are None for tasks in which all always are.
    """
    if state.alive is None:
        return None, None

    def one(view: TaskView, memory: Memory) -> tuple[tuple[jax.Array, ...], jax.Array]:
        presence = task.presence(view, memory)
        assert presence is not None  # as it was at the start
        return alive_agents(task, view, presence), presence.present

    return jax.vmap(one)(views, memory)


@jax.named_scope("restart")
def restart_subset(
    scene: Scene, task: Task, together: int, now: Restart, arenas: ArenaState | None
) -> Restart:
    """Begin an episode in the first worlds of those that are left; only they are computed.

    Args:
        scene: The scene.
        task: The task.
        together: Number of worlds; where fewer are left, some of the others are computed for nothing.
        now: All worlds, and which are left.
        arenas: See `sim.reset.reset`.
    """
    number = jnp.cumsum(now.left)  # of worlds that are left, up to each world
    # Of fixed size, as compiled shapes are. Surplus rows get indices from len(left) on: reads clip, writes
    # drop them.
    rows = _distinct(jnp.searchsorted(number, np.arange(together) + 1, method="scan_unrolled"), len(now.left))
    some = jax.tree.map(lambda old: old.at[rows].get(mode="clip"), now.worlds)
    fresh, qpos = jax.vmap(partial(reset, scene, shuffle=task.shuffle), in_axes=(0, None))(some, arenas)
    still = [jnp.zeros((together, size), jnp.float32) for size in (scene.model.nv, scene.model.na)]
    physics = PhysicsState(qpos=qpos, qvel=still[0], act=still[1])
    fresh, qpos = jax.vmap(partial(begin_team, scene, task))(fresh, jnp.asarray(qpos))
    fresh, begun = jax.vmap(partial(start_episode, scene, task))(fresh, physics)

    # The inverse of `rows`: the fresh episode that each world takes; `together`: none.
    begins = now.left & (number <= together)
    place = jnp.where(begins, number - 1, together)

    def put(old: jax.Array, new: jax.Array) -> jax.Array:
        if old[0].size > SCATTER_MIN_SIZE:
            # Sorted and each once: else a GPU writes with atomic operations.
            return old.at[rows].set(new, mode="drop", indices_are_sorted=True, unique_indices=True)
        return select_worlds(begins, new.at[place].get(mode="clip"), old)

    return Restart(
        worlds=jax.tree.map(put, now.worlds, fresh),
        begun=jax.tree.map(put, now.begun, begun),
        qpos=put(now.qpos, jnp.asarray(qpos)),
        left=now.left & ~begins,
    )


def _distinct(rows: jax.Array, worlds: int) -> jax.Array:
    """Return sorted rows in which those beyond the last of some worlds, which may be equal, count up."""
    return jnp.where(rows < worlds, rows, worlds + np.arange(len(rows)))


def restart_batch_size(worlds: int, episode_steps: int) -> int:
    """Return the number of worlds that begin an episode at once; further ones follow in another such batch.

    As many as end with a step if their ends are spread and episodes last half their time, and three standard
    deviations more (Poisson's).

    Args:
        worlds: In the environment.
        episode_steps: Steps after which the time is up.
    """
    ends = 2 * worlds / episode_steps
    return min(worlds, math.ceil(ends + 3 * math.sqrt(ends)))


def env_program_cache(task: Task, scene: Scene, worlds: int, engine: str, first: int) -> ProgramCache | None:
    """Return an environment's program cache, see `open_program_cache`; arguments as for `Env`."""
    if choose_engine(engine, "batch") == "warp":
        return None  # MuJoCo Warp's launches mean nothing to another process
    # All of the scene but what its model was compiled from.
    within = {one.name: getattr(scene, one.name) for one in fields(scene) if one.name != "spec"}
    return open_program_cache(task, within, worlds, engine, first)


class EnvBatch(Batch):
    """A batch whose programs are kept with those of its environment; arguments are those of `Batch`.

    Args:
        program_cache: Cache of programs; its digest covers all arguments of the batch.
    """

    def __init__(self, program_cache: ProgramCache | None, *args: Any, **settings: Any) -> None:  # noqa: ANN401
        # First: programs look for it while the batch is built.
        self._program_cache = program_cache
        super().__init__(*args, **settings)


@jax_entry_points
class Env:
    """A task in many worlds. Its functions are pure where the engine can be traced.

    Args:
        task: The task.
        worlds: Number of worlds.
        name: Name of the task.
        engine: `warp`, `jax`, `c`, or `auto`.
        seed: Seed of all random numbers, unless `reset` gets another.
        first: Number of the first world. World k is the same alone as in a batch.

    Attributes:
        name: Name of the task.
        first: Number of the first world.
        episode_steps: Steps after which the time is up.
        period: Simulated time of a step [s].
        levels: Difficulties of its generated arenas, from easy to hard; empty: they are not generated.
        program_cache: Cache of its programs, if they are kept from one start to the next.
        renewable: Whether its arenas can be replaced by other generated ones, see `redrawn_arenas`.
        traceable: Whether `step` may be traced (jit, scan); else it is called step by step, its inner
            parts compiled.

    Raises:
        UsageError: The task cannot be built, or not run on this engine.
        UnsupportedFeatureError: It needs something that this engine does not do.
    """

    def __init__(
        self, task: Task, worlds: int, *, name: str = "", engine: str = "auto", seed: int = 0, first: int = 0
    ) -> None:
        if task.repeat < 1 or task.episode_steps < 1:
            raise UsageError(
                f"repeat {task.repeat}, episode_steps {task.episode_steps}: both must be at least 1"
            )
        if task.time_limit not in get_args(TimeLimit):
            raise UsageError(f"time_limit {task.time_limit!r}, expected {' or '.join(get_args(TimeLimit))}")
        self.task, self.name = task, name or type(task).__name__
        if task.needs_solver and not engine_class(choose_engine(engine, "batch")).has_solver:
            raise UnsupportedFeatureError(
                f"engine {engine!r} cannot run {self.name}, which needs {task.needs_solver}; "
                "engines c, jax and warp can"
            )
        self.scene = task.scene()
        enable_cache_after_import()
        self.program_cache = env_program_cache(task, self.scene, worlds, engine, first)
        settings = {"engine": engine, "seed": seed, "first": first, "shuffle": task.shuffle}
        self.batch = EnvBatch(self.program_cache, self.scene, worlds, **settings)
        NOTICE.expect(f"{self.name} (worlds={worlds}, engine={engine!r})")
        self.worlds, self.traceable = worlds, self.batch.engine.traceable
        self.episode_steps, self.period = task.episode_steps, task.repeat * self.scene.physics.period
        self.seed = seed
        arenas = task.arenas
        self._generated = arenas if isinstance(arenas, GeneratedArenas) else None
        self.levels = arenas.levels if isinstance(arenas, GeneratedArenas) else ()
        self.renewable = self._generated is not None and self._generated.renewable
        self.first = first
        self._act = self._compile(jax.vmap(partial(apply_policy_actions, self.scene, task)))
        self._evaluate = self._compile(partial(evaluate_step, self.scene, task))
        self._regroup = self._compile(jax.vmap(partial(regroup, self.scene, task.shuffle)))
        self._blank = self._compile(self._blank_state)
        together = restart_batch_size(worlds, task.episode_steps)
        self._restart_some = self._compile(partial(restart_subset, self.scene, task, together))
        self._library = self._compile(self._library_at)
        # As they are for engines on the host, which cannot be traced; their inner parts are compiled above.
        self._step_program, self._restart = self._step, self._restart_where
        self._advance_program = self._advance
        if self.traceable:
            self._step_program = self._compile(self._step)
            self._advance_program = self._compile(self._advance)
            self._restart = self._compile(self._restart_where)

    @cached_property
    def _known_shapes(self) -> tuple[tuple[World, EpisodeStart], tuple[str, ...]]:
        # Tracing takes a second or more, which a served world does not need.
        if self.program_cache is None:
            return self._shapes()
        return self.program_cache.value("Env._shapes", self._shapes)

    @cached_property
    def groups(self) -> tuple[AgentGroup, ...]:
        """The agents."""
        return self._agents()

    @property
    def privileged_size(self) -> int:
        """Numbers that only critics see."""
        return self._known_shapes[0][1].privileged.shape[-1]

    @property
    def facts(self) -> dict[str, object]:
        """Facts of the environment by name, for display."""
        agents = ", ".join(
            f"{len(group.agents)} {group.name} ({group.obs_size} numbers, {group.action_size} actions)"
            for group in self.groups
        )
        length = f"{self.episode_steps} steps of {self.period:g} s"
        engine = type(self.batch.engine).__name__
        return {
            "task": self.name,
            "worlds": self.worlds,
            "engine": engine,
            "agents": agents,
            "episode": length,
        }

    def __repr__(self) -> str:
        """Return a short line: the task, the worlds, the agents."""
        return facts_line("Env", self.facts)

    def _repr_html_(self) -> str:
        return facts_table("Env", self.facts)

    def _compile(self, function: Callable[..., Any]) -> Callable[..., Any]:
        return compile_program(function, self.program_cache, "Env")

    def _shapes(self) -> tuple[tuple[World, EpisodeStart], tuple[str, ...]]:
        """Return the shapes of a world and of what its episode begins with, and the metrics' names."""
        scene, task = self.scene, self.task

        def once(key: jax.Array) -> tuple[World, EpisodeStart, StepResult]:
            arenas = None if scene.arenas is None else jax.tree.map(jnp.asarray, scene.arenas.states)
            world, qpos = init_world(scene, key, jnp.int32(0), arenas, shuffle=task.shuffle)
            model = scene.model
            physics = PhysicsState(qpos=qpos, qvel=jnp.zeros(model.nv), act=jnp.zeros(model.na))
            world, begun = start_episode(scene, task, world, physics)
            return world, begun, task.evaluate(make_view(scene, world, physics)[1], begun.memory)

        with jax.default_matmul_precision("highest"):  # else what is compiled later is traced anew
            world, begun, result = jax.eval_shape(once, jax.random.key(0))
        return (world, begun), (*result.metrics, *([] if begun.alive is None else [ALIVE]))

    def _agents(self) -> tuple[AgentGroup, ...]:
        scene, task = self.scene, self.task
        groups: list[AgentGroup] = []
        for number, obs, actions in zip(
            task.agent_groups(scene), self._known_shapes[0][1].obs, task.action_sizes(scene), strict=True
        ):
            group = scene.groups[number]
            names = tuple(scene.roster[int(slot)].name or f"{group.robot.name}{slot}" for slot in group.slots)
            known = (names, obs.shape[-1], actions, task.discrete, task.layout(scene), task.vector)
            groups.append(AgentGroup(group.robot.name, *known))
        return tuple(groups)

    def _library_at(self, library: ArenaState, level: jax.Array) -> ArenaState:
        """Return a library in which only the arenas in play are, over and over."""
        assert self._generated is not None  # as the caller says
        index = self._generated.arena_indices(level)
        return jax.tree.map(lambda rows: rows[index], library)

    def arenas_at(self, level: float | jax.Array, library: ArenaState | None = None) -> ArenaState | None:
        """Return the arenas that worlds go through at a level (arenas, ...); None: all have the same.

        Args:
            level: From 0 to 1.
            library: Result of `redrawn_arenas`; None: the arenas of the beginning.
        """
        if self.scene.arenas is None:
            return None
        library = jax.device_put(library or self.scene.arenas.states)  # at once: each by itself is slow
        return library if self._generated is None else self._library(library, jnp.float32(level))

    def reset(
        self, seed: int | jax.Array | None = None, level: float = 1.0, *, mixed: bool = False
    ) -> EnvState:
        """Return all worlds at the start of their first episode.

        Args:
            seed: Seed of all random numbers; None: the environment's own. An array of random keys (groups,):
                the worlds are groups of equal size, each as an environment of that key's seed alone has
                them.
            level: Difficulty of the generated arenas in play, from 0 to 1; see `at_level`.
            mixed: Whether worlds go through generated arenas with one of each level in turn, until they are
                replaced; else they meet all easy ones first.

        Raises:
            UsageError: A level below 1, or mixed levels, where no arenas are generated; or both. Seeds whose
                number does not divide the worlds.
        """
        if (level < 1.0 or mixed) and not self.levels:
            raise UsageError(f"{self.name} has no generated arenas, so none of level {level} or below")
        if mixed and level < 1.0:
            raise UsageError(f"mixed levels are those of all arenas, not of level {level} and below")
        level_now = jnp.float32(level)
        key, arenas = random.key(self.seed if seed is None else seed), self.arenas_at(level_now)
        if key.ndim and self.worlds % len(key):
            raise UsageError(f"{self.worlds} worlds cannot be divided among {len(key)} seeds")
        if mixed and self._generated is not None:
            order = self._generated.mixed_order()
            arenas = jax.tree.map(lambda rows: rows[order], arenas)
        return self._begin(self._blank(key, level_now, arenas))

    @property
    def is_evenly_spread(self) -> bool:
        """Whether equal numbers of worlds begin in each of its generated arenas."""
        return self._generated is None or self.worlds % self._generated.total == 0

    def reset_each(
        self,
        keys: jax.Array,
        arenas: ArenaState | None = None,
        ranges: dict[str, jax.Array] | None = None,
    ) -> EnvState:
        """Return all worlds at the start of their first episode, each with what is its own.

        A world's first episode is then the same whatever other worlds there are; later ones meet any of the
        arenas.

        Args:
            keys: Random keys of the worlds (worlds,).
            arenas: Theirs, of the shapes of the scene's (worlds, ...); None: the scene's, in turn.
            ranges: Ranges of the worlds' random values, by names of quantities that the task varies (worlds,
                2).
        """
        level = jnp.float32(1.0)
        arenas = self.arenas_at(level) if arenas is None else arenas
        blank = self._blank(jax.random.key(0), level, arenas)
        worlds = blank.batch.worlds.replace(key=keys, ranges=ranges)
        return self._begin(blank.replace(batch=blank.batch.replace(worlds=worlds)))

    def _begin(self, blank: EnvState) -> EnvState:
        """Begin the first episodes."""
        if not self.traceable:
            # Not in the compiled `_blank`: such an engine keeps its state on the host.
            blank = blank.replace(batch=blank.batch.replace(physics=self.batch.engine.start()))
        state = self._restart(blank, blank.done)
        return state.replace(
            # False again: it had marked all worlds for the restart.
            done=state.bad,
            final_obs=state.obs,
            final_privileged=state.privileged,
            final_alive=state.alive,
        )

    def _blank_state(self, key: jax.Array, level: jax.Array, arenas: ArenaState | None) -> EnvState:
        """Return all worlds before their first episode: done with none, and all else is zero.

        `key` is that of all, or of groups of equal size (groups,), each numbered from `first`.
        """

        def zeros(one: jax.ShapeDtypeStruct) -> jax.Array:
            return jnp.zeros((self.worlds, *one.shape), one.dtype)

        (world, begun), metrics = self._known_shapes
        numbers = self.first + jnp.arange(self.worlds // max(key.size, 1))
        keys = random.fold_in(key, numbers)
        numbers = jnp.tile(numbers, key.size)
        # Typed keys have no zeros: they are left out, and set below.
        worlds = jax.tree.map(zeros, world.replace(key=None)).replace(
            key=keys.reshape(-1),
            number=numbers,
            # A restart counts up, to 0 in the first episode.
            episode=jnp.full(self.worlds, -1, jnp.int32),
        )
        begun, no, zero = jax.tree.map(zeros, begun), jnp.zeros(self.worlds, bool), jnp.zeros(self.worlds)
        return EnvState(
            batch=BatchState(
                physics=self.batch.engine.start() if self.traceable else None, worlds=worlds, arenas=arenas
            ),
            memory=begun.memory,
            obs=begun.obs,
            privileged=begun.privileged,
            reward=tuple(jnp.zeros((self.worlds, len(group.agents))) for group in self.groups),
            done=jnp.ones(self.worlds, bool),
            truncated=no,
            final_obs=begun.obs,
            final_privileged=begun.privileged,
            score=begun.score,
            final_score=zero,
            length=begun.length,
            bad=no,
            metrics=dict.fromkeys(metrics, zero),
            alive=begun.alive,
            final_alive=begun.alive,
            level=level,
        )

    def redrawn_arenas(self, generation: int) -> ArenaState:
        """Return newly generated arenas in place of all, for `at_level` (arenas, ...); NumPy arrays.

        A generation always has the same ones.

        Args:
            generation: Number of the replacement, from 1.

        Raises:
            UsageError: Its arenas cannot be replaced, or nothing fits into their places.
        """
        known = self.scene.arenas
        if self._generated is None or known is None or not self.renewable:
            raise UsageError(f"the arenas of {self.name} cannot be replaced: they are not renewable")
        arenas = self._generated.renewed(generation, known.check_fits)
        notes = self.task.arena_notes(self.scene, arenas)
        return known.resolve_later(arenas, generation).replace(notes=notes)

    def at_level(
        self, state: EnvState, level: float | jax.Array, library: ArenaState | None = None
    ) -> EnvState:
        """Return the state with other generated arenas in play: worlds meet them at their next reset.

        Those are in play whose difficulty is at most the level, and always the easiest. Nothing is compiled
        again. Other arenas than generated ones have no levels: there it changes nothing.

        Args:
            state: The state.
            level: From 0 to 1.
            library: Result of `redrawn_arenas`; None: the arenas of the beginning.
        """
        level = jnp.asarray(level, jnp.float32)
        if self._generated is None:
            return state.replace(level=level)
        return state.replace(batch=state.batch.replace(arenas=self.arenas_at(level, library)), level=level)

    def step(self, state: EnvState, actions: tuple[Array, ...]) -> EnvState:
        """Advance every world by one action.

        Args:
            state: The environment's state.
            actions: Actions per group (worlds, robots, action_size) from -1 to 1; larger ones are clipped,
                and one that is no number counts as 0.

        Raises:
            UsageError: Actions of another shape.
        """
        return self._step_program(state, actions)

    def advance(self, state: EnvState, actions: tuple[Array, ...]) -> EnvState:
        """Advance every world by one action, and leave those that are done at their end.

        `step` is this and `restart` of the worlds that are done. A world that is advanced beyond its end
        stays done.

        Args:
            state: The environment's state.
            actions: As for `step`.

        Raises:
            UsageError: Actions of another shape.
        """
        return self._advance_program(state, actions)

    def restart(self, state: EnvState, where: Array) -> EnvState:
        """Begin the next episode in some worlds, in the middle of the present one, too.

        Results of the last step (`reward`, `done`, `final_obs` and others) stay. Episodes that are cut short
        have no `final_score`.

        Args:
            state: The environment's state.
            where: Worlds that restart (worlds,), bool.

        Raises:
            UsageError: A mask of another shape or type.
        """
        mask = jnp.asarray(where)
        if mask.shape != (self.worlds,) or not jnp.issubdtype(mask.dtype, jnp.bool_):
            given = f"{mask.dtype}{list(mask.shape)}"
            raise UsageError(f"restart: a mask {given}, expected bool[{self.worlds}], a value per world")
        return self._restart(state, mask)

    def commanded(self, state: EnvState, actions: tuple[Array, ...]) -> World:
        """Return the worlds as they are before the first control step of an action: with its commands."""
        return self._commanded(state, actions)[0]

    def _commanded(self, state: EnvState, actions: tuple[Array, ...]) -> tuple[World, Memory]:
        physics = self.batch.physics(state.batch)
        return self._act(state.batch.worlds, physics, state.memory, actions, state.alive)

    def _step(self, state: EnvState, actions: tuple[Array, ...]) -> EnvState:
        state = self._advance(state, actions)
        return self._restart(state, state.done)

    def _advance(self, state: EnvState, actions: tuple[Array, ...]) -> EnvState:
        self._check(actions)
        batch, before = state.batch, state.batch.worlds.faults  # a world in which they grow goes bad
        worlds, memory = self._commanded(state, actions)
        state = state.replace(memory=memory)
        # The environment restarts bad worlds itself, once it has closed their episodes.
        batch = self.batch.run(batch.replace(worlds=worlds), self.task.repeat, reset_bad=False)
        worlds, task, present = self._evaluate(
            state.task_state, batch.worlds, self.batch.physics(batch), before
        )
        batch = batch.replace(worlds=worlds)
        if present is not None:
            batch = come_and_go(self.batch.engine, self._regroup, batch, present)
        return state.with_task(batch, task)

    def _restart_where(self, state: EnvState, where: Array) -> EnvState:
        """Begin the next episode in some worlds (worlds,), a fixed number of them at a time."""
        # Most steps end no episode: an engine on the host can look, and leave the restart out.
        if not self.traceable and not np.asarray(where).any():
            return state
        batch = state.batch
        # On the device of all else, if that is on one: else the second batch would be compiled anew.
        qpos = jnp.where(where[:, None], 0.0, jnp.zeros((self.worlds, self.scene.model.nq), jnp.float32))
        now = Restart(worlds=batch.worlds, begun=state.episode_start, qpos=qpos, left=jnp.asarray(where))
        if self.traceable:
            now = jax.lax.while_loop(
                lambda now: now.left.any(), lambda now: self._restart_some(now, batch.arenas), now
            )
        else:
            while np.asarray(now.left).any():
                now = self._restart_some(now, batch.arenas)
        physics = self.batch.engine.reset(batch.physics, where, now.qpos)
        return state.with_start(batch.replace(physics=physics, worlds=now.worlds), now.begun)

    def _check(self, actions: tuple[Array, ...]) -> None:
        """Refuse actions of another shape."""
        wanted = [(self.worlds, len(group.agents), group.action_size) for group in self.groups]
        given = [tuple(np.shape(action)) for action in actions]
        if given != wanted:
            raise UsageError(f"actions of shapes {given}, expected {wanted}: one array per group")
