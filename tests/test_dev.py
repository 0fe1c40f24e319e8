import ast
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path

import hypothesis
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import dev
from tools import checks, environment

FAKE_PYTHON = """#!/bin/sh
# Stands for the interpreter of the virtual environment: notes what it is asked, fails on request.
echo "NPROC=$NPROC $*" >> "{log}"
case "$*" in
  *--version*) exit 0 ;;
  *killed*) kill -TERM $$ ;;
  *bad*) exit 7 ;;
esac
[ -e "{broken}" ] && echo "no such package" && exit 3
exit 0
"""


class FakeCheckout:
    """A folder with the two files that decide the packages and an interpreter that takes notes."""

    def __init__(self, root: Path) -> None:
        self.environment = environment.Environment(root, root / ".venv")
        self.log = root / "calls"
        self.broken = root / "broken"
        for name in environment.PINNED_BY:
            (root / name).write_text(f"content of {name}")
        python = self.environment.python
        python.parent.mkdir(parents=True)
        python.write_text(FAKE_PYTHON.format(log=self.log, broken=self.broken))
        python.chmod(0o755)

    def ensure(self, *extras: str) -> list[str]:
        """Ask for these extras and return the pip installations that this led to."""
        self.log.write_text("")
        self.environment.ensure(frozenset(extras))
        return [line for line in self.log.read_text().splitlines() if "pip install" in line]


@pytest.fixture
def checkout(tmp_path: Path) -> FakeCheckout:
    if os.name == "nt":
        pytest.skip("the fake interpreter is a shell script")
    return FakeCheckout(tmp_path)


@pytest.mark.parametrize("version", [(3, 11, 0), (3, 12, 4, "final", 0), (4, 0)])
def test_new_enough_python_is_accepted(version: tuple):
    assert dev.python_problem(version) == ""


@pytest.mark.parametrize("version", [(2, 7, 18), (3, 9, 1), (3, 10, 14)])
def test_old_python_is_named(version: tuple):
    problem = dev.python_problem(version)
    assert "3.11 or newer" in problem
    assert ".".join(map(str, version)) in problem


def test_old_python_gets_the_message_and_not_a_traceback():
    source = Path(dev.__file__).read_text(encoding="utf-8")
    ast.parse(source, feature_version=(3, 7))  # syntax comes before any check
    pretend = "import runpy, sys; sys.version_info = (3, 9, 1); runpy.run_path(sys.argv[1])"
    command = [sys.executable, "-c", pretend, dev.__file__]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == 1
    assert result.stderr.startswith("usarmjx needs Python 3.11")
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize(
    ("argv", "rest"),
    [
        (["test", "-k", "foo"], ["-k", "foo"]),
        (["test", "--help"], ["--help"]),
        (["lint"], []),
        (["bench", "step", "--worlds", "8"], ["step", "--worlds", "8"]),
    ],
)
def test_arguments_after_the_verb_go_to_the_tool(argv: list[str], rest: list[str]):
    verb, args = dev.parse(argv)
    assert verb is dev.VERBS[argv[0]]
    assert args == rest


def test_help_describes_every_verb(capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit, match="0"):
        dev.parse(["--help"])
    shown = capsys.readouterr().out
    for name, verb in dev.VERBS.items():
        assert re.search(rf"^  {name} +{re.escape(verb.summary)}$", shown, re.MULTILINE), name


def test_unknown_verb_lists_the_known_ones(capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit, match="2"):
        dev.parse(["tset"])
    assert "'test'" in capsys.readouterr().err


def test_test_runs_everything_and_with_arguments_only_pytest():
    tools = [" ".join(step) for step in dev.VERBS["test"].steps()]
    parts = (
        "ruff check",
        "ruff format --check",
        "pyright",
        "importlinter",
        "pytest -n 2",
        "--optimised",
        "--double",
    )
    for part in parts:
        assert sum(part in tool for tool in tools) == 1, part
    marks = [step[step.index("-m", 1) + 1] for step in dev.VERBS["test"].steps()[-2:]]
    assert marks == [f"{alone} and not tools and not thorough" for alone in ("not alone", "alone")]
    assert not any("not tools" in step for step in dev.VERBS["test"].steps("--all"))
    assert dev.VERBS["check"].steps() == dev.VERBS["test"].steps("--all")
    assert dev.VERBS["test"].steps("-k", "foo") == [["-m", "pytest", "-k", "foo"]]


def test_quick_leaves_out_what_takes_long_and_hands_on_what_else_is_asked():
    *tools, tests = dev.VERBS["test"].steps("--quick", "-k", "foo")
    tools = [" ".join(tool) for tool in tools]
    for part in ("ruff check", "ruff format --check", "importlinter"):
        assert sum(part in tool for tool in tools) == 1, part
    assert len(tools) == 3
    assert set(checks.QUICK) < set(tests)
    assert tests[-2:] == ["-k", "foo"]


@pytest.mark.parametrize("name", [*checks.QUICK, *checks.OPTIMISED, *checks.DOUBLE])
def test_what_the_chosen_tests_name_is_there(name: str):
    path, *tests = name.split("::")
    text = (dev.ROOT / path).read_text(encoding="utf-8") if tests else ""
    assert (dev.ROOT / path).exists()
    assert all(f"def {test.partition('[')[0]}(" in text for test in tests)


def collected(*args: object) -> list[str]:
    """Names of the tests that pytest finds with our settings."""
    command = [sys.executable, "-m", "pytest", "-c", "pyproject.toml", "--collect-only", "-q"]
    done = subprocess.run([*command, *map(str, args)], cwd=dev.ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return [line for line in done.stdout.splitlines() if "::" in line]


@pytest.mark.thorough
def test_quick_is_a_net_of_more_than_a_thousand_tests():
    assert len(collected(*checks.QUICK)) > 1000


@pytest.mark.thorough
def test_fuzz_runs_the_property_tests_alone_and_each_time_with_other_examples():
    (step,) = dev.VERBS["fuzz"].steps("tests/server")
    assert step == ["-m", "pytest", "-m", "hypothesis", "--hypothesis-profile", "fuzz", "tests/server"]
    found = collected("tests/base/test_registry.py", "tests/server/messages/test_victims.py", *step[2:6])
    (name,) = {line.split("::")[1] for line in found}
    assert name == "test_any_text_that_a_line_can_carry_is_read_back_as_it_was_written"
    fuzz, same = (hypothesis.settings.get_profile(name) for name in ("fuzz", "same"))
    assert not fuzz.derandomize
    assert fuzz.max_examples > same.max_examples
    assert fuzz.print_blob
    assert same.derandomize
    assert same.database is None


def test_only_the_demo_and_what_strangers_do_go_without_the_development_tools():
    bare = {name for name, verb in dev.VERBS.items() if not verb.extras}
    assert bare == {"demo", "try"}
    assert dev.VERBS["demo"].steps("--out", "x") == [["-m", "usarmjx", "demo", "--headless", "--out", "x"]]


def test_second_call_installs_nothing(checkout: FakeCheckout):
    (call,) = checkout.ensure("dev")
    assert "--editable .[dev] --constraint constraints.txt" in call
    assert checkout.ensure("dev") == []
    assert checkout.ensure() == []  # less than what is there


def test_extras_are_added_to_those_present(checkout: FakeCheckout):
    (bare,) = checkout.ensure()
    assert "--editable . " in bare
    checkout.ensure("train")
    (both,) = checkout.ensure("dev")
    assert "--editable .[dev,train] " in both
    assert checkout.ensure("train") == []


@pytest.mark.parametrize("name", environment.PINNED_BY)
def test_changed_requirements_are_installed(checkout: FakeCheckout, name: str):
    checkout.ensure("dev")
    (checkout.environment.root / name).write_text("something newer")
    assert len(checkout.ensure("dev")) == 1
    assert checkout.ensure("dev") == []


def test_failed_installation_is_reported_and_repeated(checkout: FakeCheckout):
    checkout.ensure("dev")
    checkout.broken.touch()
    (checkout.environment.root / "constraints.txt").write_text("impossible==1")
    with pytest.raises(environment.SetupError, match=r"no such package\npip failed with status 3"):
        checkout.ensure("dev")
    assert checkout.environment.installed() is None
    checkout.broken.unlink()
    assert len(checkout.ensure("dev")) == 1


def test_interrupted_installation_is_repeated(checkout: FakeCheckout, monkeypatch: pytest.MonkeyPatch):
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    checkout.ensure()
    with monkeypatch.context() as patch:
        patch.setattr(environment, "follow", interrupt)
        with pytest.raises(KeyboardInterrupt):
            checkout.ensure("dev")
    # Half of the new packages may be there: not even the former state is certain.
    assert len(checkout.ensure()) == 1


@pytest.mark.parametrize("damage", ["", "{", "[]", '{"fingerprint": 1}'])
def test_damaged_stamp_counts_as_missing(checkout: FakeCheckout, damage: str):
    checkout.ensure("dev")
    checkout.environment.stamp.write_text(damage)
    assert len(checkout.ensure("dev")) == 1


def test_copied_checkout_is_installed_anew(checkout: FakeCheckout, tmp_path: Path):
    checkout.ensure("dev")
    copy = tmp_path / "copy"
    copy.mkdir()
    for name in (*environment.PINNED_BY, ".venv"):
        source = checkout.environment.root / name
        (shutil.copytree if source.is_dir() else shutil.copy)(source, copy / name)
    # Its editable install still points to the first checkout.
    assert environment.Environment(copy, copy / ".venv").installed() is None


def test_first_bad_status_is_returned_and_the_rest_still_runs(
    checkout: FakeCheckout, capsys: pytest.CaptureFixture[str]
):
    steps = [["-m", "good"], ["-m", "bad"], ["-m", "killed"], ["-m", "last"]]
    assert environment.run_steps(checkout.environment, steps) == 7
    assert len(checkout.log.read_text().splitlines()) == len(steps)
    assert capsys.readouterr().err.endswith("failed: bad, killed\n")
    assert environment.run_steps(checkout.environment, [["-m", "killed"]]) == 128 + 15
    assert environment.run_steps(checkout.environment, [["-m", "good"]]) == 0


def test_steps_run_beside_the_next_one_and_their_output_comes_after_it(
    checkout: FakeCheckout, capfd: pytest.CaptureFixture[str]
):
    """The step beside ends only when it sees that the next one runs, which ends after it."""
    beside, longer = checkout.environment.root / "beside", checkout.environment.root / "longer"
    wait = "while [ ! -e {} ]; do sleep 0.01; done"
    checkout.environment.python.write_text(
        '#!/bin/sh\necho "$2 begins"\ncase "$2" in\n'
        f"  first) {wait.format(longer)} ;;\n  bad) touch {beside}; exit 7 ;;\n"
        f"  longer) touch {longer}; {wait.format(beside)} ;;\nesac\n"
    )
    steps = [*map(environment.Beside, (["-m", "first"], ["-m", "bad"])), ["-m", "longer"], ["-m", "last"]]
    assert environment.run_steps(checkout.environment, steps) == 7
    shown = capfd.readouterr()
    assert shown.out.splitlines() == [f"{name} begins" for name in ("longer", "first", "bad", "last")]
    assert shown.err.endswith("failed: bad\n")
    assert environment.run_steps(checkout.environment, steps[2:3] + steps[1:2]) == 7
    assert capfd.readouterr().out.splitlines() == ["longer begins", "bad begins"], "at the end, too"


@pytest.mark.parametrize(("given", "seen"), [(None, "8"), ("3", "3")])
def test_jax_gets_a_pool_that_cannot_deadlock(
    checkout: FakeCheckout, monkeypatch: pytest.MonkeyPatch, given: str | None, seen: str
):
    monkeypatch.delenv("NPROC", raising=False)
    if given:
        monkeypatch.setenv("NPROC", given)
    environment.run_steps(checkout.environment, [["-m", "good"]])
    assert checkout.log.read_text() == f"NPROC={seen} -m good\n"


@pytest.mark.parametrize(("given", "can_write"), [(None, True), (None, False), ("off", True)])
def test_test_runs_share_programs_unless_another_folder_or_none_is_asked_for(
    checkout: FakeCheckout,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    given: str | None,
    can_write: bool,
):
    seen: list[str] = []

    def run(
        command: list[str], cwd: Path, env: dict[str, str], **_: object
    ) -> subprocess.CompletedProcess[str]:
        seen.append(env["USARMJX_TEST_CACHE"])
        return subprocess.CompletedProcess(command, 0)

    monkeypatch.delenv("USARMJX_TEST_CACHE", raising=False)
    if given:
        monkeypatch.setenv("USARMJX_TEST_CACHE", given)
    users = tmp_path / "users"
    if not can_write:
        users.touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(users))
    monkeypatch.setattr(environment.subprocess, "run", run)
    environment.run_steps(checkout.environment, [["-m", "pytest"]])
    kept = users / "usarmjx-tests" if can_write else checkout.environment.root / "build" / "tests"
    assert seen == [given or str(kept)]


def test_missing_ensurepip_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for name in environment.PINNED_BY:
        (tmp_path / name).touch()
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(environment.SetupError, match="python3-venv"):
        environment.Environment(tmp_path, tmp_path / ".venv").ensure(frozenset())


@pytest.mark.slow
def test_environment_is_completed_and_nothing_in_it_deleted(tmp_path: Path):
    made = environment.Environment(tmp_path, tmp_path / ".venv")
    made.folder.mkdir()
    (made.folder / "mine").touch()
    made._create()
    assert made._has_pip()
    assert (made.folder / "mine").exists()


def read_pins(python: str) -> dict[str, str]:
    """Return the version of every pinned package for this version of Python."""
    lines = (dev.ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins: dict[str, str] = {}
    for pin in (Requirement(line) for line in lines if line and not line.startswith("#")):
        if pin.marker is None or pin.marker.evaluate({"python_version": python}):
            name = canonicalize_name(pin.name)
            assert name not in pins, f"{name} is pinned twice"
            (only,) = pin.specifier
            assert only.operator == "=="
            pins[name] = only.version
    return pins


def declared() -> list[Requirement]:
    """Return what pyproject.toml asks for, all extras included."""
    project = tomllib.loads((dev.ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"].values()
    return [Requirement(line) for lines in (project["dependencies"], *extras) for line in lines]


@pytest.mark.parametrize("python", ["3.11", "3.12"])
def test_every_declared_dependency_is_pinned_within_its_bounds(python: str):
    pins = read_pins(python)
    for wanted in declared():
        version = pins.get(canonicalize_name(wanted.name))
        assert version, f"{wanted} has no pin"
        assert version in wanted.specifier, f"{wanted} excludes its pin {version}"


def test_everything_that_the_dependencies_need_is_pinned():
    pins = read_pins("{}.{}".format(*sys.version_info))
    queue, seen, unpinned = declared(), set[str](), set[str]()
    while queue:
        wanted = queue.pop()
        name = canonicalize_name(wanted.name)
        visit = str((name, sorted(wanted.extras)))
        if visit in seen:
            continue
        seen.add(visit)
        if name not in pins:
            unpinned.add(name)
        try:
            needs = [Requirement(line) for line in metadata.requires(name) or ()]
        except metadata.PackageNotFoundError:
            continue  # of an extra that is not installed here
        extras = ("", *wanted.extras)
        for need in needs:
            if need.marker is None or any(need.marker.evaluate({"extra": e}) for e in extras):
                queue.append(need)
    assert unpinned == set()
    assert len(seen) > len(declared())


def test_stamp_is_plain_json(checkout: FakeCheckout):
    checkout.ensure("dev")
    assert json.loads(checkout.environment.stamp.read_text())["extras"] == ["dev"]
    assert not list(checkout.environment.folder.glob("*.unfinished"))
