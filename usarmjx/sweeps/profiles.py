"""Figure of performance profiles: the share of runs and settings with a score above each threshold."""

# Matplotlib leaves the types of keywords open.
# pyright: reportUnknownMemberType=false

from pathlib import Path

import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.estimates import Resampler, profile_intervals
from usarmjx.plots.style import COLUMN, PALETTE, figure_style, panels_of, save_figure
from usarmjx.sweeps.standings import Standings

POINTS = 61
"""Thresholds of a curve."""


def plot_profiles(found: Standings, out: Path, how: Resampler | None = None) -> None:
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
