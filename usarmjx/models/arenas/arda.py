"""DM-ARDA: streets of a small town for cars, as the DARPA Urban Challenge had (manual 3.2.1.2).

The roads are those of `arda_roads`, whose files ship beside this one. Flat ground and open sky; houses hide
some of the satellites. Four traffic cones lie loose, all else is fixed.
"""

import math
from pathlib import Path

from usarmjx.models.arenas.arda_roads import (
    EAST,
    FIRST_SPOT,
    LANE_OFFSET,
    MISSIONS,
    NETWORK,
    NORTH,
    ORIGIN,
    SPOT_MIDDLE,
    SPOT_WIDTH,
    SPOTS,
    Point,
)
from usarmjx.models.roads.network import FOOT
from usarmjx.models.roads.shapes import CONCRETE, PAINT, WHITE, road_shapes
from usarmjx.models.spec.arena import START_ELEVATION, ArenaSpec, LooseObject, StartPose
from usarmjx.models.spec.shapes import Rgba, Shape

FILES = tuple(Path(__file__).with_name(name) for name in (NETWORK.name, *(m.name for m in MISSIONS)))
"""The route network and the missions as files, for controllers."""

ASPHALT, GRASS = (0.28, 0.28, 0.3, 1.0), (0.35, 0.5, 0.25, 1.0)
BRICK, PLASTER = (0.6, 0.35, 0.3, 1.0), (0.85, 0.8, 0.65, 1.0)
ORANGE = (0.95, 0.4, 0.1, 1.0)


def _box(at: Point, size: tuple[float, float, float], surface: str, rgba: Rgba, yaw: float = 0.0) -> Shape:
    """Return a box of full lengths north, east and up on the floor; `yaw` turns it clockwise."""
    half = (size[0] / 2, size[1] / 2, size[2] / 2)
    place = (at[0], -at[1], half[2])
    return Shape(kind="box", size=half, at=place, rotation=(0.0, 0.0, -yaw), surface=surface, rgba=rgba)


# Asphalt lies lower than paint, grass on it: all of them are seen and not felt.
GROUND_SHAPES = (
    _box((0.0, 0.0), (2 * NORTH + 12, 2 * EAST + 12, PAINT / 2), "fixture", ASPHALT),
    *(_box((north, east), (45.0, 30.0, PAINT), "fixture", GRASS)
      for north, east in ((30.5, -23.0), (-30.5, -23.0), (-30.5, 23.0))),
)  # fmt: skip
HOUSES = (
    _box((20.0, -20.0), (14.0, 12.0, 6.0), "wall", BRICK),
    _box((40.0, -26.0), (12.0, 18.0, 9.0), "wall", PLASTER),
    _box((-22.0, -24.0), (12.0, 16.0, 7.0), "wall", PLASTER),
    _box((-42.0, -20.0), (16.0, 12.0, 5.0), "wall", BRICK),
    _box((-24.0, 22.0), (18.0, 14.0, 8.0), "wall", BRICK),
    _box((-44.0, 26.0), (10.0, 16.0, 6.0), "wall", PLASTER),
)
# Wheel stops at the ends of the spots, and barriers of the New Jersey kind's size to drive around.
OBSTACLES = (
    *(
        _box((FIRST_SPOT + i * SPOT_WIDTH * FOOT, 35.0), (1.8, 0.15, 0.10), "ground", CONCRETE)
        for i in range(SPOTS)
    ),
    _box((30.0, 16.0), (0.6, 3.05, 0.81), "wall", CONCRETE),
    _box((38.0, 24.0), (0.6, 3.05, 0.81), "wall", CONCRETE),
    _box((46.0, 16.0), (0.6, 3.05, 0.81), "wall", CONCRETE, math.radians(30)),
)
CONE_MASS = 3.2
"""Of a cone of 28 inches [kg] (MUTCD 6F.64 asks for 28 inches; 7 lb is usual)."""
CONES: tuple[Point, ...] = ((16.0, 16.0), (22.0, 20.0), (34.0, 20.0), (42.0, 20.0))


def _cone(number: int, at: Point) -> LooseObject:
    """Return a traffic cone of boxes, which wheels may meet."""
    foot, body, band = 0.04, (0.10, 0.10, 0.32), 0.06
    return LooseObject(
        name=f"Cone{number}",
        at=(at[0], -at[1], 0.0),
        shapes=(
            Shape(
                kind="box",
                size=(0.18, 0.18, foot / 2),
                at=(0.0, 0.0, foot / 2),
                mass=0.7 * CONE_MASS,
                surface="loose",
                rgba=(0.1, 0.1, 0.1, 1.0),
            ),
            Shape(
                kind="box",
                size=body,
                at=(0.0, 0.0, foot + body[2]),
                mass=0.3 * CONE_MASS,
                surface="loose",
                rgba=ORANGE,
            ),
            Shape(
                kind="box",
                size=(body[0] + 0.002, body[1] + 0.002, band),
                at=(0.0, 0.0, foot + 1.3 * body[2]),
                surface="fixture",
                rgba=WHITE,
            ),
        ),
    )


_SOUTH, _WEST = 180.0, 270.0
STARTS: tuple[tuple[str, Point, float], ...] = (
    # Tag, place, and heading [degrees] clockwise from north: on the right of all roads, then in the spots.
    ("Loop1", (NORTH - LANE_OFFSET, 20.0), 90.0),
    ("Loop2", (30.0, EAST - LANE_OFFSET), _SOUTH),
    ("Loop3", (-30.0, EAST - LANE_OFFSET), _SOUTH),
    ("Loop4", (-NORTH + LANE_OFFSET, 20.0), _WEST),
    ("Loop5", (-NORTH + LANE_OFFSET, -20.0), _WEST),
    ("Loop6", (-30.0, -EAST + LANE_OFFSET), 0.0),
    ("Loop7", (30.0, -EAST + LANE_OFFSET), 0.0),
    ("Loop8", (NORTH - LANE_OFFSET, -20.0), 90.0),
    ("Outer1", (NORTH + LANE_OFFSET, 20.0), _WEST),
    ("Outer2", (30.0, -EAST - LANE_OFFSET), _SOUTH),
    ("Outer3", (-NORTH - LANE_OFFSET, -20.0), 90.0),
    ("Outer4", (-30.0, EAST + LANE_OFFSET), 0.0),
    ("Main1", (35.0, -LANE_OFFSET), _SOUTH),
    ("Main2", (-35.0, LANE_OFFSET), 0.0),
    ("Cross1", (-LANE_OFFSET, -25.0), 90.0),
    ("Cross2", (LANE_OFFSET, -25.0), _WEST),
    *((f"Spot{i + 1}", (FIRST_SPOT + i * SPOT_WIDTH * FOOT, SPOT_MIDDLE), 90.0) for i in range(SPOTS)),
)

ARDA = ArenaSpec(
    name="DM-ARDA",
    aliases=("arda", "road"),
    about="Streets, junctions, a loop road and a car park, with an RNDF and MDFs; 4 loose cones.",
    shapes=(*GROUND_SHAPES, *road_shapes(NETWORK, ORIGIN), *HOUSES, *OBSTACLES),
    loose=tuple(_cone(i, at) for i, at in enumerate(CONES, 1)),
    starts=tuple(
        StartPose(tag=tag, at=(at[0], -at[1], START_ELEVATION), yaw=-math.radians(heading))
        for tag, at, heading in STARTS
    ),
    extent=((-NORTH - 8, NORTH + 8), (-EAST - 8, EAST + 8)),
    gps=ORIGIN,
    robots=("SnowStorm", "Hummer", "Sedan", "Cooper"),
)
