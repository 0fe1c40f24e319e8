"""DM-Factory: a hall with a loading bay, a corridor and four rooms under one roof.

A captured greeting names a level DM-Factory_250; nothing of its plan is known, so this one is ours. Of it
(x from the west wall, y from the south wall):

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
gaps are open passages. P2ATs get into every room. The floor lies as deep as that of the yellow arena, so that
the height which test programs use there (1.8, z down) is just above it here too.
"""

import math

from usarmjx.models.arenas.elements import WOOD
from usarmjx.models.arenas.factory_plan import (
    BUILDING,
    DOCK,
    EFFECTS,
    FURNITURE,
    LENGTH,
    OUTER,
    WIDTH,
)
from usarmjx.models.arenas.finishes import BARE, finished
from usarmjx.models.arenas.pieces import brick, drum, loose_box, waving
from usarmjx.models.build.victims import rest_height
from usarmjx.models.spec.arena import (
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

FLOOR = -2.08


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
