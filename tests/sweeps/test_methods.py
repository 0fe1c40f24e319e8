"""Methods of several runs: compared over runs and buildings, normalised over tasks, written as a page."""

from html.parser import HTMLParser

import numpy as np
import pytest
from scipy import stats
from typer.testing import CliRunner

from usarmjx.base.errors import UsageError
from usarmjx.base.estimates import Estimate
from usarmjx.cli.app import app
from usarmjx.sweeps.analysis import aggregates, axis_rows, overall_rows, policy_differences
from usarmjx.sweeps.design import episodes_of, mean_score
from usarmjx.sweeps.page import latex_text
from usarmjx.sweeps.report import as_words, report
from usarmjx.sweeps.spec import read_spec
from usarmjx.sweeps.store import CellRecord, StoredSweep, write_cell, write_sweep

BUILDINGS, RUNS = 12, 5


def cell(key, scores, task="explore-v1", **settings):
    labels = tuple(f"DM-building-10x8-{4_000_001_000 + n}@{n:012x}" for n in range(len(scores)))
    return CellRecord(
        key=key,
        settings={"task": task, "policy": "baseline", "seed": 0, "episodes": len(scores), **settings},
        scores=tuple(map(float, scores)),
        steps=(10,) * len(scores),
        bad=(False,) * len(scores),
        split="test",
        buildings=labels,
        note="" if "method" not in settings else "mine: 1 of 12 buildings are those of its training",
    )


def sweep_of(records, *axes, **more):
    keys = tuple(record.key for record in records)
    return StoredSweep(name="methods", about="", axes=axes, keys=keys, records=tuple(records), **more)


@pytest.fixture(scope="module")
def compared():
    """The baseline, and two methods with five runs each, in two tasks with as many buildings."""
    draw, records = np.random.default_rng(3), []
    for task, base in (("explore-v1", 40.0), ("relay-chain-v1", 20.0)):
        building = draw.normal(0.0, 5.0, BUILDINGS)
        records.append(cell(f"hand {task}", base + building, task))
        records.append(cell(f"random {task}", 5.0 + 0.1 * building, task, policy="random"))
        for method, gain in (("PPO", 4.0), ("DAgger", 1.0)):
            for run in range(RUNS):
                scores = base + gain + building + draw.normal(0, 1.5) + draw.normal(0, 3, BUILDINGS)
                own = {"policy": f"runs/{method}{run}", "method": method}
                records.append(cell(f"{method}{run} {task}", scores, task, **own))
    return sweep_of(records, "task", "policy", "method", normalise={"zero": "random", "one": "baseline"})


def test_runs_of_a_method_are_cells_of_their_own():
    method = {"name": "PPO", "runs": ["runs/a", {"run": "runs/b", "checkpoint": "last"}]}
    spec = read_spec({"common": {"task": "explore-v1"}, "product": {"method": [method], "seed": [0, 1]}})
    assert [(one["method"], one["policy"], one["seed"]) for one in spec.cells] == [
        ("PPO", "runs/a", 0),
        ("PPO", {"run": "runs/b", "checkpoint": "last"}, 0),
        ("PPO", "runs/a", 1),
        ("PPO", {"run": "runs/b", "checkpoint": "last"}, 1),
    ]
    assert spec.axes == ("seed", "policy")
    for wrong, said in (
        ({"name": "PPO"}, "method is .*, expected {name: NAME, runs:"),
        ({"name": "PPO", "runs": []}, "method PPO: runs is"),
    ):
        with pytest.raises(UsageError, match=said):
            read_spec({"common": {"task": "explore-v1", "method": wrong}})
    with pytest.raises(UsageError, match="method and policy are both given"):
        read_spec({"common": {"task": "explore-v1", "policy": "baseline", "method": method}})


def test_an_interval_of_a_method_is_over_runs_and_buildings(compared):
    (row,) = [row for row in overall_rows(compared) if (row.task, row.policy) == ("explore-v1", "PPO")]
    assert [row.mean.drawn(name) for name in ("buildings", "runs", "settings")] == [BUILDINGS, RUNS, 1]
    table = np.array([record.scores for record in compared.records if record.key.startswith("PPO")][:RUNS])
    parts = table.mean(1).var(ddof=1) / RUNS, table.mean(0).var(ddof=1) / BUILDINGS
    rest = table - table.mean(1, keepdims=True) - table.mean(0) + table.mean()
    noise = (rest**2).sum() / (RUNS - 1) / (BUILDINGS - 1) / table.size
    variance = sum(parts) - noise
    dof = variance**2 / sum(
        part**2 / n for part, n in zip((*parts, noise), (4, BUILDINGS - 1, 4 * (BUILDINGS - 1)), strict=True)
    )
    half = stats.t.ppf(0.975, dof) * np.sqrt(variance)
    np.testing.assert_allclose(
        [row.mean.low, row.mean.high], [table.mean() - half, table.mean() + half], rtol=1e-9
    )
    runs = table.mean(1)
    assert row.middle.value == pytest.approx(stats.trim_mean(runs, 0.25)), "rliable's, of one task"


def test_methods_are_compared_in_the_same_buildings_and_corrected(compared):
    rows = {(row.task, row.first, row.second): row for row in policy_differences(compared)}
    row = rows["explore-v1", "PPO", "DAgger"]
    tables = [
        np.array([record.scores for record in compared.records if record.key.startswith(name)][:RUNS])
        for name in ("PPO", "DAgger")
    ]
    assert row.gain.value == pytest.approx(tables[0].mean() - tables[1].mean())
    found = stats.mannwhitneyu(tables[0].mean(1), tables[1].mean(1)).statistic / RUNS**2
    assert row.improvement.value == pytest.approx(found)
    assert all(
        0.0 <= one.improvement.low <= one.improvement.high <= 1.0
        for one in rows.values()
        if np.isfinite(one.improvement.low)
    )
    raw = [one.gain.p for one in rows.values()]
    assert all(one.p >= one.gain.p for one in rows.values())
    smallest = min(rows.values(), key=lambda one: one.gain.p)
    assert smallest.p == pytest.approx(min(1.0, len(raw) * smallest.gain.p))
    # Buildings are hard for all alike, which differences of the same buildings do not see.
    apart = mean_score(episodes_of([one for one in compared.finished if one.key.startswith("PPO")], {}))
    assert row.gain.high - row.gain.low < apart.high - apart.low + 4.0
    assert "p (Holm)" in report(compared)


def test_normalised_scores_are_0_at_random_and_1_of_the_baseline_in_each_task(compared):
    rows = {row.policy: row for row in aggregates(compared)}
    assert (rows["random"].mean.value, rows["baseline"].mean.value) == (
        pytest.approx(0.0),
        pytest.approx(1.0),
    )
    assert rows["baseline"].mean.high - rows["baseline"].mean.low < 1e-9, "it is 1 whatever is drawn"
    ratios = []
    for task in ("explore-v1", "relay-chain-v1"):
        means = {
            name: np.mean(
                [r.scores for r in compared.finished if r.settings["task"] == task and r.key.startswith(name)]
            )
            for name in ("PPO", "hand", "random")
        }
        ratios.append((means["PPO"] - means["random"]) / (means["hand"] - means["random"]))
    assert rows["PPO"].mean.value == pytest.approx(np.mean(ratios))
    assert rows["PPO"].tasks == 2
    earlier = sweep_of(compared.records, "task", normalise={"zero": "random", "one": "by-hand"})
    assert [row.mean for row in aggregates(earlier)] == [row.mean for row in rows.values()]
    lost = sweep_of(compared.records, "task", normalise={"zero": "oracle", "one": "baseline"})
    with pytest.raises(UsageError, match="zero is oracle, which has no cells of explore-v1"):
        aggregates(lost)


def test_another_sampled_setting_is_adjusted_for():
    """Score depends on the first setting alone: ranges of the second have the same score."""
    draw = np.random.default_rng(0)
    points = draw.random((60, 2))
    building = draw.normal(0, 1, BUILDINGS)
    records = [
        cell(f"{n}", 50 + 30 * x + building, **{"radio.cutoff": x, "vary.noise": y})
        for n, (x, y) in enumerate(points.tolist())
    ]
    sampled = {"radio.cutoff": [0.0, 1.0], "vary.noise": [0.0, 1.0]}
    rows = axis_rows(sweep_of(records, *sampled, sampled=sampled))
    noise = [row.mean.value for row in rows if row.axis == "vary.noise"]
    plain = [np.mean([r.scores for r in row.records]) for row in rows if row.axis == "vary.noise"]
    assert len(noise) == 8
    assert np.ptp(noise) < 1e-6 < 1.0 < np.ptp(plain)
    np.testing.assert_allclose(noise, 65 + building.mean(), atol=1e-6)


class Links(HTMLParser):
    """What a page would load."""

    def __init__(self):
        super().__init__()
        self.loaded, self.tags = [], set()

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        self.loaded += [
            value for name, value in attrs if name in ("src", "href") and not value.startswith("#")
        ]


def test_a_number_that_is_the_rounding_of_its_sum_is_printed_as_0():
    assert as_words(Estimate(value=1.54e-18, low=-0.01, high=0.03, count=9)) == "0 (-0.01 to 0.03)"
    assert as_words(Estimate(value=1e-8, low=0.5e-8, high=2e-8, count=9)) == "1e-08 (5e-09 to 2e-08)"
    assert as_words(Estimate(value=1e-8, low=1e-8, high=1e-8, count=9)) == "1e-08 (1e-08 to 1e-08)"


def test_a_report_is_one_page_that_loads_nothing_and_a_latex_table(compared, tmp_path):
    write_sweep(
        tmp_path, "methods", "What is & is not.", compared.axes, compared.keys, normalise=compared.normalise
    )
    for record in compared.records:
        write_cell(tmp_path, record)
    done = CliRunner().invoke(app, ["sweep", "report", str(tmp_path)])
    assert done.exit_code == 0, done.output
    page, links = (tmp_path / "report.html").read_text(), Links()
    links.feed(page)
    assert (links.loaded, {"table", "svg"} <= links.tags) == ([], True)
    assert "What is &amp; is not." in page
    assert "split test, 12 buildings" in page
    assert "DM-building-10x8-4000001000@000000000000" in page
    assert "warning: mine: 1 of 12 buildings are those of its training" in page
    table = (tmp_path / "report.tex").read_text()
    assert table.count("\\begin{tabular}") == table.count("\\bottomrule") == 3
    assert "PPO less DAgger" in table
    assert latex_text("a_b & 5 %") == "a\\_b \\& 5 \\%"
