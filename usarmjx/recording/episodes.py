"""Recordings of policies: an episode of `usarmjx play`, some worlds of a training, or its faults.

`black_box` recordings hold the last seconds of worlds that go bad. A training keeps the worlds before a
rollout and its actions. If a world goes bad, its environment plays the rollout again, and a batch of this one
world repeats its last seconds from a snapshot of all its arrays, under the same commands. That batch is
recorded, so that `replay --check` repeats it to the bit on any engine.
"""

import math
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.engines.base import PhysicsState
from usarmjx.recording.file import RecordingFile
from usarmjx.recording.inputs import OrdersGiven, WorldSetup, batch_setup, orders_of, versions
from usarmjx.recording.recorder import WorldRecorder, WorldSnapshot
from usarmjx.recording.replay import ReplayedBatch, state_arrays
from usarmjx.sim.world import World
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.recipe import SPARE_ROOM
from usarmjx.train.envs.state import EnvState
from usarmjx.train.learning.trajectory import RolloutInputs

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
        # Compiled as one, steps are rounded otherwise than one by one.
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
        # No seed: the worlds come from the midst of a training, which no reset repeats.
        self._episodes = EpisodeRecorder(env, file, range(min(env.worlds, MOST_WORLDS)), None)
        self._every, self._calls, self._count = every, calls, -1

    def look(self, state: EnvState) -> None:
        """Record the worlds, if this iteration is recorded."""
        # The call before the first iteration counts as -1 and is always recorded: it is the start.
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


SECONDS = 2.0
"""Recorded time before the fault [s]."""
PATTERN = "iteration-*.mcap"
FAULTS = {
    "not_finite": "a number of the physics is not finite",
    "overflow": "the buffers of contacts are full",
    "task": "a number of the task is not finite",
}


def _say_nothing(text: str) -> None:
    del text


@dataclass
class _Box:
    """A world on its way to its fault.

    Attributes:
        world: Its index in the environment.
        end: Number of the action in which it went bad.
        begin: Number of the first recorded action, if no episode begins and no robot comes or goes later.
        start: Its arrays before that, see `state_arrays`.
        since: Time of its episode then [s].
        orders: Commands of each action since, per group.
        fault: The fault, in words; empty: it did not come again.
    """

    world: int
    end: int
    begin: int
    start: tuple[np.ndarray, ...] = ()
    since: float = 0.0
    orders: list[list[dict[str, Any]]] = field(default_factory=list[list[dict[str, Any]]])
    fault: str = ""


class BlackBox:
    """Recorder of the worlds of a training that go bad.

    Args:
        env: The worlds of the training.
        folder: For the recordings, one for each world that goes bad.
        most: Most recordings in the folder, those of earlier starts among them.
        say: Receives a line about each recording.
    """

    def __init__(self, env: Env, folder: Path, most: int, say: Callable[[str], None] = _say_nothing) -> None:
        self._env, self._folder, self._most, self._say = env, folder, most, say
        self._before: RolloutInputs | None = None
        self._last: RolloutInputs | None = None
        self._replayed: ReplayedBatch | None = None

    @property
    def _left(self) -> int:
        """Number of recordings that may still be made."""
        return self._most - len([*self._folder.glob(PATTERN)])

    def inspect(self, inputs: RolloutInputs) -> None:
        """Take a rollout, and record the worlds that went bad in the one before it."""
        self._settle()
        if self._left <= 0:
            self._before = self._last = None
            return
        # A GPU has no room for the worlds before the last rollout: recordings then begin with it at most.
        roomy = not self._env.traceable or jax.default_backend() == "cpu"
        self._before = self._last if roomy else None
        self._last = inputs

    def close(self) -> None:
        """Record the worlds that went bad in the last rollout."""
        self._settle()
        self._before = self._last = None

    def _settle(self) -> None:
        """Record the worlds that went bad in the last rollout; a fault here ends no training."""
        if self._last is None:
            return
        bad = np.asarray(self._last.bad)
        worlds = np.flatnonzero(bad.any(0))[: self._left]
        if not len(worlds):
            return
        try:
            self._record_worlds([(int(world), int(bad[:, world].argmax())) for world in worlds])
        except (UsageError, OSError) as error:
            self._say(f"a world went bad, and cannot be recorded: {error}")
            # One failure stops all further attempts: each would cost a training as much time.
            self._most = 0

    def _record_worlds(self, worlds: list[tuple[int, int]]) -> None:
        """Record worlds, given with the number of the action in which they went bad."""
        assert self._last is not None  # as the caller says
        env, last = self._env, self._last
        # Less a little: the quotient of two rounded times must not round up to one more step.
        window = math.ceil(SECONDS / env.period - 1e-6)
        # A world that went bad early in its rollout has its last seconds partly in the one before.
        earlier = self._before if min(step for _, step in worlds) + 1 < window else None
        shift = 0 if earlier is None else earlier.steps
        boxes = [_Box(world, shift + step, max(0, shift + step + 1 - window)) for world, step in worlds]
        if earlier is not None:
            self._play(earlier, boxes, 0, shift)
        self._play(last, boxes, shift, 1 + max(step for _, step in worlds))
        for box in boxes:
            path = self._folder / f"iteration-{last.iteration:06d}-world-{env.first + box.world:06d}.mcap"
            self._record(box, path)
            found = box.fault or "the fault did not come again"
            which = f"world {env.first + box.world} went bad in iteration {last.iteration}"
            self._say(f"{which} ({found}): {path}")

    def _play(self, inputs: RolloutInputs, boxes: list[_Box], shift: int, steps: int) -> None:
        """Play a rollout again, and fill the boxes; `shift` is the number of its first action."""
        env, state = self._env, inputs.env_state
        for number in range(shift, shift + steps):
            actions = inputs.action(number - shift)
            going = [box for box in boxes if box.begin <= number <= box.end]
            commanded = env.commanded(state, actions) if going else None
            for box in going:
                assert commanded is not None
                # Also after robots have come or gone, when the commands begin anew.
                if not box.orders:
                    box.start, box.since = self._start(state, box.world)
                box.orders.append([orders_of(group, box.world) for group in commanded.groups])
            before, state = state, env.step(state, actions)
            for box in going:
                if box.end == number:
                    box.fault = _fault(before, state, box.world)
                elif _is_moved(before, state, box.world):
                    box.orders.clear()  # commands do not repeat it: the recording begins anew

    def _start(self, state: EnvState, world: int) -> tuple[tuple[np.ndarray, ...], float]:
        """Return the arrays of a world, as those of a batch of it alone, and the time of its episode [s]."""
        if self._replayed is None:
            # Built at the first fault only: most trainings never need it, and it compiles for seconds.
            self._replayed = ReplayedBatch(self._setup())
        known = state_arrays(self._replayed.batch_state)
        found = state_arrays(state.batch)
        if len(known) != len(found):
            raise UsageError("its state has other parts than that of a batch of one world")
        step = int(np.asarray(state.batch.worlds.step)[world])
        arrays = tuple(_one_world(part, like, world) for part, like in zip(found, known, strict=True))
        return arrays, step * self._env.scene.physics.period

    def _setup(self) -> WorldSetup:
        task = self._env.task
        # The training's arenas may have spare room, and a snapshot needs the same shapes here.
        renewable = getattr(task.arenas, "renewable", False)
        setup = batch_setup(self._env.batch, 0, 0)
        # A bad world must stay as it is: a reset in the same step would hide the fault.
        return replace(setup, worlds=1, first=0, reset_bad=False, spare=SPARE_ROOM * renewable)

    def _record(self, box: _Box, path: Path) -> None:
        """Let a batch of one world repeat the last seconds, and record it."""
        replayed, env = self._replayed, self._env
        assert replayed is not None  # the start of every box has needed it
        replayed.restore(box.start)
        path.parent.mkdir(parents=True, exist_ok=True)
        about = {**versions(), "task": env.name, "arenas": env.scene.arena.name}
        file, period = RecordingFile(path, about), env.scene.physics.period
        try:
            setup = replace(self._setup(), snapshot=box.start)
            recorder, time = WorldRecorder(file, setup, since=box.since), 0.0
            recorder.record_frame(self._snapshot())
            for orders in box.orders:
                # Before the state of the step that they act in, as a replay expects inputs.
                recorder.record_orders(env.scene, orders)
                replayed.apply(OrdersGiven(step=recorder.steps, orders=_by_slot(env, orders)))
                for _ in range(env.task.repeat):
                    replayed.step()
                    time += period
                    physics = replayed.state()
                    recorder.stepped(time, physics["qpos"], physics["qvel"], physics["act"])
                    if recorder.frame_is_due:
                        recorder.record_frame(self._snapshot())
            recorder.event("fault", box.fault or "the fault did not come again")
        finally:
            file.close()

    def _snapshot(self) -> WorldSnapshot:
        assert self._replayed is not None  # as in `_record`
        batch, state = self._replayed.batch, self._replayed.batch_state
        keyed = state.worlds.replace(key=jax.random.key_data(state.worlds.key))
        # Copies: an engine of the host writes to its arrays again while the file's thread reads them.
        parts: tuple[World, PhysicsState] = jax.tree.map(
            lambda x: np.array(np.asarray(x)[0]), (keyed, batch.physics(state))
        )
        return WorldSnapshot(scene=self._replayed.scene, world=parts[0], physics=parts[1])


def _fault(before: EnvState, after: EnvState, world: int) -> str:
    """Return the faults of a step of a world, in words; empty without any."""
    # Counters grow over a training: only a difference tells of this step.
    counts = [(getattr(one.batch.worlds.faults, name), name) for one in (before, after) for name in FAULTS]
    then, now = ([int(np.asarray(count)[world]) for count, _ in counts[i : i + 3]] for i in (0, len(FAULTS)))
    grown = [text for text, a, b in zip(FAULTS.values(), then, now, strict=True) if b > a]
    return "; ".join(grown)


def _is_moved(before: EnvState, after: EnvState, world: int) -> bool:
    """Return whether a world began anew with a step, or robots have come or gone."""
    if np.asarray(after.done)[world]:
        return True
    groups = zip(before.batch.worlds.groups, after.batch.worlds.groups, strict=True)
    return any((np.asarray(a.active)[world] != np.asarray(b.active)[world]).any() for a, b in groups)


def _one_world(part: Any, like: Any, world: int) -> np.ndarray:  # noqa: ANN401 - arrays of NumPy or JAX
    """Return a world's part of an array, along the axis that a batch of one world has 1 of.

    Engine `warp` keeps the contacts of all worlds in one list, which is shorter for one world. Each step
    writes the list anew, so the list of the batch of one world replaces it.
    """
    axes = [axis for axis, (a, b) in enumerate(zip(part.shape, like.shape, strict=True)) if a != b]
    if not axes:
        return np.array(part)
    if len(axes) > 1 or like.shape[axes[0]] != 1:
        return np.array(like)
    return np.take(np.asarray(part), [world], axes[0])


def _by_slot(env: Env, orders: list[dict[str, Any]]) -> dict[int, dict[str, Any]]:
    """Return the commands of groups by the robots' slots."""
    return {
        int(slot): jax.tree.map(lambda x, i=member: x[i], order)
        for group, order in zip(env.scene.groups, orders, strict=True)
        for member, slot in enumerate(group.slots)
    }
