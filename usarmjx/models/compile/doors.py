"""Poses of doors, by the angles of their hinges."""

from types import ModuleType

import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.transforms import mat_from_angles
from usarmjx.models.types.arena import ArenaSpec, Door
from usarmjx.models.types.shapes import Shape

DOOR_GAP = 0.01
"""Gap between a door and the floor [m]."""


def door_panel(door: Door) -> Shape:
    """Return the panel of a door in the frame of its hinge, which has its x axis along the door."""
    width, thickness, height = door.size
    return Shape(
        kind="box",
        size=(width / 2, thickness / 2, (height - DOOR_GAP) / 2),
        at=(width / 2, 0.0, (height + DOOR_GAP) / 2),
        mass=door.mass,
        surface="wall",
        rgba=door.rgba,
    )


def door_boxes(arena: ArenaSpec, angles: Array, xp: ModuleType = np) -> tuple[Array, Array, np.ndarray]:
    """Return the poses of the panels of an arena's doors in the world, and their half lengths.

    Args:
        arena: The arena.
        angles: Angles of the hinges [rad] (doors,).
        xp: Array module of the angles.

    Returns:
        Centres [m] (doors, 3), orientations (doors, 3, 3), half lengths [m] (doors, 3).
    """
    panels = [door_panel(door) for door in arena.doors]
    foot = np.array([door.at for door in arena.doors], np.float32).reshape(-1, 3)
    offset = np.array([panel.at for panel in panels], np.float32).reshape(-1, 3)
    size = np.array([panel.size for panel in panels], np.float32).reshape(-1, 3)
    zero = xp.zeros_like(angles)
    mat = mat_from_angles(zero, zero, np.array([door.yaw for door in arena.doors], np.float32) + angles, xp)
    pos = foot + np.array([0.0, 0.0, arena.floor]) + (mat * offset[:, None]).sum(-1)
    return pos.astype(np.float32), mat.astype(np.float32), size
