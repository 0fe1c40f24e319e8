"""Discoveries of teams over an episode, and the paths of their robots."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from usarmjx.models.types.arena import ArenaSpec
from usarmjx.plots.floor_plan import draw_plan
from usarmjx.plots.picture import save_small
from usarmjx.plots.play import COLOURS, WORLD, positions_of
from usarmjx.train.envs.env import Env, EnvState
from usarmjx.train.evaluation.yardsticks import QUARTERS, TeamResult

COLUMNS = 3
TEAM_WIDTH, TOP_HEIGHT, PANEL_WIDTH = 9.6, 3.2, 3.2
"""Sizes of the figure, of its upper panel, and of a plan [inches]."""
TEAM_DPI = 90


class TeamWays:
    """Tracks of each team's robots in world 0: a `watch` of `measure_teams`.

    Attributes:
        arena: Where world 0 is.
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
    """Draw the points for finds over time, a line for each team, and the quarters of the time."""
    for number, row in enumerate(rows):
        times = period * np.arange(len(row.finds) + 1)
        label = f"{row.name}: score {row.score.value:.1f}"
        axes.plot(times, [0.0, *row.finds], color=COLOURS[number % len(COLOURS)], lw=1.8, label=label)
    end = period * max(len(row.finds) for row in rows)
    for share in QUARTERS:
        axes.axvline(share * end, color="#bbbbbb", lw=0.8, ls=":")
    axes.set(xlim=(0, end), ylim=(0, None), xlabel="time [s]", ylabel="points for finds")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=9, loc="lower right")


def draw_ways(axes: Axes, arena: ArenaSpec, way: Sequence[np.ndarray], name: str) -> None:
    """Draw an arena from above with the ways of a team's robots: from rings to dots."""
    draw_plan(axes, arena, words=False, starts=False)
    places = np.stack(way)
    for robot in range(places.shape[1]):
        colour = COLOURS[robot % len(COLOURS)]
        axes.plot(places[:, robot, 0], places[:, robot, 1], color=colour, lw=1.0, zorder=8)
        axes.plot(*places[0, robot, :2], "o", ms=5, mfc="none", color=colour, zorder=9)
        axes.plot(*places[-1, robot, :2], "o", ms=5, color=colour, zorder=9)
    axes.set_title(name, loc="left", fontsize=9)


def plot_teams(task: str, rows: Sequence[TeamResult], seen: TeamWays, out: Path) -> None:
    """Draw what teams found over time, and below it the ways of each in world 0, to a PNG file.

    Args:
        task: Its name.
        rows: One or more teams.
        seen: Has watched them.
        out: The file.

    Raises:
        ValueError: It has watched nobody.
        WriteError: The file cannot be written.
    """
    if seen.arena is None:
        raise ValueError("no team has been watched")
    lines = -(-len(rows) // COLUMNS)
    (x0, x1), (y0, y1) = seen.arena.extent
    tall = PANEL_WIDTH * min(2.0, max(0.4, (y1 - y0) / (x1 - x0))) + 0.3
    height = TOP_HEIGHT + lines * tall
    figure = Figure(figsize=(TEAM_WIDTH, height), dpi=TEAM_DPI, facecolor="white", layout="constrained")
    grid = figure.add_gridspec(1 + lines, COLUMNS, height_ratios=[TOP_HEIGHT, *[tall] * lines])
    draw_finds(figure.add_subplot(grid[0, :]), rows, seen.period)
    for index, row in enumerate(rows):
        axes = figure.add_subplot(grid[1 + index // COLUMNS, index % COLUMNS])
        draw_ways(axes, seen.arena, seen.ways[row.name], row.name)
    figure.suptitle(f"{task}; ways in {seen.arena.name}", x=0.01, ha="left", fontsize=10)
    save_small(figure, out)
