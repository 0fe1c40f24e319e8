"""What a training is run with: as typed, as its task usually is, or as another run was."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from usarmjx.cli.waiting import say

if TYPE_CHECKING:
    from usarmjx.train.learning.config import Config
    from usarmjx.train.learning.fine_tuning import TrainedNetworks
    from usarmjx.train.learning.record import EnvArguments


@dataclass(frozen=True, kw_only=True)
class TrainOptions:
    """What is asked for, by options of their own and by `--set`.

    Attributes:
        out: Folder of the run.
        engine: Its name, or `auto`.
        resume: Go on with the run in the folder.
        source: Folder of the run whose networks are begun with; None: random ones.
        checkpoint: Of that run.
        given: Settings with options of their own, those that were given.
        pairs: Others, as typed.
    """

    out: Path
    engine: str
    resume: bool = False
    source: Path | None = None
    checkpoint: str = "best"
    given: dict[str, Any]
    pairs: list[str]

    @property
    def typed(self) -> set[str]:
        """Keys of what `--set` sets."""
        return {pair.partition("=")[0] for pair in self.pairs}

    def within(self, settings: dict[str, Any], fields: dict[str, str]) -> "TrainOptions":
        """Return these with settings and fields of the task that hold where nothing else is asked for."""
        pairs = [f"{key}={text}" for key, text in fields.items() if key not in self.typed]
        kept = {key: value for key, value in settings.items() if key not in self.typed}
        return replace(self, given={**kept, **self.given}, pairs=[*pairs, *self.pairs])


@dataclass(frozen=True, kw_only=True)
class RunPlan:
    """What is run.

    Attributes:
        config: Settings of the training.
        overrides: Fields of the task that are set otherwise.
        origin: Engine, and the same fields as typed.
        source: Networks to begin with.
    """

    config: "Config"
    overrides: dict[str, Any]
    origin: "EnvArguments"
    source: "TrainedNetworks | None"


def plan_run(task: str, options: TrainOptions) -> RunPlan:
    """Return what is run when that is asked for; a line tells what nobody has typed.

    Raises:
        UnknownNameError: No such task, engine, setting or field; lists those there are.
        UsageError: A value that does not read, or no networks to begin with.
    """
    from usarmjx.train.learning.record import EnvArguments

    source, notice = None, ""
    if options.resume:
        options = _as_before(options)
    else:
        if options.source is not None:
            from usarmjx.train.learning.fine_tuning import load_trained

            source = load_trained(options.source, options.checkpoint)
            options = _as_trained(task, source, options)
        options, notice = _as_usual(task, options)
    config, overrides = _split_settings(task, options)
    if notice:  # once nothing is wrong with what was typed
        say(notice)
    texts = dict(pair.split("=", 1) for pair in options.pairs)
    origin = EnvArguments(options.engine, {key: texts[key] for key in overrides})
    return RunPlan(config=config, overrides=overrides, origin=origin, source=source)


def _as_before(options: TrainOptions) -> TrainOptions:
    """Return settings, fields and engine as the run was started, unless asked for otherwise."""
    from usarmjx.train.learning.record import RECORD_FILE, load_record

    if not (options.out / RECORD_FILE).exists():
        return options
    record = load_record(options.out)
    before = options.within(vars(record.config), record.overrides)
    return replace(before, engine=record.engine if options.engine == "auto" else options.engine)


def recorded_engine(out: Path) -> str:
    """Return the engine that a run was started with, before JAX is imported; `auto` where none is told."""
    try:
        return str(json.loads((out / "config.json").read_text())["engine"])
    except (OSError, ValueError, KeyError, TypeError):  # `load_record` says what is wrong with it
        return "auto"


def _as_trained(task: str, source: "TrainedNetworks", options: TrainOptions) -> TrainOptions:
    """Return networks' settings and, of the same task, fields as those were trained with, but for physics."""
    from usarmjx.train.own_tasks import same_class

    same = same_class(task, source.record.task)
    fields = {key: text for key, text in source.record.overrides.items() if same and key != "physics"}
    chosen = options.within(source.settings, fields)
    say("; ".join([source.describe(), *chosen.pairs[: len(chosen.pairs) - len(options.pairs)]]))
    return chosen


def _as_usual(task: str, options: TrainOptions) -> tuple[TrainOptions, str]:
    """Return what trainings of the task have unless asked for otherwise, and what to say of it."""
    from usarmjx.engines import choose_engine
    from usarmjx.train.learning.defaults import training_engine, training_fields

    engine = training_engine(task, options.engine)
    chosen = replace(options.within({}, training_fields(task, engine)), engine=engine)
    if engine == choose_engine(options.engine, "train"):
        return chosen, ""
    usual = chosen.pairs[: len(chosen.pairs) - len(options.pairs)]
    return chosen, ", ".join([f"{task} trains on engine {engine} unless another is named", *usual])


def _split_settings(task: str, options: TrainOptions) -> tuple["Config", dict[str, Any]]:
    """Return the settings of the training, and the fields of the task that are set otherwise."""
    from dataclasses import asdict, fields

    from usarmjx.train.learning.config import Config, parse_settings, task_config
    from usarmjx.train.learning.defaults import on_gpu
    from usarmjx.train.make import make_task

    chosen = make_task(task)
    own = {field.name: getattr(chosen, field.name) for field in fields(chosen)}
    simple = {
        name: value for name, value in own.items() if isinstance(value, str | bool | int | float | tuple)
    }
    training = asdict(Config())
    found = parse_settings(options.pairs, {**simple, **training}, f"{task} and its training")
    overrides = {key: value for key, value in found.items() if key not in training}
    chosen_here = {**options.given, **{key: value for key, value in found.items() if key in training}}
    return task_config(task, gpu=on_gpu(options.engine), **chosen_here), overrides
