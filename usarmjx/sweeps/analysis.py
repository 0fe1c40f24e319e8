"""Results of a sweep: scores over its axes, differences between methods, score against connectivity."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import combinations
from typing import Any

import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.estimates import Estimate, estimate_groups, holm, pareto_front
from usarmjx.sweeps.design import (
    DRIVERS,
    Episodes,
    Sampled,
    building_of,
    chosen,
    episodes_of,
    improvement,
    joined,
    mean_score,
    middle_score,
    paired,
    policy_of,
    range_scores,
)
from usarmjx.sweeps.spec import as_text, rename_policy
from usarmjx.sweeps.store import CellRecord, StoredSweep
from usarmjx.sweeps.table import scores_of

UNLINKED = "unlinked"
"""The metric of tasks for teams that connectivity is read from: share of pairs of robots without a link."""


@dataclass(frozen=True, kw_only=True)
class Difference:
    """Difference of two policies or methods in the same episodes.

    Attributes:
        task: The task.
        first: One policy or method.
        second: The other.
        gain: Score of the first less that of the second.
        better: Share of the episodes in which the first is better.
        improvement: Probability that a run of the first is better than one of the second, see `improvement`.
        p: Probability of so large a difference if there is none, corrected for all comparisons (Holm).
    """

    task: str
    first: str
    second: str
    gain: Estimate
    better: float
    improvement: Estimate
    p: float = float("nan")


@dataclass(frozen=True, kw_only=True)
class FrontPoint:
    """A cell's place between score and connectivity.

    Attributes:
        task: Its task.
        label: Its settings on the axes, as text.
        score: Mean score.
        connectivity: Share of pairs of robots with a link.
        best: Whether no other cell of the task is better at one and as good at the other.
    """

    task: str
    label: str
    score: float
    connectivity: float
    best: bool


def settings_but(record: CellRecord, names: Collection[str] = DRIVERS) -> str:
    """Return all settings of a cell but some, as text: cells that are alike in them have the same."""
    return repr(sorted((key, value) for key, value in record.settings.items() if key not in names))


def tasks_of(found: StoredSweep) -> list[str]:
    """Return the tasks of the finished cells, in the sweep's order."""
    return list(dict.fromkeys(record.settings["task"] for record in found.finished))


def axes_of(found: StoredSweep) -> list[str]:
    """Return the axes but for task, policy and method, which every table tells apart."""
    return [axis for axis in found.axes if axis not in ("task", *DRIVERS)]


def label_of(record: CellRecord, axes: Sequence[str]) -> str:
    """Return a cell's settings on the axes, as text."""
    said = [f"{axis} {as_text(record.settings[axis])}" for axis in axes if axis in record.settings]
    return ", ".join(said) or "all"


def policy_differences(found: StoredSweep) -> list[Difference]:
    """Return differences between policies or methods, in episodes that begin alike."""
    rows: list[Difference] = []
    for task in tasks_of(found):
        by_policy = {
            policy: episodes_of(records, found.sampled)
            for policy, records in _by_policy(_of_task(found, task)).items()
        }
        rows += [
            row
            for one, other in combinations(by_policy, 2)
            if (row := _difference(task, (one, by_policy[one]), (other, by_policy[other]))) is not None
        ]
    # A difference without a p counts as 1, so that the correction is for all comparisons that are shown.
    corrected = holm([row.gain.p if np.isfinite(row.gain.p) else 1.0 for row in rows])
    return [replace(row, p=p) for row, p in zip(rows, corrected, strict=True)]


def _difference(task: str, one: tuple[str, Episodes], other: tuple[str, Episodes]) -> Difference | None:
    """Return the difference of two policies by name; None: they have no episode in common."""
    (first, mine), (second, theirs) = one, other
    gains, _ = paired(mine, theirs)
    if not len(gains):
        return None
    return Difference(
        task=task,
        first=first,
        second=second,
        gain=mean_score(gains, shares=False),
        better=float((gains.scores > 0).mean()),
        improvement=improvement(mine, theirs),
    )


@dataclass(frozen=True, kw_only=True)
class Aggregate:
    """Normalised score of a policy or method over tasks.

    Attributes:
        policy: The policy or method.
        tasks: Number of tasks.
        mean: Mean over the tasks, each counting alike.
        middle: Interquartile mean over runs, tasks and settings.
    """

    policy: str
    tasks: int
    mean: Estimate
    middle: Estimate


def aggregates(found: StoredSweep) -> list[Aggregate]:
    """Return normalised scores over tasks: 0 and 1 are scores of policies of the sweep, or of its file.

    The interval of the mean counts what is not known of the scores that stand for 0 and 1, where those are of
    the same episodes. Policies that lack a task are left out.

    Raises:
        UsageError: A policy that stands for 0 or 1 and has no cells, or a task without such a score.
    """
    if not found.normalise:
        return []
    tasks = tasks_of(found)
    own = {task: _by_policy(_of_task(found, task)) for task in tasks}
    policies = [name for name in own[tasks[0]] if all(name in own[task] for task in tasks)] if tasks else []
    rows: list[Aggregate] = []
    for policy in policies:
        parts = [_normalised(found, task, own[task], policy) for task in tasks]
        if all(len(part) for part, _ in parts):
            # The mean is over the same buildings for all tasks, the interquartile mean over runs of each its
            # own.
            whole = joined([part for part, _ in parts], alike=True)
            middle = middle_score(joined([plain for _, plain in parts], alike=False))
            rows.append(
                Aggregate(
                    policy=policy, tasks=len(tasks), mean=mean_score(whole, shares=False), middle=middle
                )
            )
    return rows


def _normalised(
    found: StoredSweep, task: str, records: Mapping[str, Sequence[CellRecord]], policy: str
) -> tuple[Episodes, Episodes]:
    """Return normalised scores of a task, with the deviations of 0 and 1 in them, and without."""
    mine = episodes_of(records[policy], found.sampled)
    anchors: list[np.ndarray] = []
    for name in ("zero", "one"):
        given = found.normalise[name]
        if isinstance(given, str):
            # Results of earlier versions name policies by former names.
            given = given if given in records else rename_policy(given)
            if given not in records:
                raise UsageError(f"normalise: {name} is {given}, which has no cells of {task}")
            theirs = episodes_of(records[given], found.sampled)
            table: dict[Any, list[float]] = {}
            for key, score in zip(theirs.keys, theirs.scores.tolist(), strict=True):
                table.setdefault(key, []).append(score)
            # NaN for an episode that the anchor has not; it is left out below for all three.
            anchors.append(np.array([np.mean(table.get(key, [np.nan])) for key in mine.keys]))
        elif task in given:
            anchors.append(np.full(len(mine), float(given[task])))
        else:
            raise UsageError(f"normalise: {name} has no score for {task}; it has: {', '.join(given)}")
    zero, one = anchors
    both = np.flatnonzero(np.isfinite(zero) & np.isfinite(one))
    mine, zero, one = chosen(mine, both.tolist()), zero[both], one[both]
    if not len(mine):
        return mine, mine
    span = float(one.mean() - zero.mean())
    if span == 0.0:
        raise UsageError(f"normalise: the scores for 0 and 1 of {task} are both {zero.mean():.3g}")
    share = float((mine.scores.mean() - zero.mean()) / span)
    rest = (mine.scores - zero - share * (one - zero)) / span  # of a ratio, to first order
    plain = (mine.scores - zero.mean()) / span
    return replace(mine, scores=share + rest), replace(mine, scores=plain)


def front_points(found: StoredSweep) -> list[FrontPoint]:
    """Return points of cells between score and connectivity; none for tasks without radio."""
    rows: list[FrontPoint] = []
    for task in tasks_of(found):
        mine = [
            record
            for record in found.finished
            if record.settings["task"] == task and UNLINKED in record.metrics and record.good
        ]
        if not mine:
            continue
        points = np.array([[scores_of(record).mean(), _connectivity(record)] for record in mine])
        best = pareto_front(points)
        axes = [*axes_of(found), "policy"]
        rows += [
            FrontPoint(
                task=task, label=label_of(record, axes), score=float(x), connectivity=float(y), best=bool(one)
            )
            for record, (x, y), one in zip(mine, points, best, strict=True)
        ]
    return rows


def _connectivity(record: CellRecord) -> float:
    return 1.0 - float(np.mean([record.metrics[UNLINKED][number] for number in record.good]))


@dataclass(frozen=True, kw_only=True)
class Change:
    """A cell that two sweeps have in common.

    Attributes:
        settings: Those on the axes, as text.
        task: Its task.
        before: Mean score in the first.
        after: In the second.
        gain: Second less first, in the same episodes.
    """

    settings: str
    task: str
    before: float
    after: float
    gain: Estimate


def changes(first: StoredSweep, second: StoredSweep) -> tuple[list[Change], int, int]:
    """Return the cells that two sweeps have in common, and how many only one of them has.

    Cells are the same whose settings are, whatever their files held: so two versions of a policy compare.
    """

    def by_settings(found: StoredSweep) -> dict[str, CellRecord]:
        return {repr(sorted(one.settings.items())): one for one in found.finished}

    ours, theirs = by_settings(first), by_settings(second)
    axes = list(dict.fromkeys([*first.axes, *second.axes]))
    rows: list[Change] = []
    for key in ours:
        if key not in theirs:
            continue
        one, other = ours[key], theirs[key]
        gain = _gain(one, other)
        before, after = (
            float(scores_of(record).mean()) if record.good else np.nan for record in (one, other)
        )
        said = label_of(one, [axis for axis in axes if axis != "task"])
        rows.append(Change(settings=said, task=one.settings["task"], before=before, after=after, gain=gain))
    return rows, len(ours) - len(rows), len(theirs) - len(rows)


def _gain(before: CellRecord, after: CellRecord) -> Estimate:
    """Return how much better a cell is than another with its settings, in the episodes that both have."""
    both = sorted(set(before.good) & set(after.good))
    gains = np.array([after.scores[number] - before.scores[number] for number in both], float)
    # Episodes in one building are not independent: the building is the unit.
    return estimate_groups(gains, [repr(building_of(after, number)) for number in both])


def failures(found: StoredSweep) -> dict[str, list[CellRecord]]:
    """Return the cells that failed, by reason."""
    rows: dict[str, list[CellRecord]] = {}
    for record in found.records:
        if record.failed is not None:
            rows.setdefault(record.failed, []).append(record)
    return rows


def other_versions(found: StoredSweep, now: dict[str, str]) -> dict[str, Any]:
    """Return versions of what computed some of the cells that differ from those of now."""
    return {
        name: sorted({str(record.versions.get(name)) for record in found.finished} - {now[name]})
        for name in now
        if {str(record.versions.get(name)) for record in found.finished} - {now[name]}
    }


MOST_VALUES, BINS = 12, 8
"""A numeric axis with more values than the first is shown in BINS ranges of equal counts."""
FEWEST_POINTS = 3
"""Points of a sampled axis in each of its ranges, at least."""
USUAL = "as usual"


@dataclass(frozen=True, kw_only=True)
class AxisValue:
    """A value on an axis, or a range of values.

    Attributes:
        text: Text of the value.
        place: The number, or the middle of the range; None: no number.
    """

    text: str
    place: float | None


@dataclass(frozen=True, kw_only=True)
class AxisRow:
    """Cells that have one value on an axis, and one policy.

    Attributes:
        task: Their task.
        axis: The axis; empty: all cells.
        value: Its value.
        policy: Their policy, as text.
        records: The cells.
        mean: Mean score. Over an axis that was sampled, other sampled settings are adjusted for.
        sampled: Ranges of the sampled settings.
        left_out: Cells of this policy with this value that the others have not, and so are not among them.
        own: Whether the policies have no cells in common here, so that each stands for its own.
    """

    task: str
    axis: str
    value: AxisValue
    policy: str
    records: tuple[CellRecord, ...]
    mean: Estimate
    sampled: Sampled
    left_out: int = 0
    own: bool = False

    @property
    def cells(self) -> int:
        """Number of cells."""
        return len(self.records)

    @cached_property
    def middle(self) -> Estimate:
        """Interquartile mean over runs and settings."""
        return middle_score(episodes_of(self.records, self.sampled))


def overall_rows(found: StoredSweep) -> list[AxisRow]:
    """Return the scores of all cells of each task and policy."""
    rows: list[AxisRow] = []
    for task in tasks_of(found):
        everything = AxisValue(text="all", place=None)
        for policy, records in _by_policy(_of_task(found, task)).items():
            mean = mean_score(episodes_of(records, found.sampled))
            rows.append(
                AxisRow(
                    task=task,
                    axis="",
                    value=everything,
                    policy=policy,
                    records=tuple(records),
                    mean=mean,
                    sampled=found.sampled,
                )
            )
    return rows


def axis_rows(found: StoredSweep) -> list[AxisRow]:
    """Return scores over each axis that has several values."""
    return [
        row
        for task in tasks_of(found)
        for axis in axes_of(found)
        for row in _rows_of(task, axis, _of_task(found, task), found.sampled)
    ]


def _of_task(found: StoredSweep, task: str) -> list[CellRecord]:
    return [record for record in found.finished if record.settings["task"] == task]


def _rows_of(task: str, axis: str, records: Sequence[CellRecord], sampled: Sampled) -> list[AxisRow]:
    values = axis_values(records, axis, sampled)
    if len(set(values)) < 2:
        return []
    value_of = {record.key: value for record, value in zip(records, values, strict=True)}
    alike, apart = shared_cells(records, partial(settings_but, names=(*DRIVERS, axis)))
    kept = {record.key for cells in alike.values() for record in cells}
    rows: list[AxisRow] = []
    for value in _in_order(values):
        there = [record for record in records if value_of[record.key] == value]
        compared, own = shared_cells([record for record in there if record.key in kept])
        rows += [
            AxisRow(
                task=task,
                axis=axis,
                value=value,
                policy=policy,
                records=tuple(cells),
                mean=mean_score(episodes_of(cells, sampled)),
                sampled=sampled,
                left_out=sum(policy_of(record) == policy for record in there) - len(cells),
                own=own or (apart and len(compared) > 1),
            )
            for policy, cells in compared.items()
        ]
    return _adjusted(rows) if axis in sampled else rows


def _adjusted(rows: Sequence[AxisRow]) -> list[AxisRow]:
    """Return the rows of a sampled axis, other sampled settings adjusted for."""
    found: list[AxisRow] = []
    for policy in dict.fromkeys(row.policy for row in rows):
        mine = [row for row in rows if row.policy == policy]
        sampled, axis = mine[0].sampled, mine[0].axis
        if len(mine) < 2 or min(len(set(episodes_of(row.records, sampled).points)) for row in mine) < 2:
            found += mine
            continue
        pool = episodes_of([record for row in mine for record in row.records], sampled)
        # One entry for each good episode, in the order in which `episodes_of` lists them.
        places = [place for place, row in enumerate(mine) for one in row.records for _ in one.good]
        means = range_scores(pool, axis, places)
        found += [replace(row, mean=mean) for row, mean in zip(mine, means, strict=True)]
    # Back in the order of the axis: the loop went policy by policy.
    order = list(dict.fromkeys(row.value for row in rows))
    return sorted(found, key=lambda row: order.index(row.value))


def _in_order(values: Iterable[AxisValue]) -> list[AxisValue]:
    """Return the values once each: by their numbers, or as they came where they have none."""
    return sorted(dict.fromkeys(values), key=lambda value: -np.inf if value.place is None else value.place)


def axis_values(records: Sequence[CellRecord], axis: str, sampled: Sampled) -> list[AxisValue]:
    """Return the value of each cell on an axis (cells,): a range where there are too many numbers."""
    given = [record.settings.get(axis, USUAL) for record in records]
    numbers = [float(value) for value in given if _is_number(value)]
    names = tuple(sampled)
    points = len({tuple(record.settings.get(name) for name in names) for record in records})
    # Sampled values hardly repeat: a range needs several points for an interval.
    most = min(MOST_VALUES, points // FEWEST_POINTS) if axis in sampled else MOST_VALUES
    if len(set(numbers)) <= most or any(value != USUAL and not _is_number(value) for value in given):
        return [
            AxisValue(text=as_text(value), place=float(value) if _is_number(value) else None)
            for value in given
        ]
    edges = range_edges(numbers, max(1, min(BINS, points // FEWEST_POINTS)) if axis in sampled else BINS)
    ranges = [
        AxisValue(text=f"{as_text(low)} to {as_text(high)}", place=(low + high) / 2)
        for low, high in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)
    ]
    usual = AxisValue(text=USUAL, place=None)
    return [ranges[_range_of(edges, float(value))] if _is_number(value) else usual for value in given]


def range_edges(numbers: Sequence[float], count: int = BINS) -> np.ndarray:
    """Return the ends of ranges with as many numbers each (ranges + 1,); fewer where they repeat."""
    return np.unique(np.quantile(numbers, np.linspace(0.0, 1.0, count + 1)))


def _range_of(edges: np.ndarray, number: float) -> int:
    """Return in which range a number lies; one on an edge is in the upper of its two."""
    # The highest number is on the last edge, which begins no range.
    return min(int(np.searchsorted(edges, number, side="right")) - 1, len(edges) - 2)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _by_policy(records: Iterable[CellRecord]) -> dict[str, list[CellRecord]]:
    found: dict[str, list[CellRecord]] = {}
    for record in records:
        found.setdefault(policy_of(record), []).append(record)
    return found


def shared_cells(
    records: Iterable[CellRecord], key: Callable[[CellRecord], str] = settings_but
) -> tuple[dict[str, list[CellRecord]], bool]:
    """Return the cells of each policy that all policies have, and whether there are none.

    Args:
        records: Cells of one task.
        key: Key that cells counting as one share.

    Returns:
        The cells by policy; where there are none in common those that each has, and True.
    """
    own = _by_policy(records)
    shared = set[str].intersection(*({key(record) for record in cells} for cells in own.values()))
    if not shared:
        return own, len(own) > 1
    return {
        policy: [record for record in cells if key(record) in shared] for policy, cells in own.items()
    }, False
