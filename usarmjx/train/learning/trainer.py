"""Training: rollout, update, log, checkpoint; and going on where a run was left."""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, TypeAlias

import jax
from jax.sharding import PartitionSpec

from usarmjx.base.errors import UsageError, WriteError
from usarmjx.base.extras import extra
from usarmjx.base.files import PARTIAL, writing
from usarmjx.base.kept_programs import AheadProgram, ProgramKeeper, compile_program
from usarmjx.sim.scene import Scene
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.policy import Carry, Policy
from usarmjx.train.envs.splits import held_out
from usarmjx.train.envs.state import EnvState
from usarmjx.train.evaluation.evaluate import play_episodes
from usarmjx.train.learning.ahead import compiling
from usarmjx.train.learning.checkpoint import FULL, Checkpoints, read_part
from usarmjx.train.learning.config import Config
from usarmjx.train.learning.fine_tuning import TrainedNetworks, check_begun
from usarmjx.train.learning.imitation import teacher_of
from usarmjx.train.learning.metrics import Log, read_lines, summary
from usarmjx.train.learning.ppo import update
from usarmjx.train.learning.record import (
    DEFAULT_ENV_ARGUMENTS,
    RECORD_FILE,
    EnvArguments,
    RunRecord,
    load_record,
    make_record,
)
from usarmjx.train.learning.renewal import ArenaStream
from usarmjx.train.learning.rollout import Rollout
from usarmjx.train.learning.train_state import (
    ROLLOUT_STREAM,
    UPDATE_STREAM,
    TrainState,
    make_networks,
    policy_params,
    train_state_maker,
)
from usarmjx.train.learning.trajectory import RolloutState
from usarmjx.train.processes.group import PROCESS_AXIS, ProcessGroup
from usarmjx.train.processes.launch import check_parent
from usarmjx.train.processes.lock import run_lock

with extra("train"):  # said before anything is built, although it is needed only later
    import_module("brax")
    import_module("tensorboardX")

JUDGING_SEED = 2**31 - 1
"""Of the episodes in which policies are compared under a curriculum."""
EnvFactory = Callable[[int, int], Env]
"""From a number of worlds, and the number of the first of them, to an environment."""


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


class Trainer:
    """A run in this process, together with the others if there are any.

    Args:
        env: The worlds of this process, or what makes them.
        config: Settings.
        process_group: All processes.
    """

    def __init__(self, env: Env | EnvFactory, config: Config, process_group: ProcessGroup) -> None:
        config.check_processes(process_group.count)
        share = config.worlds // process_group.count
        if callable(env):
            env = env(share, process_group.index * share)
        if env.worlds != share:
            raise UsageError(
                f"the environment has {env.worlds} worlds; {config.worlds} worlds of {process_group.count} "
                f"processes need {share}"
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
        self.stream = ArenaStream(env, config.renew, self.iterations)
        teacher = teacher_of(env) if config.imitate else None
        known: ProgramKeeper | None = getattr(env, "keeper", None)
        # Of each seed they are the same.
        general = replace(config, seed=0, checkpoint_every=1, keep=1)
        self._keeper = known and known.of(general, self.networks, process_group.index, process_group.count)
        first = process_group.index * share
        self.rollout = Rollout(env, self.networks, config, first, teacher, self._keeper)
        timed, once = PartitionSpec(None, PROCESS_AXIS), PartitionSpec(PROCESS_AXIS)
        self._begin = train_state_maker(self.networks, config, self._keeper)
        self._everywhere = jax.shard_map(
            partial(update, self.networks, config, process_group.count),
            mesh=process_group.mesh,
            in_specs=(PartitionSpec(), (timed, once, once), PartitionSpec()),
            out_specs=(PartitionSpec(), PartitionSpec()),
            check_vma=False,
        )
        self._update = AheadProgram(compile_program(self._updated, self._keeper, "Trainer", precise=False))
        keys = [jax.random.fold_in(jax.random.key(config.seed), s) for s in (ROLLOUT_STREAM, UPDATE_STREAM)]
        self._key, updates = process_group.device_put((keys[0], jax.random.key_data(keys[1])))
        self._stream = process_group.to_global(updates, None)
        self._fold = jax.jit(jax.random.fold_in)
        self._sums = jax.jit(_with_axis)
        self._best_actions = jax.jit(partial(self.networks.policy.act, deterministic=True))

    def start(self) -> tuple[TrainState, RolloutState]:
        """Return the train state before the first update, and worlds at their start."""
        return self.process_group.device_put(self.starts()[:2])

    def starts(self) -> tuple[TrainState, RolloutState, jax.Array]:
        """Return what the first rollout is given, but for where it is."""
        learner = self._begin(jax.random.key(self.config.seed))
        return learner, self.rollout.start(self.level(0)), self._key

    def start_shapes(self) -> tuple[TrainState, RolloutState, jax.Array]:
        """Return the shapes of what `starts` returns."""
        if self._keeper is None:
            return jax.eval_shape(self.starts)
        return self._keeper.value("Trainer.starts", partial(jax.eval_shape, self.starts))

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

    def full_score(self, train_state: TrainState) -> float | None:
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
        scores = play_episodes(self.env, Policy(start, act), self.env.worlds, JUDGING_SEED).scores
        return float(scores.mean()) if len(scores) else None

    def _updated(self, *args: Any) -> tuple[TrainState, dict[str, jax.Array]]:  # noqa: ANN401 - PyTrees
        """Return the train state after an update, and numbers for the log."""
        return self._everywhere(*args)

    def level(self, iteration: int) -> float:
        """Return how difficult the arenas in play are before an iteration, counted from 0."""
        share = self.config.curriculum * self.iterations
        return min(1.0, iteration / share) if share else 1.0

    def iterate(
        self, train_state: TrainState, worlds: RolloutState, iteration: int
    ) -> tuple[TrainState, RolloutState, dict[str, jax.Array]]:
        """Let the robots act, and update.

        Args:
            train_state: So far.
            worlds: Of this process.
            iteration: Number of this one, from 0.

        Returns:
            Train state and rollout state, and numbers for the log.
        """
        arenas = self.stream.arenas(iteration)
        if self.config.curriculum or self.stream.begins(iteration):
            state = self.env.at_level(worlds.env_state, self.level(iteration), arenas)
            worlds = worlds.replace(env_state=self.process_group.device_put(state))
        key = self._fold(self._key, iteration)
        worlds, trajectory, ends, sums = self.rollout.collect(train_state, worlds, key)
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
        log = Log(out, trainer.iterations, before, bar=progress) if process_group.index == 0 else None
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
        for left in out.glob(f".*{PARTIAL}-*"):  # by a trainer that was killed
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
    log: Log | None,
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
