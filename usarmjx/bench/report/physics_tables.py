"""What settings of the physics change, class by class, of the newest record of each settings."""

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from usarmjx.bench.report.records import BenchRecord
from usarmjx.bench.report.tables import MarkdownRow, number, of, table

SHOWN = ("timestep", "solver", "iterations", "cone")
"""Settings by which a record is told from others."""


def settings_words(record: BenchRecord) -> str:
    """Return the settings of a record of `usarmjx bench physics` in a few words."""
    settings: Mapping[str, Any] = record.data["settings"]
    return ", ".join(f"{name} {settings[name]}" for name in SHOWN)


def physics_table(records: Sequence[BenchRecord]) -> str:
    """How many numbers are the reference's."""
    head = ("when", "commit", "on", "settings", "numbers within 10 % of the reference")
    rows = []
    for record in of(records, "physics"):
        total = sum(len(numbers) for numbers in record.data["numbers"].values())
        within = f"{total - len(record.data['differing'])} of {total}"
        rows.append([record.when, record.data["commit"], record.where, settings_words(record), within])
    return table(head, rows)


def differences_text(records: Sequence[BenchRecord]) -> str:
    """What settings are not for: each class that does something otherwise, with both numbers."""
    newest = {json.dumps(one.data["settings"], sort_keys=True): one for one in of(records, "physics")}
    return "\n".join(map(_differences, newest.values())) or table((), ())


def _differences(record: BenchRecord) -> str:
    data, origin = record.data, f"{record.when}, commit {record.data['commit']}"
    apart = {name for name, _ in data["differing"]}
    same = ", ".join(name for name in data["numbers"] if name not in apart)
    head = ("class", "manoeuvre", "reference", "here")
    return (
        f"{settings_words(record)} ({origin}): what differs by more than 10 %.\n\n"
        f"{table(head, _difference_rows(data))}\nNothing of {same or 'no class'}.\n"
    )


def _difference_rows(data: Mapping[str, Any]) -> Iterator[MarkdownRow]:
    for name, manoeuvre in data["differing"]:
        unit = data["units"][manoeuvre]
        told = (
            "went bad" if value is None else f"{number(value)} {unit}"
            for value in data["numbers"][name][manoeuvre]
        )
        yield [name, manoeuvre, *told]
