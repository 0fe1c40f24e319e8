"""Uncertainty of results: intervals of means, performance profiles, Pareto fronts, bootstrap.

Definitions are those of Agarwal et al., "Deep reinforcement learning at the edge of the statistical
precipice" (NeurIPS 2021): interquartile mean over runs and settings, probability of improvement, performance
profiles, percentile intervals of a bootstrap stratified by task. The paper draws runs only; the bootstrap
draws buildings too, the same ones for all runs and settings of a task (Owen, "The pigeonhole bootstrap",
Annals of Applied Statistics 1, 2007). With one building per table it is the paper's. If runs and
buildings have no effects of their own, its intervals are wider than those of crossed factors, which count
noise once. All other intervals are those of crossed factors.

Scores of a sweep are no independent values: all settings play the same buildings, and a policy of one
training run plays all of both. The factors are crossed, so the variance of a mean is a sum over sets of
factors (two-way analysis of variance with random effects, and its extension to more factors):

    V = sum over nonempty sets F of factors of (-1)^(|F| + 1) V_F

V_F is a quadratic form: each factor in F contributes the squares of its residuals, each other factor its
mean. Without effects of a factor V_F falls to the noise that the alternating sum removes again, so an
interval is right with and without effects. Resampling rows and columns of a table (the "pigeonhole
bootstrap") counts the noise three times where there are no effects: McCullagh, "Resampling and exchangeable
arrays" (Bernoulli 6, 2000); Owen, "The pigeonhole bootstrap" (Annals of Applied Statistics 1, 2007).
Degrees of freedom are Satterthwaite's. A sampled setting may be adjusted for by least squares: the residuals
of a Latin hypercube are those of its main effects (Stein, Technometrics 29, 1987).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

CONFIDENCE = 0.95
"""Confidence level of all intervals."""
LEAST_EFFECT = 0.2
"""An effect counts if it adds more than this share of the noise to its mean square. The choice weighs two
errors. At 0, every second effect of mere noise counts: simulated intervals of differences of five runs hold
the truth in 98.2 % without effects. At 0.3, effects are missed: those of three runs that differ by half the
noise hold it in 91.9 %."""
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
Table = np.ndarray
"""Scores of a task (runs, settings, buildings); NaN: the episode is missing."""
DRAWS = 2000
"""Resamples of an interval."""
METHOD = "bootstrap"
TAIL = 2.5
"""Percentage of resamples beyond each end of an interval."""


@dataclass(frozen=True, eq=False)
class Factor:
    """Random draws that are crossed with those of other factors.

    Attributes:
        name: Name of what was drawn.
        weights: Weights of the draws in the estimate (draws,).
        basis: Orthonormal columns that were fitted, the constant one among them (draws, columns).
        scale: Weight of each squared residual in the variance (draws,).
        dof: Degrees of freedom of that variance.
    """

    name: str
    weights: np.ndarray
    basis: np.ndarray
    scale: np.ndarray
    dof: float

    @property
    def count(self) -> int:
        """Number of draws."""
        return len(self.weights)


def even(name: str, count: int, groups: int = 1) -> Factor:
    """Return a factor whose draws count alike.

    Args:
        name: Name of what was drawn.
        count: Number of draws.
        groups: Number of strata that they were drawn from; residuals are within strata.
    """
    # One mean is fitted for each stratum.
    dof = count - groups
    # Variance of a mean: sum of the squared residuals by n (n - 1).
    scale = np.full(count, 1.0 / (count * dof) if dof > 0 else np.inf)
    return Factor(name, np.full(count, 1.0 / count), np.full((count, 1), count**-0.5), scale, max(dof, 0))


def adjusted(name: str, terms: np.ndarray, contrast: np.ndarray) -> Factor:
    """Return a factor whose estimate is a linear combination of coefficients of a least-squares fit.

    The variance is robust to unequal variances of the draws (HC2).

    Args:
        name: Name of what was drawn.
        terms: Design matrix of the fit, of full rank (draws, coefficients).
        contrast: Weights of the coefficients in the estimate (coefficients,).
    """
    basis, upper = np.linalg.qr(terms)
    weights = basis @ np.linalg.solve(upper.T, contrast)
    # Rounding may exceed 1, where a draw fits itself; its variance is infinite then, and not negative.
    leverage = np.minimum((basis**2).sum(-1), 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = np.where(weights == 0.0, 0.0, weights**2 / (1.0 - leverage))
    # Draws that count alike in the estimate have as many degrees of freedom as there are of them.
    alike = (weights**2).sum() ** 2 / (weights**4).sum()
    free = 1.0 - terms.shape[1] / terms.shape[0]
    return Factor(name, weights, basis, scale, max(alike * free, 0.0))


def crossed_mean(table: np.ndarray, factors: Sequence[Factor]) -> np.ndarray:
    """Return the estimate (...,) of tables (..., draws of the first factor, ... of the last)."""
    found = np.asarray(table, float)
    for factor in reversed(factors):
        found = found @ factor.weights
    return found


def crossed_variance(table: np.ndarray, factors: Sequence[Factor]) -> tuple[np.ndarray, np.ndarray]:
    """Return variance and degrees of freedom of the estimate.

    Args:
        table: Values, one for each combination of draws (..., draws of the first factor, ... of the last).
        factors: The factors.

    Returns:
        Both of the shape of the leading dimensions; the variance is infinite if a factor has one draw only.
    """
    if any(not np.isfinite(factor.scale).all() for factor in factors):
        shape = np.shape(table)[: np.ndim(table) - len(factors)]
        return np.full(shape, np.inf), np.ones(shape)
    parts = dict(_parts(np.asarray(table, float), factors))
    signs = {chosen: np.zeros(np.shape(part)) for chosen, part in parts.items()}
    for effect in parts:
        # Effect of a set of factors: its part less what larger sets put into it.
        within = {
            larger: (-1) ** (sum(larger) - sum(effect)) for larger in parts if _contains(larger, effect)
        }
        excess = sum(sign * parts[larger] for larger, sign in within.items())
        there = excess > LEAST_EFFECT * np.maximum(parts[effect] - excess, 0.0)
        for larger, sign in within.items():
            signs[larger] = signs[larger] + np.where(there, sign, 0.0)
    variance, spread = np.zeros(()), np.zeros(())
    for chosen, part in parts.items():
        dof = np.prod([factor.dof for factor, own in zip(factors, chosen, strict=True) if own])
        variance, spread = variance + signs[chosen] * part, spread + (signs[chosen] * part) ** 2 / dof
    with np.errstate(divide="ignore", invalid="ignore"):
        dof = np.where(spread > 0.0, variance**2 / spread, np.inf)
    # A small sum of parts is known from few draws, but not from less than one.
    return np.maximum(variance, 0.0), np.maximum(dof, 1.0)


def _contains(larger: tuple[bool, ...], smaller: tuple[bool, ...]) -> bool:
    return all(own or not other for own, other in zip(larger, smaller, strict=True))


def _parts(table: np.ndarray, factors: Sequence[Factor]) -> Iterator[tuple[tuple[bool, ...], np.ndarray]]:
    """Yield sets of factors and their part of the variance (...,)."""
    for chosen in product((False, True), repeat=len(factors)):
        if not any(chosen):
            continue
        found, kept = table, 0
        for number, (factor, own) in enumerate(zip(factors, chosen, strict=True)):
            # Axes of factors that are done and kept are the last ones.
            found = np.moveaxis(found, -(len(factors) - number) - kept, -1)
            if own:
                found = found - found.mean(-1, keepdims=True)  # so that equal values have no residuals at all
                found, kept = found - (found @ factor.basis) @ factor.basis.T, kept + 1
            else:
                found = found @ factor.weights
        found = found**2
        for factor in reversed([one for one, own in zip(factors, chosen, strict=True) if own]):
            found = found @ factor.scale
        yield chosen, found


def quantile_of_t(dof: np.ndarray | float) -> np.ndarray:
    """Return how many standard errors an interval reaches on each side."""
    from scipy import special  # pyright: ignore[reportMissingTypeStubs]

    functions: Any = special
    dof = np.asarray(dof, float)
    normal = functions.ndtri((1 + CONFIDENCE) / 2)
    # stdtrit returns NaN for infinite degrees of freedom; the normal quantile takes its place.
    finite = np.where(np.isfinite(dof), dof, 1.0)
    quantile = np.asarray(functions.stdtrit(finite, (1 + CONFIDENCE) / 2), float)
    return np.where(np.isfinite(dof), quantile, np.float64(normal))


def crossed_interval(
    table: np.ndarray, factors: Sequence[Factor]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return estimate, lower and upper end of its interval (...,); see `crossed_variance`."""
    value = crossed_mean(table, factors)
    variance, dof = crossed_variance(table, factors)
    half = quantile_of_t(dof) * np.sqrt(variance)
    return value, value - half, value + half


def wilson_interval(
    share: np.ndarray, variance: np.ndarray, dof: np.ndarray, count: int, draws: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return Wilson's interval of a share, for as many independent values as its variance stands for.

    After Korn and Graubard, "Confidence intervals for proportions with small expected number of positive
    counts estimated from survey data" (Survey Methodology 24, 1998).

    Args:
        share: Share of successes (...,).
        variance: Its variance (...,).
        dof: Degrees of freedom of the variance (...,).
        count: Number of values.
        draws: Fewest draws of a factor: they count as one value each where all values are alike.
    """
    # Variance of the share if all values were independent.
    alone = share * (1.0 - share) / max(count - 1, 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        effective = np.where(variance > 0.0, count * alone / variance, np.where(alone > 0.0, count, draws))
    shrink = quantile_of_t(float(max(count - 1, 1))) / quantile_of_t(dof)
    effective = np.where(alone > 0.0, effective * shrink**2, effective)
    # Correlated values cannot stand for more than there are.
    effective = np.clip(effective, 1.0, count)
    # The normal quantile: the degrees of freedom are in the effective number of values already.
    z = quantile_of_t(np.inf)
    middle = (share + z**2 / (2 * effective)) / (1 + z**2 / effective)
    half = z / (1 + z**2 / effective) * np.sqrt(share * (1 - share) / effective + z**2 / (4 * effective**2))
    return middle - half, middle + half


def p_value(value: float, variance: float, dof: float) -> float:
    """Return the two-sided probability of an estimate as far from 0, if the truth is 0."""
    from scipy import special  # pyright: ignore[reportMissingTypeStubs]

    functions: Any = special
    # Without spread only an estimate of 0 agrees with a truth of 0; of an unknown spread nothing is known.
    if variance <= 0.0 or not np.isfinite(variance):
        return float(variance <= 0.0 and value == 0.0) if np.isfinite(variance) else 1.0
    # The lower tail keeps its digits: 1 less the upper one would round to 0 for small probabilities.
    statistic = -abs(value) / np.sqrt(variance)
    tail = functions.ndtr(statistic) if not np.isfinite(dof) else functions.stdtr(dof, statistic)
    return float(2.0 * tail)


def holm(values: Sequence[float]) -> list[float]:
    """Return p-values corrected for all comparisons (Holm, Scandinavian Journal of Statistics 6, 1979)."""
    order = np.argsort(values, kind="stable")
    # The smallest is corrected for all comparisons, the next for one fewer.
    raised = np.array(values, float)[order] * (len(values) - np.arange(len(values)))
    found = np.empty(len(values))
    # A larger p-value must not become the smaller one by its smaller factor.
    found[order] = np.minimum(np.maximum.accumulate(raised), 1.0)
    return found.tolist()


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
    # Values that are left out still pull at the mean up to the last one that is kept.
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
    # Strata of single groups have no residuals: their variance would seem to be 0.
    if there < 2 * (level.max() + 1):
        level = np.zeros(len(values), int)
    middle = float(values.mean())
    # Within strata: levels are the same in each evaluation, so their differences are no chance.
    rest = values - (np.bincount(level, values) / np.bincount(level))[level]
    sums = np.bincount(index, rest)
    return crossed_estimate(
        # So scaled that the plain mean over groups of any size is that of the values.
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
    # Ties count half, as in Mann and Whitney's U.
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


@dataclass(frozen=True)
class Resampler:
    """Resamples of tables, the same ones at each call.

    Attributes:
        draws: Number of resamples.
        seed: Seed of the draws.
    """

    draws: int = DRAWS
    seed: int = 0

    def entries(self, tables: Sequence[Table], stream: int = 0) -> list[np.ndarray]:
        """Return resampled scores of runs, each a mean over buildings, per task (draws, runs, settings).

        Args:
            tables: Scores of each task.
            stream: Number of the method: runs of another stream are drawn independently, buildings are not.
        """
        found: list[np.ndarray] = []
        for task, table in enumerate(tables):
            runs, _, buildings = table.shape
            # Buildings are shared by all methods, so that differences of methods do not contain their spread.
            shared = np.random.default_rng((self.seed, task))
            weights = shared.multinomial(buildings, np.full(buildings, 1.0 / buildings), self.draws)
            means = weighted_means(table, weights)
            # From 1: NumPy ignores a 0 at the end of a seed, so stream 0 would draw as the buildings do.
            own = np.random.default_rng((self.seed, task, 1 + stream))
            picked = own.integers(0, runs, (self.draws, runs, 1))
            found.append(np.take_along_axis(means, picked, 1))
        return found


def weighted_means(table: Table, weights: np.ndarray) -> np.ndarray:
    """Return means over buildings (draws, runs, settings), by how often each is drawn (draws, buildings)."""
    there = np.isfinite(table)
    sums = np.einsum("db,rsb->drs", weights, np.where(there, table, 0.0))
    counts = np.einsum("db,rsb->drs", weights, there)
    with np.errstate(invalid="ignore"):
        means = np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
    plain = np.nanmean(table, -1)  # of a run whose drawn buildings are all missing
    return np.where(np.isnan(means), plain, means)


def run_means(tables: Sequence[Table]) -> list[np.ndarray]:
    """Return the score of each run, a mean over buildings, per task (runs, settings)."""
    return [np.nanmean(table, -1) for table in tables]


def interquartile_interval(tables: Sequence[Table], how: Resampler | None = None) -> Estimate:
    """Return the interquartile mean over runs and settings of all tasks."""
    value = interquartile_mean(_flat(run_means(tables)))
    rows = (how or Resampler()).entries(tables)
    draws = interquartile_mean(np.concatenate([one.reshape(len(one), -1) for one in rows], -1))
    return _estimate(float(value), draws, tables)


def mean_interval(tables: Sequence[Table], how: Resampler | None = None) -> Estimate:
    """Return the mean over runs, settings and tasks, each task counting alike."""
    value = float(np.mean([one.mean() for one in run_means(tables)]))
    rows = (how or Resampler()).entries(tables)
    return _estimate(value, np.mean([one.mean((1, 2)) for one in rows], 0), tables)


def improvement_interval(
    first: Sequence[Table], second: Sequence[Table], how: Resampler | None = None
) -> Estimate:
    """Return the probability that a run of one method beats a run of another, on average over settings.

    Args:
        first: Scores of the one, of each task (runs, settings, buildings).
        second: Scores of the other, of the same tasks, settings and buildings.
        how: Resamples.
    """
    how = how or Resampler()

    def chance(one: Sequence[np.ndarray], other: Sequence[np.ndarray]) -> np.ndarray:
        by_task = [
            probability_of_improvement(np.swapaxes(x, -1, -2), np.swapaxes(y, -1, -2)).mean((-1, -2))
            for x, y in zip(one, other, strict=True)
        ]
        return np.concatenate(by_task, -1).mean(-1)

    value = float(chance(run_means(first), run_means(second)))
    return _estimate(value, chance(how.entries(first), how.entries(second, 1)), first)


def profile_intervals(
    tables: Sequence[Table], thresholds: Sequence[float], how: Resampler | None = None
) -> list[Estimate]:
    """Return the share of runs and settings whose score is above each threshold: a performance profile."""
    values = _flat(run_means(tables))
    rows = np.concatenate([one.reshape(len(one), -1) for one in (how or Resampler()).entries(tables)], -1)
    return [
        _estimate(float((values > threshold).mean()), (rows > threshold).mean(-1), tables)
        for threshold in thresholds
    ]


def _flat(rows: Sequence[np.ndarray]) -> np.ndarray:
    return np.concatenate([one.ravel() for one in rows])


def _estimate(value: float, draws: np.ndarray, tables: Sequence[Table]) -> Estimate:
    """Return an estimate with the percentile interval of its resamples."""
    count = sum(one.shape[0] * one.shape[1] for one in tables)
    low, high = np.percentile(draws, [TAIL, 100.0 - TAIL])
    known = {
        "runs": min(one.shape[0] for one in tables),
        "buildings": sum(one.shape[2] for one in tables),
    }
    return Estimate(value=value, low=float(low), high=float(high), count=count, method=METHOD, draws=known)
