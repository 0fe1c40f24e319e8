"""DM-USAR_yellow, modelled on NIST's yellow arena.

The manual (3.2.1.1): the simplest arena, a large flat floor with perpendicular walls and moderately difficult
obstacles. The plan is ours, on the 1.2 m grid of the NIST arenas. The floor lies 2.08 m below the wire's
origin, so that the manual's start position (Table 2: 4.5,1.9,1.8, z down) puts a P2AT, whose origin is 0.26 m
above the ground (5.3.6), 2 cm above the floor.

The manual's features of all arenas (3.2.1.1) are in the upper rows, away from starts and without blocking a
loop: victims, glass, a mirror, a grid fender, and few loose objects, as each costs solver time.

YELLOW_2025, by the RoboCup Rescue league, is the same maze on continuous ramps, for autonomous robots:
between level ground at both ends the whole floor is full ramps of 15 degrees (ASTM E2826), so that a drive
along x pitches and a drive along y rolls. Victims sit in boxes with a hole, signs hang on walls. Walls are
those of the older arena; positions of contents are ours.
"""

import math
from functools import partial

from usarmjx.models.arenas.league_hall import victim_box, wall_sign
from usarmjx.models.arenas.pieces import (
    CELL,
    MESHWORK,
    PANE,
    PANELLED,
    RAMP_ANGLE,
    SILVER,
    WOOD,
    block,
    brick,
    cell_center,
    finished,
    loose_box,
    ramp,
    slope,
    span,
    walls,
    waving,
)
from usarmjx.models.compile.victims import rest_height
from usarmjx.models.types.arena import (
    START_ELEVATION,
    ArenaSpec,
    FalseAlarm,
    HelpSound,
    Light,
    SegmentMotion,
    StartPose,
    Tag,
    Victim,
    start_tag,
)
from usarmjx.models.types.shapes import FENDER, GLASS, MIRROR, Shape

FLOOR = -2.08
ORIGIN = (-2.4, -4.8)

PLAN = """
+--+--+--+--+--+--+--+--+--+--+--+--+
|           |              |        |
+  +--+  +  +  +--+--+  +  +  +--+  +
|  |        |     |           |     |
+  +  +--+  +--+  +  +--+--+  +  +--+
|        |        |        |        |
+--+  +  +--+--+  +  +--+  +--+--+  +
|     |           |                 |
+  +--+  +--+  +--+--+  +--+--+  +  +
|              |           |     |  |
+  +--+--+  +  +  +  +--+  +  +--+  +
|        |  |        |        |     |
+--+--+  +  +--+--+  +  +--+--+  +  +
|                    |           |  |
+  +--+--+--+  +--+  +--+--+  +--+  +
|           |                       |
+--+--+--+--+--+--+--+--+--+--+--+--+
"""


_cell = partial(cell_center, ORIGIN)


def _block(
    column: int, row: int, size: tuple[float, float, float], offset: tuple[float, float] = (0, 0)
) -> Shape:
    """Return a box of full lengths `size` on the floor, in reach of wheels."""
    x, y = _cell(column, row)
    return block((x + offset[0], y + offset[1]), size)


def _ramp(column: int, row: int, uphill: float) -> Shape:
    """Return a 15 degree slope that rises out of the floor; `uphill` is the direction of climb [rad]."""
    return ramp(_cell(column, row), uphill)


OBSTACLES = (
    _block(1, 6, (0.39, 0.19, 0.19)),  # cinder blocks
    _block(9, 1, (0.19, 0.39, 0.19), (0.2, -0.1)),
    _block(4, 2, (0.39, 0.19, 0.19), (-0.1, 0.2)),
    _block(7, 5, (0.10, 0.10, 1.2), (0.25, 0.25)),  # posts
    _block(3, 4, (0.10, 0.10, 1.2), (0.2, 0.3)),
    _block(2, 0, (0.10, 0.10, 1.2), (0.0, 0.2)),
    _block(6, 0, (0.09, 1.0, 0.04)),  # boards on the floor to drive over
    _block(8, 3, (0.09, 1.0, 0.04)),
    _block(10, 4, (1.0, 1.0, 0.06)),  # a low platform
    _block(1, 4, (0.60, 0.40, 0.45), (0.0, 0.3)),  # a crate
    _block(10, 6, (0.50, 0.50, 0.50), (0.2, 0.2)),
    _ramp(2, 7, 0.0),  # up and down again
    _ramp(3, 7, math.pi),
    _ramp(10, 0, 0.0),
)

# The first is the manual's. 47 more on cell centres and beside them, enough for a team of any usual size;
# all at least 0.6 m from the next and clear of walls and obstacles.
START_CELLS = (
    (0, 0), (1, 0), (4, 0), (5, 0), (7, 0), (8, 0), (11, 0),
    (0, 1), (1, 1), (2, 1), (3, 1), (5, 1), (6, 1), (8, 1), (11, 1),
    (0, 2), (1, 2), (2, 2), (3, 2), (6, 2), (7, 2), (8, 2), (10, 2),
    (0, 3), (1, 3), (2, 3), (3, 3), (4, 3), (5, 3), (6, 3), (7, 3), (9, 3), (11, 3),
    (0, 4), (5, 4), (6, 4), (7, 4), (8, 4), (11, 4),
    (0, 5), (2, 5), (4, 5), (5, 5), (6, 5), (9, 5), (10, 5), (11, 5),
)  # fmt: skip

EFFECTS = (
    span((7.19, 2.43, 0.0), (7.21, 3.57, 1.2), PANE, material=GLASS),  # between cells 7, 6 and 8, 6
    span((8.365, 3.7, 0.05), (8.375, 4.7, 1.1), SILVER, material=MIRROR),  # at the end of row 7
    span((10.83, 3.59, 0.0), (11.97, 3.61, 1.0), MESHWORK, material=FENDER),  # before cell 11, 6
    span((7.70, 1.40, 0.0), (7.74, 2.35, 0.7), WOOD),  # a board that hides a victim in cell 8, 5
)

TREMBLING = (
    SegmentMotion(name="LeftHand", initial=(0.0, 0.0, -0.1), final=(0.0, 0.0, 0.1), rates=(0.0, 0.0, 0.5)),
)

VICTIMS = (
    Victim(
        name="Waving",
        at=(11.75, 2.68, rest_height("sitting")),
        rotation=(0.0, 0.0, math.pi),
        posture="sitting",
        segments=waving(),
        help_sound=HelpSound(),
        state="sits behind a grid fender and waves",
    ),
    Victim(
        name="Hidden",
        at=(8.12, 2.2, rest_height("sitting")),
        rotation=(0.0, 0.0, -math.pi / 2),
        posture="sitting",
        segments=TREMBLING,
        help_sound=HelpSound(loudness=0.5, duration=1.0, pause=4.0),
        state="sits behind a board, one hand trembles",
    ),
    Victim(name="Still", at=(0.55, 2.7, rest_height("lying")), state="lies on the floor, still"),
)

LOOSE_GAP = 0.001
"""Initial gap between loose objects and the floor [m]: as robots, they start out of contact."""
LOOSE = (
    brick("Brick1", (9.0, 4.5), z=LOOSE_GAP, yaw=0.4),
    brick("Brick2", (-0.9, 4.6), z=LOOSE_GAP, yaw=-0.2),
    loose_box("Carton", (-2.1, 4.5), (0.4, 0.3, 0.3), 4.0, z=LOOSE_GAP, yaw=0.2),
    loose_box("Plank", (10.3, 4.62), (1.0, 0.12, 0.03), 2.0, z=LOOSE_GAP, rgba=WOOD),
)

YELLOW = ArenaSpec(
    name="DM-USAR_yellow",
    aliases=("yellow",),
    about=(
        "The simplest of the arenas for search and rescue: a maze on one level with blocks, posts, boards "
        "and three ramps. 4 loose objects."
    ),
    floor=FLOOR,
    shapes=finished((*walls(PLAN, origin=ORIGIN, cell=CELL), *OBSTACLES, *EFFECTS), PANELLED),
    starts=(
        StartPose(tag="PlayerStart", at=(4.5, -1.9, START_ELEVATION)),
        *(
            StartPose(tag=f"Start{i}", at=(*_cell(*cell), START_ELEVATION), yaw=math.pi / 2 * (i % 4 - 1))
            for i, cell in enumerate(START_CELLS, start=1)
        ),
    ),
    extent=((ORIGIN[0], ORIGIN[0] + 12 * CELL), (ORIGIN[1], ORIGIN[1] + 8 * CELL)),
    loose=LOOSE,
    victims=VICTIMS,
    false_alarms=(FalseAlarm(part="LeftArm", at=(10.5, -3.4, 0.07), rotation=(0.0, math.pi / 2, 0.5)),),
    tags=tuple(
        Tag(at=(*_cell(*cell), 0.01), memory=memory)
        for cell, memory in (
            ((0, 0), "Cell 0 0"),
            ((11, 0), "Cell 11 0"),
            ((6, 3), "Cell 6 3"),
            ((0, 7), "Cell 0 7"),
            ((8, 4), "Cell 8 4"),
            ((11, 7), "Cell 11 7"),
        )
    ),
    lights=tuple(Light(at=(*_cell(*cell), 2.4), brightness=4.0) for cell in ((2, 1), (9, 1), (2, 6), (9, 6))),
    robots=("P2AT", "P2DX", "Zerg", "Kurt2D"),
)


COLUMNS, ROWS = 12, 8
FIRST, LAST = 2, 10
"""First column of ramps, and the first one after them."""
EAST, NORTH = COLUMNS * CELL, ROWS * CELL

_hall_cell = partial(cell_center, (0.0, 0.0))


def _hall_ramp(column: int) -> tuple[float, float]:
    """Return x of the foot and of the head of a column's ramp: up and down by turns [m]."""
    west, east = column * CELL, (column + 1) * CELL
    return (west, east) if (column - FIRST) % 2 == 0 else (east, west)


RAMPS = tuple(
    slope((foot, NORTH / 2, 0.0), (head, NORTH / 2, CELL * math.tan(RAMP_ANGLE)), NORTH)
    for foot, head in map(_hall_ramp, range(FIRST, LAST))
)
SITTING = rest_height("sitting")
HIDING = (("Alma", (0, 7), -math.pi / 2), ("Boris", (11, 7), -math.pi / 2), ("Chen", (11, 0), math.pi / 2))
"""Victims in boxes: names, cells and headings."""
AWAY = 0.3
"""Distance from the middle of the cell towards its wall [m]."""


def _seat(cell: tuple[int, int], heading: float) -> tuple[float, float]:
    x, y = _hall_cell(*cell)
    return x - AWAY * math.cos(heading), y - AWAY * math.sin(heading)


SIGNS = (
    wall_sign((0.03, _hall_cell(0, 1)[1]), 0.0, "qr:6"),
    wall_sign((0.03, _hall_cell(0, 3)[1]), 0.0, "chart:0"),
    wall_sign((0.03, _hall_cell(0, 5)[1]), 0.0, "hazmat:1"),
    wall_sign((EAST - 0.03, _hall_cell(11, 1)[1]), math.pi, "qr:7"),
    wall_sign((EAST - 0.03, _hall_cell(11, 3)[1]), math.pi, "tag:2"),
    wall_sign((EAST - 0.03, _hall_cell(11, 5)[1]), math.pi, "chart:3"),
    wall_sign((_hall_cell(4, 0)[0], 0.03), math.pi / 2, "hazmat:4", z=1.1),
    wall_sign((_hall_cell(7, 7)[0], NORTH - 0.03), -math.pi / 2, "tag:5", z=1.1),
)

HALL_STARTS = (
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
        StartPose(tag=start_tag(i), at=(*_hall_cell(*cell), START_ELEVATION))
        for i, cell in enumerate(HALL_STARTS)
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
        Tag(at=(*_hall_cell(*cell), 0.01), memory=f"Cell {cell[0]} {cell[1]}")
        for cell in ((0, 0), (1, 5), (10, 6), (11, 2))
    ),
    lights=tuple(
        Light(at=(*_hall_cell(*cell), 2.8), brightness=4.0) for cell in ((2, 1), (9, 1), (2, 6), (9, 6))
    ),
    robots=("P2AT", "Zerg", "Kurt3D"),
)
