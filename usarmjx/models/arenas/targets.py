"""What robots look for in arenas of today: victim boxes with a hole to look through, and signs on walls."""

import math

from usarmjx.models.arenas.elements import WOOD
from usarmjx.models.spec.shapes import Position2D, Rgba, Shape

HOLE = 0.15
"""Width and height of the hole that a victim is looked at through [m] (RoboCup Rescue; estimated)."""
BOX_LENGTH, BOX_WIDTH, BOX_HEIGHT = 0.6, 0.7, 0.96
"""Of a victim box: over the trunk of a victim that sits, whose legs come out below (chosen) [m]."""
BACK = 0.2
"""From a victim's pelvis to the back of its box [m]."""
EYES = 0.72
"""Height of the middle of the hole [m]."""
SLOT = 0.3
"""Height of the gap under the front, for the legs [m]."""
SHEET = 0.02
"""Thickness of its plywood [m] (chosen)."""
SIGN = 0.3
"""Side of a sign [m]."""
WHITE: Rgba = (0.95, 0.95, 0.95, 1.0)


def victim_box(at: Position2D, heading: float) -> tuple[Shape, ...]:
    """Return a box over a victim that sits at a place [m] and looks towards `heading` [rad]."""
    front, half = BOX_LENGTH - BACK, BOX_WIDTH / 2
    low, high = EYES - HOLE / 2, EYES + HOLE / 2
    corners = (
        ((-BACK, -half, 0.0), (-BACK + SHEET, half, BOX_HEIGHT)),
        ((-BACK, -half, 0.0), (front, -half + SHEET, BOX_HEIGHT)),
        ((-BACK, half - SHEET, 0.0), (front, half, BOX_HEIGHT)),
        ((-BACK, -half, BOX_HEIGHT - SHEET), (front, half, BOX_HEIGHT)),
        ((front - SHEET, -half, SLOT), (front, half, low)),
        ((front - SHEET, -half, high), (front, half, BOX_HEIGHT)),
        ((front - SHEET, -half, low), (front, -HOLE / 2, high)),
        ((front - SHEET, HOLE / 2, low), (front, half, high)),
    )
    cos, sin = math.cos(heading), math.sin(heading)
    shapes: list[Shape] = []
    for a, b in corners:
        x, y, z = ((p + q) / 2 for p, q in zip(a, b, strict=True))
        dx, dy, dz = ((q - p) / 2 for p, q in zip(a, b, strict=True))
        place = (at[0] + x * cos - y * sin, at[1] + x * sin + y * cos, z)
        turn = (0.0, 0.0, heading)
        shapes.append(
            Shape(kind="box", size=(dx, dy, dz), at=place, rotation=turn, surface="wall", rgba=WOOD)
        )
    return tuple(shapes)


def wall_sign(at: Position2D, heading: float, texture: str, *, z: float = 0.8) -> Shape:
    """Return a square with a chart, a label or a tag on a wall, which looks towards `heading` [rad]."""
    return Shape(
        kind="box",
        size=(0.005, SIGN / 2, SIGN / 2),
        at=(at[0], at[1], z),
        rotation=(0.0, 0.0, heading),
        surface="fixture",
        rgba=WHITE,
        texture=texture,
    )
