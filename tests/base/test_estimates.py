"""Intervals, interquartile means, profiles and fronts, against closed forms."""

import math

import numpy as np
import pytest
from scipy import stats

from usarmjx.base.estimates import (
    estimate_groups,
    estimate_middle,
    interquartile_mean,
    pareto_front,
    performance_profile,
    probability_of_improvement,
)


def test_shares_have_wilsons_interval():
    found = estimate_groups(np.array([1.0] * 8 + [0.0] * 2), shares=True)
    z, n, p = 1.959963984540054, 10, 0.8
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    assert (found.value, found.method) == (0.8, "Wilson")
    np.testing.assert_allclose([found.low, found.high], [middle - half, middle + half], rtol=1e-9)
    assert estimate_groups(np.array([1.0, 0.0, 1.0])).method == "crossed"


def test_independent_values_have_students_interval():
    values = np.random.default_rng(1).normal(50.0, 10.0, 400)
    found = estimate_groups(values)
    half = stats.t.ppf(0.975, 399) * stats.sem(values)
    np.testing.assert_allclose(
        [found.low, found.high], [values.mean() - half, values.mean() + half], rtol=1e-9
    )
    assert (found.count, found.drawn("buildings")) == (400, 400)


def test_values_of_a_group_are_drawn_together():
    """Twice the same starts are not twice as many: the interval is that of the starts."""
    values = np.array([1.0, 0.0, 1.0, 1.0, 4.0])
    twice = estimate_groups(np.tile(values, 2), np.tile(np.arange(5), 2))
    once = estimate_groups(values)
    np.testing.assert_allclose([twice.low, twice.high], [once.low, once.high], rtol=1e-12)
    assert (twice.count, twice.drawn("buildings")) == (10, 5)


def test_strata_are_drawn_from_each_on_its_own():
    apart = np.repeat([10.0, 90.0], 5)
    found = estimate_groups(apart, strata=np.repeat([0, 1], 5))
    assert (found.value, found.low, found.high, found.count) == (50.0, 50.0, 50.0, 10)
    together = estimate_groups(apart)
    assert together.low < 40.0 < 60.0 < together.high
    assert estimate_groups(apart, strata=range(10)) == together, "strata of one say nothing of a spread"


def test_little_is_known_of_little():
    assert math.isnan(estimate_groups(np.zeros(0)).value)
    one = estimate_groups(np.array([3.0]))
    assert (one.value, one.low, one.high) == (3.0, -math.inf, math.inf)


def test_the_interquartile_mean_leaves_out_both_quarters():
    assert interquartile_mean(np.array([0.0, 10.0, 12.0, 1000.0])) == 11.0
    rows = np.array([[0.0, 1.0, 2.0, 9.0], [4.0, 4.0, 4.0, 4.0]])
    np.testing.assert_array_equal(interquartile_mean(rows), [1.5, 4.0])


def test_a_profile_is_the_share_above_each_threshold():
    shares = performance_profile(np.array([1.0, 2.0, 2.0, 4.0]), np.array([0.0, 1.0, 2.0, 4.0]))
    np.testing.assert_array_equal(shares, [1.0, 0.75, 0.25, 0.0])


def test_nobody_on_the_front_is_beaten():
    points = np.array([[1.0, 5.0], [2.0, 4.0], [2.0, 3.0], [3.0, 1.0], [0.0, 5.0], [1.0, 5.0]])
    np.testing.assert_array_equal(pareto_front(points), [True, True, False, True, False, True])


@pytest.mark.parametrize("count", [2, 7])
def test_all_alike_are_sure(count):
    found = estimate_groups(np.full(count, 4.0))
    assert (found.value, found.low, found.high) == (4.0, 4.0, 4.0)
    assert estimate_middle(np.full(count, 4.0)).value == 4.0


def test_the_probability_of_improvement_is_mann_and_whitneys():
    draw = np.random.default_rng(6)
    one, other = draw.integers(0, 9, 7).astype(float), draw.integers(0, 9, 5).astype(float)
    expected = stats.mannwhitneyu(one, other).statistic / 35
    assert probability_of_improvement(one, other).mean() == pytest.approx(expected, rel=1e-12)
