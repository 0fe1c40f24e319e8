"""Maps that robots are building: those of a task, else one drawn of all scans."""

import math

import numpy as np
import viser

from usarmjx.sensors.ranging import RangeScanner, ScannerSettings
from usarmjx.view.drawing import MAP_GRID, MAP_PREFIX, Drawing, Frame
from usarmjx.view.layers.bodies import ReadingPoses, sensors_of
from usarmjx.view.layers.echoes import beam_directions_of
from usarmjx.view.layers.nodes import NodeLayer

UNKNOWN, FREE, WALL, MARK = 0, 1, 2, 3
"""As in `train.mapping.maps`."""
MAP_RGBA = np.array([(0, 0, 0, 0), (70, 150, 255, 90), (20, 40, 110, 235), (230, 0, 120, 255)], np.uint8)
"""Colours of what is unknown, free, a wall and a mark."""
RANKS = np.array([0, 2, 1, 3])
"""What one robot has seen to be free goes before what another took for a wall: that may have been a robot."""
SCAN_CELL, SCAN_REACH = 0.15, 8.0
"""Side of the squares of a map of scans, and how far from a scanner they are looked at [m]."""
MOST_EVIDENCE = 8
"""So often is a square seen as free, or as a wall, until further scans count no more."""
MOST_SQUARES = 600
"""A map of scans has no more squares along a side: larger ones are coarser."""
MAP_HEIGHT = 0.03
"""Maps lie so far above the floor [m]."""
ENLARGED = 4
"""So many pixels along a side has a square, so that browsers do not blur it away."""
PICTURE_PERIOD = 0.4
"""A changed map is sent no more often than this [s of the world's time]."""
SCANS_AT_ONCE = 1
"""So many scans are looked at in one update; the others wait for the next, 50 ms later."""
MOST_BEAMS = 181
"""Of a scan with more beams than this some are not followed along their way, only to their ends."""
LEVEL = 0.35
"""A scan counts as level while its plane's normal leans by less than this [rad]."""


class ScanMap:
    """A map of all scans: every scan that ends in a square, or passes it, counts.

    Args:
        low: Least x and y that it covers [m] (2,).
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
        self.evidence: np.ndarray = np.zeros(np.ceil((high - low) / self.cell).astype(int) + 1, np.int8)

    def add(self, start: np.ndarray, ends: np.ndarray, hit: np.ndarray) -> None:
        """Look at a scan.

        Args:
            start: Where the scanner was [m] (2,).
            ends: Where its beams ended [m] (beams, 2).
            hit: Which of them met something (beams,).
        """
        every = -(-len(ends) // MOST_BEAMS)
        along = (ends - start)[::every]
        length = np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-6)
        unit = along / length[:, None]
        passed = np.where(self._steps < length[:, None] - self.cell, self._steps, 0.0)
        x, y = (start[axis] + passed * unit[:, axis, None] for axis in range(2))
        free = self._mask(x, y)
        wall = self._mask(ends[hit, 0], ends[hit, 1])
        self.evidence += wall
        self.evidence -= free & ~wall
        np.clip(self.evidence, -MOST_EVIDENCE, MOST_EVIDENCE, out=self.evidence)

    @property
    def squares(self) -> np.ndarray:
        """What squares are taken to be (i, j)."""
        return np.where(self.evidence > 0, WALL, np.where(self.evidence < 0, FREE, UNKNOWN))

    def _mask(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return which squares points lie in (i, j); those beyond it fall into a frame that is cut off."""
        rows, columns = self.evidence.shape[0], self.evidence.shape[1]
        i = np.clip((x - self.low[0]) / self.cell + 1.5, 0.5, rows + 1.5).astype(np.int32)
        j = np.clip((y - self.low[1]) / self.cell + 1.5, 0.5, columns + 1.5).astype(np.int32)
        mask = np.zeros((rows + 2, columns + 2), bool)
        mask[i, j] = True
        return mask[1:-1, 1:-1]


class MapLayer(NodeLayer):
    """The map of a team: a task's maps of its robots, one over the other, else that of all scans."""

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
                if isinstance(sensor.settings[0], ScannerSettings) and sensor.settings[0].yaw
            ]
        )
        self._directions = [beam_directions_of(sensor) for sensor in self._held.sensors]
        self._waiting: dict[int, None] = {}
        self._image: viser.ImageHandle | None = None
        self._shown: np.ndarray | None = None
        self._due = -math.inf

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Look at new scans, and show the map if it has changed."""
        maps = [np.asarray(value) for name, value in frame.extra.items() if name.startswith(MAP_PREFIX)]
        if maps:
            x, y, cell = np.asarray(frame.extra[MAP_GRID], float).tolist()
            squares, low = merged(maps), np.array([x, y])
        else:
            self._look(frame)
            low, cell = self._scans.low, self._scans.cell
        if frame.time < self._due <= frame.time + 2 * PICTURE_PERIOD:
            return
        self._due = frame.time + PICTURE_PERIOD
        self._picture(squares if maps else self._scans.squares, low, cell, drawing.floor + MAP_HEIGHT)

    def _look(self, frame: Frame) -> None:
        """Look at some of the scans that are new, at those that have waited longest."""
        self._waiting |= dict.fromkeys(self._held.look(frame))
        for number in list(self._waiting)[:SCANS_AT_ONCE]:
            del self._waiting[number]
            rows, reading = self._held.rows[number], self._held.readings[number]
            mat = self._held.mat[rows.start]
            if len(reading) and mat[2, 2] > math.cos(LEVEL):
                hit = (reading > 0) & (reading < self._held.sensors[number].settings[0].max_range)
                start = self._held.pos[rows.start, :2]
                ends = start + reading[:, None] * (self._directions[number] @ mat[:2].T)
                self._scans.add(start, ends, hit)

    def _picture(self, squares: np.ndarray, low: np.ndarray, cell: float, height: float) -> None:
        if self._shown is not None and np.array_equal(squares, self._shown):
            return
        self._shown = squares
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
    """Return several robots' maps (i, j) of the same squares as one."""
    ranks = np.max(RANKS[np.stack(maps)], 0)
    return np.argsort(RANKS)[ranks]
