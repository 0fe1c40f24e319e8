"""All commands with their options: the last part of docs/commands.md, and `usarmjx list commands`."""

import inspect
import json
from collections.abc import Iterator
from typing import Any

import typer

from usarmjx.base.markdown import markdown_table

HEAD = """## All options

From here on this page is the output of `usarmjx list commands --markdown`; a test keeps it so.
"""


def commands_page(app: typer.Typer) -> str:
    """Return a table of options for each command, as Markdown."""
    parts = [HEAD]
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
    return json.dumps(whole, indent=1)


def commands_of(app: typer.Typer) -> Iterator[tuple[str, Any]]:
    """Yield the commands by what one types, and sub-commands in their places."""
    root: Any = typer.main.get_command(app)
    yield from _below(root, "")


def _below(group: Any, path: str) -> Iterator[tuple[str, Any]]:  # noqa: ANN401 - click's, or typer's own copy
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
            names = (one.metavar or one.name.upper()).strip("[].") + (" ..." if one.nargs < 0 else "")
        else:
            names = f"`{', '.join([*one.opts, *one.secondary_opts])}`"
        what = " ".join((one.help or "").split())
        rows.append((names, what, _default(one)))
    return rows


def _plain(text: str) -> str:
    """Return a text as a cell of a Markdown table."""
    return text.replace("<", "&lt;")


def _default(parameter: Any) -> str:  # noqa: ANN401 - click's, or typer's own copy
    """Return what a parameter is unless given, as one would type it."""
    value = parameter.default
    if parameter.required:
        return "needed"
    if value is None or value is False or value == [] or "Sentinel" in type(value).__name__:
        return ""
    if value is True:
        return f"`{parameter.opts[0]}`"
    return f"`{value}`"


def _first_paragraph(text: str) -> str:
    return " ".join(inspect.cleandoc(text).split("\n\n")[0].split()).replace("\f", "")
