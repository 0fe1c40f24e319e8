"""Episodes of a sweep as tables over what was drawn: sampled settings, training runs, buildings.

An interval says what would change if others were drawn. Sampled settings, training runs and buildings are
draws; settings of `list` and `product` are not, they stand for themselves. Buildings are told apart by the
seed that they were generated from, as those of one seed are alike at all levels; where all episodes have one
arena, by seed and number of the episode.
"""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from usarmjx.base.estimates import (
    Estimate,
    Factor,
    adjusted,
    crossed_estimate,
    crossed_mean,
    even,
    interquartile_effects,
    probability_of_improvement,
)
from usarmjx.base.settings.files import is_tuple
from usarmjx.sweeps.spec import as_text
from usarmjx.sweeps.store import CellRecord
from usarmjx.train.envs.membership import seed_of

SETTINGS, RUNS, BUILDINGS = "settings", "runs", "buildings"
"""Names of factors."""
REPLICATES = ("seed", "arena.seed", "episodes")
"""Settings of which another value draws anew and means nothing else."""
DRIVERS = ("policy", "method")
"""Settings that say what drives."""
MOST_DEGREE, POINTS_PER_TERM = 2, 4
"""Highest polynomial of a sampled setting that is adjusted for, and how many points each term needs."""

Sampled = Mapping[str, Sequence[float]]
"""Lowest and highest number of each sampled setting."""


def policy_of(record: CellRecord) -> str:
    """Return the method of a cell, or its policy as text."""
    return as_text(record.settings.get("method") or record.settings["policy"])


@dataclass(frozen=True, eq=False, kw_only=True)
class Episodes:
    """Scores of episodes that went well, and what each was drawn from.

    Attributes:
        scores: Scores (episodes,).
        fixed: Settings of `list` and `product` of each, and its stratum of buildings (episodes,).
        points: Sampled settings of each (episodes,).
        runs: Policy of each (episodes,).
        buildings: Building of each (episodes,).
        keys: Pairing key of episodes (episodes,).
        sampled: Ranges of the sampled settings.
    """

    scores: np.ndarray
    fixed: list[Hashable]
    points: list[tuple[Any, ...]]
    runs: list[Hashable]
    buildings: list[Hashable]
    keys: list[Hashable]
    sampled: Sampled

    def __len__(self) -> int:
        """Return the number of episodes."""
        return len(self.scores)

    @property
    def settings(self) -> int:
        """Number of different settings."""
        cells = {fixed[0] for fixed in self.fixed if is_tuple(fixed)}
        return len(cells) * max(len(set(self.points)), 1)


def episodes_of(records: Sequence[CellRecord], sampled: Sampled) -> Episodes:
    """Return the episodes of cells that went well.

    Args:
        records: The cells.
        sampled: Ranges of the sampled settings.
    """
    scores: list[float] = []
    rows: list[tuple[Any, ...]] = []
    apart = (*REPLICATES, *DRIVERS, *sampled)
    for record in records:
        settings = record.settings
        # Sorted, so that the order of a file's keys makes no difference.
        fixed = repr(sorted((key, value) for key, value in settings.items() if key not in apart))
        point = tuple(settings.get(name) for name in sampled)
        run, seed = as_text(settings["policy"]), (settings.get("seed"), settings.get("arena.seed"))
        for number in record.good:
            stratum = number % record.strata if record.strata > 1 else 0
            building = building_of(record, number)
            # Without policy and run: episodes of two of them pair by all else.
            key = (fixed, point, seed, number)
            rows.append(((fixed, stratum), point, run, building, key))
            scores.append(record.scores[number])
    columns: list[list[Any]] = [list(column) for column in zip(*rows, strict=True)] or [[] for _ in range(5)]
    names = ("fixed", "points", "runs", "buildings", "keys")
    return Episodes(scores=np.array(scores, float), sampled=sampled, **dict(zip(names, columns, strict=True)))


def building_of(record: CellRecord, number: int) -> Hashable:
    """Return the building of an episode: its seed or its label; the episode itself where all have one."""
    if not record.buildings:
        return "episode", record.settings.get("seed"), number
    label = record.buildings[number]
    seed = seed_of(label)
    return label if seed is None else seed


def paired(first: Episodes, second: Episodes) -> tuple[Episodes, np.ndarray]:
    """Return scores of one less those of another in the episodes that both have, for each pair of runs.

    Returns:
        The differences, and the scores of the other (episodes,).
    """
    there: dict[Hashable, list[int]] = {}
    for place, key in enumerate(second.keys):
        there.setdefault(key, []).append(place)
    pairs = [(one, other) for one, key in enumerate(first.keys) for other in there.get(key, ())]
    theirs = np.array([second.scores[other] for _, other in pairs], float)
    found = chosen(first, [one for one, _ in pairs])
    runs: list[Hashable] = [(first.runs[one], second.runs[other]) for one, other in pairs]
    return replace(found, scores=found.scores - theirs, runs=runs), theirs


def chosen(episodes: Episodes, places: Sequence[int]) -> Episodes:
    """Return some episodes, by their places."""
    names = ("fixed", "points", "runs", "buildings", "keys")
    columns = {name: [getattr(episodes, name)[place] for place in places] for name in names}
    return replace(episodes, scores=episodes.scores[np.asarray(places, int)], **columns)


def joined(parts: Sequence[Episodes], *, alike: bool) -> Episodes:
    """Return the episodes of several tasks.

    Args:
        parts: Those of each task.
        alike: Give scores whose mean is the mean of the tasks' means, however many episodes each has: that
            mean, and weighted deviations from the task's mean.
    """
    total, middle = sum(map(len, parts)), float(np.mean([part.scores.mean() for part in parts]))
    scores = [part.scores for part in parts]
    if alike:
        weights = [total / (len(parts) * len(part)) for part in parts]
        scores = [middle + weight * (own - own.mean()) for own, weight in zip(scores, weights, strict=True)]
    names = ("fixed", "points", "runs", "buildings", "keys")
    columns = {name: [one for part in parts for one in getattr(part, name)] for name in names}
    return replace(parts[0], scores=np.concatenate(scores), **columns)


@dataclass(frozen=True, eq=False)
class Layout:
    """Episodes in a table over their draws.

    Attributes:
        episodes: The episodes.
    """

    episodes: Episodes

    @cached_property
    def cells(self) -> np.ndarray:
        """Number of the fixed settings and stratum of each episode (episodes,)."""
        return _numbers(self.episodes.fixed)

    @cached_property
    def groups(self) -> int:
        """Number of sets of buildings that have no fixed settings in common."""
        parent: dict[Hashable, Hashable] = {}

        def root(one: Hashable) -> Hashable:
            while parent.setdefault(one, one) != one:
                one = parent[one]
            return one

        # Union-find: a chain of settings and buildings in common makes one set.
        for cell, building in set(zip(self.cells.tolist(), self.buildings.tolist(), strict=True)):
            parent[root(("cell", cell))] = root(("building", building))
        return len({root(one) for one in list(parent)})

    @cached_property
    def buildings(self) -> np.ndarray:
        """Number of the building of each episode (episodes,); of the episode where there is one building."""
        numbers = _numbers(self.episodes.buildings)
        if len(numbers) and not numbers.any():
            return _numbers([key[2:] if is_tuple(key) else key for key in self.episodes.keys])
        return numbers

    @cached_property
    def indices(self) -> dict[str, np.ndarray]:
        """Number of each episode's draw, by factor: those of more than one, and buildings last."""
        found: dict[str, np.ndarray] = {}
        if len(set(self.episodes.points)) > 1:
            found[SETTINGS] = _numbers(self.episodes.points)
        sides = list(zip(*self.episodes.runs, strict=True)) if self._paired else [self.episodes.runs]
        for side, runs in enumerate(sides):
            if len(set(runs)) > 1:
                found[f"{RUNS}{side or ''}"] = _numbers(runs)
        return {**found, BUILDINGS: self.buildings}

    @property
    def _paired(self) -> bool:
        return bool(self.episodes.runs) and isinstance(self.episodes.runs[0], tuple)

    @cached_property
    def draws(self) -> dict[str, int]:
        """Number of draws to state."""
        runs = self.episodes.runs
        pairs = runs if self._paired else [(run,) for run in runs]
        return {
            BUILDINGS: len(set(self.episodes.buildings)),
            SETTINGS: self.episodes.settings,
            RUNS: min((len(set(side)) for side in zip(*pairs, strict=True)), default=0),
        }

    @cached_property
    def coordinates(self) -> np.ndarray:
        """Sampled settings of each point, from 0 to 1 (points, settings)."""
        # In the order of `_numbers`, whose numbers index these rows.
        points = sorted(set(self.episodes.points), key=repr)
        spans = list(self.episodes.sampled.values())
        # The least span keeps a range of a single number from a division by 0.
        return np.array(
            [
                [
                    (one - span[0]) / max(span[1] - span[0], 1e-300)
                    for one, span in zip(point, spans, strict=True)
                ]
                for point in points
            ],
            float,
        )

    def table(self, values: np.ndarray) -> np.ndarray:
        """Return values less the means of their fixed settings, over the draws, plus the mean of all.

        Args:
            values: Values, one for each episode (episodes,).
        """
        middle = values.mean()
        # Fixed settings are not drawn: the differences between them are no part of the interval.
        rest = values - (np.bincount(self.cells, values) / np.bincount(self.cells))[self.cells]
        index = tuple(self.indices.values())
        shape = tuple(int(one.max()) + 1 for one in index)
        sums, counts = np.zeros(shape), np.zeros(shape)
        # Not `sums[index] += rest`, which counts a place that occurs twice only once.
        np.add.at(sums, index, rest)
        np.add.at(counts, index, 1.0)
        if len(shape) == 1:
            return middle + sums * shape[0] / len(values)  # a building with fewer episodes counts less
        return middle + _filled(sums, counts)

    def buildings_factor(self) -> Factor:
        """Return the factor of buildings."""
        return even(BUILDINGS, int(self.buildings.max()) + 1, self.groups)

    def factors(self, points: Factor | None = None) -> list[Factor]:
        """Return the factors of the table; `points`: that of sampled settings, if they do not count alike."""
        found: list[Factor] = []
        for name, numbers in self.indices.items():
            if name == BUILDINGS:
                found.append(self.buildings_factor())
            elif name == SETTINGS and points is not None:
                found.append(points)
            else:
                found.append(even(name, int(numbers.max()) + 1))
        return found


def _filled(sums: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Return means of a table; those that it has not by the means along its other axes."""
    with np.errstate(invalid="ignore"):
        found = np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
    if not (counts == 0).any():
        return found
    added = np.zeros(found.shape)
    axes = range(found.ndim)
    for axis in axes:
        others = tuple(other for other in axes if other != axis)
        total = sums.sum(others, keepdims=True) / np.maximum(counts.sum(others, keepdims=True), 1)
        added = added + total
    return np.where(np.isnan(found), added, found)


def _numbers(labels: Sequence[Hashable]) -> np.ndarray:
    """Return the number of each label, by the order of their texts (labels,)."""
    order = {label: place for place, label in enumerate(sorted(set(labels), key=repr))}
    return np.array([order[label] for label in labels], int)


def main_effects(coordinates: np.ndarray, leave_out: int | None = None, room: int = 0) -> np.ndarray:
    """Return terms of sampled settings to adjust for, whose means over the ranges are 0 (points, terms).

    Args:
        coordinates: Settings from 0 to 1 (points, settings).
        leave_out: Setting that has terms of its own.
        room: Number of the other terms.
    """
    points, count = coordinates.shape
    chosen = [one for one in range(count) if one != leave_out]
    for degree in range(MOST_DEGREE, 0, -1):
        if (room + degree * len(chosen)) * POINTS_PER_TERM <= points:
            x = 2.0 * coordinates[:, chosen] - 1.0
            terms = [x * 3**0.5, (1.5 * x**2 - 0.5) * 5**0.5][:degree]  # Legendre's, of norm 1
            return np.concatenate(terms, -1)
    return np.zeros((points, 0))


def mean_score(episodes: Episodes, *, shares: bool = True) -> Estimate:
    """Return the mean score with its interval.

    Sampled settings are adjusted for their main effects where there are points enough.

    Args:
        episodes: The episodes.
        shares: Whether scores that are all 0 or 1 are successes.
    """
    if not len(episodes):
        return Estimate(value=np.nan, low=np.nan, high=np.nan, count=0)
    layout, scores = Layout(episodes), episodes.scores
    points, value = None, float(scores.mean())
    if SETTINGS in layout.indices and layout.coordinates.size:
        terms = main_effects(layout.coordinates, room=1)
        points = adjusted(
            SETTINGS, np.hstack([np.ones((len(terms), 1)), terms]), _unit(terms.shape[1] + 1, 0)
        )
        # The table's adjusted mean counts then, not that of the scores.
        value = None
    return crossed_estimate(
        layout.table(scores),
        layout.factors(points),
        len(scores),
        value=value,
        shares=shares and bool(np.isin(scores, (0.0, 1.0)).all()),
        draws=layout.draws,
    )


def range_scores(episodes: Episodes, axis: str, ranges: Sequence[int]) -> list[Estimate]:
    """Return mean scores over the ranges of a sampled setting, the other ones at their means.

    Args:
        episodes: All episodes of a policy.
        axis: The setting.
        ranges: Number of the range of each episode (episodes,).
    """
    layout, scores = Layout(episodes), episodes.scores
    points = layout.indices[SETTINGS]
    of_point = np.zeros(int(points.max()) + 1, int)
    # All episodes of a point lie in one range.
    of_point[points] = ranges
    own = np.eye(int(max(ranges)) + 1)[of_point]
    place = list(episodes.sampled).index(axis)
    terms = np.hstack([own, main_effects(layout.coordinates, place, own.shape[1])])
    table, found = layout.table(scores), list[Estimate]()
    shares = bool(np.isin(scores, (0.0, 1.0)).all())
    for number in range(own.shape[1]):
        factors = layout.factors(adjusted(SETTINGS, terms, _unit(terms.shape[1], number)))
        mine = np.asarray(ranges) == number
        draws = {**layout.draws, SETTINGS: int((of_point == number).sum())}
        # Adjusted means of shares may leave 0 to 1.
        value = float(np.clip(crossed_mean(table, factors), 0.0, 1.0)) if shares else None
        found.append(
            crossed_estimate(table, factors, int(mine.sum()), value=value, shares=shares, draws=draws)
        )
    return found


def _unit(size: int, place: int) -> np.ndarray:
    return np.eye(size)[place]


def entries_of(episodes: Episodes) -> np.ndarray:
    """Return the number of each episode's pair of run and settings (episodes,)."""
    rows = zip(episodes.fixed, episodes.points, episodes.runs, strict=True)
    # Without the stratum: an entry has buildings of all levels.
    return _numbers([(fixed[0] if is_tuple(fixed) else fixed, *more) for fixed, *more in rows])


def middle_score(episodes: Episodes) -> Estimate:
    """Return the interquartile mean over runs and settings, each the mean over its buildings.

    That is rliable's, with settings as its tasks.
    """
    if not len(episodes):
        return Estimate(value=np.nan, low=np.nan, high=np.nan, count=0)
    entries, scores = entries_of(episodes), episodes.scores
    means = np.bincount(entries, scores) / np.bincount(entries)
    spread, inside = interquartile_effects(means)
    # Linearised: the plain mean of these varies as the interquartile mean does.
    values = spread[entries] + inside[entries] * (scores - means[entries])
    layout = Layout(replace(episodes, scores=values))
    value = float(spread.mean())
    found = crossed_estimate(
        layout.table(values), layout.factors(), len(means), value=value, draws=layout.draws
    )
    return as_share(found) if np.isin(scores, (0.0, 1.0)).all() else found


def as_share(found: Estimate) -> Estimate:
    """Return the estimate of a share, with an interval that ends at 0 and 1."""
    if not np.isfinite(found.low):
        return found
    return replace(found, low=min(max(found.low, 0.0), 1.0), high=min(max(found.high, 0.0), 1.0))


def improvement(first: Episodes, second: Episodes) -> Estimate:
    """Return the probability that a run of one method has a higher mean score than one of another.

    It is rliable's, with settings as its tasks. The interval is over runs: none if a method has one.
    """
    means = [_means_of(episodes) for episodes in (first, second)]
    here, there = ({place for _, place in own} for own in means)
    shared = sorted(here & there, key=repr)
    runs = [list(dict.fromkeys(run for run, _ in own)) for own in means]
    tables = [
        np.array([[own.get((run, place), np.nan) for run in names] for place in shared])
        for own, names in zip(means, runs, strict=True)
    ]
    # NaN stands for a setting that a run lacks.
    better = np.nanmean(probability_of_improvement(*tables), 0)
    sides = [even(f"{RUNS}{side or ''}", size) for side, size in enumerate(better.shape)]
    return as_share(crossed_estimate(better, sides, better.size))


def _means_of(episodes: Episodes) -> dict[tuple[Hashable, Hashable], float]:
    """Return the mean score of each run at each of its settings."""
    found: dict[tuple[Hashable, Hashable], list[float]] = {}
    for key, run, score in zip(episodes.keys, episodes.runs, episodes.scores.tolist(), strict=True):
        found.setdefault((run, key[:2] if is_tuple(key) else key), []).append(score)
    return {place: float(np.mean(scores)) for place, scores in found.items()}
