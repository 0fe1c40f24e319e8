"""DM-USAR_red, modelled on NIST's red arena.

The manual (3.2.1.1): few perceptual difficulties, but maximal demand on locomotion; rubble piles, cement
blocks, slabs and debris on the floor. It gives no measures: the plan is ours, on the grid of the NIST arenas,
with cubic step fields in place of rubble. The floor lies 2.08 m below the wire's origin, so that the manual's
start position (Table 2: 0.76,2.3,1.8, z down) puts a P2AT, whose origin is 0.26 m above the ground (5.3.6), 2
cm above it.

RED_2025 has lanes of unstructured and high obstacles side by side. From one side to the other: a bare lane,
two lanes of cubic step fields (ASTM E2828), hurdles of 20 cm (E2802), stairs of 45 degrees to a deck and down
again (E2804), four pipe steps and an inclined plane of 30 degrees, rubble with cement blocks, and crossing
ramps under a low ceiling (E2827). `lanes` lists the chosen measures; the order of lanes is ours.
"""

import math
from functools import partial

from usarmjx.models.arenas.lanes import hurdle
from usarmjx.models.arenas.league_hall import Hall, ceiling
from usarmjx.models.arenas.pieces import (
    CAST,
    CELL,
    PANELLED,
    POST,
    RISE,
    brick,
    cell_center,
    cinder_block,
    deck,
    finished,
    loose_board,
    loose_cinder_block,
    loose_pipe,
    pipe,
    pipe_steps,
    plank,
    ramps,
    rubble,
    slab,
    slope,
    stairs,
    step_field,
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
    StartPose,
    Tag,
    Victim,
)

FLOOR = -2.08
ORIGIN = (-3.44, -4.1)
COLUMNS, ROWS = 9, 8

PLAN = """
+--+--+--+--+--+--+--+--+--+
|                          |
+  +  +  +  +  +  +  +  +  +
|                          |
+  +  +  +  +  +  +  +  +  +
|                          |
+  +  +  +  +  +  +  +  +  +
|                          |
+  +  +  +--+--+--+  +  +  +
|                          |
+  +  +  +--+--+--+  +  +  +
|                          |
+  +  +  +  +  +  +  +  +  +
|                          |
+  +  +  +  +  +  +  +  +  +
|                          |
+--+--+--+--+--+--+--+--+--+
"""
STEEP_PLANE = math.radians(30)
PLATFORM = CELL * math.tan(STEEP_PLANE)
"""Height of the platform at the top of the inclined plane [m]."""


cell = partial(cell_center, ORIGIN)
LANE = ((3, 3, "flat"), (4, 3, "hill"), (5, 3, "flat"))
"""Step fields in a row between walls: columns, rows and patterns."""
PLANE_X, PLANE_Y = cell(8, 2)
EAST, NORTH = ORIGIN[0] + COLUMNS * CELL, ORIGIN[1] + ROWS * CELL

SLABS = (
    # A pancake void: a floor slab on three stacks of cement blocks.
    slab((*cell(3.5, 6.0), 0.63), (1.9, 1.3, 0.12), (0.03, -0.04, 0.2)),
    *(
        cinder_block(cell(*place), z=0.19 * i, yaw=yaw)
        for place, yaw in (((2.9, 5.7), 0.3), ((4.05, 5.7), 1.9), ((3.4, 6.45), 0.2))
        for i in range(3)
    ),
    # A lean-to void: a wall slab fallen against a block of concrete.
    slab((*cell(7.3, 6.6), 0.35), (0.5, 1.6, 0.7)),
    slope((*cell(5.9, 6.6), 0.0), (*cell(7.15, 6.6), 0.75), 1.4, thickness=0.12),
    # Tilted slabs on the ground.
    slab((*cell(1.5, 4.6), 0.12), (1.1, 0.9, 0.1), (0.1, -0.15, 0.5)),
    slab((*cell(2.4, 5.0), 0.18), (1.0, 0.8, 0.1), (-0.25, 0.1, 1.2)),
    slab((*cell(6.0, 4.4), 0.15), (1.2, 0.8, 0.1), (0.2, 0.1, 2.4)),
)

RUBBLE = (
    *rubble(cell(1.15, 6.35), 0.9, 0.6, 16, seed=1),
    *rubble(cell(4.7, 5.1), 0.6, 0.35, 10, seed=2),
    *rubble(cell(6.6, 0.5), 0.65, 0.4, 12, seed=3),
)

SHAPES = (
    *walls(PLAN, origin=ORIGIN, cell=CELL),
    *(shape for column, row, pattern in LANE for shape in step_field(cell(column, row), pattern)),
    *step_field(cell(0, 3), "diagonal"),
    # An inclined plane up to a platform in the corner of the last column.
    slope((PLANE_X, PLANE_Y - CELL / 2, 0.0), (PLANE_X, PLANE_Y + CELL / 2, PLATFORM), CELL),
    deck(
        (PLANE_X - CELL / 2, PLANE_Y + CELL / 2), (EAST, PLANE_Y + 1.5 * CELL), PLATFORM, thickness=PLATFORM
    ),
    *pipe_steps((EAST - CELL, cell(0, 4.65)[1]), 0.0, 2),
    *SLABS,
    *RUBBLE,
    cinder_block(cell(4.4, 1.7), yaw=0.4),
    cinder_block(cell(6.2, 2.3), yaw=1.3),
    cinder_block(cell(1.6, 1.5), yaw=2.2),
    cinder_block(cell(7.2, 2.7), yaw=0.8),
    cinder_block(cell(4.6, 0.6), yaw=2.7),
    *pipe(cell(2.2, 2.1), 0.9, yaw=0.6),
    *pipe(cell(5.3, 1.9), 0.9, yaw=2.0),
    plank(cell(3.4, 0.6), 0.9, yaw=1.1),
    plank(cell(1.2, 2.4), 0.8, yaw=0.3),
)

LOOSE = (
    loose_cinder_block("block1", cell(2.6, 0.4), yaw=0.9),
    loose_cinder_block("block2", cell(4.5, 2.2), yaw=0.2),
    loose_cinder_block("block3", cell(3.9, 7.2), yaw=1.5),
    loose_cinder_block("block4", cell(4.4, 4.1), yaw=2.4),
    brick("brick1", cell(0.5, 1.5), yaw=0.3),
    brick("brick2", cell(6.6, 1.5), yaw=1.0),
    brick("brick3", cell(3.5, 4.5), yaw=2.0),
    brick("brick4", cell(6.2, 3.5), yaw=0.6),
    loose_pipe("pipe1", cell(1.5, 0.6), 0.8, yaw=2.1),
    loose_pipe("pipe2", cell(5.7, 2.1), 0.7, yaw=0.4),
    loose_board("board1", cell(0.6, 4.6), (0.6, 0.4, 0.018), yaw=0.5),
    loose_board("board2", cell(7.0, 3.4), (0.8, 0.3, 0.018), yaw=1.8),
)

LYING, SITTING = rest_height("lying"), rest_height("sitting")

VICTIMS = (
    Victim(
        name="Pancake",
        at=(*cell(3.5, 6.05), LYING),
        rotation=(0.0, 0.0, 0.2),
        help_sound=HelpSound(loudness=0.7, duration=1.5, pause=5.0),
        state="in a void: lies still under a floor slab",
    ),
    Victim(
        name="LeanTo",
        at=(*cell(6.78, 6.6), LYING),
        rotation=(0.0, 0.0, math.pi / 2),
        state="in a void: lies still under a slab that leans on another",
    ),
    Victim(
        name="Waving",
        at=(*cell(8.3, 3.3), PLATFORM + SITTING),
        rotation=(0.0, 0.0, math.pi),
        posture="sitting",
        segments=waving("LeftArm"),
        help_sound=HelpSound(loudness=1.0),
        state="moving: waves from the platform",
    ),
    Victim(
        name="BehindRubble",
        at=(*cell(-0.15, 6.9), SITTING),
        rotation=(0.0, 0.0, -math.pi / 2),
        posture="sitting",
        state="still: hidden behind a pile of rubble",
    ),
)

# The first is the manual's.
START_CELLS = (
    (0, 0), (1, 0), (2, 0), (4, 0), (5, 0), (8, 0), (0, 1), (2, 1), (5, 1), (8, 1), (0, 2), (3, 2),
    (2, 3), (6, 3), (3, 4), (8, 6), (5, 7), (8, 7),
)  # fmt: skip

RED = ArenaSpec(
    name="DM-USAR_red",
    aliases=("red",),
    about="Rubble piles, cement blocks, slabs with voids under them, cubic step fields. "
    "148 fixed solids, 12 loose objects.",
    floor=FLOOR,
    shapes=finished(SHAPES, CAST),
    loose=LOOSE,
    victims=VICTIMS,
    false_alarms=(
        FalseAlarm(part="RightArm", at=(*cell(6.2, 5.6), 0.05), rotation=(0.0, math.pi / 2, 0.3)),
        FalseAlarm(part="LeftFoot", at=(*cell(2.5, 1.5), 0.04)),
    ),
    tags=tuple(
        Tag(at=(*cell(column, row), height + 0.02), memory=memory)
        for column, row, height, memory in (
            (2.4, 3.0, 0.0, "step fields"),
            (6.5, 3.0, 0.0, "step fields"),
            (3.0, 5.1, 0.0, "void"),
            (6.6, 7.3, 0.0, "void"),
            (8.0, 2.8, PLATFORM, "platform"),
            (0.3, 4.2, 0.0, ""),
            (0.4, 7.4, 0.0, ""),
        )
    ),
    lights=(
        Light(at=(*cell(2, 2), 3.0), brightness=6.0),
        Light(at=(*cell(6, 2), 3.0), brightness=6.0),
        Light(at=(*cell(4, 6), 3.0), brightness=6.0),
    ),
    starts=(
        StartPose(tag="PlayerStart", at=(0.76, -2.3, START_ELEVATION)),
        *(
            StartPose(
                tag=f"Start{i}",
                at=(*cell(*place), START_ELEVATION),
                yaw=0.0 if place == (2, 3) else math.pi / 2 * (i % 4 - 1),
            )
            for i, place in enumerate(START_CELLS, start=1)
        ),
    ),
    extent=((ORIGIN[0], EAST), (ORIGIN[1], NORTH)),
    robots=("kenaf", "TeleMax", "Talon", "Soryu", "Rugbot"),
)


FLIGHT = 5
"""Number of rises of the stairs."""
UPPER, PIPES, ROOM = FLIGHT * RISE, 0.8, 0.75
"""Height of the deck between the stairs and of four pipe steps, room under the ceiling (chosen) [m]."""
HALL = Hall(columns=11, first=2, last=8, tops=(0.0, 0.4, 0.4, 0.2, UPPER, PIPES, 0.45, ROOM - 0.4))
HALL_WEST, HALL_EAST = HALL.first * CELL, HALL.last * CELL
"""Ends of the lanes [m]."""
STAIR_ANGLE = math.radians(45)


def _across(row: int) -> float:
    """Return y of the middle of a lane [m]."""
    return HALL.at(0, row)[1]


FLIGHT_RUN = (FLIGHT - 1) * RISE / math.tan(STAIR_ANGLE)
HEAD, TAIL = HALL_WEST + CELL + FLIGHT_RUN, HALL_EAST - CELL - FLIGHT_RUN
"""x of the end of the stairs up, and of the beginning of those down [m]."""
BRINK = HALL_WEST + CELL / 2 + 2 * CELL + CELL / 2
"""x of the beginning of the inclined plane behind the pipe steps [m]."""

LANES = (
    *HALL.fields(1, 3, ("flat", "hill", "diagonal", "hill"), POST),
    *HALL.fields(2, 3, ("diagonal", "flat", "hill"), POST),
    *hurdle(HALL.at(3, 3), 0.2),
    *hurdle(HALL.at(6, 3), 0.2),
    *stairs((HEAD, _across(4)), 0.0, FLIGHT, angle=STAIR_ANGLE),
    HALL.deck(4, HEAD, TAIL, UPPER),
    *stairs((TAIL, _across(4)), math.pi, FLIGHT, angle=STAIR_ANGLE),
    *pipe_steps((HALL_WEST + CELL / 2, _across(5)), 0.0, 4),
    HALL.deck(5, HALL_WEST + CELL / 2 + 2 * CELL, BRINK, PIPES),
    slope((BRINK + PIPES / math.tan(math.radians(30)), _across(5), 0.0), (BRINK, _across(5), PIPES), CELL),
    *rubble(HALL.at(3.6, 6), 0.4, 0.35, 12, seed=1),
    *rubble(HALL.at(6.0, 6), 0.4, 0.45, 12, seed=2),
    cinder_block(HALL.at(4.7, 6.2), yaw=0.3),
    cinder_block(HALL.at(4.9, 5.7), yaw=1.2),
    *ramps(">^<v>^<v\nv>^<v>^<", (HALL_WEST + CELL, 7 * CELL), side=CELL / 2),
    ceiling(HALL.at(4.5, 7), 4 * CELL, ROOM),
)
VICTIM_ROWS, SIGN_ROWS = (2, 5, 7), (0, 1, 3, 4, 6)

RED_2025 = ArenaSpec(
    name="DM-USAR_red_2025",
    aliases=("red_2025",),
    about="Lanes with cubic step fields, hurdles, stairs of 45 degrees, pipe steps, rubble, and ramps under "
    "a low ceiling; victims in boxes behind them.",
    shapes=finished((*HALL.walls(), *LANES, *HALL.boxes(VICTIM_ROWS), *HALL.signs(SIGN_ROWS)), PANELLED),
    starts=HALL.starts(behind=(0, 1, 3, 4, 6)),
    extent=HALL.extent,
    victims=HALL.victims(("Goran", "Hana", "Imre"), VICTIM_ROWS),
    tags=tuple(Tag(at=(*HALL.at(1.5, row), 0.01), memory=f"lane {row}") for row in range(HALL.rows)),
    lights=HALL.lights(),
    robots=("kenaf", "Talon", "TeleMax"),
)
