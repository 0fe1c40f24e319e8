"""The plan of a training, of one seed or several: what is typed, over what else gives a value."""

import os
from collections.abc import Generator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.base.settings import FileValue, Text, default_reader, parse_assignments, read_file
from usarmjx.base.settings.json_file import read_json
from usarmjx.cli.common import announce, ends_on_signals, say, tried_on
from usarmjx.cli.setting_options import option_name
from usarmjx.cli.task_options import field_texts, fields_over

if TYPE_CHECKING:
    from usarmjx.train.envs.env import Env
    from usarmjx.train.envs.task import Task
    from usarmjx.train.learning.config import Config, EnvArguments
    from usarmjx.train.learning.fine_tuning import TrainedNetworks
    from usarmjx.train.learning.trainer import StopRequest, TrainResult


SET_FILE = "seeds.json"
"""`SET_FILE` of the trainer, whose module imports JAX."""
CURRICULUM = "curriculum"
"""Field of `Config`, whose module imports JAX."""


@dataclass(frozen=True, kw_only=True)
class TrainOptions:
    """Options of a training, as typed.

    Attributes:
        out: Folder of the run.
        engine: Name of the engine, or `auto`.
        resume: Whether to go on with the run in the folder.
        source: Folder of the run whose networks the new run begins with; None: random ones.
        checkpoint: Checkpoint of that run.
        config: File of settings; None: there is none.
        given: Values of options of their own, by field of `Config`.
        pairs: Settings of the training and fields of the task, `name=value` each.
    """

    out: Path
    engine: str
    resume: bool = False
    source: Path | None = None
    checkpoint: str = "best"
    config: Path | None = None
    given: dict[str, Any]
    pairs: list[str]


@dataclass(frozen=True, kw_only=True)
class RunSettings:
    """Settings that are asked for.

    Attributes:
        training: Checked values by field of `Config`.
        fields: Fields of the task as texts, those of nested settings by names with dots.
    """

    training: dict[str, Any]
    fields: dict[str, str]

    def over(self, training: dict[str, Any], fields: dict[str, str]) -> "RunSettings":
        """Return these over settings and fields that hold where nothing else is asked for."""
        training = {**training, **self.training}
        return RunSettings(training=training, fields=fields_over(self.fields, fields))

    def beyond(self, other: "RunSettings") -> list[str]:
        """Return the fields that the other settings do not have, `name=text` each."""
        return [f"{name}={text}" for name, text in self.fields.items() if name not in other.fields]


@dataclass(frozen=True, kw_only=True)
class RunPlan:
    """Everything that a run is started with.

    Attributes:
        config: Settings of the training.
        overrides: Fields of the task that are set otherwise.
        origin: Engine, and the same fields as texts.
        source: Networks to begin with.
    """

    config: "Config"
    overrides: dict[str, Any]
    origin: "EnvArguments"
    source: "TrainedNetworks | None"


def plan_run(task: str, options: TrainOptions) -> RunPlan:
    """Return the plan of a run, after a line about the defaults of its task that are not those of all tasks.

    Raises:
        UnknownNameError: No such task, engine, setting or field; lists those there are.
        UsageError: A value that is not allowed, or no networks to begin with.
    """
    from usarmjx.train.learning.config import (
        EnvArguments,
        on_gpu,
        task_config,
        turn_settings,
        wheel_settings,
    )
    from usarmjx.train.make import make_task, task_values

    known = make_task(task)
    source, notice, engine, asked = None, "", options.engine, read_settings(known, options)
    if options.resume:
        engine, asked = _as_before(options, asked)
    else:
        if options.source is not None:
            from usarmjx.train.learning.fine_tuning import load_trained

            source = load_trained(options.source, options.checkpoint)
            asked = _as_trained(task, source, asked)
        engine, asked, notice = _as_usual(task, engine, asked)
    overrides = task_values(known, asked.fields)
    played = make_task(task, **overrides)
    # They follow from the task as it is set, so its fields are read first; typed settings still win.
    own = turn_settings(task, played.turn_length) | wheel_settings(task, discrete=played.discrete)
    training = {**own, **asked.training}
    config = task_config(task, gpu=on_gpu(engine), **training)
    if notice:  # once nothing is wrong with what was typed
        say(notice)
    return RunPlan(
        config=config, overrides=overrides, origin=EnvArguments(engine, asked.fields), source=source
    )


def read_settings(task: "Task", options: TrainOptions) -> RunSettings:
    """Return the settings of file, `--set` and options of their own, in this order; the last one counts.

    A name that `Config` has, or had in the version before, is one of the training.

    Raises:
        UnknownNameError: Neither the training nor the task has such a setting; lists those there are.
        UsageError: A value that is not allowed, or one that is given twice.
    """
    from usarmjx.train.learning.config import Config

    reader = default_reader()
    known, own = reader.names(Config), reader.names(type(task))
    data, texts = _config_file(options.config), parse_assignments(options.pairs, "--set")
    for name, value in {**data, **texts}.items():
        if name.partition(".")[0] not in known.keys() | own.keys():
            where = value.place if isinstance(value, FileValue | Text) else ""
            names = ", ".join(dict.fromkeys([*own.values(), *known.values()]))
            raise UnknownNameError(
                f"{where}: the task and its training have no setting {name!r}; they have: {names}"
            )
    first = reader.values(Config, {name: value for name, value in data.items() if name in known})
    typed = reader.values(Config, {name: text for name, text in texts.items() if name in known})
    if twice := sorted(options.given.keys() & typed.keys()):
        raise UsageError(f"{twice[0]} is given twice, by {option_name(twice[0])} and by --set")
    fields = field_texts(task, {name: value for name, value in data.items() if name not in known})
    asked = RunSettings(training={}, fields={name: text for name, text in texts.items() if name not in known})
    # The order counts: a file is weakest, then `--set`, then an option of its own.
    return replace(asked.over({}, fields), training={**first, **typed, **options.given})


def _config_file(path: Path | None) -> dict[str, Any]:
    return {} if path is None else dict(read_file(path).mapping())


def _as_before(options: TrainOptions, asked: RunSettings) -> tuple[str, RunSettings]:
    """Return engine and settings as the run was started, unless asked for otherwise."""
    from usarmjx.train.learning.config import RECORD_FILE, load_record

    if not (options.out / RECORD_FILE).exists():
        return options.engine, asked
    record = load_record(options.out)
    engine = record.engine if options.engine == "auto" else options.engine
    return engine, asked.over(vars(record.config), record.overrides)


def recorded_engine(out: Path) -> str:
    """Return the engine that a run was started with, before JAX is imported; `auto` if there is no record."""
    try:
        # `RECORD_FILE` of the trainings, whose module imports JAX.
        return str(read_json(out / "config.json")["engine"])
    except (UsageError, KeyError, TypeError):  # `load_record` refuses the file
        return "auto"


def _as_trained(task: str, source: "TrainedNetworks", asked: RunSettings) -> RunSettings:
    """Return the networks' settings and, of the same task, the fields that they were trained with.

    Physics is left out: a run may begin with networks of other physics.
    """
    from usarmjx.train.task_names import same_class

    same = same_class(task, source.record.task)
    fields = {
        name: text
        for name, text in source.record.overrides.items()
        if same and name.partition(".")[0] != "physics"
    }
    chosen = asked.over(source.settings, fields)
    say("; ".join([source.describe(), *chosen.beyond(asked)]))
    return chosen


def _as_usual(task: str, engine: str, asked: RunSettings) -> tuple[str, RunSettings, str]:
    """Return engine and settings of the task's trainings unless asked for otherwise, and a notice."""
    from usarmjx.engines import choose_engine
    from usarmjx.train.learning.config import training_engine, training_fields

    usual = training_engine(task, engine)
    chosen = asked.over({}, training_fields(task, usual))
    if usual == choose_engine(engine, "train"):
        return usual, chosen, ""
    line = f"{task} trains on engine {usual} unless another is named"
    return usual, chosen, ", ".join([line, *chosen.beyond(asked)])


@contextmanager
def stop_request() -> "Generator[StopRequest]":
    """Yield the request that signals make of a training; before its first iteration they end the process."""
    from usarmjx.train.learning.trainer import StopRequest

    # Until the trainer catches signals itself, they end the process at once: nothing is worth keeping yet.
    with ExitStack() as early:
        early.enter_context(ends_on_signals())
        with StopRequest(say, early.close) as request:
            yield request


def trains_seeds(out: Path, count: int | None, resume: bool) -> bool:
    """Return whether several seeds are to be trained: a number of new ones, or those in the folder."""
    return count is not None or (resume and (out / SET_FILE).exists())


def check_alone(views: Mapping[str, bool], processes: int) -> None:
    """Refuse what goes with a single seed only.

    Args:
        views: Whether the run is to be shown, by option.
        processes: Number of processes.

    Raises:
        UsageError: Names it.
    """
    from usarmjx.train.learning.launch import process_info

    if processes > 1 or process_info(os.environ) is not None:
        raise UsageError("several seeds train in one process: leave out --processes, or --seeds")
    if shown := [name for name, wanted in views.items() if wanted]:
        raise UsageError(f"{shown[0]} shows a single seed: leave it out, or --seeds")


def check_curriculum(options: TrainOptions) -> None:
    """Refuse a curriculum, before JAX is imported; other values are refused where they are read.

    Args:
        options: The request.

    Raises:
        UsageError: Seeds that train together have no curriculum; or as `read_file`, `parse_assignments`.
    """
    data = {} if options.config is None else read_file(options.config).mapping()
    typed = parse_assignments(options.pairs, "--set").get(CURRICULUM)
    value = data[CURRICULUM].data if typed is None and CURRICULUM in data else typed
    try:
        share = float(str(value))
    except ValueError:
        # No number at all: the reader that knows the field refuses it later.
        return
    if 0 < share <= 1:
        raise UsageError(f"{CURRICULUM} is {share}: seeds that train together have none")


def run_seeds(task: str, options: TrainOptions, count: int | None, quiet: bool) -> None:
    """Train several seeds in this process, and print their scores.

    Args:
        task: Name of the task.
        options: The request; its seed is the first one.
        count: Number of seeds; None: those of the folder.
        quiet: Show no bar.

    Raises:
        UsageError: As `train_seeds`.
    """
    recorded = options.resume and options.engine == "auto"
    engine = tried_on(options.engine)
    if recorded:
        # The engine must be known before JAX is imported: its pool of threads is sized by it.
        engine = next((recorded_engine(one.parent) for one in options.out.glob("seed-*/config.json")), engine)
    announce(f"building worlds for {task} ...", engines=[engine])
    from usarmjx.train.learning.processes import distributed_run

    with distributed_run():
        from usarmjx.train.learning.config import load_seeds, seed_folder
        from usarmjx.train.learning.seed_runs import train_seeds
        from usarmjx.train.make import make

        there = load_seeds(options.out) if options.resume else ()
        # The first seed's folder has the record that all were started with.
        known = replace(options, out=seed_folder(options.out, there[0])) if there else options
        plan = plan_run(task, known)
        first = plan.config.seed
        seeds = there if there and count is None else tuple(range(first, first + (count or 1)))

        def worlds_of(count: int, first: int) -> "Env":
            given = {"worlds": count, "engine": plan.origin.engine, "seed": plan.config.seed, "first": first}
            return make(task, **given, **plan.overrides)

        with stop_request() as stop:
            results = train_seeds(
                worlds_of,
                plan.config,
                options.out,
                seeds,
                options.resume,
                origin=plan.origin,
                source=plan.source,
                progress=not quiet,
                stop=stop,
            )
    for result in results:
        typer.echo(result_line(result))
    # Seeds train in one program: a stop ends all of them.
    if results[0].stopped:
        say(f"go on with: usarmjx train {task} --out {options.out} --resume")
        # As shells report a process that a signal has ended.
        raise typer.Exit(128 + stop.number)


def result_line(result: "TrainResult") -> str:
    """Return the result of a run in a line."""
    score = result.last_metrics.get("score")
    shown = score if score is None else round(score, 3)
    return f"{result.agent_steps:,} agent steps, score {shown}: {result.run}"
