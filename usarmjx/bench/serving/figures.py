"""Figures of several runs: gathered by their names, as medians with their spread, or why there is none."""

import statistics
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias, TypeVar

from usarmjx.base.errors import UsarmjxError

Measured = TypeVar("Measured")
DIGITS = 5
"""Decimals of figures."""


@dataclass(frozen=True)
class Missing:
    """Stands for a figure that could not be measured.

    Attributes:
        reason: Why.
    """

    reason: str


Figure: TypeAlias = float | Missing | Sequence[float | Missing]
"""A measurement, none, or several of the same."""
FigureTree: TypeAlias = Mapping[str, Any]
"""Figures by name; whole parts may be missing or have names of their own."""


def attempt(measure: Callable[[], Measured]) -> Measured | Missing:
    """Return what is measured, or why it cannot be: others are not to fail with it."""
    try:
        return measure()
    except (UsarmjxError, OSError) as error:
        return Missing(str(error))


def gather(runs: Sequence[Figure | FigureTree]) -> dict[str, Any]:
    """Return the figures of several runs by name, each as `spread` has it."""
    trees = [run for run in runs if isinstance(run, Mapping)]
    if not trees:
        return spread([run for run in runs if not isinstance(run, Mapping)])
    names = dict.fromkeys(name for tree in trees for name in tree)
    return {
        name: gather(
            [run.get(name, Missing("not reached")) if isinstance(run, Mapping) else run for run in runs]
        )
        for name in names
    }


def spread(figures: Sequence[Figure]) -> dict[str, Any]:
    """Return median, least and most of measurements and all of them, and why some are missing."""
    values: list[float] = []
    reasons: dict[str, None] = {}
    for figure in figures:
        for one in figure if isinstance(figure, Sequence) else [figure]:
            if isinstance(one, Missing):
                reasons[one.reason] = None
            else:
                values.append(round(one, DIGITS))
    found: dict[str, Any] = {"median": None}
    if values:
        median = round(statistics.median(values), DIGITS)
        found = {"median": median, "least": min(values), "most": max(values), "values": values}
    return found | ({"missing": list(reasons)} if reasons else {})


def rows(gathered: Mapping[str, Any], path: tuple[str, ...] = ()) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the name and the spread of every figure; a name is that of its part, parts, and its own."""
    if "median" in gathered:
        yield " ".join(path), gathered
        return
    for name, inner in gathered.items():
        yield from rows(inner, (*path, name))


def ratios(ours: Mapping[str, Any], theirs: Mapping[str, Any]) -> dict[str, float | None]:
    """Return the other medians as multiples of ours, by name; None where that makes no sense."""
    other = dict(rows(theirs))
    found: dict[str, float | None] = {}
    for name, figure in rows(ours):
        own, their = figure["median"], other.get(name, {"median": None})["median"]
        found[name] = round(their / own, 3) if own and their and own > 0 < their else None
    return found


def show(figure: Mapping[str, Any]) -> str:
    """Return a figure as text: its median, and in brackets least and most if there are several."""
    if figure["median"] is None:
        return "-"
    if len(figure["values"]) == 1:
        return f"{figure['median']:.3f}"
    return f"{figure['median']:.3f} ({figure['least']:.3f}-{figure['most']:.3f})"
