"""Training: iterations with rollout, update, log, checkpoint; and going on where a run was left.

Ctrl-C and SIGTERM are requests: a training writes a checkpoint before it ends.
"""

import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from threading import Event
from types import FrameType, TracebackType
from typing import Any, NamedTuple, TypeAlias

import jax
from jax.sharding import SingleDeviceSharding

from usarmjx.base.errors import UsageError, WriteError, extra, need_module
from usarmjx.base.files import PARTIAL_MARK, writing
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.state import EnvState
from usarmjx.train.learning.checkpoint import FULL, SET, Checkpoints, read_part
from usarmjx.train.learning.config import (
    DEFAULT_ENV_ARGUMENTS,
    RECORD_FILE,
    Config,
    EnvArguments,
    RunRecord,
    load_record,
    make_record,
)
from usarmjx.train.learning.fine_tuning import TrainedNetworks, check_source
from usarmjx.train.learning.launch import check_parent
from usarmjx.train.learning.league import write_standings
from usarmjx.train.learning.learner import EnvFactory, Trainer
from usarmjx.train.learning.metrics import MetricsLog, read_lines, summary
from usarmjx.train.learning.processes import ProcessGroup, run_lock
from usarmjx.train.learning.train_state import TrainState
from usarmjx.train.learning.trajectory import Inspector, RolloutState

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class StopRequest:
    """Request to end a training after the iteration at work, made by a signal.

    Signals before `arm` act as usual, since there is nothing to keep; so does a second one. Only the main
    thread of a process gets signals, elsewhere none is caught.

    Args:
        say: Receives a line when the request is made.
        on_arm: Called before the first signal is caught, as to end another handling of signals.

    Attributes:
        number: Number of the signal; 0 without a request.
    """

    def __init__(self, say: Callable[[str], None], on_arm: Callable[[], None] | None = None) -> None:
        self._say, self._on_arm = say, on_arm
        self._before: dict[int, object] = {}
        self.number = 0

    def __enter__(self) -> "StopRequest":
        """Begin; `arm` catches signals."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Let signals act as before."""
        self._restore()

    def arm(self) -> None:
        """Catch signals from now on, except those that are ignored, as under `nohup`."""
        # Python lets only its main thread catch signals.
        if self._before or self.number or threading.current_thread() is not threading.main_thread():
            return
        if self._on_arm is not None:
            self._on_arm()
        for number in SIGNALS:
            if signal.getsignal(number) is not signal.SIG_IGN:
                self._before[number] = signal.signal(number, self._request)

    def _request(self, number: int, frame: FrameType | None) -> None:
        del frame
        # First, so that a second signal ends the process at once.
        self._restore()
        self.number = number
        name = signal.Signals(number).name
        self._say(f"{name}: ending with a checkpoint after this iteration; a second one ends at once")

    def _restore(self) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)  # pyright: ignore[reportArgumentType]
        self._before = {}

    @property
    def requested(self) -> bool:
        """Whether the training is requested to end."""
        return self.number != 0


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
    # Weighted by episodes: an iteration with one that ended says little.
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
    # Logs may differ in length: a kill may come after the line of one and before that of the next.
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
        # A finished future stands for no checkpoint at work, so nobody has to ask which it is.
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
        # Records wait for their checkpoint: a watcher may read the folder when it gets them.
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
        # Alone only: a stop in one of several processes would leave the others waiting in a collective.
        if trainer.process_group.count == 1:
            # After the first iteration: before there is nothing that a checkpoint could keep.
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
        # Entered last, so closed first: the thread's last words still reach the logs.
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


@contextmanager
def compiling(trainer: "Trainer") -> Generator[None]:
    """Compile rollout and update in threads while the caller prepares, and wait for both.

    The update starts once the rollout is with XLA, which takes longest for it: two programs that Python
    traces at once take turns.

    A fault is left to the first call, which compiles again. Worlds that cannot be
    traced have no rollout to compile, and nothing is done.
    """
    if not trainer.env.traceable:
        yield
        return
    # Shapes with a device: a program that is compiled for no place would be compiled again at the first call.
    place = SingleDeviceSharding(trainer.process_group.device)
    shapes = jax.tree.map(
        lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=place), trainer.start_shapes()
    )
    lowered = Event()
    with ThreadPoolExecutor(2, "compiling") as pool:

        def compile_update(collected: tuple[object, ...]) -> None:
            lowered.set()
            pool.submit(trainer.compile_update, shapes[0], collected)

        done = pool.submit(trainer.rollout.compile_ahead, *shapes, tell=compile_update)
        # Also after a fault, or the wait below would never end.
        done.add_done_callback(lambda _: lowered.set())
        lowered.wait()
        yield
        done.exception()  # until then there may be more to submit


with extra("train"):  # said before anything is built, although it is needed only later
    need_module("brax")
    need_module("tensorboardX")


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
    inspect: Inspector | None = None,
    stop: StopRequest | None = None,
) -> TrainResult:
    """Train a policy; in every process at once, if there are several (see `processes.initialize`).

    Args:
        env: An environment; or what makes one of a number of worlds and the number of the first of them,
            which it must be if there are several processes.
        config: Settings.
        out: Folder of the run.
        resume: Go on where the run in that folder was left; from the start if it had no checkpoint yet.
        origin: Arguments that the environment was made with, for the record.
        source: Networks to begin with; None: random ones. A run that is resumed has its own.
        progress: Show a bar in the terminal.
        watch: Receives the record of each iteration.
        look: Receives the worlds of this process: as they are before the first action, and then again
            and again, see `Rollout.look`.
        inspect: Receives the inputs of each rollout of this process.
        stop: Ends the training early, with a checkpoint; for a single process.

    Raises:
        UsageError: The folder has a run already, or none to resume, or one with other settings, more
            iterations than requested, or another trainer; a broken checkpoint; numbers of worlds,
            minibatches and processes, or networks to begin with, that do not fit.
        WriteError: The folder cannot be written to, or something is missing there at the end.
    """
    out, process_group = Path(out), ProcessGroup()
    with ExitStack() as held:
        _open_run(held, out, process_group, resume)
        if not resume:
            _check_new(out, process_group)
        process_group.barrier("look for a run")  # before anyone writes one
        trainer = Trainer(env, config, process_group)
        trainer.rollout.look, trainer.inspect = look or trainer.rollout.look, inspect
        checkpoints = Checkpoints(out, process_group, config.keep_checkpoints)
        if not resume:
            # The lock makes the folder; it comes late, so that refused settings leave no folder behind.
            lock_run(held, out, process_group)
            _check_new(out, process_group)  # another one may have been quicker
        record = make_record(trainer.env, config, process_group.count, origin)
        _prepare(out, _checked_record(record, trainer, checkpoints, resume, source), process_group)
        began = time.perf_counter()
        with compiling(trainer):
            train_state, worlds, before = _restore(trainer, checkpoints, source)
        trainer.rollout.look(worlds.env_state)
        logs = [MetricsLog(out, trainer.iterations, before, bar=progress)] if not process_group.index else []
        outputs = _outputs(checkpoints, logs, watch)
        return run_iterations(trainer, outputs, (train_state, worlds, before), began, stop)[0]


def _outputs(
    checkpoints: Checkpoints, logs: list[MetricsLog], watch: Callable[[dict[str, Any]], None] | None
) -> RunOutputs:
    """Return the outputs of a run alone."""

    def save(iteration: int, train_state: TrainState, worlds: RolloutState, notes: Records) -> None:
        checkpoints.save(iteration, train_state, worlds, notes[0])
        if train_state.league is not None and logs:
            write_standings(checkpoints.run, iteration, train_state.league)

    def show(lines: Records) -> None:
        if watch is not None:
            watch(lines[0])

    return RunOutputs(folders=[checkpoints.run], logs=logs, save=save, watch=show)


def _open_run(held: ExitStack, out: Path, process_group: ProcessGroup, resume: bool) -> None:
    """Lock the folder if it has a run; refuse to resume where there is none."""
    if resume and not (out / RECORD_FILE).exists():
        raise UsageError(f"nothing to resume in {out}: it has no {RECORD_FILE}")
    if (out / RECORD_FILE).exists():
        lock_run(held, out, process_group)


def _checked_record(
    record: RunRecord,
    trainer: Trainer,
    checkpoints: Checkpoints,
    resume: bool,
    source: TrainedNetworks | None,
) -> RunRecord:
    """Return the record with the run that it began with, after a look at the run to resume."""
    if resume:
        old = load_record(checkpoints.run)
        record.check_resumes(old, checkpoints.run)
        check_ahead(trainer, checkpoints)
        record = replace(record, began_with=old.began_with)
    if source is not None:
        source.check(trainer.networks)
        record = replace(record, began_with=source.origin)
    check_source(checkpoints, record, source)
    return record


def lock_run(held: ExitStack, out: Path, process_group: ProcessGroup) -> None:
    """Keep other trainers out of the folder; the first of several processes does that for all."""
    if process_group.index == 0:
        with writing(out):
            out.mkdir(parents=True, exist_ok=True)
        held.enter_context(run_lock(out))


def _check_new(out: Path, process_group: ProcessGroup) -> None:
    if process_group.index == 0 and (out / RECORD_FILE).exists():
        raise UsageError(f"{out} has a run already; resume it, or choose another folder")


def check_ahead(trainer: Trainer, checkpoints: Checkpoints) -> None:
    """Refuse to resume a run that has more agent steps than requested."""
    if checkpoints.all():
        done = checkpoints.meta(checkpoints.find("last"))
        if done["iteration"] > trainer.iterations:
            raise UsageError(
                f"the run in {checkpoints.run} has {done['agent_steps']:,} agent steps behind it, more than "
                f"the requested {trainer.config.total_steps:,}: request at least as many"
            )


def _prepare(out: Path, record: RunRecord, process_group: ProcessGroup) -> None:
    if process_group.index == 0:
        # Under the lock of the run: no live trainer is writing these.
        for left in out.glob(f".*{PARTIAL_MARK}-*"):  # by a trainer that was killed
            left.unlink()
        record.save(out)
    process_group.barrier("prepared")


def _restore(
    trainer: Trainer, checkpoints: Checkpoints, source: TrainedNetworks | None
) -> tuple[TrainState, RolloutState, int]:
    # Needed to resume, too: a checkpoint is read into trees of these shapes.
    train_state, worlds = trainer.start()
    if source is not None:
        train_state = trainer.process_group.device_put(source.begin(train_state, trainer.config))
        # A run that is resumed before its next checkpoint needs no source.
        checkpoints.save(0, train_state, worlds, {"agent_steps": 0, "score": None})
        return train_state, worlds, 0
    if not checkpoints.all():
        return train_state, worlds, 0
    path, index = checkpoints.find("last"), trainer.process_group.index
    meta = checkpoints.meta(path)
    if SET in meta:
        raise UsageError(
            f"{checkpoints.run} is one of {meta[SET]} seeds that train together: resume the folder above it"
        )
    # Worlds are stored by process: another number of processes would have to divide them anew.
    if meta["processes"] != trainer.process_group.count:
        raise UsageError(
            f"{path} is of {meta['processes']} processes, these are {trainer.process_group.count}"
        )
    train_state = read_part(path, "learner", train_state, index)
    worlds = read_part(path, "worlds", worlds, index)
    return *trainer.process_group.device_put((train_state, worlds)), meta["iteration"]
