"""The red arena of 2025: lanes of unstructured and high obstacles side by side.

From one side to the other: a bare lane, two lanes of cubic step fields (ASTM E2828), hurdles of 20 cm
(E2802), stairs of 45 degrees to a deck and down again (E2804), four pipe steps and an inclined plane of 30
degrees, rubble with cement blocks, and crossing ramps under a low ceiling (E2827). `lanes` lists the chosen
measures; the order of lanes is ours.
"""

import math

from usarmjx.models.arenas.elements import CELL, POST, RISE, ramps, slope, stairs
from usarmjx.models.arenas.lanes import hurdle
from usarmjx.models.arenas.league_hall import Hall, ceiling
from usarmjx.models.arenas.pieces import PANELLED, cinder_block, finished, pipe_steps, rubble
from usarmjx.models.types.arena import ArenaSpec, Tag

FLIGHT = 5
"""Number of rises of the stairs."""
UPPER, PIPES, ROOM = FLIGHT * RISE, 0.8, 0.75
"""Height of the deck between the stairs and of four pipe steps, room under the ceiling (chosen) [m]."""
HALL = Hall(columns=11, first=2, last=8, tops=(0.0, 0.4, 0.4, 0.2, UPPER, PIPES, 0.45, ROOM - 0.4))
WEST, EAST = HALL.first * CELL, HALL.last * CELL
"""Ends of the lanes [m]."""
STAIR_ANGLE = math.radians(45)


def _across(row: int) -> float:
    """Return y of the middle of a lane [m]."""
    return HALL.at(0, row)[1]


FLIGHT_RUN = (FLIGHT - 1) * RISE / math.tan(STAIR_ANGLE)
HEAD, TAIL = WEST + CELL + FLIGHT_RUN, EAST - CELL - FLIGHT_RUN
"""x of the end of the stairs up, and of the beginning of those down [m]."""
BRINK = WEST + CELL / 2 + 2 * CELL + CELL / 2
"""x of the beginning of the inclined plane behind the pipe steps [m]."""

LANES = (
    *HALL.fields(1, 3, ("flat", "hill", "diagonal", "hill"), POST),
    *HALL.fields(2, 3, ("diagonal", "flat", "hill"), POST),
    *hurdle(HALL.at(3, 3), 0.2),
    *hurdle(HALL.at(6, 3), 0.2),
    *stairs((HEAD, _across(4)), 0.0, FLIGHT, angle=STAIR_ANGLE),
    HALL.deck(4, HEAD, TAIL, UPPER),
    *stairs((TAIL, _across(4)), math.pi, FLIGHT, angle=STAIR_ANGLE),
    *pipe_steps((WEST + CELL / 2, _across(5)), 0.0, 4),
    HALL.deck(5, WEST + CELL / 2 + 2 * CELL, BRINK, PIPES),
    slope((BRINK + PIPES / math.tan(math.radians(30)), _across(5), 0.0), (BRINK, _across(5), PIPES), CELL),
    *rubble(HALL.at(3.6, 6), 0.4, 0.35, 12, seed=1),
    *rubble(HALL.at(6.0, 6), 0.4, 0.45, 12, seed=2),
    cinder_block(HALL.at(4.7, 6.2), yaw=0.3),
    cinder_block(HALL.at(4.9, 5.7), yaw=1.2),
    *ramps(">^<v>^<v\nv>^<v>^<", (WEST + CELL, 7 * CELL), side=CELL / 2),
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
