"""MovingAI's grid maps (.map) and scenarios (.scen): cells as walls, rows of a scenario as start poses."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from usarmjx.base.errors import ArenaFileError
from usarmjx.base.settings.files import read_bytes
from usarmjx.models.files.content import Content
from usarmjx.models.files.maps import DEFAULT_WALL_HEIGHT, MAX_MAP_BOXES, GridFrame, cover
from usarmjx.models.types.arena import START_ELEVATION, StartPose

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
    letters = np.frombuffer("".join(rows).encode("latin-1"), np.uint8).reshape(height, width)
    unknown = ~np.isin(letters, [ord(letter) for letter in FREE + WALLS + LOW])
    if unknown.any():
        first = int(np.flatnonzero(unknown.any(1))[0])
        letter = chr(int(letters[first][unknown[first]][0]))
        allowed = ", ".join(FREE + WALLS + LOW)
        raise ArenaFileError(f"{path}:{row + 1 + first}: no cell is {letter!r}; allowed: {allowed}")
    end = row + height
    behind = next((number for number, line in enumerate(lines[end:], end + 1) if line.strip()), 0)
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
        if len(chosen) == MAX_SCENARIO_ROWS:
            left.append(line)
            continue
        numbers = [_whole(path, line, word, MAX_CELLS) for word in words[4:8]]
        ends = (grid.at(*numbers[:2]), grid.at(*numbers[2:]))
        for (row, column), (x, y) in zip(ends, (numbers[:2], numbers[2:]), strict=True):
            inside = 0 <= row < free.shape[0] and 0 <= column < free.shape[1]
            if not inside or not free[row, column]:
                raise ArenaFileError(f"{path}:{line}: the cell {x} {y} is not free on {grid.path.name}")
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
