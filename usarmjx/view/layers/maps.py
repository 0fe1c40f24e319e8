"""Maps of robots: a task's own, or one that the page builds of all scans."""

import math

import numpy as np
import viser

from usarmjx.sensors.ranging import RangeScanner, ScannerSettings
from usarmjx.view.drawing import MAP_GRID, MAP_PREFIX, Drawing, Frame
from usarmjx.view.layers.base import NodeLayer
from usarmjx.view.layers.bodies import ReadingPoses, sensors_of
from usarmjx.view.layers.echoes import beam_directions_of

UNKNOWN, FREE, WALL, MARK = 0, 1, 2, 3
"""States of a square, as in `train.mapping.maps`."""
MAP_RGBA = np.array([(0, 0, 0, 0), (70, 150, 255, 90), (20, 40, 110, 235), (230, 0, 120, 255)], np.uint8)
"""Colours of the states."""
RANKS = np.array([0, 2, 1, 3])
"""Precedence of the states between robots: free beats wall, which may have been another robot."""
SCAN_CELL, SCAN_REACH = 0.15, 8.0
"""Side of a scan map's squares, and largest distance from the scanner that counts [m]."""
MOST_EVIDENCE = 8
"""Largest evidence for free or wall in a square, in scans; further scans do not count."""
MOST_SQUARES = 600
"""Most squares along a side of a scan map: larger maps are coarser."""
MAP_HEIGHT = 0.03
"""Height of maps above the floor [m]."""
ENLARGED = 4
"""Pixels along a square's side, so that browsers do not blur it."""
PICTURE_PERIOD = 0.4
"""Least interval between two sent pictures of a map [s of the world's time]."""
SCANS_AT_ONCE = 1
"""Scans that one update adds; the others wait for the next, 50 ms later."""
MOST_BEAMS = 181
"""Most beams of a scan whose path counts; of more, only some do. All ends count."""
LEVEL = 0.35
"""Lean of a scan plane's normal below which the scan counts as level [rad]."""


class ScanMap:
    """Map of all scans: every scan that ends in a square, or passes it, counts.

    Args:
        low: Least x and y of the map [m] (2,).
        high: Largest x and y [m] (2,).

    Attributes:
        low: Middle of its first square [m] (2,).
        cell: Side of a square [m].
        evidence: Below 0 free, above 0 a wall (i, j).
    """

    def __init__(self, low: np.ndarray, high: np.ndarray) -> None:
        self.low = low
        self.cell = max(SCAN_CELL, float((high - low).max()) / MOST_SQUARES)
        self._steps = np.arange(0.0, SCAN_REACH, self.cell)
        # One square more than fits, as `low` is the middle of the first one.
        self.evidence: np.ndarray = np.zeros(np.ceil((high - low) / self.cell).astype(int) + 1, np.int8)

    def add(self, start: np.ndarray, ends: np.ndarray, hit: np.ndarray) -> None:
        """Add a scan.

        Args:
            start: Position of the scanner [m] (2,).
            ends: Ends of its beams [m] (beams, 2).
            hit: Which of them are echoes (beams,).
        """
        # Rounded up, so that no more than `MOST_BEAMS` are left.
        every = -(-len(ends) // MOST_BEAMS)
        along = (ends - start)[::every]
        # A beam of no length has no direction, and passes no square.
        length = np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-6)
        unit = along / length[:, None]
        # A square short of the end, which is the wall's; steps beyond count at the start, free anyway.
        passed = np.where(self._steps < length[:, None] - self.cell, self._steps, 0.0)
        x, y = (start[axis] + passed * unit[:, axis, None] for axis in range(2))
        free = self._mask(x, y)
        wall = self._mask(ends[hit, 0], ends[hit, 1])
        self.evidence += wall
        # Beams pass close by walls that others hit: a hit counts more.
        self.evidence -= free & ~wall
        # Limited, so that what moves away is forgotten, and 8 bits are enough.
        np.clip(self.evidence, -MOST_EVIDENCE, MOST_EVIDENCE, out=self.evidence)

    @property
    def squares(self) -> np.ndarray:
        """State of each square (i, j)."""
        return np.where(self.evidence > 0, WALL, np.where(self.evidence < 0, FREE, UNKNOWN))

    def _mask(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the squares with points in them (i, j); those outside fall into a cut-off border."""
        rows, columns = self.evidence.shape[0], self.evidence.shape[1]
        # Shifted by a border of one square, where all that is outside ends up.
        i = np.clip((x - self.low[0]) / self.cell + 1.5, 0.5, rows + 1.5).astype(np.int32)
        j = np.clip((y - self.low[1]) / self.cell + 1.5, 0.5, columns + 1.5).astype(np.int32)
        mask = np.zeros((rows + 2, columns + 2), bool)
        mask[i, j] = True
        return mask[1:-1, 1:-1]


class MapLayer(NodeLayer):
    """The map of a team: a task's maps of its robots, merged, or that of all scans."""

    name = "Map"
    about = "the map being built: blue free, dark a wall, red what was looked for"
    shown_at_first = False

    def draw(self, drawing: Drawing) -> None:
        """Begin an empty map."""
        low, high = np.asarray(drawing.extent, float).T
        self._scans = ScanMap(low, high)
        self._held = ReadingPoses(
            [
                sensor
                for sensor in sensors_of(drawing, RangeScanner)
                # A scanner that sweeps up and down sees floors and ceilings, which are no walls of a map.
                if isinstance(sensor.settings[0], ScannerSettings) and sensor.settings[0].yaw
            ]
        )
        self._directions = [beam_directions_of(sensor) for sensor in self._held.sensors]
        self._waiting: dict[int, None] = {}
        self._image: viser.ImageHandle | None = None
        self._shown: np.ndarray | None = None
        self._due = -math.inf

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Add new scans, and show the map if it has changed."""
        maps = [np.asarray(value) for name, value in frame.extra.items() if name.startswith(MAP_PREFIX)]
        if maps:
            x, y, cell = np.asarray(frame.extra[MAP_GRID], float).tolist()
            squares, low = merged(maps), np.array([x, y])
        else:
            self._add_scans(frame)
            squares, low, cell = None, self._scans.low, self._scans.cell
        # The upper bound lets a picture through after the time has moved backwards (reset, seek).
        if frame.time < self._due <= frame.time + 2 * PICTURE_PERIOD:
            return
        self._due = frame.time + PICTURE_PERIOD
        squares = self._scans.squares if squares is None else squares
        self._picture(squares, low, cell, drawing.floor + MAP_HEIGHT)

    def _add_scans(self, frame: Frame) -> None:
        """Add some of the new scans, those that have waited longest."""
        # A dict keeps the order of arrival, and a scanner that already waits keeps its turn.
        self._waiting |= dict.fromkeys(self._held.update(frame))
        for number in list(self._waiting)[:SCANS_AT_ONCE]:
            del self._waiting[number]
            rows, reading = self._held.rows[number], self._held.readings[number]
            mat = self._held.mat[rows.start]
            # A leaning robot's beams end at the floor, which is no wall.
            if len(reading) and mat[2, 2] > math.cos(LEVEL):
                hit = (reading > 0) & (reading < self._held.sensors[number].settings[0].max_range)
                start = self._held.pos[rows.start, :2]
                ends = start + reading[:, None] * (self._directions[number] @ mat[:2].T)
                self._scans.add(start, ends, hit)

    def _picture(self, squares: np.ndarray, low: np.ndarray, cell: float, height: float) -> None:
        if self._shown is not None and np.array_equal(squares, self._shown):
            return
        self._shown = squares
        # Squares are (x, y), pictures (row, column).
        pixels = MAP_RGBA[squares.T].repeat(ENLARGED, 0).repeat(ENLARGED, 1)
        if self._image is not None:
            self._image.image = pixels
            return
        width, depth = np.array(squares.shape) * cell
        middle = low + cell * (np.array(squares.shape) - 1) / 2
        self._image = self.scene.add_image(
            f"{self.root}/squares",
            pixels,
            float(width),
            float(depth),
            format="png",
            position=(*middle, height),
            cast_shadow=False,
            receive_shadow=False,
        )


def merged(maps: list[np.ndarray]) -> np.ndarray:
    """Return the merged map (i, j) of several robots' maps of the same squares."""
    ranks = np.max(RANKS[np.stack(maps)], 0)
    # The inverse of RANKS: back from ranks to states.
    return np.argsort(RANKS)[ranks]
