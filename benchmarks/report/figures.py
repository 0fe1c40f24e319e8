"""Figures of docs/evidence/speed.md: cost over size, and simulated time of peers, ours and others'."""

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from benchmarks.peering.contest import OURS
from benchmarks.report.laws import Law, laws_of
from benchmarks.report.records import BenchRecord
from benchmarks.report.tables import of
from usarmjx.plots.style import (
    COLUMN,
    MOST_PANELS,
    PAGE,
    PALETTE,
    figure_style,
    panels_of,
    save_figure,
    series,
)

DIGEST = "Description"
"""Where a PNG says of which records it is."""
SHOWN_LINES = 8
"""Lines of a panel that its legend names, at most."""
ROW = 0.17
"""Height of a row of a dot plot [inches]."""
UNITS = {
    "ms a step": "cost of a step [ms]",
    "ms a scan": "cost of a scan [ms]",
    "ms an evaluation": "cost of an evaluation [ms]",
    "CPU s a simulated s": "CPU time per simulated time",
    "CPU ms an update": "CPU time of an update [ms]",
    "MB": "memory [MB]",
}
"""Names of costs in figures."""


def draw_laws(records: Sequence[BenchRecord], out: Path, digest: str) -> None:
    """Draw costs over sizes, a panel for each thing that grows and unit; two sizes are no law.

    Args:
        records: The records.
        out: PNG file.
        digest: Of the records, kept in the file.
    """
    panels: dict[tuple[str, str], list[Law]] = {}
    for law in (law for law in laws_of(records) if not math.isnan(law.exponent)):
        panels.setdefault((law.axis, law.unit), []).append(law)
    chosen = sorted(panels.items(), key=lambda item: -max(len(law.sizes) for law in item[1]))[:MOST_PANELS]
    with figure_style():
        figure, axes = panels_of(max(len(chosen), 1), width=COLUMN + (PAGE - COLUMN) * (len(chosen) > 1))
        for panel, ((axis, unit), laws) in zip(axes, chosen, strict=False):
            for number, law in enumerate(laws):
                label = f"{law.group.rpartition(', ')[0]}\ngrows as size to the {law.exponent:.2f}"
                series(panel, law.sizes, law.costs, number, label)
            panel.set(xscale="log", yscale="log", xlabel=axis, ylabel=UNITS.get(unit, unit))
            panel.set(xlim=_decades(x for law in laws for x in law.sizes))
            panel.set(ylim=_decades(y for law in laws for y in law.costs))
            if len(laws) <= SHOWN_LINES:
                panel.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), fontsize=6)
        save_figure(figure, out, **{DIGEST: digest})


def _decades(values: Iterable[float]) -> tuple[float, float]:
    """Return the powers of ten around values, between which labels of a logarithmic axis have room."""
    logs = np.log10(list(values))
    return 10.0 ** math.floor(logs.min()), 10.0 ** max(math.ceil(logs.max()), math.floor(logs.min()) + 1)


def compared(records: Sequence[BenchRecord]) -> list[tuple[str, list[Mapping]]]:
    """Return the runs of peers that are drawn, by name, with what was measured in each.

    Those of both ours and others, but for which a later one on the same machine has all sizes, too.
    """
    runs = [
        (record, [row for row in record.data["rows"] if "speed" in row]) for record in of(records, "peers")
    ]
    found: list[tuple[str, list[Mapping]]] = []
    known: dict[str, list[set[tuple[int, int]]]] = {}
    for record, rows in reversed(runs):
        sizes = {(row["worlds"], row["robots"]) for row in rows}
        later = known.setdefault(record.where, [])
        if len({row["who"] == OURS for row in rows}) == 2 and not any(sizes <= other for other in later):
            later.append(sizes)
            found.insert(0, (f"{record.where}, {record.when}", rows))
    return found


def draw_peers(records: Sequence[BenchRecord], out: Path, digest: str) -> None:
    """Draw simulated robot-seconds per second, a row for each program and size, a panel for each run.

    The runs are the last of `compared`. The bar in a row is real time: as many as there are robots.

    Args:
        records: The records.
        out: PNG file.
        digest: Of the records, kept in the file.
    """
    runs = compared(records)[-MOST_PANELS:]
    with figure_style():
        heights = [1.5 + len(rows) for _, rows in runs] or [1.0]
        figure = Figure(figsize=(PAGE, 0.7 + ROW * (sum(heights) + 1.2 * len(heights))), layout="constrained")
        axes = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights).ravel()
        speeds = [row["robot_seconds_per_s"] for _, rows in runs for row in rows]
        for panel, (machine, rows) in zip(axes, runs, strict=False):
            ordered = sorted(rows, key=lambda row: row["robot_seconds_per_s"])
            for place, row in enumerate(ordered):
                ours, robots = row["who"] == OURS, row["worlds"] * row["robots"]
                style = {"color": PALETTE[0 if ours else 1], "marker": "s" if ours else "o"}
                panel.plot([row["robot_seconds_per_s"]], [place], **style)
                panel.plot([robots], [place], color="#555555", marker="|", markersize=7)
            sizes = {row["worlds"] * row["robots"] for row in rows}
            names = [
                f"{row['who']}: {row['variant']}"
                + (f", {row['worlds'] * row['robots']:,} robots" if len(sizes) > 1 else "")
                for row in ordered
            ]
            panel.set_yticks(range(len(ordered)), names, fontsize=6)
            panel.set(xscale="log", ylim=(-0.6, max(len(ordered), 1) - 0.4), xlim=_decades(speeds))
            robots = f", {sizes.pop():,} robots" if len(sizes) == 1 else ""
            panel.set_title(machine.replace("NVIDIA ", "").replace("(R)", "") + robots, fontsize=7)
        axes[-1].set_xlabel("simulated robot-seconds per second")
        marks = (("s", PALETTE[0], OURS), ("o", PALETTE[1], "others"), ("|", "#555555", "real time"))
        handles = [
            Line2D([], [], marker=mark, color=colour, linestyle="none", label=name)
            for mark, colour, name in marks
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=3)
        save_figure(figure, out, **{DIGEST: digest})


FIGURES = {"performance-laws.png": draw_laws, "performance-peers.png": draw_peers}
"""Files beside the page, and what draws them."""
