"""Figures of docs/performance.md: cost over size, and simulated time over robots, ours and others'."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from benchmarks.peering.contest import OURS
from benchmarks.report.laws import laws_of
from benchmarks.report.records import BenchRecord
from benchmarks.report.tables import of
from usarmjx.base.files import atomic_write

DPI, PANEL = 100, (4.6, 3.6)
"""Width and height of a panel [inches]."""
DIGEST = "Description"
"""Where a PNG says of which records it is."""
OUR_LINES, OTHERS_LINES = "s-", "o--"
"""Marks and lines of ours and of others."""
COLOURS = colormaps["tab20"].colors  # pyright: ignore[reportAttributeAccessIssue] - of those made of a list


def _save(figure: Figure, out: Path, digest: str) -> None:
    FigureCanvasAgg(figure)
    with atomic_write(out) as fresh:
        figure.savefig(fresh, format="png", metadata={DIGEST: digest})


def _logarithmic(panel: Axes, x: str, y: str) -> None:
    panel.set_xscale("log")
    panel.set_yscale("log")
    panel.set_xlabel(x, fontsize=9)
    panel.set_ylabel(y, fontsize=9)
    panel.grid(visible=True, which="major", alpha=0.3)
    panel.tick_params(labelsize=8)


def draw_laws(records: Sequence[BenchRecord], out: Path, digest: str) -> None:
    """Draw all laws, a panel for each thing that grows and unit.

    Args:
        records: The records.
        out: PNG file.
        digest: Of the records, kept in the file.
    """
    panels: dict[tuple[str, str], list] = {}
    for law in laws_of(records):
        panels.setdefault((law.axis, law.unit), []).append(law)
    figure = Figure(figsize=(PANEL[0] * max(len(panels), 1), PANEL[1]), dpi=DPI, layout="constrained")
    axes = figure.subplots(1, max(len(panels), 1), squeeze=False)[0]
    for panel, ((axis, unit), laws) in zip(axes, panels.items(), strict=False):
        for law in laws:
            label = f"{law.group.rpartition(', ')[0]}: {law.exponent:.2f}"
            panel.plot(law.sizes, law.costs, "o-", markersize=4, label=label)
        _logarithmic(panel, axis, unit)
        if len(laws) <= 8:
            panel.legend(fontsize=6)
    _save(figure, out, digest)


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
    """Draw simulated robot-seconds per second over robots in all, a panel for each run of `compared`.

    The dotted line is real time: as many as there are robots.

    Args:
        records: The records.
        out: PNG file.
        digest: Of the records, kept in the file.
    """
    runs = compared(records)
    figure = Figure(figsize=(2 * PANEL[0], 1.4 * PANEL[1] * max(len(runs), 1)), dpi=DPI, layout="constrained")
    axes = figure.subplots(max(len(runs), 1), 1, squeeze=False)[:, 0]
    for panel, (machine, rows) in zip(axes, runs, strict=False):
        lines: dict[str, list[tuple[int, float]]] = {}
        for row in rows:
            point = row["worlds"] * row["robots"], row["robot_seconds_per_s"]
            lines.setdefault(f"{row['who']}: {row['variant']}", []).append(point)
        for i, (name, points) in enumerate(lines.items()):
            style, colour = OUR_LINES if name.startswith(OURS) else OTHERS_LINES, COLOURS[i % len(COLOURS)]
            panel.plot(*zip(*sorted(points), strict=True), style, color=colour, markersize=5, label=name)
        sizes = sorted({x for points in lines.values() for x, _ in points})
        panel.plot(sizes, sizes, "kx:", label="real time")
        _logarithmic(panel, "robots in all worlds", "simulated robot-seconds per second")
        panel.set_title(machine, loc="left", fontsize=8)
        panel.legend(fontsize=7, bbox_to_anchor=(1.0, 1.0), loc="upper left")
    _save(figure, out, digest)


FIGURES = {"performance-laws.png": draw_laws, "performance-peers.png": draw_peers}
"""Files beside the page, and what draws them."""
