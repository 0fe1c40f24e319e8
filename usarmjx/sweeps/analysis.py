"""Results of a sweep beside scores over axes: differences between policies, score against connectivity."""

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import combinations
from typing import Any

import numpy as np

from usarmjx.base.estimates import Estimate, estimate, interquartile_mean, pareto_front
from usarmjx.sweeps.spec import as_text
from usarmjx.sweeps.store import CellRecord, StoredSweep
from usarmjx.sweeps.table import scores_of

UNLINKED = "unlinked"
"""The metric of tasks for teams that connectivity is read from: share of pairs of robots without a link."""


@dataclass(frozen=True, kw_only=True)
class Difference:
    """Gain of one policy over another in the same episodes.

    Attributes:
        task: The task.
        first: One policy.
        second: The other.
        gain: Score of the first less that of the second.
        better: Share of the episodes in which the first is better.
    """

    task: str
    first: str
    second: str
    gain: Estimate
    better: float


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


def policy_of(record: CellRecord) -> str:
    """Return a cell's policy, as text."""
    return as_text(record.settings["policy"])


def settings_but(record: CellRecord, names: Collection[str] = ("policy",)) -> str:
    """Return all settings of a cell but some, as text: cells that are alike in them have the same."""
    return repr(sorted((key, value) for key, value in record.settings.items() if key not in names))


def tasks_of(found: StoredSweep) -> list[str]:
    """Return the tasks of the finished cells, in the sweep's order."""
    return list(dict.fromkeys(record.settings["task"] for record in found.finished))


def axes_of(found: StoredSweep) -> list[str]:
    """Return the axes but for task and policy, which every table tells apart."""
    return [axis for axis in found.axes if axis not in ("task", "policy")]


def label_of(record: CellRecord, axes: Sequence[str]) -> str:
    """Return a cell's settings on the axes, as text."""
    said = [f"{axis} {as_text(record.settings[axis])}" for axis in axes if axis in record.settings]
    return ", ".join(said) or "all"


def paired(first: CellRecord, second: CellRecord) -> np.ndarray:
    """Return scores of one cell less those of the other in the episodes that went well in both (n,)."""
    both = sorted(set(first.good) & set(second.good))
    return np.array([first.scores[number] - second.scores[number] for number in both], float)


def policy_differences(found: StoredSweep) -> list[Difference]:
    """Return the gains of policies over each other, in episodes that begin alike."""
    rows: list[Difference] = []
    for task in tasks_of(found):
        by_policy: dict[str, dict[str, CellRecord]] = {}
        for record in found.finished:
            if record.settings["task"] == task:
                by_policy.setdefault(policy_of(record), {})[settings_but(record)] = record
        for one, other in combinations(by_policy, 2):
            shared = [key for key in by_policy[one] if key in by_policy[other]]
            strata = [paired(by_policy[one][key], by_policy[other][key]) for key in shared]
            strata = [row for row in strata if len(row)]
            if strata:
                gains = np.concatenate(strata)
                rows.append(
                    Difference(
                        task=task,
                        first=one,
                        second=other,
                        gain=estimate(strata),
                        better=float((gains > 0).mean()),
                    )
                )
    return rows


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
        gain = estimate([paired(other, one)])
        before, after = (estimate([scores_of(record)]).value for record in (one, other))
        said = label_of(one, [axis for axis in axes if axis != "task"])
        rows.append(Change(settings=said, task=one.settings["task"], before=before, after=after, gain=gain))
    return rows, len(ours) - len(rows), len(theirs) - len(rows)


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
"""Most values of a numeric axis before it is cut into ranges, and the number of ranges of equal counts."""
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
        left_out: Cells of this policy with this value that the others have not, and so are not among them.
        own: Whether the policies have no cells in common here, so that each stands for its own.
    """

    task: str
    axis: str
    value: AxisValue
    policy: str
    records: tuple[CellRecord, ...]
    left_out: int = 0
    own: bool = False

    @property
    def cells(self) -> int:
        """Number of cells."""
        return len(self.records)

    @cached_property
    def mean(self) -> Estimate:
        """Mean score."""
        return estimate([scores_of(record) for record in self.records], shares=True)

    @cached_property
    def middle(self) -> Estimate:
        """Interquartile mean."""
        return estimate([scores_of(record) for record in self.records], interquartile_mean)


def overall_rows(found: StoredSweep) -> list[AxisRow]:
    """Return the scores of all cells of each task and policy."""
    rows: list[AxisRow] = []
    for task in tasks_of(found):
        everything = AxisValue(text="all", place=None)
        for policy, records in _by_policy(_of_task(found, task)).items():
            rows.append(AxisRow(task=task, axis="", value=everything, policy=policy, records=tuple(records)))
    return rows


def axis_rows(found: StoredSweep) -> list[AxisRow]:
    """Return scores over each axis that has several values."""
    return [
        row
        for task in tasks_of(found)
        for axis in axes_of(found)
        for row in _rows_of(task, axis, _of_task(found, task))
    ]


def _of_task(found: StoredSweep, task: str) -> list[CellRecord]:
    return [record for record in found.finished if record.settings["task"] == task]


def _rows_of(task: str, axis: str, records: Sequence[CellRecord]) -> list[AxisRow]:
    values = axis_values(records, axis)
    if len(set(values)) < 2:
        return []
    value_of = {record.key: value for record, value in zip(records, values, strict=True)}
    alike, apart = shared_cells(records, partial(settings_but, names=("policy", axis)))
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
                left_out=sum(policy_of(record) == policy for record in there) - len(cells),
                own=own or (apart and len(compared) > 1),
            )
            for policy, cells in compared.items()
        ]
    return rows


def _in_order(values: Iterable[AxisValue]) -> list[AxisValue]:
    """Return the values once each: by their numbers, or as they came where they have none."""
    return sorted(dict.fromkeys(values), key=lambda value: -np.inf if value.place is None else value.place)


def axis_values(records: Sequence[CellRecord], axis: str) -> list[AxisValue]:
    """Return the value of each cell on an axis (cells,): a range where there are too many numbers."""
    given = [record.settings.get(axis, USUAL) for record in records]
    numbers = [float(value) for value in given if _is_number(value)]
    if len(set(numbers)) <= MOST_VALUES or any(value != USUAL and not _is_number(value) for value in given):
        return [
            AxisValue(text=as_text(value), place=float(value) if _is_number(value) else None)
            for value in given
        ]
    edges = range_edges(numbers)
    ranges = [
        AxisValue(text=f"{as_text(low)} to {as_text(high)}", place=(low + high) / 2)
        for low, high in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)
    ]
    usual = AxisValue(text=USUAL, place=None)
    return [ranges[_range_of(edges, float(value))] if _is_number(value) else usual for value in given]


def range_edges(numbers: Sequence[float]) -> np.ndarray:
    """Return the ends of `BINS` ranges with as many numbers each (ranges + 1,); fewer where they repeat."""
    return np.unique(np.quantile(numbers, np.linspace(0.0, 1.0, BINS + 1)))


def _range_of(edges: np.ndarray, number: float) -> int:
    """Return in which range a number lies; one on an edge is in the upper of its two."""
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
        key: What is the same in cells that count as one.

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
