import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import pytest
import typer
from typer.testing import CliRunner

from usarmjx.base.settings import POSITIVE, Setting, from_data, read_file, validate
from usarmjx.cli.setting_options import help_table, print_config, with_settings


@dataclass(frozen=True, kw_only=True)
class Inner:
    depth: int = 1


@dataclass(frozen=True, kw_only=True)
class Drive:
    """A drive.

    Attributes:
        radius: Distance at which a goal counts [m].
        turn: Largest turn [rad].
        sizes: Widths of the layers.
        fast: Drive fast.
    """

    panel = "Drive"

    radius: Annotated[float, POSITIVE] = 0.5
    turn: float = 0.0
    sizes: tuple[int, ...] = (64, 64)
    fast: bool = False
    kind: Annotated[str, Setting(choices=("slow", "quick"))] = "slow"
    inner: Inner = Inner()

    def __post_init__(self):
        validate(self)


@dataclass(frozen=True, kw_only=True)
class Typed:
    worlds: Annotated[int, typer.Option("--worlds", min=1, help="Worlds.")] = 1
    rate: Annotated[float, POSITIVE] = 2.0


def run(*words: str):
    app, seen = typer.Typer(), []

    @app.command()
    @with_settings
    def go(drive: Drive, typed: Typed = Typed(rate=3.0), name: str = "x") -> None:
        seen.append((drive, typed, name))

    result = CliRunner().invoke(app, list(words), env={"COLUMNS": "200", "TERM": "dumb"})
    return result, seen


def test_options_are_read_by_the_grammar_of_settings():
    result, seen = run(
        "--radius", "1e-3", "--turn=90deg", "--sizes", "3,4", "--fast", "--worlds", "4", "--kind", "QUICK"
    )
    assert result.exit_code == 0, result.output
    drive = Drive(radius=0.001, turn=math.pi / 2, sizes=(3, 4), fast=True, kind="quick")
    assert seen == [(drive, Typed(worlds=4, rate=3.0), "x")]
    assert run()[1] == [(Drive(), Typed(rate=3.0), "x")]
    assert run("--no-fast", "--rate", "4", "--name", "y")[1] == [(Drive(), Typed(rate=4.0), "y")]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--radius", "nan"), "--radius: radius is 'nan', expected a number above 0 [m]"),
        (("--sizes", "64.7,64"), "--sizes: sizes[0] is '64.7', expected a whole number"),
        (("--kind", "slov"), "--kind: kind is 'slov', expected one of slow, quick; did you mean 'slow'?"),
        (("--rate", "0"), "--rate: rate is '0', expected a number above 0"),
    ],
)
def test_refusals_are_one_line(words, said):
    result, seen = run(*words)
    assert (result.exit_code, seen) == (2, [])
    assert result.output.strip().endswith(f"usarmjx: {said}")


def test_help_has_meaning_limits_and_default_of_each():
    text = " ".join(run("--help")[0].output.split())
    assert "Distance at which a goal counts: a number above 0 (m). Default: 0.5." in text
    assert "Widths of the layers: a list of whole numbers. Default: 64,64." in text
    assert "--no-fast" in text
    assert "slow|quick" in text
    assert "A number above 0. Default: 3." in text
    assert "Drive fast. Default: false." in text
    assert "--inner" not in text


def test_a_printed_file_is_read_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    drive, file = Drive(turn=math.pi / 2, inner=Inner(depth=3)), tmp_path / "run.yaml"
    print_config(drive)
    file.write_text(capsys.readouterr().out)
    assert from_data(Drive, read_file(file)) == drive


def test_table_for_a_help():
    lines = help_table("Settings of the drive", Drive).splitlines()
    assert lines[0] == "Settings of the drive:"
    assert [line.split()[0] for line in lines[1:]] == [
        "radius",
        "turn",
        "sizes",
        "fast",
        "kind",
        "inner",
        "inner.depth",
    ]
