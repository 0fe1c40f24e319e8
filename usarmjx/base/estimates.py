"""Uncertainty of results: confidence intervals, interquartile means, performance profiles, Pareto fronts.

After Agarwal et al., "Deep reinforcement learning at the edge of the statistical precipice" (NeurIPS 2021):
methods are compared by the interquartile mean, by the probability of improvement and by performance profiles.
Intervals are those of crossed factors, see `crossed`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from usarmjx.base.crossed import (
    CONFIDENCE,
    Factor,
    crossed_mean,
    crossed_variance,
    even,
    p_value,
    quantile_of_t,
    wilson_interval,
)

TRIM = 0.25
"""Fraction of the lowest and of the highest scores that the interquartile mean leaves out."""

__all__ = [
    "CONFIDENCE",
    "Estimate",
    "crossed_estimate",
    "estimate_groups",
    "estimate_middle",
    "interquartile_effects",
    "interquartile_mean",
    "pareto_front",
    "performance_profile",
    "probability_of_improvement",
]


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """Point estimate with its 95 % confidence interval.

    Attributes:
        value: Estimate; NaN if there are no values.
        low: Lower end of the interval.
        high: Upper end of the interval.
        count: Number of values.
        method: Method of the interval: `crossed`, or `Wilson` of a share.
        draws: Number of independent draws by factor: buildings, settings, runs.
        p: Two-sided probability of an estimate as far from 0 if the truth is 0.
    """

    value: float
    low: float
    high: float
    count: int
    method: str = "crossed"
    draws: Mapping[str, int] | None = None
    p: float = float("nan")

    def drawn(self, name: str) -> int:
        """Return the number of draws of a factor; 0: there is none of that name."""
        return 0 if self.draws is None else self.draws.get(name, 0)


def interquartile_mean(values: np.ndarray) -> np.ndarray:
    """Return the mean of the middle half (...,) of values (..., n)."""
    # The import takes a second, and training needs none of it.
    from scipy import stats  # pyright: ignore[reportMissingTypeStubs]

    functions: Any = stats
    return np.asarray(functions.trim_mean(values, TRIM, axis=-1))


def interquartile_effects(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what each value, and a change of it, does to the interquartile mean (n,), (n,).

    The first are the interquartile mean plus the influence of each value (of Winsorized values, Huber and
    Ronchetti, "Robust Statistics", 3.2): their mean is the interquartile mean, their spread is that of its
    draws.
    The second are the derivatives times n: 0 of values that are left out.

    Args:
        values: Values (n,).
    """
    order = np.argsort(values, kind="stable")
    cut = int(TRIM * len(values))
    kept = order[cut : len(values) - cut]
    inside = np.zeros(len(values))
    inside[kept] = len(values) / len(kept)
    clipped = np.clip(values, values[kept[0]], values[kept[-1]])
    influence = (clipped - clipped.mean()) * len(values) / len(kept)
    return values[kept].mean() + influence, inside


def crossed_estimate(
    table: np.ndarray,
    factors: Sequence[Factor],
    count: int,
    *,
    value: float | None = None,
    shares: bool = False,
    draws: Mapping[str, int] | None = None,
) -> Estimate:
    """Estimate the mean of a table with its 95 % confidence interval.

    Args:
        table: Values, one for each combination of draws (draws of the first factor, ... of the last).
        factors: Factors that were drawn.
        count: Number of values that the table was made from.
        value: Estimate, if it is not the mean of the table.
        shares: Whether the values are successes, 0 or 1, whose share gets Wilson's interval.
        draws: Numbers of draws to state; None: those of the factors.
    """
    variance, dof = crossed_variance(table, factors)
    middle = float(crossed_mean(table, factors)) if value is None else value
    stated = {factor.name: factor.count for factor in factors} if draws is None else draws
    if not np.isfinite(variance):
        return Estimate(value=middle, low=-np.inf, high=np.inf, count=count, draws=stated)
    if shares:
        fewest = min(factor.count for factor in factors)
        low, high = wilson_interval(np.array(middle), variance, dof, count, fewest)
        method = "Wilson"
    else:
        half = float(quantile_of_t(dof) * np.sqrt(variance))
        low, high, method = middle - half, middle + half, "crossed"
    chance = p_value(middle, float(variance), float(dof))
    return Estimate(
        value=middle, low=float(low), high=float(high), count=count, method=method, draws=stated, p=chance
    )


def estimate_groups(
    values: np.ndarray,
    groups: Sequence[object] | np.ndarray | None = None,
    strata: Sequence[object] | np.ndarray | None = None,
    *,
    shares: bool = False,
) -> Estimate:
    """Estimate the mean of values with its 95 % confidence interval, those of a group drawn together.

    Args:
        values: Values (n,).
        groups: Group of each value, as its building (n,); None: each value is drawn by itself.
        strata: Stratum of each value, as the level of its building (n,); None: there is one. Strata with
            fewer than two groups each, on average, count as one.
        shares: Whether values that are all 0 or 1 are successes, whose share gets Wilson's interval.
    """
    values = np.asarray(values, float)
    if not len(values):
        return Estimate(value=np.nan, low=np.nan, high=np.nan, count=0)
    index = np.arange(len(values)) if groups is None else _numbered(groups)
    level = np.zeros(len(values), int) if strata is None else _numbered(strata)
    there = int(index.max()) + 1
    if there < 2 * (level.max() + 1):
        level = np.zeros(len(values), int)
    middle = float(values.mean())
    rest = values - (np.bincount(level, values) / np.bincount(level))[level]
    sums = np.bincount(index, rest)
    return crossed_estimate(
        middle + sums * there / len(values),
        [even("buildings", there, int(level.max()) + 1)],
        len(values),
        value=middle,
        shares=shares and bool(np.isin(values, (0.0, 1.0)).all()),
    )


def _numbered(labels: Sequence[object] | np.ndarray) -> np.ndarray:
    """Return the number of each label (n,)."""
    return np.unique(np.asarray(labels), return_inverse=True)[1]


def estimate_middle(values: np.ndarray) -> Estimate:
    """Estimate the interquartile mean of independent values (n,) with its 95 % confidence interval."""
    return estimate_groups(values if len(values) < 2 else interquartile_effects(values)[0])


def probability_of_improvement(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return how often a draw of one method is better than one of another (..., draws, draws).

    Its mean is the probability of improvement of Agarwal et al.: Mann and Whitney's U by the number of pairs.

    Args:
        first: Scores of the one (..., draws).
        second: Scores of the other (..., draws).
    """
    one, other = np.asarray(first)[..., :, None], np.asarray(second)[..., None, :]
    return (one > other) + 0.5 * (one == other)


def performance_profile(scores: np.ndarray, thresholds: np.ndarray) -> np.ndarray:
    """Return the share of scores (n,) above each threshold (thresholds,)."""
    return (np.asarray(scores)[None] > np.asarray(thresholds)[:, None]).mean(-1)


def pareto_front(points: np.ndarray) -> np.ndarray:
    """Return which points (n, criteria) no other dominates: as good in all criteria, better in one (n,)."""
    points = np.asarray(points, float)
    at_least = (points[None] >= points[:, None]).all(-1)
    better = (points[None] > points[:, None]).any(-1)
    return np.logical_not(np.any(at_least & better, axis=-1))
