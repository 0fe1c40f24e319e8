"""Step fields: pallets of square posts, the arenas' repeatable rubble.

After Jacoff, Downs, Virts and Messina, "Stepfield Pallets: Repeatable Terrain for Evaluating Robot Mobility"
(PerMIS 2008): posts cut to whole units, one unit being a post's width, in patterns that tend to flat ground,
a hill or a diagonal hill. Half cubic fields, with units of half a width, are the orange arena's. The posts'
places are ours; the patterns are the same after half a turn, as the symmetric fields of ASTM E2828 are.
"""

import math

from usarmjx.base.errors import SpecError
from usarmjx.models.arenas.elements import WOOD
from usarmjx.models.spec.shapes import Shape

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
    """Return few boxes with the same top as one post per place: (height, first and last row and column).

    A box may reach under higher ones, where no one sees it: a lone post on flat ground is one box more. The
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
    """Return for every length along the rows the widest box from that post on that none is lower than."""
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
        pattern: A key of `STEP_FIELDS`, or rows of digits of one's own.
        unit: Height of a unit [m]: a post's width in cubic fields, half of it in half cubic ones.
        turns: Quarter turns, counter-clockwise.

    Raises:
        SpecError: The pattern is not drawn as it should be.
    """
    grid = heights(STEP_FIELDS.get(pattern, pattern))
    size, yaw = (len(grid) * POST, len(grid[0]) * POST), turns * math.pi / 2
    cos, sin = round(math.cos(yaw)), round(math.sin(yaw))
    shapes: list[Shape] = []
    for height, x0, x1, y0, y1 in cover_boxes(grid):
        x, y = (x0 + x1) / 2 * POST - size[0] / 2, (y0 + y1) / 2 * POST - size[1] / 2
        half = ((x1 - x0) * POST / 2, (y1 - y0) * POST / 2, height * unit / 2)
        place = (at[0] + x * cos - y * sin, at[1] + x * sin + y * cos, half[2])
        shapes.append(
            Shape(kind="box", size=half, at=place, rotation=(0.0, 0.0, yaw), surface="ground", rgba=WOOD)
        )
    return tuple(shapes)
