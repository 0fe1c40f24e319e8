"""DM-Factory: a hall with a loading bay, a corridor and four rooms under one roof.

A captured greeting names a level DM-Factory_250; its plan is unknown, so this one is ours (x from the west
wall, y from the south wall):

    y 16 +-----------+-----------+-----------+-----------+
         | Office    | Store     | Control   | Workshop  |
      11 +----DD-----+---   -----+-DD--GGGG--+---   -----+
         | Corridor                                      |
       9 +---   -------DD----------   ---+               |
         | Hall: racks, press,             Bay: dock,
         | conveyors, pillars            | ramp
         |                               W               |
       0 +-------------------------------+---------------+
         x 0         6           12      16  18         24

Doors (D) that robots push open, a pane (G), and a window without one (W), 1.4 m wide and high, for AirRobots;
gaps are open passages. P2ATs get into every room. The floor has the height of the yellow arena's, so that the
height of test programs there (1.8, z down) is just above it here too.
"""

import math

from usarmjx.models.arenas.pieces import (
    BARE,
    CONCRETE,
    MESHWORK,
    PANE,
    SILVER,
    STEEL,
    WOOD,
    block,
    brick,
    drum,
    finished,
    loose_box,
    slope,
    span,
    table,
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
    SegmentMotion,
    StartPose,
    Tag,
    Victim,
)
from usarmjx.models.types.shapes import FENDER, GLASS, MIRROR, Rgba, Shape

LENGTH, WIDTH, HEIGHT = 24.0, 16.0, 3.0
OUTER, INNER = 0.2, 0.1
"""Thickness of walls [m]."""
CORRIDOR = (9.0, 11.0)
BAY = 16.0
"""x of the wall between hall and bay [m]."""
ROOMS = (6.0, 12.0, 18.0)
"""x of the walls between rooms [m]."""
DOORWAY, PASSAGE = 2.1, 2.4
"""Height of openings with a door and without [m]."""
WINDOW = (2.8, 4.2, 0.8, 2.2)
"""Window in the bay's wall: y from and to, height from and to [m]."""
GATE = (4.0, 7.0)
"""y of the gate to the outside [m]."""
PRESS = (6.0, 4.6)
DOCK = (20.0, 2.4, 0.6)
"""Beginning of the dock along x, its end along y, and its height [m]."""
RAMP_RUN = 2.4

RED: Rgba = (0.7, 0.25, 0.2, 1.0)
GREEN: Rgba = (0.25, 0.5, 0.4, 1.0)
BELT: Rgba = (0.2, 0.2, 0.22, 1.0)
ROOF: Rgba = (0.6, 0.6, 0.6, 0.12)

Opening = tuple[float, float, float, float]
"""Beginning and end along the wall, lower and upper edge [m]."""


def _wall(
    at: float, start: float, stop: float, openings: tuple[Opening, ...] = (), along: str = "x"
) -> tuple[Shape, ...]:
    """Return an inner wall with openings: its pieces, and the wall below and above the openings."""
    pieces: list[Shape] = []

    def add(begin: float, end: float, low: float, high: float) -> None:
        if end > begin and high > low:
            across = (at - INNER / 2, at + INNER / 2)
            (x0, x1), (y0, y1) = ((begin, end), across) if along == "x" else (across, (begin, end))
            pieces.append(span((x0, y0, low), (x1, y1, high)))

    for begin, end, low, high in openings:
        add(start, begin, 0.0, HEIGHT)
        add(begin, end, 0.0, low)
        add(begin, end, high, HEIGHT)
        start = end
    add(start, stop, 0.0, HEIGHT)
    return tuple(pieces)


def _rack(x: float, y: float, length: float = 2.4, depth: float = 0.5, height: float = 1.8) -> list[Shape]:
    """Return a rack along x: two ends and three boards, the lowest 10 cm above the floor."""
    ends = [
        block((x + side * (length - 0.04) / 2, y), (0.04, depth, height), surface="wall", rgba=STEEL)
        for side in (-1, 1)
    ]
    boards = [
        block((x, y), (length - 0.08, depth, 0.04), z=z, surface="wall", rgba=WOOD)
        for z in (0.1, 0.8, height - 0.1)
    ]
    return ends + boards


def _conveyor(x0: float, y0: float, x1: float, y1: float) -> list[Shape]:
    """Return a conveyor with its belt 0.8 m above the floor, on a stand at each end and in the middle."""
    stands = [
        block((x0 + share * (x1 - x0), y0 + share * (y1 - y0)), (0.3, 0.3, 0.6), surface="wall", rgba=STEEL)
        for share in (0.08, 0.5, 0.92)
    ]
    half_x, half_y = (0.0, 0.3) if y0 == y1 else (0.3, 0.0)
    belt = span((x0 - half_x, y0 - half_y, 0.6), (x1 + half_x, y1 + half_y, 0.8), BELT)
    return [belt, *stands]


BUILDING = (
    span((0.0, -OUTER, 0.0), (LENGTH, 0.0, HEIGHT)),
    span((0.0, WIDTH, 0.0), (LENGTH, WIDTH + OUTER, HEIGHT)),
    span((-OUTER, -OUTER, 0.0), (0.0, WIDTH + OUTER, HEIGHT)),
    span((LENGTH, -OUTER, 0.0), (LENGTH + OUTER, GATE[0], HEIGHT)),
    span((LENGTH, GATE[1], 0.0), (LENGTH + OUTER, WIDTH + OUTER, HEIGHT)),
    span((LENGTH, GATE[0], 2.6), (LENGTH + OUTER, GATE[1], HEIGHT)),
    span((-OUTER, -OUTER, HEIGHT), (LENGTH + OUTER, WIDTH + OUTER, HEIGHT + 0.1), ROOF),
    *_wall(
        CORRIDOR[0],
        0.0,
        BAY,
        ((2.0, 3.6, 0.0, PASSAGE), (7.0, 8.0, 0.0, DOORWAY), (13.0, 14.6, 0.0, PASSAGE)),
    ),
    *_wall(
        CORRIDOR[1],
        0.0,
        LENGTH,
        (
            (2.5, 3.5, 0.0, DOORWAY),
            (8.2, 9.8, 0.0, PASSAGE),
            (13.0, 14.0, 0.0, DOORWAY),
            (15.0, 17.0, 0.0, DOORWAY),  # filled by a pane
            (20.0, 21.6, 0.0, PASSAGE),
        ),
    ),
    *(piece for x in ROOMS for piece in _wall(x, CORRIDOR[1] + INNER / 2, WIDTH, along="y")),
    *_wall(BAY, 0.0, CORRIDOR[0] + INNER / 2, (WINDOW, (6.2, 8.4, 0.0, 2.6)), along="y"),
    *(block((x, y), (0.3, 0.3, HEIGHT), surface="wall") for x in (4.0, 8.0, 12.0) for y in (2.6, 6.8)),
    *(block((20.0, y), (0.3, 0.3, HEIGHT), surface="wall") for y in (4.6, 8.6)),
    # Beams and pipes under the roof.
    *(span((x - 0.1, 0.0, 2.75), (x + 0.1, CORRIDOR[0], HEIGHT), STEEL) for x in (4.0, 8.0, 12.0)),
    *(span((0.0, y, 2.5), (BAY, y + 0.12, 2.62), RED) for y in (0.2, 8.7)),
)

EFFECTS = (
    span((15.0, 10.98, 0.0), (17.0, 11.02, DOORWAY), PANE, material=GLASS),
    span((6.0, 10.92, 0.05), (8.0, 10.95, 1.9), SILVER, material=MIRROR),
    span((4.8, 3.48, 0.0), (7.2, 3.52, 1.2), MESHWORK, material=FENDER),
    span((4.78, 3.52, 0.0), (4.82, 5.7, 1.2), MESHWORK, material=FENDER),
)

FURNITURE = (
    # Hall: racks, a press, conveyors, a lathe.
    *_rack(1.6, 0.5),
    *_rack(4.2, 0.5),
    block(PRESS, (1.4, 1.2, 0.9), surface="wall", rgba=GREEN),
    block((PRESS[0] + 0.5, PRESS[1]), (0.4, 1.2, 0.8), z=0.9, surface="wall", rgba=GREEN),
    block(PRESS, (1.4, 0.8, 0.5), z=1.7, surface="wall", rgba=GREEN),
    *_conveyor(10.2, 5.2, 15.0, 5.2),
    *_conveyor(9.9, 0.4, 9.9, 4.4),
    block((13.6, 0.6), (2.0, 0.7, 0.8), surface="wall", rgba=GREEN),
    block((12.9, 0.6), (0.6, 0.7, 0.4), z=0.8, surface="wall", rgba=STEEL),
    # Office.
    *table((1.0, 14.8), (1.6, 0.8, 0.72)),
    *table((4.6, 13.2), (1.6, 0.8, 0.72)),
    block((1.0, 13.9), (0.45, 0.45, 0.45), surface="wall", rgba=STEEL),
    block((5.6, 15.6), (0.6, 0.5, 1.6), surface="wall", rgba=STEEL),
    # Store; a board has come down from a rack.
    *_rack(7.5, 15.6),
    *_rack(10.5, 15.6),
    slope((8.7, 14.4, 0.02), (10.1, 14.9, 1.25), 0.9, thickness=0.04),
    # Control room.
    *table((15.0, 15.3), (3.0, 0.8, 0.75), STEEL),
    *(block((x, 15.5), (0.5, 0.06, 0.4), z=0.75, surface="wall", rgba=BELT) for x in (14.4, 15.6)),
    block((12.5, 15.5), (0.6, 0.8, 2.0), surface="wall", rgba=STEEL),
    # Workshop.
    *table((22.4, 15.5), (2.4, 0.8, 0.9)),
    block((18.6, 14.2), (0.8, 1.2, 1.5), surface="wall", rgba=RED),
    # Bay: a dock with a ramp and two steps, a pallet, a container.
    span((DOCK[0], 0.0, 0.0), (LENGTH, *DOCK[1:]), surface="ground"),
    slope((DOCK[0] - RAMP_RUN, 1.2, 0.0), (DOCK[0], 1.2, DOCK[2]), 1.6, thickness=0.2),
    *(
        block((22.5, DOCK[1] + 0.3 * i + 0.15), (1.2, 0.3, 0.4 - 0.2 * i), surface="ground", rgba=CONCRETE)
        for i in range(2)
    ),
    block((17.0, 10.3), (1.2, 0.8, 0.144), surface="ground", rgba=WOOD),
    block((23.2, 9.6), (1.2, 2.4, 2.2), surface="wall", rgba=RED),
)


FLOOR = -2.08
"""Height of the floor in the world [m]."""


def _door(name: str, x: float, y: float) -> Door:
    """Return a door in a doorway of 1 m that begins at x; it swings both ways."""
    return Door(name=name, at=(x + 0.02, y, 0.0), size=(0.96, 0.04, 2.05), mass=12.0)


BREATHING = (
    SegmentMotion(name="Chest", initial=(0.0, 0.0, 0.0), final=(0.06, 0.0, 0.0), rates=(0.05, 0.0, 0.0)),
)

VICTIMS = (
    Victim(
        name="Clerk",
        at=(5.4, 11.7, rest_height("sitting")),
        rotation=(0.0, 0.0, math.pi / 2),
        posture="sitting",
        segments=waving(),
        help_sound=HelpSound(loudness=1.0),
        state="sits in the office's corner and waves",
    ),
    Victim(
        name="Operator",
        at=(6.0, 5.9, rest_height("lying")),
        segments=BREATHING,
        state="lies behind the press, hardly moves",
    ),
    Victim(
        name="Storekeeper",
        at=(9.7, 14.8, rest_height("lying")),
        rotation=(0.0, 0.0, math.pi),
        help_sound=HelpSound(loudness=0.4, duration=1.0, pause=6.0),
        state="lies under a fallen board in the dark, groans",
    ),
    Victim(
        name="Loader",
        at=(23.4, 0.6, DOCK[2] + rest_height("crouched")),
        rotation=(0.0, 0.0, math.pi),
        posture="crouched",
        segments=BREATHING,
        state="crouches in the corner of the dock",
    ),
)

LOOSE = (
    loose_box("Carton1", (12.0, 10.4), (0.4, 0.3, 0.3), 4.0, yaw=0.3),
    loose_box("Carton2", (16.8, 10.3), (0.4, 0.3, 0.3), 4.0, z=0.144),
    loose_box("Carton3", (17.3, 10.3), (0.4, 0.3, 0.3), 4.0, z=0.144, yaw=0.2),
    loose_box("Carton4", (18.8, 12.0), (0.6, 0.4, 0.4), 6.0, yaw=-0.4),
    loose_box("Plank", (14.2, 7.4), (1.5, 0.15, 0.03), 3.5, yaw=0.6, rgba=WOOD),
    brick("Brick1", (10.6, 12.2), yaw=0.5),
    brick("Brick2", (10.9, 12.6), yaw=-0.9),
    drum("Drum1", (1.0, 8.2), 15.0),
    drum("Drum2", (17.0, 5.4), 15.0),
)

STARTS = (
    ("Gate", 22.4, 5.5, math.pi),
    ("Bay", 18.5, 7.3, math.pi),
    ("Window", 13.6, 3.5, 0.0),
    ("Hall1", 1.2, 4.6, 0.0),
    ("Hall2", 2.4, 7.4, 0.0),
    ("Hall3", 10.0, 7.4, math.pi),
    ("Corridor1", 1.2, 10.0, 0.0),
    ("Corridor2", 10.5, 10.0, math.pi),
    ("Corridor3", 19.0, 10.0, math.pi),
    ("Office", 3.0, 12.4, math.pi / 2),
    ("Control", 13.5, 13.2, -math.pi / 2),
    ("Workshop", 20.8, 13.4, -math.pi / 2),
    ("PlayerStart", 19.0, 5.5, math.pi),
)

FACTORY = ArenaSpec(
    name="DM-Factory",
    aliases=("factory",),
    about=(
        "A factory under a roof: hall, loading bay, corridor and four rooms, with doors, a window to fly "
        "through, a pane, a mirror and a fence. 9 loose objects, 3 doors."
    ),
    floor=FLOOR,
    shapes=finished((*BUILDING, *EFFECTS, *FURNITURE), BARE),
    starts=tuple(StartPose(tag=tag, at=(x, y, START_ELEVATION), yaw=yaw) for tag, x, y, yaw in STARTS),
    extent=((-OUTER, LENGTH + OUTER), (-OUTER, WIDTH + OUTER)),
    loose=LOOSE,
    doors=(_door("Hall", 7.0, 9.0), _door("Office", 2.5, 11.0), _door("Control", 13.0, 11.0)),
    victims=VICTIMS,
    false_alarms=(
        FalseAlarm(part="RightArm", at=(14.4, 0.6, 0.86), rotation=(0.0, math.pi / 2, 0.0)),
        FalseAlarm(part="Head", at=(15.8, 15.2, 0.92)),
    ),
    tags=tuple(
        Tag(at=at, memory=memory)
        for at, memory in (
            ((3.8, 11.08, 0.4), "Office"),
            ((9.95, 11.08, 0.4), "Store"),
            ((14.2, 11.08, 0.4), "Control"),
            ((21.8, 11.08, 0.4), "Workshop"),
            ((0.03, 6.0, 0.4), "Hall"),
            ((23.97, 3.6, 0.4), "Gate"),
            ((20.0, 0.03, 0.9), "Dock"),
        )
    ),
    lights=tuple(
        Light(at=(x, y, 2.7), brightness=brightness)
        for x, y, brightness in (
            (3.0, 4.5, 4.0),
            (9.9, 6.0, 4.0),
            (14.0, 3.0, 4.0),
            (20.0, 3.0, 5.0),
            (4.0, 10.0, 2.0),
            (12.0, 10.0, 2.0),
            (3.0, 13.5, 3.0),
            (15.0, 13.5, 3.0),
            (21.0, 13.5, 1.0),  # the store has none
        )
    ),
    robots=("P2AT", "P2DX", "Talon", "TeleMax", "UnitLoader", "AirRobot"),
)
