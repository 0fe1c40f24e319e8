"""Maps of ROS' map_server as walls: an image of occupancy, and a YAML file that describes it."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import numpy as np

from usarmjx.base.errors import ArenaFileError
from usarmjx.base.settings import NOT_NEGATIVE, POSITIVE, FileValue, Setting
from usarmjx.base.settings.reader import Reader
from usarmjx.base.transforms import Vec3
from usarmjx.models.files.content import Content, Rectangle
from usarmjx.models.files.grid_cover import GridFrame, cover
from usarmjx.models.files.images import read_grey

DEFAULT_WALL_HEIGHT = 1.2
"""Default height of walls [m]: the NIST arenas'."""
MAX_MAP_BOXES = 10_000
"""Largest number of boxes of a map."""
GRADED_WALL_VALUE = 50
"""Value from which a cell of a graded map is a wall, from 0 (free) to 100 (occupied)."""
LAST_RAW = 100
"""Largest known raw value; higher ones are unknown, as map_server's -1."""
Unknown = Literal["free", "occupied"]
"""Treatment of unknown cells."""
OTHERS_KEYS = ("cost_translation_table", "frame_id", "height", "image_format", "name", "stamp", "width")
"""Keys that other tools write into such files; map_server ignores them."""
MIN_CELL, MAX_CELL = 0.01, 1.0
"""Sides of a cell outside which a map's scale is doubted [m]."""


@dataclass(frozen=True, kw_only=True)
class MapDescription:
    """A YAML file of map_server, and `min_blob`.

    Attributes:
        image: Picture of the cells, from the file's folder.
        resolution: Side of a cell [m].
        origin: x and y of the outer corner of the lowest left cell, and yaw, 0 if left out.
        negate: Whether dark cells are free; map_server writes 0 or 1.
        occupied_thresh: Darkness above which a cell is occupied, 1 being black.
        free_thresh: Darkness below which a cell is free.
        mode: Meaning of the picture's values; see `read_occupancy_grid`.
        min_blob: Length below which groups of occupied cells are left out [m]; map_server ignores the key.
    """

    image: Path
    resolution: Annotated[float, POSITIVE]
    origin: tuple[float, float, Annotated[float, Setting(unit="rad")]] | tuple[float, float] = (0.0, 0.0, 0.0)
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

    @property
    def frame(self) -> GridFrame:
        """Place of the cells."""
        return GridFrame(origin=self.origin, cell=(self.resolution, self.resolution))


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
    given = READER.from_data(MapDescription, _own_keys(value))
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
    x, y, yaw = (*given.origin, 0.0)[:3]
    return OccupancyGrid(wall, free, given.resolution, (x, y, yaw), specks)


def _own_keys(value: FileValue) -> FileValue:
    """Return a map's file without the keys that map_server ignores."""
    return replace(value, data={key: one for key, one in value.mapping().items() if key not in OTHERS_KEYS})


def _doubts(value: FileValue, plan: OccupancyGrid) -> tuple[str, ...]:
    """Return keys that have no effect, and a scale that is hardly meant."""
    given = value.mapping()
    others = [key for key in OTHERS_KEYS if key in given]
    found = [f"{given[others[0]].place}: {', '.join(others)} of the map left out"] if others else []
    if not MIN_CELL <= plan.resolution <= MAX_CELL:
        found.append(
            f"{given['resolution'].place}: a cell is {plan.resolution:g} m long; `resolution` is that "
            "length in metres, as 0.05"
        )
    return tuple(found)


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
    boxes = cover(plan.wall, MAX_MAP_BOXES)
    if len(boxes) > MAX_MAP_BOXES:
        raise value.error(
            f"the map makes more than the {MAX_MAP_BOXES} boxes that are allowed: set min_blob in it, the "
            "length below which specks are left out [m], or halve its size and double its resolution"
        )
    specks = (f"{value.path}: min_blob leaves out {plan.specks} specks",) if plan.specks else ()
    return Content(
        shapes=tuple(plan.frame.box(box, 0.0, height) for box in boxes),
        extent=_extent(plan),
        free_position=_free_position(plan),
        warnings=_doubts(value, plan) + specks + (() if plan.free.any() else (_nowhere(value, plan),)),
    )


def _nowhere(value: FileValue, plan: OccupancyGrid) -> str:
    rows, columns = plan.wall.shape
    return (
        f"{value.path}: the map has no free cell: of {columns} x {rows}, {plan.wall.sum()} are walls and the "
        "others unknown; mind `negate`, `occupied_thresh` and `free_thresh`; transparent pixels count by "
        "their colour"
    )


def _extent(plan: OccupancyGrid) -> Rectangle:
    rows, columns = plan.wall.shape
    corners = np.array([plan.frame.there(c, r) for c in (0, columns) for r in (0, rows)])
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
    return plan.frame.there(float(column) + 0.5, float(row) + 0.5)
