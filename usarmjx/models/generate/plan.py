"""The plan of a generated arena: walls between the cells of a grid, and the ways between them.

The ways are a tree over the cells. An impassable structure takes a leaf of the tree: the rest stays
connected. Walls never cut the tree, so that every robot that fits between two walls can reach the whole rest.
"""

from collections.abc import Iterable, Iterator

from usarmjx.base.random import RandomStream
from usarmjx.models.types.shapes import Shape

CELL = 1.2
"""Side of a cell of the NIST arenas' grid [m]."""
WALL_HEIGHT, THICKNESS = 1.2, 0.05
"""Height and thickness of walls [m]."""
MAX_WALL_CELLS = 4
"""Largest length of a piece of wall [cells]."""
START_CELL = (0, 0)
"""Cell of the first start pose."""
WALL_RGBA = (0.85, 0.8, 0.6, 1.0)
DOUBLE_RGBA = (0.6, 0.6, 0.62, 1.0)

Cell = tuple[int, int]
Edge = tuple[Cell, Cell]
"""Two neighbouring cells, the one with the lower column or row first."""
DIRECTIONS: tuple[Cell, ...] = ((1, 0), (0, 1), (-1, 0), (0, -1))


def edge(a: Cell, b: Cell) -> Edge:
    """Return the edge between two neighbouring cells."""
    return (a, b) if a < b else (b, a)


def middle(cell: Cell) -> tuple[float, float]:
    """Return the middle of a cell [m]; the grid's corner is the arena's origin."""
    return (cell[0] + 0.5) * CELL, (cell[1] + 0.5) * CELL


class CellGrid:
    """Walls and ways of an arena.

    Args:
        size: Columns and rows.

    Attributes:
        walls: Edges with inner walls.
        tree: Tree of ways: the neighbours of each cell.
        kept: Cells that may not be removed.
    """

    def __init__(self, size: tuple[int, int]) -> None:
        self.size = size
        self.walls: set[Edge] = set()
        self.tree: dict[Cell, list[Cell]] = {}
        self.kept: set[Cell] = {START_CELL}

    def cells(self) -> Iterator[Cell]:
        """Yield all cells, column by column."""
        columns, rows = self.size
        return ((column, row) for column in range(columns) for row in range(rows))

    def around(self, cell: Cell) -> list[Cell]:
        """Return the neighbours of a cell."""
        columns, rows = self.size
        beside = [(cell[0] + dx, cell[1] + dy) for dx, dy in DIRECTIONS]
        return [(c, r) for c, r in beside if 0 <= c < columns and 0 <= r < rows]

    def edges(self) -> list[Edge]:
        """Return all edges that can have inner walls."""
        columns, rows = self.size
        return [
            ((c, r), (c + dx, r + dy))
            for c, r in self.cells()
            for dx, dy in DIRECTIONS[:2]
            if c + dx < columns and r + dy < rows
        ]

    def grow_tree(self, draw: RandomStream, *, bushy: bool, barred: Iterable[Cell] = ()) -> None:
        """Grow the tree over all cells that walls do not separate from the base.

        Args:
            draw: Random stream.
            bushy: Whether it has many short branches rather than few long ones.
            barred: Cells outside the tree.
        """
        taken: set[Cell] = {START_CELL, *barred}
        self.tree = {START_CELL: []}
        tips: list[Cell] = [START_CELL]
        while tips:
            # Growth from the last cell makes long corridors, from a random one short branches.
            at = draw.randint(len(tips)) if bushy else -1
            cell = tips[at]
            free = [n for n in self.around(cell) if n not in taken and edge(cell, n) not in self.walls]
            if not free:
                tips.pop(at)
                continue
            new = draw.choice(free)
            taken.add(new)
            tips.append(new)
            self.tree[cell].append(new)
            self.tree[new] = [cell]

    def leaves(self) -> list[Cell]:
        """Return the leaves of the tree that can be removed."""
        return [cell for cell, next_to in self.tree.items() if len(next_to) == 1 and cell not in self.kept]

    def remove_leaf(self, cell: Cell) -> Cell:
        """Remove a leaf of the tree and return its neighbour."""
        (neighbour,) = self.tree.pop(cell)
        self.tree[neighbour].remove(cell)
        return neighbour

    def seal(self, cell: Cell) -> None:
        """Enclose a cell with walls."""
        self.walls.update(edge(cell, neighbour) for neighbour in self.around(cell))

    def wall_shapes(self) -> tuple[list[Shape], list[Shape]]:
        """Return outer and inner walls, straight runs as one box each."""
        columns, rows = self.size
        outer: list[Shape] = []
        inner: list[Shape] = []
        for line in range(columns + 1):
            for a, b in _runs([self._wall((line - 1, r), (line, r)) for r in range(rows)]):
                (inner if 0 < line < columns else outer).append(_wall(line, line, a, b))
        for line in range(rows + 1):
            for a, b in _runs([self._wall((c, line - 1), (c, line)) for c in range(columns)]):
                (inner if 0 < line < rows else outer).append(_wall(a, b, line, line))
        return outer, inner

    def _wall(self, a: Cell, b: Cell) -> bool:
        columns, rows = self.size
        # Beyond the grid is a wall everywhere.
        return not (a[0] >= 0 and a[1] >= 0 and b[0] < columns and b[1] < rows) or (a, b) in self.walls


def _runs(filled: list[bool]) -> Iterator[tuple[int, int]]:
    """Yield (start, stop) of runs of true cells, none longer than `MAX_WALL_CELLS`."""
    start = None
    # The appended False ends a run at the border.
    for i, wall in enumerate([*filled, False]):
        if start is not None and (not wall or i - start == MAX_WALL_CELLS):
            yield start, i
            start = None
        if start is None and wall:
            start = i


def _wall(x0: int, x1: int, y0: int, y1: int) -> Shape:
    """Return a wall along a grid line; its ends reach into the corners by half its thickness."""
    return Shape(
        kind="box",
        size=((x1 - x0) * CELL / 2 + THICKNESS / 2, (y1 - y0) * CELL / 2 + THICKNESS / 2, WALL_HEIGHT / 2),
        at=((x0 + x1) * CELL / 2, (y0 + y1) * CELL / 2, WALL_HEIGHT / 2),
        surface="wall",
        rgba=WALL_RGBA,
    )


def doubled(wall: Shape) -> list[Shape]:
    """Return a wall as two sheets of half its thickness, side by side: the radio counts both."""
    x, y, z = wall.at
    along, across, up = wall.size
    # Half the thickness of a sheet, and the distance of its middle from the wall's.
    half = THICKNESS / 4
    sheets: list[Shape] = []
    for side in (-half, half):
        upright = along < across
        at = (x + side, y, z) if upright else (x, y + side, z)
        size = (half, across, up) if upright else (along, half, up)
        sheets.append(Shape(kind="box", size=size, at=at, surface="wall", rgba=DOUBLE_RGBA))
    return sheets
