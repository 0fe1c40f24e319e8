"""Scores over the axes of a sweep: cells with one value, or in one range of many values, are taken together.

Policies are compared over cells that all of them have; how many are left out for that is said.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from usarmjx.base.estimates import Estimate, estimate, interquartile_mean
from usarmjx.sweeps.answers import axes_of, policy_of, settings_but, tasks_of
from usarmjx.sweeps.settings import as_text
from usarmjx.sweeps.store import CellRecord, StoredSweep
from usarmjx.sweeps.table import scores_of

MOST_VALUES, BINS = 12, 8
"""A numeric axis with more values than the first is told in so many ranges, with as many cells in each."""
USUAL = "as usual"


@dataclass(frozen=True, kw_only=True)
class AxisValue:
    """A value on an axis, or a range of values.

    Attributes:
        text: As it is told.
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
        """How many there are."""
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
