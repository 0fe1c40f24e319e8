"""A box on an upright hinge to a door."""

import math
from dataclasses import dataclass

import numpy as np

from usarmjx.base.errors import ArenaFileError
from usarmjx.models.build.doors import DOOR_GAP
from usarmjx.models.files.mjcf_solids import Pose
from usarmjx.models.spec.arena import Door

AXIS_TOLERANCE = 1e-3
"""How far a hinge or an edge may lean [rad]."""
HINGE_OFFSET_TOLERANCE = 0.02
"""How far a hinge may lie from the door's end; the door is moved to it [m]."""
FULL_TURN = (-math.pi, math.pi)
"""Limits of a hinge that has none."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Hinge:
    """What a door turns about, in the arena's axes.

    Attributes:
        anchor: A point of it (3,).
        axis: Its direction (3,).
        limits: Lowest and highest angle about that direction; None: none.
        friction: Damping [N m s/rad].
    """

    anchor: np.ndarray
    axis: np.ndarray
    limits: tuple[float, float] | None
    friction: float


def door_of(
    name: str, pose: Pose, half: np.ndarray, hinge: Hinge, mass: float, rgba: tuple[float, ...]
) -> Door:
    """Return a box that turns about a hinge as a door.

    Args:
        name: Its name.
        pose: Where the box is while the door is closed, in the arena's axes.
        half: Its half lengths [m] (3,).
        hinge: The hinge.
        mass: Mass of the door [kg].
        rgba: Colour.

    Raises:
        ArenaFileError: The hinge or the box does not stand upright, or the hinge is not at the box's end.
    """
    if abs(hinge.axis[2]) < 1 - AXIS_TOLERANCE:
        raise ArenaFileError(f"body {name!r}: its hinge is not upright; a door's is (axis 0 0 1)")
    up = int(np.abs(pose.mat[2]).argmax())
    if abs(pose.mat[2, up]) < 1 - AXIS_TOLERANCE:
        raise ArenaFileError(f"body {name!r}: its box does not stand upright; a door does")
    flat = [i for i in range(3) if i != up]
    long = max(flat, key=lambda i: float(half[i]))
    thin = next(i for i in flat if i != long)
    offset = pose.pos[:2] - hinge.anchor[:2]
    along = pose.mat[:2, long]
    reach, aside = float(along @ offset), float(pose.mat[:2, thin] @ offset)
    if reach < 0:
        along, reach = -along, -reach
    if abs(reach - half[long]) > HINGE_OFFSET_TOLERANCE or abs(aside) > HINGE_OFFSET_TOLERANCE + half[thin]:
        raise ArenaFileError(f"body {name!r}: its hinge is not at a narrow side of its box; a door's is")
    low, high = hinge.limits or FULL_TURN
    if hinge.axis[2] < 0:
        low, high = -high, -low
    x, y = hinge.anchor[:2].tolist()
    foot = float(pose.pos[2] - half[up]) - DOOR_GAP
    red, green, blue, alpha = rgba
    return Door(
        name=name,
        at=(x, y, foot),
        yaw=math.atan2(along[1], along[0]),
        size=(2 * float(half[long]), 2 * float(half[thin]), 2 * float(half[up]) + DOOR_GAP),
        limits=(low, high),
        mass=mass,
        friction=hinge.friction,
        rgba=(red, green, blue, alpha),
    )
