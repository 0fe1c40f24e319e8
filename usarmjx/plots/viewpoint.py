"""Where pictures are seen from: a pinhole with a fixed field of view."""

import math

import numpy as np

FOV_Y = math.radians(32.0)
"""Field of view across a picture's height."""
FRAMING_MARGIN = 1.03
"""How much farther away the eye is than where the arena fills the picture."""


def camera_rays(eye: np.ndarray, target: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return the directions of a picture's rays, row by row from the top (height * width, 3)."""
    right, up, forward = camera_axes(eye - target)
    scale = 2 * math.tan(FOV_Y / 2) / height
    x = (np.arange(width) - (width - 1) / 2) * scale
    y = ((height - 1) / 2 - np.arange(height)) * scale
    rays = forward + x[None, :, None] * right + y[:, None, None] * up
    return (rays / np.linalg.norm(rays, axis=-1, keepdims=True)).reshape(-1, 3).astype(np.float32)


def camera_axes(back: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a picture's axes right, up, forward (3,) from the direction of the eye, seen from its middle."""
    forward = -back / np.linalg.norm(back)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return right, np.cross(right, forward), forward


def fit_camera(corners: np.ndarray, back: np.ndarray, aspect: float) -> tuple[np.ndarray, np.ndarray]:
    """Return from where corners fill a picture, and the picture's middle (3,) and (3,) [m].

    Args:
        corners: What shall be in the picture [m] (n, 3).
        back: Unit vector from the picture's middle to the eye (3,).
        aspect: Width of the picture over its height.
    """
    right, up, forward = camera_axes(back)
    slope = np.array([aspect, 1.0]) * math.tan(FOV_Y / 2)
    target, away = corners.mean(0), 0.0
    for _ in range(4):  # near corners take more of the picture than far ones: move the middle a little
        seen, deep = (corners - target) @ np.stack([right, up], -1), (corners - target) @ forward
        away = float((np.abs(seen) / slope - deep[:, None]).max())
        on_screen = seen / (away + deep)[:, None]
        target = target + away * (on_screen.max(0) + on_screen.min(0)) / 2 @ np.stack([right, up])
    return target + FRAMING_MARGIN * away * back, target


def downsample(picture: np.ndarray) -> np.ndarray:
    """Return a picture half as wide and high (rows, columns, 3), each pixel the mean of four."""
    rows, columns, _ = picture.shape
    return picture.reshape(rows // 2, 2, columns // 2, 2, 3).mean((1, 3))
