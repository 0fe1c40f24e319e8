"""Uncertainty of results: confidence intervals, interquartile means, performance profiles, Pareto fronts.

After Agarwal et al., "Deep reinforcement learning at the edge of the statistical precipice" (NeurIPS 2021):
runs are compared by the interquartile mean, by performance profiles, and with intervals of a stratified
bootstrap, which resamples episodes within each cell.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

CONFIDENCE = 0.95
"""Confidence level of all intervals."""
RESAMPLES = 2000
"""Bootstrap resamples."""
TRIM = 0.25
"""Fraction of the lowest and of the highest scores that the interquartile mean leaves out."""

Strata = Sequence[np.ndarray]
"""Values (n,) of each cell."""


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """Point estimate with its 95 % confidence interval.

    Attributes:
        value: Estimate; NaN if there are no values.
        low: Lower end of the interval.
        high: Upper end of the interval.
        count: Number of values.
        method: Method of the interval: `bootstrap` or `Wilson`.
    """

    value: float
    low: float
    high: float
    count: int
    method: str = "bootstrap"


def interquartile_mean(values: np.ndarray) -> np.ndarray:
    """Return the mean of the middle half (...,) of values (..., n)."""
    from scipy import stats  # the import takes a second, and training needs none of it

    return np.asarray(stats.trim_mean(values, TRIM, axis=-1))


def mean(values: np.ndarray) -> np.ndarray:
    """Return the mean (...,) of values (..., n)."""
    return np.asarray(values.mean(-1))


def estimate(
    strata: Strata,
    of: Callable[[np.ndarray], np.ndarray] = mean,
    *,
    shares: bool = False,
    seed: int = 0,
) -> Estimate:
    """Estimate a statistic of all values with its 95 % confidence interval.

    Args:
        strata: Values of each cell.
        of: Statistic of values (..., n): `mean` or `interquartile_mean`.
        shares: Whether values that are all 0 or 1 are successes, whose proportion gets Wilson's interval.
        seed: Seed of the bootstrap.
    """
    rows = [np.asarray(one, float) for one in strata if len(one)]
    if not rows:
        return Estimate(value=np.nan, low=np.nan, high=np.nan, count=0)
    everything = np.concatenate(rows)
    value, count = float(of(everything)), len(everything)
    if shares and np.isin(everything, (0.0, 1.0)).all():
        from scipy import stats

        found = stats.binomtest(int(everything.sum()), count).proportion_ci(CONFIDENCE, method="wilson")
        low, high = float(found.low), float(found.high)
        return Estimate(value=value, low=low, high=high, count=count, method="Wilson")
    # The bootstrap of a single value has no spread; an honest interval is unbounded.
    if count == 1:
        return Estimate(value=value, low=-np.inf, high=np.inf, count=1)
    draw = np.random.default_rng(seed)
    drawn = np.concatenate([row[draw.integers(len(row), size=(RESAMPLES, len(row)))] for row in rows], -1)
    low, high = np.quantile(of(drawn), [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return Estimate(value=value, low=float(low), high=float(high), count=count)


def performance_profile(scores: np.ndarray, thresholds: np.ndarray) -> np.ndarray:
    """Return the share of scores (n,) above each threshold (thresholds,)."""
    return (np.asarray(scores)[None] > np.asarray(thresholds)[:, None]).mean(-1)


def pareto_front(points: np.ndarray) -> np.ndarray:
    """Return which points (n, criteria) no other dominates: as good in all criteria, better in one (n,)."""
    points = np.asarray(points, float)
    at_least = (points[None] >= points[:, None]).all(-1)
    better = (points[None] > points[:, None]).any(-1)
    return np.logical_not(np.any(at_least & better, axis=-1))
