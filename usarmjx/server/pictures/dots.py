"""What is drawn into a picture: small balls and thin lines, hidden by what is in front (manual 9.4)."""

import math

import numpy as np

from usarmjx.cameras.lenses import MIRROR_DISTANCE, MIRROR_RIM_ANGLE
from usarmjx.cameras.picture import Viewpoint
from usarmjx.sensors.sketch import OverlayLines

BALL_RADIUS = 0.03
"""Of a ball (chosen) [m]."""
MIN_BALL_PIXELS = 0.75
"""Pixels that a ball's radius is at least, so that it always has one's middle in it."""
NEAR_CLIP = 0.05
"""Nothing nearer to the camera than this is drawn [m]."""
DEPTH_BIAS = 0.02
"""What is so close in front of a line does not hide it: it may end on a surface [m]."""


def draw_sketch(rgb: np.ndarray, depth: np.ndarray, viewpoint: Viewpoint, sketch: OverlayLines) -> None:
    """Draw lines and then balls into a picture; they have no shadow, and mirrors do not show them.

    Args:
        rgb: The picture, which is changed (height, width, 3) uint8.
        depth: Its depths; see `cameras.picture` (height, width) [m].
        viewpoint: From where it was taken; its eye is where it is itself.
        sketch: What to draw; points become balls.
    """
    start, end, colors = (np.asarray(rows)[sketch.shown] for rows in (sketch.start, sketch.end, sketch.rgb))
    colors, points = np.round(255 * colors).astype(np.uint8), (start == end).all(-1)
    for line in zip(start[~points], end[~points], colors[~points], strict=True):
        _line(rgb, depth, viewpoint, *line)
    _balls(rgb, depth, viewpoint, start[points], colors[points])


def _line(
    rgb: np.ndarray,
    depth: np.ndarray,
    viewpoint: Viewpoint,
    start: np.ndarray,
    end: np.ndarray,
    color: np.ndarray,
) -> None:
    """Draw a line that is a pixel wide."""
    height, width = depth.shape
    length = float(np.linalg.norm(end - start))
    along = (end - start) / length
    foot = float((viewpoint.pos - start) @ along)
    aside = max(float(np.linalg.norm(start + foot * along - viewpoint.pos)), 1e-3)
    # Points that are evenly apart as the eye sees them, closer than pixels anywhere in the picture.
    first, last = math.atan2(-foot, aside), math.atan2(length - foot, aside)
    count = math.ceil(2 * (last - first) * max(width, height) / math.tan(viewpoint.fov / 2)) + 2
    way = np.clip(foot + aside * np.tan(np.linspace(first, last, count)), 0.0, length)
    right, down, away, _ = _project(viewpoint, start + way[:, None] * along, width, height)
    seen = (away > NEAR_CLIP) & (right >= 0) & (right < width) & (down >= 0) & (down < height)
    column, row, away = right[seen].astype(int), down[seen].astype(int), away[seen]
    clear = depth[row, column] > away - DEPTH_BIAS
    rgb[row[clear], column[clear]] = color


def _balls(
    rgb: np.ndarray, depth: np.ndarray, viewpoint: Viewpoint, points: np.ndarray, colors: np.ndarray
) -> None:
    """Draw balls, the far ones first."""
    height, width = depth.shape
    right, down, away, scale = _project(viewpoint, points, width, height)
    seen = (away > NEAR_CLIP) & np.isfinite(right) & np.isfinite(down)
    for ball in sorted(np.flatnonzero(seen), key=lambda ball: -away[ball]):
        radius = max(scale[ball] * BALL_RADIUS, MIN_BALL_PIXELS)
        first = [max(0, math.floor(middle[ball] - radius)) for middle in (right, down)]
        last = [max(0, math.ceil(middle[ball] + radius)) for middle in (right, down)]
        part = np.s_[first[1] : last[1], first[0] : last[0]]
        if not depth[part].size:
            continue
        rows, columns = np.mgrid[part][:, : depth[part].shape[0], : depth[part].shape[1]] + 0.5
        inside = np.hypot(columns - right[ball], rows - down[ball]) <= radius
        rgb[part][inside & (depth[part] > away[ball] - BALL_RADIUS)] = colors[ball]


def _project(
    viewpoint: Viewpoint, points: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return column and row, depth [m] and pixels per metre of points (points, 3); nan: not seen."""
    project = _omni if viewpoint.lens == "omni" else _pinhole
    return project(viewpoint, (points - viewpoint.pos) @ viewpoint.mat, width, height)


def _pinhole(
    viewpoint: Viewpoint, along: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return that of points in the eye's axes."""
    focal = width / 2 / math.tan(viewpoint.fov / 2)
    away = along[:, 0]
    scale = focal / np.maximum(away, NEAR_CLIP)
    return width / 2 - scale * along[:, 1], height / 2 - scale * along[:, 2], away, scale


def _omni(
    viewpoint: Viewpoint, along: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the same in a parabolic mirror; see `cameras.lenses.omni_rays`."""
    along = along - (MIRROR_DISTANCE, 0.0, 0.0)
    away = np.linalg.norm(along, axis=1)
    angle = np.arccos(np.clip(-along[:, 0] / np.maximum(away, 1e-9), -1.0, 1.0))
    zoom = math.tan(viewpoint.default_fov / 2) / math.tan(viewpoint.fov / 2)
    rim = min(width, height) / 2 * zoom
    radius = np.where(
        angle < MIRROR_RIM_ANGLE, rim * np.tan(angle / 2) / math.tan(MIRROR_RIM_ANGLE / 2), np.nan
    )
    aside = np.maximum(np.hypot(along[:, 1], along[:, 2]), 1e-9)
    # How fast the radius grows with the angle, which a ball fills from RADIUS / away to either side.
    scale = rim / math.tan(MIRROR_RIM_ANGLE / 2) / 2 / np.cos(angle / 2) ** 2 / np.maximum(away, NEAR_CLIP)
    right, up = -along[:, 1] / aside, along[:, 2] / aside
    return width / 2 + radius * right, height / 2 - radius * up, away, scale
