"""Results files of strangers: `suite replay` runs no code that only they name."""

from dataclasses import replace

import pytest
from typer.testing import CliRunner

from usarmjx.base.errors import UsageError
from usarmjx.cli.app import app
from usarmjx.sweeps.spec import find_suite
from usarmjx.sweeps.standings import check_origin
from usarmjx.sweeps.store import CellRecord
from usarmjx.sweeps.suite import RunResult, load_suite, run_digest

CODE = """
import pathlib
pathlib.Path(__file__).with_name("RAN").touch()

def drive(env):
    raise NotImplementedError
"""


@pytest.fixture(scope="module")
def suite():
    return load_suite(find_suite("drive-v1"))


@pytest.fixture
def evil(tmp_path):
    (tmp_path / "evil.py").write_text(CODE)
    return tmp_path


def result_of(suite, run, **changes):
    """A result of one episode in the suite's first cell, with other settings of that cell."""
    settings = suite.spec("test", "mine", [run]).cells[0] | changes
    rows = {"scores": (1.0,), "steps": (9,), "bad": (False,), "buildings": ("m",)}
    return RunResult(
        suite=suite.name,
        suite_digest=suite.digest,
        split="test",
        method="mine",
        run=run,
        policies={"drive-to-goal": "0"},
        cells=(CellRecord(key="1", settings=settings, engine="c", **rows),),
    )


RUNS = ["{evil}/evil.py:drive", "client:touch {evil}/RAN", "baseline:{evil}/evil.py:Task"]


@pytest.mark.parametrize("run", RUNS)
def test_a_run_that_is_code_is_not_run_by_its_file(suite, evil, run):
    result = result_of(suite, run.format(evil=evil))
    file = evil / "mine.result.json"
    result.write(file)
    found = CliRunner().invoke(app, ["suite", "replay", str(file), "--episodes", "1"])
    assert found.exit_code == 2
    assert "whose code it does not run by itself" in found.stderr
    assert found.stderr.count("\n") == 1
    assert not (evil / "RAN").exists()


def test_nor_is_code_that_only_a_cell_names(suite, evil):
    for changes in ({"policy": {"client": f"touch {evil}/RAN"}}, {"task": f"{evil}/evil.py:Task"}):
        with pytest.raises(UsageError, match=r"is not played by the run 'random'|drive-v1 has no task"):
            check_origin(result_of(suite, "random", **changes), suite)
    assert not (evil / "RAN").exists()


def test_what_the_user_names_is_run(suite, evil):
    run = f"{evil}/evil.py:drive"
    result = result_of(suite, run)
    with pytest.raises(UsageError, match="whose code it does not run by itself"):
        check_origin(result, suite, "other.py:drive")
    assert not (evil / "RAN").exists()
    check_origin(replace(result, policies={"drive-to-goal": run_digest(run, "drive-to-goal")}), suite, run)
    assert (evil / "RAN").exists()


def test_a_policy_that_has_changed_is_refused(suite):
    result = result_of(suite, "random")
    with pytest.raises(UsageError, match="the policy of 'random' has changed"):
        check_origin(result, suite)
    check_origin(replace(result, policies={"drive-to-goal": run_digest("random", "drive-to-goal")}), suite)
