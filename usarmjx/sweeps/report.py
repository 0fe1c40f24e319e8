"""Answers as text: aligned columns that are Markdown tables, too."""

from collections.abc import Sequence

import numpy as np

from usarmjx.base.estimates import Estimate
from usarmjx.recording.inputs import versions
from usarmjx.sweeps.analysis import (
    AxisRow,
    aggregates,
    axis_rows,
    changes,
    failures,
    front_points,
    label_of,
    other_versions,
    overall_rows,
    policy_differences,
)
from usarmjx.sweeps.store import StoredSweep

MOST_POINTS = 12
"""Cells of a front that are listed."""
MOST_CHANGES = 40
RESIDUE = 1e-9
"""Share of its interval below which a value is a rounding error of a sum."""


def aligned(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return a table's lines, columns as wide as they need be."""
    widths = [max(len(row[i]) for row in [head, *rows]) for i in range(len(head))]

    def line(row: Sequence[str]) -> str:
        return "| " + " | ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)) + " |"

    return [line(head), "|" + "|".join("-" * (width + 2) for width in widths) + "|", *map(line, rows)]


def as_words(found: Estimate) -> str:
    """Return a number with its interval."""
    if not np.isfinite(found.value):
        return "none"
    if not np.isfinite(found.low):
        return f"{found.value:.3g}"
    return f"{without_residue(found):.3g} ({found.low:.3g} to {found.high:.3g})"


def without_residue(found: Estimate) -> float:
    """Return the value of a number with an interval; 0 if it is a rounding error."""
    return 0.0 if abs(found.value) < RESIDUE * (found.high - found.low) else found.value


def report(found: StoredSweep) -> str:
    """Return the results of a sweep, in tables."""
    lines = [f"{found.name}: {found.about}" if found.about else found.name]
    failed = sum(record.failed is not None for record in found.records)
    missing = len(found.keys) - len(found.records)
    lines.append(
        f"{len(found.finished)} of {len(found.keys)} cells, {failed} failed, {missing} not played yet"
    )
    bad = sum(len(record.bad) - len(record.good) for record in found.finished)
    if bad:
        lines.append(f"{bad} episodes left out: physics failed")
    lines += [f"warning: {note}" for note in dict.fromkeys(record.note for record in found.finished) if note]
    for name, others in other_versions(found, versions()).items():
        lines.append(f"computed with another {name}: {', '.join(others)}")
    for reason, records in failures(found).items():
        lines.append(f"failed: {reason} ({len(records)} cells, as {label_of(records[0], found.axes)})")
    rows = [*overall_rows(found), *axis_rows(found)]
    for axis in dict.fromkeys(row.axis for row in rows):
        lines += ["", *_axis_table(axis, [row for row in rows if row.axis == axis])]
    lines += _differences(found) + _aggregates(found) + _front(found)
    return "\n".join(lines)


def _axis_table(axis: str, rows: Sequence[AxisRow]) -> list[str]:
    head = ["task", axis or "cells", "policy", "score, 95 % interval", "interquartile mean", *COUNTS]
    body = [
        [
            row.task,
            row.value.text if axis else str(row.cells),
            row.policy,
            as_words(row.mean) + (" Wilson" if row.mean.method == "Wilson" else ""),
            # Ranges of a sampled axis differ in the other settings, for which only the mean is adjusted.
            "" if row.axis in row.sampled else as_words(row.middle),
            *_counts(row.mean),
        ]
        for row in rows
    ]
    return [*aligned(head, body), *_compared(rows)]


COUNTS = ("buildings", "settings", "runs", "episodes")


def _counts(found: Estimate) -> list[str]:
    """Return what an interval stands on, for the columns `COUNTS`."""
    return [*(str(found.drawn(name)) for name in COUNTS[:3]), str(found.count)]


def _compared(rows: Sequence[AxisRow]) -> list[str]:
    """Return over which cells policies are compared, where those are not all that each has."""
    left_out: dict[tuple[str, str], int] = {}
    for row in rows:
        left_out[row.task, row.policy] = left_out.get((row.task, row.policy), 0) + row.left_out
    lines = [
        f"{task}: {count} cells of {policy} are left out, which not all policies have"
        for (task, policy), count in left_out.items()
        if count
    ]
    own = dict.fromkeys(row.task for row in rows if row.own)
    return lines + [
        f"{task}: the policies have no cells in common, each is shown over its own" for task in own
    ]


def _differences(found: StoredSweep) -> list[str]:
    rows = policy_differences(found)
    if not rows:
        return []
    # With single runs the probability of improvement has no interval.
    several = any(row.gain.drawn("runs") > 1 for row in rows)
    head = ["task", "policy", "less", "difference in the same episodes, 95 %", "p (Holm)", "better in"]
    body = [
        [
            row.task,
            row.first,
            row.second,
            as_words(row.gain),
            f"{row.p:.2g}",
            f"{row.better:.0%}",
            *([as_words(row.improvement)] if several else []),
            *_counts(row.gain),
        ]
        for row in rows
    ]
    return ["", *aligned([*head, *(["probability of improvement"] if several else []), *COUNTS], body)]


def _aggregates(found: StoredSweep) -> list[str]:
    rows = aggregates(found)
    if not rows:
        return []
    zero, one = (
        name if isinstance(name, str) else "given" for name in map(found.normalise.get, ("zero", "one"))
    )
    head = ["policy", f"normalised score (0 {zero}, 1 {one}), 95 %", "interquartile mean", "tasks", *COUNTS]
    body = [
        [row.policy, as_words(row.mean), as_words(row.middle), str(row.tasks), *_counts(row.mean)]
        for row in rows
    ]
    return ["", *aligned(head, body)]


def _front(found: StoredSweep) -> list[str]:
    best = [point for point in front_points(found) if point.best]
    if not best:
        return []
    best.sort(key=lambda point: (point.task, -point.score))
    body = [
        [point.task, point.label, f"{point.score:.3g}", f"{point.connectivity:.2f}"]
        for point in best[:MOST_POINTS]
    ]
    more = [f"... and {len(best) - MOST_POINTS} more"] if len(best) > MOST_POINTS else []
    return ["", *aligned(["task", "nobody is better than", "score", "connectivity"], body), *more]


def compare(first: StoredSweep, second: StoredSweep) -> str:
    """Return the differences in the cells that two sweeps share, the largest changes first."""
    rows, only_first, only_second = changes(first, second)
    lines = [
        f"{len(rows)} cells in both, {only_first} in the first only, {only_second} in the second only",
    ]
    if not rows:
        return lines[0]
    # An unknown gain sorts behind all changes.
    rows.sort(key=lambda row: -abs(row.gain.value) if np.isfinite(row.gain.value) else 0.0)
    same = sum(row.gain.value == 0.0 for row in rows)
    lines.append(f"the same score in {same} of them")
    body = [
        [row.task, row.settings, f"{row.before:.3g}", f"{row.after:.3g}", as_words(row.gain)]
        for row in rows[:MOST_CHANGES]
        if row.gain.value != 0.0
    ]
    if body:
        lines += ["", *aligned(["task", "cell", "first", "second", "second less first, 95 %"], body)]
    return "\n".join(lines)
