"""An arena with room for as many robots as one likes: a hall of cells with low walls in between."""

import math

from usarmjx.models.spec.arena import START_ELEVATION, ArenaSpec, StartPose
from usarmjx.models.spec.shapes import Shape

CELL = 2.0
"""Side of a cell [m]; a robot starts in the middle."""
WALL = (0.5, 0.05, 0.3)
"""Half lengths of a wall between two cells [m]: robots see it, and each other beside it."""
OUTER = (0.1, 0.5)
"""Half the thickness and height of the walls around the hall [m]."""


def make_hall(robots: int) -> ArenaSpec:
    """Return a hall with start poses for at least so many robots."""
    side = math.ceil(math.sqrt(robots))
    half = side * CELL / 2
    middles = [(i + 0.5) * CELL - half for i in range(side)]
    between = [i * CELL - half for i in range(1, side)]
    walls = [_wall((x, y), WALL) for x in middles for y in between]
    thick, high = OUTER
    walls += [_wall((0.0, y), (half, thick, high)) for y in (-half, half)]
    walls += [_wall((x, 0.0), (thick, half, high)) for x in (-half, half)]
    starts = [
        StartPose(tag=f"Cell{row}x{column}", at=(x, y, START_ELEVATION))
        for row, x in enumerate(middles)
        for column, y in enumerate(middles)
    ]
    return ArenaSpec(
        name="DM-Hall",
        about=f"{side * side} cells with low walls in between.",
        shapes=tuple(walls),
        starts=tuple(starts),
        extent=((-half, half), (-half, half)),
    )


def _wall(at: tuple[float, float], size: tuple[float, float, float]) -> Shape:
    return Shape(kind="box", size=size, at=(*at, size[2]), surface="wall")
