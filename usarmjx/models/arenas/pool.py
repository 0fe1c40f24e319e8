"""DM-Pool: a walled basin with a quay along one side, for the submarine and what must not fall in.

The manual's list of files has maps for submarines, but describes none: the plan is ours. The floor of the
basin is the arena's floor; the quay lies at the wire's origin height.
"""

from usarmjx.models.arena_spec import ArenaSpec, StartPose, Water
from usarmjx.models.spec import Shape

LENGTH, WIDTH, DEPTH = 60.0, 44.0, 5.0
"""Of the water [m]: room for the submarine to turn about, which takes it 36 m."""
FREEBOARD, QUAY, WALL, PARAPET = 0.4, 4.0, 0.3, 1.2
"""Quay above the water, its width, thickness of walls and deck, height of the parapet [m]."""
DECK = DEPTH + FREEBOARD
START_ELEVATION = 0.188  # manual 5.3.5
KEEL = 1.5
"""Height of the submarines' keels over the floor when they start [m]."""
WATER_X, WATER_ROWS = -20.0, (0.0, -4.0, 4.0, -8.0)
QUAY_COLUMNS = (-20.0, -10.0, 0.0, 10.0, 20.0)

CONCRETE = (0.65, 0.65, 0.62, 1.0)
TILES = (0.45, 0.65, 0.75, 1.0)
RUST = (0.5, 0.3, 0.2, 1.0)


def _block(
    low: tuple[float, float, float],
    high: tuple[float, float, float],
    surface: str = "wall",
    rgba: tuple[float, float, float, float] = TILES,
) -> Shape:
    """Return the box between two corners."""
    x, y, z = ((a + b) / 2 for a, b in zip(low, high, strict=True))
    half_x, half_y, half_z = ((b - a) / 2 for a, b in zip(low, high, strict=True))
    return Shape(kind="box", size=(half_x, half_y, half_z), at=(x, y, z), surface=surface, rgba=rgba)


X, Y = LENGTH / 2, WIDTH / 2
SHORE = -Y - QUAY  # where the quay ends
SHAPES = (
    # The basin: far side, both ends, and the quay's side up to the deck.
    _block((-X - WALL, Y, 0.0), (X + WALL, Y + WALL, DECK + PARAPET)),
    _block((-X - WALL, SHORE, 0.0), (-X, Y, DECK + PARAPET)),
    _block((X, SHORE, 0.0), (X + WALL, Y, DECK + PARAPET)),
    _block((-X, -Y - WALL, 0.0), (X, -Y, DECK - WALL)),
    # The quay and the wall behind it.
    _block((-X, SHORE, DECK - WALL), (X, -Y, DECK), "ground", CONCRETE),
    _block((-X - WALL, SHORE - WALL, 0.0), (X + WALL, SHORE, DECK + PARAPET), rgba=CONCRETE),
    # On the floor: a step for sonars to hear, and a wreck to look at.
    _block((15.0, -Y, 0.0), (X, -10.0, 1.0)),
    _block((12.0, 12.0, 0.0), (16.0, 13.5, 1.2), rgba=RUST),
)

POOL = ArenaSpec(
    name="DM-Pool",
    aliases=("pool",),
    floor=-DECK,
    shapes=SHAPES,
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
    ),
    extent=((-X, X), (SHORE, Y)),
)
