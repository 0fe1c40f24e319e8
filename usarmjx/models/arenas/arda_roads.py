"""The roads of DM-ARDA: a route network and two missions, which ship as ARDA_RNDF.txt and ARDA_MDF1, 2.txt.

The manual names these files and does not show them (3.2.1.2): the plan is ours. A loop road of 120 m by 90 m
with curves of 15 m radius surrounds four blocks, between which Main Street and Cross Street meet; one block
is a car park. All have two lanes, driven on the right. The middle of town lies where the Urban Challenge
took place, at Victorville's former George Air Force Base; places are metres north and east of it.
"""

import math
from collections.abc import Iterator

from usarmjx.models.roads.geodesy import LatLon, to_lat_lon
from usarmjx.models.roads.network import (
    FOOT,
    Lane,
    Mission,
    PointId,
    RoadSegment,
    RouteNetwork,
    SpeedLimit,
    Spot,
    Zone,
)

Point = tuple[float, float]
"""North and east of the middle of town [m]."""

ORIGIN: LatLon = (34.587, -117.367)
"""Latitude and longitude of the middle of town [degrees], on the air base."""
DECIMALS = 8
"""Of degrees in the files: 1 mm."""

WIDTH = 12.0
"""Of lanes [feet]."""
LANE_OFFSET = WIDTH * FOOT / 2
"""From the middle of a road to the middle of a lane [m]."""
NORTH, EAST, RADIUS = 60.0, 45.0, 15.0
"""Half lengths of the loop, and the radius of its curves, all of the middle of the road [m]."""
ARC = 5
"""Waypoints on a curve, one every 22.5 degrees."""
SETBACK = 8.0
"""From the middle of a junction to where lanes end and begin [m]."""
JUNCTIONS: tuple[Point, ...] = ((0.0, 0.0), (NORTH, 0.0), (-NORTH, 0.0), (0.0, EAST), (0.0, -EAST))
JUNCTION_RADIUS = 1.2 * SETBACK

DRIVEWAY_IN, DRIVEWAY_OUT = 31.0, 15.0
"""Where the westbound lane of Cross Street leads into the car park and out of it, east [m]."""
PERIMETER: tuple[Point, ...] = (
    (8.0, 10.0),
    (8.0, 21.0),
    (8.0, 25.0),
    (8.0, 37.0),
    (52.0, 37.0),
    (52.0, 10.0),
)
"""Of the car park; the second point leads out, the third in."""
SPOT_WIDTH, SPOTS = 9.0, 4
"""Of parking spots [feet], and how many there are."""
SPOT_MOUTH, SPOT_MIDDLE, FIRST_SPOT = 30.0, 32.75, 20.0
"""Where spots begin and where one parks, east, and where the first one is, north [m]."""


def _loop(side: float) -> list[Point]:
    """Return a lane of the loop, clockwise seen from above from behind the northern junction.

    Args:
        side: Where it is from the middle of the road, outwards [m].
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
    """Iterate over waypoints, and headings, where lanes come to a junction, or where they go on from it."""
    for owner, way in WAYS.items():
        for i, (north, east) in enumerate(way):
            heading, there = _heading(way, i), (junction[0] - north, junction[1] - east)
            if math.hypot(*there) < JUNCTION_RADIUS and (_dot(there, heading) > 0) == coming:
                yield (*owner, i + 1), heading


def _exits() -> dict[PointId, list[PointId]]:
    """Return where every exit leads: to all that goes on from its junction, but not back."""
    exits: dict[PointId, list[PointId]] = {}
    for junction in JUNCTIONS:
        for point, heading in _at_junction(junction, coming=True):
            onwards = _at_junction(junction, coming=False)
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
    north = FIRST_SPOT + (number - 1) * SPOT_WIDTH * FOOT
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
"""Round the loop; and through all streets, to end in the second parking spot."""
