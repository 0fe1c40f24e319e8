"""Maps of ROS' map_server as walls: an image of occupancy, and a YAML file that describes it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import numpy as np

from usarmjx.base.errors import ArenaFileError
from usarmjx.base.settings import NOT_NEGATIVE, POSITIVE, FileValue, Setting
from usarmjx.base.settings.reader import Reader
from usarmjx.base.transforms import Vec3, mat_from_angles
from usarmjx.models.files.content import Content, Rectangle
from usarmjx.models.files.images import read_grey
from usarmjx.models.types.shapes import Shape

DEFAULT_WALL_HEIGHT = 1.2
"""Default height of walls [m]: the NIST arenas'."""
MAX_MAP_BOXES = 2000
"""Largest number of boxes of a map."""
WALL_RGBA = (0.85, 0.8, 0.6, 1.0)
GRADED_WALL_VALUE = 50
"""Value from which a cell of a graded map is a wall, from 0 (free) to 100 (occupied)."""
LAST_RAW = 100
"""Largest known raw value; higher ones are unknown, as map_server's -1."""
Unknown = Literal["free", "occupied"]
"""Treatment of unknown cells."""

Cells = tuple[int, int, int, int]
"""First row, row after the last, first column, column after the last."""


@dataclass(frozen=True, kw_only=True)
class MapDescription:
    """A YAML file of map_server, and `min_blob`.

    Attributes:
        image: Picture of the cells, from the file's folder.
        resolution: Side of a cell [m].
        origin: x and y of the outer corner of the lowest left cell, and yaw.
        negate: Whether dark cells are free; map_server writes 0 or 1.
        occupied_thresh: Darkness above which a cell is occupied, 1 being black.
        free_thresh: Darkness below which a cell is free.
        mode: Meaning of the picture's values; see `read_occupancy_grid`.
        min_blob: Length below which groups of occupied cells are left out [m]; map_server ignores the key.
    """

    image: Path
    resolution: Annotated[float, POSITIVE]
    origin: tuple[float, float, Annotated[float, Setting(unit="rad")]] = (0.0, 0.0, 0.0)
    negate: Annotated[int, Setting(ge=0, le=1)] | bool = 0
    occupied_thresh: float = 0.65
    free_thresh: float = 0.196
    mode: Literal["trinary", "scale", "raw"] = "trinary"
    min_blob: Annotated[float, NOT_NEGATIVE] = 0.0

    def problem(self) -> str:
        """Return the contradiction between the thresholds; empty: there is none."""
        low, high = self.free_thresh, self.occupied_thresh
        return f"free_thresh {low} is above occupied_thresh {high}" if low > high else ""


READER = Reader(refusal=ArenaFileError, single_precision=False)
"""Reader of map_server's files."""


@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """A map's cells.

    Attributes:
        wall: Whether each cell is a wall (rows, columns), the lowest row of y first.
        free: Whether each cell is certainly free (rows, columns).
        resolution: Side of a cell [m].
        origin: x, y and yaw of the outer corner of the first cell.
        specks: Number of groups of wall cells that were too small for `min_blob`.
    """

    wall: np.ndarray
    free: np.ndarray
    resolution: float
    origin: Vec3
    specks: int = 0


def is_map(value: FileValue) -> bool:
    """Return whether a YAML file is one of map_server's."""
    return isinstance(value.data, dict) and {"image", "resolution"} <= set(value.data)


def read_occupancy_grid(value: FileValue, unknown: Unknown = "free") -> OccupancyGrid:
    """Return the map that a YAML file of map_server describes.

    The modes are map_server's: `trinary` and `scale` compare the mean m of a pixel's channels as (255 - m) /
    255, or m / 255 if `negate`, with the thresholds: above occupied_thresh is occupied, below free_thresh is
    free; in between it is unknown, or with `scale`, unless transparent, graded: a wall from the middle on. In
    `raw` maps a cell is a wall from 100 times occupied_thresh on, and unknown above 100.

    Args:
        value: The file.
        unknown: Treatment of unknown cells.

    Raises:
        ArenaFileError: A wrong key or value, or an unreadable image.
    """
    given = READER.from_data(MapDescription, value)
    low, high, mode = given.free_thresh, given.occupied_thresh, given.mode
    mean, opaque = read_grey(given.image)
    if given.negate:
        mean = 255 - mean
    if mode == "raw":
        wall, free = (mean >= 100 * high) & (mean <= LAST_RAW), mean < 100 * low
        lost = mean > LAST_RAW
    else:
        share = (255 - mean) / 255
        wall, free = share > high, share < low
        lost = ~wall & ~free
        if mode == "scale":
            lost &= ~opaque
            graded = 1 + 98 * (share - low) / max(high - low, 1e-9)
            wall |= ~wall & ~free & ~lost & (graded >= GRADED_WALL_VALUE)
    if unknown == "occupied":
        wall = wall | lost
    wall, specks = without_specks(wall, given.min_blob / given.resolution)
    return OccupancyGrid(wall, free, given.resolution, given.origin, specks)


def without_specks(wall: np.ndarray, smallest: float) -> tuple[np.ndarray, int]:
    """Remove connected groups of cells that are shorter than `smallest` cells in both directions.

    Cells that touch at a corner belong together: a thin wall that runs askew is one group.

    Args:
        wall: The cells (rows, columns).
        smallest: Length along an axis from which a group stays [cells].

    Returns:
        The cells that stay, and the number of groups removed.
    """
    if smallest <= 1:
        return wall, 0
    from scipy import ndimage  # pyright: ignore[reportMissingTypeStubs]

    tools = cast("Any", ndimage)
    label, count = tools.label(wall, np.ones((3, 3)))
    small = [
        number
        for number, (rows, columns) in enumerate(tools.find_objects(label), 1)
        if max(rows.stop - rows.start, columns.stop - columns.start) < smallest - 1e-9
    ]
    drop = np.zeros(count + 1, bool)
    drop[small] = True
    return wall & ~drop[label], len(small)


def occupancy_grid_content(
    value: FileValue, height: float = DEFAULT_WALL_HEIGHT, unknown: Unknown = "free"
) -> Content:
    """Return a map as walls, `height` metres high, merged into few boxes.

    Raises:
        ArenaFileError: See `read_occupancy_grid`; or the map has too many walls.
    """
    plan = read_occupancy_grid(value, unknown)
    boxes = min(
        rectangles(plan.wall, MAX_MAP_BOXES), _turned(rectangles(plan.wall.T, MAX_MAP_BOXES)), key=len
    )
    if len(boxes) > MAX_MAP_BOXES:
        raise value.error(
            f"the map makes more than the {MAX_MAP_BOXES} boxes that are allowed: set min_blob in it, the "
            "length below which specks are left out [m], or halve its size and double its resolution"
        )
    specks = (f"{value.path}: min_blob leaves out {plan.specks} specks",) if plan.specks else ()
    return Content(
        shapes=tuple(_box(plan, box, height) for box in boxes),
        extent=_extent(plan),
        free_position=_free_position(plan),
        warnings=specks + (() if plan.free.any() else (_nowhere(value, plan),)),
    )


def _nowhere(value: FileValue, plan: OccupancyGrid) -> str:
    rows, columns = plan.wall.shape
    return (
        f"{value.path}: the map has no free cell: of {columns} x {rows}, {plan.wall.sum()} are walls and the "
        "others unknown; mind `negate`, `occupied_thresh` and `free_thresh`"
    )


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


def _there(plan: OccupancyGrid, column: float, row: float) -> tuple[float, float]:
    """Return x and y of a point on a map, given in cells from its first corner."""
    x, y, yaw = plan.origin
    local = np.array([column * plan.resolution, row * plan.resolution, 0.0])
    dx, dy, _ = (mat_from_angles(0.0, 0.0, np.float64(yaw)) @ local).tolist()
    return (round(x + dx, 9), round(y + dy, 9))


def _box(plan: OccupancyGrid, cells: Cells, height: float) -> Shape:
    r0, r1, c0, c1 = cells
    half = plan.resolution / 2
    return Shape(
        kind="box",
        size=(round((c1 - c0) * half, 9), round((r1 - r0) * half, 9), height / 2),
        at=(*_there(plan, (c0 + c1) / 2, (r0 + r1) / 2), height / 2),
        rotation=(0.0, 0.0, plan.origin[2]),
        surface="wall",
        rgba=WALL_RGBA,
    )


def _extent(plan: OccupancyGrid) -> Rectangle:
    rows, columns = plan.wall.shape
    corners = np.array([_there(plan, c, r) for c in (0, columns) for r in (0, rows)])
    (x0, y0), (x1, y1) = corners.min(0).tolist(), corners.max(0).tolist()
    return ((x0, x1), (y0, y1))


def _free_position(plan: OccupancyGrid) -> tuple[float, float] | None:
    """Return the free position farthest from all cells that are not free."""
    from scipy import ndimage  # pyright: ignore[reportMissingTypeStubs]

    distance = cast("Any", ndimage).distance_transform_edt

    if not plan.free.any():
        return None
    away = np.asarray(distance(np.pad(plan.free, 1)))[1:-1, 1:-1]
    row, column = np.unravel_index(int(away.argmax()), away.shape)
    return _there(plan, float(column) + 0.5, float(row) + 0.5)
