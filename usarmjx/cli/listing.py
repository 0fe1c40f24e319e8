"""`usarmjx list`: robots, sensors, arenas, tasks, policies, engines and commands. Starts without JAX."""

import inspect
import json as json_format
import sys
from collections.abc import Iterator
from typing import Annotated, Any

import typer

from usarmjx.base.errors import UsageError
from usarmjx.base.settings.files import is_list
from usarmjx.base.tables import markdown_table
from usarmjx.cli.common import (
    ErrorExit,
    IniOption,
    JsonFlag,
    PackagesOption,
    PiecesOption,
    RobotFilesOption,
    UnitOption,
    add_robots,
    announce,
    configure_from,
)
from usarmjx.cli.known_names import complete_listings

EVERYTHING, COMMANDS, SETTINGS = "everything", "commands", "settings"
MarkdownFlag = Annotated[bool, typer.Option("--markdown", help="Print Markdown, as the documents have it.")]
COMMANDS_HEAD = """## All options

From here on this page is the output of `usarmjx list commands --markdown`; a test keeps it so.
"""


def commands_page(app: typer.Typer) -> str:
    """Return a table of options for each command, as Markdown."""
    parts = [COMMANDS_HEAD]
    for path, command in commands_of(app):
        cells = [(names, _plain(what), default) for names, what, default in options_of(command)]
        about = _first_paragraph(command.help or "")
        table = ["", markdown_table(("option", "what", "unless given"), cells)] if cells else []
        parts.append("\n".join([f"### usarmjx {path}", "", about, *table, ""]))
    return "\n".join(parts).rstrip()


def commands_json(app: typer.Typer) -> str:
    """Return all commands as a JSON list."""
    columns = "option", "what", "default"
    whole = [
        {
            "command": path,
            "what": _first_paragraph(command.help or ""),
            "options": [dict(zip(columns, row, strict=True)) for row in options_of(command)],
        }
        for path, command in commands_of(app)
    ]
    return json_format.dumps(whole, indent=1)


def commands_of(app: typer.Typer) -> Iterator[tuple[str, Any]]:
    """Yield the commands by what one types, and sub-commands in their places."""
    root: Any = typer.main.get_command(app)
    yield from _below(root, "")


def _below(group: Any, path: str) -> Iterator[tuple[str, Any]]:  # noqa: ANN401 - click's, or typer's own copy
    # Sorted: the page must not change with the order of the help.
    for name in sorted(group.commands):
        command = group.commands[name]
        if hasattr(command, "commands"):
            yield from _below(command, f"{path}{name} ")
        elif not command.hidden:
            yield f"{path}{name}", command


def options_of(command: Any) -> list[tuple[str, str, str]]:  # noqa: ANN401 - click's, or typer's own copy
    """Return names, help and default of a command's arguments and options, those in no help left out."""
    rows: list[tuple[str, str, str]] = []
    for one in command.params:
        if getattr(one, "hidden", False) or one.name == "help":
            continue
        if one.param_type_name == "argument":
            # Click writes optional arguments in brackets and repeated ones with dots.
            names = (one.metavar or one.name.upper()).strip("[].") + (" ..." if one.nargs < 0 else "")
        else:
            names = f"`{', '.join([*one.opts, *one.secondary_opts])}`"
        what = " ".join((one.help or "").split())
        rows.append((names, what, _default(one)))
    return rows


def _plain(text: str) -> str:
    """Return a text as a cell of a Markdown table."""
    # A browser would take `<NAME>` for a tag.
    return text.replace("<", "&lt;")


def _default(parameter: Any) -> str:  # noqa: ANN401 - click's, or typer's own copy
    """Return the default of a parameter, as one would type it."""
    value = parameter.default
    if parameter.required:
        return "needed"
    # Newer versions of click have a value for no default, whose class is not public.
    if value is None or value is False or value == [] or "Sentinel" in type(value).__name__:
        return ""
    if value is True:
        return f"`{parameter.opts[0]}`"
    return f"`{', '.join(map(str, value)) if is_list(value) else value}`"


def _first_paragraph(text: str) -> str:
    # Click ends what it shows of a help text at a form feed.
    return " ".join(inspect.cleandoc(text).split("\n\n")[0].split()).replace("\f", "")


def list_everything(
    what: Annotated[
        str,
        typer.Argument(
            help="robots, sensors, arenas, tasks, policies, engines, commands, settings, or everything.",
            autocompletion=complete_listings,
        ),
    ] = EVERYTHING,
    json: JsonFlag = False,
    markdown: MarkdownFlag = False,
    card: Annotated[
        str | None,
        typer.Option(help="With policies: the card of a packaged one, its training, scores and hash."),
    ] = None,
    robot: RobotFilesOption = None,
    packages: PackagesOption = None,
    pieces: PiecesOption = None,
    ini: IniOption = None,
    uu_per_metre: UnitOption = 250.0,
) -> None:
    """List robots, sensors, arenas, tasks, policies and engines."""
    with ErrorExit():
        check_form(json, markdown)
        if card is not None:
            _show_card(what, card)
            return
        announce("reading the lists ...")
        # Before the listings are made: they show what is registered by then.
        add_robots(robot)
        configure_from(ini, uu_per_metre)
        from usarmjx.cli.tables import LISTINGS

        if what not in (EVERYTHING, COMMANDS, SETTINGS, *LISTINGS):
            known = ", ".join((EVERYTHING, *LISTINGS, COMMANDS, SETTINGS))
            raise UsageError(f"cannot list {what!r}; known: {known}")
        if what == EVERYTHING:
            _list_all(json, markdown)
        else:
            show_listing(what, json, markdown)


def _show_card(what: str, name: str) -> None:
    """Print the card of a packaged policy.

    Raises:
        UsageError: Something else is listed, or there is no such policy.
    """
    if what not in ("policies", EVERYTHING):
        raise UsageError(f"--card is for policies, not for {what}")
    from usarmjx.train.policies.cards import card_text

    typer.echo(card_text(name))


def check_form(json: bool, markdown: bool) -> None:
    """Refuse two forms at once.

    Raises:
        UsageError: Both are asked for.
    """
    if json and markdown:
        raise UsageError("give either --json or --markdown")


def show_listing(what: str, json: bool, markdown: bool) -> None:
    """Print one listing in the form that is asked for; else a table on a terminal, plain text elsewhere."""
    from usarmjx.cli.tables import LISTINGS

    if what == COMMANDS:
        # The app imports this module.
        from usarmjx.cli.app import app

        typer.echo(commands_json(app) if json else commands_page(app))
        return
    if what == SETTINGS:
        from usarmjx.cli.setting_options import settings_page

        if json:
            raise UsageError("settings are listed as Markdown only; `--print-config` writes them as YAML")
        typer.echo(settings_page())
        return
    if markdown:
        typer.echo(_page(what))
        return
    listing = LISTINGS[what]()
    if json:
        typer.echo(listing.as_json())
    elif sys.stdout.isatty():
        from rich.console import Console

        listing.show(Console())
    else:
        typer.echo(listing.as_text())


def _page(what: str) -> str:
    """Return the page of a listing in the documents: of some more than its table."""
    from usarmjx.cli.catalogue import robots_table, sensors_table
    from usarmjx.cli.tables import LISTINGS, arenas_table

    pages = {"robots": robots_table, "sensors": sensors_table, "arenas": arenas_table}
    return pages[what]() if what in pages else LISTINGS[what]().as_markdown()


def _list_all(json: bool, markdown: bool) -> None:
    from usarmjx.cli.tables import LISTINGS

    if json:
        whole = {name: json_format.loads(make().as_json()) for name, make in LISTINGS.items()}
        typer.echo(json_format.dumps(whole, indent=1))
    elif markdown:
        typer.echo("\n\n".join(f"## {make().title}\n\n{make().as_markdown()}" for make in LISTINGS.values()))
    else:
        from usarmjx.cli.catalogue import catalogue

        typer.echo(catalogue())
