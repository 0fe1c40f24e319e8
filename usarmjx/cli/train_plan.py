"""The plan of a training: what is typed, over what a run, its source or its task has otherwise."""

from collections.abc import Generator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.base.settings import FileValue, Text, default_reader, parse_assignments, read_file
from usarmjx.base.settings.json_file import read_json
from usarmjx.cli.common import ends_on_signals
from usarmjx.cli.setting_options import option_name
from usarmjx.cli.startup_messages import say
from usarmjx.cli.task_options import field_texts, fields_over

if TYPE_CHECKING:
    from usarmjx.train.envs.task import Task
    from usarmjx.train.learning.config import Config
    from usarmjx.train.learning.fine_tuning import TrainedNetworks
    from usarmjx.train.learning.run_record import EnvArguments
    from usarmjx.train.learning.stopping import StopRequest


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
    from usarmjx.train.learning.config import on_gpu, task_config
    from usarmjx.train.learning.run_record import EnvArguments
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
    config = task_config(task, gpu=on_gpu(engine), **asked.training)
    overrides = task_values(known, asked.fields)
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
    return replace(asked.over({}, fields), training={**first, **typed, **options.given})


def _config_file(path: Path | None) -> dict[str, Any]:
    return {} if path is None else dict(read_file(path).mapping())


def _as_before(options: TrainOptions, asked: RunSettings) -> tuple[str, RunSettings]:
    """Return engine and settings as the run was started, unless asked for otherwise."""
    from usarmjx.train.learning.run_record import RECORD_FILE, load_record

    if not (options.out / RECORD_FILE).exists():
        return options.engine, asked
    record = load_record(options.out)
    engine = record.engine if options.engine == "auto" else options.engine
    return engine, asked.over(vars(record.config), record.overrides)


def recorded_engine(out: Path) -> str:
    """Return the engine that a run was started with, before JAX is imported; `auto` if there is no record."""
    try:
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
    from usarmjx.train.learning.stopping import StopRequest

    with ExitStack() as early:
        early.enter_context(ends_on_signals())
        with StopRequest(say, early.close) as request:
            yield request
