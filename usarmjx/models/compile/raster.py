"""Vertical extents of solids above the cells of a grid, and maps of the floor's filled squares.

Boxes are exact, turned and tilted; meshes are their convex hulls; spheres, capsules, cylinders and ellipsoids
the boxes around them; terrain is sampled at the nearest of its heights. A solid is widened by half a cell on
every side (not upwards), so that a wall thinner than a cell is not missed between two.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from usarmjx.base.errors import SpecError
from usarmjx.base.transforms import mat_from_angles
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.shapes import SKY, SURFACES, Shape

MAX_SPAN_ROWS = 10_000_000
"""Largest number of rows of a table: pairs of a solid and a cell."""
VERTICAL_NORMAL_Z = 1e-9
"""Bound on the z component of the normal of a vertical face."""
UPWARD_NORMAL_Z = 0.5
"""Bound on the z component of a normal above which a face is not moved when solids are widened: the move
would raise slopes."""
CELL = 0.05
"""Side of a map's square [m]; doubled until there are no more than `MOST_SQUARES`."""
MOST_SQUARES = 1_000_000
LOWEST, HIGHEST = 0.1, 0.6
"""Heights above the floor between which a solid is an obstacle [m]."""
MARGIN = 0.5
"""Margin of the map around the arena's extent [m]."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Cells of a rectangle; cell (i, j) has its middle at `low + (i + 0.5, j + 0.5) cell`.

    Attributes:
        low: Corner with the lowest x and y [m].
        cell: Side of a cell [m].
        shape: Number of cells along x and y.
    """

    low: tuple[float, float]
    cell: float
    shape: tuple[int, int]

    def index(self, x: float, y: float) -> tuple[int, int]:
        """Return the cell of a point; it may lie outside the grid."""
        return int((x - self.low[0]) // self.cell), int((y - self.low[1]) // self.cell)

    def holds(self, i: int, j: int) -> bool:
        """Return whether a cell is within the grid."""
        return 0 <= i < self.shape[0] and 0 <= j < self.shape[1]


@dataclass(frozen=True, eq=False)
class SpanTable:
    """Vertical extents of solids at the middles of cells; one row per solid and cell.

    Attributes:
        square: Flat index of the cell, i times cells along y plus j (n,).
        low: Lower end of the solid [m] (n,).
        high: Upper end [m] (n,).
        slope: Rise per metre of its upper face (n,).
    """

    square: np.ndarray
    low: np.ndarray
    high: np.ndarray
    slope: np.ndarray


def touchable(shape: Shape) -> bool:
    """Return whether robots can touch a solid of an arena."""
    return shape.material != SKY and bool(SURFACES[shape.surface].contype)


def half_lengths(shape: Shape) -> tuple[float, float, float]:
    """Return the half lengths of the box around a round solid, or of a box itself [m]."""
    a, b, c = (*shape.size, 0.0, 0.0)[:3]
    if shape.kind == "sphere":
        return a, a, a
    if shape.kind == "capsule":
        return a, a, a + b
    if shape.kind == "cylinder":
        return a, a, b
    return a, b, c


def rasterize(shapes: Sequence[Shape], grid: Grid) -> SpanTable:
    """Return the vertical extents over a grid's cells of the solids that robots can touch.

    Raises:
        SpecError: The table would have more than `MAX_SPAN_ROWS` rows.
    """
    solid = [shape for shape in shapes if touchable(shape)]
    parts: list[SpanRows] = []
    for part in _parts(solid, grid):
        parts.append(part)
        _check_total(sum(len(some[0]) for some in parts))
    rows = [np.concatenate(values) for values in zip(*parts, strict=True)]
    return SpanTable(square=rows[0], low=rows[1], high=rows[2], slope=rows[3])


SpanRows = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Columns of a `SpanTable`."""


def _parts(solid: Sequence[Shape], grid: Grid) -> Iterator[SpanRows]:
    yield from (_terrain(shape, grid) for shape in solid if shape.kind == "hfield")
    yield from (_hull(shape, grid) for shape in solid if shape.kind == "mesh")
    yield _boxes([shape for shape in solid if shape.kind not in ("hfield", "mesh")], grid)


def _check_total(squares: int) -> None:
    if squares > MAX_SPAN_ROWS:
        raise SpecError(f"its solids stand over {squares} squares of its plan; at most {MAX_SPAN_ROWS}")


def _boxes(shapes: Sequence[Shape], grid: Grid) -> SpanRows:
    """Return rows of all boxes at once."""
    half = np.array([half_lengths(shape) for shape in shapes]).reshape(-1, 3)
    mid = np.array([shape.at for shape in shapes]).reshape(-1, 3)
    angles = np.array([shape.rotation for shape in shapes]).reshape(-1, 3)
    mat = mat_from_angles(angles[:, 0], angles[:, 1], angles[:, 2])
    normals = np.concatenate([mat.swapaxes(-1, -2), -mat.swapaxes(-1, -2)], axis=1)
    offsets = (normals * mid[:, None]).sum(-1) + np.concatenate([half, half], axis=1)
    # Half lengths of the upright boxes around turned ones.
    reach = (np.abs(mat) * half[:, None]).sum(-1)
    return _rows(normals, offsets, mid[:, :2] - reach[:, :2], mid[:, :2] + reach[:, :2], grid)


def _hull(shape: Shape, grid: Grid) -> SpanRows:
    from scipy.spatial import ConvexHull  # imports in half the time of JAX; only meshes need it

    assert shape.mesh is not None
    corners = shape.mesh.vertices @ mat_from_angles(*np.array(shape.rotation)).T + shape.at
    # Qhull's faces are n x + d <= 0, those of `_rows` n x <= offset.
    faces = ConvexHull(corners).equations
    low, high = corners[:, :2].min(0), corners[:, :2].max(0)
    return _rows(faces[None, :, :3], -faces[None, :, 3], low[None], high[None], grid)


def _rows(
    normals: np.ndarray, offsets: np.ndarray, low: np.ndarray, high: np.ndarray, grid: Grid
) -> SpanRows:
    """Cut vertical lines through the cells' middles with convex solids given by their faces.

    Args:
        normals: Normals of each solid's faces (n, faces, 3).
        offsets: Offsets of the faces: a point p is inside where `normals @ p <= offsets` for all (n, faces).
        low: Lowest x and y of each solid (n, 2).
        high: Highest x and y (n, 2).
        grid: The cells.
    """
    owner, i, j = _windows(low, high, grid)
    # Widens solids by half a cell: what stands anywhere in a cell then fills its middle.
    across = np.hypot(normals[..., 0], normals[..., 1])
    offsets = offsets + np.where(normals[..., 2] > UPWARD_NORMAL_Z, 0.0, across * grid.cell / 2)
    x = grid.low[0] + (i + 0.5) * grid.cell
    y = grid.low[1] + (j + 0.5) * grid.cell
    ends_low, ends_high = np.full(len(owner), -np.inf), np.full(len(owner), np.inf)
    steep, inside = np.zeros(len(owner)), np.ones(len(owner), bool)
    # Faces that point up bound the line from above, those that point down from below; upright ones only
    # decide whether the line meets the solid.
    for face in range(normals.shape[1]):
        normal = normals[:, face]
        left = offsets[owner, face] - normal[owner, 0] * x - normal[owner, 1] * y
        up = normal[owner, 2]
        upright = np.abs(up) < VERTICAL_NORMAL_Z
        inside &= ~upright | (left >= 0.0)
        # Upright faces cut no point off the line: 1 in place of their 0 keeps the quotient finite.
        cut = left / np.where(upright, 1.0, up)
        lower = (up >= VERTICAL_NORMAL_Z) & (cut < ends_high)
        ends_high = np.where(lower, cut, ends_high)
        steep = np.where(lower, across[owner, face] / np.where(upright, 1.0, up), steep)
        ends_low = np.where((up <= -VERTICAL_NORMAL_Z) & (cut > ends_low), cut, ends_low)
    inside &= ends_high > ends_low
    square = i * grid.shape[1] + j
    return square[inside], ends_low[inside], ends_high[inside], steep[inside]


def _windows(low: np.ndarray, high: np.ndarray, grid: Grid) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (solid, i, j) of all cells that each solid may fill."""
    limit = np.array(grid.shape)
    # Middles lie half a cell in; a solid turned by 45 degrees is widened by 0.71 cells along an axis.
    first = np.ceil((low - grid.low) / grid.cell - 1.25).astype(int).clip(0, limit)
    last = np.floor((high - grid.low) / grid.cell + 1.25).astype(int).clip(0, limit)
    count = last - first
    each = count.prod(-1)
    _check_total(int(each.sum()))
    owner = np.repeat(np.arange(len(low)), each)
    # Numbers within each solid's window: its first row of the list is taken off.
    index = np.arange(len(owner)) - np.repeat(np.cumsum(each) - each, each)
    return owner, first[owner, 0] + index // count[owner, 1], first[owner, 1] + index % count[owner, 1]


def _terrain(shape: Shape, grid: Grid) -> SpanRows:
    """Return rows of a height field, which may be turned about the vertical, not tilted."""
    assert shape.heights is not None
    heights = np.asarray(shape.heights.heights, float)
    rows, lines = heights.shape
    length, width, base = shape.size[0], shape.size[1], shape.size[-1]
    i, j = (axis.ravel() for axis in np.indices(grid.shape))
    x = grid.low[0] + (i + 0.5) * grid.cell - shape.at[0]
    y = grid.low[1] + (j + 0.5) * grid.cell - shape.at[1]
    cos, sin = np.cos(shape.rotation[2]), np.sin(shape.rotation[2])
    along, across = cos * x + sin * y, cos * y - sin * x
    inside = (np.abs(along) <= length) & (np.abs(across) <= width)
    line = np.rint((along[inside] / length + 1) / 2 * (lines - 1)).astype(int)
    row = np.rint((across[inside] / width + 1) / 2 * (rows - 1)).astype(int)
    slope_y, slope_x = np.gradient(heights, 2 * width / max(rows - 1, 1), 2 * length / max(lines - 1, 1))
    high = shape.at[2] + heights[row, line]
    low = np.full(len(high), shape.at[2] - base)
    return (i * grid.shape[1] + j)[inside], low, high, np.hypot(slope_x, slope_y)[row, line]


def floor_map(arena: ArenaSpec) -> tuple[Grid, np.ndarray]:
    """Return the squares of an arena's map, and which of them a fixed solid fills (i, j).

    Solids are widened by half a square on each side. Loose objects and doors are left out.
    """
    cell, spans = CELL, [(low - MARGIN, high + MARGIN) for low, high in arena.extent]
    while math.prod((high - low) / cell for low, high in spans) > MOST_SQUARES:
        cell *= 2
    columns, rows = (max(1, math.ceil((high - low) / cell)) for low, high in spans)
    grid = Grid(low=(spans[0][0], spans[1][0]), cell=cell, shape=(columns, rows))
    table = rasterize(arena.shapes, grid)
    blocks = (table.high > LOWEST) & (table.low < HIGHEST)  # above the floor
    filled = np.zeros(grid.shape, bool)
    filled.reshape(-1)[table.square[blocks]] = True
    return grid, filled
