"""Recordings of policies at work: an episode of `usarmjx play`, some worlds of a training."""

from collections.abc import Iterator
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
"""Of a training so many worlds are recorded, the first ones."""
MIDST = "training goes on from episode to episode, and the recording leaves out most of it"


def _world_of(env: Env, state: EnvState, number: int) -> tuple[World, PhysicsState]:
    """Return one world, without an axis over worlds; NumPy arrays."""
    worlds, physics = state.batch.worlds, env.batch.physics(state.batch)
    keyed = worlds.replace(key=jax.random.key_data(worlds.key))
    return jax.tree.map(lambda x: np.asarray(x)[number], (keyed, physics))


class EpisodeRecorder:
    """Records the worlds of an environment, action by action.

    Args:
        env: The environment.
        file: The recording.
        numbers: Which worlds.
        seed: What the environment was reset with; None: with something else, and nothing can be repeated.
    """

    def __init__(self, env: Env, file: RecordingFile, numbers: range, seed: int | None) -> None:
        self._env, self._file, self._seed = env, file, seed
        self._numbers, self._recorders, self._time = numbers, dict[int, WorldRecorder](), 0.0

    def _begin(self, state: EnvState) -> None:
        """Say what the worlds were made of, as they are before their first action."""
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
        """Return why the episode cannot be computed again, in words; empty: it can."""
        if self._seed is None:
            return MIDST
        if self._env.traceable:
            return f"engine {self._env.batch.engine.name} compiles a task's steps as one; take engine c"
        return "its arenas were generated" if self._env.levels else ""

    def watch(self, state: EnvState) -> None:
        """Keep the worlds as they are: once before the first action, and after each."""
        env, is_first = self._env, not self._recorders
        if is_first:
            self._begin(state)
        for number, recorder in self._recorders.items():
            world, physics = _world_of(env, state, number)
            if not is_first:
                groups = state.batch.worlds.groups
                recorder.told(env.scene, [orders_of(group, number) for group in groups])
                qpos, qvel, act = (np.asarray(one) for one in (physics.qpos, physics.qvel, physics.act))
                recorder.stepped(self._time, qpos, qvel, act, steps=env.task.repeat)
            if recorder.frame_is_due:
                score = float(np.asarray(state.score)[number])
                recorder.look(WorldSnapshot(scene=env.scene, world=world, physics=physics, score=score))
        self._time += env.period


class TrainingRecorder:
    """Records the first worlds of a training in every so many iterations.

    Args:
        env: The training's worlds.
        file: The recording.
        every: Of so many iterations one is recorded.
        calls: How often `look` is called in an iteration; once more before the first one.
    """

    def __init__(self, env: Env, file: RecordingFile, every: int, calls: int) -> None:
        self._episodes = EpisodeRecorder(env, file, range(min(env.worlds, MOST_WORLDS)), None)
        self._every, self._calls, self._count = every, calls, -1

    def look(self, state: EnvState) -> None:
        """Keep the worlds as they are, if it is their turn."""
        if self._count < 0 or self._count // self._calls % self._every == 0:
            self._episodes.watch(state)
        self._count += 1


@contextmanager
def episode_file(env: Env, path: Path) -> Iterator[RecordingFile]:
    """Give a recording of an environment's worlds, which is complete in the end.

    Raises:
        UsageError: The file is there already.
        WriteError: It cannot be written.
    """
    about = {**versions(), "task": env.name, "arenas": env.scene.arena.name}
    file = RecordingFile(path, about, several=env.worlds > 1)
    try:
        yield file
    finally:
        file.close()
