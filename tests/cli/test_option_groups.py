"""Options in groups: what typer sees of a command that takes dataclasses, and what the command gets."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import typer
from typer.testing import CliRunner

from usarmjx.cli.setting_options import with_settings


@dataclass(frozen=True, kw_only=True)
class Where:
    """A group with an argument."""

    panel: ClassVar[str] = "Places"

    place: Annotated[str | None, typer.Argument(help="Name it.")] = None
    port: Annotated[int, typer.Option(min=0, help="Of it.")] = 3


@dataclass(frozen=True, kw_only=True)
class Bare:
    """A group without a panel."""

    loud: Annotated[bool, typer.Option("--loud", help="Shout.")] = False


got = []
app = typer.Typer()


@app.command()
@with_settings
def visit(where: Where, how: Bare, times: Annotated[int, typer.Option(help="So often.")] = 1) -> None:
    """Go there."""
    got.append((where, how, times))


def invoke(*words):
    got.clear()
    return CliRunner().invoke(app, list(words), env={"COLUMNS": "100", "TERM": "dumb", "NO_COLOR": "1"})


def test_fields_are_options_with_their_defaults():
    assert invoke().exit_code == 0
    assert got == [(Where(), Bare(), 1)]
    assert invoke("here", "--port", "5", "--loud", "--times", "2").exit_code == 0
    assert got == [(Where(place="here", port=5), Bare(loud=True), 2)]


def test_bounds_of_a_field_hold():
    result = invoke("--port", "-1")
    assert (result.exit_code, got) == (2, [])
    assert "--port" in result.stderr


def test_the_help_has_a_panel_for_each_group_that_wants_one():
    shown = invoke("--help").stdout
    assert "Go there." in shown
    above, _, below = shown.partition("Places")
    assert "--port" in below
    assert "--port" not in above
    assert "--loud" in above
    assert "--times" in above
