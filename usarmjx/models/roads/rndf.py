"""Route network (RNDF) and mission (MDF) files of the DARPA Urban Challenge: text to data and back.

The format is DARPA's "RNDF and MDF Formats" (manual 10.13): keywords and their values on lines, blocks closed
by `end_...`, comments between /* and */. Keywords are matched without case, white space and line breaks of
any system separate words, and headers of blocks may be in any order.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from usarmjx.base.errors import SpecError
from usarmjx.models.roads.lines import RoadLines, Row, format_lines
from usarmjx.models.roads.network import (
    MAX_SPEED_MPH,
    MAX_WIDTH_FEET,
    Lane,
    LatLon,
    Mission,
    RoadSegment,
    RouteNetwork,
    SpeedLimit,
    Spot,
    Zone,
    mission_faults,
    network_faults,
    point_name,
)


def read_mdf(source: str | Path, network: RouteNetwork | None = None) -> Mission:
    """Return the mission of a file.

    Args:
        source: Its path, or its text: a string with a line break.
        network: Its route network; with it, checkpoints and numbers of segments are checked too.

    Raises:
        SpecError: It does not follow the format, a speed limit has its lowest speed last, or its network
            lacks
            an item that it refers to; the message names file and line, the error and the allowed values.
    """
    lines = RoadLines(source)
    name = lines.text("MDF_name")
    rndf = lines.text("RNDF")
    head: dict[str, str] = {}

    def note(keyword: str) -> None:
        head[keyword] = lines.text(keyword)

    lines.header({keyword: partial(note, keyword) for keyword in ("format_version", "creation_date")})
    checkpoints = _checkpoints(lines) if lines.word == "checkpoints" else ()
    limits = _speed_limits(lines) if lines.word == "speed_limits" else ()
    if lines.word != "end_file":
        raise lines.unexpected("format_version", "creation_date", "checkpoints", "speed_limits", "end_file")
    lines.take("end_file")
    mission = Mission(name=name, rndf=rndf, checkpoints=checkpoints, speed_limits=limits, **head)
    lines.refuse(mission_faults(mission, network))
    return mission


def _checkpoints(lines: RoadLines) -> tuple[int, ...]:
    lines.take("checkpoints")
    (announced,) = lines.numbers("num_checkpoints")
    found: list[int] = []
    while lines.numbered:
        (number,) = lines.parsed(lines.word, 1, lines.line)
        lines.fault_lines.setdefault(("checkpoint", number), lines.line)
        lines.words(0)
        found.append(number)
    lines.count(len(found), announced, "checkpoints")
    lines.take("end_checkpoints")
    return tuple(found)


def _speed_limits(lines: RoadLines) -> tuple[SpeedLimit, ...]:
    lines.take("speed_limits")
    (announced,) = lines.numbers("num_speed_limits")
    found: list[SpeedLimit] = []
    while lines.numbered:
        line = lines.line
        (number,) = lines.parsed(lines.word, 1, line)
        lines.fault_lines["speed_limit", number] = line
        low, high = (
            lines.real(w, "speed", 0.0, MAX_SPEED_MPH, line) for w in lines.words(2, "lowest highest")
        )
        found.append(SpeedLimit(id=number, low=low, high=high))
    lines.count(len(found), announced, "speed limits")
    lines.take("end_speed_limits")
    return tuple(found)


def write_mdf(mission: Mission) -> str:
    """Return the text of a mission's file; `read_mdf` returns the same mission for it.

    Raises:
        SpecError: The mission is not sound (`mission_faults`), or a file cannot hold one of its names.
    """
    for _, text in mission_faults(mission):
        raise SpecError(f"{mission.name}: {text}")
    rows: list[Row] = [
        ("MDF_name", mission.name),
        ("RNDF", mission.rndf),
        ("format_version", mission.format_version),
        ("creation_date", mission.creation_date),
        ("checkpoints",),
        ("num_checkpoints", len(mission.checkpoints)),
        *((number,) for number in mission.checkpoints),
        ("end_checkpoints",),
        ("speed_limits",),
        ("num_speed_limits", len(mission.speed_limits)),
        *((limit.id, limit.low, limit.high) for limit in mission.speed_limits),
        ("end_speed_limits",),
        ("end_file",),
    ]
    return format_lines(rows)


def read_rndf(source: str | Path) -> RouteNetwork:
    """Return the route network of a file.

    Args:
        source: Its path, or its text: a string with a line break.

    Raises:
        SpecError: It does not follow the format, or refers to points that do not exist; the message names
            file
            and line, the error and the allowed values.
    """
    lines = RoadLines(source)
    name = lines.text("RNDF_name")
    counts: dict[str, int] = {}
    head: dict[str, str] = {}
    lines.header(
        {
            "num_segments": partial(_number, lines, "num_segments", counts),
            "num_zones": partial(_number, lines, "num_zones", counts),
            "format_version": partial(_text, lines, "format_version", head),
            "creation_date": partial(_text, lines, "creation_date", head),
        }
    )
    if missing := {"num_segments", "num_zones"} - counts.keys():
        raise lines.unexpected(*sorted(missing))
    segments: list[RoadSegment] = []
    while lines.word == "segment":
        segments.append(_segment(lines, len(segments) + 1))
    lines.count(len(segments), counts["num_segments"], "segments")
    zones: list[Zone] = []
    while lines.word == "zone":
        zones.append(_zone(lines, len(segments) + len(zones) + 1))
    lines.count(len(zones), counts["num_zones"], "zones")
    lines.take("end_file")
    network = RouteNetwork(name=name, segments=tuple(segments), zones=tuple(zones), **head)
    lines.refuse(network_faults(network))
    return network


def _number(lines: RoadLines, keyword: str, into: dict[str, int]) -> None:
    (into[keyword],) = lines.numbers(keyword)


def _text(lines: RoadLines, keyword: str, into: dict[str, str]) -> None:
    into[keyword] = lines.text(keyword)


def _segment(lines: RoadLines, number: int) -> RoadSegment:
    lines.named("segment", number)
    counts: dict[str, int] = {}
    head: dict[str, str] = {}
    lines.header(
        {
            "num_lanes": partial(_number, lines, "num_lanes", counts),
            "segment_name": partial(_text, lines, "segment_name", head),
        }
    )
    if not counts:
        raise lines.unexpected("num_lanes")
    lanes: list[Lane] = []
    while lines.word == "lane":
        lanes.append(_lane(lines, (number, len(lanes) + 1)))
    lines.count(len(lanes), counts["num_lanes"], f"lanes of segment {number}")
    lines.take("end_segment")
    return RoadSegment(lanes=tuple(lanes), name=head.get("segment_name", ""))


class _Head:
    """Header of a lane, a perimeter or a spot: the lines before its points.

    Args:
        lines: The file.
        owner: The first two numbers of its points.
    """

    def __init__(self, lines: RoadLines, owner: tuple[int, int]) -> None:
        self.lines, self.owner = lines, owner
        self.counts: dict[str, int] = {}
        self.text: dict[str, str] = {}
        self.width: float | None = None
        self.marks: dict[str, list[Any]] = {"checkpoint": [], "stop": [], "exit": []}

    def read(self, count: str, *others: str) -> None:
        """Read the lines of the header: the count, unless it is empty, and the other allowed keywords."""
        readers: dict[str, Callable[[], None]] = {
            "lane_width": partial(self._width, "lane_width"),
            "spot_width": partial(self._width, "spot_width"),
            "left_boundary": partial(self._boundary, "left_boundary"),
            "right_boundary": partial(self._boundary, "right_boundary"),
            "checkpoint": self._checkpoint,
            "stop": self._stop,
            "exit": self._exit,
        }
        allowed = {keyword: readers[keyword] for keyword in others}
        if count:
            allowed[count] = partial(_number, self.lines, count, self.counts)
        self.lines.header(allowed)
        if count and count not in self.counts:
            raise self.lines.unexpected(count, *others)
        if not self.lines.numbered:
            raise self.lines.unexpected(*others, f"{point_name((*self.owner, 1))} latitude longitude")

    def _width(self, keyword: str) -> None:
        line, (word,) = self.lines.line, self.lines.words(1, "feet")
        self.width = self.lines.real(word, keyword, 0.0, MAX_WIDTH_FEET, line)

    def _boundary(self, keyword: str) -> None:
        self.lines.fault_lines[keyword, self.owner] = self.lines.line
        self.text[keyword] = self.lines.text(keyword)

    def _point(self, word: str, line: int) -> int:
        m, n, point = self.lines.parsed(word, 3, line)
        if (m, n) != self.owner:
            expected = point_name(self.owner)
            raise self.lines.fault(f"point {word} is not one of {expected}; expected {expected}.P", line)
        return point

    def _checkpoint(self) -> None:
        line, (at, number) = self.lines.line, self.lines.words(2, "M.N.P number")
        point, (checkpoint,) = self._point(at, line), self.lines.parsed(number, 1, line)
        self.marks["checkpoint"].append((point, checkpoint))
        self.lines.fault_lines["checkpoint", (*self.owner, point), checkpoint] = line

    def _stop(self) -> None:
        line, (at,) = self.lines.line, self.lines.words(1, "M.N.P")
        point = self._point(at, line)
        self.marks["stop"].append(point)
        self.lines.fault_lines["stop", (*self.owner, point), None] = line

    def _exit(self) -> None:
        line, (at, to) = self.lines.line, self.lines.words(2, "M.N.P M.N.P")
        point, entry = self._point(at, line), self.lines.parsed(to, 3, line)
        self.marks["exit"].append((point, entry))
        self.lines.fault_lines["exit", (*self.owner, point), entry] = line


def _lane(lines: RoadLines, owner: tuple[int, int]) -> Lane:
    lines.named("lane", *owner)
    head = _Head(lines, owner)
    marks = ("lane_width", "left_boundary", "right_boundary", "checkpoint", "stop", "exit")
    head.read("num_waypoints", *marks)
    waypoints = lines.points(owner, head.counts["num_waypoints"], "waypoints")
    lines.take("end_lane")
    return Lane(
        waypoints=waypoints,
        width=head.width,
        left=head.text.get("left_boundary", ""),
        right=head.text.get("right_boundary", ""),
        checkpoints=tuple(head.marks["checkpoint"]),
        stops=tuple(head.marks["stop"]),
        exits=tuple(head.marks["exit"]),
    )


def _zone(lines: RoadLines, number: int) -> Zone:
    lines.named("zone", number)
    counts: dict[str, int] = {}
    text: dict[str, str] = {}
    lines.header(
        {
            "num_spots": partial(_number, lines, "num_spots", counts),
            "zone_name": partial(_text, lines, "zone_name", text),
        }
    )
    if not counts:
        raise lines.unexpected("num_spots", "zone_name")
    lines.named("perimeter", number, 0)
    head = _Head(lines, (number, 0))
    head.read("num_perimeterpoints", "exit")
    perimeter = lines.points((number, 0), head.counts["num_perimeterpoints"], "perimeter points")
    lines.take("end_perimeter")
    spots: list[Spot] = []
    while lines.word == "spot":
        spots.append(_spot(lines, (number, len(spots) + 1)))
    lines.count(len(spots), counts["num_spots"], f"spots of zone {number}")
    lines.take("end_zone")
    exits = tuple(head.marks["exit"])
    return Zone(perimeter=perimeter, exits=exits, spots=tuple(spots), name=text.get("zone_name", ""))


def _spot(lines: RoadLines, owner: tuple[int, int]) -> Spot:
    lines.named("spot", *owner)
    head = _Head(lines, owner)
    head.read("", "spot_width", "checkpoint")
    waypoints = lines.points(owner, 2, "waypoints")
    lines.take("end_spot")
    return Spot(waypoints=waypoints, width=head.width, checkpoints=tuple(head.marks["checkpoint"]))


def write_rndf(network: RouteNetwork) -> str:
    """Return the text of a route network's file; `read_rndf` returns the same network for it.

    Raises:
        SpecError: The network is not sound (`network_faults`), or a file cannot hold one of its names.
    """
    for _, text in network_faults(network):
        raise SpecError(f"{network.name}: {text}")
    rows: list[Row] = [
        ("RNDF_name", network.name),
        ("num_segments", len(network.segments)),
        ("num_zones", len(network.zones)),
        ("format_version", network.format_version),
        ("creation_date", network.creation_date),
    ]
    for m, segment in enumerate(network.segments, 1):
        rows += [("segment", m), ("num_lanes", len(segment.lanes)), ("segment_name", segment.name)]
        for n, lane in enumerate(segment.lanes, 1):
            rows += _lane_rows((m, n), lane)
        rows.append(("end_segment",))
    for m, zone in enumerate(network.zones, 1 + len(network.segments)):
        rows += [("zone", m), ("num_spots", len(zone.spots)), ("zone_name", zone.name)]
        rows += [("perimeter", (m, 0)), ("num_perimeterpoints", len(zone.perimeter))]
        rows += [("exit", (m, 0, point), entry) for point, entry in zone.exits]
        rows += [*_point_rows((m, 0), zone.perimeter), ("end_perimeter",)]
        for n, spot in enumerate(zone.spots, 1):
            rows += [("spot", (m, n)), ("spot_width", spot.width)]
            rows += [("checkpoint", (m, n, point), number) for point, number in spot.checkpoints]
            rows += [*_point_rows((m, n), spot.waypoints), ("end_spot",)]
        rows.append(("end_zone",))
    return format_lines([*rows, ("end_file",)])


def _lane_rows(owner: tuple[int, int], lane: Lane) -> list[Row]:
    return [
        ("lane", owner),
        ("num_waypoints", len(lane.waypoints)),
        ("lane_width", lane.width),
        ("left_boundary", lane.left),
        ("right_boundary", lane.right),
        *(("checkpoint", (*owner, point), number) for point, number in lane.checkpoints),
        *(("stop", (*owner, point)) for point in lane.stops),
        *(("exit", (*owner, point), entry) for point, entry in lane.exits),
        *_point_rows(owner, lane.waypoints),
        ("end_lane",),
    ]


def _point_rows(owner: tuple[int, int], points: tuple[LatLon, ...]) -> list[Row]:
    return [((*owner, i), *at) for i, at in enumerate(points, 1)]
