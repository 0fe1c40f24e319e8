"""Covers of the occupied cells of a grid by rectangles, and the boxes that they make."""

from dataclasses import dataclass

import numpy as np

from usarmjx.base.transforms import Vec3, mat_from_angles
from usarmjx.models.types.shapes import Rgba, Shape

Cells = tuple[int, int, int, int]
"""First row, row after the last, first column, column after the last."""
MAX_DISJOINT = 300
"""Number of rectangles up to which they do not overlap: the radio counts walls that overlap twice."""
WALL_RGBA: Rgba = (0.85, 0.8, 0.6, 1.0)
"""Colour of walls of a grid."""


@dataclass(frozen=True, kw_only=True)
class GridFrame:
    """Place of a grid's cells, the first one at the lowest x and y of its own axes.

    Attributes:
        origin: x, y and yaw of the outer corner of the first cell.
        cell: Lengths of a cell along its columns' and its rows' direction [m].
    """

    origin: Vec3
    cell: tuple[float, float]

    def there(self, column: float, row: float) -> tuple[float, float]:
        """Return x and y of a point that is given in cells from the first corner."""
        x, y, yaw = self.origin
        local = np.array([column * self.cell[0], row * self.cell[1], 0.0])
        dx, dy, _ = (mat_from_angles(0.0, 0.0, np.float64(yaw)) @ local).tolist()
        return (round(x + dx, 9), round(y + dy, 9))

    def box(self, cells: Cells, low: float, high: float, rgba: Rgba = WALL_RGBA) -> Shape:
        """Return the wall of a rectangle of cells, from a height to another [m]."""
        r0, r1, c0, c1 = cells
        return Shape(
            kind="box",
            size=(
                round((c1 - c0) * self.cell[0] / 2, 9),
                round((r1 - r0) * self.cell[1] / 2, 9),
                (high - low) / 2,
            ),
            at=(*self.there((c0 + c1) / 2, (r0 + r1) / 2), (low + high) / 2),
            rotation=(0.0, 0.0, self.origin[2]),
            surface="wall",
            rgba=rgba,
        )


def cover(filled: np.ndarray, most: float = np.inf) -> list[Cells]:
    """Cover the true cells (rows, columns), and no others, with few rectangles.

    Up to `MAX_DISJOINT` of them do not overlap; more of them may. A list longer than `most` is no cover.
    """
    found = min(rectangles(filled, most), _turned(rectangles(filled.T, most)), key=len)
    if len(found) <= MAX_DISJOINT:
        return found
    return min(found, overlapping_rectangles(filled, most), key=len)


def rectangles(filled: np.ndarray, most: float = np.inf) -> list[Cells]:
    """Cover the true cells (rows, columns) with rectangles, each as long as possible and then as wide.

    It stops after the row that exceeds `most`.
    """
    found: list[Cells] = []
    left = filled.copy()
    for row in range(left.shape[0]):
        if len(found) > most:
            break
        edges = np.flatnonzero(np.diff(left[row].astype(np.int8), prepend=0, append=0))
        for start, stop in edges.reshape(-1, 2).tolist():
            below = np.asarray(left[row:, start:stop].all(axis=1))
            end = row + (len(below) if below.all() else int(below.argmin()))
            left[row:end, start:stop] = False
            found.append((row, end, start, stop))
    return found


def _turned(found: list[Cells]) -> list[Cells]:
    return [(c0, c1, r0, r1) for r0, r1, c0, c1 in found]


def overlapping_rectangles(filled: np.ndarray, most: float = np.inf) -> list[Cells]:
    """Cover the true cells (rows, columns) with rectangles that may overlap.

    Each one holds the first cell that no earlier one holds. It is the longest one along the row or along
    the column through that cell, widened as far as it goes: the one of both that covers more cells first. At
    the end, rectangles whose cells are all in others go. It stops beyond `most`.
    """
    grid = _Sums(filled)
    left = filled.copy()
    found: list[Cells] = []
    for row in range(filled.shape[0]):
        column = 0
        while len(found) <= most:
            ahead = left[row, column:]
            step = int(ahead.argmax()) if len(ahead) else 0
            if not len(ahead) or not ahead[step]:
                break
            column += step
            tries = (grid.longest(row, column), grid.tallest(row, column))
            best = max(tries, key=lambda c: int(left[c[0] : c[1], c[2] : c[3]].sum()))
            left[best[0] : best[1], best[2] : best[3]] = False
            found.append(best)
    return _without_spare(found, filled.shape) if len(found) <= most else found


def _without_spare(found: list[Cells], shape: tuple[int, ...]) -> list[Cells]:
    """Return rectangles without those whose cells are all in others, the smallest ones first."""
    times = np.zeros(shape, np.int32)
    for r0, r1, c0, c1 in found:
        times[r0:r1, c0:c1] += 1
    kept = set(range(len(found)))
    for i in sorted(kept, key=lambda i: (found[i][1] - found[i][0]) * (found[i][3] - found[i][2])):
        r0, r1, c0, c1 = found[i]
        if times[r0:r1, c0:c1].min() > 1:
            times[r0:r1, c0:c1] -= 1
            kept.discard(i)
    return [found[i] for i in sorted(kept)]


class _Sums:
    """Numbers of true cells in rectangles of a grid.

    Args:
        filled: The cells (rows, columns).
    """

    def __init__(self, filled: np.ndarray) -> None:
        self._rows, self._columns = filled.shape
        sums = np.zeros((self._rows + 1, self._columns + 1), np.int32)
        np.cumsum(np.cumsum(filled, axis=0, dtype=np.int32), axis=1, out=sums[1:, 1:])
        self._sums = sums

    def _full(self, r0: int, r1: int, c0: int, c1: int) -> bool:
        sums = self._sums
        inside = int(sums[r1, c1]) - int(sums[r0, c1]) - int(sums[r1, c0]) + int(sums[r0, c0])
        return inside == (r1 - r0) * (c1 - c0)

    def longest(self, row: int, column: int) -> Cells:
        """Return the run of a cell along its row, widened along the columns."""
        c0, c1 = self._along_row(row, row + 1, column, column + 1)
        r0, r1 = self._along_column(row, row + 1, c0, c1)
        return (r0, r1, c0, c1)

    def tallest(self, row: int, column: int) -> Cells:
        """Return the run of a cell along its column, widened along the rows."""
        r0, r1 = self._along_column(row, row + 1, column, column + 1)
        c0, c1 = self._along_row(r0, r1, column, column + 1)
        return (r0, r1, c0, c1)

    def _along_row(self, r0: int, r1: int, c0: int, c1: int) -> tuple[int, int]:
        low, high = 0, c0
        while low < high:
            middle = (low + high) // 2
            low, high = (low, middle) if self._full(r0, r1, middle, c0) else (middle + 1, high)
        first = low
        low, high = c1, self._columns
        while low < high:
            middle = (low + high + 1) // 2
            low, high = (middle, high) if self._full(r0, r1, c1, middle) else (low, middle - 1)
        return first, low

    def _along_column(self, r0: int, r1: int, c0: int, c1: int) -> tuple[int, int]:
        low, high = 0, r0
        while low < high:
            middle = (low + high) // 2
            low, high = (low, middle) if self._full(middle, r0, c0, c1) else (middle + 1, high)
        first = low
        low, high = r1, self._rows
        while low < high:
            middle = (low + high + 1) // 2
            low, high = (middle, high) if self._full(r1, middle, c0, c1) else (low, middle - 1)
        return first, low
