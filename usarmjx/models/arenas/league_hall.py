"""A hall with parallel lanes, the layout of recent league arenas.

Rows are lanes along x between walls, with starts before them and victims behind; the columns at both ends are
open from side to side.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

from usarmjx.models.arenas.pieces import CELL, WALL_RGBA, WOOD, block, cell_center, deck, span, step_field
from usarmjx.models.compile.victims import rest_height
from usarmjx.models.types.arena import START_ELEVATION, HelpSound, Light, StartPose, Victim, start_tag
from usarmjx.models.types.shapes import Position2D, Rgba, Shape

HOLE = 0.15
"""Width and height of the hole through which a victim is visible [m] (RoboCup Rescue; estimated)."""
BOX_LENGTH, BOX_WIDTH, BOX_HEIGHT = 0.6, 0.7, 0.96
"""Size of a victim box [m]: over the trunk of a sitting victim, whose legs come out below (chosen)."""
BACK = 0.2
"""Distance from a victim's pelvis to the back of its box [m]."""
EYES = 0.72
"""Height of the middle of the hole [m]."""
SLOT = 0.3
"""Height of the gap under the front, for the legs [m]."""
SHEET = 0.02
"""Thickness of its plywood [m] (chosen)."""
SIGN = 0.3
"""Side of a sign [m]."""
WHITE: Rgba = (0.95, 0.95, 0.95, 1.0)

HALL_HEIGHT, PARAPET = 1.5, 0.5
"""Height of the hall's walls, and of walls beside a lane above its highest ground (chosen) [m]."""

SIGNS = ("chart", "hazmat", "tag", "qr")
"""Kinds of signs, in turn."""

SPARE = 0.15
"""Additional width of the first lane, which is bare, for robots as large as a Talon [m]."""

THICKNESS = 0.05

OFF_THE_WALL = 0.08
"""Distance of start poses from the middle of their cells [m]: the longest robots are as long as a cell."""


def victim_box(at: Position2D, heading: float) -> tuple[Shape, ...]:
    """Return a box over a victim that sits at a point [m] and faces `heading` [rad]."""
    front, half = BOX_LENGTH - BACK, BOX_WIDTH / 2
    low, high = EYES - HOLE / 2, EYES + HOLE / 2
    corners = (
        ((-BACK, -half, 0.0), (-BACK + SHEET, half, BOX_HEIGHT)),
        ((-BACK, -half, 0.0), (front, -half + SHEET, BOX_HEIGHT)),
        ((-BACK, half - SHEET, 0.0), (front, half, BOX_HEIGHT)),
        ((-BACK, -half, BOX_HEIGHT - SHEET), (front, half, BOX_HEIGHT)),
        # The front: above the slot for the legs, around the hole.
        ((front - SHEET, -half, SLOT), (front, half, low)),
        ((front - SHEET, -half, high), (front, half, BOX_HEIGHT)),
        ((front - SHEET, -half, low), (front, -HOLE / 2, high)),
        ((front - SHEET, HOLE / 2, low), (front, half, high)),
    )
    cos, sin = math.cos(heading), math.sin(heading)
    shapes: list[Shape] = []
    for a, b in corners:
        x, y, z = ((p + q) / 2 for p, q in zip(a, b, strict=True))
        dx, dy, dz = ((q - p) / 2 for p, q in zip(a, b, strict=True))
        middle = (at[0] + x * cos - y * sin, at[1] + x * sin + y * cos, z)
        turn = (0.0, 0.0, heading)
        shapes.append(
            Shape(kind="box", size=(dx, dy, dz), at=middle, rotation=turn, surface="wall", rgba=WOOD)
        )
    return tuple(shapes)


def wall_sign(at: Position2D, heading: float, texture: str, *, z: float = 0.8) -> Shape:
    """Return a square with a chart, a label or a tag on a wall, which faces `heading` [rad]."""
    return Shape(
        kind="box",
        size=(0.005, SIGN / 2, SIGN / 2),
        at=(at[0], at[1], z),
        rotation=(0.0, 0.0, heading),
        surface="fixture",
        rgba=WHITE,
        texture=texture,
    )


@dataclass(frozen=True)
class Hall:
    """A hall of 1.2 m cells, its lower left corner in the origin.

    Attributes:
        columns: Columns of cells, from x = 0 on; rows begin at y = 0.
        first: First column of the lanes.
        last: Column after them.
        tops: The highest ground in each lane [m].
    """

    columns: int
    first: int
    last: int
    tops: tuple[float, ...]

    @property
    def extent(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Limits of x and y of the hall [m]."""
        return (0.0, self.columns * CELL), (-SPARE, self.rows * CELL)

    @property
    def rows(self) -> int:
        """Number of rows of cells, each a lane."""
        return len(self.tops)

    def at(self, column: float, row: float) -> Position2D:
        """Return the middle of a cell [m]."""
        return cell_center((0.0, 0.0), column, row)

    def walls(self) -> tuple[Shape, ...]:
        """Return walls around the hall and between the lanes."""
        (_, east), (south, north) = self.extent
        edges = (
            ((0.0, south), (east, south)),
            ((0.0, north), (east, north)),
            ((0.0, south), (0.0, north)),
            ((east, south), (east, north)),
        )
        outer = [_wall(low, high, HALL_HEIGHT) for low, high in edges]
        inner = [
            _wall((self.first * CELL, row * CELL), (self.last * CELL, row * CELL), max(beside) + PARAPET)
            for row, beside in enumerate(itertools.pairwise(self.tops), start=1)
        ]
        return (*outer, *inner)

    def fields(self, row: int, column: int, patterns: Sequence[str], unit: float) -> tuple[Shape, ...]:
        """Return step fields one behind the other."""
        return tuple(
            shape
            for i, pattern in enumerate(patterns)
            for shape in step_field(self.at(column + i, row), pattern, unit=unit)
        )

    def deck(self, row: int, x0: float, x1: float, top: float) -> Shape:
        """Return a deck across a lane, closed below [m]."""
        return deck((x0, row * CELL), (x1, (row + 1) * CELL), top, thickness=top)

    def seats(self, rows: Sequence[int]) -> tuple[Position2D, ...]:
        """Return the positions of victims at the far wall [m]."""
        return tuple((self.columns * CELL - 0.3, self.at(0, row)[1]) for row in rows)

    def boxes(self, rows: Sequence[int]) -> tuple[Shape, ...]:
        """Return boxes over victims at the far wall."""
        return tuple(shape for seat in self.seats(rows) for shape in victim_box(seat, math.pi))

    def victims(self, names: Sequence[str], rows: Sequence[int]) -> tuple[Victim, ...]:
        """Return victims that sit at the far wall in boxes; every other one cries."""
        return tuple(
            Victim(
                name=name,
                at=(*seat, rest_height("sitting")),
                rotation=(0.0, 0.0, math.pi),
                posture="sitting",
                help_sound=HelpSound(loudness=0.7) if i % 2 == 0 else None,
                state="sits in a box with a hole",
            )
            for i, (name, seat) in enumerate(zip(names, self.seats(rows), strict=True))
        )

    def signs(self, rows: Sequence[int]) -> tuple[Shape, ...]:
        """Return signs of all kinds on the far wall."""
        x = self.columns * CELL - 0.03
        return tuple(
            wall_sign((x, self.at(0, row)[1]), math.pi, f"{SIGNS[i % len(SIGNS)]}:{i}")
            for i, row in enumerate(rows)
        )

    def starts(self, behind: Sequence[int]) -> tuple[StartPose, ...]:
        """Return start poses in the cells before the lanes, and behind them in some rows."""
        rows = (1, 0, *range(2, self.rows))  # the first one away from walls
        cells = [(column, row) for row in rows for column in range(self.first)]
        cells += [(self.last, row) for row in behind]
        return tuple(
            StartPose(tag=start_tag(i), at=(x + OFF_THE_WALL, y, START_ELEVATION))
            for i, (x, y) in enumerate(self.at(*cell) for cell in cells)
        )

    def lights(self) -> tuple[Light, ...]:
        """Return four lamps."""
        return tuple(
            Light(at=(*self.at(x * self.columns - 0.5, y * self.rows - 0.5), 3.0), brightness=5.0)
            for x in (0.25, 0.75)
            for y in (0.25, 0.75)
        )


def _wall(low: Position2D, high: Position2D, height: float) -> Shape:
    half = THICKNESS / 2
    return span((low[0] - half, low[1] - half, 0.0), (high[0] + half, high[1] + half, height), WALL_RGBA)


def ceiling(at: Position2D, length: float, height: float) -> Shape:
    """Return a slab over a lane with `height` [m] of room below."""
    return block(at, (length, CELL, 0.1), z=height, surface="wall")
