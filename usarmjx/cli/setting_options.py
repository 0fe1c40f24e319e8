"""Command-line options from the declarations of settings: typed once, shown, read and completed alike."""

import inspect
from collections.abc import Callable, Iterator, Mapping
from copy import copy
from dataclasses import MISSING, field, is_dataclass, make_dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar, cast, get_args, get_type_hints

import typer
from typer.models import OptionInfo, ParameterInfo

from usarmjx.base.settings import (
    Setting,
    SettingField,
    Text,
    default_reader,
    describe,
    members_of,
    read_file,
    rows_of,
    settings_table,
    summary,
    to_text,
    to_yaml,
)
from usarmjx.base.tables import markdown_table
from usarmjx.cli.common import ErrorExit

METAVARS: dict[Any, str] = {int: "N", float: "NUMBER", Path: "PATH"}
MOST_LISTED = 4
"""Words that an option's help lists in place of a value."""
F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")
CONFIG_HELP = "Settings from a YAML, JSON or TOML file."
ConfigOption = Annotated[Path | None, typer.Option("--config", metavar="FILE", help=CONFIG_HELP)]
PrintConfigOption = Annotated[
    bool, typer.Option("--print-config", help="Write the settings as a file for --config, and end.")
]
HEAD = """# All settings

This page is the output of `usarmjx list settings --markdown`; a test keeps it so. `usarmjx train TASK --help`
prints those of one task. `--set NAME=VALUE` and `--config FILE` set them, `--print-config` writes them. The
table of a task has its own fields, and those of all tasks whose default is another one.
"""
COLUMNS = ("setting", "default", "value", "meaning")


def with_settings(command: F) -> F:
    """Return a command for typer with an option for each setting of the dataclasses that the given one takes.

    A field annotated as an option of typer's stays that; any other becomes one by its declaration, under the
    dataclass' `panel` in the help. Nested settings have no options of their own; `--set` reaches them.

    Args:
        command: A function. A parameter whose type is a dataclass is made from the options; its default, if
            there is one, has the settings that hold where an option is not given.
    """
    # Resolved here: annotations of modules with postponed evaluation are texts.
    kinds = get_type_hints(command, include_extras=True)
    parameters: list[inspect.Parameter] = []
    groups: dict[str, tuple[type, object]] = {}
    for name, parameter in inspect.signature(command).parameters.items():
        kind = kinds[name]
        if is_dataclass(kind) and isinstance(kind, type):
            base = None if parameter.default is inspect.Parameter.empty else parameter.default
            groups[name] = (kind, base)
            parameters += _options_of(kind, base)
        else:
            parameters.append(parameter.replace(annotation=kind, kind=inspect.Parameter.KEYWORD_ONLY))

    def run(**values: Any) -> Any:  # noqa: ANN401 - what the command returns
        with ErrorExit():
            for name, (kind, base) in groups.items():
                own = {one.name: values.pop(one.name) for one in _shown(kind)}
                values[name] = _built(kind, own, base)
        return command(**values)

    return _as_command(run, command, parameters)


def _as_command(run: Callable[..., Any], command: F, parameters: list[inspect.Parameter]) -> F:
    """Return a function under a command's name and docstring, with parameters as typer looks for them."""
    # The name of the command and the text of its help are read from the function.
    run.__name__, run.__doc__, run.__module__ = command.__name__, command.__doc__, command.__module__
    run.__signature__ = inspect.Signature(parameters)  # type: ignore - as inspect looks for it
    # Typer takes the defaults from the signature, but the types from the annotations.
    run.__annotations__ = {one.name: one.annotation for one in parameters}
    return cast(F, run)  # called by typer only, with options


def with_config(command: F) -> F:
    """Return a command for typer with `--config` and `--print-config` for the options that it has.

    A file has the options' names with underscores. An option on the command line has priority. Options with
    an environment variable hold secrets, and are left out.

    Args:
        command: A function whose parameters are annotated as options of typer's, as `with_settings` makes it.
    """
    signature = inspect.signature(command)
    notes = {name: note for name, one in signature.parameters.items() if (note := _option_note(one))}

    def kind() -> type:
        # Made on demand: most command lines name no file.
        own = {name: signature.parameters[name] for name in notes}
        rows = [(name, _declared(one, notes[name]), field(default=one.default)) for name, one in own.items()]
        return make_dataclass(command.__name__, rows, kw_only=True, frozen=True)

    def load(ctx: typer.Context, path: Path | None) -> Path | None:
        if path is not None and not ctx.resilient_parsing:
            with ErrorExit():
                found = default_reader().values(kind(), dict(read_file(path).mapping()))
                # Click takes these where the command line has nothing.
                ctx.default_map = {name: value for name, value in found.items() if value is not None}
        return path

    def run(**values: Any) -> Any:  # noqa: ANN401 - what the command returns
        del values["config"]
        if not values.pop("print_config"):
            return command(**values)
        with ErrorExit():
            return print_config(kind()(**{name: values[name] for name in notes}))

    # Eager: click looks up the defaults of the other options after it has called this.
    config = typer.Option("--config", metavar="FILE", help=CONFIG_HELP, is_eager=True, callback=load)
    more = {"config": (Annotated[Path | None, config], None), "print_config": (PrintConfigOption, False)}
    shown = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
        for name, (annotation, default) in more.items()
    ]
    return _as_command(run, command, [*signature.parameters.values(), *shown])


def _option_note(parameter: inspect.Parameter) -> OptionInfo | None:
    """Return typer's note of an option that a file may set; None: an argument, a secret, a hidden one."""
    found = [one for one in get_args(parameter.annotation)[1:] if isinstance(one, OptionInfo)]
    return found[0] if found and not found[0].envvar and not found[0].hidden else None


def _declared(parameter: inspect.Parameter, note: OptionInfo) -> Any:  # noqa: ANN401 - an annotation
    """Return the annotation of an option as one of a setting, with the same limits and help."""
    setting = Setting(ge=note.min, le=note.max, help=note.help or "")
    return Annotated[get_args(parameter.annotation)[0], setting]


def option_name(field: str) -> str:
    """Return the option of a field: `num_worlds` -> `--num-worlds`."""
    return f"--{field.replace('_', '-')}"


def print_config(instance: object) -> None:
    """Write settings as YAML to the standard output, each with its help, for `--print-config`."""
    typer.echo(to_yaml(instance), nl=False)


def help_table(title: str, kind: type, base: object = None) -> str:
    """Return the settings of a dataclass as a part of a command's help: name, default, limits, meaning."""
    lines = settings_table(kind, base).splitlines()
    return "\n".join([f"{title}:", *(f"  {line}" for line in lines)])


def _shown(kind: type) -> list[SettingField]:
    """Return the fields that become options: all but those that are settings of their own only."""
    typed = _typer_notes(kind)
    return [one for one in describe(kind) if one.name in typed or not is_dataclass(one.hint)]


def _typer_notes(kind: type) -> dict[str, ParameterInfo]:
    hints = get_type_hints(kind, include_extras=True)
    notes = {
        name: [one for one in get_args(hint)[1:] if isinstance(one, ParameterInfo)]
        for name, hint in hints.items()
    }
    return {name: found[0] for name, found in notes.items() if found}


def _options_of(kind: type, base: object) -> list[inspect.Parameter]:
    hints, typed = get_type_hints(kind, include_extras=True), _typer_notes(kind)
    panel = getattr(kind, "panel", None)
    parameters: list[inspect.Parameter] = []
    for one in _shown(kind):
        value = one.default if base is None else getattr(base, one.name)
        if one.name in typed:
            annotation = _in_panel(hints[one.name], typed[one.name], panel)
            default = inspect.Parameter.empty if value is MISSING else value
        else:
            # None: not given, so what the base has stands.
            annotation, default = _annotation(one, value, panel), None
        parameters.append(
            inspect.Parameter(
                one.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation
            )
        )
    return parameters


def _in_panel(hint: Any, note: ParameterInfo, panel: str | None) -> Any:  # noqa: ANN401 - annotations
    if panel is None or note.rich_help_panel is not None or not isinstance(note, OptionInfo):
        return hint  # arguments have a panel of their own
    # A copy: the note belongs to an alias that other commands use, with another panel.
    moved = copy(note)
    moved.rich_help_panel = panel
    return Annotated[get_args(hint)[0], moved]


def _annotation(one: SettingField, value: object, panel: str | None) -> Any:  # noqa: ANN401 - an annotation
    """Return the annotation of a generated option: a text, which the reader of settings reads; or a flag.

    None stands for an option that is not given, so that files and `--set` count where it is not.
    """
    flag = one.hint is bool
    name = option_name(one.name)
    words = one.choices

    def complete(incomplete: str) -> list[str]:
        return [word for word in words if word.lower().startswith(incomplete.lower())]

    option = typer.Option(
        f"{name}/--no-{name[2:]}" if flag else name,
        metavar=None if flag else _metavar(one),
        help=_help(one, value),
        show_default=False,  # typer would put brackets around it
        rich_help_panel=panel,
        autocompletion=complete if words and not flag else None,
    )
    return Annotated[(bool if flag else str) | None, option]


def _metavar(one: SettingField) -> str:
    words = [word for word in one.choices if word != "none"]
    if 2 <= len(words) <= MOST_LISTED:
        return "|".join(words)
    kinds = [kind for kind in (one.hint, *members_of(one.hint)) if kind in METAVARS]
    return METAVARS[kinds[0]] if kinds else "TEXT"


def _help(one: SettingField, value: object) -> str:
    """Return meaning, limits and default; in round brackets, as typer takes square ones for markup."""
    text = (one.note.help if one.hint is bool else summary(one)).rstrip(". ")
    parts = [text[:1].upper() + text[1:], "" if value is MISSING else f"Default: {to_text(value)}"]
    return " ".join(f"{part}." for part in parts if part).replace("[", "(").replace("]", ")")


def _built(kind: type, values: Mapping[str, Any], base: object) -> object:
    """Return the dataclass of options: those of typer's own are values, the others texts."""
    typed = _typer_notes(kind)
    data: dict[str, Any] = {}
    for name, value in values.items():
        # Flags come from the parser as values already.
        if name in typed or isinstance(value, bool):
            data[name] = value
        elif value is not None:
            data[name] = Text(value, option_name(name))
    reader = default_reader()
    if not typed:
        return reader.from_data(kind, data, base=base)
    # Values of typer's own options were checked by typer, and may be of types that settings do not have.
    checked = reader.values(kind, {name: value for name, value in data.items() if name not in typed})
    kept = {} if base is None else {one.name: getattr(base, one.name) for one in describe(kind)}
    return kind(**{**kept, **{name: value for name, value in data.items() if name in typed}, **checked})


def settings_page() -> str:
    """Return tables of all settings, as Markdown."""
    return "\n".join([HEAD, *(f"## {title}\n\n{_table(rows)}\n" for title, rows in _sections())]).rstrip()


def _sections() -> Iterator[tuple[str, list[tuple[str, str, str, str]]]]:
    from usarmjx.comms.attenuation import RadioSettings
    from usarmjx.comms.mail import MessageSettings
    from usarmjx.models.compile.physics import Physics
    from usarmjx.models.compile.randomization import DomainRandomization
    from usarmjx.sweeps.spec import Cell
    from usarmjx.train.envs.recipe import GeneratedArenas
    from usarmjx.train.envs.task import Task
    from usarmjx.train.learning.config import Config
    from usarmjx.train.tasks import TASKS

    yield "Trainings", _rows(Config)
    yield "All tasks", _rows(Task)
    common = {row[0]: row for row in _rows(Task)}
    for name in TASKS.names():
        task = TASKS.get(name)
        yield f"Task {name}", [row for row in _rows(type(task), task) if common.get(row[0]) != row]
    yield "Physics: `physics.NAME`", _rows(Physics)
    yield "Radio: `radio.NAME`", _rows(RadioSettings)
    yield "Messages: `mail.NAME`", _rows(MessageSettings)
    yield "Randomisation: `vary.NAME`", _rows(DomainRandomization)
    yield "Generated arenas", _rows(GeneratedArenas)
    yield "Cells of sweeps", _rows(Cell)


def _rows(kind: type, base: object = None) -> list[tuple[str, str, str, str]]:
    """Return the settings of a class without those of nested ones, which have tables of their own."""
    return [row for row in rows_of(kind, base) if "." not in row[0]]


def _table(rows: list[tuple[str, str, str, str]]) -> str:
    cells = [(f"`{name}`", f"`{default}`", expects, text) for name, expects, default, text in rows]
    return markdown_table(COLUMNS, cells)
