"""Recordings of policies: an episode of `usarmjx play`, or some worlds of a training."""

from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np

from usarmjx.engines.base import PhysicsState
from usarmjx.recording.file import RecordingFile
from usarmjx.recording.inputs import batch_setup, orders_of, versions
from usarmjx.recording.recorder import WorldRecorder, WorldSnapshot
from usarmjx.sim.world import World
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.state import EnvState

MOST_WORLDS = 4
"""Most recorded worlds of a training, the first ones."""
MIDST = "training goes on from episode to episode, and the recording leaves out most of it"


def _world_of(env: Env, state: EnvState, number: int) -> tuple[World, PhysicsState]:
    """Return one world, without an axis over worlds; NumPy arrays."""
    worlds, physics = state.batch.worlds, env.batch.physics(state.batch)
    # Typed random keys cannot become NumPy arrays, their data can.
    keyed = worlds.replace(key=jax.random.key_data(worlds.key))
    return jax.tree.map(lambda x: np.asarray(x)[number], (keyed, physics))


class EpisodeRecorder:
    """Records the worlds of an environment, action by action.

    Args:
        env: The environment.
        file: The recording.
        numbers: Numbers of the recorded worlds.
        seed: Seed of the environment's reset; None: it was reset otherwise, and no replay is possible.
    """

    def __init__(self, env: Env, file: RecordingFile, numbers: range, seed: int | None) -> None:
        self._env, self._file, self._seed = env, file, seed
        self._numbers, self._recorders, self._time = numbers, dict[int, WorldRecorder](), 0.0

    def _begin(self, state: EnvState) -> None:
        """Record the worlds' inputs, as they are before their first action."""
        env = self._env
        for number in self._numbers:
            _, physics = _world_of(env, state, number)
            setup = replace(
                batch_setup(env.batch, number, 0),
                repeat=env.task.repeat,
                start=np.asarray(physics.qpos),
                why_not=self._why_not(),
            )
            if self._seed is not None:
                setup = replace(setup, seed=self._seed)
            self._recorders[number] = WorldRecorder(self._file, setup, number)

    def _why_not(self) -> str:
        """Return the reason why the episode cannot be replayed; empty if it can."""
        if self._seed is None:
            return MIDST
        if self._env.traceable:
            return f"engine {self._env.batch.engine.name} compiles a task's steps as one; take engine c"
        return "its arenas were generated" if self._env.levels else ""

    def watch(self, state: EnvState) -> None:
        """Record the present state of the worlds: once before the first action, and after each."""
        env, is_first = self._env, not self._recorders
        if is_first:
            self._begin(state)
        for number, recorder in self._recorders.items():
            world, physics = _world_of(env, state, number)
            if not is_first:
                groups = state.batch.worlds.groups
                recorder.record_orders(env.scene, [orders_of(group, number) for group in groups])
                qpos, qvel, act = (np.asarray(one) for one in (physics.qpos, physics.qvel, physics.act))
                recorder.stepped(self._time, qpos, qvel, act, steps=env.task.repeat)
            if recorder.frame_is_due:
                score = float(np.asarray(state.score)[number])
                recorder.record_frame(
                    WorldSnapshot(scene=env.scene, world=world, physics=physics, score=score)
                )
        self._time += env.period


class TrainingRecorder:
    """Records the first worlds of a training in one of every `every` iterations.

    Args:
        env: The training's worlds.
        file: The recording.
        every: Number of iterations of which one is recorded.
        calls: Number of calls of `look` in an iteration; there is one more before the first iteration.
    """

    def __init__(self, env: Env, file: RecordingFile, every: int, calls: int) -> None:
        self._episodes = EpisodeRecorder(env, file, range(min(env.worlds, MOST_WORLDS)), None)
        self._every, self._calls, self._count = every, calls, -1

    def look(self, state: EnvState) -> None:
        """Record the worlds, if this iteration is recorded."""
        if self._count < 0 or self._count // self._calls % self._every == 0:
            self._episodes.watch(state)
        self._count += 1


@contextmanager
def episode_file(env: Env, path: Path) -> Generator[RecordingFile]:
    """Open a recording of an environment's worlds, and complete it at the end of the context.

    Raises:
        UsageError: The file exists already.
        WriteError: It cannot be written.
    """
    about = {**versions(), "task": env.name, "arenas": env.scene.arena.name}
    file = RecordingFile(path, about, several=env.worlds > 1)
    try:
        yield file
    finally:
        file.close()
