"""Training: rollout, update, log, checkpoint; and going on where a run was left."""

import time
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Any

import jax
from jax.sharding import SingleDeviceSharding

from usarmjx.base.errors import UsageError, extra, need_module
from usarmjx.base.files import PARTIAL_MARK, writing
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.state import EnvState
from usarmjx.train.learning.checkpoint import SET, Checkpoints, read_part
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
from usarmjx.train.learning.iterations import Records, RunOutputs, TrainResult, run_iterations
from usarmjx.train.learning.learner import EnvFactory, Trainer
from usarmjx.train.learning.metrics import MetricsLog
from usarmjx.train.learning.processes import ProcessGroup, run_lock
from usarmjx.train.learning.stopping import StopRequest
from usarmjx.train.learning.train_state import TrainState
from usarmjx.train.learning.trajectory import Inspector, RolloutState

if TYPE_CHECKING:
    from usarmjx.train.learning.learner import Trainer


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
    """Train a policy; in every process at once, if there are several (see `processes.group`).

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
    if meta["processes"] != trainer.process_group.count:
        raise UsageError(
            f"{path} is of {meta['processes']} processes, these are {trainer.process_group.count}"
        )
    train_state = read_part(path, "learner", train_state, index)
    worlds = read_part(path, "worlds", worlds, index)
    return *trainer.process_group.device_put((train_state, worlds)), meta["iteration"]
