"""What is said of results: tables, differences, fronts, figures, files, other places to show them."""

import csv
import sys
import types

import numpy as np
import pytest
from PIL import Image
from pyarrow import parquet
from typer.testing import CliRunner

from usarmjx.base.errors import UsageError
from usarmjx.cli.app import app
from usarmjx.sweeps.analysis import axis_rows, front_points, overall_rows, policy_differences
from usarmjx.sweeps.report import compare, report
from usarmjx.sweeps.run import tensorboard_sink, wandb_sink
from usarmjx.sweeps.store import CellRecord, read_sweep, write_cell, write_sweep
from usarmjx.sweeps.table import export_rows


def record(key, scores, bad=(), failed=None, unlinked=0.5, **settings):
    settings = {"task": "explore-v1", "policy": "baseline", "seed": 0, "episodes": len(scores), **settings}
    flags = [number in bad for number in range(len(scores))]
    return CellRecord(
        key=key,
        settings=settings,
        engine="c",
        scores=tuple(map(float, scores)),
        steps=(10,) * len(scores),
        bad=tuple(flags),
        metrics={"unlinked": (unlinked,) * len(scores)},
        seconds=1.0,
        versions={"usarmjx": "0.0.1"},
        failed=failed,
    )


RECORDS = (
    record("a", [10, 20, 30], **{"radio.cutoff": -60, "policy": "baseline"}),
    record("b", [40, 50, 60], **{"radio.cutoff": -40, "policy": "baseline"}, unlinked=0.9),
    record("c", [11, 22, 33], **{"radio.cutoff": -60, "policy": "packaged"}, unlinked=0.2),
    record("d", [41, 0, 61], bad=(1,), **{"radio.cutoff": -40, "policy": "packaged"}, unlinked=0.95),
    record("e", [], failed="out of luck", **{"radio.cutoff": -20, "policy": "packaged"}),
)


def stored(folder, records=RECORDS, missing=("f",)):
    keys = [*(one.key for one in records), *missing]
    write_sweep(folder, "some", "What is asked.", ["radio.cutoff", "policy"], keys)
    for one in records:
        write_cell(folder, one)
    return read_sweep(folder)


@pytest.fixture
def found(tmp_path):
    return stored(tmp_path / "some")


def test_what_is_kept_comes_back(found):
    assert found.records == RECORDS
    assert found.keys == ("a", "b", "c", "d", "e", "f")


def test_scores_over_an_axis_are_those_of_its_cells(found):
    rows = {(row.axis, row.value.text, row.policy): row for row in overall_rows(found) + axis_rows(found)}
    assert rows["", "all", "baseline"].mean.value == 35.0
    assert rows["radio.cutoff", "-60", "baseline"].mean.value == 20.0
    last = rows["radio.cutoff", "-40", "packaged"].mean
    assert (last.value, last.count) == (51.0, 2), "an episode that went wrong does not count"
    assert last.low <= 51.0 <= last.high


def test_policies_are_compared_in_the_same_episodes(found):
    (row,) = policy_differences(found)
    assert (row.first, row.second) == ("baseline", "packaged")
    # Less 1, 2 and 3 in one cell; less 1 and 1 in the other, whose second episode went wrong.
    assert row.gain.value == pytest.approx(-(1 + 2 + 3 + 1 + 1) / 5)
    assert row.gain.count == 5
    assert row.better == 0.0


def test_the_front_is_between_score_and_connectivity(found):
    best = {point.label for point in front_points(found) if point.best}
    assert best == {
        "radio.cutoff -60, policy packaged",  # the best linked
        "radio.cutoff -40, policy packaged",  # the best score
        "radio.cutoff -40, policy baseline",
    }


def test_the_report_says_what_there_is_and_what_is_not(found):
    said = report(found)
    assert said.startswith("some: What is asked.\n4 of 6 cells, 1 failed, 1 not played yet\n")
    assert "1 episodes left out: physics failed" in said
    assert "failed: out of luck (1 cells, as radio.cutoff -20, policy packaged)" in said
    assert "computed with another usarmjx: 0.0.1" in said
    assert "| explore-v1 | -60          | baseline | 20 (" in said
    assert "-1.6 (" in said


def test_two_sweeps_are_compared_cell_by_cell(found, tmp_path):
    other = (record("x", [10, 20, 33], **{"radio.cutoff": -60}), RECORDS[1])
    said = compare(found, stored(tmp_path / "other", other))
    assert "2 cells in both, 2 in the first only, 0 in the second only" in said
    assert "the same score in 1 of them" in said
    assert "| explore-v1 | radio.cutoff -60, policy baseline | 20    | 21     | 1 (-3.3 to 5.3) " in said, (
        "Student's of 0, 0, 3"
    )


def test_tables_and_figures_are_files(found, tmp_path):
    folder, table, figure = tmp_path / "some", tmp_path / "t.csv", tmp_path / "f.png"
    episodes = tmp_path / "e.csv"
    words = ["sweep", "show", folder, "--table", table, "--figure", figure, "--episodes", episodes]
    done = CliRunner().invoke(app, list(map(str, words)))
    assert done.exit_code == 0, done.output
    rows = list(csv.DictReader(table.open()))
    assert [row["score"] for row in rows[:4]] == ["20.0", "50.0", "22.0", "51.0"]
    assert rows[4]["failed"] == "out of luck"
    assert [row["bad"] for row in csv.DictReader(episodes.open())].count("True") == 1
    picture = np.asarray(Image.open(figure).convert("L"))
    assert picture.shape[1] > picture.shape[0] > 200
    assert (picture < 128).sum() > 1000


def test_parquet_needs_pyarrow_and_mixed_columns_are_text(tmp_path, monkeypatch):
    rows = [{"a": 1, "b": "[1, 2]"}, {"a": 2.5, "b": 3.0}]
    with monkeypatch.context() as without:
        without.setitem(sys.modules, "pyarrow", None)
        with pytest.raises(UsageError, match="Parquet needs pyarrow"):
            export_rows(rows, tmp_path / "t.parquet")
    export_rows(rows, tmp_path / "t.parquet")
    assert parquet.read_table(tmp_path / "t.parquet").to_pydict() == {"a": [1, 2.5], "b": ["[1, 2]", "3.0"]}
    with pytest.raises(UsageError, match=r"tables end in .csv, .parquet"):
        export_rows(rows, tmp_path / "t.xlsx")


def test_a_parquet_file_has_the_rows_of_the_table(found, tmp_path):
    table, episodes = tmp_path / "t.parquet", tmp_path / "e.parquet"
    words = ["sweep", "show", tmp_path / "some", "--table", table, "--episodes", episodes]
    done = CliRunner().invoke(app, list(map(str, words)))
    assert done.exit_code == 0, done.output
    cells = parquet.read_table(table)
    assert cells.column("score").to_pylist()[:4] == [20.0, 50.0, 22.0, 51.0]
    assert cells.column("failed").to_pylist() == ["", "", "", "", "out of luck"]
    assert cells.column("radio.cutoff").to_pylist() == [-60, -40, -60, -40, -20]
    rows = parquet.read_table(episodes).to_pylist()
    assert [row["score"] for row in rows] == [score for one in RECORDS[:4] for score in one.scores]
    assert [row["bad"] for row in rows].count(True) == 1


def test_cells_are_shown_to_tensorboard_and_to_weights_and_biases(tmp_path, monkeypatch):
    tensorboard_sink(tmp_path)(RECORDS[0])
    (events,) = tmp_path.glob("events*")
    assert b"metric/unlinked" in events.read_bytes()
    assert b"setting/radio.cutoff" in events.read_bytes()
    calls = []
    run = types.SimpleNamespace(log=calls.append, finish=lambda exit_code: calls.append(exit_code))
    module = types.ModuleType("wandb")
    module.init = lambda **given: calls.append(given) or run
    monkeypatch.setitem(sys.modules, "wandb", module)
    sink = wandb_sink("robots", "some")
    sink(RECORDS[0])
    sink(RECORDS[4])
    assert (calls[0]["project"], calls[0]["group"], calls[0]["name"]) == ("robots", "some", "a")
    assert calls[1] == {"score": 20.0, "metric/unlinked": 0.5}
    assert [calls[2], calls[5]] == [0, 1]
    monkeypatch.setitem(sys.modules, "wandb", None)
    with pytest.raises(UsageError, match="pip install wandb"):
        wandb_sink("robots", "some")


def test_the_command_line_refuses_in_one_line(tmp_path):
    def refused(*words):
        done = CliRunner().invoke(app, ["sweep", *map(str, words)])
        assert done.exit_code == 2
        return done.output

    assert "no bundled sweep; those are: robustness, teams, thousand" in refused("nothing")
    assert "holds no sweep" in refused("show", tmp_path)
    file = tmp_path / "x.yaml"
    file.write_text("common: {task: explore-v1}\nproduct: {seed: [0]}\n")
    assert "run on 'moon': expected here, processes, ray" in refused(file, "--run-on", "moon")
    assert "an address is for a cluster of Ray" in refused(file, "--address", "10.0.0.1:6379")
    assert "no setting 'height'" in refused(file, "--set", "height=3")
