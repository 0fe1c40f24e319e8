"""Route network (RNDF) and mission (MDF) files of the DARPA Urban Challenge: text to data and back.

The format is DARPA's "RNDF and MDF Formats" (manual 10.13): keywords and their values on lines, blocks closed
by `end_...`, comments between /* and */. Keywords are matched without case, white space and line breaks of
any system separate words, and lines of a block may be in any order. Files of the race's teams differ from the
format: what can be read anyway is read with a warning.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
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

DETAILS = ("format_version", "creation_date")
"""Optional lines of both formats."""
COUNTS = ("num_segments", "num_zones")
"""Lines that announce the blocks of a route network."""


def read_mdf(source: str | Path, network: RouteNetwork | None = None) -> Mission:
    """Return the mission of a file.

    Args:
        source: Its path, or its text: a string with a line break.
        network: Its route network; with it, checkpoints and numbers of segments are checked too.

    Raises:
        SpecError: It does not follow the format, a speed limit has its lowest speed last, or its network
            lacks an item that it refers to; the message names file and line, the error and the allowed
            values.
    """
    lines = RoadLines(source)
    head: dict[str, str] = {}
    checkpoints: list[int] = []
    limits: list[SpeedLimit] = []
    readers: dict[str, Callable[[], None]] = {
        **{key: partial(_text, lines, key, head) for key in ("MDF_name", "RNDF", *DETAILS)},
        "checkpoints": partial(_checkpoints, lines, checkpoints),
        "speed_limits": partial(_speed_limits, lines, limits),
    }
    _read_top(lines, readers, ("MDF_name", "RNDF"))
    mission = Mission(
        name=head["MDF_name"],
        rndf=head["RNDF"],
        checkpoints=tuple(checkpoints),
        speed_limits=tuple(limits),
        **{key: head[key] for key in DETAILS if key in head},
    )
    lines.refuse(mission_faults(mission, network))
    return mission


def _read_top(lines: RoadLines, readers: Mapping[str, Callable[[], None]], needed: Sequence[str]) -> None:
    """Read the lines and blocks of a whole file in any order; those that are needed come first as a rule."""
    for key in needed:
        if lines.word != key.lower():
            if key.lower() not in lines.rest:
                raise lines.unexpected(key)
            lines.warn(f"{key} stands further down")
            break
        readers[key]()
    lowered = {key.lower(): reader for key, reader in readers.items()}
    while reader := lowered.get(lines.word):
        reader()
    if lines.word not in ("end_file", ""):
        raise lines.unexpected(*(key for key in readers if key not in needed), "end_file")
    lines.end("end_file")


def _checkpoints(lines: RoadLines, into: list[int]) -> None:
    lines.words(0)
    announced = _announced(lines, "num_checkpoints")
    before = len(into)
    while lines.numbered:
        (number,) = lines.parsed(lines.word, 1, lines.line)
        lines.fault_lines.setdefault(("checkpoint", number), lines.line)
        lines.words(0)
        into.append(number)
    lines.count(len(into) - before, announced, "checkpoints")
    lines.end("end_checkpoints", "speed_limits", "end_file")


def _speed_limits(lines: RoadLines, into: list[SpeedLimit]) -> None:
    lines.words(0)
    announced = _announced(lines, "num_speed_limits")
    before = len(into)
    while lines.numbered:
        line = lines.line
        (number,) = lines.parsed(lines.word, 1, line)
        lines.fault_lines["speed_limit", number] = line
        low, high = (
            lines.real(w, "speed", 0.0, MAX_SPEED_MPH, line) for w in lines.words(2, "lowest highest")
        )
        into.append(SpeedLimit(id=number, low=low, high=high))
    lines.count(len(into) - before, announced, "speed limits")
    lines.end("end_speed_limits", "checkpoints", "end_file")


def _announced(lines: RoadLines, keyword: str) -> int | None:
    """Return the number of items that a line announces; None, with a warning: there is no such line."""
    if lines.word != keyword:
        lines.warn(f"{keyword} is missing")
        return None
    return lines.numbers(keyword)[0]


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

    Segments, zones, lanes and the lines in them may be in any order, counts and ends of blocks may be
    missing, and waypoints may begin with any number; each such deviation is a warning with its line.

    Args:
        source: Its path, or its text: a string with a line break.

    Raises:
        SpecError: It does not follow the format, or refers to points that do not exist; the message names
            file and line, the error and the allowed values.
    """
    lines = RoadLines(source)
    counts: dict[str, int] = {}
    head: dict[str, str] = {}
    segments: dict[int, RoadSegment] = {}
    zones: dict[int, Zone] = {}
    readers: dict[str, Callable[[], None]] = {
        **{key: partial(_text, lines, key, head) for key in ("RNDF_name", *DETAILS)},
        **{key: partial(_number, lines, key, counts) for key in COUNTS},
        "segment": partial(_segment, lines, segments, zones, counts),
        "zone": partial(_zone, lines, segments, zones, counts),
    }
    _read_top(lines, readers, ("RNDF_name",))
    for found, what in ((segments, "segments"), (zones, "zones")):
        if f"num_{what}" not in counts:
            lines.warn(f"num_{what} is missing")
        lines.count(len(found), counts.get(f"num_{what}"), what, lines.fault_lines.get(("behind", what)))
    for kind, numbers, start in (("segment", segments, 1), ("zone", zones, 1 + len(segments))):
        for number, expected in zip(sorted(numbers), range(start, start + len(numbers)), strict=True):
            if number != expected:
                where = lines.fault_lines[kind, number]
                raise lines.fault(
                    f"{kind} {number}; expected {kind} {expected}: numbers go up one by one", where
                )
    network = RouteNetwork(
        name=head["RNDF_name"],
        segments=tuple(segments[number] for number in sorted(segments)),
        zones=tuple(zones[number] for number in sorted(zones)),
        **{key: head[key] for key in DETAILS if key in head},
    )
    lines.refuse(network_faults(network))
    return network


def _number(lines: RoadLines, keyword: str, into: dict[str, int]) -> None:
    (into[keyword],) = lines.numbers(keyword)


def _text(lines: RoadLines, keyword: str, into: dict[str, str]) -> None:
    into[keyword] = lines.text(keyword)


def _segment(
    lines: RoadLines, segments: dict[int, RoadSegment], zones: Mapping[int, Zone], counts: Mapping[str, int]
) -> None:
    line = lines.line
    number = lines.next_number("segment", (), {**segments, **zones}, counts.get("num_segments"))
    lines.fault_lines["segment", number] = line
    own: dict[str, int] = {}
    head: dict[str, str] = {}
    lanes: dict[int, Lane] = {}

    def lane() -> None:
        found = lines.next_number("lane", (number,), lanes, own.get("num_lanes"))
        lanes[found] = _lane(lines, (number, found))

    lines.header(
        {
            "num_lanes": partial(_number, lines, "num_lanes", own),
            "segment_name": partial(_text, lines, "segment_name", head),
            "lane": lane,
        }
    )
    if not (own or lanes):
        raise lines.unexpected("num_lanes")
    if not own:
        lines.warn(f"num_lanes of segment {number} is missing")
    lines.count(len(lanes), own.get("num_lanes"), f"lanes of segment {number}")
    _refuse_gaps(lines, lanes, f"lane {number}.")
    lines.end("end_segment", "segment", "zone", "end_file")
    ordered = tuple(lanes[found] for found in sorted(lanes))
    segments[number] = RoadSegment(lanes=ordered, name=head.get("segment_name", ""))
    lines.fault_lines["behind", "segments"] = lines.line


def _refuse_gaps(lines: RoadLines, found: Collection[int], what: str) -> None:
    """Refuse numbers that are not 1, 2 and so on."""
    for number, expected in zip(sorted(found), range(1, 1 + len(found)), strict=True):
        if number != expected:
            raise lines.fault(f"{what}{number}; expected {what}{expected}: numbers go up one by one")


class _Head:
    """Contents of a lane, a perimeter or a spot: its points and the lines about them.

    Args:
        lines: The file.
        owner: The first two numbers of its points.
    """

    def __init__(self, lines: RoadLines, owner: tuple[int, int]) -> None:
        self.lines, self.owner = lines, owner
        self.counts: dict[str, int] = {}
        self.text: dict[str, str] = {}
        self.width: float | None = None
        self.points: dict[int, LatLon] = {}
        self.marks: dict[str, list[Any]] = {"checkpoint": [], "stop": [], "exit": []}

    def read(self, count: str, *others: str) -> None:
        """Read the lines of the block: the count, unless it is empty, other allowed keywords, and points.

        Lines behind points are warnings: the format has them before.
        """
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
        while self.lines.numbered or self.lines.word in allowed:
            if self.lines.numbered:
                self.lines.point(self.owner, self.points)
                continue
            if self.points:
                self.lines.warn(f"{self.lines.word} is behind points; the format has it before")
            allowed[self.lines.word]()
        if not self.points:
            missing = [count] if count and count not in self.counts else []
            first = f"{point_name((*self.owner, 1))} latitude longitude"
            raise self.lines.unexpected(*missing, *others, first)
        if count and count not in self.counts:
            self.lines.warn(f"{count} of {point_name(self.owner)} is missing")

    @property
    def first(self) -> int:
        """Number of the first point."""
        return min(self.points)

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
    head = _Head(lines, owner)
    marks = ("lane_width", "left_boundary", "right_boundary", "checkpoint", "stop", "exit")
    head.read("num_waypoints", *marks)
    lines.count(len(head.points), head.counts.get("num_waypoints"), f"waypoints of {point_name(owner)}")
    lines.end("end_lane", "lane", "end_segment", "segment", "zone", "end_file")
    return Lane(
        waypoints=tuple(head.points.values()),
        width=head.width,
        left=head.text.get("left_boundary", ""),
        right=head.text.get("right_boundary", ""),
        checkpoints=tuple(head.marks["checkpoint"]),
        stops=tuple(head.marks["stop"]),
        exits=tuple(head.marks["exit"]),
        first=head.first,
    )


def _zone(
    lines: RoadLines, segments: Mapping[int, RoadSegment], zones: dict[int, Zone], counts: Mapping[str, int]
) -> None:
    line = lines.line
    most = sum(counts.values()) if len(counts) == len(COUNTS) else None
    number = lines.next_number("zone", (), {**segments, **zones}, most)
    lines.fault_lines["zone", number] = line
    own: dict[str, int] = {}
    text: dict[str, str] = {}
    around: list[_Head] = []
    spots: dict[int, Spot] = {}

    def perimeter() -> None:
        lines.named("perimeter", number, 0)
        head = _Head(lines, (number, 0))
        head.read("num_perimeterpoints", "exit")
        expected = head.counts.get("num_perimeterpoints")
        lines.count(len(head.points), expected, f"perimeter points of {point_name((number, 0))}")
        lines.end("end_perimeter", "spot", "end_zone", "zone", "segment", "end_file")
        around.append(head)

    def spot() -> None:
        found = lines.next_number("spot", (number,), spots, own.get("num_spots"))
        spots[found] = _spot(lines, (number, found))

    lines.header(
        {
            "num_spots": partial(_number, lines, "num_spots", own),
            "zone_name": partial(_text, lines, "zone_name", text),
            "perimeter": perimeter,
            "spot": spot,
        }
    )
    if len(around) != 1:
        raise (
            lines.unexpected("perimeter") if not around else lines.fault(f"zone {number} has two perimeters")
        )
    if not own:
        lines.warn(f"num_spots of zone {number} is missing")
    lines.count(len(spots), own.get("num_spots"), f"spots of zone {number}")
    _refuse_gaps(lines, spots, f"spot {number}.")
    lines.end("end_zone", "zone", "segment", "end_file")
    (head,) = around
    zones[number] = Zone(
        perimeter=tuple(head.points.values()),
        exits=tuple(head.marks["exit"]),
        spots=tuple(spots[found] for found in sorted(spots)),
        name=text.get("zone_name", ""),
        first=head.first,
    )


def _spot(lines: RoadLines, owner: tuple[int, int]) -> Spot:
    head = _Head(lines, owner)
    head.read("", "spot_width", "checkpoint")
    lines.count(len(head.points), 2, f"waypoints of {point_name(owner)}")
    lines.end("end_spot", "spot", "end_zone", "zone", "segment", "end_file")
    return Spot(
        waypoints=tuple(head.points.values()),
        width=head.width,
        checkpoints=tuple(head.marks["checkpoint"]),
        first=head.first,
    )


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
        rows += [*_point_rows((m, 0), zone.perimeter, zone.first), ("end_perimeter",)]
        for n, spot in enumerate(zone.spots, 1):
            rows += [("spot", (m, n)), ("spot_width", spot.width)]
            rows += [("checkpoint", (m, n, point), number) for point, number in spot.checkpoints]
            rows += [*_point_rows((m, n), spot.waypoints, spot.first), ("end_spot",)]
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
        *_point_rows(owner, lane.waypoints, lane.first),
        ("end_lane",),
    ]


def _point_rows(owner: tuple[int, int], points: tuple[LatLon, ...], first: int) -> list[Row]:
    return [((*owner, i), *at) for i, at in enumerate(points, first)]
