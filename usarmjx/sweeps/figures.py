"""A sweep as a figure: scores over its axes, performance profiles, score against connectivity."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from usarmjx.base.errors import UsageError
from usarmjx.base.estimates import performance_profile
from usarmjx.plots.picture import save_small
from usarmjx.sweeps.analysis import (
    AxisRow,
    axes_of,
    axis_rows,
    front_points,
    shared_cells,
    tasks_of,
)
from usarmjx.sweeps.design import policy_of
from usarmjx.sweeps.store import StoredSweep
from usarmjx.sweeps.table import scores_of

COLOURS = ("#1f5fa8", "#d1622b", "#3b8a4e", "#8a4fa3", "#7a7a7a", "#b8a11f")
DPI = 100
PANEL = (3.4, 2.7)
"""Width and height of a panel [inches]."""
MOST_COLUMNS = 5
"""Panels beside each other; what more there are begin another line."""
THRESHOLDS = 101


def plot_sweep(found: StoredSweep, out: Path) -> None:
    """Draw a sweep into a file; see `draw_sweep`.

    Args:
        found: The sweep.
        out: PNG file.

    Raises:
        UsageError: Nothing is finished.
        WriteError: The file cannot be written.
    """
    save_small(draw_sweep(found), out)


def draw_sweep(found: StoredSweep) -> Figure:
    """Draw a sweep: its panels for each task.

    Raises:
        UsageError: Nothing is finished.
    """
    tasks = tasks_of(found)
    if not tasks:
        raise UsageError(f"{found.name} has no finished cells to draw")
    rows = axis_rows(found)
    axes = [axis for axis in axes_of(found) if any(row.axis == axis for row in rows)]
    lines = -(-(len(axes) + 2) // MOST_COLUMNS)
    columns = -(-(len(axes) + 2) // lines)
    size = PANEL[0] * columns, PANEL[1] * lines * len(tasks)
    figure = Figure(figsize=size, dpi=DPI, layout="constrained")
    panels = figure.subplots(lines * len(tasks), columns, squeeze=False).reshape(len(tasks), -1)
    policies = list(dict.fromkeys(policy_of(record) for record in found.finished))
    colours = {policy: COLOURS[i % len(COLOURS)] for i, policy in enumerate(policies)}
    for line, task in zip(panels, tasks, strict=True):
        drawn: list[Axes] = []
        for panel, axis in zip(line, axes, strict=False):
            mine = [row for row in rows if (row.task, row.axis) == (task, axis)]
            drawn += [panel] if _axis_panel(panel, axis, mine, colours) else []
        _alike(drawn)
        profile, front, *spare = line[len(axes) :]
        _profile_panel(profile, found, task, colours)
        _front_panel(front, found, task)
        for panel in spare:
            panel.set_axis_off()
        line[0].set_title(f"{task}: score", loc="left", fontsize=10)
    return figure


def _alike(panels: Sequence[Axes]) -> None:
    """Give all panels the same scores, so that an axis which matters little looks so."""
    if panels:
        lows, highs = zip(*(panel.get_ylim() for panel in panels), strict=True)
        for panel in panels:
            panel.set_ylim(min(lows), max(highs))


def _axis_panel(panel: Axes, axis: str, rows: list[AxisRow], colours: dict[str, str]) -> bool:
    """Draw scores over an axis; return whether there are some."""
    if not rows:
        panel.set_axis_off()
        return False
    values = list(dict.fromkeys(row.value for row in rows))
    numbers = [value.place for value in values if value.place is not None]
    named = len(numbers) < len(values)
    places = dict(zip(values, range(len(values)) if named else numbers, strict=True))
    for policy, colour in colours.items():
        mine = sorted((row for row in rows if row.policy == policy), key=lambda row: places[row.value])
        if not mine:
            continue
        x, y = [places[row.value] for row in mine], [row.mean.value for row in mine]
        low, high = [row.mean.low for row in mine], [row.mean.high for row in mine]
        label = cells_told(
            policy,
            sum(row.cells for row in mine),
            sum(row.left_out for row in mine),
            any(row.own for row in mine),
        )
        if len(mine) == 1:
            _point(panel, (x[0], y[0]), (low[0], high[0]), colour, label)
            continue
        panel.plot(x, y, "o-", color=colour, markersize=3, label=label)
        panel.fill_between(x, low, high, color=colour, alpha=0.2, linewidth=0)
    if named:
        panel.set_xticks(range(len(values)), [value.text for value in values], fontsize=7)
    panel.set_xlabel(axis)
    if any(row.left_out or row.own for row in rows):
        panel.legend(fontsize=6)
    return True


def _point(
    panel: Axes, place: tuple[float, float], ends: tuple[float, float], colour: str, label: str
) -> None:
    """Draw a single point with its interval, where it has one."""
    (x, y), (low, high) = place, ends
    bar = [[y - low], [high - y]] if np.isfinite(ends).all() else None
    panel.errorbar([x], [y], yerr=bar, fmt="o", color=colour, markersize=3, capsize=3, label=label)


def cells_told(policy: str, used: int, left_out: int, own: bool) -> str:
    """Return a policy for a legend, with its cells where the other policies have not all of them.

    Args:
        policy: As text.
        used: Cells that are shown.
        left_out: Cells that the others have not.
        own: Whether the policies have none in common.
    """
    if own:
        return f"{policy}, its own {used} cells"
    return f"{policy}, {used} of {used + left_out} cells" if left_out else policy


def _profile_panel(panel: Axes, found: StoredSweep, task: str, colours: dict[str, str]) -> None:
    mine = [record for record in found.finished if record.settings["task"] == task]
    compared, own = shared_cells(mine)
    scores = {
        policy: np.concatenate([scores_of(record) for record in cells]) for policy, cells in compared.items()
    }
    everything = np.concatenate([*scores.values()])
    if not len(everything):
        return
    thresholds = np.linspace(min(0.0, everything.min()), max(everything.max(), 1e-9), THRESHOLDS)
    for policy, values in scores.items():
        there = sum(policy_of(record) == policy for record in mine)
        label = cells_told(policy, len(compared[policy]), there - len(compared[policy]), own)
        if len(values):
            panel.plot(
                thresholds, performance_profile(values, thresholds), color=colours[policy], label=label
            )
    panel.legend(fontsize=7)
    panel.set_xlabel("score above")
    panel.set_ylabel("share of episodes")


def _front_panel(panel: Axes, found: StoredSweep, task: str) -> None:
    points = [point for point in front_points(found) if point.task == task]
    if not points:
        panel.set_axis_off()
        return
    panel.plot([p.connectivity for p in points], [p.score for p in points], ".", color="#b0b0b0")
    best = sorted((p for p in points if p.best), key=lambda p: p.connectivity)
    panel.plot([p.connectivity for p in best], [p.score for p in best], "o-", color=COLOURS[1], markersize=3)
    panel.set_xlabel("connectivity")
    panel.set_ylabel("score")
