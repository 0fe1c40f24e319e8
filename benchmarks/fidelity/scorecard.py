"""Settings of the physics, or an engine, against the reference: every class, every manoeuvre."""

import math
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from multiprocessing import get_context
from typing import Any

from benchmarks.cases import RecordOptions, ScorecardCase
from benchmarks.fidelity.conditions import Conditions
from benchmarks.fidelity.manoeuvres import MANOEUVRES, SHEET_MANOEUVRES, drive_all, manoeuvres_on
from benchmarks.tools import append_record, record_header
from usarmjx.engines.base import choose_engine, choose_solver
from usarmjx.models.compile.physics import PHYSICS, Physics
from usarmjx.models.robots import ROBOTS

NO_RECORD = RecordOptions()
TOLERATED = 0.1
"""Share of the reference by which a number may differ."""
Card = dict[str, dict[str, float]]
"""The number of each manoeuvre of each class."""


ALL_MANOEUVRES = SHEET_MANOEUVRES | MANOEUVRES


def _drive(name: str, conditions: Conditions, engine: str) -> dict[str, float]:
    return drive_all(conditions, ROBOTS.get(name), manoeuvres_on(engine))


def measure_cards(
    settings: Sequence[Conditions], names: Iterable[str], jobs: int = 1, engine: str = "c"
) -> list[Card]:
    """Return the manoeuvre cards of several conditions, driven by `jobs` processes at once."""
    classes = list(names)
    work = [(name, conditions, engine) for conditions in settings for name in classes]
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
            slack = max(ALL_MANOEUVRES[manoeuvre].least, TOLERATED * abs(wanted))
            if not abs(found - wanted) <= slack:
                yield name, manoeuvre, wanted, found


def write_scorecard(case: ScorecardCase, options: RecordOptions = NO_RECORD) -> str:
    """Measure settings and engine beside the reference settings on `c`; append a record; return a summary.

    Raises:
        UnknownNameError: There is no such class, or no such settings.
    """
    physics = case.replaced(PHYSICS.get(case.physics))
    classes = [ROBOTS.get(name).name for name in case.robot or ROBOTS.names()]
    header = record_header("physics", host=True, note=options.note)
    engine = choose_engine(case.engine, "batch")
    conditions = Conditions(), Conditions(physics, engine)
    reference, card = measure_cards(conditions, classes, case.jobs, engine)
    record: dict[str, Any] = {
        **header,
        "case": {"classes": classes, "jobs": case.jobs, "engine": engine},
        "scene": None,
        "rates": {},
        "baselines": {"reference settings": {"what": "each number has the reference's before it"}},
        "reference": _settings(Physics(), "c"),
        "settings": _settings(physics, engine),
        "units": {name: manoeuvre.unit for name, manoeuvre in manoeuvres_on(engine).items()},
        "numbers": {
            name: {key: [_known(value), _known(card[name][key])] for key, value in numbers.items()}
            for name, numbers in reference.items()
            if numbers
        },
        "differing": [list(row[:2]) for row in differences(reference, card)],
    }
    append_record(record, options.json)
    return (summary if engine == "c" else engine_summary)(reference, card)


def _settings(physics: Physics, engine: str) -> dict[str, Any]:
    """Return settings as a record has them, with the solver by its name."""
    solver = choose_solver(physics, engine)
    return asdict(physics) | {"solver": solver}


def _known(value: float) -> float | None:
    """Return a number as JSON has it, which knows no NaN."""
    return value if math.isfinite(value) else None


def summary(reference: Card, card: Card) -> str:
    """Return a table of both numbers of the manoeuvres that differ, for people."""
    apart = list(differences(reference, card))
    total = sum(len(numbers) for numbers in reference.values())
    head = f"{total - len(apart)} of {total} numbers within {TOLERATED:.0%} of the reference; the others:"
    return "\n".join([head, *(_row(*row) for row in apart)])


def engine_summary(reference: Card, card: Card) -> str:
    """Return a table of both numbers of all manoeuvres, for people; * marks those that differ."""
    apart = {row[:2] for row in differences(reference, card)}
    return "\n".join(
        f"{_row(name, manoeuvre, wanted, card[name][manoeuvre])}{' *' * ((name, manoeuvre) in apart)}"
        for name, numbers in reference.items()
        for manoeuvre, wanted in numbers.items()
    )


def _row(name: str, manoeuvre: str, wanted: float, found: float) -> str:
    return f"{name:12} {manoeuvre:13} {wanted:8.3f} -> {found:8.3f} {ALL_MANOEUVRES[manoeuvre].unit}"
