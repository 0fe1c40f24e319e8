"""Route networks and missions of the DARPA Urban Challenge (manual 3.2.1.2), and their checks.

Segments have numbers from 1, zones the numbers after the last segment's; lanes, spots and waypoints have
numbers from 1 within their owner, and waypoints may begin with another number. Positions are latitude and
longitude in floating-point degrees, as before DARPA's revision of December 2006 (manual 10.13). Widths are
feet and speeds miles per hour, as in the files.
"""

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

METRES_PER_LATITUDE_DEGREE, METRES_PER_LONGITUDE_DEGREE = 111200.0, 71670.0
"""Metres per degree (GPSSensor.uc), at any latitude."""

LatLon = tuple[float, float]
"""Latitude and longitude [degrees], north and east positive."""


METRES_PER_DEGREE = (METRES_PER_LATITUDE_DEGREE, METRES_PER_LONGITUDE_DEGREE)
"""Metres per degree of latitude and of longitude."""

METRES_PER_FOOT = 0.3048
"""Length of a foot [m]."""

MAX_WIDTH_FEET = 1e3
"""Largest width of a lane or spot that is accepted [feet]."""

MAX_LISTED_NUMBERS = 100
"""Largest count of numbers in a message."""

MAX_SPEED_MPH = 1e3
"""Largest speed that is accepted [miles per hour]."""

BOUNDARIES = ("double_yellow", "solid_yellow", "solid_white", "broken_white")
"""Kinds of lane boundaries."""

PointId = tuple[int, int, int]
"""M.N.P: segment, lane and waypoint; zone, 0 and perimeter point; zone, spot and waypoint."""

Fault = tuple[tuple[object, ...], str]
"""Key of a faulty item (as `exit`, from, to), and the fault in words."""


def to_lat_lon(
    origin: LatLon, at: tuple[float, float], scales: tuple[float, float] = METRES_PER_DEGREE
) -> LatLon:
    """Return latitude and longitude [degrees] of a point x, y [m] of an arena with that origin.

    Args:
        origin: Latitude and longitude of the arena's origin.
        at: The point.
        scales: Metres per degree of latitude and of longitude; negative ones reverse the axis.
    """
    # x points north and y left of it, to the west.
    return origin[0] + at[0] / scales[0], origin[1] - at[1] / scales[1]


def to_local_xy(origin: LatLon, at: LatLon) -> tuple[float, float]:
    """Return x, y [m] of a latitude and longitude [degrees]; the inverse of `to_lat_lon`."""
    return (at[0] - origin[0]) * METRES_PER_LATITUDE_DEGREE, (origin[1] - at[1]) * METRES_PER_LONGITUDE_DEGREE


@dataclass(frozen=True, kw_only=True)
class Lane:
    """A lane, driven from its first waypoint to its last.

    Attributes:
        waypoints: Its waypoints.
        width: Width [feet]; None: not given.
        left: Left boundary, one of `BOUNDARIES`; empty: not given.
        right: Right boundary, likewise.
        checkpoints: Waypoint and checkpoint of each checkpoint.
        stops: Waypoints with a stop sign.
        exits: Waypoint of each exit, and the waypoint or perimeter point to which it leads.
        first: Number of the first waypoint: 1, but other numbers in some teams' files.
    """

    waypoints: tuple[LatLon, ...]
    width: float | None = None
    left: str = ""
    right: str = ""
    checkpoints: tuple[tuple[int, int], ...] = ()
    stops: tuple[int, ...] = ()
    exits: tuple[tuple[int, PointId], ...] = ()
    first: int = 1

    @property
    def last(self) -> int:
        """Number of the last waypoint."""
        return self.first + len(self.waypoints) - 1


@dataclass(frozen=True, kw_only=True)
class RoadSegment:
    """A road, with its lanes in both directions."""

    lanes: tuple[Lane, ...]
    name: str = ""


@dataclass(frozen=True, kw_only=True)
class Spot:
    """A parking spot: its mouth, and the parking position.

    Attributes:
        waypoints: The mouth, then the parking position.
        width: Width [feet]; None: not given.
        checkpoints: Waypoint and checkpoint of each checkpoint.
        first: Number of the mouth; see `Lane`.
    """

    waypoints: tuple[LatLon, ...]
    width: float | None = None
    checkpoints: tuple[tuple[int, int], ...] = ()
    first: int = 1


@dataclass(frozen=True, kw_only=True)
class Zone:
    """An area without lanes, as a car park.

    Attributes:
        perimeter: Corners, and the points of entry and exit.
        exits: Perimeter point of each exit, and the waypoint or perimeter point to which it leads.
        spots: Parking spots.
        name: Name; empty: none.
        first: Number of the first perimeter point; see `Lane`.
    """

    perimeter: tuple[LatLon, ...]
    exits: tuple[tuple[int, PointId], ...] = ()
    spots: tuple[Spot, ...] = ()
    name: str = ""
    first: int = 1


@dataclass(frozen=True, kw_only=True)
class RouteNetwork:
    """Contents of a route network definition file (RNDF)."""

    name: str
    segments: tuple[RoadSegment, ...]
    zones: tuple[Zone, ...] = ()
    format_version: str = ""
    creation_date: str = ""

    def points(self) -> dict[PointId, LatLon]:
        """Return all waypoints and perimeter points by their numbers."""
        return {
            (*owner, i): at for owner, part in self.parts() for i, at in enumerate(_points(part), part.first)
        }

    def checkpoints(self) -> dict[int, PointId]:
        """Return the point of each checkpoint."""
        return {
            checkpoint: (*owner, point)
            for owner, part in self.parts()
            if not isinstance(part, Zone)
            for point, checkpoint in part.checkpoints
        }

    @cached_property
    def entries(self) -> frozenset[PointId]:
        """Points to which exits lead."""
        parts = [part for _, part in self.parts()]
        # The format gives spots no exits.
        return frozenset(to for part in parts if not isinstance(part, Spot) for _, to in part.exits)

    def lane(self, segment: int, lane: int) -> Lane:
        """Return a lane by its numbers."""
        # Numbers of the format begin with 1.
        return self.segments[segment - 1].lanes[lane - 1]

    def parts(self) -> Iterator[tuple[tuple[int, int], Lane | Zone | Spot]]:
        """Iterate over lanes, perimeters and spots, with the first two numbers of their points."""
        for m, segment in enumerate(self.segments, 1):
            for n, lane in enumerate(segment.lanes, 1):
                yield (m, n), lane
        # The format numbers zones after the segments.
        for m, zone in enumerate(self.zones, 1 + len(self.segments)):
            yield (m, 0), zone
            for n, spot in enumerate(zone.spots, 1):
                yield (m, n), spot


@dataclass(frozen=True, kw_only=True)
class SpeedLimit:
    """Lowest and highest speed [miles per hour] on a segment or in a zone, by its number."""

    id: int
    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class Mission:
    """Contents of a mission data file (MDF): checkpoints to visit in order, and speed limits.

    Attributes:
        name: Name of the mission.
        rndf: Name of its route network.
        checkpoints: Checkpoints in their order, repetitions allowed.
        speed_limits: Speed limits.
        format_version: Version of the format.
        creation_date: Date of creation.
    """

    name: str
    rndf: str
    checkpoints: tuple[int, ...] = ()
    speed_limits: tuple[SpeedLimit, ...] = ()
    format_version: str = ""
    creation_date: str = ""


def _points(part: Lane | Zone | Spot) -> tuple[LatLon, ...]:
    return part.perimeter if isinstance(part, Zone) else part.waypoints


def point_name(numbers: tuple[int, ...]) -> str:
    """Return numbers in the notation of the files: 1.2.3."""
    return ".".join(map(str, numbers))


def network_faults(network: RouteNetwork) -> list[Fault]:
    """Return the faults of a route network; empty if it is sound.

    Checkpoints, stop signs and exits are at existing points of their lane, zone or spot; exits lead to
    existing points; checkpoints have unique numbers; values are in their ranges.
    """
    known = network.points()
    # For messages: points of an owner have consecutive numbers.
    numbers = {owner: (part.first, part.first + len(_points(part)) - 1) for owner, part in network.parts()}
    faults: list[Fault] = [] if network.name else [(("name",), "a route network needs a name")]
    # Numbers of checkpoints are unique in the whole network: missions name them alone.
    taken: set[int] = set()
    for owner, part in network.parts():
        faults += _wrong_figures(owner, part)
        for kind, point, other in _marks(part):
            where = (kind, (*owner, point), other)
            if (*owner, point) not in known:
                there = f"{point_name(owner)} has {_extent(numbers, (*owner, point))}"
                faults.append((where, f"{kind} at {point_name((*owner, point))}: {there}"))
            # The type tells the kind: a tuple is an exit's destination, a whole number a checkpoint's number.
            if isinstance(other, tuple) and other not in known:
                there = f"{point_name(other[:2])} has {_extent(numbers, other)}"
                faults.append((where, f"exit to {point_name(other)}: {there}"))
            if isinstance(other, int):
                if other in taken or other < 1:
                    text = f"checkpoint {other}: numbers begin with 1, and each can be given once"
                    faults.append((where, text))
                taken.add(other)
    return faults


def _wrong_figures(owner: tuple[int, int], part: Lane | Zone | Spot) -> Iterator[Fault]:
    # A spot is exactly its mouth and its parking position; of lanes and perimeters one point is enough.
    points, fewest = _points(part), 2 if isinstance(part, Spot) else 1
    if len(points) < fewest or (isinstance(part, Spot) and len(points) > fewest):
        yield ("points", owner), f"{point_name(owner)} has {len(points)} points; expected {fewest}"
    for i, (latitude, longitude) in enumerate(points, part.first):
        if not (-90 <= latitude <= 90 and -180 <= longitude <= 180):
            text = (
                f"{point_name((*owner, i))} lies at {latitude}, {longitude}; expected -90 to 90, -180 to 180"
            )
            yield ("points", owner), text
    if part.first < 0:
        yield ("points", owner), f"points of {point_name(owner)} begin with {part.first}; expected 0 or more"
    if not isinstance(part, Zone) and part.width is not None and not 0 <= part.width <= MAX_WIDTH_FEET:
        yield (
            ("width", owner),
            f"{point_name(owner)} is {part.width:g} feet wide; expected 0 to {MAX_WIDTH_FEET:g}",
        )
    if isinstance(part, Lane):
        for side, boundary in (("left", part.left), ("right", part.right)):
            if boundary not in ("", *BOUNDARIES):
                text = f"{side}_boundary {boundary!r}; allowed: {', '.join(BOUNDARIES)}"
                yield (f"{side}_boundary", owner), text


def _marks(part: Lane | Zone | Spot) -> Iterator[tuple[str, int, int | PointId | None]]:
    """Iterate over checkpoints, stops and exits: kind, point, and number or destination."""
    if not isinstance(part, Zone):
        yield from (("checkpoint", point, checkpoint) for point, checkpoint in part.checkpoints)
    if isinstance(part, Lane):
        yield from (("stop", point, None) for point in part.stops)
    if not isinstance(part, Spot):
        yield from (("exit", point, entry) for point, entry in part.exits)


def _extent(numbers: dict[tuple[int, int], tuple[int, int]], lost: PointId) -> str:
    # An owner that does not exist has no points: its first is behind its last.
    first, last = numbers.get(lost[:2], (1, 0))
    return f"points {first} to {last}" if last >= first else "no points"


def mission_faults(mission: Mission, network: RouteNetwork | None = None) -> list[Fault]:
    """Return the faults of a mission; empty if it is sound.

    Speed limits have their lowest speed first, and there is at most one for a segment or zone. With its route
    network: its checkpoints, segments and zones exist there.
    """
    faults: list[Fault] = []
    if not (mission.name and mission.rndf):
        faults.append((("name",), "a mission needs a name and the name of its route network"))
    for limit in mission.speed_limits:
        # In this form: NaN is refused as well.
        if not 0 <= limit.low <= limit.high <= MAX_SPEED_MPH:
            expected = f"0 <= lowest <= highest <= {MAX_SPEED_MPH:g}"
            text = f"speeds {limit.low:g} and {limit.high:g}: expected {expected}"
            faults.append((("speed_limit", limit.id), text))
    for number, times in Counter(limit.id for limit in mission.speed_limits).items():
        if times > 1:
            faults.append((("speed_limit", number), f"{times} speed limits for {number}; one is allowed"))
    return [*faults, *_strangers(mission, network)]


def _strangers(mission: Mission, network: RouteNetwork | None) -> Iterator[Fault]:
    """Iterate over references of a mission that its network lacks."""
    known = network.checkpoints() if network else {}
    there = _listed(known) if network else "1 and up"
    # Zones are numbered after the last segment, so one range covers both.
    areas = len(network.segments) + len(network.zones) if network else None
    for checkpoint in mission.checkpoints:
        if checkpoint < 1 or (network and checkpoint not in known):
            yield ("checkpoint", checkpoint), f"no checkpoint {checkpoint}; known: {there}"
    for limit in mission.speed_limits:
        if limit.id < 1 or (areas is not None and limit.id > areas):
            allowed = "1 and up" if areas is None else f"1 to {areas}"
            yield ("speed_limit", limit.id), f"no segment or zone {limit.id}; known: {allowed}"


def _listed(numbers: Iterable[int]) -> str:
    found = sorted(numbers)
    return (
        ", ".join(map(str, found[:MAX_LISTED_NUMBERS])) + (", ..." if len(found) > MAX_LISTED_NUMBERS else "")
        or "none"
    )
