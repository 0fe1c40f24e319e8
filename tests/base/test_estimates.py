"""Intervals, interquartile means, profiles and fronts, against closed forms."""

import math

import numpy as np
import pytest

from usarmjx.base.estimates import estimate, interquartile_mean, pareto_front, performance_profile


def test_shares_have_wilsons_interval():
    found = estimate([np.array([1.0] * 8 + [0.0] * 2)], shares=True)
    z, n, p = 1.959963984540054, 10, 0.8
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    assert (found.value, found.method) == (0.8, "Wilson")
    np.testing.assert_allclose([found.low, found.high], [middle - half, middle + half], rtol=1e-9)
    assert estimate([np.array([1.0, 0.0, 1.0])]).method == "bootstrap"


def test_the_bootstrap_agrees_with_the_normal_interval_of_many_values():
    values = np.random.default_rng(1).normal(50.0, 10.0, 400)
    found = estimate([values])
    half = 1.96 * values.std() / math.sqrt(400)
    # 2000 resamples: an end is off by some 5 % of half the interval.
    np.testing.assert_allclose(
        [found.low, found.high], [values.mean() - half, values.mean() + half], atol=0.2
    )
    assert estimate([values]) == found


def test_cells_are_drawn_from_each_on_its_own():
    apart = [np.full(5, 10.0), np.full(5, 90.0)]
    found = estimate(apart)
    assert (found.value, found.low, found.high, found.count) == (50.0, 50.0, 50.0, 10)
    together = estimate([np.concatenate(apart)])
    assert together.low < 40.0 < 60.0 < together.high


def test_little_is_known_of_little():
    assert math.isnan(estimate([]).value)
    one = estimate([np.array([3.0])])
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
    found = estimate([np.full(count, 4.0)], interquartile_mean)
    assert (found.value, found.low, found.high) == (4.0, 4.0, 4.0)
