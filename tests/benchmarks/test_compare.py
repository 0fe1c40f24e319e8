"""Comparison of records: the newest of a case against the one before it of another commit."""

import json

import pytest
from typer.testing import CliRunner

from benchmarks.compare import changes
from benchmarks.report.records import BenchRecord
from usarmjx.cli.app import app

STEP = {"benchmark": "step", "device": "GPU", "case": {"worlds": 4, "engine": "planar"}}
TRAIN = {"benchmark": "train", "device": "GPU", "case": {"task": "t"}, "config": {"gamma": 0.9, "seed": 0}}


def record(day, commit, rate, base=STEP, name="whole", **more):
    when = f"2026-01-{day:02}T00:00:00+00:00"
    data = {**base, "when": when, "commit": commit, "rates": {name: {"rate": rate}}, **more}
    return BenchRecord("x.jsonl", data)


def ratios(*records):
    return [(change.name, round(change.ratio, 6)) for change in changes(records)]


def test_the_newest_is_compared_with_the_one_before():
    assert ratios(record(1, "a", 50.0), record(2, "b", 100.0), record(3, "c", 90.0)) == [("whole", 0.9)]


def test_one_commit_is_no_change():
    assert ratios(record(1, "a", 50.0), record(2, "a", 100.0)) == []
    assert ratios(record(1, "a", 50.0), record(2, "b", 100.0), record(3, "b", 90.0)) == [("whole", 1.8)]


@pytest.mark.parametrize(
    "other",
    [{"device": "TPU"}, {"case": {"worlds": 8, "engine": "planar"}}, {"benchmark": "rays"}, {"case": {}}],
)
def test_another_machine_or_case_is_no_change(other):
    assert ratios(record(1, "a", 50.0), record(2, "b", 100.0, **other)) == []


def test_a_new_option_is_the_same_case():
    newer = record(2, "b", 25.0, case={**STEP["case"], "graph": "step", "repeats": 9})
    assert ratios(record(1, "a", 50.0), newer) == [("whole", 0.5)]


def test_settings_of_a_training_are_part_of_its_case():
    older = record(1, "a", 50.0, TRAIN, "training")
    other = record(2, "b", 10.0, TRAIN, "training", config={"gamma": 0.5, "seed": 0})
    assert ratios(older, other) == []
    again = record(3, "c", 40.0, TRAIN, "training", config={"gamma": 0.9, "seed": 7})
    assert ratios(older, other, again) == [("training, median", 0.8)]


def test_means_of_trainings_are_not_compared_with_medians():
    older = record(1, "a", 50.0, TRAIN, "training")
    newer = record(2, "b", 30.0, TRAIN, "training", median_agent_steps_per_s=60.0)
    assert ratios(older, newer) == [("training, median", 1.2)]
    newest = record(3, "c", 33.0, TRAIN, "training", median_agent_steps_per_s=60.0)
    assert ratios(older, newer, newest) == [("training, all waits", 1.1), ("training, median", 1.0)]


@pytest.mark.parametrize(("rate", "status"), [(96.0, 0), (94.0, 1)])
def test_the_command_names_what_became_slower(rate, status, tmp_path):
    lines = [json.dumps(dict(one.data)) for one in (record(1, "a", 100.0), record(2, "b", rate))]
    (tmp_path / "step.jsonl").write_text("\n".join(lines) + "\n")
    done = CliRunner().invoke(app, ["bench", "compare", "--results", str(tmp_path)])
    assert done.exit_code == status
    assert f"{rate / 100:.3f}" in done.output
    assert ("slower by 6%: step, whole, on GPU, worlds 4, engine planar: a to b" in done.output) == bool(
        status
    )
