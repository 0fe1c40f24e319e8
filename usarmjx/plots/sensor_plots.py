"""Plots of what sensors see and of how wrong they are, for docs/sensors.md."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Wedge

from usarmjx.base.registry import Registry
from usarmjx.models.arenas import ARENAS
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.plots.palette import save_small
from usarmjx.plots.picture import PAPER, draw_shapes
from usarmjx.plots.sensor_studies import (
    DRIVE_SECONDS,
    PATH_HALF_WIDTH,
    PATH_LENGTH,
    RangeStudy,
    gps_errors,
    ins_paths,
    range_study,
    reported_ranges,
    rfid_range,
    winding_path,
)
from usarmjx.sensors.gps import GpsSettings, largest_error
from usarmjx.sensors.motion import InsSettings
from usarmjx.sensors.ranging import RangeSettings, SonarSettings
from usarmjx.sensors.rfid import RfidSettings, signal_strength

DPI = 100
BLUE, ORANGE, GREEN, PINK, GREY = "#1f5fa8", "#d1622b", "#2c8a4f", "#b5179e", "#8a857a"
BEAM = "#e9a3dc"
ROBOT_POSITION, ROBOT_YAW = (0.6, -3.0), math.radians(10)
"""Where in the yellow arena the robot stands that looks around."""
SONAR_VIEW = ((-2.6, 6.1), (-5.0, -0.9))
"""The part of the plan that sonars are shown on: x and y [m]."""
EXAMPLE_OUTPUT_CURVE = ((0.0, 0.0), (1.0, 1.6), (3.0, 2.4), (5.0, 5.0))
"""The distortion that is shown, in metres."""

ECHO_STYLE: dict[str, Any] = {"fc": "#f2b694", "ec": ORANGE}
NO_ECHO_STYLE: dict[str, Any] = {"fc": "none", "ec": GREY, "ls": ":", "lw": 0.8}
"""Cones of sonars with and without an echo."""

FigureDrawing = Callable[[Figure], None]
PLOTS: Registry[tuple[FigureDrawing, tuple[float, float]]] = Registry("plot")
"""What there is to draw: a function that fills a figure, and its size [inches]."""


def plot(name: str, folder: Path) -> Path:
    """Draw a plot as `sensor-<name>.png` in a folder, which is made if need be; return the file.

    Raises:
        UnknownNameError: No such plot; lists those there are.
    """
    draw, size = PLOTS.get(name)
    figure = Figure(figsize=size, dpi=DPI, facecolor="white", layout="constrained")
    draw(figure)
    path = folder / f"sensor-{name}.png"
    save_small(figure, path)
    return path


def _plan(axes: Axes, title: str) -> None:
    arena = ARENAS.get("yellow")
    (x0, x1), (y0, y1) = arena.extent
    axes.set(
        aspect="equal",
        facecolor=PAPER,
        xlim=(x0 - 0.2, x1 + 0.2),
        ylim=(y0 - 0.2, y1 + 0.2),
        xlabel="x [m]",
        ylabel="y [m]",
    )
    axes.set_title(title, loc="left", fontsize=11)
    draw_shapes(axes, arena)
    axes.spines[:].set_visible(False)


def _robot(axes: Axes, pose: np.ndarray) -> None:
    """Draw a P2AT from above, its front as a corner."""
    length, width = P2AT.dimensions[0] / 2, P2AT.dimensions[1] / 2
    hull = np.array(
        [(-length, -width), (0.4 * length, -width), (length, 0), (0.4 * length, width), (-length, width)]
    )
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    axes.add_patch(
        Polygon(hull @ np.array([[cos, sin], [-sin, cos]]) + pose[:2], fc=BLUE, ec="white", zorder=6)
    )


def draw_laser(axes: Axes, seen: RangeStudy) -> None:
    """Draw the beams of a laser scan and where they ended."""
    for end in seen.ends[seen.hit]:
        axes.plot(*np.stack([seen.origin, end]).T, color=BEAM, lw=0.5, zorder=3)
    axes.plot(*seen.ends[seen.hit].T, ".", color=PINK, ms=4, zorder=5)
    _robot(axes, seen.pose)


def draw_sonars(axes: Axes, seen: RangeStudy) -> None:
    """Draw the cones of sonars up to their echoes, or faint to their range where there is none."""
    for (x, y, yaw), echo, wide, deaf in zip(
        seen.sonars, seen.echoes, seen.beam_angle, seen.no_echo, strict=True
    ):
        low, high = math.degrees(yaw - wide / 2), math.degrees(yaw + wide / 2)
        style = NO_ECHO_STYLE if deaf else ECHO_STYLE
        axes.add_patch(Wedge((x, y), echo, low, high, alpha=0.85, zorder=4, **style))
        if not deaf:
            at = (x + (echo + 0.12) * math.cos(yaw), y + (echo + 0.12) * math.sin(yaw))
            text = axes.annotate(f"{echo:.2f}", at, fontsize=8, ha="center", va="center", zorder=7)
            text.set_bbox({"fc": "white", "ec": "none", "pad": 0.6, "alpha": 0.8})
    _robot(axes, seen.pose)


def _laser(figure: Figure) -> None:
    seen = range_study(ARENAS.get("yellow"), ROBOT_POSITION, ROBOT_YAW)
    axes = figure.add_subplot()
    _plan(axes, f"One scan of a P2AT's RangeScanner in the yellow arena: {len(seen.ends)} beams")
    draw_laser(axes, seen)


def _sonar(figure: Figure) -> None:
    seen = range_study(ARENAS.get("yellow"), ROBOT_POSITION, ROBOT_YAW)
    axes = figure.add_subplot()
    _plan(
        axes, "The sonars of a P2AT, and what they read [m], Noise=0.05, MaxIncidence=1.309; dotted: no echo"
    )
    axes.set(xlim=SONAR_VIEW[0], ylim=SONAR_VIEW[1])
    draw_sonars(axes, seen)


def _rfid(figure: Figure) -> None:
    settings, axes = RfidSettings(), figure.add_subplot()
    distance = np.linspace(0.3, 5.0, 400)
    for blocked, colour, label in ((False, BLUE, "nothing between"), (True, ORANGE, "behind an obstacle")):
        power = signal_strength(settings, distance, np.array(blocked), np)
        reach = rfid_range(settings, blocked=blocked)
        axes.plot(distance, power, color=colour, lw=2, label=label)
        axes.plot(reach, settings.rx_sensitivity_dbm, "o", color=colour, ms=7, zorder=5)
        axes.plot([reach, reach], [-130, settings.rx_sensitivity_dbm], ":", color=colour, lw=1.2)
        axes.annotate(
            f"{reach:.2f} m",
            (reach, -101),
            (7 if not blocked else -7, 0),
            textcoords="offset points",
            ha="left" if not blocked else "right",
            color=colour,
            fontsize=11,
        )
    axes.axhline(settings.rx_sensitivity_dbm, color=GREY, lw=1, ls="--")
    axes.annotate(
        f"dBmRXSensibility = {settings.rx_sensitivity_dbm:g} dBm",
        (5.0, settings.rx_sensitivity_dbm),
        (0, 4),
        textcoords="offset points",
        ha="right",
        color=GREY,
    )
    axes.set(
        xlim=(0, 5.05), ylim=(-104, -46), xlabel="distance of the tag [m]", ylabel="received power [dBm]"
    )
    axes.set_title("RFID, SensingMode=Attenuation: how far a tag is read", loc="left", fontsize=11)
    _plain(axes)
    axes.legend(frameon=False)


def _plain(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#e4e0d6", lw=0.6, zorder=0)
    axes.set_axisbelow(True)


INS_RUNS, INS_SHOWN = 64, 5
"""INS sensors that are driven along the winding way, and how many of them are shown."""
INS_CASES: tuple[tuple[str, dict[str, Any], str], ...] = (
    ("Sigma=0.1, the default", {"Sigma": 0.1}, ORANGE),
    ("Sigma=0, Drifting, Precision=1000", {"Sigma": 0.0, "Drifting": True}, GREEN),
    ("Sigma=0, PolarStep=True", {"Sigma": 0.0, "PolarStep": True}, GREY),
)


def _ins(figure: Figure) -> None:
    *paths_axes, right = figure.subplots(1, 3, width_ratios=(1.1, 1.1, 1))
    times, truth = winding_path(InsSettings().scan_interval)
    for i, (label, settings, colour) in enumerate(INS_CASES):
        paths = ins_paths(INS_RUNS, **settings)
        error = np.linalg.norm(paths - truth[:, :2], axis=-1)
        right.plot(times, np.median(error, 0), color=colour, lw=1.8, label=label)
        if i < len(paths_axes):
            _draw_paths(paths_axes[i], paths[:INS_SHOWN], truth, colour)
            paths_axes[i].set_title(label, loc="left", fontsize=10)
    right.set(xlabel="time [s]", ylabel=f"median error of {INS_RUNS} INS [m]", xlim=(0, DRIVE_SECONDS))
    right.set_ylim(0, 1.35 * right.get_ylim()[1])
    right.legend(frameon=False, fontsize=8, loc="upper left")
    _plain(right)


def _draw_paths(axes: Axes, paths: np.ndarray, truth: np.ndarray, colour: str) -> None:
    for path in paths:
        axes.plot(*path.T, color=colour, lw=0.9)
        axes.plot(*path[-1], "s", color=colour, ms=4, zorder=4)
    axes.plot(*truth[:, :2].T, color="black", lw=1.6, label="true path")
    axes.plot([], [], "-s", color=colour, lw=0.9, ms=4, label=f"{len(paths)} INS and where they end")
    axes.plot(*truth[0, :2], "o", color="white", mec="black", ms=7, zorder=5)
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.set(xlim=(-2, PATH_LENGTH + 4), ylim=(-PATH_HALF_WIDTH - 4, PATH_HALF_WIDTH + 7))
    axes.legend(frameon=False, fontsize=8, ncols=2, loc="upper center")
    _plain(axes)


def _noise(figure: Figure) -> None:
    left, right = figure.subplots(1, 2, sharey=True)
    true = np.linspace(0.0, 6.0, 900, dtype=np.float32)
    plain, curved = SonarSettings(), RangeSettings(noise=0.02, output_curve=EXAMPLE_OUTPUT_CURVE)
    for axes, settings, title in (
        (left, plain, "Noise=0.05"),
        (right, curved, "Noise=0.02, then an OutputCurve"),
    ):
        exact = reported_ranges(true, RangeSettings(output_curve=settings.output_curve))
        axes.plot(true, reported_ranges(true, settings), ".", color=ORANGE, ms=2.5, label="readings")
        axes.plot(true, exact, color=BLUE, lw=1.4, label="without noise")
        axes.set(xlabel="true distance [m]", xlim=(0, 6), ylim=(0, 5.6))
        axes.set_title(title, loc="left", fontsize=10)
        _plain(axes)
    right.plot(*np.array(EXAMPLE_OUTPUT_CURVE).T, "s", color=BLUE, ms=5, label="points of the curve")
    left.set_ylabel("reading [m]")
    left.annotate(
        "no return: MaxRange exactly", (5.95, 5.0), (0, 7), textcoords="offset points", ha="right", fontsize=9
    )
    for axes in (left, right):
        axes.legend(frameon=False, loc="upper left", fontsize=9)


def _gps(figure: Figure) -> None:
    settings = GpsSettings()
    for axes, satellites in zip(figure.subplots(1, 3, sharey=True), (12, 8, 4), strict=True):
        errors, largest = gps_errors(satellites, 400), float(largest_error(settings, np.array(satellites)))
        axes.plot(*errors.T, ".", color=BLUE, ms=3)
        corners = largest * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
        axes.add_patch(Polygon(corners, fc="none", ec=ORANGE, ls="--", lw=1.2))
        axes.plot(0, 0, "+", color="black", ms=12)
        axes.set(aspect="equal", xlim=(-2.8, 2.8), ylim=(-2.8, 2.8), xlabel="error of x (north) [m]")
        axes.set_title(f"{satellites} satellites: at most {largest:g} m", loc="left", fontsize=10)
        _plain(axes)
    figure.axes[0].set_ylabel("error of y (west) [m]")


PLOTS.add("laser", (_laser, (9.0, 6.2)))
PLOTS.add("sonar", (_sonar, (9.5, 5.1)))
PLOTS.add("rfid", (_rfid, (8.0, 4.4)))
PLOTS.add("ins", (_ins, (12.0, 4.0)))
PLOTS.add("noise", (_noise, (9.5, 4.2)))
PLOTS.add("gps", (_gps, (10.5, 3.9)))
