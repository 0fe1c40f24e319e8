"""A sweep as figures: scores over its axes, performance profiles, score against connectivity."""

# Matplotlib leaves the types of keywords open.
# pyright: reportUnknownMemberType=false

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from usarmjx.base.errors import UsageError
from usarmjx.base.estimates import Resampler, performance_profile, profile_intervals
from usarmjx.plots.style import (
    COLUMN,
    FEWEST_FOR_LINE,
    MARKS,
    MOST_PANELS,
    PALETTE,
    check_figure,
    figure_style,
    numbered,
    panels_of,
    save_figure,
    setting_name,
)
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

if TYPE_CHECKING:
    from usarmjx.sweeps.standings import Standings

THRESHOLDS = 101
MOST_LETTERS, MOST_NUMBERS = 36, 5
"""Largest number of letters, and of numbers, that fit along an axis."""
Panel = Callable[[Axes], None]
"""Draws a panel."""
POINTS = 61
"""Thresholds of a curve."""


def plot_sweep(found: StoredSweep, out: Path) -> list[Path]:
    """Draw a sweep into files, and return them; see `draw_sweep`.

    Args:
        found: The sweep.
        out: PNG, PDF, SVG or EPS file; further figures have numbers: `x.pdf`, `x-2.pdf`.

    Raises:
        UsageError: Nothing is finished, or another suffix.
        WriteError: A file cannot be written.
    """
    check_figure(out)
    files: list[Path] = []
    for number, figure in enumerate(draw_sweep(found)):
        files.append(numbered(out, number))
        save_figure(figure, files[-1])
    return files


def draw_sweep(found: StoredSweep) -> list[Figure]:
    """Draw a sweep: figures of at most `MOST_PANELS` panels for each task.

    Raises:
        UsageError: Nothing is finished.
    """
    tasks = tasks_of(found)
    if not tasks:
        raise UsageError(f"{found.name} has no finished cells to draw")
    rows = axis_rows(found)
    policies = list(dict.fromkeys(policy_of(record) for record in found.finished))
    with figure_style():
        return [figure for task in tasks for figure in _figures_of(found, task, rows, policies)]


def _figures_of(
    found: StoredSweep, task: str, rows: Sequence[AxisRow], policies: Sequence[str]
) -> list[Figure]:
    """Return the figures of a task."""
    drawn: list[tuple[str, Panel]] = []
    for axis in axes_of(found):
        mine = [row for row in rows if (row.task, row.axis) == (task, axis)]
        if mine:
            drawn.append((axis, partial(_axis_panel, axis=axis, rows=mine, policies=policies)))
    drawn.append(("profile", partial(_profile_panel, found=found, task=task, policies=policies)))
    if any(point.task == task for point in front_points(found)):
        drawn.append(("front", partial(_front_panel, found=found, task=task)))
    figures: list[Figure] = []
    scales: list[Axes] = []
    for start in range(0, len(drawn), MOST_PANELS):
        part = drawn[start : start + MOST_PANELS]
        figure, panels = panels_of(len(part))
        for panel, (name, draw) in zip(panels, part, strict=True):
            panel.set_gid(name)
            draw(panel)
            scales += [panel] if name not in ("profile", "front") else []
        scored = any(name not in ("profile", "front") for name, _ in part)
        figure.suptitle(
            f"{task}: mean score and 95 % interval" if scored else task, x=0.01, ha="left", fontsize=8
        )
        if len(policies) > 1:
            _legend(figure, policies)
        figures.append(figure)
    # Over all figures of the task, so that panels on different pages compare.
    _alike(scales)
    return figures


def _legend(figure: Figure, policies: Sequence[str]) -> None:
    """Draw the legend of all policies below the panels."""
    handles = [
        Line2D([], [], color=_colour(number), marker=_mark(number), label=name)
        for number, name in enumerate(policies)
    ]
    figure.legend(handles, list(policies), loc="outside lower center", ncols=min(len(policies), 4))


def _colour(number: int) -> str:
    return PALETTE[number % len(PALETTE)]


def _mark(number: int) -> str:
    return MARKS[number % len(MARKS)]


def _alike(panels: Sequence[Axes]) -> None:
    """Give all panels the same scores, so that an axis which matters little looks so."""
    if panels:
        lows, highs = zip(*(panel.get_ylim() for panel in panels), strict=True)
        for panel in panels:
            panel.set_ylim(min(lows), max(highs))


def _axis_panel(panel: Axes, axis: str, rows: Sequence[AxisRow], policies: Sequence[str]) -> None:
    """Draw scores over an axis: points with their intervals, joined where there are enough numbers."""
    values = list(dict.fromkeys(row.value for row in rows))
    numbers = [value.place for value in values if value.place is not None]
    # One value that is no number makes all of them names at even distances.
    named = len(numbers) < len(values)
    places = dict(zip(values, range(len(values)) if named else numbers, strict=True))
    # A single value has no span, but methods stand beside each other there, too.
    span = (max(places.values()) - min(places.values())) or 1.0
    there = [name for name in policies if any(row.policy == name for row in rows)]
    for number, policy in enumerate(policies):
        mine = sorted((row for row in rows if row.policy == policy), key=lambda row: places[row.value])
        if not mine:
            continue
        # Beside each other, so that intervals do not cover each other.
        aside = (there.index(policy) - (len(there) - 1) / 2) * 0.02 * span
        x = np.array([float(places[row.value]) for row in mine]) + (aside if len(there) > 1 else 0.0)
        y, low, high = (
            np.array([getattr(row.mean, end) for row in mine], float) for end in ("value", "low", "high")
        )
        label = cells_told(
            policy,
            sum(row.cells for row in mine),
            sum(row.left_out for row in mine),
            any(row.own for row in mine),
        )
        joined = len(mine) >= FEWEST_FOR_LINE and not named
        # Matplotlib draws no bars at all where one is NaN, so cells without an interval have none of length
        # 0.
        bar = np.where(np.isfinite([y - low, high - y]), [y - low, high - y], 0.0)
        style: dict[str, Any] = {"color": _colour(number), "marker": _mark(number), "label": label}
        panel.errorbar(x, y, yerr=bar, linestyle="-" if joined else "none", elinewidth=0.9, **style)
    if named:
        names = [in_lines(value.text) for value in values]
        width = max(len(line) for name in names for line in name.split("\n"))
        turned: dict[str, Any] = {"rotation": 20, "ha": "right"} if width * len(names) > MOST_LETTERS else {}
        panel.set_xticks(range(len(values)), names, **turned)
        panel.set_xlim(-0.5, len(values) - 0.5)
    else:
        panel.xaxis.set_major_locator(MaxNLocator(MOST_NUMBERS, steps=[1, 2, 5, 10]))
    panel.set_xlabel(setting_name(axis))
    panel.set_ylabel("score")
    if any(row.left_out or row.own for row in rows):
        panel.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0))


def in_lines(name: str) -> str:
    """Return the name of a value with a line for each robot class of a team; ranges stay in one line."""
    return name if name.startswith("[") else name.replace(", ", ",\n")


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


def _profile_panel(panel: Axes, found: StoredSweep, task: str, policies: Sequence[str]) -> None:
    mine = [record for record in found.finished if record.settings["task"] == task]
    compared, own = shared_cells(mine)
    scores = {
        policy: np.concatenate([scores_of(record) for record in cells]) for policy, cells in compared.items()
    }
    everything = np.concatenate([*scores.values()])
    if not len(everything):
        return
    # Scores that are all 0 need an axis of some length, too.
    low, high = min(0.0, float(everything.min())), max(float(everything.max()), 1e-9)
    thresholds = np.asarray(np.linspace(low, high, THRESHOLDS), float)
    told = False
    for policy, values in scores.items():
        there = sum(policy_of(record) == policy for record in mine)
        label = cells_told(policy, len(compared[policy]), there - len(compared[policy]), own)
        told |= label != policy
        if len(values):
            profile = performance_profile(values, thresholds)
            panel.plot(thresholds, profile, color=_colour(list(policies).index(policy)), label=label)
    if told:
        panel.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0))
    panel.set_xlabel("score above")
    panel.set_ylabel("share of episodes")
    # A little above 1, so that the frame does not cover a line at 1.
    panel.set_ylim(0.0, 1.02)


def _front_panel(panel: Axes, found: StoredSweep, task: str) -> None:
    points = [point for point in front_points(found) if point.task == task]
    style: dict[str, Any] = {"linestyle": "none", "marker": "."}
    panel.plot([p.connectivity for p in points], [p.score for p in points], color="#b0b0b0", **style)
    best = sorted((p for p in points if p.best), key=lambda p: p.connectivity)
    panel.plot(
        [p.connectivity for p in best],
        [p.score for p in best],
        color=PALETTE[1],
        marker="o",
        linestyle="none",
        label="nobody is better at both",
    )
    panel.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0))
    panel.set_xlabel("share of pairs of robots with a link")
    panel.set_ylabel("score")


def plot_profiles(found: "Standings", out: Path, how: Resampler | None = None) -> None:
    """Draw the performance profile of each method over all tasks, with 95 % bands.

    Raises:
        UsageError: There are no normalised scores.
        WriteError: The file cannot be written.
    """
    tables = {method: own for method in found.methods if (own := found.tables(method)) is not None}
    if not tables:
        raise UsageError("no profiles: the results have no normalised scores")
    highest = max(float(np.nanmax(one)) for own in tables.values() for one in own)
    thresholds = np.linspace(0.0, max(highest, 1.0), POINTS)
    with figure_style():
        figure, (panel,) = panels_of(1, columns=1, width=COLUMN)
        for number, (method, own) in enumerate(tables.items()):
            rows = profile_intervals(own, thresholds.tolist(), how)
            colour = PALETTE[number % len(PALETTE)]
            panel.plot(thresholds, [row.value for row in rows], color=colour, label=method)
            low, high = [row.low for row in rows], [row.high for row in rows]
            panel.fill_between(thresholds, low, high, color=colour, alpha=0.2, linewidth=0)
        panel.set_xlabel("normalised score above")
        panel.set_ylabel("share of runs and settings")
        panel.set_ylim(0.0, 1.02)
        panel.legend()
        save_figure(figure, out)
