"""Elements of the arenas of NIST, as ASTM's standard test methods for response robots have them since.

All stand on a grid of 1.2 m, the width of a sheet of plywood. Ramps of 15 degrees are ASTM E2826's
(continuous) and E2827's (crossing), stairs E2804's; there is more in `step_fields`, `pipes` and `debris`.
Lengths that these leave open are marked chosen. Positions are in the arena's axes, headings are
counter-clockwise from x.
"""

import math

from usarmjx.base.errors import SpecError
from usarmjx.base.transforms import Vec3
from usarmjx.models.spec.shapes import Position2D, Rgba, Shape

CELL = 1.2
"""Side of a grid cell [m]."""
RAMP_ANGLE = math.radians(15)
STEEP, STEEPER = math.radians(35), math.radians(40)
"""Stairs of the orange arena, and the steeper ones."""
RISE = 0.18
"""Of one stair [m] (chosen)."""
PLYWOOD_THICKNESS = 0.10
"""Thickness of decks and slabs with the joists under them [m] (chosen)."""

WOOD: Rgba = (0.7, 0.55, 0.35, 1.0)
STONE: Rgba = (0.6, 0.6, 0.6, 1.0)


def cell_center(origin: Position2D, column: float, row: float) -> Position2D:
    """Return the centre of a cell of the grid that has its lower left corner at `origin` [m]."""
    return (origin[0] + (column + 0.5) * CELL, origin[1] + (row + 0.5) * CELL)


def block(
    at: tuple[float, float],
    size: Vec3,
    *,
    z: float = 0.0,
    yaw: float = 0.0,
    surface: str = "ground",
    rgba: Rgba = STONE,
) -> Shape:
    """Return a box of full lengths `size` that stands at height `z` [m]; `at` is its middle."""
    half = (size[0] / 2, size[1] / 2, size[2] / 2)
    return Shape(
        kind="box", size=half, at=(*at, z + half[2]), rotation=(0.0, 0.0, yaw), surface=surface, rgba=rgba
    )


def deck(
    low: tuple[float, float], high: tuple[float, float], top: float, *, thickness: float = PLYWOOD_THICKNESS
) -> Shape:
    """Return a floor between two corners whose upper face lies at `top` [m]."""
    middle = ((low[0] + high[0]) / 2, (low[1] + high[1]) / 2)
    size = (high[0] - low[0], high[1] - low[1], thickness)
    return block(middle, size, z=top - thickness, rgba=WOOD)


def slope(
    foot: Vec3,
    head: Vec3,
    width: float,
    *,
    thickness: float = PLYWOOD_THICKNESS,
    surface: str = "ground",
    rgba: Rgba = WOOD,
) -> Shape:
    """Return a slab whose upper face rises from the middle of its low edge to that of its high edge [m].

    Its ends are at right angles to that face.
    """
    along, across, rise = (b - a for a, b in zip(foot, head, strict=True))
    run = math.hypot(along, across)
    angle, uphill = math.atan2(rise, run), math.atan2(across, along)
    back = thickness / 2 * math.sin(angle)
    x, y, z = ((a + b) / 2 for a, b in zip(foot, head, strict=True))
    return Shape(
        kind="box",
        size=(math.hypot(run, rise) / 2, width / 2, thickness / 2),
        at=(x + back * math.cos(uphill), y + back * math.sin(uphill), z - thickness / 2 * math.cos(angle)),
        rotation=(0.0, -angle, uphill),
        surface=surface,
        rgba=rgba,
    )


def ramp(
    at: tuple[float, float],
    uphill: float,
    *,
    run: float = 1.1,
    width: float = 1.1,
    angle: float = RAMP_ANGLE,
    thickness: float = 0.2,
) -> Shape:
    """Return a slab that rises out of the floor at `angle`, over `run` [m] towards `uphill` [rad].

    `at` is the slab's centre; what of it lies under the floor meets nothing.
    """
    back = run / 2 + thickness / 2 * math.sin(angle)
    x, y = at[0] - back * math.cos(uphill), at[1] - back * math.sin(uphill)
    head = (x + run * math.cos(uphill), y + run * math.sin(uphill), run * math.tan(angle))
    return slope((x, y, 0.0), head, width, thickness=thickness)


UPHILL = {">": 0.0, "^": math.pi / 2, "<": math.pi, "v": -math.pi / 2}


def ramps(
    plan: str, corner: tuple[float, float], *, side: float = CELL, angle: float = RAMP_ANGLE
) -> tuple[Shape, ...]:
    """Return ramps drawn as the arrows `>`, `^`, `<` and `v` of their climb; a blank or a dot is bare floor.

    `><` is a hill and `<>` a valley, which are continuous; arrows that cross make saw teeth. A full ramp is a
    cell long, a half ramp half a cell.

    Args:
        plan: Rows of arrows, that with the largest y first.
        corner: x and y of the plan's lower left corner [m].
        side: Length and width of each ramp [m].
        angle: Slope [rad].

    Raises:
        SpecError: The plan has other letters.
    """
    rows = plan.strip("\n").splitlines()
    slabs: list[Shape] = []
    for row, line in enumerate(reversed(rows)):
        for column, letter in enumerate(line):
            if letter in " .":
                continue
            if letter not in UPHILL:
                raise SpecError(f"a plan of ramps is made of {' '.join(UPHILL)} and blanks, not {letter!r}")
            x, y = corner[0] + (column + 0.5) * side, corner[1] + (row + 0.5) * side
            ahead = (math.cos(UPHILL[letter]) * side / 2, math.sin(UPHILL[letter]) * side / 2)
            head = (x + ahead[0], y + ahead[1], side * math.tan(angle))
            slabs.append(slope((x - ahead[0], y - ahead[1], 0.0), head, side))
    return tuple(slabs)


def stairs(
    head: tuple[float, float],
    uphill: float,
    count: int,
    *,
    rise: float = RISE,
    angle: float = STEEP,
    width: float = CELL,
) -> tuple[Shape, ...]:
    """Return a flight of `count` rises, the last of which is the edge of the floor that it leads to.

    Args:
        head: Middle of that edge [m].
        uphill: Direction of climb [rad].
        count: Number of rises.
        rise: Height of each [m].
        angle: Of the line over the edges of the steps [rad].
        width: Of the flight [m].
    """
    going = rise / math.tan(angle)
    steps: list[Shape] = []
    for i in range(1, count):
        back = (count - i - 0.5) * going
        at = (head[0] - back * math.cos(uphill), head[1] - back * math.sin(uphill))
        steps.append(block(at, (going, width, i * rise), yaw=uphill, rgba=WOOD))
    return tuple(steps)
