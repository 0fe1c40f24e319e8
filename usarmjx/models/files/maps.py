"""Grid maps as walls: ROS' map_server (an image and a YAML file), and MovingAI's .map and .scen.

A scenario's rows are start poses.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import numpy as np

from usarmjx.base.errors import ArenaFileError, UsageError
from usarmjx.base.settings import NOT_NEGATIVE, POSITIVE, FileValue, Setting
from usarmjx.base.settings.files import read_bytes
from usarmjx.base.settings.reader import Reader
from usarmjx.base.settings.yaml_file import read_yaml
from usarmjx.base.transforms import Vec3, mat_from_angles
from usarmjx.models.files.content import Content, Rectangle
from usarmjx.models.files.images import read_grey
from usarmjx.models.types.arena import START_ELEVATION, StartPose
from usarmjx.models.types.shapes import Rgba, Shape

Cells = tuple[int, int, int, int]
"""First row, row after the last, first column, column after the last."""
MAX_DISJOINT = 300
"""Number of rectangles up to which they do not overlap: the radio counts walls that overlap twice."""
WALL_RGBA: Rgba = (0.85, 0.8, 0.6, 1.0)
"""Colour of walls of a grid."""
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
MAP_VALUES = (0, 205, 254, 255)
"""Grey values that map_server's saver writes: occupied, unknown, free, and white."""
ADVICE = (
    "for walls, load a YAML file with `image: {name}`, `resolution: 0.05` (metres a pixel) and "
    "`origin: [0, 0]`; for hills, one with `heightfield: {{file: {name}, size: [10, 10], height: 1}}`"
)
"""Lines to write in place of such a picture."""


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
        # The origin is the pose of the lower left corner, and cells turn about it, as in map_server.
        local = np.array([column * self.cell[0], row * self.cell[1], 0.0])
        dx, dy, _ = (mat_from_angles(0.0, 0.0, np.float64(yaw)) @ local).tolist()
        # Rounded to a nanometre, so that neighbouring boxes share their corners to the bit.
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
    # Rows first or columns first: maps of long corridors differ by a factor.
    found = min(rectangles(filled, most), _turned(rectangles(filled.T, most)), key=len)
    # The radio counts walls on a line: two that overlap would weaken it twice.
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
        # The caller refuses such a map: going on would only cost time.
        if len(found) > most:
            break
        # Steps up and down alternate: pairs of them are runs of true cells.
        edges = np.flatnonzero(np.diff(left[row].astype(np.int8), prepend=0, append=0))
        for start, stop in edges.reshape(-1, 2).tolist():
            # Only rows that have the whole run: a rectangle must not hold a free cell.
            below = np.asarray(left[row:, start:stop].all(axis=1))
            # argmin of booleans is the first False, and 0 where there is none.
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
    # Counts of rectangles over each cell: one whose cells all have two is spare.
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
        # A border of zeros spares the special cases of the first row and column.
        np.cumsum(np.cumsum(filled, axis=0, dtype=np.int32), axis=1, out=sums[1:, 1:])
        self._sums = sums

    def _full(self, r0: int, r1: int, c0: int, c1: int) -> bool:
        sums = self._sums
        # Sums over all cells above and left of a corner: four of them give any rectangle.
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
        # Bisection: a run that is full stays full when it is shortened.
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
        # map_server takes the picture's values for percentages here; 101 to 255 are unknown.
        wall, free = (mean >= 100 * high) & (mean <= LAST_RAW), mean < 100 * low
        lost = mean > LAST_RAW
    else:
        share = (255 - mean) / 255
        wall, free = share > high, share < low
        # Between the thresholds.
        lost = ~wall & ~free
        if mode == "scale":
            lost &= ~opaque
            # map_server's own formula: 1 to 99 between the thresholds.
            graded = 1 + 98 * (share - low) / max(high - low, 1e-9)
            wall |= ~wall & ~free & ~lost & (graded >= GRADED_WALL_VALUE)
    if unknown == "occupied":
        wall = wall | lost
    wall, specks = without_specks(wall, given.min_blob / given.resolution)
    # An origin of two numbers has yaw 0; of three the appended one is cut off.
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
    # All eight neighbours: scipy's default has the four at the sides only.
    label, count = tools.label(wall, np.ones((3, 3)))
    small = [
        number
        for number, (rows, columns) in enumerate(tools.find_objects(label), 1)
        if max(rows.stop - rows.start, columns.stop - columns.start) < smallest - 1e-9
    ]
    # A table by label: one look-up for all cells instead of a comparison for each group. Label 0 is no group.
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
    # Padded with cells that are not free: the edge of the map counts as a wall.
    away = np.asarray(distance(np.pad(plan.free, 1)))[1:-1, 1:-1]
    row, column = np.unravel_index(int(away.argmax()), away.shape)
    return plan.frame.there(float(column) + 0.5, float(row) + 0.5)


def check_picture(path: Path) -> None:
    """Refuse a picture that is a map of walls: it has two values only, map_server's, or a map's YAML file.

    Raises:
        ArenaFileError: It is one; says what to write.
    """
    for suffix in (".yaml", ".yml"):
        # map_server's saver gives a picture and its description one name.
        beside = path.with_suffix(suffix)
        if beside.is_file() and _names(beside, path):
            raise ArenaFileError(f"{path}: is the picture of the map {beside.name}: load that file")
    grey, _ = read_grey(path)
    # Rounded: the mean of three channels need not be whole.
    values = np.unique(np.rint(grey))
    if len(values) <= 2 or np.isin(values, MAP_VALUES).all():
        shown = ", ".join(f"{value:g}" for value in values.tolist())
        advice = ADVICE.format(name=path.name)
        raise ArenaFileError(f"{path}: has the grey values {shown} only, as a map of walls: {advice}")


def _names(file: Path, picture: Path) -> bool:
    """Return whether a YAML file is a map with that picture."""
    try:
        value = read_yaml(file, ArenaFileError)
    except UsageError:
        return False
    if not is_map(value):
        return False
    name = value.mapping()["image"].data
    # The last part only: the folder may differ where files were moved.
    return isinstance(name, str) and Path(name).name == picture.name


DEFAULT_CELL = 1.0
"""Side of a cell [m] (chosen: a P2AT turns in it)."""
MAX_CELLS = 16_000_000
"""Largest number of cells of a map."""
FREE, WALLS, LOW = ".GS", "@OT", "W"
"""Letters of cells: passable ones, barriers as high as walls, and water, which is a low barrier."""
LOW_HEIGHT = 0.3
"""Height of the barriers that stand for water [m]: too high to be climbed, too low to be hidden behind."""
LOW_RGBA = (0.2, 0.4, 0.7, 1.0)
MAX_SCENARIO_ROWS = 16
"""Largest number of rows of a scenario that become start poses."""
ROW_WORDS = 9
"""Words in a row of a scenario: bucket, map, width, height, x and y of start and goal, optimal length."""


@dataclass(frozen=True, eq=False)
class GridMap:
    """The cells of a map.

    Attributes:
        letters: Code of each cell's letter (rows, columns), the lowest row of y first.
        path: Its file.
        line: Line of its first row, the one with the largest y.
        behind: Line of the first text behind the last row; 0: there is none.
    """

    letters: np.ndarray
    path: Path
    line: int
    behind: int = 0

    def at(self, x: int, y: int) -> tuple[int, int]:
        """Return row and column of a cell by MovingAI's x and y, whose y runs downwards."""
        # Rows are stored from the bottom, as all grids here; MovingAI counts them from the top.
        return self.letters.shape[0] - 1 - y, x


def moving_ai_content(path: Path, cell: float = DEFAULT_CELL, height: float = DEFAULT_WALL_HEIGHT) -> Content:
    """Return a map as walls, or a scenario as its map with start poses.

    The first row of the file is far, at the largest y; the origin is the outer corner of the lowest left
    cell. Letters: `.`, `G` and `S` (swamp) are floor; `@`, `O` and `T` are walls; `W` (water) is a low
    barrier. Rows of a scenario become the start poses "Start1", "Goal1" and so on, up to `MAX_SCENARIO_ROWS`
    of them; those whose cells are taken already are left out.

    Args:
        path: File that ends in .map or .scen.
        cell: Side of a cell [m].
        height: Height of the walls [m].

    Raises:
        ArenaFileError: An unreadable file; names it and the line.
    """
    if path.suffix.lower() == ".scen":
        return _scenario(path, cell, height)
    return _walls(read_grid_map(path), cell, height)


def read_grid_map(path: Path) -> GridMap:
    """Return the cells of a file that ends in .map.

    Raises:
        ArenaFileError: An unreadable file; names it and the line.
    """
    lines = _lines(path)
    height, width, row = _head(path, lines)
    rows = lines[row : row + height]
    for number, line in enumerate(rows, row + 1):
        if len(line) != width:
            raise ArenaFileError(f"{path}:{number}: {len(line)} cells in the row, expected {width}")
    if len(rows) < height:
        raise ArenaFileError(f"{path}: ends after {len(rows)} of {height} rows")
    # Latin-1 has a byte for each character: the array has the shape of the text.
    letters = np.frombuffer("".join(rows).encode("latin-1"), np.uint8).reshape(height, width)
    unknown = ~np.isin(letters, [ord(letter) for letter in FREE + WALLS + LOW])
    if unknown.any():
        first = int(np.flatnonzero(unknown.any(1))[0])
        letter = chr(int(letters[first][unknown[first]][0]))
        allowed = ", ".join(FREE + WALLS + LOW)
        raise ArenaFileError(f"{path}:{row + 1 + first}: no cell is {letter!r}; allowed: {allowed}")
    end = row + height
    behind = next((number for number, line in enumerate(lines[end:], end + 1) if line.strip()), 0)
    # The last line of the file is the lowest row.
    return GridMap(letters[::-1], path, row + 1, behind)


def _head(path: Path, lines: list[str]) -> tuple[int, int, int]:
    """Return the height and width of a map, and the number of lines of its head."""
    sizes: dict[str, int] = {}
    row = 0
    for row, line in enumerate(lines, 1):
        words = line.split()
        if words == ["map"]:
            break
        if len(words) != 2 or words[0] not in ("type", "height", "width"):
            raise ArenaFileError(
                f"{path}:{row}: {_shown(line)} is no line of a map's head: expected type, height, width, map"
            )
        if words[0] != "type":
            sizes[words[0]] = _whole(path, row, words[1], MAX_CELLS)
    else:
        raise ArenaFileError(f"{path}: has no line `map` above its cells")
    if len(sizes) < 2:
        raise ArenaFileError(f"{path}:{row}: height and width come before `map`")
    height, width = sizes["height"], sizes["width"]
    if height * width > MAX_CELLS or min(height, width) < 1:
        raise ArenaFileError(f"{path}: {width} x {height} cells; from 1 to {MAX_CELLS} in all")
    return height, width, row


def _lines(path: Path) -> list[str]:
    return read_bytes(path, refusal=ArenaFileError).decode("latin-1").splitlines()


def _shown(line: str) -> str:
    return repr(line if len(line) <= 40 else f"{line[:40]}...")


def _whole(path: Path, line: int, word: str, most: int) -> int:
    # Long words are no sizes, and `int` takes its time for thousands of digits.
    number = int(word) if word.isdecimal() and word.isascii() and len(word) < 10 else -1
    if not 0 <= number <= most:
        raise ArenaFileError(f"{path}:{line}: {_shown(word)} is no whole number from 0 to {most}")
    return number


def _is(grid: GridMap, letters: str) -> np.ndarray:
    return np.isin(grid.letters, [ord(letter) for letter in letters])


def _walls(grid: GridMap, cell: float, height: float) -> Content:
    """Return the cells that are not free as walls."""
    frame = GridFrame(origin=(0.0, 0.0, 0.0), cell=(cell, cell))
    walls, low = _is(grid, WALLS), _is(grid, LOW)
    # Walls and water apart: a box has one height and one colour.
    boxes = cover(walls, MAX_MAP_BOXES)
    bars = cover(low, MAX_MAP_BOXES) if low.any() else []
    if len(boxes) + len(bars) > MAX_MAP_BOXES:
        raise ArenaFileError(
            f"{grid.path}: the map makes more than the {MAX_MAP_BOXES} boxes that are allowed"
        )
    notes: list[str] = []
    for letters, what in (("S", "swamp: floor here"), (LOW, f"water: a barrier of {LOW_HEIGHT} m here")):
        found = _is(grid, letters)
        if found.any():
            # Rows count from the bottom, lines of the file from the top.
            line = grid.line + int(np.flatnonzero(found[::-1].any(1))[0])
            notes.append(f"{grid.path}:{line}: {int(found.sum())} cells {letters} are {what}")
    rows, columns = walls.shape
    if grid.behind:
        notes.append(f"{grid.path}:{grid.behind}: lines after the {rows} rows are left out")
    return Content(
        shapes=(
            *(frame.box(box, 0.0, height) for box in boxes),
            *(frame.box(box, 0.0, min(LOW_HEIGHT, height), LOW_RGBA) for box in bars),
        ),
        extent=((0.0, columns * cell), (0.0, rows * cell)),
        warnings=tuple(notes),
    )


def _scenario(path: Path, cell: float, height: float) -> Content:
    """Return a scenario's map with start poses."""
    lines = _lines(path)
    if not lines or lines[0].split()[:1] != ["version"]:
        raise ArenaFileError(f"{path}:1: a scenario begins with `version`")
    rows = [(number, line.split()) for number, line in enumerate(lines[1:], 2) if line.strip()]
    if not rows:
        raise ArenaFileError(f"{path}: names no map: it has no rows")
    for number, words in rows:
        if len(words) != ROW_WORDS:
            raise ArenaFileError(
                f"{path}:{number}: {len(words)} words, expected {ROW_WORDS}: bucket map width height startx "
                "starty goalx goaly length"
            )
    grid = read_grid_map(_map_of(path, *rows[0]))
    starts, left = _starts(path, rows, grid, cell)
    content = _walls(grid, cell, height)
    why = f"a cell of theirs is taken, or {MAX_SCENARIO_ROWS} rows are read"
    notes = (f"{path}:{left[0]}: {len(left)} of {len(rows)} rows are left out: {why}",) if left else ()
    return Content(
        shapes=content.shapes, extent=content.extent, starts=starts, warnings=content.warnings + notes
    )


def _map_of(path: Path, line: int, words: list[str]) -> Path:
    """Return the map that a row names: at the path from the scenario's folder or above it, or by its name."""
    named = Path(words[1])
    folders = (path.parent, *path.resolve().parent.parents[:3])
    # Scenarios name maps by the paths of MovingAI's own archive, which few people keep.
    tries = [folder / named for folder in folders] + [folder / named.name for folder in folders]
    own = path.with_name(path.name.removesuffix(".scen"))
    found = next((one for one in (*tries, own) if one.suffix.lower() == ".map" and one.is_file()), None)
    if found is None:
        raise ArenaFileError(
            f"{path}:{line}: the map {_shown(words[1])} is not there; put it beside the file"
        )
    return found


def _starts(
    path: Path, rows: list[tuple[int, list[str]]], grid: GridMap, cell: float
) -> tuple[tuple[StartPose, ...], list[int]]:
    """Return the start poses of a scenario's rows, all starts before all goals, and the lines left out."""
    frame = GridFrame(origin=(0.0, 0.0, 0.0), cell=(cell, cell))
    free = _is(grid, FREE)
    taken: set[tuple[int, int]] = set()
    chosen: list[tuple[tuple[int, int], tuple[int, int]]] = []
    left: list[int] = []
    for line, words in rows:
        # Scenarios have thousands of rows, each a task of its own; an arena needs a few start poses.
        if len(chosen) == MAX_SCENARIO_ROWS:
            left.append(line)
            continue
        numbers = [_whole(path, line, word, MAX_CELLS) for word in words[4:8]]
        ends = (grid.at(*numbers[:2]), grid.at(*numbers[2:]))
        for (row, column), (x, y) in zip(ends, (numbers[:2], numbers[2:]), strict=True):
            inside = 0 <= row < free.shape[0] and 0 <= column < free.shape[1]
            if not inside or not free[row, column]:
                raise ArenaFileError(f"{path}:{line}: the cell {x} {y} is not free on {grid.path.name}")
        # Two robots on one cell would begin inside each other.
        if ends[0] == ends[1] or taken & set(ends):
            left.append(line)
            continue
        taken |= set(ends)
        chosen.append(ends)
    poses: list[StartPose] = []
    for end, word in enumerate(("Start", "Goal")):
        for number, ends in enumerate(chosen, 1):
            row, column = ends[end]
            at = frame.there(column + 0.5, row + 0.5)
            poses.append(StartPose(tag=f"{word}{number}", at=(*at, START_ELEVATION)))
    return tuple(poses), left
