"""The two-way bootstrap against closed forms: its variance, the interquartile mean, Mann-Whitney's U."""

import numpy as np
import pytest
from scipy import stats

from usarmjx.base.estimates import (
    Resampler,
    improvement_interval,
    interquartile_interval,
    mean_interval,
    profile_intervals,
)

RUNS, SETTINGS, BUILDINGS = 5, 3, 7


@pytest.fixture(scope="module")
def table():
    draw = np.random.default_rng(0)
    rows = draw.normal(size=(RUNS, 1, 1)) + draw.normal(size=(1, 1, BUILDINGS))
    return rows + 0.3 * draw.normal(size=(RUNS, SETTINGS, BUILDINGS))


def test_the_variance_of_a_resampled_mean_is_the_closed_form(table):
    """Both weights are multinomial: the variance is that of row means, of column means and of the rest."""
    found = Resampler(20_000).entries([table[:, :1]])[0].mean((1, 2))
    x = table[:, 0]
    rows, columns, middle = x.mean(1), x.mean(0), x.mean()
    rest = x - rows[:, None] - columns + middle
    form = ((rows - middle) ** 2).sum() / RUNS**2 + ((columns - middle) ** 2).sum() / BUILDINGS**2
    form += (rest**2).sum() / (RUNS * BUILDINGS) ** 2
    # A variance from 20,000 draws has a relative error of sqrt(2 / 20,000) = 1 %: four of these.
    assert found.var() == pytest.approx(form, rel=0.04)
    assert found.mean() == pytest.approx(middle, abs=4 * (form / 20_000) ** 0.5)


def test_one_building_leaves_the_bootstrap_of_runs_by_itself(table):
    """With one building only runs are drawn, as in the paper."""
    found = Resampler(20_000).entries([table[:, :1, :1]])[0].mean((1, 2))
    assert found.var() == pytest.approx(table[:, 0, 0].var() / RUNS, rel=0.04)


def test_values_are_the_definitions(table):
    other = table + 0.4
    means = table.mean(-1)
    assert interquartile_interval([table, other]).value == pytest.approx(
        stats.trim_mean(np.concatenate([means.ravel(), means.ravel() + 0.4]), 0.25)
    )
    assert mean_interval([table, other[:, :1]]).value == pytest.approx(
        (means.mean() + means[:, 0].mean() + 0.4) / 2
    )
    chances = [
        stats.mannwhitneyu(means[:, s] + 0.4, means[:, s]).statistic / RUNS**2 for s in range(SETTINGS)
    ]
    assert improvement_interval([other], [table]).value == pytest.approx(np.mean(chances))
    (half,) = profile_intervals([table], [float(np.median(means))])
    assert half.value == pytest.approx((means > np.median(means)).mean())


def test_intervals_hold_their_values_and_are_the_same_at_each_call(table):
    one, again = interquartile_interval([table]), interquartile_interval([table])
    assert one == again
    assert one.low < one.value < one.high
    assert (one.drawn("runs"), one.drawn("buildings")) == (RUNS, BUILDINGS)
    alike = improvement_interval([table], [table])
    assert alike.value == 0.5
    assert alike.low < 0.5 < alike.high


def test_a_shared_building_is_drawn_for_both_methods(table):
    """A gain that is the same in all buildings is sure, however much buildings differ."""
    far = np.random.default_rng(1).normal(0.0, 100.0, (1, 1, BUILDINGS)) + 1e-3 * table
    assert improvement_interval([far + 1.0], [far]).low == 1.0


def test_missing_episodes_are_left_out(table):
    with_gaps = table.copy()
    with_gaps[1, 2, 3] = np.nan
    assert mean_interval([with_gaps]).value == pytest.approx(np.nanmean(with_gaps, -1).mean())
    assert np.isfinite(Resampler(200).entries([with_gaps])[0]).all()
