"""A picture of what a robot did: the arena's plan, its path, and where its sensors believed it was.

A log is what `usarmjx/client/wander.py` writes. Its numbers are in USARSim's axes (y right, z down, yaw
clockwise); the picture is in ours, as the arena's description (y left, z up).
"""

# Matplotlib leaves the types of keywords open.
# pyright: reportUnknownMemberType=false

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from scipy.spatial import ConvexHull

from usarmjx.base.transforms import mat_from_angles
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.shapes import FENDER, GLASS, MIRROR, OPAQUE, SKY, Shape
from usarmjx.plots.style import PAGE, figure_style, save_figure

CIRCLE_POINTS = 32
"""Corners that stand for a circle."""
_ANGLES = np.linspace(0.0, 2 * math.pi, CIRCLE_POINTS, endpoint=False)
CIRCLE = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], -1)
CORNER_SIGNS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)


def outline(shape: Shape) -> np.ndarray:
    """Return the polygon that a solid covers, counter-clockwise (corners, 2) [m]."""
    mat, at = np.asarray(mat_from_angles(*np.array(shape.rotation))), np.array(shape.at)
    points = _corners(shape) @ mat[:2].T
    points = (points[:, None] + _shadow(shape, mat)).reshape(-1, 2) + at[:2]
    # The outline of a convex solid is the hull of its corners' projections.
    return points[ConvexHull(points).vertices]


def height_range(shape: Shape) -> tuple[float, float]:
    """Return the heights of a solid's lowest and highest points [m]."""
    # The last row of a rotation gives heights.
    up = mat_from_angles(*np.array(shape.rotation))[2]
    z = _corners(shape) @ up + shape.at[2]
    # Support of an ellipsoid: its largest height over its centre is the norm of the
    # radii times the direction.
    reach = float(np.linalg.norm(_radii(shape) * up))
    if shape.kind == "cylinder":  # of its end discs
        # A disc reaches as high as its radius times the sine of its tilt.
        reach = shape.size[0] * math.hypot(up[0], up[1])
    return float(z.min()) - reach, float(z.max()) + reach


def area(polygon: np.ndarray) -> float:
    """Return the area of a polygon (corners, 2) [m2]."""
    x, y = polygon.T
    return abs(float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())) / 2


def _corners(shape: Shape) -> np.ndarray:
    """Return the points in its frame that a solid is the hull of, without round ones' radii (n, 3)."""
    if shape.kind == "box":
        return CORNER_SIGNS * shape.size
    if shape.mesh is not None:
        return np.asarray(shape.mesh.vertices, float)
    if shape.heights is not None:
        x, y, base = shape.size
        top = float(np.max(shape.heights.heights))
        # Every second sign is one of the four corners in x and y.
        return np.concatenate(
            [CORNER_SIGNS[::2] * (x, y, 0) - (0, 0, base), CORNER_SIGNS[::2] * (x, y, 0) + (0, 0, top)]
        )
    half = shape.size[1] if shape.kind in ("capsule", "cylinder") else 0.0
    return np.array([(0.0, 0.0, -half), (0.0, 0.0, half)])


def _radii(shape: Shape) -> np.ndarray:
    """Return the radii of the ellipsoid that a round solid has around each of its corners (3,)."""
    if shape.kind == "ellipsoid":
        return np.array(shape.size)
    return np.full(3, shape.size[0]) if shape.kind in ("sphere", "capsule") else np.zeros(3)


def _shadow(shape: Shape, mat: np.ndarray) -> np.ndarray:
    """Return the outline of such an ellipsoid, or the disc of a cylinder, around its centre (n, 2)."""
    if shape.kind == "cylinder":
        return shape.size[0] * CIRCLE @ mat[:2, :2].T
    spread = mat[:2] * _radii(shape)
    if not spread.any():
        return np.zeros((1, 2))
    # A linear image of the unit ball, which is the image of the unit circle under a root of M M^T.
    return CIRCLE @ np.linalg.cholesky(spread @ spread.T).T


SCANNER_RANGE = 20.0
"""Reading of the P2AT's scanner without a hit (captured CONF: MaxRange) [m]."""

ARROW = np.array([(1.0, 0.0), (-0.8, 0.7), (-0.4, 0.0), (-0.8, -0.7)])
"""Marker of the last pose, pointing forward (corners, 2)."""

PAPER, WALL, GROUND_EDGE = "#f7f5ef", "#3b3a36", "#a8987a"
GROUND = LinearSegmentedColormap.from_list("ground", ["#e6dcc3", "#cdbf9f", "#8f7d58"])
DARKEST_HEIGHT = 1.2
"""Ground that is higher is not drawn darker [m]."""
CONTOURS = 12
OVERHEAD = 2.2
"""Solids whose undersides are this much above the highest start pose are over robots' heads [m]."""
STYLES: dict[str, dict[str, Any]] = {
    "ground": {"edgecolor": GROUND_EDGE, "lw": 0.8, "zorder": 2},
    "paint": {"edgecolor": GROUND_EDGE, "lw": 0.3, "zorder": 2.05},
    "wall": {"facecolor": WALL, "edgecolor": WALL, "lw": 0.8, "zorder": 2.1},
    "overhead": {"facecolor": "none", "edgecolor": "#9a958a", "lw": 0.6, "ls": "--", "zorder": 2.3},
    GLASS: {"facecolor": "#c4e6f3", "edgecolor": "#3d9cc4", "lw": 1.0, "zorder": 2.2},
    MIRROR: {"facecolor": "#d8d2ea", "edgecolor": "#6a4fb0", "lw": 1.0, "zorder": 2.2},
    FENDER: {"facecolor": "#ffffff", "edgecolor": "#4c7a3f", "lw": 0.8, "hatch": "xxxx", "zorder": 2.2},
    SKY: {"visible": False},
}
"""Styles of solids: ground, walls, overhead, and materials that are not opaque."""
TRUTH, ODOMETRY, INS, SCAN = "#1f5fa8", "#d1622b", "#2c8a4f", "#b5179e"


def tracked_poses(log: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Return the logged poses in our axes and in the world's frame.

    Odometry starts at zero and the INS with an error of its own, so both are laid on the true start.

    Returns:
        x, y [m] and yaw [rad] per report under "truth", "odometry" and "ins" (reports, 3).
    """
    wire = np.array([report[1:] for report in log["track"]], float).reshape(-1, 3, 3)
    truth, odometry, ins = np.moveaxis(wire * (1, -1, -1), 1, 0)
    return {"truth": truth, "odometry": _aligned(odometry, truth), "ins": _aligned(ins, truth)}


def _aligned(estimate: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return an estimate moved rigidly so that it starts at the true start (n, 3)."""
    if not len(truth):
        return estimate
    turn = truth[0, 2] - estimate[0, 2]
    cos, sin = math.cos(turn), math.sin(turn)
    # The transposed rotation, as points are rows.
    moved = (estimate[:, :2] - estimate[0, :2]) @ np.array([[cos, sin], [-sin, cos]])
    return np.column_stack([moved + truth[0, :2], estimate[:, 2] + turn])


def scan_points(scan: Mapping[str, Any]) -> np.ndarray:
    """Return the end points of the beams of a logged laser scan, in our axes [m] (hits, 2).

    The first beam is the rightmost (wire yaw +fov/2), the others follow counter-clockwise. Beams
    that met nothing are left out.
    """
    ranges = np.array(scan["ranges"], float)
    (x, y, yaw), (at_x, at_y, at_yaw) = scan["pose"], scan["at"]
    spread = np.asarray(np.linspace(scan["fov"] / 2, -scan["fov"] / 2, len(ranges)), float)
    # The wire's yaw turns clockwise, as its y axis points to the right.
    angle = yaw + at_yaw + spread
    # In the wire's axes, y right and yaw clockwise; only the points are turned into ours.
    start_x = x + at_x * math.cos(yaw) - at_y * math.sin(yaw)
    start_y = y + at_x * math.sin(yaw) + at_y * math.cos(yaw)
    points = np.column_stack([start_x + ranges * np.cos(angle), -start_y - ranges * np.sin(angle)])
    return points[ranges < SCANNER_RANGE]


def run_picture(arena: ArenaSpec, log: Mapping[str, Any], path: Path) -> None:
    """Draw a run as a figure.

    Args:
        arena: Its arena.
        log: "track" with one row per report (time, truth, odometry, INS; poses as x, y, yaw), and
            "scan" with the last laser scan, or nothing in it.
        path: PNG, PDF, SVG or EPS file; its folder exists.

    Raises:
        UsageError: Another suffix.
        WriteError: The file cannot be written.
    """
    (x0, x1), (y0, y1) = arena.extent
    with figure_style():
        figure = Figure(figsize=(PAGE, PAGE * (y1 - y0) / (x1 - x0) + 0.7))
        axes = figure.add_subplot()
        axes.set(
            aspect="equal",
            facecolor=PAPER,
            xlim=(x0 - 0.3, x1 + 0.3),
            ylim=(y0 - 0.3, y1 + 0.3),
            xlabel="x [m]",
            ylabel="y [m]",
            title=_title(arena, log["track"]),
        )
        axes.grid(visible=False)
        draw_shapes(axes, arena)
        _draw_run(axes, log)
        axes.spines[:].set_visible(False)
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=6)
    save_figure(figure, path)


def _title(arena: ArenaSpec, track: Sequence[Sequence[Any]]) -> str:
    lasted = track[-1][0] - track[0][0] if track else 0.0
    return f"{arena.name}: {lasted:.1f} simulated seconds"


def overhead_height(arena: ArenaSpec) -> float:
    """Return the height from which on solids are over the heads of robots, wherever they start [m]."""
    return OVERHEAD + max([0.0, *(start.at[2] for start in arena.starts)])


def draw_shapes(axes: Axes, arena: ArenaSpec) -> None:
    """Draw fixed solids as their outlines on the floor: walls dark, ground the darker the higher it is.

    Glass, mirrors and fenders have their own styles, what is never touched (paint on a road) has its own
    colour, terrain is drawn as contours, the sky not at all; of roofs and whatever else is above all robots
    there is only a dashed line.
    """
    sorts: dict[str, list[Shape]] = {}
    above = overhead_height(arena)
    for shape in arena.shapes:
        if shape.heights is not None:
            _draw_terrain(axes, shape)
        else:
            sorts.setdefault(_sort(shape, above), []).append(shape)
    # Once for each solid: it is a key of the sorting and of the colours.
    tops = {id(shape): height_range(shape)[1] for shape in sorts.get("ground", ())}
    for sort, members in sorts.items():
        style = dict(STYLES[sort])
        if sort == "ground":
            # Higher ground over lower, as it is seen from above.
            members = sorted(members, key=lambda shape: tops[id(shape)])
            style["facecolor"] = [GROUND(tops[id(shape)] / DARKEST_HEIGHT) for shape in members]
        elif sort == "paint":
            style["facecolor"] = [shape.rgba for shape in members]
        axes.add_collection(PatchCollection([Polygon(outline(shape)) for shape in members], **style))


def _sort(shape: Shape, above: float) -> str:
    """Return the style in which a solid is drawn; `above` is the height of what is overhead."""
    if shape.material == SKY or height_range(shape)[0] > above:
        return shape.material if shape.material == SKY else "overhead"
    if shape.material != OPAQUE:
        return shape.material
    return {"wall": "wall", "fixture": "paint"}.get(shape.surface, "ground")


def _draw_terrain(axes: Axes, shape: Shape) -> None:
    assert shape.heights is not None
    z = np.asarray(shape.heights.heights, float) + shape.at[2]
    # MuJoCo's height fields have rows along y and columns along x.
    x, y = np.meshgrid(*(np.linspace(-h, h, n) for h, n in zip(shape.size, z.shape[::-1], strict=False)))
    cos, sin = math.cos(shape.rotation[2]), math.sin(shape.rotation[2])
    x, y = shape.at[0] + cos * x - sin * y, shape.at[1] + sin * x + cos * y
    # Level ground has no contours, of which Matplotlib warns.
    if np.ptp(z) == 0:
        return
    axes.contourf(x, y, z, levels=CONTOURS, cmap=GROUND, zorder=1)
    axes.contour(x, y, z, levels=CONTOURS, colors=GROUND_EDGE, linewidths=0.5, zorder=1)


def _draw_run(axes: Axes, log: Mapping[str, Any]) -> None:
    if log["scan"].get("pose"):  # a run may end between a scan and the pose of its moment
        hits = scan_points(log["scan"])
        axes.plot(hits[:, 0], hits[:, 1], ".", color=SCAN, ms=2.5, label="last laser scan", zorder=5)
    paths = tracked_poses(log)
    for name, colour, style, label in (
        ("truth", TRUTH, "-", "driven path"),
        ("odometry", ODOMETRY, "--", "odometry"),
        ("ins", INS, ":", "INS"),
    ):
        x, y = paths[name][:, 0], paths[name][:, 1]
        wide = 1.8 if name == "truth" else 1.2
        axes.plot(x, y, style, color=colour, lw=wide, label=label, zorder=4)
    truth = paths["truth"]
    if len(truth):
        axes.plot(*truth[0, :2], "o", color="white", mec=TRUTH, mew=1.5, ms=6, label="start", zorder=6)
        cos, sin = math.cos(truth[-1, 2]), math.sin(truth[-1, 2])
        # Markers do not turn with the data, so their corners are turned.
        arrow = ARROW @ np.array([[cos, sin], [-sin, cos]])
        axes.plot(*truth[-1, :2], marker=arrow, color=TRUTH, ms=10, ls="", label="end", zorder=6)
