"""Iterations of a training, or of several at once: numbers, logs and checkpoints, until the end or a stop."""

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, closing
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import jax

from usarmjx.base.errors import WriteError
from usarmjx.train.learning.checkpoint import FULL
from usarmjx.train.learning.launch import check_parent
from usarmjx.train.learning.learner import Trainer
from usarmjx.train.learning.metrics import MetricsLog, read_lines, summary
from usarmjx.train.learning.stopping import StopRequest
from usarmjx.train.learning.train_state import TrainState
from usarmjx.train.learning.trajectory import RolloutState

Records: TypeAlias = list[dict[str, Any]]
"""A record for each of the runs that train at once."""
IterationsWatch: TypeAlias = Callable[[Records], None]
"""Receives the records of each iteration."""
SaveCheckpoint: TypeAlias = Callable[[int, TrainState, RolloutState, Records], None]
"""Writes a checkpoint after an iteration, with a note for each run."""


@dataclass(frozen=True)
class TrainResult:
    """Result of a run.

    Attributes:
        run: Its folder.
        iterations: Updates in all.
        agent_steps: Steps of all robots in all.
        last_metrics: Record of the last iteration.
        stopped: Whether a signal ended it before its last iteration.
    """

    run: Path
    iterations: int
    agent_steps: int
    last_metrics: dict[str, Any]
    stopped: bool = False


def _mean_score(lines: list[dict[str, Any]]) -> float | None:
    """Return the mean score of the episodes of some iterations; None where none ended."""
    rows = [(line["episodes"], line["score"]) for line in lines if line["score"] is not None]
    count = sum(episodes for episodes, _ in rows)
    return sum(episodes * score for episodes, score in rows) / count if count else None


def _scored(trainer: Trainer, train_state: TrainState, lines: list[dict[str, Any]]) -> dict[str, Any]:
    """Return a checkpoint's score and its kind: under a curriculum not that of easy arenas."""
    if not trainer.config.curriculum:
        return {"score": _mean_score(lines), "kind": "in training"}
    first = trainer.process_group.index == 0  # who writes the note
    return {"score": trainer.full_difficulty_score(train_state) if first else None, "kind": FULL}


def _notes(trainer: Trainer, train_state: TrainState, agent_steps: int, recent: list[Records]) -> Records:
    """Return a checkpoint's note for each run, from the records of a whole interval of checkpoints."""
    scores = [_scored(trainer, train_state, list(run)) for run in zip(*recent, strict=True)]
    return [{"agent_steps": agent_steps, **one} for one in scores]


def _recent_records(folders: Sequence[Path], done: int, count: int) -> deque[Records]:
    """Return the records before iteration `done + 1`, `count` iterations at most.

    Checkpoints are compared by the mean over as many iterations: one that a signal makes after few would
    else be the best by luck.
    """
    runs = [read_lines(folder / "metrics.jsonl") for folder in folders] if done else []
    kept = [[line for line in run if done - count < line["iteration"] <= done] for run in runs]
    return deque(map(list, zip(*kept, strict=False)), maxlen=count)


class _CheckpointWriter:
    """Writer of checkpoints in a thread beside the training, one at a time.

    A checkpoint of a GPU's worlds takes longer than an iteration to fetch and write, and the device would
    wait for it. Several processes write together, which takes collectives that must not meet those of an
    update: then each save is waited for.

    Args:
        save: Writes a checkpoint, as `Checkpoints.save`, with a note for each run.
        beside: Whether a thread writes.
        say: Receives a line about a checkpoint that could not be written.
        watch: Receives the records of iterations, one for each run, after the checkpoints before are written.
    """

    def __init__(
        self,
        save: SaveCheckpoint,
        beside: bool,
        say: Callable[[str], None],
        watch: IterationsWatch,
    ) -> None:
        self._save, self._say, self._watch = save, say, watch
        self._pool = ThreadPoolExecutor(1, "checkpoints") if beside else None
        self._lines: list[Records] = []
        self._written: Future[WriteError | None] = Future()
        self._written.set_result(None)

    def save(self, iteration: int, state: tuple[TrainState, RolloutState], notes: Records) -> None:
        """Begin to write a checkpoint; `settle` the one before first."""
        if self._pool is None:
            self._written = Future()
            self._written.set_result(self._write(iteration, state, notes))
        else:
            self._written = self._pool.submit(self._write, iteration, state, notes)

    def show(self, lines: Records, last: bool) -> None:
        """Hand on an iteration's records, at once unless a checkpoint is being written or it is the last."""
        self._lines.append(lines)
        if self._written.done() and not last:
            self.settle()

    def settle(self) -> None:
        """Wait for the checkpoint that is being written, and hand on the records that waited for it."""
        if fault := self.finish():
            self._say(f"{fault}; training goes on, and the next checkpoint is tried")

    def finish(self) -> WriteError | None:
        """Do as `settle` does; return why the checkpoint could not be written, or None."""
        fault = self._written.result()
        self._written = Future()
        self._written.set_result(None)
        while self._lines:
            self._watch(self._lines.pop(0))
        return fault

    def _write(
        self, iteration: int, state: tuple[TrainState, RolloutState], notes: Records
    ) -> WriteError | None:
        try:
            self._save(iteration, *state, notes)
        except WriteError as error:
            return error
        return None

    def close(self) -> None:
        """Wait, and end the thread."""
        if self._pool is not None:
            self._pool.shutdown()


def ignore(what: object) -> None:
    """Do nothing: the default of what watches."""
    del what


class _Iteration(NamedTuple):
    """An iteration whose numbers may still be at work.

    Attributes:
        number: From 1.
        known: Numbers for the log.
        state: The state after it, if a checkpoint of it is due; else None.
        last: Whether the training ends with it.
    """

    number: int
    known: dict[str, jax.Array]
    state: tuple[TrainState, RolloutState] | None
    last: bool


def _iterations(
    trainer: Trainer, restored: tuple[TrainState, RolloutState, int], stop: StopRequest
) -> Iterator[list[_Iteration]]:
    """Iterate to the end, from where it was left, or until a stop is requested.

    Yields:
        Iterations whose numbers can be read: the one before, while the next one is at work, so that the
        device does not wait for the host; at the end the last one, too. Worlds that are stepped by the host
        leave nothing at work: then it is the iteration itself, and its time is its own.
    """
    train_state, worlds, done = restored
    pending: list[_Iteration] = []
    for number in range(done + 1, trainer.iterations + 1):
        train_state, worlds, known = trainer.iterate(train_state, worlds, number - 1)
        if trainer.process_group.count == 1:
            stop.arm()
        last = number == trainer.iterations or stop.requested
        due = last or number % trainer.config.checkpoint_interval == 0
        pending.append(_Iteration(number, known, (train_state, worlds) if due else None, last))
        if last or not trainer.env.traceable:
            ready, pending = pending, []
        else:
            ready, pending = pending[:-1], pending[-1:]
        yield ready
        if last:
            return


def _line(
    trainer: Trainer, iteration: int, sums: dict[str, float], rate: float, waits: dict[str, float]
) -> dict[str, Any]:
    """Return the record of an iteration."""
    world_steps = trainer.config.rollout_length * trainer.config.num_worlds
    return {
        "iteration": iteration,
        "agent_steps": iteration * world_steps * trainer.agents,
        "steps_per_s": rate,
        "waits": waits,
        "level": trainer.level(iteration - 1),
        **summary(sums, world_steps),
    }


def _write_records(logs: Sequence[MetricsLog], lines: Records) -> None:
    """Write the records of all runs; the first log shows what all are about together."""
    for number, (log, line) in enumerate(zip(logs, lines, strict=True)):
        log.write(line, shown=_together(lines) if number == 0 and len(lines) > 1 else None)


def _together(lines: Records) -> dict[str, Any]:
    """Return a record of all runs: the sum of their rates, and means of what else is shown."""
    means: dict[str, Any] = {}
    for name in ("return", "score", "bad"):
        there = [line[name] for line in lines if line[name] is not None]
        means[name] = sum(there) / len(there) if there else None
    return {**means, "steps_per_s": sum(line["steps_per_s"] for line in lines)}


@dataclass(frozen=True, kw_only=True)
class RunOutputs:
    """Outputs of the runs that train at once.

    Attributes:
        folders: Folder of each run.
        logs: Log of each run; none in a process that writes none.
        save: Writes a checkpoint, as `Checkpoints.save`, with a note for each run.
        watch: Receives the records of each iteration, one for each run.
    """

    folders: Sequence[Path]
    logs: Sequence[MetricsLog]
    save: SaveCheckpoint
    watch: IterationsWatch


def run_iterations(
    trainer: Trainer,
    outputs: RunOutputs,
    restored: tuple[TrainState, RolloutState, int],
    began: float,
    stop: StopRequest | None,
) -> list[TrainResult]:
    """Iterate to the end, from where it was left; the first iteration's time is from when it compiled.

    Args:
        trainer: Rollouts and updates of all runs.
        outputs: Receivers of their numbers and checkpoints.
        restored: Train state, rollout state and number of iterations behind them.
        began: When the first iteration began to compile, by the performance counter [s].
        stop: Ends the training early, with a checkpoint.

    Raises:
        WriteError: The last checkpoint, or a line of a log, is missing at the end.
    """
    logs, done, stop, waits = outputs.logs, restored[2], stop or StopRequest(ignore), trainer.waits
    steps = trainer.config.rollout_length * trainer.config.num_worlds * trainer.agents
    recent, lines = _recent_records(outputs.folders, done, trainer.config.checkpoint_interval), Records()
    say = logs[0].say if logs else ignore
    writer = _CheckpointWriter(outputs.save, trainer.process_group.count == 1, say, outputs.watch)
    with ExitStack() as held:
        for log in logs:
            held.enter_context(log)
        held.enter_context(closing(writer))
        for finished in chain.from_iterable(_iterations(trainer, restored, stop)):
            done = finished.number
            with waits.timed("device"):
                numbers = trainer.numbers(finished.known)
            began, seconds = (now := time.perf_counter()), now - began
            waited = waits.take()
            lines = [_line(trainer, done, sums, steps / seconds, waited) for sums in numbers]
            recent.append(lines)
            if finished.state is not None:
                with waits.timed("checkpoint"):
                    writer.settle()
            with waits.timed("log"):
                _write_records(logs, lines)
            if finished.state is not None:
                with waits.timed("checkpoint"):
                    writer.save(
                        done, finished.state, _notes(trainer, finished.state[0], done * steps, list(recent))
                    )
            with waits.timed("log"):
                writer.show(lines, last=finished.last)
            check_parent()
        if fault := writer.finish():
            raise WriteError(f"{fault}; the last checkpoint is missing: resume the run from the one before")
        for log in logs:
            log.check_whole()
    if not lines:  # the run was over already
        lines = [(read_lines(folder / "metrics.jsonl") or [{}])[-1] for folder in outputs.folders]
    return [
        TrainResult(folder, done, done * steps, line, done < trainer.iterations)
        for folder, line in zip(outputs.folders, lines, strict=True)
    ]
