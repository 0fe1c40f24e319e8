"""Cost over size: what a step, a scan, an evaluation takes when worlds, teams, geoms, rays or pairs grow."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from statistics import median

import numpy as np

from benchmarks.report.records import BenchRecord
from benchmarks.report.tables import MarkdownRow, number, of, physics_words, table

MILLISECONDS = 1e3
FEWEST_FOR_LAW = 3
"""Sizes of a law, at least."""


@dataclass(frozen=True)
class Sample:
    """A point of a law.

    Attributes:
        axis: The growing quantity.
        size: Amount of it.
        cost: Cost, in `unit`.
        unit: Of the cost.
        group: Fixed settings; points of one group make a line.
    """

    axis: str
    size: float
    cost: float
    unit: str
    group: str


@dataclass(frozen=True)
class Law:
    """Points that differ in one thing.

    Attributes:
        axis: Its meaning.
        group: Fixed settings.
        unit: Of the costs.
        sizes: Growing (points,).
        costs: The lowest cost of each size (points,).
    """

    axis: str
    group: str
    unit: str
    sizes: tuple[float, ...]
    costs: tuple[float, ...]

    @property
    def exponent(self) -> float:
        """Power of the size by which the cost grows: least squares of the logarithms; NaN of two sizes.

        A line through two points fits them whatever disturbed them, and is no law.
        """
        if len(self.sizes) < FEWEST_FOR_LAW:
            return math.nan
        return float(np.polyfit(np.log(self.sizes), np.log(self.costs), 1)[0])


def laws_of(records: Sequence[BenchRecord]) -> list[Law]:
    """Return a law for each group that has two sizes or more."""
    found: dict[tuple[str, str, str], dict[float, float]] = {}
    for sample in samples_of(records):
        best = found.setdefault((sample.axis, sample.group, sample.unit), {})
        best[sample.size] = min(sample.cost, best.get(sample.size, np.inf))
    return [
        Law(axis, group, unit, *zip(*sorted(points.items()), strict=True))
        for (axis, group, unit), points in found.items()
        if len(points) > 1
    ]


def samples_of(records: Sequence[BenchRecord]) -> Iterator[Sample]:
    """Yield the points that records have for any law."""
    yield from _step_samples(records)
    yield from _team_samples(records)
    yield from _size_samples(records)
    for record in of(records, "rays"):
        case, data = record.case, record.data
        cost = MILLISECONDS * median(data["times_s"]) / case["steps"]
        rays, geoms, kind = data["rays_per_scan"], data["geoms_per_world"], case["robot"]
        yield Sample("rays", rays, cost, "ms a scan", f"{kind}, {geoms} geoms a world, {record.where}")
        size = f"{case['worlds']} x {record.roster}"
        yield Sample("geoms of a world", geoms, cost, "ms a scan", f"{size}, {record.where}")
    for record in of(records, "radio"):
        cost = MILLISECONDS * median(record.data["times_s"]) / record.case["steps"]
        group = f"{record.case['walls']} walls, {record.data.get('counted_on', 'jax')}, {record.where}"
        yield Sample("pairs", record.data["links_per_evaluation"], cost, "ms an evaluation", group)


def _team_samples(records: Sequence[BenchRecord]) -> Iterator[Sample]:
    for record in of(records, "serve"):
        server = record.data["servers"][0]
        for name, load in server["figures"].get("load", {}).items():
            cost = load.get("driving", {}).get("cpu_per_simulated_s", {}).get("median")
            if cost:
                group = f"served and driving, commit {server['commit']}, {record.when}"
                yield Sample("robots of a team", int(name.split()[0]), cost, "CPU s a simulated s", group)
    for record in of(records, "viewer"):
        for name, row in record.data["updates"].items():
            group = f"live page, {record.case['robot']}, {record.when}"
            yield Sample(
                "robots of a team", int(name.split()[0]), row["update_cpu_ms"], "CPU ms an update", group
            )


def _size_samples(records: Sequence[BenchRecord]) -> Iterator[Sample]:
    for record in of(records, "memory"):
        for row in record.data["rows"]:
            group = f"state of {record.roster}, {record.case['engine']}, {record.where}"
            yield Sample("worlds", row["worlds"], row["state_bytes"] / 1e6, "MB", group)
    for record in of(records, "peers"):
        for row in record.data["rows"]:
            if "speed" in row:
                robots = row["worlds"] * row["robots"]
                group = f"{row['who']}, {row['variant']}, {record.when}"
                yield Sample(
                    "robots in all",
                    robots,
                    MILLISECONDS * robots / row["robot_steps_per_s"],
                    "ms a step",
                    group,
                )


def _step_samples(records: Sequence[BenchRecord]) -> Iterator[Sample]:
    for record in of(records, "step"):
        case = record.case
        kinds = {entry.partition(":")[0] for entry in record.roster.split(",")}
        if len(kinds) > 1 or "whole_times_s" not in record.data:
            continue
        cost = MILLISECONDS * median(record.data["whole_times_s"]) / case["steps"]
        robots = int(record.roster.partition(":")[2] or 1)
        rest = (
            f"{case['engine']}, {case.get('generated') or ''}{case['arena']}, "
            f"{', '.join(physics_words(case))}, commit {record.data['commit']}, {record.where}"
        )
        yield Sample("worlds", case["worlds"], cost, "ms a step", f"{record.roster}, {rest}")
        team = f"{case['worlds']} worlds of {kinds.pop()}, {rest}"
        yield Sample("robots of a team", robots, cost, "ms a step", team)


def laws_table(records: Sequence[BenchRecord]) -> str:
    """The laws: points, and the power by which the cost grows."""
    rows: Iterator[MarkdownRow] = (
        [
            law.axis,
            law.group,
            law.unit,
            ", ".join(f"{number(x)}: {number(y)}" for x, y in zip(law.sizes, law.costs, strict=True)),
            "two sizes" if math.isnan(law.exponent) else f"{law.exponent:.2f}",
        ]
        for law in laws_of(records)
    )
    return table(("quantity", "all else", "cost in", "size: cost", "cost grows as size to the"), rows)
