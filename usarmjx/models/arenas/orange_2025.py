"""The orange arena of 2025: lanes of structured obstacles side by side.

From one side to the other: a bare lane, crossing ramps (ASTM E2827), continuous ramps (E2826), hurdles of 10
cm (E2802), half cubic step fields (E2828), stairs of 35 degrees to a deck (E2804) and an inclined plane of 30
degrees down (E2803), two pipe steps, and a gap of 20 cm between two decks (E2801). `lanes` lists the chosen
measures; the order of lanes is ours.
"""

import math

from usarmjx.models.arenas.elements import CELL, POST, RAMP_ANGLE, RISE, STEEP, ramps, slope, stairs
from usarmjx.models.arenas.lanes import hurdle
from usarmjx.models.arenas.league_hall import Hall
from usarmjx.models.arenas.pieces import PANELLED, finished, pipe_steps
from usarmjx.models.types.arena import ArenaSpec, Tag

FLIGHT = 5
"""Number of rises of the stairs."""
UPPER, STEPS, LOW = FLIGHT * RISE, 0.4, 0.3
"""Height of the decks behind the stairs and the pipe steps, and beside the gap [m]."""
RIDGE = CELL * math.tan(RAMP_ANGLE)
HALL = Hall(columns=11, first=2, last=8, tops=(0.0, RIDGE / 2, RIDGE, 0.1, 0.2, UPPER, STEPS, LOW))
WEST, EAST = HALL.first * CELL, HALL.last * CELL
"""Ends of the lanes [m]."""
GAP = 0.2
"""Width of the gap [m]."""


def _across(row: int) -> float:
    """Return y of the middle of a lane [m]."""
    return HALL.at(0, row)[1]


HEAD = WEST + CELL + (FLIGHT - 1) * RISE / math.tan(STEEP)
"""x of the end of the stairs [m]."""
FOOT = EAST - CELL / 2
"""x of the end of the inclined plane [m]."""
BRINK = FOOT - UPPER / math.tan(math.radians(30))
MIDDLE = (WEST + EAST) / 2

LANES = (
    *ramps(">^<v>^<v>^<v\nv>^<v>^<v>^<", (WEST, 1 * CELL), side=CELL / 2),
    *ramps("><><><", (WEST, 2 * CELL)),
    *hurdle(HALL.at(3, 3), 0.1),
    *hurdle(HALL.at(6, 3), 0.1),
    *HALL.fields(4, 3, ("flat", "hill", "diagonal", "flat"), POST / 2),
    *stairs((HEAD, _across(5)), 0.0, FLIGHT),
    HALL.deck(5, HEAD, BRINK, UPPER),
    slope((FOOT, _across(5), 0.0), (BRINK, _across(5), UPPER), CELL),
    *pipe_steps((WEST + CELL, _across(6)), 0.0, 2),
    HALL.deck(6, WEST + 2 * CELL, EAST - 2 * CELL, STEPS),
    slope((EAST - 0.3, _across(6), 0.0), (EAST - 2 * CELL, _across(6), STEPS), CELL),
    slope((WEST, _across(7), 0.0), (WEST + CELL, _across(7), LOW), CELL),
    HALL.deck(7, WEST + CELL, MIDDLE - GAP / 2, LOW),
    HALL.deck(7, MIDDLE + GAP / 2, EAST - CELL, LOW),
    slope((EAST, _across(7), 0.0), (EAST - CELL, _across(7), LOW), CELL),
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
