"""Points of traces in a picture: small coloured balls, hidden by what is in front of them (manual 9.4)."""

import math
from dataclasses import dataclass

import numpy as np

from usarmjx.cameras.lenses import MIRROR_DISTANCE, RIM
from usarmjx.cameras.mounts import Camera

RADIUS = 0.03
"""Of a ball (chosen) [m]."""
LEAST = 0.75
"""Pixels that a ball's radius is at least, so that it always has one's middle in it."""
NEAR = 0.05
"""Nothing nearer to the camera than this is drawn [m]."""


@dataclass(frozen=True, eq=False)
class Eye:
    """What takes a picture.

    Attributes:
        place: Where it is [m] (3,).
        turn: Its orientation; x is the optical axis, z up in the picture (3, 3).
        fov: Its field of view [rad].
        camera: What camera it is of.
    """

    place: np.ndarray
    turn: np.ndarray
    fov: float
    camera: Camera


def paint(rgb: np.ndarray, depth: np.ndarray, eye: Eye, places: np.ndarray, colors: np.ndarray) -> None:
    """Draw balls into a picture, the far ones first; they have no shadow, and mirrors do not show them.

    Args:
        rgb: The picture, which is changed (height, width, 3) uint8.
        depth: Its depths; see `cameras.picture` (height, width) [m].
        eye: What has taken it.
        places: Middles of the balls [m] (balls, 3).
        colors: Their red, green and blue, 0 to 1 (balls, 3).
    """
    height, width = depth.shape
    project = _omni if eye.camera.lens == "omni" else _pinhole
    right, down, away, scale = project(eye, (places - eye.place) @ eye.turn, width, height)
    seen = (away > NEAR) & np.isfinite(right) & np.isfinite(down)
    for ball in sorted(np.flatnonzero(seen), key=lambda ball: -away[ball]):
        radius = max(scale[ball] * RADIUS, LEAST)
        first = [max(0, math.floor(middle[ball] - radius)) for middle in (right, down)]
        last = [max(0, math.ceil(middle[ball] + radius)) for middle in (right, down)]
        part = np.s_[first[1] : last[1], first[0] : last[0]]
        if not depth[part].size:
            continue
        rows, columns = np.mgrid[part][:, : depth[part].shape[0], : depth[part].shape[1]] + 0.5
        inside = np.hypot(columns - right[ball], rows - down[ball]) <= radius
        rgb[part][inside & (depth[part] > away[ball] - RADIUS)] = np.round(255 * colors[ball])


def _pinhole(
    eye: Eye, along: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return column and row, depth [m] and pixels per metre of points in the eye's axes."""
    focal = width / 2 / math.tan(eye.fov / 2)
    away = along[:, 0]
    scale = focal / np.maximum(away, NEAR)
    return width / 2 - scale * along[:, 1], height / 2 - scale * along[:, 2], away, scale


def _omni(
    eye: Eye, along: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the same in a parabolic mirror; see `cameras.lenses.omni`."""
    along = along - (MIRROR_DISTANCE, 0.0, 0.0)
    away = np.linalg.norm(along, axis=1)
    angle = np.arccos(np.clip(-along[:, 0] / np.maximum(away, 1e-9), -1.0, 1.0))
    zoom = math.tan(eye.camera.default / 2) / math.tan(eye.fov / 2)
    rim = min(width, height) / 2 * zoom
    radius = np.where(angle < RIM, rim * np.tan(angle / 2) / math.tan(RIM / 2), np.nan)
    aside = np.maximum(np.hypot(along[:, 1], along[:, 2]), 1e-9)
    # How fast the radius grows with the angle, which a ball fills from RADIUS / away to either side.
    scale = rim / math.tan(RIM / 2) / 2 / np.cos(angle / 2) ** 2 / np.maximum(away, NEAR)
    right, up = -along[:, 1] / aside, along[:, 2] / aside
    return width / 2 + radius * right, height / 2 - radius * up, away, scale
