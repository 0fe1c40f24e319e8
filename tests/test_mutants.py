"""The lists of mutants, and the tool that runs them: on a toy checkout, as the true one takes long."""

import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

import dev
from tools.mutants import (
    BROKEN,
    KILLED,
    LISTS,
    STALE,
    SURVIVED,
    Laboratory,
    ListError,
    Mutant,
    choose,
    main,
    read_lists,
)

MUTANTS = read_lists(dev.ROOT)
AREAS = {"comms", "planar", "protocol", "sensors", "sim", "train"}

ENTRY = """
[[mutant]]
name = "{name}"
file = "{file}"
find = '''{find}'''
replace = '''{replace}'''
tests = ["{tests}"]
"""
SOUND = "def twice(x):\n    return 2 * x\n\n\ndef half(x):\n    return x / 2\n"
TESTS = "from toy import twice\n\n\ndef test_twice():\n    assert twice(3) == 6\n"


def test_every_mutant_can_be_applied():
    """What is renamed or moved has to be followed in the lists."""
    assert {mutant.name: said for mutant in MUTANTS if (said := mutant.problem(dev.ROOT))} == {}


def test_every_mutant_has_tests_that_are_there():
    gone = {
        mutant.name: test
        for mutant in MUTANTS
        for test in mutant.tests
        if not (dev.ROOT / test.partition("::")[0]).exists()
    }
    assert gone == {}


def test_every_test_that_is_named_is_in_its_file():
    """By name, as nothing is collected here."""
    gone = {
        mutant.name: test
        for mutant in MUTANTS
        for test in mutant.tests
        for name in test.split("::")[1:]
        if f"def {name.partition('[')[0]}(" not in (dev.ROOT / test.partition("::")[0]).read_text("utf-8")
    }
    assert gone == {}


def test_each_area_has_about_ten():
    counts = {area: sum(mutant.area == area for mutant in MUTANTS) for area in AREAS}
    assert {mutant.area for mutant in MUTANTS} == AREAS
    assert min(counts.values()) >= 8


def entry(name="a", file="toy.py", find="2 * x", replace="3 * x", tests="test_toy.py"):
    return ENTRY.format(name=name, file=file, find=find, replace=replace, tests=tests)


@pytest.fixture
def toy(tmp_path, monkeypatch):
    """A checkout with a module and a test of it, and a function that adds mutants."""
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")  # whose import takes longer than the tests
    (tmp_path / LISTS).mkdir(parents=True)
    (tmp_path / "toy.py").write_text(SOUND)
    (tmp_path / "test_toy.py").write_text(TESTS)
    (tmp_path / "test_wrong.py").write_text("def test_wrong():\n    assert False\n")
    subprocess.run(["git", "init", "-q"], cwd=tmp_path, check=True)
    subprocess.run(["git", "add", "."], cwd=tmp_path, check=True)
    (tmp_path / "test_untracked.py").write_text("")

    def add(*entries: str) -> Path:
        (tmp_path / LISTS / "toys.toml").write_text("".join(entries))
        return tmp_path

    return add


def test_only_a_test_that_fails_kills(toy, capsys):
    """Neither a module that cannot be imported nor tests that fail anyway do."""
    root = toy(
        entry("dies"),
        entry("lives", find="x / 2", replace="x / 3"),
        entry("no-python", find="2 * x", replace="2 *"),
        entry("gone", find="4 * x"),
        entry("twice", find="(x)"),
        entry("moved", file="toys.py"),
        entry("fails-anyway", tests="test_wrong.py"),
        entry("not-copied", tests="test_untracked.py"),
    )
    assert main([], root) == 1
    *lines, last = capsys.readouterr().out.splitlines()
    found = {line.partition(": ")[0].split()[-1]: line.split()[0] for line in lines}
    assert found == {
        "dies": KILLED,
        "lives": SURVIVED,
        "no-python": BROKEN,
        "gone": STALE,
        "twice": STALE,
        "moved": STALE,
        "fails-anyway": BROKEN,
        "not-copied": BROKEN,
    }
    assert "8 mutants: 1 killed, 1 SURVIVED, 3 broken, 3 stale" in last
    assert "test_twice - " in lines[0], "it says why"
    assert (root / "toy.py").read_text() == SOUND, "the checkout stays as it is"


def test_who_has_moved_is_told_where_he_is(toy, tmp_path):
    root = toy(entry())
    (tmp_path / "parts").mkdir()
    (tmp_path / "toy.py").rename(tmp_path / "parts" / "new.py")
    mutant = Mutant("toys", "a", "parts/toy.py", "2 * x", "3 * x", ("test_toy.py",))
    assert mutant.problem(root) == "its file has the text 0 times; the text is in parts/new.py"
    assert "the text is nowhere" in replace(mutant, find="4 * x").problem(root)


def test_mutants_come_one_after_the_other_and_each_counts(toy, tmp_path):
    """Of the same length, within a second: Python does not take the code of one for that of the next."""
    copy = tmp_path / "copy"
    laboratory = Laboratory(toy(entry()), copy)
    dies, lives = (
        Mutant("toys", name, "toy.py", "2 * x", text, ("test_toy.py",))
        for name, text in (("dies", "3 * x"), ("lives", "x * 2"))
    )
    told = [laboratory.judge(mutant, check_clean=False)[0] for mutant in (dies, lives, dies, lives)]
    assert told == [KILLED, SURVIVED, KILLED, SURVIVED]
    assert (copy / "toy.py").read_text() == SOUND


def test_what_takes_too_long_is_no_kill(toy, capsys):
    root = toy(entry(replace="__import__('time').sleep(60)"))
    assert main(["--timeout", "3", "--no-check-clean"], root) == 1
    assert "broken" in capsys.readouterr().out


def test_all_killed_is_success_and_lists_run_nothing(toy, capsys):
    root = toy(entry("one"), entry("two", find="x / 2"))
    assert main(["--only", "one", "--area", "toys"], root) == 0
    capsys.readouterr()
    assert main(["--list"], root) == 0
    assert capsys.readouterr().out.splitlines() == [
        "toys     one: toy.py: test_toy.py",
        "toys     two: toy.py: test_toy.py",
    ]


@pytest.mark.parametrize(
    ("entries", "says"),
    [
        ((), "no mutants in"),
        ((entry(), entry()), "names that occur twice: a"),
        ((entry(replace="2 * x"),), "a: it changes nothing"),
        ((entry() + "speed = 1\n",), "a: missing or unknown: speed"),
        ((entry().replace("file =", "path ="),), "a: missing or unknown: file, path"),
        ((entry().replace('["test_toy.py"]', "[]"),), "a: tests must be a list of texts"),
        ((entry() + "why = 1\n",), "a: everything but tests must be a text"),
        (("[[mutant]\n",), "toys.toml: "),
    ],
)
def test_a_list_that_makes_no_sense_is_refused(toy, entries, says):
    with pytest.raises(ListError, match=says):
        read_lists(toy(*entries))


def test_what_is_asked_for_and_not_there_lists_what_there_is(toy, capsys):
    mutants = read_lists(toy(entry("one"), entry("two")))
    assert [mutant.name for mutant in choose(mutants, ["toys"], ["two"])] == ["two"]
    with pytest.raises(ListError, match="no area sims; known: toys"):
        choose(mutants, ["sims"], [])
    assert main(["--only", "three"], toy(entry("one"), entry("two"))) == 2
    assert "no mutant three; known: one, two" in capsys.readouterr().err
