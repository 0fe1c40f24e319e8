"""Figures of training: what is drawn is what was written down."""

import json
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.image import imread
from numpy.testing import assert_allclose, assert_array_equal
from typer.testing import CliRunner

import dev
from benchmarks.train import train_record
from tests.benchmarks.records import faults
from tests.test_docs import blocks
from tests.train.runs import CONFIG, lines
from usarmjx.base.errors import UsageError
from usarmjx.cli.app import app
from usarmjx.plots.training_plots import (
    Curve,
    curve_of_record,
    curve_of_run,
    curves_by_task,
    draw_curves,
    mean_curve,
    panel_title,
    plain_fields,
    read_curves,
    thinned,
)
from usarmjx.train.learning.config import from_record
from usarmjx.train.learning.metrics import read_lines

ABOUT = {"benchmark": "train", "device": "GPU", "worlds": 8, "agent_steps_per_s": 50.0}
RECORDS = (
    {**ABOUT, "task": "wait", "seed": 0, "curve": [[100, 9.0]]},  # superseded by the last one
    {**ABOUT, "task": "wait", "seed": 1, "curve": [[100, 0.0], [300, 4.0]], "baseline": 3.0},
    {"benchmark": "step", "worlds": 8},
    {**ABOUT, "task": "go", "seed": 0, "curve": [[1e6, -1.0, 7.0], [2e6, 5.0, 9.0]]},
    {**ABOUT, "task": "wait", "seed": 0, "curve": [[100, 2.0], [200, 4.0], [400, 6.0]], "baseline": 3.0},
)


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "train.jsonl"
    path.write_text("".join(json.dumps(record) + "\n" for record in RECORDS))
    return path


RUNS, MEAN, BASELINE = "runs", "mean of the runs", "baseline"


@pytest.fixture
def panels(file):
    """Of each panel the lines in it by what they are, as places and scores; over steps, then over time."""
    found = []
    for axes in [
        axes for along in ("steps", "time") for axes in draw_curves(read_curves(file), along)[0].axes
    ]:
        drawn = {}
        for line in axes.lines:
            name = line.get_label() if not line.get_label().startswith("_") else RUNS
            drawn.setdefault(name, []).append(np.array(line.get_data(), float).T.tolist())
        found.append((axes, drawn))
    return found


def test_each_task_has_its_curves_over_steps_and_over_time(panels):
    """Time is as written down, or at the record's steps per second; the last run of a seed counts."""
    (steps, waited), (_, went), (time, timed), (_, went_on) = panels
    assert (steps.get_xlabel(), time.get_xlabel()) == ("agent steps [million]", "time [s]")
    assert steps.get_title(loc="left") == "wait\n8 worlds, 2 runs, GPU"
    first, second = [[1e-4, 2.0], [2e-4, 4.0], [4e-4, 6.0]], [[1e-4, 0.0], [3e-4, 4.0]]
    assert_allclose(waited[RUNS][0], first)
    assert_allclose(waited[RUNS][1], second)
    assert_allclose(timed[RUNS][0], [[2.0, 2.0], [4.0, 4.0], [8.0, 6.0]])
    assert went == {RUNS: [[[1.0, -1.0], [2.0, 5.0]]]}
    assert went_on == {RUNS: [[[7.0, -1.0], [9.0, 5.0]]]}
    assert panels[1][0].get_ylim()[0] == -1.0
    assert [line.get_linestyle() for line in panels[1][0].lines] == ["None"], "two points are no line"


def test_the_mean_goes_as_far_as_all_seeds(panels):
    """At 200 steps (4 + 2) / 2, at 300 (5 + 4) / 2; beyond, one has nothing. Over time there is none."""
    (_, waited), _, (_, timed), _ = panels
    assert_allclose(waited[MEAN], [[[1e-4, 1.0], [2e-4, 3.0], [3e-4, 4.5]]])
    assert set(timed) == {RUNS, BASELINE}


def test_runs_of_other_kinds_are_drawn_by_themselves():
    """Only those of one engine, size, seed and the same fields set by hand supersede each other."""
    shape = {"steps": np.ones(1), "seconds": np.ones(1), "seed": 0}
    kinds = [
        ("wait", "c", "", 8), ("wait", "planar", "", 8), ("wait", "c", "", 8), ("go", "c", "", 8),
        ("wait", "c", "advice=false", 8), ("wait", "c", "", 64),
    ]  # fmt: skip
    curves = [
        Curve(task=task, engine=engine, fields=fields, worlds=worlds,
              score=np.array([float(i)]), **shape)
        for i, (task, engine, fields, worlds) in enumerate(kinds)
    ]  # fmt: skip
    found = {name: [one.score[0] for one in rows] for name, rows in curves_by_task(curves).items()}
    assert found == {
        "wait on c (8 worlds)": [2.0],
        "wait on planar (8 worlds)": [1.0],
        "go on c (8 worlds)": [3.0],
        "wait without advice on c (8 worlds)": [4.0],
        "wait on c (64 worlds)": [5.0],
    }


def test_titles_have_lines_that_fit_above_a_panel():
    """Of two panels beside each other, the title of one does not run into that of the other."""
    title = "wait without advice on planar (2048 worlds, NVIDIA H100 80GB HBM3 and NVIDIA H200)"
    assert panel_title(title, 3) == "wait without advice on planar\n2048 worlds, 3 runs, H100 and\nH200"
    assert panel_title("wait on c (8 worlds)", 1) == "wait on c\n8 worlds, 1 run"


def test_titles_have_fields_of_the_task_in_words():
    said = plain_fields("advice=false, hold=True, physics=reference")
    assert said == "without advice, with hold, with physics reference"
    assert plain_fields("") == ""


def test_seeds_of_several_machines_are_told_to_be():
    one = Curve(
        task="wait", seed=0, worlds=8, steps=np.ones(1), seconds=np.ones(1), score=np.ones(1), device="B"
    )
    assert list(curves_by_task([one, replace(one, seed=1, device="A")])) == ["wait (8 worlds, A and B)"]
    assert list(curves_by_task([one, replace(one, seed=1)])) == ["wait (8 worlds, B)"]


def test_records_tell_what_was_set_of_a_task_by_hand():
    """What a bare command sets goes without saying."""
    record = {**RECORDS[0], "task": "explore-v2", "engine": "planar"}
    for fields, told in (({}, "physics=reference"), ({"advice": "false"}, "advice=false")):
        task = {"physics": "reference" if not fields else "coarse", **fields}
        assert curve_of_record({**record, "settings": {"task": task}}).fields == told
    assert curve_of_record({**record, "settings": {"task": {"physics": "coarse"}}}).fields == ""
    assert curve_of_record(record).fields == ""


def test_long_curves_are_drawn_as_means_of_what_follows_each_other():
    """250 points become 100 of 3 or 2; a short one stays as it is."""
    places = np.arange(250.0)
    curve = Curve(task="wait", seed=0, worlds=8, steps=places, seconds=2 * places, score=places % 5)
    short = thinned(replace(curve, steps=places[:3], seconds=places[:3], score=places[:3]))
    assert_array_equal(short.score, [0.0, 1.0, 2.0])
    drawn = thinned(curve)
    assert_array_equal(drawn.steps[[0, 49, 50, 99]], [1.0, 148.0, 150.5, 248.5])
    assert_array_equal(drawn.seconds, 2 * drawn.steps)
    assert_array_equal(drawn.score[[0, 50]], [1.0, 0.5])


def test_the_baseline_is_a_line_across(panels):
    (axes, waited), *_, (_, went) = panels
    assert [score for _, score in waited[BASELINE][0]] == [3.0, 3.0]
    assert BASELINE not in went
    (legend,) = axes.get_figure().legends
    assert [text.get_text() for text in legend.get_texts()] == ["a run", MEAN, BASELINE]
    assert axes.get_legend() is None, "it covers no curve"


def test_a_run_is_drawn_from_what_it_has_written(reference):
    curve = curve_of_run(reference)
    written = lines(reference)
    assert (curve.task, curve.seed, curve.worlds) == ("drive-toy", 0, 32)
    assert_array_equal(curve.steps, [line["agent_steps"] for line in written])
    assert_array_equal(curve.score, [line["score"] for line in written])
    first, second, *_ = (2400 / line["steps_per_s"] for line in read_lines(reference / "metrics.jsonl"))
    assert_allclose(curve.seconds[:2], [first, first + second])
    places, mean = mean_curve([curve, curve], lambda one: one.steps)
    assert_array_equal(places, curve.steps)
    assert_allclose(mean, curve.score)


def test_the_command_draws_records_and_runs(file, reference, tmp_path):
    out = tmp_path / "new" / "curves.png"
    done = CliRunner().invoke(app, ["curves", str(file), str(reference), "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert done.output == f"wrote {out}\n"
    rows, columns, _ = imread(out).shape
    assert (columns, rows) == (1074, 360), "a page wide at 150 dots an inch"
    pages = draw_curves([replace(read_curves(file)[0], task=f"task {number}") for number in range(13)])
    assert [len(page.axes) for page in pages] == [6, 6, 1]


def test_a_run_is_recorded_as_it_is_drawn(reference, tmp_path):
    """And when it was as good as the baseline: in the first iteration with such a score."""
    file, scores = tmp_path / "records.jsonl", [line["score"] for line in lines(reference)]
    words = ["bench", "train", str(reference), "--baseline", "0.5", "--json", str(file)]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    (record,), (curve,) = (json.loads(line) for line in file.open()), read_curves(file)
    drawn = curve_of_run(reference)
    assert_array_equal(curve.steps, drawn.steps)
    assert_allclose(curve.score, drawn.score, atol=5e-5)  # four decimals
    assert_allclose(curve.seconds, drawn.seconds, atol=0.05)  # one
    reached = drawn.seconds[next(i for i, score in enumerate(scores) if score >= 0.5)]
    assert (curve.baseline, record["baseline_reached_s"]) == (0.5, pytest.approx(reached))
    assert record["agent_steps"] == 24_000
    assert any(change.startswith("gamma: 0.99 -> 0.9") for change in record["settings"]["training"])
    assert from_record(record["config"]) == CONFIG
    assert f"score {scores[-1]:.3f}; baseline 0.5 after {reached:.0f} s" in done.output
    assert train_record(reference, 2.0)["baseline_reached_s"] is None
    assert faults(record) == []
    assert record["rates"]["training"]["rate"] == pytest.approx(record["agent_steps_per_s"])
    assert "drive-toy" in record["baselines"]["mujoco_rollout"]["missing"]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (None, "is neither a file of benchmark records nor the folder of a run"),
        ("", "has no records of training"),
        ('{"benchmark": "step"}\n', "has no records of training"),
        ('{"benchmark": "train"}\n', "is no file of benchmark records: KeyError"),
        ("hello\n", "is no file of benchmark records"),
    ],
)
def test_what_has_no_curves_is_refused(text, complaint, tmp_path):
    path = tmp_path / "records.jsonl"
    if text is not None:
        path.write_text(text)
    with pytest.raises(UsageError, match=complaint):
        read_curves(path)


def test_the_figure_of_the_docs_is_of_all_records():
    page = (dev.ROOT / "docs" / "evidence" / "training.md").read_text(encoding="utf-8")
    assert "](training-curves.png)" in page
    command = "usarmjx curves benchmarks/results/train.jsonl --out docs/evidence/training-curves.png"
    assert any(command in block for block in blocks(page, "console"))
    assert (dev.ROOT / "docs" / "evidence" / "training-curves.png").stat().st_size < 150_000
    assert all(curve.baseline for curve in read_curves(dev.ROOT / "benchmarks" / "results" / "train.jsonl"))
