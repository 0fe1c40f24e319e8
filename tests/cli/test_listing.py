"""`usarmjx list`: tables for terminals, pipes, documents and programs; and names that shells complete."""

import json
import os
import subprocess
import sys

import pytest
from rich.console import Console
from typer.testing import CliRunner

import dev
from usarmjx.cli import known_names
from usarmjx.cli.app import app
from usarmjx.cli.tables import LISTINGS, Listing
from usarmjx.engines import ENGINES
from usarmjx.models.arenas import ARENAS
from usarmjx.models.robots import ROBOTS
from usarmjx.sensors.base import SENSORS
from usarmjx.train.baselines import BASELINES
from usarmjx.train.policies import POLICIES
from usarmjx.train.policies.sources import load_policy
from usarmjx.train.tasks import TASKS

REGISTRIES = {"robots": ROBOTS, "sensors": SENSORS, "arenas": ARENAS, "tasks": TASKS, "engines": ENGINES}


def invoke(*words):
    return CliRunner().invoke(app, list(words))


@pytest.mark.parametrize("what", REGISTRIES)
def test_a_listing_has_a_row_for_each_thing(what):
    listing = LISTINGS[what]()
    assert sorted(row[0] for row in listing.rows) == sorted(REGISTRIES[what].names())
    assert all(len(row) == len(listing.columns) for row in listing.rows)


def test_policies_are_the_packaged_ones_and_the_baselines():
    names = [row[0] for row in LISTINGS["policies"]().rows]
    assert names == [*POLICIES.names(), *BASELINES.names()]


def test_tasks_say_which_policies_come_for_them():
    policies = {row[0]: row[-1] for row in LISTINGS["tasks"]().rows}
    assert policies["stairs"].endswith("baseline")
    for name in ("explore-v1", "explore-v2", "explore-v3", "victim-search-v1", "victim-search-v2"):
        assert policies[name] == "packaged, baseline"
        assert load_policy(name).task == name


def test_json_is_a_list_of_objects_and_no_word_more_on_standard_output():
    result = invoke("list", "arenas", "--json")
    assert result.exit_code == 0
    found = {one["arena"]: one for one in json.loads(result.stdout)}
    yellow = ARENAS.get("yellow")
    assert found["DM-USAR_yellow"]["solids"] == len(yellow.shapes)
    assert found["DM-USAR_yellow"]["description"] == yellow.about
    everything = json.loads(invoke("list", "--json").stdout)
    assert everything.keys() == LISTINGS.keys()
    assert everything["arenas"] == list(found.values())


def test_a_pipe_gets_plain_lines_that_are_not_cut_off():
    result = invoke("list", "tasks")
    lines = result.stdout.splitlines()
    assert len(lines) == 1 + len(TASKS)
    assert lines[0].startswith("task ")
    assert "\x1b" not in result.stdout
    for name, task in TASKS:
        (line,) = (line for line in lines if line.startswith(f"{name} "))
        assert task.about in line


SAMPLE = Listing(columns=("name", "description"), rows=[("a|b", "[red]"), ("long name", 2)], title="Things")


def test_markdown_and_text_of_a_table():
    assert SAMPLE.as_markdown().splitlines() == [
        "| name | description |",
        "|---|---|",
        "| a/b | [red] |",
        "| long name | 2 |",
    ]
    assert SAMPLE.as_text() == "name       description\na|b        [red]\nlong name  2"


def test_a_terminal_gets_a_table_that_fits():
    with open(os.devnull, "w") as nowhere:
        console = Console(width=40, record=True, file=nowhere)
        SAMPLE.show(console)
        shown = console.export_text()
    assert "Things" in shown
    assert "[red]" in shown, "a cell is no markup"
    assert max(map(len, shown.splitlines())) <= 40


def test_what_cannot_be_listed_is_one_line():
    result = invoke("list", "cats")
    assert (result.exit_code, result.stdout) == (2, "")
    assert "cannot list 'cats'; known: everything, robots, sensors, arenas, tasks" in result.stderr
    result = invoke("list", "tasks", "--json", "--markdown")
    assert (result.exit_code, result.stderr) == (2, "usarmjx: give either --json or --markdown\n")


# Completion


def test_names_that_are_completed_are_those_of_the_registries(tmp_path, monkeypatch):
    """Kept in a file, of which a change of the package's folders makes another one."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert known_names.complete_robots("Zer") == ["Zerg"]
    (file,) = (tmp_path / "usarmjx").glob("names-*.json")
    whole = file.read_text()
    assert json.loads(whole.splitlines()[1]) == known_names.registered_names()
    names = sorted([*TASKS.names(), "victim-search"])
    assert known_names.complete_tasks("victim") == [one for one in names if one.startswith("victim")]
    assert {"explore", "explore-v1", "explore-v3"} <= {*known_names.complete_policies("expl")}
    assert "victim-search" in known_names.complete_policies("victim")
    assert "relay-chain" in known_names.complete_policies("relay")
    with monkeypatch.context() as unpackaged:
        unpackaged.delitem(POLICIES._entries, "relay-chain-v3")
        assert "relay-chain" not in known_names.registered_names()["policies"], "its newest version has none"
    file.write_text(whole.replace('"Zerg"', '"Zerh"'))
    assert known_names.complete_robots("Zer") == ["Zerg"], "what has another checksum is made anew"
    assert file.read_text() == whole
    with monkeypatch.context() as broken:
        broken.setattr(known_names, "_asked", None)
        assert known_names.complete_robots("Zer") == ["Zerg"], "the file is read"
    monkeypatch.setattr(known_names, "_fingerprint", lambda: "other")
    assert known_names.complete_robots("Zer") == ["Zerg"]
    assert {*known_names.LISTING_NAMES} == {"everything", "commands", "settings", *LISTINGS}


CASES = {
    "usarmjx serve --arena soc": "soccer",
    "usarmjx eval hov": "hover-inspect",
    "usarmjx play --task hov": "hover-inspect",
    "usarmjx arena check yellow --robot Zer": "Zerg",
    "usarmjx serve --engine ja": "jax",
    "usarmjx list pol": "policies",
    "usarmjx ser": "serve",
    "usarmjx arena gen": "generate",
}
COMPLETES = """
import contextlib, io, json, os, sys
from usarmjx.cli.app import app
found = {}
for line in json.loads(sys.argv[1]):
    words = line.split()
    os.environ.update(_USARMJX_COMPLETE="complete_bash", COMP_WORDS=line, COMP_CWORD=str(len(words) - 1))
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.suppress(SystemExit):
        app([], prog_name="usarmjx")
    found[line] = said.getvalue().split()
print(json.dumps([found, "jax" in sys.modules]))
"""


def test_a_shell_completes_names_without_jax():
    done = subprocess.run(
        [sys.executable, "-c", COMPLETES, json.dumps([*CASES])],
        capture_output=True,
        text=True,
        cwd=dev.ROOT,
        check=True,
    )
    found, has_jax = json.loads(done.stdout)
    assert found == {line: [word] for line, word in CASES.items()}
    assert not has_jax


def test_version_and_short_help():
    for option in ("--version", "-V"):
        result = invoke(option)
        assert result.exit_code == 0
        assert result.stdout.startswith("usarmjx ")
        assert f"Python {sys.version_info[0]}.{sys.version_info[1]}." in result.stdout
    for words in ((), ("serve",), ("arena",), ("arena", "check")):
        result = invoke(*words, "-h")
        assert (result.exit_code, result.stdout) == (0, invoke(*words, "--help").stdout)
        assert "Usage" in result.stdout
