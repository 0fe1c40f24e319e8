"""Scores over axes: many values are told in ranges, policies are compared over cells that all have."""

import numpy as np
import pytest

from usarmjx.base.errors import UsageError
from usarmjx.base.estimates import estimate_groups
from usarmjx.plots.style import PAGE
from usarmjx.sweeps.analysis import axis_rows, overall_rows, shared_cells
from usarmjx.sweeps.figures import cells_told, draw_sweep, in_lines, plot_sweep
from usarmjx.sweeps.report import report
from usarmjx.sweeps.store import CellRecord, StoredSweep

EPISODES = 6


def cell(number, policy="baseline", scores=None, **settings):
    scores = np.random.default_rng(number).uniform(0, 10, EPISODES) if scores is None else scores
    return CellRecord(
        key=f"{number} {policy}",
        settings={"task": "explore-v1", "policy": policy, **settings},
        engine="c",
        scores=tuple(map(float, scores)),
        steps=(10,) * len(scores),
        bad=(False,) * len(scores),
    )


def sweep_of(records, *axes):
    keys = tuple(record.key for record in records)
    return StoredSweep(name="some", about="", axes=axes, keys=keys, records=tuple(records))


@pytest.fixture
def sampled():
    """A hundred cells whose cutoff is anywhere between -60 and -40."""
    cutoffs = np.random.default_rng(5).uniform(-60, -40, 100)
    records = [cell(n, **{"radio.cutoff": float(cutoff)}) for n, cutoff in enumerate(cutoffs)]
    return sweep_of(records, "radio.cutoff"), cutoffs


def test_a_sampled_axis_is_told_in_eight_ranges_with_as_many_cells_each(sampled):
    found, cutoffs = sampled
    rows = axis_rows(found)
    edges = np.quantile(cutoffs, np.arange(9) / 8)
    assert [row.value.place for row in rows] == pytest.approx((edges[1:] + edges[:-1]) / 2)
    assert [row.value.text for row in rows][:2] == [
        f"{edges[0]:.4g} to {edges[1]:.4g}",
        f"{edges[1]:.4g} to {edges[2]:.4g}",
    ]
    assert [row.cells for row in rows] == np.histogram(cutoffs, edges)[0].tolist()


def test_a_range_has_the_mean_and_the_interval_of_all_its_episodes(sampled):
    found, cutoffs = sampled
    third = axis_rows(found)[2]
    low, high = np.quantile(cutoffs, [2 / 8, 3 / 8])
    scores = [record.scores for record, at in zip(found.records, cutoffs, strict=True) if low <= at < high]
    assert third.mean.value == pytest.approx(np.mean(scores))
    assert third.mean.count == EPISODES * len(scores)
    # Each cell has the same six episodes: what is drawn is these, and the cells are as they are.
    expected = estimate_groups(np.mean(scores, 0))
    np.testing.assert_allclose([third.mean.low, third.mean.high], [expected.low, expected.high], rtol=1e-9)
    assert (third.mean.drawn("buildings"), third.mean.drawn("settings")) == (EPISODES, len(scores))


def test_few_values_and_words_are_told_one_by_one():
    twelve = sweep_of([cell(n, seed=n) for n in range(12)], "seed")
    assert [row.value.text for row in axis_rows(twelve)] == [str(n) for n in range(12)]
    thirteen = sweep_of([cell(n, seed=n) for n in range(13)], "seed")
    rows = axis_rows(thirteen)
    assert len(rows) == 8
    assert (rows[0].value.text, rows[-1].value.text) == ("0 to 1.5", "10.5 to 12")
    assert sum(row.cells for row in rows) == 13, "the highest is in the last range"
    words = sweep_of([cell(n, arena=f"arena {n}") for n in range(20)], "arena")
    assert [row.value.place for row in axis_rows(words)] == [None] * 20


def test_numbers_are_in_order_and_what_is_as_usual_comes_first():
    cells = [cell(n, **{"radio.n": n}) for n in (3, 1, 2)]
    rows = axis_rows(sweep_of([*cells, cell(9)], "radio.n"))
    assert [row.value.text for row in rows] == ["as usual", "1", "2", "3"]
    many = [cell(n, **{"radio.n": n}) for n in range(16)]
    rows = axis_rows(sweep_of([*many, cell(99)], "radio.n"))
    assert [row.cells for row in rows] == [1, *[2] * 8]


def test_most_cells_may_have_the_same_number():
    cells = [cell(n, **{"radio.n": max(0, n - 90)}) for n in range(110)]
    rows = axis_rows(sweep_of(cells, "radio.n"))
    assert sum(row.cells for row in rows) == 110
    assert [row.value.text for row in rows] == ["0 to 5.375", "5.375 to 19"], "7/8 of 109 is 95.375"


@pytest.fixture
def uneven():
    """The baseline with teams of 2 and 4 at two levels; the packaged policy with teams of 4 alone."""
    baseline = [
        cell(n, scores=[score] * 3, roster={"P2AT": size}, **{"arena.level": level})
        for n, (size, level, score) in enumerate([(2, 0.4, 10), (2, 0.8, 5), (4, 0.4, 30), (4, 0.8, 20)])
    ]
    packaged = [
        cell(n, "packaged", [score] * 3, roster={"P2AT": 4}, **{"arena.level": level})
        for n, (level, score) in enumerate([(0.4, 32), (0.8, 21)])
    ]
    return sweep_of([*baseline, *packaged], "roster", "arena.level")


def test_policies_are_compared_over_the_cells_that_all_of_them_have(uneven):
    rows = {(row.axis, row.value.text, row.policy): row for row in axis_rows(uneven)}
    assert rows["arena.level", "0.4", "baseline"].mean.value == 30, "not 20, with the small team"
    assert rows["arena.level", "0.8", "packaged"].mean.value == 21
    assert [rows["arena.level", "0.4", policy].left_out for policy in ("baseline", "packaged")] == [1, 0]
    assert rows["roster", "P2AT x 2", "baseline"].mean.value == 7.5, "who is alone there has all its cells"
    assert rows["roster", "P2AT x 4", "baseline"].mean.value == 25
    assert ("roster", "P2AT x 2", "packaged") not in rows
    assert {row.policy: row.mean.value for row in overall_rows(uneven)} == {
        "baseline": 16.25,
        "packaged": 26.5,
    }
    assert "explore-v1: 2 cells of baseline are left out, which not all policies have" in report(uneven)


def test_a_cell_that_one_policy_lacks_is_left_out_of_the_others_value(uneven):
    some = [record for record in uneven.records if record.key != "0 packaged"]
    rows = {(row.axis, row.value.text, row.policy): row for row in axis_rows(sweep_of(some, *uneven.axes))}
    assert rows["roster", "P2AT x 4", "baseline"].mean.value == 20, "at the level of packaged"
    assert rows["roster", "P2AT x 4", "baseline"].left_out == 1


def test_policies_without_a_cell_in_common_stand_for_their_own():
    records = [
        cell(1, "baseline", roster={"P2AT": 2}, seed=0),
        cell(2, "baseline", roster={"P2AT": 2}, seed=1),
        cell(3, "packaged", roster={"P2AT": 4}, seed=0),
        cell(4, "packaged", roster={"P2AT": 4}, seed=1),
    ]
    found = sweep_of(records, "seed", "roster")
    rows = [row for row in axis_rows(found) if row.axis == "seed"]
    assert [(row.policy, row.own, row.left_out) for row in rows[:2]] == [
        ("baseline", True, 0),
        ("packaged", True, 0),
    ]
    assert shared_cells(records)[1]
    assert not shared_cells(records[:2])[1], "one policy has all cells in common with itself"
    assert "explore-v1: the policies have no cells in common, each is shown over its own" in report(found)


def panels_of(found):
    return {panel.get_gid(): panel for figure in draw_sweep(found) for panel in figure.axes}


def texts(panel):
    legend = panel.get_legend()
    return [] if legend is None else [text.get_text() for text in legend.get_texts()]


def test_a_legend_says_over_which_cells(uneven):
    panels = panels_of(uneven)
    assert texts(panels["arena.level"]) == ["baseline, 2 of 4 cells", "packaged"]
    assert texts(panels["profile"]) == ["baseline, 2 of 4 cells", "packaged"]
    assert texts(panels["roster"]) == [], "all of their cells are there"
    assert cells_told("baseline", 3, 0, True) == "baseline, its own 3 cells"


def test_points_have_their_intervals_and_no_line_joins_two(uneven):
    spread = [
        cell(1, scores=[1, 3, 5], **{"radio.n": 1}),
        cell(2, scores=[2, 3, 4], **{"radio.n": 2}),
        cell(2, "packaged", [3, 6, 9], **{"radio.n": 2}),
    ]
    found = sweep_of(spread, "radio.n")
    panel = panels_of(found)["radio.n"]
    assert panel.get_xlabel() == "path loss exponent of the radio"
    bars = {one.get_label(): one for one in panel.containers}
    assert [one.lines[0].get_linestyle() for one in bars.values()] == ["None", "None"]
    (line,) = bars["packaged"].lines[2]
    (row,) = [row for row in axis_rows(found) if row.policy == "packaged"]
    (segment,) = line.get_segments()
    np.testing.assert_allclose(segment[:, 1], [row.mean.low, row.mean.high])
    assert row.mean.low < 6 < row.mean.high
    three = sweep_of([*spread, cell(3, scores=[2, 2, 5], **{"radio.n": 3})], "radio.n")
    assert [one.lines[0].get_linestyle() for one in panels_of(three)["radio.n"].containers] == ["-", "None"]


def test_axes_of_a_task_are_drawn_to_one_scale_and_six_panels_a_figure(uneven):
    panels = panels_of(uneven)
    assert panels["roster"].get_ylim() == panels["arena.level"].get_ylim()
    settings = [{f"radio.{name}": n for name in ("pdo", "n", "cutoff", "atten_fac")} for n in range(3)]
    records = [cell(n, seed=n, **{"vary.noise": n, "vary.speed": n}, **own) for n, own in enumerate(settings)]
    drawn = draw_sweep(sweep_of(records, "seed", "vary.noise", "vary.speed", *settings[0]))
    assert [len(figure.axes) for figure in drawn] == [6, 2]
    assert {float(figure.get_figwidth()) for figure in drawn} == {PAGE}


@pytest.mark.parametrize("suffix", [".png", ".pdf", ".svg"])
def test_figures_are_pixels_or_vectors(uneven, tmp_path, suffix):
    (file,) = plot_sweep(uneven, tmp_path / f"x{suffix}")
    head = file.read_bytes()[:400]
    assert head.startswith({".png": b"\x89PNG", ".pdf": b"%PDF", ".svg": b"<?xml"}[suffix])
    with pytest.raises(UsageError, match=r"x.jpg: figures end in .png, .pdf, .svg, .eps"):
        plot_sweep(uneven, tmp_path / "x.jpg")


def test_a_team_has_a_line_for_each_class_and_a_range_one_line():
    assert in_lines("P2AT x 2, kenaf x 1") == "P2AT x 2,\nkenaf x 1"
    assert in_lines("[0.7, 1.3]") == "[0.7, 1.3]"
