"""Commands that are imported when they are used: help of all of them needs their summaries only."""

import sys
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar

import typer
from typer.core import TyperCommand, TyperGroup

import usarmjx
from usarmjx.base import early_signals
from usarmjx.base.errors import UsageError
from usarmjx.cli.common import ErrorExit

ROOT = Path(usarmjx.__file__).resolve().parents[1]
"""Folder of the package: of a checkout, or of installed packages."""
CommandTable = Mapping[str, tuple[str, str]]
"""Names of commands with the place of each, as `module:attribute`, and its summary.

The attribute is a function, or a typer.Typer that either is the command or has one of that name."""


def has_benchmarks() -> bool:
    """Return whether the package stands in a checkout, beside its benchmarks."""
    return (ROOT / "benchmarks" / "commands.py").is_file()


def import_benchmarks(name: str) -> ModuleType:
    """Import a module of the checkout's package `benchmarks`.

    Raises:
        UsageError: There is no checkout; names what to do.
    """
    if not has_benchmarks():
        raise UsageError(
            "benchmarks are a folder of the sources, which no wheel has: clone the repository and run "
            "`python3 dev.py bench` there"
        )
    # A folder of the same name where Python runs, or an installed package, must not pass for ours.
    sys.path.insert(0, str(ROOT))
    try:
        return import_module(name)
    finally:
        sys.path.remove(str(ROOT))


def needs_checkout(name: str, summary: str) -> Any:  # noqa: ANN401 - click's command, or typer's own copy
    """Return a command that takes any words and ends with the line of `import_benchmarks`."""
    stub = typer.Typer(add_completion=False)
    # The words are for a command that is not here: the parser must not refuse them first.
    anything = {"allow_extra_args": True, "ignore_unknown_options": True}

    @stub.command(name, help=f"{summary} Needs a checkout.", context_settings=anything)
    def refuse() -> None:
        with ErrorExit():
            import_benchmarks("benchmarks")

    return typer.main.get_command(stub)


def with_usual_signals(run: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return a command's `invoke` that restores the signals first."""

    def invoke(context: Any) -> Any:  # noqa: ANN401 - click's, or typer's own copy
        early_signals.restore_signals()
        return run(context)

    return invoke


def load_command(name: str, place: str, summary: str) -> Any:  # noqa: ANN401 - click's, or typer's own copy
    """Import a command."""
    module, _, attribute = place.partition(":")
    if module.partition(".")[0] != "benchmarks":
        target = getattr(import_module(module), attribute)
    elif has_benchmarks():
        target = getattr(import_benchmarks(module), attribute)
    else:
        return needs_checkout(name, summary)
    if not isinstance(target, typer.Typer):
        # With one more command it is a group, which has the command as it is, without options of a program.
        target, function = typer.Typer(), target
        target.command(name)(function)
    # A Typer of one command may become the command itself; as a group it always has names to look up.
    group = typer.main.get_group(target)
    group.name = name
    command: Any = group.commands.get(name, group)
    # Signals return to normal only here: importing the command takes seconds, in which Ctrl-C must work.
    command.invoke = with_usual_signals(command.invoke)
    return command


class LazyCommands(Mapping[str, Any]):
    """The commands of a table, each imported at its first look-up.

    Args:
        table: The commands.
    """

    def __init__(self, table: CommandTable) -> None:
        self._table = table
        self._loaded: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:  # noqa: ANN401 - click's, or typer's own copy
        """Return a command."""
        if name not in self._loaded:
            self._loaded[name] = load_command(name, *self._table[name])
        return self._loaded[name]

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names."""
        return iter(self._table)

    def __len__(self) -> int:
        """Return the number of commands."""
        return len(self._table)


def _hide_arguments(command: Any) -> None:  # noqa: ANN401 - click's, or typer's own copy
    """Leave hidden arguments out of the usage of a command, and of the commands of a group."""
    for inner in getattr(command, "commands", {}).values():
        _hide_arguments(inner)
    for param in command.params:
        if getattr(param, "hidden", False):
            # On the parameter, not its class: other commands use the same class.
            param.get_usage_pieces = _no_usage


def _no_usage(context: Any) -> list[str]:  # noqa: ANN401 - click's, or typer's own copy
    del context
    return []


class LazyGroup(TyperGroup):
    """A group of commands; its help and the shell's completion of their names import none of them.

    Attributes:
        table: The commands, of a subclass.
        headings: Heading in the help for each command that has one.
        examples: A command line for each command that has one, shown at the end of its help.
    """

    table: ClassVar[CommandTable] = {}
    headings: ClassVar[Mapping[str, str]] = {}
    examples: ClassVar[Mapping[str, str]] = {}

    def __init__(self, **settings: Any) -> None:  # noqa: ANN401 - typer's
        # Click would keep a dictionary of its own; the lazy mapping replaces it below.
        given: dict[str, Any] = {**settings, "commands": {}}
        super().__init__(**given)
        self.commands: Any = LazyCommands(self.table)
        self._summaries_only = False

    @contextmanager
    def _summaries(self) -> Generator[None]:
        self._summaries_only = True
        try:
            yield
        finally:
            self._summaries_only = False

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ANN401 - click's, or typer's own copy
        """Return the names of all commands, in the table's order."""
        return list(self.table)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:  # noqa: ANN401 - click's, or typer's own copy
        """Return a command, or None; while help is written, one that has its summary only."""
        # Click asks for every command to write help; importing all of them takes many seconds.
        if self._summaries_only and cmd_name in self.table:
            summary, heading = self.table[cmd_name][1], self.headings.get(cmd_name)
            return TyperCommand(cmd_name, help=summary, rich_help_panel=heading)
        command = self.commands.get(cmd_name)
        example = f"Example: `{self.examples.get(cmd_name)}`"
        if command is not None and cmd_name in self.examples and example not in (command.epilog or ""):
            # Added once: the loaded command is kept, and help may be asked for again in one process.
            command.epilog = " ".join(filter(None, (command.epilog, example)))
        if command is not None:
            _hide_arguments(command)
        return command

    def format_help(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401 - click's, or typer's own copy
        """Write the help of the group."""
        with self._summaries():
            super().format_help(ctx, formatter)

    def shell_complete(self, ctx: Any, incomplete: str) -> Any:  # noqa: ANN401 - click's, or typer's own copy
        """Return the names that begin so."""
        with self._summaries():
            return super().shell_complete(ctx, incomplete)
