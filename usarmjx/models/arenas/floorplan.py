"""Walls from a drawn floor plan, on a square grid as in the NIST arenas (cells of 1.2 m)."""

from usarmjx.base.errors import SpecError
from usarmjx.models.types.shapes import Shape

WALL_RGBA = (0.85, 0.8, 0.6, 1.0)


def _runs(cells: list[bool]) -> list[tuple[int, int]]:
    """Return (start, stop) of each run of true cells, so that a straight wall is one box."""
    runs: list[tuple[int, int]] = []
    start = None
    for i, filled in enumerate([*cells, False]):
        if filled and start is None:
            start = i
        elif not filled and start is not None:
            runs.append((start, i))
            start = None
    return runs


def walls(
    plan: str, *, origin: tuple[float, float], cell: float = 1.2, height: float = 1.2, thickness: float = 0.05
) -> tuple[Shape, ...]:
    """Return the walls of a plan drawn with `+`, `--` and `|` as boxes on the floor.

    The first row of text is the far left (largest y), x grows along a row.

    Args:
        plan: Rows of `+--+  +` (walls along x) alternating with rows of `|  |   ` (walls along y).
        origin: x and y of the plan's lower left corner [m].
        cell: Side of a grid cell [m].
        height: Wall height [m].
        thickness: Wall thickness [m].

    Raises:
        SpecError: The rows do not have the same length.
    """
    rows = plan.strip("\n").splitlines()  # a row of blanks is a row of open cells
    if len({len(row) for row in rows}) != 1 or len(rows) % 2 == 0:
        raise SpecError("a floor plan needs an odd number of rows of the same length")
    columns, lines = (len(rows[0]) - 1) // 3, (len(rows) - 1) // 2
    boxes: list[Shape] = []

    def add(x0: float, y0: float, x1: float, y1: float) -> None:
        half = ((x1 - x0 + thickness) / 2, (y1 - y0 + thickness) / 2, height / 2)
        centre = (origin[0] + (x0 + x1) / 2, origin[1] + (y0 + y1) / 2, height / 2)
        boxes.append(Shape(kind="box", size=half, at=centre, surface="wall", rgba=WALL_RGBA))

    for line in range(lines + 1):
        y = (lines - line) * cell
        along = [rows[2 * line][3 * column + 1] == "-" for column in range(columns)]
        for start, stop in _runs(along):
            add(start * cell, y, stop * cell, y)
    for column in range(columns + 1):
        across = [rows[2 * line + 1][3 * column] == "|" for line in range(lines)]
        for start, stop in _runs(across):
            add(column * cell, (lines - stop) * cell, column * cell, (lines - start) * cell)
    return tuple(boxes)
