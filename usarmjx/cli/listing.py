"""`usarmjx list`: what robots, sensors, arenas, tasks, policies and engines there are."""

import json as json_format
import sys
from typing import Annotated

import typer

from usarmjx.base.errors import UsageError
from usarmjx.cli.completion import complete_listings
from usarmjx.cli.tools import ErrorExit, IniOption, UnitOption, configure_from
from usarmjx.cli.waiting import announce

EVERYTHING, COMMANDS = "everything", "commands"
JsonFlag = Annotated[bool, typer.Option("--json", help="Print JSON.")]
MarkdownFlag = Annotated[bool, typer.Option("--markdown", help="Print Markdown, as the documents have it.")]


def list_everything(
    what: Annotated[
        str,
        typer.Argument(
            help="robots, sensors, arenas, tasks, policies, engines, commands, or everything in brief.",
            autocompletion=complete_listings,
        ),
    ] = EVERYTHING,
    json: JsonFlag = False,
    markdown: MarkdownFlag = False,
    ini: IniOption = None,
    uu_per_metre: UnitOption = 250.0,
) -> None:
    """List robots, sensors, arenas, tasks, policies, engines: a table on a terminal, lines in a pipe."""
    with ErrorExit():
        check_form(json, markdown)
        announce("reading what there is ...")
        configure_from(ini, uu_per_metre)
        from usarmjx.cli.tables import LISTINGS

        if what not in (EVERYTHING, COMMANDS, *LISTINGS):
            known = ", ".join((EVERYTHING, *LISTINGS, COMMANDS))
            raise UsageError(f"cannot list {what!r}; there is: {known}")
        if what == EVERYTHING:
            _list_all(json, markdown)
        else:
            show_listing(what, json, markdown)


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
        from usarmjx.cli.app import app
        from usarmjx.cli.commands_table import commands_json, commands_page

        typer.echo(commands_json(app) if json else commands_page(app))
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
    """Return what the documents have of a listing: of some more than its table."""
    from usarmjx.cli.arena_tables import arenas_table
    from usarmjx.cli.catalogue import robots_table
    from usarmjx.cli.sensor_tables import sensors_table
    from usarmjx.cli.tables import LISTINGS

    pages = {"robots": robots_table, "sensors": sensors_table, "arenas": arenas_table}
    return pages[what]() if what in pages else LISTINGS[what]().as_markdown()


def _list_all(json: bool, markdown: bool) -> None:
    from usarmjx.cli.catalogue import catalogue
    from usarmjx.cli.tables import LISTINGS

    if json:
        whole = {name: json_format.loads(make().as_json()) for name, make in LISTINGS.items()}
        typer.echo(json_format.dumps(whole, indent=1))
    elif markdown:
        typer.echo("\n\n".join(f"## {make().title}\n\n{make().as_markdown()}" for make in LISTINGS.values()))
    else:
        typer.echo(catalogue())
