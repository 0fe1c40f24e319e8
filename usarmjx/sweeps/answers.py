"""What a sweep says beside scores over its axes: differences between policies, score against connectivity."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from usarmjx.base.estimates import Estimate, estimate, pareto_front
from usarmjx.sweeps.settings import as_text
from usarmjx.sweeps.store import CellRecord, StoredSweep
from usarmjx.sweeps.table import scores_of

UNLINKED = "unlinked"
"""The metric of tasks for teams that connectivity is read from: share of pairs of robots without a link."""


@dataclass(frozen=True, kw_only=True)
class Difference:
    """How much better one policy is than another in the same episodes.

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
    """Return how much better policies are than each other, in episodes that begin alike."""
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
    """Return where cells are between score and connectivity; none where the task has no radio."""
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
