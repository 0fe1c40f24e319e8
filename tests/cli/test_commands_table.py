"""The page of all commands: it is the generated one, and names every option of every command."""

import json

from typer.testing import CliRunner

import dev
from usarmjx.cli.app import app
from usarmjx.cli.listing import COMMANDS_HEAD, commands_of, commands_page, options_of

PAGE = dev.ROOT / "docs" / "commands.md"


def test_the_page_of_all_commands_is_the_generated_one():
    """After a change: `usarmjx list commands --markdown` replaces the page from its heading on."""
    text = PAGE.read_text(encoding="utf-8")
    assert text.count(COMMANDS_HEAD) == 1
    assert text[text.index(COMMANDS_HEAD) :] == commands_page(app) + "\n"


def test_every_command_has_a_table_with_every_option_that_its_help_has():
    page = commands_page(app)
    found = dict(commands_of(app))
    assert {"serve", "play", "eval", "train", "doctor", "arena check", "bench step"} <= found.keys()
    for path, command in found.items():
        part = page[page.index(f"### usarmjx {path}\n") :].split("\n### ")[0]
        for one in command.params:
            hidden = getattr(one, "hidden", False)
            for name in one.opts if one.param_type_name == "option" and one.name != "help" else ():
                assert (f"`{name}" in part or f", {name}" in part) != hidden, (path, name)


def test_options_are_told_with_what_they_are_unless_given():
    rows = {names: (what, default) for names, what, default in options_of(dict(commands_of(app))["serve"])}
    assert rows["`--arena`"][1] == "`yellow`"
    assert rows["`--view, --no-view`"][1] == "`--view`"
    assert rows["`--log-json`"] == ("Log a JSON object per line.", "")
    checked = {names: default for names, _, default in options_of(dict(commands_of(app))["arena check"])}
    assert checked["ARENA"] == "needed"


def test_programs_get_it_as_json():
    result = CliRunner().invoke(app, ["list", "commands", "--json"])
    whole = {one["command"]: one for one in json.loads(result.stdout)}
    assert whole.keys() == dict(commands_of(app)).keys()
    assert {"option": "`--seed`", "what": "Seed of all random numbers.", "default": "`0`"} in whole["serve"][
        "options"
    ]
