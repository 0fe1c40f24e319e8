"""DM-USAR_orange, modelled on NIST's orange arena.

The manual (3.2.1.1): a bi-level arena with stairs and a ramp, its floor covered with debris, as paper, pipes
and cement blocks. It gives no measures: the plan is ours, on the grid of the NIST arenas. The floor lies 1.44
m below the wire's origin, so that the manual's start position (Table 2: 1.2,-2.3,1.16, z down) puts a P2AT,
whose origin is 0.26 m above the ground (5.3.6), 2 cm above it.

ORANGE_2025 has lanes of structured obstacles side by side. From one side to the other: a bare lane, crossing
ramps (ASTM E2827), continuous ramps (E2826), hurdles of 10 cm (E2802), half cubic step fields (E2828), stairs
of 35 degrees to a deck (E2804) and an inclined plane of 30 degrees down (E2803), two pipe steps, and a gap of
20 cm between two decks (E2801). `lanes` lists the chosen measures; the order of lanes is ours.
"""

import math
from functools import partial

from usarmjx.models.arenas.lanes import hurdle
from usarmjx.models.arenas.league_hall import Hall
from usarmjx.models.arenas.pieces import (
    BRICKED,
    CELL,
    PANE,
    PANELLED,
    POST,
    RAMP_ANGLE,
    RISE,
    STEEP,
    STEEPER,
    WOOD,
    block,
    brick,
    cell_center,
    cinder_block,
    deck,
    finished,
    loose_board,
    loose_cinder_block,
    loose_pipe,
    pallet,
    paper,
    pipe,
    pipe_steps,
    plank,
    ramps,
    slope,
    span,
    stairs,
    step_field,
    walls,
    waving,
)
from usarmjx.models.compile.victims import rest_height
from usarmjx.models.types.arena import (
    START_ELEVATION,
    ArenaSpec,
    Door,
    FalseAlarm,
    HelpSound,
    Light,
    StartPose,
    Tag,
    Victim,
)
from usarmjx.models.types.shapes import GLASS

FLOOR = -1.44
ORIGIN = (-4.2, -4.3)
COLUMNS, ROWS = 10, 8

PLAN = """
+--+--+--+--+--+--+--+--+--+--+
|                             |
+  +  +--+--+--+  +--+  +--+  +
|                             |
+  +--+  +--+  +  +  +--+  +  +
|     |        |     |        |
+--+  +  +--+  +--+  +  +--+  +
|                          |  |
+  +--+--+  +--+--+--+--+  +  +
|        |              |     |
+  +--+  +  +--+  +--+  +  +  +
|           |     |           |
+--+  +--+  +  +--+  +  +--+  +
|                             |
+  +  +  +  +  +  +--+  +  +  +
|                             |
+--+--+--+--+--+--+--+--+--+--+
"""
STAIRS = 7
"""Number of rises of the stairs."""
UPPER = STAIRS * RISE
"""Height of the upper floor [m]."""
WEST, SOUTH = ORIGIN[0] + 6 * CELL, ORIGIN[1] + 4 * CELL
"""West and south edge of the upper floor, over the columns from 6 and the rows from 4 [m]."""
EAST, NORTH = ORIGIN[0] + COLUMNS * CELL, ORIGIN[1] + ROWS * CELL
"""East and north edge of the upper floor and of the arena [m]."""
RAMP_RUN = UPPER / math.tan(RAMP_ANGLE)
PARAPET = 0.3


cell = partial(cell_center, ORIGIN)
RAMP_Y, STAIRS_Y, STEEPER_X = cell(0, 7)[1], cell(0, 4)[1], cell(9, 0)[0]
SIDE = cell(0, 6.5)[1]
"""y of the open side of the ramp's upper half, above a void [m]."""

UPPER_FLOOR = (
    deck((WEST, SOUTH), (EAST, NORTH), UPPER),
    *stairs((WEST, STAIRS_Y), 0.0, STAIRS),
    *stairs((STEEPER_X, SOUTH), math.pi / 2, STAIRS, angle=STEEPER),
    slope((WEST - RAMP_RUN, RAMP_Y, 0.0), (WEST, RAMP_Y, UPPER), CELL),
    # Parapets: beside the ramp, and around the upper floor but for the ways up.
    slope(
        (WEST - CELL, SIDE, UPPER - CELL * math.tan(RAMP_ANGLE) + 0.15),
        (WEST, SIDE, UPPER + 0.15),
        0.05,
        thickness=0.2,
        surface="wall",
    ),
    *(
        span((x0 - 0.025, y0 - 0.025, UPPER - 0.1), (x1 + 0.025, y1 + 0.025, UPPER + PARAPET), WOOD)
        for x0, y0, x1, y1 in (
            (WEST, SOUTH + CELL, WEST, NORTH - CELL),
            (WEST, SOUTH, EAST - CELL, SOUTH),
            (EAST, SOUTH, EAST, NORTH),
            (WEST, NORTH, EAST, NORTH),
        )
    ),
)

OBSTACLES = (
    *ramps(">^<v\nv>^<", cell(1.5, 0.5), side=CELL / 2),  # crossing half ramps
    *ramps("><", cell(5.5, 0.5)),  # full ramps, up and down
    *step_field(cell(8, 2), "hill", unit=POST / 2),  # half cubic
    *step_field(cell(5, 0), "flat", unit=POST / 2),
)

PANE_X, PANE_Y = cell(8, 0)[0], SOUTH
HIDING = (
    # A window into the room under the upper floor.
    span(
        (PANE_X - CELL / 2, PANE_Y - 0.005, 0.0),
        (PANE_X + CELL / 2, PANE_Y + 0.005, 1.15),
        PANE,
        material=GLASS,
    ),
    # A board that hides a victim, in the corner of the first column.
    block((ORIGIN[0] + 0.75, ORIGIN[1] + 0.95), (1.0, 0.02, 0.9), surface="wall", rgba=WOOD),
)

DEBRIS = (
    *pipe(cell(2.1, 4.0), 1.0, yaw=1.9),
    *pipe(cell(7.0, 4.9), 0.8, yaw=0.7),
    *pipe(cell(0.2, 4.0), 0.9, yaw=0.4),
    cinder_block(cell(3.2, 6.3), yaw=0.5),
    cinder_block(cell(9.1, 6.8), yaw=1.2),
    cinder_block(cell(4.25, 3.35), yaw=0.2),
    cinder_block(cell(4.25, 3.35), z=0.19, yaw=0.5),
    cinder_block(cell(1.8, 2.2), yaw=2.4),
    paper(cell(2.2, 5.0), yaw=0.6),
    paper(cell(2.95, 2.9), yaw=1.7),
    paper(cell(6.3, 3.1), yaw=0.1),
    paper(cell(7.2, 6.1), yaw=2.2),
    plank(cell(4.9, 5.9), 1.0, yaw=0.9),
    plank(cell(8.0, 3.1), 0.9, yaw=1.3),
    plank(cell(0.9, 1.2), 0.8, yaw=2.6),
    *pallet(cell(4.0, 1.75), yaw=0.0),
)

LOOSE = (
    loose_cinder_block("block1", cell(3.3, 5.1), yaw=0.4),
    loose_cinder_block("block2", cell(7.1, 2.8), yaw=1.1),
    loose_cinder_block("block3", cell(6.2, 6.1), yaw=2.0),
    brick("brick1", cell(2.6, 5.1), yaw=0.3),
    brick("brick2", cell(5.3, 1.9), yaw=1.4),
    brick("brick3", cell(8.2, 4.8), z=UPPER, yaw=0.8),
    loose_pipe("pipe1", cell(1.2, 6.2), 0.8, yaw=0.7),
    loose_pipe("pipe2", cell(3.2, 3.4), 0.6, yaw=1.9),
    loose_pipe("pipe3", cell(8.4, 0.3), 0.9, yaw=2.5),
    loose_pipe("pipe4", cell(7.0, 5.3), 0.7, z=UPPER, yaw=0.5),
    loose_board("board1", cell(5.7, 2.9), (0.6, 0.4, 0.012), yaw=0.6),
    loose_board("board2", cell(9.0, 2.0), (0.8, 0.3, 0.018), yaw=1.0),
)

LYING, SITTING, CROUCHED = (rest_height(posture) for posture in ("lying", "sitting", "crouched"))

VICTIMS = (
    Victim(
        name="Waving",
        at=(*cell(8.3, 6.2), UPPER + SITTING),
        rotation=(0.0, 0.0, -2.4),
        posture="sitting",
        segments=waving(),
        help_sound=HelpSound(loudness=1.0),
        state="moving: waves from the upper floor",
    ),
    Victim(
        name="BehindBoard",
        at=(ORIGIN[0] + 0.35, ORIGIN[1] + 0.45, SITTING),
        posture="sitting",
        help_sound=HelpSound(loudness=0.5, duration=1.0, pause=6.0),
        state="hidden behind a board",
    ),
    Victim(
        name="UnderRamp",
        at=(*cell(5.0, 7.0), LYING),
        state="in a void: lies still under the ramp",
    ),
    Victim(
        name="UnderFloor",
        at=(*cell(8.0, 4.2), CROUCHED),
        rotation=(0.0, 0.0, math.pi),
        posture="crouched",
        state="still: behind glass, under the upper floor",
    ),
)

# The first is the manual's. The last two are on the upper floor.
START_CELLS = (
    (0, 7), (1, 7), (2, 6), (0, 5), (1, 5), (3, 4), (0, 3), (1, 3), (5, 3), (0, 2), (3, 2), (0, 1), (5, 1),
    (8, 1), (9, 0), (7, 0), (3, 0), (6, 5),
)  # fmt: skip
UPPER_CELLS = ((7, 6), (6, 4))

ORANGE = ArenaSpec(
    name="DM-USAR_orange",
    aliases=("orange",),
    about="Two levels joined by stairs of 35 and 40 degrees and a ramp; debris, half cubic step fields. "
    "116 fixed solids, 12 loose objects.",
    floor=FLOOR,
    shapes=finished(
        (*walls(PLAN, origin=ORIGIN, cell=CELL), *UPPER_FLOOR, *OBSTACLES, *HIDING, *DEBRIS), BRICKED
    ),
    loose=LOOSE,
    doors=(
        Door(name="door1", at=(ORIGIN[0] + 0.05, ORIGIN[1] + 6 * CELL, 0.0), size=(1.1, 0.04, 1.15)),
        Door(name="door2", at=(ORIGIN[0] + CELL + 0.05, ORIGIN[1] + 2 * CELL, 0.0), size=(1.1, 0.04, 1.15)),
    ),
    victims=VICTIMS,
    false_alarms=(
        FalseAlarm(part="LeftHand", at=(*cell(3.7, 2.75), 0.02), rotation=(math.pi / 2, 0.0, 0.4)),
        FalseAlarm(part="Head", at=(*cell(9.2, 7.2), 0.16)),
    ),
    tags=tuple(
        Tag(at=(*cell(column, row), height + 0.02), memory=memory)
        for column, row, height, memory in (
            (4.1, 4.3, 0.0, "stairs"),
            (1.0, 6.7, 0.0, "ramp"),
            (6.3, 7.0, UPPER, "upper floor"),
            (8.6, 5.7, UPPER, ""),
            (8.4, 5.4, 0.0, ""),
            (0.6, 0.4, 0.0, ""),
            (5.0, 6.6, 0.0, "void"),
            (8.3, 2.75, 0.0, ""),
        )
    ),
    lights=(
        Light(at=(*cell(2, 5), 3.0), brightness=6.0),
        Light(at=(*cell(7, 6), 3.0), brightness=6.0),
        Light(at=(*cell(6, 1), 3.0), brightness=6.0),
        Light(at=(*cell(7, 5), 1.1), brightness=0.3, rgb=(1.0, 0.8, 0.6)),  # under the upper floor
    ),
    gps=(39.1333, -77.2167),  # NIST, Gaithersburg
    starts=(
        StartPose(tag="PlayerStart", at=(1.2, 2.3, START_ELEVATION)),
        *(
            StartPose(tag=f"Start{i}", at=(*cell(*place), START_ELEVATION), yaw=math.pi / 2 * (i % 4 - 1))
            for i, place in enumerate(START_CELLS, start=1)
        ),
        *(
            StartPose(tag=f"Upper{i}", at=(*cell(*place), UPPER + START_ELEVATION), yaw=math.pi)
            for i, place in enumerate(UPPER_CELLS, start=1)
        ),
    ),
    extent=((ORIGIN[0], EAST), (ORIGIN[1], NORTH)),
    robots=("P2AT", "Talon", "TeleMax", "kenaf", "Tarantula"),
)


FLIGHT = 5
"""Number of rises of the stairs."""
HALL_DECK, STEPS, LOW = FLIGHT * RISE, 0.4, 0.3
"""Height of the decks behind the stairs and the pipe steps, and beside the gap [m]."""
RIDGE = CELL * math.tan(RAMP_ANGLE)
HALL = Hall(columns=11, first=2, last=8, tops=(0.0, RIDGE / 2, RIDGE, 0.1, 0.2, HALL_DECK, STEPS, LOW))
HALL_WEST, HALL_EAST = HALL.first * CELL, HALL.last * CELL
"""Ends of the lanes [m]."""
GAP = 0.2
"""Width of the gap [m]."""


def _across(row: int) -> float:
    """Return y of the middle of a lane [m]."""
    return HALL.at(0, row)[1]


HEAD = HALL_WEST + CELL + (FLIGHT - 1) * RISE / math.tan(STEEP)
"""x of the end of the stairs [m]."""
FOOT = HALL_EAST - CELL / 2
"""x of the end of the inclined plane [m]."""
BRINK = FOOT - HALL_DECK / math.tan(math.radians(30))
MIDDLE = (HALL_WEST + HALL_EAST) / 2

LANES = (
    *ramps(">^<v>^<v>^<v\nv>^<v>^<v>^<", (HALL_WEST, 1 * CELL), side=CELL / 2),
    *ramps("><><><", (HALL_WEST, 2 * CELL)),
    *hurdle(HALL.at(3, 3), 0.1),
    *hurdle(HALL.at(6, 3), 0.1),
    *HALL.fields(4, 3, ("flat", "hill", "diagonal", "flat"), POST / 2),
    *stairs((HEAD, _across(5)), 0.0, FLIGHT),
    HALL.deck(5, HEAD, BRINK, HALL_DECK),
    slope((FOOT, _across(5), 0.0), (BRINK, _across(5), HALL_DECK), CELL),
    *pipe_steps((HALL_WEST + CELL, _across(6)), 0.0, 2),
    HALL.deck(6, HALL_WEST + 2 * CELL, HALL_EAST - 2 * CELL, STEPS),
    slope((HALL_EAST - 0.3, _across(6), 0.0), (HALL_EAST - 2 * CELL, _across(6), STEPS), CELL),
    slope((HALL_WEST, _across(7), 0.0), (HALL_WEST + CELL, _across(7), LOW), CELL),
    HALL.deck(7, HALL_WEST + CELL, MIDDLE - GAP / 2, LOW),
    HALL.deck(7, MIDDLE + GAP / 2, HALL_EAST - CELL, LOW),
    slope((HALL_EAST, _across(7), 0.0), (HALL_EAST - CELL, _across(7), LOW), CELL),
)
VICTIM_ROWS, SIGN_ROWS = (1, 4, 6), (0, 2, 3, 5, 7)

ORANGE_2025 = ArenaSpec(
    name="DM-USAR_orange_2025",
    aliases=("orange_2025",),
    about="Lanes with crossing and continuous ramps, hurdles, half cubic step fields, stairs, an inclined "
    "plane, pipe steps and a gap; victims in boxes behind them.",
    shapes=finished((*HALL.walls(), *LANES, *HALL.boxes(VICTIM_ROWS), *HALL.signs(SIGN_ROWS)), PANELLED),
    starts=HALL.starts(behind=(0, 2, 3, 5, 7)),
    extent=HALL.extent,
    victims=HALL.victims(("Dora", "Emil", "Fatima"), VICTIM_ROWS),
    tags=tuple(Tag(at=(*HALL.at(1.5, row), 0.01), memory=f"lane {row}") for row in range(HALL.rows)),
    lights=HALL.lights(),
    robots=("Talon", "kenaf", "TeleMax", "P2AT"),
)
