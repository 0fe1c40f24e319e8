"""A sweep as a figure: scores over its axes, performance profiles, score against connectivity."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from usarmjx.base.errors import UsageError
from usarmjx.base.estimates import performance_profile
from usarmjx.base.files import write_beside
from usarmjx.sweeps.answers import AxisRow, axes_of, axis_rows, front_points, policy_of, tasks_of
from usarmjx.sweeps.store import StoredSweep
from usarmjx.sweeps.table import scores_of

COLOURS = ("#1f5fa8", "#d1622b", "#3b8a4e", "#8a4fa3", "#7a7a7a", "#b8a11f")
DPI = 100
PANEL = (3.4, 2.7)
"""Width and height of a panel [inches]."""
THRESHOLDS = 101


def plot_sweep(found: StoredSweep, out: Path) -> None:
    """Draw a sweep: a row of panels for each task.

    Args:
        found: The sweep.
        out: PNG file.

    Raises:
        UsageError: Nothing is finished.
        WriteError: The file cannot be written.
    """
    tasks = tasks_of(found)
    if not tasks:
        raise UsageError(f"{found.name} has no finished cells to draw")
    rows = [row for row in axis_rows(found) if row.axis]
    axes = [axis for axis in axes_of(found) if any(row.axis == axis for row in rows)]
    figure = Figure(
        figsize=(PANEL[0] * (len(axes) + 2), PANEL[1] * len(tasks)), dpi=DPI, layout="constrained"
    )
    panels = figure.subplots(len(tasks), len(axes) + 2, squeeze=False)
    policies = list(dict.fromkeys(policy_of(record) for record in found.finished))
    colours = {policy: COLOURS[i % len(COLOURS)] for i, policy in enumerate(policies)}
    for line, task in zip(panels, tasks, strict=True):
        for panel, axis in zip(line, axes, strict=False):
            mine = [row for row in rows if row.task == task and row.axis == axis]
            _axis_panel(panel, axis, mine, colours)
        _profile_panel(line[-2], found, task, colours)
        _front_panel(line[-1], found, task)
        line[0].set_title(f"{task}: score", loc="left", fontsize=10)
    panels[0][-2].legend(fontsize=7)
    FigureCanvasAgg(figure)
    with write_beside(out) as fresh:
        figure.savefig(fresh, format="png")


def _numbers(values: list[str]) -> list[float] | None:
    try:
        return [float(value) for value in values]
    except ValueError:
        return None


def _axis_panel(panel: Axes, axis: str, rows: list[AxisRow], colours: dict[str, str]) -> None:
    if not rows:
        panel.set_axis_off()
        return
    values = list(dict.fromkeys(row.value for row in rows))
    numbers = _numbers(values)
    places = dict(zip(values, range(len(values)) if numbers is None else numbers, strict=True))
    for policy, colour in colours.items():
        mine = sorted((row for row in rows if row.policy == policy), key=lambda row: places[row.value])
        if mine:
            x, y = [places[row.value] for row in mine], [row.mean.value for row in mine]
            panel.plot(x, y, "o-", color=colour, markersize=3)
            ends = [row.mean.low for row in mine], [row.mean.high for row in mine]
            panel.fill_between(x, *ends, color=colour, alpha=0.2, linewidth=0)
    if numbers is None:
        panel.set_xticks(range(len(values)), values, fontsize=7)
    panel.set_xlabel(axis)


def _profile_panel(panel: Axes, found: StoredSweep, task: str, colours: dict[str, str]) -> None:
    scores = {
        policy: np.concatenate(
            [
                scores_of(record)
                for record in found.finished
                if record.settings["task"] == task and policy_of(record) == policy
            ]
            or [np.zeros(0)]
        )
        for policy in colours
    }
    everything = np.concatenate([*scores.values()])
    if not len(everything):
        return
    thresholds = np.linspace(min(0.0, everything.min()), max(everything.max(), 1e-9), THRESHOLDS)
    for policy, values in scores.items():
        if len(values):
            panel.plot(
                thresholds, performance_profile(values, thresholds), color=colours[policy], label=policy
            )
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
