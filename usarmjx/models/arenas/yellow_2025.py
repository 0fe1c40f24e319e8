"""The yellow arena of 2025, by the RoboCup Rescue league: the same maze on continuous ramps.

For autonomous robots: between level ground at both ends the whole floor is full ramps of 15 degrees (ASTM
E2826), so that a drive along x pitches and a drive along y rolls. Victims sit in boxes with a hole, signs
hang on walls. Walls are those of `yellow`; positions of contents are ours.
"""

import math
from functools import partial

from usarmjx.models.arenas.elements import CELL, RAMP_ANGLE, cell_center, slope
from usarmjx.models.arenas.league_hall import victim_box, wall_sign
from usarmjx.models.arenas.pieces import PANELLED, finished, walls, waving
from usarmjx.models.arenas.yellow import PLAN
from usarmjx.models.compile.victims import rest_height
from usarmjx.models.types.arena import START_ELEVATION, ArenaSpec, HelpSound, Light, StartPose, Tag, Victim

COLUMNS, ROWS = 12, 8
FIRST, LAST = 2, 10
"""First column of ramps, and the first one after them."""
EAST, NORTH = COLUMNS * CELL, ROWS * CELL

_cell = partial(cell_center, (0.0, 0.0))


def _ramp(column: int) -> tuple[float, float]:
    """Return x of the foot and of the head of a column's ramp: up and down by turns [m]."""
    west, east = column * CELL, (column + 1) * CELL
    return (west, east) if (column - FIRST) % 2 == 0 else (east, west)


RAMPS = tuple(
    slope((foot, NORTH / 2, 0.0), (head, NORTH / 2, CELL * math.tan(RAMP_ANGLE)), NORTH)
    for foot, head in map(_ramp, range(FIRST, LAST))
)
SITTING = rest_height("sitting")
HIDING = (("Alma", (0, 7), -math.pi / 2), ("Boris", (11, 7), -math.pi / 2), ("Chen", (11, 0), math.pi / 2))
"""Victims in boxes: names, cells and headings."""
AWAY = 0.3
"""Distance from the middle of the cell towards its wall [m]."""


def _seat(cell: tuple[int, int], heading: float) -> tuple[float, float]:
    x, y = _cell(*cell)
    return x - AWAY * math.cos(heading), y - AWAY * math.sin(heading)


SIGNS = (
    wall_sign((0.03, _cell(0, 1)[1]), 0.0, "qr:6"),
    wall_sign((0.03, _cell(0, 3)[1]), 0.0, "chart:0"),
    wall_sign((0.03, _cell(0, 5)[1]), 0.0, "hazmat:1"),
    wall_sign((EAST - 0.03, _cell(11, 1)[1]), math.pi, "qr:7"),
    wall_sign((EAST - 0.03, _cell(11, 3)[1]), math.pi, "tag:2"),
    wall_sign((EAST - 0.03, _cell(11, 5)[1]), math.pi, "chart:3"),
    wall_sign((_cell(4, 0)[0], 0.03), math.pi / 2, "hazmat:4", z=1.1),
    wall_sign((_cell(7, 7)[0], NORTH - 0.03), -math.pi / 2, "tag:5", z=1.1),
)

START_CELLS = (
    (0, 0), (1, 0), (0, 1), (1, 1), (0, 2), (1, 2), (0, 3), (1, 3), (0, 4), (0, 5), (10, 2), (10, 3), (11, 3),
    (11, 4), (10, 5), (11, 5),
)  # fmt: skip

YELLOW_2025 = ArenaSpec(
    name="DM-USAR_yellow_2025",
    aliases=("yellow_2025",),
    about="The maze of the yellow arena on continuous ramps of 15 degrees; victims in boxes with a hole.",
    shapes=finished(
        (
            *walls(PLAN, origin=(0.0, 0.0), cell=CELL, height=1.5),
            *RAMPS,
            *(shape for _, cell, heading in HIDING for shape in victim_box(_seat(cell, heading), heading)),
            *SIGNS,
        ),
        PANELLED,
    ),
    starts=tuple(
        StartPose(tag=f"Start{i}" if i else "PlayerStart", at=(*_cell(*cell), START_ELEVATION))
        for i, cell in enumerate(START_CELLS)
    ),
    extent=((0.0, EAST), (0.0, NORTH)),
    victims=tuple(
        Victim(
            name=name,
            at=(*_seat(cell, heading), SITTING),
            rotation=(0.0, 0.0, heading),
            posture="sitting",
            segments=waving() if name == "Chen" else (),
            help_sound=HelpSound(loudness=0.7) if name != "Boris" else None,
            state="sits in a box with a hole",
        )
        for name, cell, heading in HIDING
    ),
    tags=tuple(
        Tag(at=(*_cell(*cell), 0.01), memory=f"Cell {cell[0]} {cell[1]}")
        for cell in ((0, 0), (1, 5), (10, 6), (11, 2))
    ),
    lights=tuple(Light(at=(*_cell(*cell), 2.8), brightness=4.0) for cell in ((2, 1), (9, 1), (2, 6), (9, 6))),
    robots=("P2AT", "Zerg", "Kurt3D"),
)
