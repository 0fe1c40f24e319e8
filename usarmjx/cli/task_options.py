"""Fields of a task on command lines: from `--set` and from a file, and written as a file."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from usarmjx.base.settings import (
    FileValue,
    default_reader,
    describe,
    parse_assignments,
    read_file,
    summary,
    to_data,
    to_text,
)

if TYPE_CHECKING:
    from usarmjx.train.envs.task import Task

TaskSetOption = Annotated[
    list[str] | None,
    typer.Option("--set", "-c", help="A field of the task as name=value; may be repeated."),
]
TaskConfigOption = Annotated[
    Path | None,
    typer.Option(
        "--config", metavar="FILE", help="Fields of the task from a YAML, JSON or TOML file, before --set."
    ),
]
TaskPrintOption = Annotated[
    bool,
    typer.Option("--print-config", help="Write the fields of the task as a file for --config, and end."),
]


def task_pairs(task: str, settings: Sequence[str], config: Path | None) -> list[str]:
    """Return fields of a task from a file and from `--set`, `name=text` each; those of `--set` have priority.

    Settings of a training are skipped: `usarmjx train --print-config` writes both.

    Raises:
        UsageError: A field that the task does not have, or a value that is not allowed; names file and line.
    """
    if config is None:
        return [*settings]
    from usarmjx.train.learning.config import Config
    from usarmjx.train.make import make_task

    known = default_reader().names(Config)
    mine = {name: value for name, value in read_file(config).mapping().items() if name not in known}
    typed = dict(parse_assignments(settings, "--set"))
    fields = fields_over(typed, field_texts(make_task(task), mine))
    return [f"{name}={text}" for name, text in fields.items()]


def field_texts(task: "Task", data: Mapping[str, FileValue]) -> dict[str, str]:
    """Return checked fields of a file as texts that `--set` reads."""
    default_reader().values(type(task), data, base=task)
    return {name: text for key, value in data.items() for name, text in _as_texts(key, value)}


def fields_over(own: Mapping[str, str], fields: Mapping[str, str]) -> dict[str, str]:
    """Return fields of a task as texts: own ones, and others that these do not replace.

    Own parts of settings replace the whole that another source has, but for physics: there they change it.
    """

    def replaced(name: str) -> bool:
        parts = name != "physics" and any(one.startswith(f"{name}.") for one in own)
        return parts or name.partition(".")[0] in own

    return {**{name: text for name, text in fields.items() if not replaced(name)}, **own}


def _as_texts(name: str, value: FileValue) -> Iterator[tuple[str, str]]:
    """Yield a field of a file as texts that `--set` reads, those of nested settings by names with dots."""
    if isinstance(value.data, dict):
        for key, item in value.data.items():
            yield from _as_texts(f"{name}.{key}", item)
    else:
        yield name, to_text(value.plain())


def print_task(task: str, trained: Mapping[str, str], pairs: Sequence[str]) -> None:
    """Write the fields of a task, as a policy was trained and as they are set, as a file for `--config`."""
    from usarmjx.train.policies.sources import task_settings

    chosen, _ = task_settings(task, trained, pairs)
    typer.echo(task_text(task, chosen), nl=False)


def task_text(task: str, overrides: Mapping[str, Any]) -> str:
    """Return the fields of a task as YAML, but for those whose names settings of a training have."""
    from usarmjx.base.settings.yaml_file import dump_yaml
    from usarmjx.train.learning.config import Config
    from usarmjx.train.make import make_task

    chosen = make_task(task, **overrides)
    names = {one.name for one in describe(Config)}
    rows = {one.name: one for one in describe(type(chosen)) if one.name not in names}
    data = {name: to_data(value) for name in rows if _is_data(value := getattr(chosen, name))}
    if "repeat" not in overrides:  # it follows from the physics
        data.pop("repeat")
    return dump_yaml(data, {name: summary(rows[name]) for name in data})


def _is_data(value: object) -> bool:
    """Return whether a field of a task reads back from a file: it is no description that Python built."""
    from usarmjx.comms.attenuation import RadioSettings
    from usarmjx.comms.mail import MessageSettings
    from usarmjx.models.compile.physics import Physics
    from usarmjx.models.compile.randomization import DomainRandomization

    settings = (Physics, RadioSettings, MessageSettings, DomainRandomization)
    plain = value is None or isinstance(value, (str, bool, int, float, *settings))
    return plain or (isinstance(value, tuple) and all(map(_is_data, cast(tuple[object, ...], value))))
