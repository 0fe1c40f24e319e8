"""Training: rollout, update, log, checkpoint; and going on where a run was left."""

import time
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Any, TypeAlias

import jax
from jax.sharding import SingleDeviceSharding

from usarmjx.base.errors import UsageError, WriteError, extra, need_module
from usarmjx.base.files import PARTIAL_MARK, writing
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.state import EnvState
from usarmjx.train.learning.checkpoint import FULL, Checkpoints, read_part
from usarmjx.train.learning.config import Config
from usarmjx.train.learning.fine_tuning import TrainedNetworks, check_begun
from usarmjx.train.learning.learner import EnvFactory, Trainer
from usarmjx.train.learning.metrics import MetricsLog, read_lines, summary
from usarmjx.train.learning.processes import ProcessGroup, check_parent, run_lock
from usarmjx.train.learning.run_record import (
    DEFAULT_ENV_ARGUMENTS,
    RECORD_FILE,
    EnvArguments,
    RunRecord,
    load_record,
    make_record,
)
from usarmjx.train.learning.train_state import TrainState
from usarmjx.train.learning.trajectory import RolloutState

if TYPE_CHECKING:
    from usarmjx.train.learning.learner import Trainer


@contextmanager
def compiling(trainer: "Trainer") -> Generator[None]:
    """Compile rollout and update beside what is done meanwhile, and wait for both.

    That begins once the rollout is with XLA, which takes longest for it: two programs that Python traces at
    once take turns.

    What is wrong with one is for its first call to tell, which compiles it again. Worlds that cannot be
    traced have no rollout to compile, and nothing is done.
    """
    if not trainer.env.traceable:
        yield
        return
    place = SingleDeviceSharding(trainer.process_group.device)
    shapes = jax.tree.map(
        lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=place), trainer.start_shapes()
    )
    lowered = Event()
    with ThreadPoolExecutor(2, "compiling") as pool:

        def update_too(collected: tuple[object, ...]) -> None:
            lowered.set()
            pool.submit(trainer.compile_update, shapes[0], collected)

        done = pool.submit(trainer.rollout.compile_ahead, *shapes, tell=update_too)
        done.add_done_callback(lambda _: lowered.set())
        lowered.wait()
        yield
        done.exception()  # until then there may be more to submit


with extra("train"):  # said before anything is built, although it is needed only later
    need_module("brax")
    need_module("tensorboardX")


@dataclass(frozen=True)
class TrainResult:
    """What became of a run.

    Attributes:
        run: Its folder.
        iterations: Updates in all.
        agent_steps: Steps of all robots in all.
        last_metrics: What was written of the last iteration.
    """

    run: Path
    iterations: int
    agent_steps: int
    last_metrics: dict[str, Any]


def train(  # noqa: PLR0913 - all but three may be left out
    env: Env | EnvFactory,
    config: Config,
    out: str | Path,
    resume: bool = False,
    *,
    origin: EnvArguments = DEFAULT_ENV_ARGUMENTS,
    source: TrainedNetworks | None = None,
    progress: bool = True,
    watch: Callable[[dict[str, Any]], None] | None = None,
    look: Callable[[EnvState], None] | None = None,
) -> TrainResult:
    """Train a policy; in every process at once, if there are several (see `processes.group`).

    Args:
        env: An environment; or what makes one of a number of worlds and the number of the first of them,
            which it must be if there are several processes.
        config: Settings.
        out: Folder of the run.
        resume: Go on where the run in that folder was left; from the start if it had no checkpoint yet.
        origin: For the record: what the environment was made with.
        source: Networks to begin with; None: random ones. A run that is resumed has its own.
        progress: Show a bar in the terminal.
        watch: Called with what is written of each iteration.
        look: Gets to see the worlds of this process: as they are before the first action, and then again
            and again, see `Rollout.look`.

    Raises:
        UsageError: The folder has a run already, or none to resume, or one that was started otherwise, went
            further than is asked for, or is being trained; a broken checkpoint; numbers of worlds,
            minibatches and processes, or networks to begin with, that do not fit.
        WriteError: The folder cannot be written to, or something is missing there at the end.
    """
    out, process_group = Path(out), ProcessGroup()
    if resume and not (out / RECORD_FILE).exists():
        raise UsageError(f"nothing to resume in {out}: it has no {RECORD_FILE}")
    with ExitStack() as held:
        if (out / RECORD_FILE).exists():
            _lock(held, out, process_group)
        if not resume:
            _check_new(out, process_group)
        process_group.barrier("look for a run")  # before anyone writes one
        trainer = Trainer(env, config, process_group)
        trainer.rollout.look = look or trainer.rollout.look
        record = make_record(trainer.env, config, process_group.count, origin)
        checkpoints = Checkpoints(out, process_group, config.keep)
        if resume:
            old = load_record(out)
            record.check_resumes(old, out)
            _check_ahead(trainer, checkpoints)
            record = replace(record, began_with=old.began_with)
        else:
            _lock(held, out, process_group)
            _check_new(out, process_group)  # another one may have been quicker
        if source is not None:
            source.check(trainer.networks)
            record = replace(record, began_with=source.origin)
        check_begun(checkpoints, record, source)
        _prepare(out, record, process_group)
        began = time.perf_counter()
        with compiling(trainer):
            train_state, worlds, before = _restore(trainer, checkpoints, source)
        trainer.rollout.look(worlds.env_state)
        log = MetricsLog(out, trainer.iterations, before, bar=progress) if process_group.index == 0 else None
        left = train_state, worlds, before
        return _run(trainer, checkpoints, left, log, watch or (lambda line: None), began)


def _lock(held: ExitStack, out: Path, process_group: ProcessGroup) -> None:
    """Keep other trainers out of the folder; the first of several processes does that for all."""
    if process_group.index == 0:
        with writing(out):
            out.mkdir(parents=True, exist_ok=True)
        held.enter_context(run_lock(out))


def _check_new(out: Path, process_group: ProcessGroup) -> None:
    if process_group.index == 0 and (out / RECORD_FILE).exists():
        raise UsageError(f"{out} has a run already; resume it, or choose another folder")


def _check_ahead(trainer: Trainer, checkpoints: Checkpoints) -> None:
    """Refuse to resume a run that has more behind it than is asked for."""
    if checkpoints.all():
        done = checkpoints.meta(checkpoints.find("last"))
        if done["iteration"] > trainer.iterations:
            raise UsageError(
                f"the run in {checkpoints.run} has {done['agent_steps']:,} agent steps behind it, more than "
                f"the {trainer.config.steps:,} that are asked for: ask for as many at least"
            )


def _prepare(out: Path, record: RunRecord, process_group: ProcessGroup) -> None:
    if process_group.index == 0:
        for left in out.glob(f".*{PARTIAL_MARK}-*"):  # by a trainer that was killed
            left.unlink()
        record.save(out)
    process_group.barrier("prepared")


def _restore(
    trainer: Trainer, checkpoints: Checkpoints, source: TrainedNetworks | None
) -> tuple[TrainState, RolloutState, int]:
    train_state, worlds = trainer.start()
    if source is not None:
        train_state = trainer.process_group.device_put(source.begin(train_state, trainer.config))
        # Whoever resumes the run before its next checkpoint needs no source.
        checkpoints.save(0, train_state, worlds, {"agent_steps": 0, "score": None})
        return train_state, worlds, 0
    if not checkpoints.all():
        return train_state, worlds, 0
    path, index = checkpoints.find("last"), trainer.process_group.index
    meta = checkpoints.meta(path)
    if meta["processes"] != trainer.process_group.count:
        raise UsageError(
            f"{path} is of {meta['processes']} processes, these are {trainer.process_group.count}"
        )
    train_state = read_part(path, "learner", train_state, index)
    worlds = read_part(path, "worlds", worlds, index)
    return *trainer.process_group.device_put((train_state, worlds)), meta["iteration"]


def _mean_score(lines: list[dict[str, Any]]) -> float | None:
    """Return the mean score of the episodes of some iterations; None where none ended."""
    rows = [(line["episodes"], line["score"]) for line in lines if line["score"] is not None]
    count = sum(episodes for episodes, _ in rows)
    return sum(episodes * score for episodes, score in rows) / count if count else None


def _judged(trainer: Trainer, train_state: TrainState, lines: list[dict[str, Any]]) -> dict[str, Any]:
    """Return a checkpoint's score and what kind of one it is: under a curriculum not that of easy arenas."""
    if not trainer.config.curriculum:
        return {"score": _mean_score(lines), "kind": "in training"}
    first = trainer.process_group.index == 0  # who writes the note
    return {"score": trainer.full_score(train_state) if first else None, "kind": FULL}


def _save(
    checkpoints: Checkpoints, iteration: int, state: tuple[TrainState, RolloutState], note: dict[str, Any]
) -> WriteError | None:
    """Write a checkpoint, and return why it could not be written."""
    try:
        checkpoints.save(iteration, *state, note)
    except WriteError as error:
        return error
    return None


Unread: TypeAlias = list[tuple[int, dict[str, jax.Array]]]
"""Iterations with their numbers for the log, which may still be at work."""


def _iterated(
    trainer: Trainer, left: tuple[TrainState, RolloutState, int]
) -> Iterator[tuple[int, tuple[TrainState, RolloutState], Unread, bool]]:
    """Iterate to the end, from where it was left.

    Yields:
        The iteration's number and what it left; what can be read of iterations by now: the one before, while
        this one is at work, so that the device does not wait for the host; and whether a checkpoint is due:
        then of this one, too.
    """
    train_state, worlds, before = left
    unread: Unread = []
    for iteration in range(before + 1, trainer.iterations + 1):
        train_state, worlds, known = trainer.iterate(train_state, worlds, iteration - 1)
        due = iteration % trainer.config.checkpoint_every == 0 or iteration == trainer.iterations
        ready = [*unread, (iteration, known)] if due else unread
        unread = [] if due else [(iteration, known)]
        yield iteration, (train_state, worlds), ready, due


def _line(trainer: Trainer, iteration: int, sums: dict[str, float], rate: float) -> dict[str, Any]:
    """Return what is written of an iteration."""
    world_steps = trainer.config.rollout * trainer.config.worlds
    return {
        "iteration": iteration,
        "agent_steps": iteration * world_steps * trainer.agents,
        "steps_per_s": rate,
        "level": trainer.level(iteration - 1),
        **summary(sums, world_steps),
    }


def _run(
    trainer: Trainer,
    checkpoints: Checkpoints,
    left: tuple[TrainState, RolloutState, int],
    log: MetricsLog | None,
    watch: Callable[[dict[str, Any]], None],
    began: float,
) -> TrainResult:
    """Iterate to the end, from where it was left; the first iteration's time is from when it compiled."""
    iterations, out = trainer.iterations, checkpoints.run
    steps = trainer.config.rollout * trainer.config.worlds * trainer.agents
    lines: list[dict[str, Any]] = []  # of the iterations since the last checkpoint
    line: dict[str, Any] = {}
    missing: WriteError | None = None
    with log or nullcontext():
        for iteration, state, ready, due in _iterated(trainer, left):
            for number, known in ready:
                sums = {name: float(one) for name, one in jax.device_get(known).items()}
                began, seconds = (now := time.perf_counter()), now - began
                line = _line(trainer, number, sums, steps / seconds)
                lines.append(line)
                if log:
                    log.write(line)
                if number < iteration:
                    watch(line)
            if due:
                note = {"agent_steps": iteration * steps, **_judged(trainer, state[0], lines)}
                missing = _save(checkpoints, iteration, state, note)
                if log and missing and iteration < iterations:
                    log.say(f"{missing}; training goes on, and the next checkpoint is tried")
                lines.clear()
                watch(line)
                began = time.perf_counter()
            check_parent()
        if missing:
            raise WriteError(f"{missing}; the last checkpoint is missing: resume the run from the one before")
        if log:
            log.check_whole()
    if not line:  # the run was over already
        line = (read_lines(out / "metrics.jsonl") or [{}])[-1]
    return TrainResult(out, iterations, iterations * steps, line)
