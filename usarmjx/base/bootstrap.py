"""Two-way stratified bootstrap of results over training runs and buildings.

Definitions are those of Agarwal et al., "Deep reinforcement learning at the edge of the statistical
precipice" (NeurIPS 2021): interquartile mean over runs and settings, probability of improvement, performance
profiles, percentile intervals of a bootstrap stratified by task. The paper draws runs only; here buildings
are drawn too, the same ones for all runs and settings of a task (Owen, "The pigeonhole bootstrap", Annals of
Applied Statistics 1, 2007). With one building per table the bootstrap is the paper's. Where runs and
buildings have no effects of their own, the intervals are wider than those of `crossed`, which counts noise
once.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usarmjx.base.estimates import Estimate, interquartile_mean, probability_of_improvement

Table = np.ndarray
"""Scores of a task (runs, settings, buildings); NaN: the episode is missing."""
DRAWS = 2000
"""Resamples of an interval."""
METHOD = "bootstrap"
TAIL = 2.5
"""Percentage of resamples beyond each end of an interval."""


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
            shared = np.random.default_rng((self.seed, task))
            weights = shared.multinomial(buildings, np.full(buildings, 1.0 / buildings), self.draws)
            means = weighted_means(table, weights)
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
