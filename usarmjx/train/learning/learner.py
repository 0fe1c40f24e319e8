"""A run in this process, together with the others: rollout and update in turn, on a stream of arenas.

Generated arenas are a stream: new ones replace those of earlier iterations. 48 large buildings are two to
three seconds of work for a processor, and a GPU may need others every second: where there are cores for it,
processes beside this one make them.
"""

import time
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any, Literal, TypeAlias, get_args
from weakref import finalize

import jax
from jax.sharding import PartitionSpec

from usarmjx.base import random
from usarmjx.base.errors import UsageError
from usarmjx.base.process import cores
from usarmjx.base.program_cache import PrecompiledProgram, ProgramCache, compile_program
from usarmjx.base.worker_processes import WorkerProcesses, use_workers
from usarmjx.models.compile.arena_set import ArenaState
from usarmjx.sim.scene import Scene
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.recipe import held_out
from usarmjx.train.envs.task import Carry, Policy
from usarmjx.train.evaluation.evaluate import play_episodes
from usarmjx.train.learning.config import Config
from usarmjx.train.learning.ppo import teacher_of, update
from usarmjx.train.learning.processes import PROCESS_AXIS, ProcessGroup
from usarmjx.train.learning.rollout import Rollout
from usarmjx.train.learning.train_state import (
    ROLLOUT_STREAM,
    UPDATE_STREAM,
    TrainState,
    make_networks,
    policy_params,
    train_state_maker,
)
from usarmjx.train.learning.trajectory import Inspector, RolloutState, inputs_of
from usarmjx.train.tasks.buildings import Buildings

Reason: TypeAlias = Literal["arenas", "device", "checkpoint", "log"]
"""New arenas and their transfer; results of the device; checkpoints and scores; metrics and watchers."""
MAX_WORKERS, CORES_PER_WORKER, MIN_CORES = 6, 2, 8
"""Processes that generate arenas, at most, for how many cores there is one, and from how many on."""
GENERATIONS_AHEAD = 2
"""Generations that are requested before they are due: one may take longer than its interval."""
SCORING_SEED = 2**31 - 1
"""Seed of the episodes in which policies are compared under a curriculum."""
EnvFactory = Callable[[int, int], Env]
"""From a number of worlds, and the number of the first of them, to an environment."""


class Waits:
    """Sums of the seconds that the host has waited, by reason."""

    def __init__(self) -> None:
        self._seconds = dict.fromkeys(get_args(Reason), 0.0)

    @contextmanager
    def timed(self, reason: Reason) -> Generator[None]:
        """Add the duration of a block."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self._seconds[reason] += time.perf_counter() - began

    def take(self) -> dict[str, float]:
        """Return the sums since the last call [s]."""
        taken, self._seconds = self._seconds, dict.fromkeys(self._seconds, 0.0)
        return {reason: round(seconds, 6) for reason, seconds in taken.items()}


class ArenaStream:
    """The arenas of each iteration. The next ones are generated beside the training.

    Which they are depends on the iteration alone, so that a run that is resumed meets the same ones.

    Args:
        env: The environment; arenas that are not renewable stay.
        interval: Iterations between two replacements; 0: the arenas stay.
        iterations: Iterations of the run: no arenas are generated for later ones.
        workers: Processes that generate them; 0: a thread of this one does.
    """

    def __init__(self, env: Env, interval: int, iterations: int, workers: int = 0) -> None:
        self._env = env
        self.interval = (
            interval if getattr(env, "renewable", False) else 0
        )  # environments of one's own need it not
        self._last = (iterations - 1) // self.interval if self.interval else 0
        self._requests: dict[int, Future[ArenaState]] = {}
        # Without a later generation processes would start only to be ended.
        self._workers = WorkerProcesses(workers, [Buildings.__module__]) if workers and self._last else None
        # One thread: the generation that is due first is made first.
        self._pool = ThreadPoolExecutor(1, "arenas")
        # The thread would otherwise keep generating for a trainer that is dropped.
        finalize(self, self._pool.shutdown, wait=False, cancel_futures=True)

    def is_refresh(self, iteration: int) -> bool:
        """Return whether arenas are replaced before an iteration, counted from 0."""
        return bool(self.interval) and iteration > 0 and iteration % self.interval == 0

    def arenas(self, iteration: int) -> ArenaState | None:
        """Return the arenas of an iteration (arenas, ...); None: those of the beginning."""
        if not self.interval:
            return None
        generation = iteration // self.interval
        # Arenas of past generations hold large arrays that no iteration reads again.
        self._requests = {number: made for number, made in self._requests.items() if number >= generation}
        present = self._request(generation) if generation else None
        ahead = GENERATIONS_AHEAD if self._workers else 1
        for later in range(generation + 1, min(generation + ahead, self._last) + 1):
            self._request(later)
        return present.result() if present else None

    def _request(self, generation: int) -> "Future[ArenaState]":
        if generation not in self._requests:
            self._requests[generation] = self._pool.submit(_generated, self._env, generation, self._workers)
        return self._requests[generation]


def _generated(env: Env, generation: int, workers: WorkerProcesses | None) -> ArenaState:
    with use_workers(workers):
        return env.redrawn_arenas(generation)


def workers_for(processes: int) -> int:
    """Return the number of processes that generate arenas for each of some trainers on this host."""
    mine = cores() // processes
    return min(MAX_WORKERS, mine // CORES_PER_WORKER) if mine >= MIN_CORES else 0


class Trainer:
    """A run in this process, together with the others if there are any.

    Args:
        env: The worlds of this process, or what makes them.
        config: Settings.
        process_group: All processes.
    """

    runs = 1
    """Runs that train at once, each in worlds of its own."""

    def __init__(self, env: Env | EnvFactory, config: Config, process_group: ProcessGroup) -> None:
        config.check_processes(process_group.count)
        share = config.num_worlds // process_group.count
        if callable(env):
            env = env(share * self.runs, process_group.index * share)
        if env.worlds != share * self.runs:
            parts = f"{process_group.count} processes" if self.runs == 1 else f"each of {self.runs} seeds"
            raise UsageError(
                f"the environment has {env.worlds} worlds; {config.num_worlds} worlds of {parts} need "
                f"{share * self.runs}"
            )
        _check_split(env)
        if config.curriculum and not env.levels:
            raise UsageError(
                f"curriculum is {config.curriculum}, but {env.name} has no generated arenas that could get "
                "harder: set arena=maze, or leave curriculum out"
            )
        self.env, self.config, self.process_group = env, config, process_group
        self.networks = make_networks(env.groups, env.privileged_size, config)
        self.agents = self.networks.agent_count
        self.iterations = config.iterations(self.agents)
        workers = workers_for(process_group.count)
        self.stream = ArenaStream(env, config.arena_refresh_interval, self.iterations, workers)
        self.waits = Waits()
        teacher = teacher_of(env, config.teacher) if config.imitation_steps else None
        # Environments of one's own have no cache.
        known: ProgramCache | None = getattr(env, "program_cache", None)
        # Programs are the same for all seeds and checkpoint settings.
        general = replace(config, seed=0, checkpoint_interval=1, keep_checkpoints=1, black_box=0)
        self._program_cache = known and known.of(
            general, self.networks, process_group.index, process_group.count, type(self).__name__
        )
        self.inspect: Inspector | None = None
        self.rollout = self._make_rollout(process_group.index * share, teacher)
        # Trajectories have steps first and worlds second, ends have worlds first.
        timed, once = PartitionSpec(None, PROCESS_AXIS), PartitionSpec(PROCESS_AXIS)
        self._begin = train_state_maker(self.networks, config, self._program_cache)
        self._everywhere = jax.shard_map(
            self._updater(),
            mesh=process_group.mesh,
            in_specs=(PartitionSpec(), (timed, once, once), PartitionSpec()),
            out_specs=(PartitionSpec(), PartitionSpec()),
            check_vma=False,
        )
        self._update = PrecompiledProgram(
            compile_program(self._update_shards, self._program_cache, "Trainer", precise=False)
        )
        keys = [self._stream_key(stream) for stream in (ROLLOUT_STREAM, UPDATE_STREAM)]
        # The update's key travels as its data: global arrays are made of plain ones, not of typed keys.
        self._key, updates = process_group.device_put((keys[0], jax.random.key_data(keys[1])))
        self._stream = process_group.to_global(updates, None)
        self._fold: Callable[..., jax.Array] = jax.jit(jax.random.fold_in)
        self._sums = jax.jit(_with_axis)
        self._best_actions = jax.jit(partial(self.networks.policy.act, deterministic=True))

    def _make_rollout(self, first: int, teacher: Policy | None) -> Rollout:
        return Rollout(self.env, self.networks, self.config, first, teacher, self._program_cache)

    def _updater(self) -> Callable[..., tuple[TrainState, dict[str, jax.Array]]]:
        """Return the function of train state, experience and stream, see `update`."""
        return partial(update, self.networks, self.config, self.process_group.count)

    def _stream_key(self, stream: int) -> jax.Array:
        """Return the key of a stream of random numbers."""
        return jax.random.fold_in(random.key(self.config.seed), stream)

    def numbers(self, known: dict[str, jax.Array]) -> list[dict[str, float]]:
        """Return the numbers for the log of each run, once they are computed."""
        return [{name: float(value) for name, value in jax.device_get(known).items()}]

    def start(self) -> tuple[TrainState, RolloutState]:
        """Return the train state before the first update, and worlds at their start."""
        return self.process_group.device_put(self.starts()[:2])

    def starts(self) -> tuple[TrainState, RolloutState, jax.Array]:
        """Return the arguments of the first rollout, on any device."""
        learner = self._begin(random.key(self.config.seed))
        return learner, self.rollout.start(self.level(0)), self._key

    def start_shapes(self) -> tuple[TrainState, RolloutState, jax.Array]:
        """Return the shapes of what `starts` returns."""
        if self._program_cache is None:
            return jax.eval_shape(self.starts)
        return self._program_cache.value("Trainer.starts", partial(jax.eval_shape, self.starts))

    def compile_update(self, train_state: TrainState, collected: Any) -> None:  # noqa: ANN401 - shapes of `Collected`
        """Compile the update.

        Args:
            train_state: Its shapes.
            collected: Shapes of what a rollout returns.
        """
        _, trajectory, ends, sums = collected
        shapes = self.process_group.global_shapes
        experience = (shapes(trajectory, 1), shapes(ends, 0), shapes(jax.eval_shape(_with_axis, sums), 0))
        self._update.compile(shapes(train_state, None), experience, self._stream)

    def full_difficulty_score(self, train_state: TrainState) -> float | None:
        """Return the mean score of one episode of each world of this process, with all arenas in play.

        The policy takes its most probable actions, and the seed is always the same: so what was trained on
        easier arenas is compared with what was trained on harder ones. The worlds in training stay as they
        are. None: no episode ended well.
        """

        def act(
            carry: Carry, obs: tuple[jax.Array, ...], key: jax.Array
        ) -> tuple[Carry, tuple[jax.Array, ...]]:
            del key
            actions, carry = self._best_actions(params, obs, carry)
            return carry, actions

        params, start = policy_params(train_state), self.networks.policy.initial_carry
        scores = play_episodes(self.env, Policy(start, act), self.env.worlds, SCORING_SEED).scores
        return float(scores.mean()) if len(scores) else None

    def _update_shards(self, *args: Any) -> tuple[TrainState, dict[str, jax.Array]]:  # noqa: ANN401 - PyTrees
        """Return the train state after an update, and numbers for the log."""
        return self._everywhere(*args)

    def level(self, iteration: int) -> float:
        """Return the difficulty of the arenas in play before an iteration, counted from 0."""
        # A curriculum of 0 has all arenas in play from the start; the division needs a share above 0.
        share = self.config.curriculum * self.iterations
        return min(1.0, iteration / share) if share else 1.0

    def iterate(
        self, train_state: TrainState, worlds: RolloutState, iteration: int
    ) -> tuple[TrainState, RolloutState, dict[str, jax.Array]]:
        """Let the robots act, and update.

        Args:
            train_state: So far.
            worlds: State of this process's worlds.
            iteration: Number of this one, from 0.

        Returns:
            Train state and rollout state, and numbers for the log.
        """
        with self.waits.timed("arenas"):
            arenas = self.stream.arenas(iteration)
            if self.config.curriculum or self.stream.is_refresh(iteration):
                state = self.env.at_level(worlds.env_state, self.level(iteration), arenas)
                worlds = worlds.replace(env_state=self.process_group.device_put(state))
        # By number, not split in sequence: a resumed run draws the same.
        key = self._fold(self._key, iteration)
        begun = worlds.env_state
        worlds, trajectory, ends, sums = self.rollout.collect(train_state, worlds, key)
        if self.inspect is not None:
            repeat = self.config.action_repeat
            self.inspect(inputs_of(self.networks.policy, iteration + 1, begun, trajectory, repeat))
        to_global = self.process_group.to_global
        experience = (to_global(trajectory, 1), to_global(ends, 0), to_global(self._sums(sums), 0))
        train_state, known = self.process_group.to_local(
            self._update(to_global(train_state, None), experience, self._stream)
        )
        return train_state, worlds, known


def _check_split(env: Env) -> None:
    """Refuse to train on arenas that scores are measured in."""
    scene: Scene | None = getattr(env, "scene", None)  # environments of one's own need none
    if scene is None:
        return
    if split := held_out((scene.arena,) if scene.arenas is None else scene.arenas.arenas):
        raise UsageError(
            f"{env.name} has arenas of the split {split}, which are held out to measure scores in: train on "
            "those of the split train"
        )


def _with_axis(sums: dict[str, jax.Array]) -> dict[str, jax.Array]:
    """Return sums with an axis over processes."""
    return {name: one[None] for name, one in sums.items()}
