"""DM-Outdoor: hills under an open sky, trees, and a building that has collapsed on people.

By the manual, outdoor areas and collapsed buildings exist (3.2.1.1), and an outdoor world has the sky all
around it, without which GPS does not work (10.5.2); the plan is ours. The terrain is a height field of 1 m
cells over 40 x 40 m in a bowl whose rim is too steep to drive out of. Its flat parts lie `BASE` above the
arena's floor and 2.08 m below the wire's origin, as the floor of the yellow arena does.

Heights are polynomials, rounded to millimetres: the same on every machine. Engine `jax` has no contacts of
cylinders with height fields; this arena is for `c`. Loose boxes on a height field rock and creep by
centimetres, as MuJoCo finds one contact for each of its cells; here they lie on the building's foundation.

DM-Field is a large, flat, open ground for cars and flyers, with some walls at its edge. Its plan is ours,
too.
"""

import math

import numpy as np

from usarmjx.models.arenas.pieces import (
    BARE,
    CONCRETE,
    WOOD,
    block,
    brick,
    finished,
    loose_box,
    slope,
    span,
    waving,
)
from usarmjx.models.compile.victims import rest_height
from usarmjx.models.types.arena import (
    START_ELEVATION,
    ArenaSpec,
    FalseAlarm,
    HelpSound,
    StartPose,
    Tag,
    Victim,
)
from usarmjx.models.types.shapes import SKY, HeightField, Rgba, Shape

BASE = 0.5
"""Height of the flat parts above the arena's floor [m]."""
FLOOR = -2.08 - BASE
"""Height of the floor in the world [m]."""
FOUNDATION_TOP = BASE + 0.04
"""Height of the building's foundation above the arena's floor [m]: a step for wheels."""
HALF, CELLS = 20.0, 40
"""Half the side of the terrain [m] and its number of cells along a side."""
RIM, STEEPNESS = 17.0, 0.25
"""Distance at which the rim begins to rise [m], and its rise over the squared distance from there [1/m]."""
HILLS = (
    (-10.0, 9.0, 8.0, 1.6),
    (9.0, -10.0, 8.0, 1.4),
    (-9.0, -10.0, 6.0, 0.9),
    (0.0, -6.0, 3.5, -0.3),
    (-1.0, 14.0, 5.0, 0.6),
)
"""x and y of the middle, radius, and height of each hill or hollow [m]."""
SKY_HEIGHT = 12.0

EARTH: Rgba = (0.42, 0.5, 0.28, 1.0)
BARK: Rgba = (0.4, 0.3, 0.2, 1.0)
LEAVES: Rgba = (0.2, 0.42, 0.18, 1.0)
ROCK: Rgba = (0.5, 0.5, 0.47, 1.0)
AIR: Rgba = (0.6, 0.75, 0.95, 0.06)


def ground(x: float, y: float) -> float:
    """Return the height of the terrain above the arena's floor [m], exact on the grid of 1 m.

    A hill falls off as (1 - r^2 / R^2)^2: level on top and at its foot, its slope at most 1.54 height / R.
    """
    height = BASE
    for hill_x, hill_y, radius, rise in HILLS:
        inside = 1.0 - ((x - hill_x) ** 2 + (y - hill_y) ** 2) / radius**2
        height += rise * max(0.0, inside) ** 2
    for coordinate in (x, y):
        height += STEEPNESS * max(0.0, abs(coordinate) - RIM) ** 2
    return round(height, 3)


def _terrain() -> Shape:
    lines = [i * 2 * HALF / CELLS - HALF for i in range(CELLS + 1)]
    heights = np.array([[ground(x, y) for x in lines] for y in lines])
    return Shape(
        kind="hfield",
        size=(HALF, HALF, 0.5),
        heights=HeightField(heights=heights),
        surface="ground",
        rgba=EARTH,
    )


def _sky() -> tuple[Shape, ...]:
    """Return the sky's four sides and its top, without contacts."""
    far, thick, top = HALF + 0.5, 0.1, SKY_HEIGHT
    sides = [
        ((-far, -far, 0.0), (-far + thick, far, top)),
        ((far - thick, -far, 0.0), (far, far, top)),
        ((-far, -far, 0.0), (far, -far + thick, top)),
        ((-far, far - thick, 0.0), (far, far, top)),
        ((-far, -far, top), (far, far, top + thick)),
    ]
    return tuple(span(low, high, AIR, surface="fixture", material=SKY) for low, high in sides)


def _tree(x: float, y: float, height: float) -> tuple[Shape, ...]:
    """Return a trunk, rooted in the floor, and a crown."""
    top = ground(x, y) + height
    crown = 0.45 * height
    return (
        block((x, y), (0.25, 0.25, top - crown), surface="wall", rgba=BARK),
        block((x, y), (crown, crown, crown), z=top - crown, yaw=x, surface="wall", rgba=LEAVES),
    )


def _chunk(x: float, y: float, size: float, turn: float) -> Shape:
    """Return a piece of broken concrete, or a rock, that lies askew and partly in the ground."""
    return Shape(
        kind="box",
        size=(size / 2, size / 3, size / 4),
        at=(x, y, ground(x, y) + size / 8),
        rotation=(0.4 * math.sin(3 * turn), 0.4 * math.cos(5 * turn), turn),
        surface="ground",
        rgba=CONCRETE if x > 0 else ROCK,
    )


def _beam(foot: tuple[float, float, float], head: tuple[float, float, float]) -> Shape:
    """Return a beam of 20 cm between two points, given as heights above the foundation."""
    low, high = ((x, y, FOUNDATION_TOP + z) for x, y, z in (foot, head))
    return slope(low, high, 0.2, thickness=0.2, rgba=WOOD)


TREES = (
    *((-16.0, 12.0, 4.0), (-13.0, 13.0, 5.0), (-6.0, 11.0, 3.5), (-4.0, 7.0, 4.5), (-15.0, -6.0, 5.0)),
    *((-12.0, -13.0, 4.0), (-6.0, -12.0, 3.5), (4.0, -12.0, 4.5), (13.0, -13.0, 5.0), (15.0, -4.0, 4.0)),
)
ROCKS = ((-8.0, 5.0, 0.6, 1.0), (-12.0, -8.0, 0.7, 2.2), (-3.0, -10.0, 0.5, 0.4), (-14.0, 7.0, 0.8, 2.9))
RUBBLE = (
    *((5.6, 8.2, 0.5, 0.3), (6.6, 9.4, 0.7, 1.1), (7.4, 8.3, 0.4, 2.0), (9.2, 4.2, 0.6, 2.7)),
    *((10.2, 5.1, 0.4, 0.8), (12.9, 7.1, 0.5, 1.7), (8.3, 10.2, 0.6, 2.4), (13.3, 4.6, 0.6, 0.1)),
)
STOREY = 2.4

# x from 4 to 14, y from 3 to 11.
BUILDING = (
    span((2.6, 1.2, 0.0), (14.3, 11.3, FOUNDATION_TOP), surface="ground"),
    # Standing remains: a corner, the stumps of two walls, two columns.
    span((8.0, 10.8, 0.0), (14.0, 11.0, FOUNDATION_TOP + STOREY)),
    span((13.8, 6.5, 0.0), (14.0, 10.8, FOUNDATION_TOP + STOREY)),
    span((4.0, 3.0, 0.0), (4.2, 6.0, FOUNDATION_TOP + 1.0)),
    span((4.2, 3.0, 0.0), (7.0, 3.2, FOUNDATION_TOP + 0.6)),
    block((8.0, 7.0), (0.3, 0.3, FOUNDATION_TOP + STOREY), surface="wall"),
    block((11.0, 7.0), (0.3, 0.3, FOUNDATION_TOP + 1.3), surface="wall"),
    # A floor that leans on the wall behind it, with room below.
    slope((11.0, 8.2, FOUNDATION_TOP), (11.0, 10.7, FOUNDATION_TOP + 1.8), 4.0, thickness=0.2, rgba=CONCRETE),
    # A floor with one edge on the ground, to drive up, and one on a block.
    slope((4.9, 5.0, FOUNDATION_TOP), (7.6, 5.0, FOUNDATION_TOP + 0.9), 2.4, thickness=0.2, rgba=CONCRETE),
    block((7.5, 5.0), (0.4, 2.0, FOUNDATION_TOP + 0.6), surface="ground", rgba=CONCRETE),
    # Two floors that collapsed flat on each other, half a metre apart.
    *(
        block((x, 4.4), (0.3, 2.2, FOUNDATION_TOP + 0.5), surface="ground", rgba=CONCRETE)
        for x in (10.9, 13.1)
    ),
    block((12.0, 4.4), (2.8, 2.4, 0.2), z=FOUNDATION_TOP + 0.5, surface="ground", rgba=CONCRETE),
    slope(
        (10.9, 4.4, FOUNDATION_TOP + 0.7),
        (13.3, 4.4, FOUNDATION_TOP + 1.2),
        2.2,
        thickness=0.16,
        rgba=CONCRETE,
    ),
    _beam((6.2, 7.3, 0.0), (8.6, 9.9, 1.0)),
    _beam((9.0, 6.2, 0.0), (10.9, 6.9, 1.3)),
    _beam((12.6, 6.4, 0.2), (13.6, 8.9, 1.7)),
    *(_chunk(*chunk) for chunk in RUBBLE),
)

VICTIMS = (
    Victim(
        name="Leaning",
        at=(11.6, 10.3, FOUNDATION_TOP + rest_height("lying")),
        help_sound=HelpSound(loudness=0.6),
        state="lies in the void below the leaning floor and calls",
    ),
    Victim(
        name="Pancake",
        at=(12.2, 4.3, FOUNDATION_TOP + rest_height("lying")),
        rotation=(0.0, 0.0, math.pi / 2),
        state="lies between two floors, still",
    ),
    Victim(
        name="Wall",
        at=(3.8, 4.6, FOUNDATION_TOP + rest_height("sitting")),
        rotation=(0.0, 0.0, math.pi),
        posture="sitting",
        segments=waving("LeftArm", 1.5),
        help_sound=HelpSound(),
        state="sits outside at the wall and waves",
    ),
    Victim(
        name="Walker",
        at=(-14.6, -5.2, BASE + rest_height("crouched")),
        rotation=(0.0, 0.0, -0.6),
        posture="crouched",
        state="crouches beside a tree",
    ),
)

LOOSE = (
    brick("Brick1", (3.4, 7.0), z=FOUNDATION_TOP, yaw=0.4),
    brick("Brick2", (3.6, 7.6), z=FOUNDATION_TOP, yaw=-0.7),
    brick("Brick3", (9.6, 2.4), z=FOUNDATION_TOP, yaw=1.2),
    loose_box("Cinder1", (4.6, 7.0), (0.39, 0.19, 0.19), 13.0, z=FOUNDATION_TOP, yaw=0.2, rgba=CONCRETE),
    loose_box("Cinder2", (10.4, 2.2), (0.39, 0.19, 0.19), 13.0, z=FOUNDATION_TOP, yaw=1.0, rgba=CONCRETE),
    loose_box("Plank", (6.0, 1.8), (1.8, 0.2, 0.04), 6.0, z=FOUNDATION_TOP, yaw=0.3, rgba=WOOD),
)

STARTS = (
    ("Camp1", -14.0, 0.0, 0.0),
    ("Camp2", -14.0, -3.2, 0.0),
    ("Camp3", -8.0, -1.6, 0.0),
    ("Field1", 0.0, 0.0, 0.0),
    ("Field2", 0.0, 4.0, math.pi),
    ("Site1", -0.5, 7.0, 0.0),
    ("Site2", 15.6, 0.0, math.pi / 2),
    ("Site3", 9.0, -0.6, math.pi),
    ("PlayerStart", -11.0, -1.6, 0.0),
)

OUTDOOR = ArenaSpec(
    name="DM-Outdoor",
    aliases=("outdoor",),
    about=(
        "Hills of up to 17 degrees under an open sky, with trees and a collapsed building with people in its "
        "voids. A height field: robots drive on it on engine c. 6 loose objects."
    ),
    floor=FLOOR,
    shapes=finished(
        (
            _terrain(),
            *_sky(),
            *(shape for tree in TREES for shape in _tree(*tree)),
            *(_chunk(*rock) for rock in ROCKS),
            *BUILDING,
        ),
        {**BARE, ROCK: "concrete", BARK: "wood"},
    ),
    starts=tuple(
        StartPose(tag=tag, at=(x, y, ground(x, y) + START_ELEVATION), yaw=yaw) for tag, x, y, yaw in STARTS
    ),
    extent=((-HALF, HALF), (-HALF, HALF)),
    loose=LOOSE,
    victims=VICTIMS,
    false_alarms=(
        FalseAlarm(part="LeftLeg", at=(6.2, 8.9, FOUNDATION_TOP + 0.08), rotation=(0.0, math.pi / 2, 0.4)),
        FalseAlarm(part="RightHand", at=(9.9, 4.4, FOUNDATION_TOP + 0.05), rotation=(0.0, math.pi / 2, 0.0)),
    ),
    tags=tuple(
        Tag(at=(x, y, FOUNDATION_TOP + z), memory=memory)
        for x, y, z, memory in (
            (4.1, 2.98, 0.5, "South-west corner"),
            (13.98, 11.02, 1.0, "North-east corner"),
            (8.0, 6.83, 1.0, "Column"),
            (-14.84, -6.0, 1.0, "Tree"),
        )
    ),
    gps=(39.133788, -77.216633),  # where the GPS sensor's own reference lies (GPSSensor.uc)
    robots=("P2AT", "ATRVJr", "Talon", "kenaf", "Hummer", "AirRobot"),
)


FIELD_HALF = 200.0
"""Half the field's side [m]; the ground extends beyond it."""
WALL = (10.0, 0.1, 1.5)
"""Half lengths of a wall [m]."""
SPACING = 10.0
"""Distance between two starts [m]."""
BRICK = (0.6, 0.35, 0.3, 1.0)


def _wall(x: float, y: float, along_y: bool) -> Shape:
    length, thickness, height = WALL
    size = (thickness, length, height) if along_y else (length, thickness, height)
    return Shape(kind="box", size=size, at=(x, y, height), surface="wall", rgba=BRICK)


FIELD = ArenaSpec(
    name="DM-Field",
    aliases=("field",),
    about="A flat ground of 400 x 400 m with walls in the middle of each side, for cars and flyers.",
    shapes=(
        _wall(FIELD_HALF, 0.0, along_y=True),
        _wall(-FIELD_HALF, 0.0, along_y=True),
        _wall(0.0, FIELD_HALF, along_y=False),
        _wall(0.0, -FIELD_HALF, along_y=False),
    ),
    starts=(
        *(
            StartPose(
                tag=f"Start{1 + 5 * row + column}",
                at=((row - 2) * SPACING, (2 - column) * SPACING, START_ELEVATION),
            )
            for row in range(5)
            for column in range(5)
        ),
        StartPose(tag="PlayerStart", at=(-3 * SPACING, 0.0, START_ELEVATION)),
    ),
    extent=((-FIELD_HALF, FIELD_HALF), (-FIELD_HALF, FIELD_HALF)),
    robots=("Hummer", "SnowStorm", "Sedan", "Cooper", "AirRobot", "Passarola"),
)
