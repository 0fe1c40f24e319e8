"""Settings of the physics against the reference settings: every class, every manoeuvre."""

import math
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from multiprocessing import get_context
from typing import Any

from benchmarks.cases import RecordOptions, ScorecardCase
from benchmarks.fidelity.manoeuvres import MANOEUVRES, drive_all
from benchmarks.tools import append_record, record_header
from usarmjx.models.compile.physics import PHYSICS, Physics
from usarmjx.models.robots import ROBOTS

NO_RECORD = RecordOptions()
TOLERATED = 0.1
"""Share of the reference by which a number may differ."""
Card = dict[str, dict[str, float]]
"""The number of each manoeuvre of each class."""


def _drive(name: str, physics: Physics) -> dict[str, float]:
    return drive_all(physics, ROBOTS.get(name))


def measure_cards(settings: Sequence[Physics], names: Iterable[str], jobs: int = 1) -> list[Card]:
    """Return the cards of several settings, measured by so many processes at once."""
    classes = list(names)
    work = [(name, physics) for physics in settings for name in classes]
    if jobs == 1:
        numbers = [_drive(*pair) for pair in work]
    else:
        with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
            numbers = list(pool.map(_drive, *zip(*work, strict=True)))
    found = iter(numbers)
    return [{name: next(found) for name in classes} for _ in settings]


def differences(reference: Card, other: Card) -> Iterator[tuple[str, str, float, float]]:
    """Yield class, manoeuvre, reference and number where they differ by more than is tolerated."""
    for name, numbers in reference.items():
        for manoeuvre, wanted in numbers.items():
            found = other[name][manoeuvre]
            slack = max(MANOEUVRES[manoeuvre].least, TOLERATED * abs(wanted))
            if not abs(found - wanted) <= slack:
                yield name, manoeuvre, wanted, found


def write_scorecard(case: ScorecardCase, options: RecordOptions = NO_RECORD) -> str:
    """Measure settings beside the reference settings; append a record; return a summary for people.

    Raises:
        UnknownNameError: There is no such class, or no such settings.
    """
    physics = PHYSICS.get(case.physics)
    classes = [ROBOTS.get(name).name for name in case.robot or ROBOTS.names()]
    header = record_header("physics", host=True, note=options.note)
    reference, card = measure_cards((Physics(), physics), classes, case.jobs)
    record: dict[str, Any] = {
        **header,
        "case": {"classes": classes, "jobs": case.jobs},
        "scene": None,
        "rates": {},
        "baselines": {"reference settings": {"what": "each number has the reference's before it"}},
        "reference": asdict(Physics()),
        "settings": asdict(physics),
        "units": {name: manoeuvre.unit for name, manoeuvre in MANOEUVRES.items()},
        "numbers": {
            name: {key: [_known(value), _known(card[name][key])] for key, value in numbers.items()}
            for name, numbers in reference.items()
            if numbers
        },
        "differing": [list(row[:2]) for row in differences(reference, card)],
    }
    append_record(record, options.json)
    return summary(reference, card)


def _known(value: float) -> float | None:
    """Return a number as JSON has it, which knows no NaN."""
    return value if math.isfinite(value) else None


def summary(reference: Card, card: Card) -> str:
    """Return a table of shares of the reference, of the manoeuvres that differ, for people."""
    rows = [
        f"{name:12} {manoeuvre:13} {wanted:8.3f} -> {found:8.3f} {MANOEUVRES[manoeuvre].unit}"
        for name, manoeuvre, wanted, found in differences(reference, card)
    ]
    total = sum(len(numbers) for numbers in reference.values())
    head = f"{total - len(rows)} of {total} numbers within {TOLERATED:.0%} of the reference; the others:"
    return "\n".join([head, *rows])
