"""Films of teams from above: ways, messages and points for finds, side by side in the same building."""

# Matplotlib leaves the types of keywords open.
# pyright: reportUnknownMemberType=false

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from usarmjx.base.files import atomic_write
from usarmjx.plots.floor_plan import draw_plan
from usarmjx.plots.play import (
    COLUMNS,
    DPI,
    PANEL_WIDTH,
    SentMessage,
    TeamWays,
    draw_finds,
    draw_messages,
    draw_tracks,
    frames_of,
    picture_of,
    plan_height,
    write_gif,
)
from usarmjx.plots.style import PANEL_HEIGHT, figure_style
from usarmjx.train.evaluation.yardsticks import TeamResult

FILM = ".gif"
SPEEDUP = 8.0
"""Speed of a film relative to simulated time."""
RECENT = 5.0
"""Time for which a message is shown [s]."""


def film_teams(task: str, rows: Sequence[TeamResult], seen: TeamWays, out: Path) -> None:
    """Write a film of teams in world 0, `SPEEDUP` times as fast as it was, with the finds of all worlds.

    Args:
        task: Its name.
        rows: One or more teams.
        seen: Has watched them.
        out: GIF file.

    Raises:
        ValueError: It has watched nobody.
        WriteError: The file cannot be written.
    """
    # Episodes of teams may differ in length: the film is as long as the longest.
    steps = max((len(way) for way in seen.ways.values()), default=0)
    if not steps:
        raise ValueError("no team has been watched")
    frames = frames_of(steps)
    with figure_style(), atomic_write(out) as fresh:
        write_gif(team_frames(task, rows, seen, frames), frames * seen.period / SPEEDUP, fresh)


def team_frames(
    task: str, rows: Sequence[TeamResult], seen: TeamWays, frames: np.ndarray
) -> Iterator[np.ndarray]:
    """Yield moments of teams in world 0, by steps, as pictures (height, width, 3)."""
    figure, panels, finds = _panels(rows, seen)
    for number, step in enumerate(frames.tolist()):
        drawn = [finds.axvline(step * seen.period, color="black", lw=0.8)]
        for row, axes in zip(rows, panels, strict=True):
            drawn += draw_tracks(axes, seen.ways[row.name][: step + 1])
            drawn += draw_messages(axes, recent_messages(seen, row.name, step))
        figure.suptitle(f"{task}, {step * seen.period:.0f} s", x=0.01, ha="left")
        yield picture_of(figure)
        if number == 0:
            # Laid out once: a legend that comes and goes moves nothing.
            figure.set_layout_engine("none")
        for one in drawn:
            one.remove()


def recent_messages(seen: TeamWays, name: str, step: int) -> list[SentMessage]:
    """Return a team's messages in the time `RECENT` before the end of a step; after its episode, the last."""
    counts = [0, *seen.sent_counts[name]]
    until = min(step + 1, len(counts) - 1)
    return seen.sent[name][counts[max(0, until - round(RECENT / seen.period))] : counts[until]]


def _panels(rows: Sequence[TeamResult], seen: TeamWays) -> tuple[Figure, list[Axes], Axes]:
    """Return a figure with a plan for each team, and below them the points for finds over time."""
    if seen.arena is None:
        raise ValueError("no team has been watched")
    columns = min(COLUMNS, len(rows))
    lines = -(-len(rows) // columns)
    tall = plan_height(seen.arena, PANEL_WIDTH) + 0.3
    size = (columns * PANEL_WIDTH, lines * tall + PANEL_HEIGHT)
    figure = Figure(figsize=size, dpi=DPI, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(lines + 1, columns, height_ratios=[*[tall] * lines, PANEL_HEIGHT])
    panels = [figure.add_subplot(grid[index // columns, index % columns]) for index in range(len(rows))]
    for row, axes in zip(rows, panels, strict=True):
        draw_plan(axes, seen.arena, words=False, starts=False)
        axes.set_title(row.name, loc="left")
    finds = figure.add_subplot(grid[lines, :])
    draw_finds(finds, rows, seen.period)
    return figure, panels, finds
