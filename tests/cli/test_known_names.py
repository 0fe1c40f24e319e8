"""Names on command lines are checked before JAX is imported and before a line about what is begun."""

import json
import os
import subprocess
import sys

import pytest

import dev
from tests.scripts import python_path
from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.base.settings import read_file
from usarmjx.cli import known_names
from usarmjx.cli.app import app
from usarmjx.cli.known_names import check_file, check_name, check_policy, check_roster, check_run
from usarmjx.cli.listing import commands_of
from usarmjx.models.robots import ROBOTS
from usarmjx.train.evaluation.yardsticks import GOAL_TEAMS, TEAMS
from usarmjx.train.policies.sources import UNTRAINED

ARENA, ROBOT, ENGINE = ("yelow", "'yellow'"), ("P2TA", "'P2AT'"), ("plannar", "'planar'")
TASK, POLICY = ("exploer", "'explore'"), ("hover-inspekt", "'hover-inspect'")
WRONG = {
    ("arena check", "arena"): ("arena check {}", ARENA),
    ("arena check", "robot"): ("arena check yellow --robot {}", ROBOT),
    ("arena draw", "arena"): ("arena draw {} --png x.png", ARENA),
    ("arena export", "arena"): ("arena export {} --out x.xml", ARENA),
    ("arena generate", "kind"): ("arena generate --kind {}", ("maez", "'maze'")),
    ("arena generate", "robot"): ("arena generate --robot {}", ROBOT),
    ("arena lane", "name"): ("arena lane {}", ("stair", "'stairs'")),
    ("arena lane", "robot"): ("arena lane stairs --robot {}", ROBOT),
    ("arena obstacles", "robot"): ("arena obstacles --robot {}", ROBOT),
    ("bench camera", "arena"): ("bench camera --arena {}", ARENA),
    ("bench camera", "engine"): ("bench camera --engine {}", ENGINE),
    ("bench camera", "roster"): ("bench camera --roster {}:2", ROBOT),
    ("bench compile", "arena"): ("bench compile --arena {}", ARENA),
    ("bench compile", "engine"): ("bench compile --engine {}", ENGINE),
    ("bench compile", "roster"): ("bench compile --roster {}:2", ROBOT),
    ("bench memory", "arena"): ("bench memory --generated 2 --arena {}", ("maez", "'maze'")),
    ("bench memory", "engine"): ("bench memory --engine {}", ENGINE),
    ("bench memory", "roster"): ("bench memory --roster {}:2", ROBOT),
    ("bench peers", "arena"): ("bench peers --arena {}", ARENA),
    ("bench peers", "engines"): ("bench peers --engine c --engine {}", ENGINE),
    ("bench physics", "engine"): ("bench physics --engine {}", ENGINE),
    ("bench physics", "robot"): ("bench physics --robot {}", ROBOT),
    ("bench radio", "roster"): ("bench radio --roster {}:2", ROBOT),
    ("bench rays", "roster"): ("bench rays --roster {}:2", ROBOT),
    ("bench serve", "arena"): ("bench serve --arena {}", ARENA),
    ("bench serve", "classes"): ("bench serve --robot {}", ROBOT),
    ("bench serve", "engine"): ("bench serve --engine {}", ENGINE),
    ("bench serve", "rosters"): ("bench serve --roster {}:2", ROBOT),
    ("bench step", "arena"): ("bench step --arena {}", ARENA),
    ("bench step", "engine"): ("bench step --engine {}", ENGINE),
    ("bench step", "roster"): ("bench step --roster P2DX,{}:2", ROBOT),
    ("bench train", "engine"): ("bench train --task explore-v1 --engine {}", ENGINE),
    ("bench train", "task"): ("bench train --task {}", TASK),
    ("bench viewer", "rosters"): ("bench viewer --roster {}:2", ROBOT),
    ("calibrate", "engines"): ("calibrate --tasks --engines c,{}", ENGINE),
    ("calibrate", "names"): ("calibrate P2DX {}", ROBOT),
    ("chaos", "arena"): ("chaos --self --arena {}", ARENA),
    ("eval", "agent"): ("eval --task explore-v1 --agent {}", ("zreo", "'zero'")),
    ("eval", "baseline"): ("eval --baseline {}", TASK),
    ("eval", "engine"): ("eval explore-v1 --engine {}", ENGINE),
    ("eval", "policy"): ("eval {}", POLICY),
    ("eval", "robot"): ("eval explore-v1 --robot {}", ROBOT),
    ("eval", "task"): ("eval explore-v1 --task {}", TASK),
    ("export", "run"): ("export {} --out x.npz", POLICY),
    ("kernels", "arena"): ("kernels 90 --arena {}", ARENA),
    ("kernels", "roster"): ("kernels 90 --roster {}:2", ROBOT),
    ("play", "agent"): ("play --task explore-v1 --agent {}", ("zreo", "'zero'")),
    ("play", "baseline"): ("play --baseline {}", TASK),
    ("play", "engine"): ("play explore-v1 --engine {}", ENGINE),
    ("play", "policy"): ("play {} --view", POLICY),
    ("play", "robot"): ("play explore-v1 --robot {}", ROBOT),
    ("play", "task"): ("play explore-v1 --task {}", TASK),
    ("portraits", "robot"): ("portraits P2DX --robot {} --out x.png", ROBOT),
    ("portraits", "robots"): ("portraits P2DX {} --out x.png", ROBOT),
    ("radio-map", "arena"): ("radio-map {} --from 0,0 --out x.png", ARENA),
    ("robot export", "robot"): ("robot export {} --out x.xml", ROBOT),
    ("serve", "arena"): ("serve --arena {}", ARENA),
    ("serve", "engine"): ("serve --engine {}", ENGINE),
    ("serve", "roster"): ("serve --roster P2DX:2,{}:2", ROBOT),
    ("suite replay", "suite"): ("suite replay x.json --suite {}", ("teams-v11", "'teams-v1'")),
    ("suite run", "engine"): ("suite run baseline --engine {}", ENGINE),
    ("suite run", "suite"): ("suite run baseline --suite {}", ("teams-v11", "'teams-v1'")),
    ("suite show", "suite"): ("suite show x --suite {}", ("teams-v11", "'teams-v1'")),
    ("sweep run", "engine"): ("sweep thousand --engine {}", ENGINE),
    ("sweep run", "robot"): ("sweep thousand --robot {}", ROBOT),
    ("sweep run", "what"): ("sweep {}", ("tousand", "'thousand'")),
    ("league", "engine"): ("league runs/x --engine {}", ENGINE),
    ("teams", "engine"): ("teams explore-v1 --engine {}", ENGINE),
    ("teams", "names"): ("teams explore-v1 random {}", ("packagd", "'packaged'")),
    ("teams", "robot"): ("teams explore-v1 --robot {}", ROBOT),
    ("teams", "task"): ("teams {}", TASK),
    ("train", "engine"): ("train explore-v1 --engine {}", ENGINE),
    ("train", "named"): ("train {}", TASK),
    ("train", "robot"): ("train explore-v1 --robot {}", ROBOT),
    ("train", "task"): ("train --task {}", TASK),
}
"""By command and parameter: a command line with a gap, a wrong name for it, and the one that was meant."""
NO_NAMES = {
    ("bench train", "baseline"): "a score",
    ("list", "robot"): "a file",
    ("serve", "robot"): "a file",
    ("suite run", "method"): "a name of the user's",
    ("list", "what"): "its words are in tests/cli/test_wrong_inputs.py",
}
NAMING = (
    *("agent", "arena", "baseline", "classes", "engine", "engines", "kind", "method", "named", "names"),
    *("policy", "robot", "robots", "roster", "rosters", "suite", "task", "what"),
)
"""Parameters that are names in some command."""
WITHOUT_JAX = """
import contextlib, io, json, sys
from importlib.abc import MetaPathFinder

class Gate(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("jax", "mujoco", "brax", "flax"):
            raise SystemExit(f"imports {name}")

sys.meta_path.insert(0, Gate())
from usarmjx.cli.app import app
found = []
for command in json.loads(sys.argv[1]):
    out, said = io.StringIO(), io.StringIO()
    code = None
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(out):
        try:
            app(command.split())
        except SystemExit as end:
            code = end.code
    found.append([code, out.getvalue(), said.getvalue()])
print(json.dumps(found))
"""


def test_a_wrong_name_is_refused_before_anything_is_imported_or_begun(tmp_path):
    commands = [line.format(wrong) for line, (wrong, _) in WRONG.values()]
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_JAX, json.dumps(commands)],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": python_path(dev.ROOT)},
    )
    assert done.returncode == 0, done.stderr
    for command, (_, (wrong, meant)), (code, out, said) in zip(
        commands, WRONG.values(), json.loads(done.stdout), strict=True
    ):
        assert (code, out) == (2, ""), (command, code, said)
        assert said.count("\n") == 1, (command, said)
        assert said.startswith("usarmjx: "), (command, said)
        assert wrong in said
        assert f"did you mean {meant}?" in said, (command, said)


def test_every_parameter_that_is_a_name_is_in_the_table():
    found = {(path, one.name) for path, command in commands_of(app) for one in command.params}
    naming = {pair for pair in found if pair[1] in NAMING} - NO_NAMES.keys()
    assert naming - WRONG.keys() == set()
    assert WRONG.keys() <= found


def test_the_table_is_that_of_the_registries():
    """Write it anew after adding a name: `python -m usarmjx.cli.known_names`."""
    fresh = subprocess.run(
        [
            sys.executable,
            "-c",
            "import json; from usarmjx.cli.known_names import registered as f; print(json.dumps(f()))",
        ],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONPATH": python_path(dev.ROOT)},
    )
    assert json.loads(fresh.stdout) == known_names.table()


def test_words_beside_the_registries_are_those_of_their_modules():
    assert (*TEAMS,) == known_names.TEAM_WORDS
    assert (*GOAL_TEAMS,) == known_names.GOAL_TEAM_WORDS
    assert (*UNTRAINED,) == known_names.AGENTS


@pytest.fixture
def alone(monkeypatch):
    """As in a process that has imported no registry."""
    for module, _ in known_names.REGISTRIES.values():
        monkeypatch.delitem(sys.modules, module, raising=False)


@pytest.mark.usefixtures("alone")
def test_known_names_files_and_new_ones_pass(tmp_path, monkeypatch):
    check_name("arena", "YELLOW")
    check_name("arena", "lane_stairs")
    check_name("arena", "somewhere/cave.yaml")
    check_name("robot", "cart.urdf")
    check_name("engine", "auto")
    check_name("task", "mine.py:Task")
    check_roster("P2AT:4, p2dx", ())
    check_roster("Cart:2", ["cart.urdf"])
    check_policy("P2AT=explore-v1,kenaf=mine.py:act")
    folder = tmp_path / "models" / "robots"
    folder.mkdir(parents=True)
    monkeypatch.setattr(known_names, "PACKAGE", tmp_path)
    with pytest.raises(UnknownNameError, match="unknown robot 'Cart'"):
        check_name("robot", "Cart")
    (folder / "cart.py").write_text('CART = RobotSpec(name="Cart")\n')
    check_name("robot", "Cart")


def test_a_name_that_a_program_adds_passes(monkeypatch):
    """The registry itself is asked where it is there."""
    registry = ROBOTS.copy()
    monkeypatch.setattr(sys.modules["usarmjx.models.robots"], "ROBOTS", registry)
    registry.add("Cart", ROBOTS.get("P2AT"))
    check_name("robot", "cart")


@pytest.mark.parametrize(("word", "meant"), [("oracel", "oracle"), ("packagd", "packaged")])
def test_a_run_that_is_nowhere_gets_the_likely_word(word, meant):
    check_run(meant)
    with pytest.raises(UnknownNameError, match=f"{word} is no folder of a run.*did you mean '{meant}'"):
        check_run(word)


@pytest.mark.usefixtures("alone")
@pytest.mark.parametrize(
    ("text", "line", "meant"),
    [
        ("common: {task: exploer}", 1, "task 'exploer'; did you mean 'explore'"),
        ("common:\n  task: explore\nproduct:\n  engine: [c, plannar]", 4, "did you mean 'planar'"),
        ("list:\n  - {task: explore, roster: {P2TA: 2}}", 2, "did you mean 'P2AT'"),
        ("list:\n  - {task: explore, arena: yelow}", 2, "did you mean 'yellow'"),
    ],
)
def test_names_in_the_file_of_a_sweep(tmp_path, text, line, meant):
    file = tmp_path / "mine.yaml"
    file.write_text(text)
    with pytest.raises(UsageError, match=meant) as refusal:
        check_file(read_file(file))
    assert str(refusal.value).startswith(f"{file}:{line}: ")
