"""A recorded mission as a figure for a paper: plan, ways, scans, radio, victims met, and all over time."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from usarmjx.base.backend import numpy_backend
from usarmjx.base.files import write_beside
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.plots.floor_plan import draw_plan
from usarmjx.plots.mission import RecordedMission, RobotWay, read_mission
from usarmjx.plots.picture import ARROW
from usarmjx.plots.play import COLOURS
from usarmjx.plots.radio_map import MIN_STEP, power_map
from usarmjx.recording.reader import Recording

WIDTH = 11.0
"""Of the figure [inches]."""
DPI = 150
SCAN, FOUND = "#0f8b8d", "#c4122f"
STATION = "ComStation"
"""The class of robot from which the radio's power is drawn; without one, from where the first began."""
INSIDE: dict[str, Any] = {"scalex": False, "scaley": False}
"""What is drawn so leaves the picture as large as it is."""
GRID_POINTS = 160
"""Points of the radio's map along the longer side of the arena."""
SMOOTHED = 1.0
"""Speeds are averaged over this time [s]."""


def plot_recording(
    recording: Recording, paths: Sequence[Path], world: int = 0, span: tuple[float, float] = (0.0, np.inf)
) -> list[Path]:
    """Draw a recorded mission; return the files.

    Args:
        recording: The recording.
        paths: PNG, PDF or SVG files.
        world: Which world.
        span: From when to when [s].

    Raises:
        UsageError: There is no such world, or nothing in it.
        WriteError: A file cannot be written.
    """
    figure = mission_figure(read_mission(recording, world, span))
    for path in paths:
        with write_beside(path) as fresh:
            figure.savefig(fresh, format=path.suffix[1:].lower() or "png", dpi=DPI)
    return [*paths]


def mission_figure(mission: RecordedMission) -> Figure:
    """Return the figure of a mission."""
    (x0, x1), (y0, y1) = mission.arena.extent
    tall = WIDTH / 2 * min(1.4, max(0.5, (y1 - y0) / (x1 - x0)))
    figure = Figure(figsize=(WIDTH, tall + 2.6), dpi=DPI, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 1, height_ratios=[tall, 2.4])
    above = grid[0].subgridspec(1, 2)
    _draw_ways(figure.add_subplot(above[0]), mission)
    _draw_power(figure, figure.add_subplot(above[1]), mission)
    panels = [_draw_distance, _draw_speed, _draw_battery]
    panels.append(_draw_score if mission.scores else _draw_found)
    below = grid[1].subgridspec(1, len(panels))
    for place, draw in enumerate(panels):
        axes = figure.add_subplot(below[place])
        draw(axes, mission)
        axes.set_xlabel("time [s]", fontsize=8)
        axes.tick_params(labelsize=7)
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def _colour(place: int) -> str:
    return COLOURS[place % len(COLOURS)]


def _draw_ways(axes: Axes, mission: RecordedMission) -> None:
    """Draw the plan, where beams ended, the robots' ways and the victims that were met."""
    draw_plan(axes, mission.arena, words=False, starts=False)
    axes.plot(*mission.scans.T, ".", ms=1.0, color=SCAN, alpha=0.4, zorder=6, rasterized=True, **INSIDE)
    for place, way in enumerate(mission.ways):
        _draw_way(axes, way, _colour(place))
    for victim, (time, _) in sorted(mission.found.items(), key=lambda item: item[1]):
        at = mission.arena.victims[victim].at[:2]
        axes.plot(*at, "o", ms=13, mfc="none", mec=FOUND, mew=1.6, zorder=10, **INSIDE)
        axes.annotate(
            f"{time:.0f} s", at, (8, 6), textcoords="offset points", fontsize=7, color=FOUND, zorder=10
        )
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0.0), fontsize=7, frameon=False, ncols=4)
    found = f", {len(mission.found)} of {len(mission.arena.victims)} victims met" if mission.found else ""
    axes.set_title(f"{mission.arena.name}: ways and scans{found}", loc="left", fontsize=10)


def _draw_way(axes: Axes, way: RobotWay, colour: str) -> None:
    poses = np.array(way.poses)
    axes.plot(*poses[:, :2].T, color=colour, lw=1.6, zorder=8, label=f"{way.name} ({way.robot})", **INSIDE)
    axes.plot(*poses[0, :2], "o", color=colour, ms=4, mec="white", mew=0.5, zorder=9, **INSIDE)
    cos, sin = np.cos(poses[-1, 2]), np.sin(poses[-1, 2])
    marker = ARROW @ np.array([[cos, sin], [-sin, cos]])
    axes.plot(*poses[-1, :2], marker=marker, color=colour, ms=11, mec="white", mew=0.5, zorder=9, **INSIDE)


def _draw_power(figure: Figure, axes: Axes, mission: RecordedMission) -> None:
    """Draw the radio's power all over the arena, from a station or from where the first robot began."""
    station = next((way for way in mission.ways if way.robot == STATION), mission.ways[0])
    source = station.poses[0][:2]
    step = max(MIN_STEP, np.ptp(mission.arena.extent, axis=1).max() / GRID_POINTS)
    with numpy_backend():  # compiled it would take longer
        drawn = power_map(mission.arena, source, step=step)
    draw_plan(axes, mission.arena, words=False, starts=False)
    top = np.percentile(drawn.power, 99.5)
    colours = axes.pcolormesh(
        drawn.x,
        drawn.y,
        drawn.power,
        cmap="viridis",
        vmax=top,
        shading="nearest",
        alpha=0.55,
        zorder=5,
        rasterized=True,
    )
    cutoff = RadioSettings().cutoff
    if drawn.power.min() < cutoff < drawn.power.max():
        axes.contour(drawn.x, drawn.y, drawn.power, [cutoff], colors="#d1622b", linestyles="solid", zorder=6)
    for place, way in enumerate(mission.ways):
        axes.plot(*np.array(way.poses)[:, :2].T, color=_colour(place), lw=1.0, zorder=8, **INSIDE)
    axes.plot(*source, "*", color="white", mec="black", ms=14, zorder=9)
    figure.colorbar(colours, ax=axes, shrink=0.7, label="received power [dBm]")
    axes.set_title(f"radio power from {station.name}", loc="left", fontsize=10)


def _travelled(way: RobotWay) -> np.ndarray:
    """Return how far a robot had gone at each of its times [m]."""
    steps = np.linalg.norm(np.diff(np.array(way.poses)[:, :2], axis=0), axis=-1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _draw_distance(axes: Axes, mission: RecordedMission) -> None:
    for place, way in enumerate(mission.ways):
        axes.plot(way.times, _travelled(way), color=_colour(place), lw=1.2)
    axes.set_title("distance travelled [m]", loc="left", fontsize=9)


def _draw_speed(axes: Axes, mission: RecordedMission) -> None:
    for place, way in enumerate(mission.ways):
        times, gone = np.array(way.times), _travelled(way)
        before = np.interp(times - SMOOTHED, times, gone)
        passed = np.minimum(times - times[0], SMOOTHED)
        axes.plot(times, (gone - before) / np.maximum(passed, 1e-9), color=_colour(place), lw=1.0)
    axes.set_title("speed [m/s]", loc="left", fontsize=9)


def _draw_battery(axes: Axes, mission: RecordedMission) -> None:
    for place, way in enumerate(mission.ways):
        axes.plot(way.times, np.array(way.battery) / 60.0, color=_colour(place), lw=1.2)
    axes.set_title("battery left [min]", loc="left", fontsize=9)
    axes.set_ylim(bottom=0)


def _draw_score(axes: Axes, mission: RecordedMission) -> None:
    times, scores = zip(*mission.scores, strict=True)
    axes.step(times, scores, where="post", color="#333333", lw=1.2)
    axes.set_title("score", loc="left", fontsize=9)


def _draw_found(axes: Axes, mission: RecordedMission) -> None:
    first, last = (pick(time for way in mission.ways for time in way.times) for pick in (min, max))
    times = sorted(time for time, _ in mission.found.values())
    axes.step([first, *times, last], [*range(len(times) + 1), len(times)], where="post", color=FOUND, lw=1.4)
    axes.set_ylim(0, max(1, len(mission.arena.victims)))
    axes.set_title(f"victims met (of {len(mission.arena.victims)})", loc="left", fontsize=9)
