"""From where a world is looked at so that it fills the picture."""

import math
from dataclasses import dataclass

import numpy as np

from usarmjx.view.drawing import NOBODY, Drawing
from usarmjx.view.mesh import BOX

AZIMUTH, ELEVATION = math.radians(-115.0), math.radians(50.0)
"""From where one looks at first: seen from the middle, in which direction of the compass and how high."""
FOV = math.radians(50.0)
"""How much the picture shows from top to bottom at first [rad]."""
USED = 0.94
"""The world fills so much of the picture's width or height, whichever is full first."""
LOWEST = 1.0
"""A world is at least so high [m]."""
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class CameraPose:
    """Where a camera is and what it looks at [m], both (3,), and which way is up on its picture (3,)."""

    pos: np.ndarray
    look_at: np.ndarray
    up: np.ndarray


def bounds_of(drawing: Drawing) -> tuple[np.ndarray, np.ndarray]:
    """Return least and largest x, y and z of what a drawing has to show [m], both (3,)."""
    low, high = drawing.extent.T
    tops = [drawing.floor + LOWEST]
    for shape in (drawing.shapes[body.shape] for body in drawing.bodies if body.slot == NOBODY):
        boxes = shape.kind == BOX
        upward = (np.abs(shape.mat[boxes, 2]) * shape.size[boxes]).sum(1)
        tops += (shape.pos[boxes, 2] + upward).tolist()
    return np.array([*low, drawing.floor]), np.array([*high, max(tops)])


def framed(low: np.ndarray, high: np.ndarray, aspect: float = 1.6) -> CameraPose:
    """Return from where a box fills the picture.

    Args:
        low: Its least x, y and z [m] (3,).
        high: Its largest x, y and z [m] (3,).
        aspect: Width of the picture over its height.
    """
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    ahead = -np.array(
        [
            math.cos(ELEVATION) * math.cos(AZIMUTH),
            math.cos(ELEVATION) * math.sin(AZIMUTH),
            math.sin(ELEVATION),
        ]
    )
    right = np.cross(ahead, UP)
    right /= np.linalg.norm(right)
    above = np.cross(right, ahead)
    half_height = math.tan(FOV / 2) * USED
    target = (low + high) / 2
    distance = 1.0
    # What is near looks larger than what is far: the target moves until both sides have the same margin.
    for _ in range(4):
        around = corners - target
        depth, aside, up = around @ ahead, around @ right, around @ above
        distance = max(
            float((np.abs(up) / half_height - depth).max()),
            float((np.abs(aside) / (half_height * aspect) - depth).max()),
            0.5,
        )
        seen_up, seen_aside = up / (distance + depth), aside / (distance + depth)
        target = target + distance / 2 * (
            (seen_up.max() + seen_up.min()) * above + (seen_aside.max() + seen_aside.min()) * right
        )
    return CameraPose(target - distance * ahead, target, UP)
