"""Comparison of records: rates that fell between two versions, on one machine and in one case."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.report.records import BenchRecord, read_records
from benchmarks.report.tables import number, table

TRAINING = "training"
NO_MATTER = {"repeats", "profile", "steps", "total_steps", "seed", "checkpoint_every", "keep"}
"""Keys of cases and settings that change no rate."""


@dataclass(frozen=True)
class Change:
    """A rate in the newest record of a case, and in the one before of another commit.

    Attributes:
        newest: The newest record.
        before: The one before.
        name: Name of the rate.
        rate: The rate, now.
        earlier: The rate, before.
    """

    newest: BenchRecord
    before: BenchRecord
    name: str
    rate: float
    earlier: float

    @property
    def ratio(self) -> float:
        """Rate now over the rate before."""
        return self.rate / self.earlier


def changes(records: Iterable[BenchRecord]) -> list[Change]:
    """Return the changes of all rates whose case was measured at two commits, oldest first.

    Cases are equal where all keys that both records have are equal: a version may have added an option,
    whose default is the behaviour of before. So are their machines.
    """
    found: list[Change] = []
    latest: list[BenchRecord] = []
    for record in sorted(records, key=lambda one: one.data["when"], reverse=True):
        mine = next((one for one in latest if _same_case(one, record)), None)
        if mine is None:
            latest.append(record)
            continue
        known = {(change.newest.data["when"], change.name) for change in found}
        if mine.data["commit"] == record.data["commit"]:
            continue
        now, then = _rates(mine.data), _rates(record.data)
        found += [
            Change(mine, record, name, now[name], then[name])
            for name in now
            if name in then and (mine.data["when"], name) not in known
        ]
    return sorted(found, key=lambda change: change.newest.data["when"])


def _same_case(one: BenchRecord, other: BenchRecord) -> bool:
    if one.benchmark != other.benchmark or one.where != other.where or not (one.case and other.case):
        return False
    return _agree(one.case, other.case) and all(
        _agree(one.data.get(name) or {}, other.data.get(name) or {}) for name in ("settings", "config")
    )


def _agree(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Return whether common values are equal, but for those that change no rate."""
    return all(one[key] == other[key] for key in one.keys() & other.keys() - NO_MATTER)


def _rates(data: Mapping[str, Any]) -> dict[str, float]:
    """Return rates by name; of a training the median, which records of all versions have, and the mean."""
    rates = {name: float(rate["rate"]) for name, rate in data.get("rates", {}).items() if rate.get("rate")}
    if TRAINING in rates:
        mean = rates.pop(TRAINING)
        if "median_agent_steps_per_s" in data:
            rates |= {"training, all waits": mean, "training, median": data["median_agent_steps_per_s"]}
        else:
            rates["training, median"] = mean
    return rates


def compare(folder: Path, tolerance: float) -> tuple[str, int]:
    """Return a table of all changes, slower ones named below it, and the number of these.

    Args:
        folder: Folder of records.
        tolerance: Loss that does not count, as a share.

    Raises:
        UsageError: A line is no record; names file and line.
    """
    known = changes(read_records(folder))
    head = ("benchmark", "on", "case", "rate", "before", "now", "ratio")
    rows = [
        (
            change.newest.benchmark,
            change.newest.where,
            _case_text(change.newest.case),
            change.name,
            f"{number(change.earlier)} ({change.before.data['commit']})",
            f"{number(change.rate)} ({change.newest.data['commit']})",
            f"{change.ratio:.3f}",
        )
        for change in known
    ]
    slower = [change for change in known if change.ratio < 1 - tolerance]
    said = [
        f"slower by {1 - change.ratio:.0%}: {change.newest.benchmark}, {change.name}, "
        f"on {change.newest.where}, {_case_text(change.newest.case)}: "
        f"{change.before.data['commit']} to {change.newest.data['commit']}"
        for change in slower
    ]
    return "\n".join([table(head, rows), *said]).rstrip(), len(slower)


def _case_text(case: Mapping[str, Any]) -> str:
    """Return a case in few words: its worlds and robots first, and what is not off."""
    named = {key: value for key, value in case.items() if key not in ("seed", "steps", "repeats", "profile")}
    return ", ".join(f"{key} {value}" for key, value in named.items() if value not in (None, False, 0, ""))
