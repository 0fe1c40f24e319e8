"""Training of several seeds in one program, each with a folder of its own.

`OUT/seed-3` is the run of seed 3, with the files of a run that trained alone. The checkpoints of OUT have the
worlds of all seeds: a checkpoint counts once OUT has it, and OUT gets it last.

The worlds of all seeds are one batch, in which each seed has a group as large as it has alone. Networks and
updates have an axis over seeds. Neither a world nor a policy learns of another seed's.
"""

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import jax
import jax.numpy as jnp

from usarmjx.base import random
from usarmjx.base.errors import UsageError
from usarmjx.base.files import PARTIAL_MARK
from usarmjx.base.program_cache import ProgramCache
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.task import Carry, Policy
from usarmjx.train.learning.checkpoint import SET, Checkpoints, read_part
from usarmjx.train.learning.config import (
    DEFAULT_ENV_ARGUMENTS,
    RECORD_FILE,
    SET_FILE,
    Config,
    EnvArguments,
    RunRecord,
    load_record,
    load_seeds,
    make_record,
    save_seeds,
    seed_folder,
)
from usarmjx.train.learning.fine_tuning import TrainedNetworks, check_source
from usarmjx.train.learning.league import write_standings
from usarmjx.train.learning.learner import EnvFactory, Trainer
from usarmjx.train.learning.metrics import MetricsLog
from usarmjx.train.learning.processes import ProcessGroup
from usarmjx.train.learning.rollout import Rollout
from usarmjx.train.learning.train_state import STAGGER_STREAM, Networks, TrainState
from usarmjx.train.learning.trainer import (
    IterationsWatch,
    Records,
    RunOutputs,
    StopRequest,
    TrainResult,
    check_ahead,
    compiling,
    ignore,
    lock_run,
    run_iterations,
)
from usarmjx.train.learning.trajectory import (
    Background,
    Decision,
    GroupArrays,
    RolloutEnds,
    RolloutState,
    StepView,
    Trajectory,
)

SEED_AXIS = "seed"
"""Axis over seeds within a rollout."""
Tree = TypeVar("Tree")
"""Any tree of arrays."""


def split_worlds(tree: Tree, seeds: int, axis: int = 0) -> Tree:
    """Return arrays (..., seeds, worlds, ...) of arrays with an axis over the worlds of all seeds."""

    def split(leaf: jax.Array) -> jax.Array:
        shape = leaf.shape
        return leaf.reshape(*shape[:axis], seeds, shape[axis] // seeds, *shape[axis + 1 :])

    return jax.tree.map(split, tree)


def join_worlds(tree: Tree) -> Tree:
    """Return arrays over the worlds of all seeds (seeds * worlds, ...) of arrays (seeds, worlds, ...)."""

    def join(leaf: jax.Array) -> jax.Array:
        return leaf.reshape(leaf.shape[0] * leaf.shape[1], *leaf.shape[2:])

    return jax.tree.map(join, tree)


@jax.jit  # one program in place of one for each shape of a leaf
def stack_seeds(trees: list[Tree]) -> Tree:
    """Return the trees of all seeds as one, with a leading axis over seeds."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)


@jax.jit
def of_seed(tree: Tree, number: int) -> Tree:
    """Return the part of the seed of an index, of a tree with a leading axis over seeds."""
    return jax.tree.map(lambda leaf: leaf[number], tree)


class SeedRollout(Rollout):
    """Rollouts of several seeds at once; train states have a leading axis over seeds.

    Worlds, trajectories and rollout states have one axis over the worlds of all seeds, in order.

    Args:
        seeds: The seeds.
        env: The worlds of all seeds.
        networks: Shapes of policy and critics.
        config: Settings of each run.
        teacher: See `Rollout`.
        program_cache: Cache of its programs.
    """

    def __init__(
        self,
        seeds: tuple[int, ...],
        env: Env,
        networks: Networks,
        config: Config,
        teacher: Policy | None = None,
        program_cache: ProgramCache | None = None,
    ) -> None:
        super().__init__(env, networks, config, 0, teacher, program_cache)
        self.seeds, self.worlds = seeds, env.worlds // len(seeds)

    def _split(self, tree: Tree) -> Tree:
        return split_worlds(tree, len(self.seeds))

    def _mapped(self, function: Callable[..., Any], train_state: TrainState) -> Callable[..., Any]:
        """Return a function of train state and more, mapped over seeds in the same iteration."""
        # Not mapped: a condition on it stays one, where else both of its branches were computed.
        iteration = train_state.iteration[0]

        def run(train_state: TrainState, *rest: Any) -> Any:  # noqa: ANN401 - as of the function
            return function(train_state.replace(iteration=iteration), *rest)

        return jax.vmap(run, axis_name=SEED_AXIS)

    def _any(self, where: jax.Array) -> jax.Array:
        """Return whether something is true in any world of any seed ()."""
        # Over all seeds, so that the condition is one for the mapped program, not one for each seed.
        return jax.lax.psum(where.any().astype(jnp.int32), SEED_AXIS) > 0

    def _seeds(self) -> tuple[Any, jax.Array]:
        keys = jnp.stack([random.key(seed) for seed in self.seeds])
        return keys, random.fold_in(keys, STAGGER_STREAM)

    def _initial_carry(self, key: jax.Array) -> tuple[jax.Array, jax.Array, GroupArrays]:
        return join_worlds(jax.vmap(super()._initial_carry)(key))

    def _choose_actions(
        self,
        train_state: TrainState,
        view: StepView,
        carry: tuple[GroupArrays, GroupArrays, Carry],
        worlds: jax.Array,
        key: tuple[jax.Array, Any],
        background: Background,
    ) -> tuple[GroupArrays, Decision]:
        # Bound here: within the nested function `super()` would take that function's first argument for self.
        base = super()._choose_actions
        keys, step = key

        def choose(train_state: TrainState, key: jax.Array, *seen: Any) -> tuple[GroupArrays, Decision]:  # noqa: ANN401
            view, carry, worlds, background = seen
            return base(train_state, view, carry, worlds, (key, step), background)

        seen = self._split((view, carry, worlds, background))
        return join_worlds(self._mapped(choose, train_state)(train_state, keys, *seen))

    def _record_step(
        self,
        train_state: TrainState,
        episode: tuple[jax.Array, jax.Array],
        decision: Decision,
        before: StepView,
        after: StepView,
    ) -> tuple[Trajectory, tuple[GroupArrays, GroupArrays, Carry], jax.Array, dict[str, jax.Array]]:
        mapped = self._mapped(super()._record_step, train_state)
        *rows, sums = mapped(train_state, *self._split((episode, decision, before, after)))
        # Sums keep their axis over seeds: each has a log of its own.
        step, carry, episode_return = join_worlds(tuple(rows))
        return step, carry, episode_return, sums

    def _rollout_ends(
        self,
        train_state: TrainState,
        before: tuple[GroupArrays, GroupArrays],
        after: tuple[jax.Array, GroupArrays],
        view: StepView,
    ) -> RolloutEnds:
        mapped = self._mapped(super()._rollout_ends, train_state)
        return join_worlds(mapped(train_state, *self._split((before, after, view))))


class SeedTrainer(Trainer):
    """Runs of several seeds at once, in one process; train states have a leading axis over seeds.

    Args:
        env: The worlds of all seeds, or what makes them.
        config: Settings of each run; its seed does not matter.
        process_group: This process.
        seeds: The seeds.
    """

    def __init__(
        self,
        env: Env | EnvFactory,
        config: Config,
        process_group: ProcessGroup,
        seeds: tuple[int, ...],
    ) -> None:
        # First: the base class counts worlds by the runs, and makes the rollout of these seeds.
        self.seeds, self.runs = seeds, len(seeds)
        super().__init__(env, config, process_group)
        # One key for each seed, all folded by the same number.
        self._fold = jax.jit(jax.vmap(jax.random.fold_in, (0, None)))

    def _make_rollout(self, first: int, teacher: Policy | None) -> Rollout:
        # All seeds train in one process: the worlds of each are numbered from 0, as if it trained alone.
        del first
        return SeedRollout(self.seeds, self.env, self.networks, self.config, teacher, self._program_cache)

    def _updater(self) -> Callable[..., tuple[TrainState, dict[str, jax.Array]]]:
        # Steps have worlds on axis 1, so their seeds are there, too; ends have them in front.
        mapped = jax.vmap(super()._updater(), in_axes=(0, (1, 0, 1), 0))

        def update_all(
            train_state: TrainState,
            experience: tuple[Trajectory, RolloutEnds, dict[str, jax.Array]],
            stream: jax.Array,
        ) -> tuple[TrainState, dict[str, jax.Array]]:
            steps, ends, sums = experience
            split = split_worlds(steps, self.runs, 1), split_worlds(ends, self.runs), sums
            return mapped(train_state, split, stream)

        return update_all

    def _stream_key(self, stream: int) -> jax.Array:
        return random.fold_in(jnp.stack([random.key(seed) for seed in self.seeds]), stream)

    def starts(self) -> tuple[TrainState, RolloutState, jax.Array]:
        """Return the arguments of the first rollout, on any device."""
        learner = stack_seeds([self._begin(random.key(seed)) for seed in self.seeds])
        return learner, self.rollout.start(self.level(0)), self._key

    def numbers(self, known: dict[str, jax.Array]) -> list[dict[str, float]]:
        """Return the numbers for the log of each seed, once they are computed."""
        found = jax.device_get(known)
        return [{name: float(value[k]) for name, value in found.items()} for k in range(self.runs)]


def train_seeds(  # noqa: PLR0913 - all but four may be left out
    env: Env | EnvFactory,
    config: Config,
    out: str | Path,
    seeds: Sequence[int],
    resume: bool = False,
    *,
    origin: EnvArguments = DEFAULT_ENV_ARGUMENTS,
    source: TrainedNetworks | None = None,
    progress: bool = True,
    watch: IterationsWatch | None = None,
    stop: StopRequest | None = None,
) -> list[TrainResult]:
    """Train a policy for each of several seeds in one program, on one device.

    Each seed has its own networks, worlds and random numbers, those of `train` with that seed, and learns the
    same but for rounding.

    Args:
        env: An environment with `config.num_worlds` worlds for each seed; or what makes one of a number of
            worlds and the number of the first of them.
        config: Settings of each run; its seed does not matter.
        out: Folder of all; the run of seed K is in the folder `seed-K` there.
        seeds: The seeds.
        resume: Go on where the runs in that folder were left; from the start if they had no checkpoint yet.
        origin: See `train`.
        source: Networks that each run begins with; None: random ones of its own.
        progress: Show a bar in the terminal, of all runs together.
        watch: Receives the records of each iteration, one for each seed.
        stop: Ends the training early, with a checkpoint.

    Returns:
        The result of each seed.

    Raises:
        UsageError: As `train`; seeds that are not whole numbers or not different; several processes, or a
            curriculum.
        WriteError: As `train`.
    """
    out, process_group, seeds = Path(out), ProcessGroup(), _checked(seeds, config)
    if process_group.count > 1:
        raise UsageError("several seeds train in one process: train one seed, or leave out the processes")
    with ExitStack() as held:
        _open_set(held, out, seeds, resume)
        trainer = SeedTrainer(env, config, process_group, seeds)
        if not resume:
            _lock_all(held, out, seeds)
            _check_new(out, seeds)  # another one may have been quicker
        checkpoints = SeedCheckpoints(out, seeds, config.keep_checkpoints)
        records = [make_record(trainer.env, replace(config, seed=seed), 1, origin) for seed in seeds]
        _prepare(out, seeds, [_checked_record(one, trainer, checkpoints, source) for one in records])
        began = time.perf_counter()
        with compiling(trainer):
            restored = _restore(trainer, checkpoints, source)
        folders = [run.run for run in checkpoints.runs]
        # The folders of all seeds are at the same iteration: the shared checkpoint counts.
        logs = _logs(folders, trainer.iterations, restored[2], progress)
        outputs = RunOutputs(folders=folders, logs=logs, save=checkpoints.save, watch=watch or ignore)
        return run_iterations(trainer, outputs, restored, began, stop)


def _logs(folders: list[Path], iterations: int, after: int, progress: bool) -> list[MetricsLog]:
    """Return the log of each run; the first one shows all in the terminal, if progress is to be shown."""
    return [
        MetricsLog(folder, iterations, after, bar=progress and number == 0)
        for number, folder in enumerate(folders)
    ]


def _checked(seeds: Sequence[int], config: Config) -> tuple[int, ...]:
    checked = tuple(random.checked_seed(seed) for seed in seeds)
    if not checked or len(set(checked)) < len(checked):
        raise UsageError(f"seeds are {list(checked)}, expected one or more, all different")
    if config.curriculum:
        raise UsageError(f"curriculum is {config.curriculum}: seeds that train together have none")
    return checked


def _open_set(held: ExitStack, out: Path, seeds: tuple[int, ...], resume: bool) -> None:
    """Lock the folder to resume; refuse one with other runs."""
    if not resume:
        _check_new(out, seeds)
        return
    there = load_seeds(out)
    if not there:
        raise UsageError(f"nothing to resume in {out}: it has no {SET_FILE}")
    if there != seeds:
        raise UsageError(f"the runs in {out} have the seeds {list(there)}, not {list(seeds)}")
    _lock_all(held, out, seeds)


def _check_new(out: Path, seeds: tuple[int, ...]) -> None:
    if load_seeds(out):
        raise UsageError(f"{out} has runs already; resume them, or choose another folder")
    for folder in (out, *(seed_folder(out, seed) for seed in seeds)):
        if (folder / RECORD_FILE).exists():
            raise UsageError(f"{folder} has a run already; choose another folder")


def _lock_all(held: ExitStack, out: Path, seeds: tuple[int, ...]) -> None:
    """Keep other trainers out of all folders."""
    process_group = ProcessGroup()
    for folder in (out, *(seed_folder(out, seed) for seed in seeds)):
        lock_run(held, folder, process_group)


class SeedCheckpoints:
    """The checkpoints of runs that train together.

    Args:
        out: Folder of all.
        seeds: The seeds.
        keep: See `Checkpoints`.

    Attributes:
        shared: Those with the worlds of all.
        runs: Those of each seed.
    """

    def __init__(self, out: Path, seeds: tuple[int, ...], keep: int) -> None:
        self.shared = Checkpoints(out, keep=keep)
        self.runs = [Checkpoints(seed_folder(out, seed), keep=keep) for seed in seeds]

    def save(self, iteration: int, train_state: TrainState, worlds: RolloutState, notes: Records) -> None:
        """Write a checkpoint of all runs, and drop old ones.

        Args:
            iteration: After which.
            train_state: Of all seeds.
            worlds: Of all seeds.
            notes: Note of each seed, see `Checkpoints.save`.

        Raises:
            WriteError: The earlier ones are whole.
        """
        # Fetched once: each seed's part is then cut from memory of the host.
        learners = jax.device_get(train_state)
        for number, (run, note) in enumerate(zip(self.runs, notes, strict=True)):
            # All are kept until the shared one is written: an interruption in between must leave a full set.
            run.write(iteration, {"learner": of_seed(learners, number)}, {**note, SET: len(self.runs)})
            if learners.league is not None:
                write_standings(run.run, iteration, of_seed(learners.league, number))
        shared = {"agent_steps": notes[0]["agent_steps"], "score": None, SET: len(self.runs)}
        self.shared.write(iteration, {"worlds": worlds}, shared)
        # Only now: each run must have the checkpoint that the shared ones end with.
        for one in (self.shared, *self.runs):
            one.delete_old(one.keep)

    def drop_unfinished(self, iteration: int) -> None:
        """Delete runs' checkpoints of later iterations, whose worlds were not written any more.

        Raises:
            UsageError: A run was continued alone.
        """
        for run in self.runs:
            for path in run.all():
                # Without this field a checkpoint has worlds of its own: the run was resumed by itself.
                if int(path.name) > iteration and SET not in run.meta(path):
                    raise UsageError(f"{run.run} went on alone: resume it alone, or delete its checkpoints")
            run.delete_after(iteration)


def _checked_record(
    record: RunRecord, trainer: SeedTrainer, checkpoints: SeedCheckpoints, source: TrainedNetworks | None
) -> RunRecord:
    """Return the record with the run that it began with, after a look at the run that is there."""
    folder = seed_folder(checkpoints.shared.run, record.config.seed)
    if (folder / RECORD_FILE).exists():
        old = load_record(folder)
        record.check_resumes(old, folder)
        check_ahead(trainer, checkpoints.shared)
        record = replace(record, began_with=old.began_with)
    if source is not None:
        source.check(trainer.networks)
        record = replace(record, began_with=source.origin)
    check_source(checkpoints.shared, record, source)
    return record


def _prepare(out: Path, seeds: tuple[int, ...], records: list[RunRecord]) -> None:
    save_seeds(out, seeds)
    for seed, record in zip(seeds, records, strict=True):
        folder = seed_folder(out, seed)
        for left in folder.glob(f".*{PARTIAL_MARK}-*"):  # by a trainer that was killed
            left.unlink()
        record.save(folder)


def _restore(
    trainer: SeedTrainer, checkpoints: SeedCheckpoints, source: TrainedNetworks | None
) -> tuple[TrainState, RolloutState, int]:
    train_state, worlds = trainer.start()
    fresh = [of_seed(train_state, number) for number in range(trainer.runs)]
    put = trainer.process_group.device_put
    if source is not None:
        train_state = put(stack_seeds([source.begin(one, trainer.config) for one in fresh]))
        notes: Records = [{"agent_steps": 0, "score": None} for _ in fresh]
        checkpoints.save(0, train_state, worlds, notes)
        return train_state, worlds, 0
    if not checkpoints.shared.all():
        # Without shared worlds no run's checkpoint can go on: all of them are dropped.
        checkpoints.drop_unfinished(-1)
        return train_state, worlds, 0
    path = checkpoints.shared.find("last")
    done = int(checkpoints.shared.meta(path)["iteration"])
    checkpoints.drop_unfinished(done)
    learners = [
        read_part(run.find(str(done)), "learner", one)
        for run, one in zip(checkpoints.runs, fresh, strict=True)
    ]
    return *put((stack_seeds(learners), read_part(path, "worlds", worlds))), done
