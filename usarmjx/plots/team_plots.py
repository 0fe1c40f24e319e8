"""Discoveries of teams over an episode, and the paths of their robots."""

# Matplotlib leaves the types of keywords open.
# pyright: reportUnknownMemberType=false

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from usarmjx.models.types.arena import ArenaSpec
from usarmjx.plots.floor_plan import draw_plan
from usarmjx.plots.play import WORLD, positions_of
from usarmjx.plots.style import PAGE, PALETTE, PANEL_HEIGHT, figure_style, save_figure
from usarmjx.train.envs.env import Env, EnvState
from usarmjx.train.evaluation.yardsticks import QUARTERS, TeamResult

COLUMNS = 3
PLAN_WIDTH = PAGE / COLUMNS
"""Width of a plan [inches]."""


class TeamWays:
    """Tracks of each team's robots in world 0: a `watch` of `measure_teams`.

    Attributes:
        arena: Arena of world 0.
        ways: By team: x, y [m] and yaw [rad] of its robots at the begin of each step, [(robots, 3), ...].
        period: Length of a step [s].
    """

    def __init__(self) -> None:
        self.arena: ArenaSpec | None = None
        self.ways: dict[str, list[np.ndarray]] = {}
        self.period = 0.0

    def __call__(self, name: str, env: Env, state: EnvState) -> None:
        """Take down where they are."""
        if self.arena is None:
            self.arena, self.period = env.batch.arena_of(state.batch, WORLD), env.period
        self.ways.setdefault(name, []).append(positions_of(env, state)[0])


def draw_finds(axes: Axes, rows: Sequence[TeamResult], period: float) -> None:
    """Draw the points for finds over time, a line for each team, and the quarters of the time.

    The legend is above the panel, where it covers no line.
    """
    for number, row in enumerate(rows):
        times = period * np.arange(len(row.finds) + 1)
        label = f"{row.name}: score {row.score.value:.1f}"
        axes.plot(times, [0.0, *row.finds], color=PALETTE[number % len(PALETTE)], label=label)
    end = period * max(len(row.finds) for row in rows)
    for share in QUARTERS:
        axes.axvline(share * end, color="#999999", lw=0.8, ls=":")
    axes.set(xlim=(0, end), ylim=(0, None), xlabel="time [s]", ylabel="points for finds")
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=COLUMNS)


def draw_ways(axes: Axes, arena: ArenaSpec, way: Sequence[np.ndarray], name: str) -> None:
    """Draw an arena from above with the ways of a team's robots: from rings to dots."""
    draw_plan(axes, arena, words=False, starts=False)
    places = np.stack(way)
    for robot in range(places.shape[1]):
        colour = PALETTE[robot % len(PALETTE)]
        axes.plot(places[:, robot, 0], places[:, robot, 1], color=colour, lw=0.9, zorder=8)
        axes.plot(*places[0, robot, :2], "o", mfc="none", color=colour, zorder=9)
        axes.plot(*places[-1, robot, :2], "o", color=colour, zorder=9)
    axes.set_title(name)


def plot_teams(task: str, rows: Sequence[TeamResult], seen: TeamWays, out: Path) -> None:
    """Draw what teams found over time, and below it the ways of each in world 0.

    Args:
        task: Its name.
        rows: One or more teams.
        seen: Has watched them.
        out: PNG, PDF, SVG or EPS file.

    Raises:
        ValueError: It has watched nobody.
        UsageError: Another suffix.
        WriteError: The file cannot be written.
    """
    if seen.arena is None:
        raise ValueError("no team has been watched")
    lines = -(-len(rows) // COLUMNS)
    (x0, x1), (y0, y1) = seen.arena.extent
    tall = PLAN_WIDTH * min(2.0, max(0.4, (y1 - y0) / (x1 - x0))) + 0.2
    with figure_style():
        figure = Figure(figsize=(PAGE, PANEL_HEIGHT + lines * tall), layout="constrained")
        grid = figure.add_gridspec(1 + lines, COLUMNS, height_ratios=[PANEL_HEIGHT, *[tall] * lines])
        draw_finds(figure.add_subplot(grid[0, :]), rows, seen.period)
        for index, row in enumerate(rows):
            axes = figure.add_subplot(grid[1 + index // COLUMNS, index % COLUMNS])
            draw_ways(axes, seen.arena, seen.ways[row.name], row.name)
        figure.suptitle(f"{task}; paths in {seen.arena.name}", x=0.01, ha="left", fontsize=8)
        save_figure(figure, out)
