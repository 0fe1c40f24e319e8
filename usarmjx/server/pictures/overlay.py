"""Overlay of a rendered picture: lines and balls where no surface hides them.

Traces of robots and the findings of sensors are drawn so, after rendering: no ray has to hit a thin line.
"""

import math

import numpy as np

from usarmjx.sensors.cameras.lenses import MIRROR_DISTANCE, MIRROR_RIM_ANGLE
from usarmjx.sensors.cameras.picture import Viewpoint
from usarmjx.sensors.sketch import OverlayLines

BALL_RADIUS = 0.03
"""Radius of a ball (chosen) [m]."""
MIN_BALL_PIXELS = 0.75
"""Smallest radius of a ball [pixels], so that it always covers the middle of one."""
NEAR_CLIP = 0.05
"""Smallest drawn distance from the camera [m]."""
DEPTH_BIAS = 0.02
"""Distance up to which a surface in front of a line does not hide it: a line may end on a surface [m]."""


def draw_overlay(rgb: np.ndarray, depth: np.ndarray, viewpoint: Viewpoint, sketch: OverlayLines) -> None:
    """Draw lines and then balls into a picture; they have no shadow, and mirrors do not show them.

    Args:
        rgb: The picture, which is changed (height, width, 3) uint8.
        depth: Its depths; see `cameras.picture` (height, width) [m].
        viewpoint: Viewpoint of the picture, with its eye at its own position.
        sketch: Lines to draw; a line of length 0 becomes a ball.
    """
    shown = np.asarray(sketch.shown)
    start, end = np.asarray(sketch.start)[shown], np.asarray(sketch.end)[shown]
    colors = np.round(255 * np.asarray(sketch.rgb)[shown]).astype(np.uint8)
    points = (start == end).all(-1)
    for line in zip(start[~points], end[~points], colors[~points], strict=True):
        _draw_line(rgb, depth, viewpoint, *line)
    _draw_balls(rgb, depth, viewpoint, start[points], colors[points])


def _draw_line(
    rgb: np.ndarray,
    depth: np.ndarray,
    viewpoint: Viewpoint,
    start: np.ndarray,
    end: np.ndarray,
    color: np.ndarray,
) -> None:
    """Draw a line of one pixel's width."""
    height, width = depth.shape
    length = float(np.linalg.norm(end - start))
    along = (end - start) / length
    foot = float((viewpoint.pos - start) @ along)
    aside = max(float(np.linalg.norm(start + foot * along - viewpoint.pos)), 1e-3)
    # Points at equal angles from the eye, denser than pixels anywhere in the picture.
    first, last = math.atan2(-foot, aside), math.atan2(length - foot, aside)
    count = math.ceil(2 * (last - first) * max(width, height) / math.tan(viewpoint.fov / 2)) + 2
    reach = np.clip(foot + aside * np.tan(np.linspace(first, last, count)), 0.0, length)
    right, down, away, _ = _project(viewpoint, start + reach[:, None] * along, width, height)
    in_view = (away > NEAR_CLIP) & (right >= 0) & (right < width) & (down >= 0) & (down < height)
    column, row, away = right[in_view].astype(int), down[in_view].astype(int), away[in_view]
    visible = depth[row, column] > away - DEPTH_BIAS
    rgb[row[visible], column[visible]] = color


def _draw_balls(
    rgb: np.ndarray, depth: np.ndarray, viewpoint: Viewpoint, points: np.ndarray, colors: np.ndarray
) -> None:
    """Draw balls, the far ones first."""
    height, width = depth.shape
    right, down, away, scale = _project(viewpoint, points, width, height)
    in_view = (away > NEAR_CLIP) & np.isfinite(right) & np.isfinite(down)
    for ball in sorted(np.flatnonzero(in_view), key=lambda ball: -away[ball]):
        radius = max(scale[ball] * BALL_RADIUS, MIN_BALL_PIXELS)
        first = [max(0, math.floor(center[ball] - radius)) for center in (right, down)]
        last = [max(0, math.ceil(center[ball] + radius)) for center in (right, down)]
        part = np.s_[first[1] : last[1], first[0] : last[0]]
        if not depth[part].size:
            continue
        rows, columns = np.mgrid[part][:, : depth[part].shape[0], : depth[part].shape[1]] + 0.5
        inside = np.hypot(columns - right[ball], rows - down[ball]) <= radius
        rgb[part][inside & (depth[part] > away[ball] - BALL_RADIUS)] = colors[ball]


def _project(
    viewpoint: Viewpoint, points: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return column and row, depth [m] and pixels per metre of points (points, 3); nan: out of sight."""
    project = _project_mirror if viewpoint.lens == "omni" else _project_pinhole
    return project(viewpoint, (points - viewpoint.pos) @ viewpoint.mat, width, height)


def _project_pinhole(
    viewpoint: Viewpoint, along: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Project points in the eye's axes through a pinhole; see `_project`."""
    focal = width / 2 / math.tan(viewpoint.fov / 2)
    away = along[:, 0]
    scale = focal / np.maximum(away, NEAR_CLIP)
    return width / 2 - scale * along[:, 1], height / 2 - scale * along[:, 2], away, scale


def _project_mirror(
    viewpoint: Viewpoint, along: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Project points in the eye's axes by a parabolic mirror; see `cameras.lenses.omni_rays`."""
    along = along - (MIRROR_DISTANCE, 0.0, 0.0)
    away = np.linalg.norm(along, axis=1)
    angle = np.arccos(np.clip(-along[:, 0] / np.maximum(away, 1e-9), -1.0, 1.0))
    zoom = math.tan(viewpoint.default_fov / 2) / math.tan(viewpoint.fov / 2)
    rim = min(width, height) / 2 * zoom
    radius = np.where(
        angle < MIRROR_RIM_ANGLE, rim * np.tan(angle / 2) / math.tan(MIRROR_RIM_ANGLE / 2), np.nan
    )
    aside = np.maximum(np.hypot(along[:, 1], along[:, 2]), 1e-9)
    # Derivative of the radius by the angle, of which a ball covers RADIUS / away to either side.
    scale = rim / math.tan(MIRROR_RIM_ANGLE / 2) / 2 / np.cos(angle / 2) ** 2 / np.maximum(away, NEAR_CLIP)
    right, up = -along[:, 1] / aside, along[:, 2] / aside
    return width / 2 + radius * right, height / 2 - radius * up, away, scale
