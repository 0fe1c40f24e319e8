"""DM-ARDA: streets of a small town for cars, as in the DARPA Urban Challenge (manual 3.2.1.2).

The route network and its missions are also packaged as files (`FILES`). Flat ground and open sky; houses hide
some of the satellites. Four traffic cones are loose, all else is fixed.
"""

import math
from collections.abc import Iterator
from pathlib import Path

from usarmjx.models.roads.network import (
    METRES_PER_FOOT,
    Lane,
    LatLon,
    Mission,
    PointId,
    RoadSegment,
    RouteNetwork,
    SpeedLimit,
    Spot,
    Zone,
    to_lat_lon,
)
from usarmjx.models.roads.shapes import CONCRETE, PAINT_THICKNESS, WHITE, road_shapes
from usarmjx.models.types.arena import START_ELEVATION, ArenaSpec, LooseObject, StartPose
from usarmjx.models.types.shapes import Rgba, Shape

Point = tuple[float, float]
"""Position north and east of the middle of town [m]."""

ORIGIN: LatLon = (34.587, -117.367)
"""Latitude and longitude of the middle of town [degrees], on the air base."""
DECIMALS = 8
"""Decimals of degrees in the files: 1 mm."""

WIDTH = 12.0
"""Width of lanes [feet]."""
LANE_OFFSET = WIDTH * METRES_PER_FOOT / 2
"""Distance from the middle of a road to the middle of a lane [m]."""
NORTH, EAST, RADIUS = 60.0, 45.0, 15.0
"""Half lengths of the loop, and the radius of its curves, all of the middle of the road [m]."""
ARC = 5
"""Waypoints on a curve, one per 22.5 degrees."""
SETBACK = 8.0
"""Distance from the middle of a junction to the ends of lanes [m]."""
JUNCTIONS: tuple[Point, ...] = ((0.0, 0.0), (NORTH, 0.0), (-NORTH, 0.0), (0.0, EAST), (0.0, -EAST))
"""Middles of the junctions."""
JUNCTION_RADIUS = 1.2 * SETBACK
"""Radius around a junction that contains the ends of its lanes [m]."""

DRIVEWAY_IN, DRIVEWAY_OUT = 31.0, 15.0
"""Entrance and exit of the car park on the westbound lane of Cross Street, east [m]."""
PERIMETER: tuple[Point, ...] = (
    (8.0, 10.0),
    (8.0, 21.0),
    (8.0, 25.0),
    (8.0, 37.0),
    (52.0, 37.0),
    (52.0, 10.0),
)
"""Perimeter of the car park; the second point is an exit, the third an entry."""
SPOT_WIDTH, SPOTS = 9.0, 4
"""Width of parking spots [feet], and their number."""
SPOT_MOUTH, SPOT_MIDDLE, FIRST_SPOT = 30.0, 32.75, 20.0
"""Mouth and parking position of spots, east, and position of the first one, north [m]."""


def _loop(side: float) -> list[Point]:
    """Return a lane of the loop, clockwise seen from above from behind the northern junction.

    Args:
        side: Offset from the middle of the road, outwards [m].
    """
    north, east = NORTH - RADIUS, EAST - RADIUS
    radius = RADIUS + side

    def arc(centre: Point, first: int) -> list[Point]:
        angles = [math.radians(first + 90 * i / (ARC - 1)) for i in range(ARC)]
        return [(centre[0] + radius * math.cos(a), centre[1] + radius * math.sin(a)) for a in angles]

    edge_north, edge_east = NORTH + side, EAST + side
    return [
        (edge_north, SETBACK), *arc((north, east), 0),
        (SETBACK, edge_east), (-SETBACK, edge_east), *arc((-north, east), 90),
        (-edge_north, SETBACK), (-edge_north, -SETBACK), *arc((-north, -east), 180),
        (-SETBACK, -edge_east), (SETBACK, -edge_east), *arc((north, -east), 270),
        (edge_north, -SETBACK),
    ]  # fmt: skip


_MAIN, _CROSS = NORTH - SETBACK, EAST - SETBACK
WAYS: dict[tuple[int, int], list[Point]] = {
    (1, 1): _loop(-LANE_OFFSET),
    (1, 2): _loop(LANE_OFFSET)[::-1],
    (2, 1): [(north, -LANE_OFFSET) for north in (_MAIN, SETBACK, -SETBACK, -_MAIN)],
    (2, 2): [(north, LANE_OFFSET) for north in (-_MAIN, -SETBACK, SETBACK, _MAIN)],
    (3, 1): [(-LANE_OFFSET, east) for east in (-_CROSS, -SETBACK, SETBACK, _CROSS)],
    (3, 2): [(LANE_OFFSET, east) for east in (_CROSS, DRIVEWAY_IN, DRIVEWAY_OUT, SETBACK, -SETBACK, -_CROSS)],
}
"""Waypoints of the lanes."""
NAMES = {1: "Loop_Road", 2: "Main_Street", 3: "Cross_Street"}
PARKING = 1 + len(NAMES)
"""Number of the car park's zone."""
CHECKPOINTS: dict[PointId, int] = {
    (1, 1, 4): 1,
    (1, 1, 18): 2,
    (1, 2, 11): 3,
    (1, 2, 25): 4,
    (2, 1, 1): 5,
    (2, 2, 3): 6,
    (3, 1, 3): 7,
    (3, 2, 5): 8,
    **{(PARKING, i, 2): 8 + i for i in range(1, SPOTS + 1)},
}


def _degrees(at: Point) -> LatLon:
    north, east = to_lat_lon(ORIGIN, (at[0], -at[1]))
    return round(north, DECIMALS), round(east, DECIMALS)


def _heading(way: list[Point], i: int) -> Point:
    (n0, e0), (n1, e1) = way[i : i + 2] if i + 1 < len(way) else way[i - 1 : i + 1]
    length = math.dist((n0, e0), (n1, e1))
    return (n1 - n0) / length, (e1 - e0) / length


def _dot(a: Point, b: Point) -> float:
    return a[0] * b[0] + a[1] * b[1]


def _at_junction(junction: Point, coming: bool) -> Iterator[tuple[PointId, Point]]:
    """Iterate over waypoints, with headings, at which lanes enter a junction, or leave it."""
    for owner, way in WAYS.items():
        for i, (north, east) in enumerate(way):
            heading, there = _heading(way, i), (junction[0] - north, junction[1] - east)
            if math.hypot(*there) < JUNCTION_RADIUS and (_dot(there, heading) > 0) == coming:
                yield (*owner, i + 1), heading


def _exits() -> dict[PointId, list[PointId]]:
    """Return the entries of every exit: all lanes that leave its junction, except back."""
    exits: dict[PointId, list[PointId]] = {}
    for junction in JUNCTIONS:
        for point, heading in _at_junction(junction, coming=True):
            onwards = _at_junction(junction, coming=False)
            # No turning round: entries against the own heading are left out.
            exits[point] = [entry for entry, along in onwards if _dot(heading, along) > -0.5]
    exits[3, 2, 2] = [(PARKING, 0, 3), (3, 2, 3)]
    return exits


EXITS = _exits()


def _lane(owner: tuple[int, int]) -> Lane:
    way = WAYS[owner]
    ids: list[PointId] = [(*owner, i) for i in range(1, len(way) + 1)]
    at_junctions = [point for point in ids if point in EXITS and point != (3, 2, 2)]
    return Lane(
        waypoints=tuple(map(_degrees, way)),
        width=WIDTH,
        left="double_yellow",
        right="solid_white" if owner[0] == 1 else "",  # the streets have kerbs
        checkpoints=tuple((point[2], CHECKPOINTS[point]) for point in ids if point in CHECKPOINTS),
        stops=tuple(point[2] for point in at_junctions) if owner[0] != 1 else (),
        exits=tuple((point[2], entry) for point in ids for entry in EXITS.get(point, ())),
    )


def _spot(number: int) -> Spot:
    north = FIRST_SPOT + (number - 1) * SPOT_WIDTH * METRES_PER_FOOT
    return Spot(
        waypoints=(_degrees((north, SPOT_MOUTH)), _degrees((north, SPOT_MIDDLE))),
        width=SPOT_WIDTH,
        checkpoints=((2, CHECKPOINTS[PARKING, number, 2]),),
    )


NETWORK = RouteNetwork(
    name="ARDA_RNDF.txt",
    format_version="1.0",
    creation_date="01-Mar-07",
    segments=tuple(
        RoadSegment(name=name, lanes=(_lane((number, 1)), _lane((number, 2))))
        for number, name in NAMES.items()
    ),
    zones=(
        Zone(
            name="Car_Park",
            perimeter=tuple(map(_degrees, PERIMETER)),
            exits=((2, (3, 2, 3)),),
            spots=tuple(map(_spot, range(1, SPOTS + 1))),
        ),
    ),
)


def _mission(number: int, *checkpoints: int) -> Mission:
    speeds = {1: 20.0, 2: 15.0, 3: 15.0, PARKING: 5.0}
    return Mission(
        name=f"ARDA_MDF{number}.txt",
        rndf=NETWORK.name,
        format_version=NETWORK.format_version,
        creation_date=NETWORK.creation_date,
        checkpoints=checkpoints,
        speed_limits=tuple(SpeedLimit(id=i, low=0.0, high=high) for i, high in speeds.items()),
    )


MISSIONS = (_mission(1, 1, 2, 1), _mission(2, 5, 7, 3, 6, 8, 4, 10))
"""Around the loop; and through all streets, to end in the second parking spot."""


FILES = tuple(Path(__file__).with_name(name) for name in (NETWORK.name, *(m.name for m in MISSIONS)))
"""Files of the route network and the missions, for controllers."""

ASPHALT, GRASS = (0.28, 0.28, 0.3, 1.0), (0.35, 0.5, 0.25, 1.0)
BRICK, PLASTER = (0.6, 0.35, 0.3, 1.0), (0.85, 0.8, 0.65, 1.0)
ORANGE = (0.95, 0.4, 0.1, 1.0)


def _box(at: Point, size: tuple[float, float, float], surface: str, rgba: Rgba, yaw: float = 0.0) -> Shape:
    """Return a box of full lengths north, east and up on the floor; `yaw` turns it clockwise."""
    half = (size[0] / 2, size[1] / 2, size[2] / 2)
    middle = (at[0], -at[1], half[2])
    return Shape(kind="box", size=half, at=middle, rotation=(0.0, 0.0, -yaw), surface=surface, rgba=rgba)


# Asphalt lies lower than paint, grass on it: all of them are visible, without contacts.
GROUND_SHAPES = (
    _box((0.0, 0.0), (2 * NORTH + 12, 2 * EAST + 12, PAINT_THICKNESS / 2), "fixture", ASPHALT),
    *(_box((north, east), (45.0, 30.0, PAINT_THICKNESS), "fixture", GRASS)
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
        _box((FIRST_SPOT + i * SPOT_WIDTH * METRES_PER_FOOT, 35.0), (1.8, 0.15, 0.10), "ground", CONCRETE)
        for i in range(SPOTS)
    ),
    _box((30.0, 16.0), (0.6, 3.05, 0.81), "wall", CONCRETE),
    _box((38.0, 24.0), (0.6, 3.05, 0.81), "wall", CONCRETE),
    _box((46.0, 16.0), (0.6, 3.05, 0.81), "wall", CONCRETE, math.radians(30)),
)
CONE_MASS = 3.2
"""Mass of a cone of 28 inches [kg] (MUTCD 6F.64 asks for 28 inches; 7 lb is usual)."""
CONES: tuple[Point, ...] = ((16.0, 16.0), (22.0, 20.0), (34.0, 20.0), (42.0, 20.0))


def _cone(number: int, at: Point) -> LooseObject:
    """Return a traffic cone of boxes, which have contacts with wheels on every engine."""
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
    # Tag, position, and heading [degrees] clockwise from north: on the right of all roads, then in the spots.
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
    *(
        (f"Spot{i + 1}", (FIRST_SPOT + i * SPOT_WIDTH * METRES_PER_FOOT, SPOT_MIDDLE), 90.0)
        for i in range(SPOTS)
    ),
    ("PlayerStart", (20.0, -LANE_OFFSET), _SOUTH),
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
