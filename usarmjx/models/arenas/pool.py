"""DM-Pool: a walled basin with a quay along one side, for the submarine and for robots beside the water.

The manual's list of files has maps for submarines, but describes none: the plan is ours. The floor of the
basin is the arena's floor; the quay is at the height of the wire's origin.
"""

import math

from usarmjx.models.arenas.pieces import BARE, CONCRETE, finished, span, waving
from usarmjx.models.compile.victims import rest_height
from usarmjx.models.types.arena import START_ELEVATION, ArenaSpec, HelpSound, StartPose, Tag, Victim, Water

LENGTH, WIDTH, DEPTH = 60.0, 44.0, 5.0
"""Size of the water [m]: room for the submarine to turn about, which takes it 36 m."""
FREEBOARD, QUAY, WALL, PARAPET = 0.4, 4.0, 0.3, 1.2
"""Height of the quay above the water, its width, thickness of walls and deck, height of the parapet [m]."""
DECK = DEPTH + FREEBOARD
KEEL = 1.5
"""Height of the submarines' keels over the floor when they start [m]."""
WATER_X, WATER_ROWS = -20.0, (0.0, -4.0, 4.0, -8.0)
QUAY_COLUMNS = (-20.0, -10.0, 0.0, 10.0, 20.0)

TILES = (0.45, 0.65, 0.75, 1.0)
RUST = (0.5, 0.3, 0.2, 1.0)

X, Y = LENGTH / 2, WIDTH / 2
SHORE = -Y - QUAY  # y of the quay's outer edge
SHAPES = (
    # The basin: far side, both ends, and the quay's side up to the deck.
    span((-X - WALL, Y, 0.0), (X + WALL, Y + WALL, DECK + PARAPET), TILES),
    span((-X - WALL, SHORE, 0.0), (-X, Y, DECK + PARAPET), TILES),
    span((X, SHORE, 0.0), (X + WALL, Y, DECK + PARAPET), TILES),
    span((-X, -Y - WALL, 0.0), (X, -Y, DECK - WALL), TILES),
    # The quay and the wall behind it.
    span((-X, SHORE, DECK - WALL), (X, -Y, DECK), surface="ground"),
    span((-X - WALL, SHORE - WALL, 0.0), (X + WALL, SHORE, DECK + PARAPET), CONCRETE),
    # On the floor: a step for sonars, and a wreck for cameras.
    span((15.0, -Y, 0.0), (X, -10.0, 1.0), TILES),
    span((12.0, 12.0, 0.0), (16.0, 13.5, 1.2), RUST),
)

POOL = ArenaSpec(
    name="DM-Pool",
    aliases=("pool",),
    about="A basin of 60 x 44 m, 5 m deep, with a step and a wreck on its floor, and a quay beside it.",
    floor=-DECK,
    shapes=finished(SHAPES, {**BARE, TILES: "tiles"}),
    waters=(Water(low=(-X, -Y, 0.0), high=(X, Y, DEPTH)),),
    starts=(
        *(
            StartPose(tag=f"Water{i}", at=(WATER_X, y, KEEL + START_ELEVATION))
            for i, y in enumerate(WATER_ROWS, start=1)
        ),
        *(
            StartPose(tag=f"Quay{i}", at=(x, -Y - QUAY / 2, DECK + START_ELEVATION))
            for i, x in enumerate(QUAY_COLUMNS, start=1)
        ),
        StartPose(tag="PlayerStart", at=(WATER_X, 8.0, KEEL + START_ELEVATION)),
    ),
    extent=((-X, X), (SHORE, Y)),
    victims=(
        Victim(
            name="Swimmer",
            at=(25.0, -Y - 0.5, DECK + rest_height("sitting")),
            rotation=(0.0, 0.0, math.pi),
            posture="sitting",
            segments=waving(),
            help_sound=HelpSound(),
            state="sits on the quay beside the water and waves",
        ),
    ),
    tags=(
        Tag(at=(-25.0, SHORE + 0.02, DECK + 0.4), memory="Quay, west end"),
        Tag(at=(27.0, SHORE + 0.02, DECK + 0.4), memory="Quay, east end"),
    ),
    robots=("Submarine", "P2AT", "Talon", "AirRobot"),
)
