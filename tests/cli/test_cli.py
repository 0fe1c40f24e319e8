"""The command line: what it says of itself, and that a mistake is one line and exit code 2."""

import re
import subprocess
import sys

import pytest
import typer
from typer.testing import CliRunner

from tests.test_docs import command_problem
from usarmjx.base.errors import UsageError
from usarmjx.cli import lazy_commands
from usarmjx.cli.app import COMMANDS, EXAMPLES, GROUPS, app
from usarmjx.engines import ENGINES
from usarmjx.models.arenas import ARENAS
from usarmjx.models.robots import ROBOTS
from usarmjx.server.worlds.make import parse_roster


@pytest.fixture(autouse=True)
def own_cache(monkeypatch, tmp_path):
    """What JAX compiles for a test belongs to the test."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


def invoke(*words):
    return CliRunner().invoke(app, list(words))


def test_help_names_the_commands():
    result = invoke("--help")
    assert result.exit_code == 0
    for command in ("list", "serve", "demo", "bench"):
        assert re.search(rf"\b{command}\b", result.output)


def test_the_module_runs_and_help_does_not_wait_for_jax():
    code = "import sys; sys.argv = ['usarmjx', '--help']\nimport atexit, runpy\n"
    code += "atexit.register(lambda: print('jax' in sys.modules))\n"
    code += "runpy.run_module('usarmjx', run_name='__main__')"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True
    )
    assert "serve" in done.stdout
    assert done.stdout.rstrip().endswith("False")


@pytest.mark.parametrize("name", COMMANDS)
def test_the_summary_of_a_command_is_the_first_paragraph_of_its_help(name):
    """It is written down beside the command's place, so that help of all commands imports none."""
    command = typer.main.get_command(app).commands[name]
    assert command.name == name
    assert " ".join(command.help.split("\n\n")[0].split()) == COMMANDS[name][1]


def test_the_help_has_every_command_under_a_heading_and_an_example_for_each():
    grouped = [name for names in GROUPS.values() for name in names]
    assert sorted(grouped) == sorted(COMMANDS)
    assert sorted(EXAMPLES) == sorted(COMMANDS)
    shown = " ".join(invoke("--help").output.split())
    assert all(f"─ {heading} ─" in shown for heading in GROUPS)
    assert EXAMPLES["eval"] in " ".join(invoke("eval", "--help").output.split())


def test_usages_have_no_hidden_arguments():
    for command in (["export"], ["radio-map"], ["arena", "gallery"]):
        assert "old_out" not in invoke(*command, "--help").output.replace("-", "_").lower()


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_example_of_a_command_is_one_that_it_understands(name):
    words = EXAMPLES[name].split()
    assert words[:2] == ["usarmjx", name]
    assert command_problem(words) == ""


def test_a_wheel_alone_says_where_the_benchmarks_are(monkeypatch, tmp_path):
    """In one line, whatever was asked for; and a folder of that name where Python runs is not them."""
    monkeypatch.setattr(lazy_commands, "ROOT", tmp_path)
    for words in (["bench"], ["bench", "step", "--worlds", "2"], ["chaos", "--self"]):
        result = invoke(*words)
        assert result.exit_code == 2
        (line,) = result.stderr.splitlines()
        assert line.startswith("usarmjx: benchmarks are a folder of the sources, which no wheel has")
    assert "bench" in invoke("--help").output


def test_a_sweep_without_a_checkout_keeps_no_record(monkeypatch, tmp_path):
    """It says so before it plays anything."""
    here = tmp_path / "here"  # libraries keep their caches beside it
    here.mkdir()
    monkeypatch.setattr(lazy_commands, "ROOT", here)
    monkeypatch.chdir(here)
    result = invoke("sweep", "run", "thousand", "--json", "x.jsonl")
    assert (result.exit_code, "benchmarks are a folder" in result.stderr) == (2, True)
    assert not list(here.iterdir())


def test_serve_help_names_every_option():
    result = invoke("serve", "--help")
    assert result.exit_code == 0
    plain = re.sub(r"\x1b\[[0-9;]*m", "", result.output)
    options = ("arena", "worlds", "instance", "roster", "host", "port", "engine", "seed", "ini")
    images = ("images", "image-port", "image-size", "image-fps", "image-format", "multi-view")
    for option in (*options, "uu-per-metre", *images):
        assert f"--{option}" in plain


def test_list_names_robots_arenas_sensors_and_engines():
    result = invoke("list")
    assert result.exit_code == 0
    for registry in (ROBOTS, ARENAS, ENGINES):
        for name, _ in registry:
            assert re.search(rf"^  {re.escape(name)}\b", result.output, re.MULTILINE), name
    assert "16 Sonar, RangeScanner, Odometry, INS, GroundTruth" in result.output
    assert "0.70 m/s" in result.output
    assert "1.80 m/s" in result.output


def test_ini_files_add_robots_and_warn_on_the_error_stream(monkeypatch, tmp_path):
    monkeypatch.setattr(ROBOTS, "_entries", dict(ROBOTS._entries))
    first, second = tmp_path / "first.ini", tmp_path / "second.ini"
    first.write_text("[USARBot.Twin]\nBaseClass=P2AT\nbDebug=True\n")
    mount = "ItemClass=class'USARBot.INS',ItemName=A,Position=(X=5.25)"
    second.write_text(f"[USARBot.Twin]\nbMountByUU=True\nWeight=15\nSensors=({mount})\n")
    result = invoke("list", "--ini", str(first), "--ini", str(second), "--uu-per-metre", "52.5")
    assert result.exit_code == 0
    assert re.search(r"^  Twin .* 15 kg, 0\.70 m/s\n +INS$", result.stdout, re.MULTILINE)
    assert re.fullmatch(r"usarmjx: warning: .*first\.ini:3: bDebug is ignored: .*\n", result.stderr)
    assert ROBOTS.get("Twin").sensors[0].at[0] == pytest.approx(0.1)
    second.write_text("[USARBot.P2AT]\nWeight=much\n")
    result = invoke("serve", "--port", "0", "--ini", str(second))
    assert result.exit_code == 2
    assert re.fullmatch(r"usarmjx: .*second\.ini:2: Weight is 'much'; expected a number\n", result.stderr)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--arena", "atlantis"], "unknown arena 'atlantis'; known: .*yellow"),
        (["--engine", "karma"], "unknown engine 'karma'; known: auto, c, jax, planar, warp"),
        (["--engine", "jax", "--roster", "P2AT:many"], "'P2AT:many' is not of the form CLASS:COUNT"),
        (["--engine", "jax", "--roster", "Dalek:2"], "unknown robot 'Dalek'; known: .*P2AT"),
        (["--engine", "jax", "--roster", ""], "needs a roster"),
        (["--worlds", "2", "--instance", "2"], "instance 2 is not among worlds 0 to 1"),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2(words, says):
    result = invoke("serve", "--port", "0", *words)
    assert result.exit_code == 2
    assert re.search(says, result.stderr), result.stderr
    assert result.stderr.startswith("usarmjx: ")
    assert result.stderr.count("\n") == 1
    assert result.stdout == ""


def test_bench_refuses_what_it_does_not_know():
    result = invoke("bench", "step", "--roster", "Dalek", "--engine", "c")
    assert result.exit_code == 2
    assert re.fullmatch(r"usarmjx: unknown robot 'Dalek'; known: .*\n", result.stderr)


@pytest.mark.parametrize("words", [["--port", "70000"], ["--worlds", "0"], ["--realtime-factor", "-1"]])
def test_numbers_out_of_range_are_refused_by_the_option(words):
    result = invoke("serve", *words)
    assert result.exit_code == 2
    assert words[0] in result.stderr


def test_rosters():
    assert parse_roster("P2AT:2, p2dx") == ["P2AT", "P2AT", "P2DX"]
    assert parse_roster("") == []
    assert parse_roster("P2AT:0") == []
    with pytest.raises(UsageError):
        parse_roster("P2AT:-1")
