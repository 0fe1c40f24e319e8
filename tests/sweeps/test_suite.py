"""Suites: results files of runs, standings of methods, the leaderboard, a replay."""

from collections import Counter
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from tests.sweeps.conftest import SMALL
from usarmjx.base.errors import UsageError
from usarmjx.base.estimates import Resampler
from usarmjx.cli.app import app
from usarmjx.sweeps.figures import plot_profiles
from usarmjx.sweeps.resolve import resolve
from usarmjx.sweeps.spec import find_suite
from usarmjx.sweeps.standings import (
    leaderboard_page,
    replay,
    standings_of,
    standings_record,
    standings_report,
)
from usarmjx.sweeps.store import CellRecord
from usarmjx.sweeps.suite import RunResult, load_suite, read_result, read_results, run_digest, run_suite

FEW, BUILDINGS, RUNS = Resampler(200), 6, 3
TASKS = {"explore-v2": 40.0, "relay-chain-v1": 20.0}


@pytest.fixture(scope="module")
def suite():
    return load_suite(find_suite("teams-v1"))


def cell(task, scores, cutoff, policy, method, **more):
    settings = {"task": task, "policy": policy, "method": method, "radio.cutoff": cutoff, "seed": 0}
    return CellRecord(
        key=f"{task} {cutoff} {policy}",
        settings={**settings, "episodes": len(scores), "arena.count": 2},
        engine="planar",
        scores=tuple(map(float, scores)),
        steps=(10,) * len(scores),
        bad=(False,) * len(scores),
        buildings=tuple(f"DM-building-10x8-{n}@{n:012x}" for n in range(len(scores))),
        metrics={"contacts": (2.0,) * len(scores), "explored": (0.5,) * len(scores)},
        seconds=3.0,
        compile_seconds=1.0,
        **more,
    )


METHODS = (("random", 0.0, 1), ("baseline", 1.0, 1), ("mine", 1.5, RUNS))
"""Name, share and number of runs of each method: the last one's lie around halfway between 1 and 2."""


def results_of(suite, split="test", methods=METHODS, tasks=TASKS):
    """Results of methods whose scores lie at their shares between 10 and the highest of each task."""
    draw, found = np.random.default_rng(2), []
    building = draw.normal(0.0, 0.5, BUILDINGS)
    for method, share, count in methods:
        for run in range(count):
            name = method if count == 1 else f"runs/{method}-{run}"
            cells = [
                cell(task, 10.0 + share * (base - 10.0) + building + 0.2 * run, cutoff, name, method)
                for task, base in tasks.items()
                for cutoff in (-49, -43)
            ]
            found.append(
                RunResult(
                    suite=suite.name,
                    suite_digest=suite.digest,
                    split=split,
                    method=method,
                    run=name,
                    commit="abc",
                    card="H200",
                    versions={"jax": "0.10.2"},
                    policies=dict.fromkeys(tasks, "0123"),
                    cells=tuple(cells),
                )
            )
    return found


def test_the_bundled_suite_asks_for_held_out_buildings_that_do_not_depend_on_the_episodes(suite):
    spec = suite.spec("test", "mine", ["packaged", "baseline:{task}"])
    assert {one["split"] for one in spec.cells} == {"test"}
    assert [one["policy"] for one in spec.cells if one["task"] == "relay-chain-v1"][:2] == [
        "packaged",
        {"baseline": "relay-chain-v1"},
    ]
    counts = {one["task"]: one["arena.count"] for one in spec.cells}
    few = suite.spec("test", "mine", ["random"], episodes=3)
    assert {one["task"]: one["arena.count"] for one in few.cells} == counts
    with pytest.raises(UsageError, match="split 'train', expected one of validation, test"):
        suite.spec("train", "mine", ["random"])
    with pytest.raises(
        UsageError,
        match="no-such is no file, and no bundled suite; those are: "
        "drive-v1, teams-v1, teams-v3, teams-v3-small",
    ):
        find_suite("no-such")


def test_a_results_file_is_read_as_it_was_written_and_damage_is_named(suite, tmp_path):
    (one, *_) = results_of(suite)
    file = tmp_path / one.file_name(0)
    assert file.name == "teams-v1-test-random-0.result.json"
    one.write(file)
    again = read_result(file)
    assert again.cells[0].metrics == {"contacts": (2.0,) * BUILDINGS}  # others are not kept
    np.testing.assert_allclose(again.cells[0].scores, one.cells[0].scores, rtol=1e-5)
    for cells in (again.cells, one.cells):
        assert sum(cell.seconds - cell.compile_seconds for cell in cells) == 2.0 * len(one.cells)
    file.write_text(file.read_text().replace("H200", "H100"))
    with pytest.raises(UsageError, match=r"random-0.result.json: is not whole"):
        read_result(file)
    with pytest.raises(UsageError, match=r"no results \(\*.result.json\) in"):
        read_results([tmp_path / "cells"]) if (tmp_path / "cells").mkdir() is None else None


def test_standings_have_the_shares_between_random_and_the_score_that_counts_as_one(suite, tmp_path):
    found = standings_of(results_of(suite), suite)
    record = standings_record(found, FEW)
    # Runs differ by 0.2 in score, a share of 0.2 / 30; the interquartile mean is that of the middle run.
    assert record["all"]["random"]["value"] == pytest.approx(0.0, abs=1e-9)
    assert record["all"]["baseline"]["value"] == pytest.approx(1.0)
    mine = next(one for one in record["rows"] if (one["task"], one["method"]) == ("explore-v2", "mine"))
    assert mine["normalised"]["value"] == pytest.approx(1.5 + 0.2 / 30)
    assert (mine["runs"], mine["settings"], mine["buildings"]) == (RUNS, 2, BUILDINGS)
    assert mine["metrics"] == {"contacts": 2.0, "explored": 0.5}
    assert mine["seconds_per_episode"] == pytest.approx(2.0 / BUILDINGS)
    text = standings_report(found, FEW)
    assert "| mine     | baseline | 1 (1 to 1)" in text
    plot_profiles(found, tmp_path / "profile.png", FEW)
    assert (tmp_path / "profile.png").stat().st_size > 5_000


def test_results_that_do_not_compare_are_refused_by_name(suite):
    results = results_of(suite)
    with pytest.raises(
        UsageError, match=r"random, run random: results of suite teams-v1 \(other\), expected"
    ):
        standings_of([replace(results[0], suite_digest="other"), *results[1:]], suite)
    with pytest.raises(UsageError, match="results of the splits test and validation"):
        standings_of([*results, *results_of(suite, "validation")], suite)
    rest = [replace(one, cells=one.cells[1:]) if one.method == "random" else one for one in results]
    record = standings_record(standings_of(rest, suite), FEW)
    assert {one["settings"] for one in record["rows"] if one["task"] == "explore-v2"} == {1}


def test_the_leaderboard_names_every_run_with_its_origin(suite):
    page = leaderboard_page(results_of(suite))
    assert page.count("| abc    | H200 | 0.10.2 |") == RUNS + 2
    assert "## teams-v1" in page
    assert leaderboard_page(results_of(suite, "validation")).count("##") == 0


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    """A tiny suite that the baseline has played: two buildings of a maze on C MuJoCo."""
    folder = tmp_path_factory.mktemp("suite")
    common = {name: one for name, one in SMALL["common"].items() if name not in ("episodes", "split")}
    content = {
        "episodes": {"validation": 2, "test": 2},
        "common": common,
        "list": [{"arena.level": 0.9}],
        "zero": {"drive-to-goal": -1.0},
        "one": {"drive-to-goal": 1.0},
    }
    file = folder / "tiny.yaml"
    file.write_text(yaml.safe_dump(content))
    return file, run_suite(load_suite(file), "validation", "planner", ["baseline"], folder / "results")


GOAL_TASKS = ["explore-v3", "victim-search-v3", "relay-chain-v3"]


def test_the_suite_of_teams_that_choose_goals_has_all_sizes_and_radios():
    """Three tasks, teams of 2, 4, 8, 16, three cutoffs; buildings of three sizes, as many of each."""
    spec = load_suite(find_suite("teams-v3")).spec("test", "mine", ["baseline"])
    cells = [(one["task"], one["roster"]["P2AT"], one["radio.cutoff"]) for one in spec.cells]
    assert sorted(cells) == sorted(product(GOAL_TASKS, (2, 4, 8, 16), (-43, -49, -1e6)))
    found = resolve(spec.cells[0])
    sizes = Counter(label.rpartition("-")[0] for label in found.labels)
    assert (found.task.count, found.levels, set(sizes.values())) == (2, 9, {15})
    assert len(sizes) == 3


def test_the_small_suite_has_cells_of_the_suite_of_teams_that_choose_goals():
    """One of each task, in three buildings of each size; the oracle counts as 1 in both."""
    whole, small = (load_suite(find_suite(name)) for name in ("teams-v3", "teams-v3-small"))
    assert (small.file.zero, small.file.one) == (whole.file.zero, whole.file.one) == ("random", "oracle")
    cells, all_cells = (one.spec("test", "mine", ["baseline"]).cells for one in (small, whole))
    assert [one["task"] for one in cells] == GOAL_TASKS
    for cell in cells:
        assert any({**one, "episodes": 9, "arena.count": 3} == cell for one in all_cells)
        sizes = Counter(label.rpartition("-")[0] for label in resolve(cell).buildings)
        assert sorted(sizes.values()) == [3, 3, 3]


def test_shares_of_teams_that_choose_goals_end_at_the_oracle():
    """A method at 0.4 of the way has that share; without the oracle's results there are no shares."""
    suite, tasks = load_suite(find_suite("teams-v3")), dict.fromkeys(GOAL_TASKS, 60.0)
    methods = (("random", 0.0, 1), ("baseline", 0.4, 1), ("oracle", 1.0, 1))
    results = results_of(suite, methods=methods, tasks=tasks)
    record = standings_record(standings_of(results, suite), FEW)
    assert record["all"]["oracle"]["value"] == pytest.approx(1.0)
    assert record["all"]["baseline"]["value"] == pytest.approx(0.4)
    text = standings_report(standings_of(results[:2], suite), FEW)
    assert text.endswith("no normalised scores: no results of oracle")


@pytest.mark.thorough
def test_a_planner_plays_the_suite_of_teams_that_choose_goals(tmp_path):
    """In small buildings, two robots and few steps."""
    whole = load_suite(find_suite("teams-v3"))
    small = {"arena.size": [5, 4], "fields.episode_steps": 3, "roster": {"P2AT": 2}}
    few = replace(whole, file=replace(whole.file, product={"radio.cutoff": [-49]}))
    (file,) = run_suite(few, "validation", "courier", ["baseline:courier"], tmp_path, episodes=1, **small)
    found = read_result(file)
    assert [one.settings["task"] for one in found.cells] == GOAL_TASKS
    assert {str(one.settings["policy"]) for one in found.cells} == {"{'baseline': 'courier'}"}
    assert all(np.isfinite(one.scores).all() and one.steps == (3,) for one in found.cells)


def test_a_replay_plays_the_same_episodes_to_the_bit(played):
    """Engine `c` computes the same bits in whatever batch; six digits are kept."""
    file, (result,) = played
    (again,) = replay(read_result(result), load_suite(file), 2)
    assert again.same_buildings
    np.testing.assert_allclose(again.after, again.before, rtol=1e-5)
    found = CliRunner().invoke(app, ["suite", "show", str(result.parent), "--suite", str(file)])
    assert found.exit_code == 0, found.output
    assert "drive-to-goal" in found.output
    missing = CliRunner().invoke(
        app, ["suite", "show", str(result.parent), "--suite", str(file), "--split", "test"]
    )
    assert missing.exit_code == 2
    assert "no results of suite tiny on split test there" in missing.output


def test_methods_that_are_played_at_once_into_one_folder_keep_their_results(played, tmp_path):
    """The second begins when the first has planned its cells, and ends before it."""
    suite, begun = load_suite(played[0]), []

    def begin_other(line):
        if not begun:
            begun.append(line)
            begun.extend(run_suite(suite, "validation", "other", ["random"], tmp_path, episodes=1))

    (first,) = run_suite(suite, "validation", "planner", ["baseline"], tmp_path, say=begin_other, episodes=1)
    _, second = begun
    policies = [[one.settings["policy"] for one in read_result(file).cells] for file in (first, second)]
    assert policies == [["baseline"], ["random"]]


def test_the_hash_of_a_policy_is_that_of_its_weights(tmp_path):
    from tests.sweeps.conftest import weak

    (tmp_path / "own.py").write_text("def drive(env):\n    raise NotImplementedError\n")
    script = f"{tmp_path / 'own.py'}:drive"
    before = run_digest(script, "drive-to-goal")
    (tmp_path / "own.py").write_text("def drive(env):\n    return None\n")
    assert run_digest(script, "drive-to-goal") != before
    assert run_digest("random", "explore-v2") == run_digest("random", "explore-v2")
    file = weak(tmp_path / "weak.npz")
    assert run_digest(str(file), "drive-to-goal") != run_digest("packaged", "drive-to-goal")
