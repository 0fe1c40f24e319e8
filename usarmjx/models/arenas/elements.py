"""Elements of the NIST arenas, later ASTM's standard test methods for response robots.

All stand on a grid of 1.2 m, the width of a sheet of plywood. Ramps of 15 degrees are ASTM E2826's
(continuous) and E2827's (crossing), stairs E2804's, step fields E2828's. Lengths that these leave open are
marked chosen. Positions are in the arena's axes, headings are counter-clockwise from x.
"""

import math

from usarmjx.base.errors import SpecError
from usarmjx.base.transforms import Vec3
from usarmjx.models.types.shapes import Position2D, Rgba, Shape

CELL = 1.2
"""Side of a grid cell [m]."""
RAMP_ANGLE = math.radians(15)
"""Slope of ramps [rad]."""
STEEP, STEEPER = math.radians(35), math.radians(40)
"""Slopes of the stairs of the orange arena, and of the steeper ones [rad]."""
RISE = 0.18
"""Rise of one stair [m] (chosen)."""
PLYWOOD_THICKNESS = 0.10
"""Thickness of decks and slabs with their joists [m] (chosen)."""

WOOD: Rgba = (0.7, 0.55, 0.35, 1.0)
STONE: Rgba = (0.6, 0.6, 0.6, 1.0)

UPHILL = {">": 0.0, "^": math.pi / 2, "<": math.pi, "v": -math.pi / 2}
"""Directions of climb of the arrows in a plan of ramps [rad]."""

POST = 0.10
"""Width of a post [m]."""

STEP_FIELDS = {
    "flat": """
211111112111
121111111211
112111111121
111211111112
111121111111
111112111111
111111211111
111111121111
211111112111
121111111211
112111111121
111211111112
""",
    "hill": """
112234432211
112234432211
122234432211
112234442211
112334432211
112234432211
112234432211
112234433211
112244432211
112234432221
112234432211
112234432211
""",
    "diagonal": """
443322110000
443322110000
334433221100
334433221100
223344332211
223344332211
112233443322
112233443322
001122334433
001122334433
000011223344
000011223344
""",
}
"""Heights of the posts in units, rows along y from the largest on; the hill's ridge lies along y."""

PostHeights = list[list[int]]
"""Heights of posts in units, rows along x, columns along y."""


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

    Its ends are perpendicular to that face.
    """
    along, across, rise = (b - a for a, b in zip(foot, head, strict=True))
    run = math.hypot(along, across)
    angle, uphill = math.atan2(rise, run), math.atan2(across, along)
    # From the upper face, which is given, to the slab's centre half a thickness below it.
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

    `at` is the slab's centre; its part below the floor has no contacts.
    """
    back = run / 2 + thickness / 2 * math.sin(angle)
    x, y = at[0] - back * math.cos(uphill), at[1] - back * math.sin(uphill)
    head = (x + run * math.cos(uphill), y + run * math.sin(uphill), run * math.tan(angle))
    return slope((x, y, 0.0), head, width, thickness=thickness)


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
        angle: Slope of the line through the edges of the steps [rad].
        width: Width of the flight [m].
    """
    going = rise / math.tan(angle)
    steps: list[Shape] = []
    for i in range(1, count):
        back = (count - i - 0.5) * going
        at = (head[0] - back * math.cos(uphill), head[1] - back * math.sin(uphill))
        steps.append(block(at, (going, width, i * rise), yaw=uphill, rgba=WOOD))
    return tuple(steps)


def heights(pattern: str) -> PostHeights:
    """Return a pattern's heights, from the corner with the lowest x and y (rows along x, columns along y).

    Raises:
        SpecError: Its rows do not have the same length, or it has other letters than digits.
    """
    rows = pattern.split()
    if not rows or len({len(row) for row in rows}) != 1 or not all(row.isdigit() for row in rows):
        raise SpecError("a step field is drawn with rows of digits of the same length")
    return [[int(row[column]) for row in reversed(rows)] for column in range(len(rows[0]))]


def cover_boxes(grid: PostHeights) -> list[tuple[int, int, int, int, int]]:
    """Return few boxes with the same top as one post per cell: (height, first and last row and column).

    A box may extend under higher ones, where it is hidden: a lone post on flat ground is one box more. The
    last row and column are one past the box, as in `range`.
    """
    boxes: list[tuple[int, int, int, int, int]] = []
    for height in range(1, max(map(max, grid)) + 1):
        bare = {(i, j) for i, row in enumerate(grid) for j, post in enumerate(row) if post == height}
        while bare:
            box = max(_boxes_at(grid, min(bare), height), key=lambda box: len(bare & _posts(box)))
            boxes.append((height, *box))
            bare -= _posts(box)
    return boxes


def _boxes_at(grid: PostHeights, post: tuple[int, int], height: int) -> list[tuple[int, int, int, int]]:
    """Return for every length along the rows the widest box from that post on with no lower post."""
    boxes: list[tuple[int, int, int, int]] = []
    first, column = post
    left, right = 0, len(grid[0])
    for last in range(first, len(grid)):
        row = grid[last]
        if row[column] < height:
            break
        left = max(left, *(j + 1 for j in range(-1, column) if j < 0 or row[j] < height))
        right = min(right, *(j for j in range(column, len(row) + 1) if j == len(row) or row[j] < height))
        boxes.append((first, last + 1, left, right))
    return boxes


def _posts(box: tuple[int, int, int, int]) -> set[tuple[int, int]]:
    return {(i, j) for i in range(box[0], box[1]) for j in range(box[2], box[3])}


def step_field(
    at: tuple[float, float], pattern: str = "flat", *, unit: float = POST, turns: int = 0
) -> tuple[Shape, ...]:
    """Return a pallet of posts.

    Args:
        at: Its middle [m].
        pattern: A key of `STEP_FIELDS`, or custom rows of digits.
        unit: Height of a unit [m]: a post's width in cubic fields, half of it in half cubic ones.
        turns: Quarter turns, counter-clockwise.

    Raises:
        SpecError: The pattern is invalid.
    """
    grid = heights(STEP_FIELDS.get(pattern, pattern))
    size, yaw = (len(grid) * POST, len(grid[0]) * POST), turns * math.pi / 2
    cos, sin = round(math.cos(yaw)), round(math.sin(yaw))
    shapes: list[Shape] = []
    for height, x0, x1, y0, y1 in cover_boxes(grid):
        x, y = (x0 + x1) / 2 * POST - size[0] / 2, (y0 + y1) / 2 * POST - size[1] / 2
        half = ((x1 - x0) * POST / 2, (y1 - y0) * POST / 2, height * unit / 2)
        middle = (at[0] + x * cos - y * sin, at[1] + x * sin + y * cos, half[2])
        shapes.append(
            Shape(kind="box", size=half, at=middle, rotation=(0.0, 0.0, yaw), surface="ground", rgba=WOOD)
        )
    return tuple(shapes)
