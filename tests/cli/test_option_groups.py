"""Options in groups: what typer sees of a command that takes dataclasses, and what the command gets."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import pytest
import typer
import yaml
from typer.testing import CliRunner

from usarmjx.cli.setting_options import with_config, with_settings


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
    paths: Annotated[list[Path] | None, typer.Option("--path", help="Ways.")] = None
    secret: Annotated[str | None, typer.Option(envvar="VISIT_SECRET", help="Password.")] = None


got = []
app = typer.Typer()


@app.command()
@with_config
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


def test_a_file_sets_options_and_the_command_line_has_priority(tmp_path):
    file = tmp_path / "visit.yaml"
    file.write_text("port: 7\nloud: true\npaths: [a.txt]\n")
    assert invoke("--config", str(file), "--times", "2", "there").exit_code == 0
    assert got == [(Where(place="there", port=7), Bare(loud=True, paths=[tmp_path / "a.txt"]), 2)]
    assert invoke("--port", "8", "--config", str(file)).exit_code == 0
    assert got[0][0] == Where(port=8)


@pytest.mark.parametrize(
    ("text", "refusal"),
    [
        ("\nport: -1\n", "visit.yaml:2: port is -1, expected a whole number from 0"),
        ("port: '7'\n", "visit.yaml:1: port is '7', expected a whole number from 0"),
        ("prot: 1\n", "visit.yaml:1: visit has no setting 'prot'; did you mean 'port'?"),
        ("secret: x\n", "visit.yaml:1: visit has no setting 'secret'"),
        ("place: x\n", "visit.yaml:1: visit has no setting 'place'"),
    ],
)
def test_a_file_is_refused_with_its_line(tmp_path, text, refusal):
    file = tmp_path / "visit.yaml"
    file.write_text(text)
    result = invoke("--config", str(file))
    assert (result.exit_code, got) == (2, [])
    assert refusal in result.stderr


def test_settings_are_printed_as_a_file_without_secrets(tmp_path):
    words = ("--port", "5", "--loud", "--path", "/a", "--times", "3")
    shown = invoke("--print-config", "--secret", "s3cret", *words).stdout
    assert got == []
    assert yaml.safe_load(shown) == {"port": 5, "loud": True, "paths": ["/a"], "times": 3}
    assert "# Of it: a whole number from 0\nport: 5\n" in shown
    file = tmp_path / "visit.yaml"
    file.write_text(shown)
    assert invoke("--config", str(file), "--print-config").stdout == shown
