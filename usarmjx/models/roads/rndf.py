"""Route network (RNDF) and mission (MDF) files of the DARPA Urban Challenge: text to data and back.

The format is DARPA's "RNDF and MDF Formats" (manual 10.13): keywords and their values on lines, blocks closed
by `end_...`, comments between /* and */. Keywords are matched without case, white space and line breaks of
any system separate words, and lines of a block may be in any order. Files of the race's teams differ from the
format: what can be read anyway is read with a warning.
"""

import logging
import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from usarmjx.base.errors import SpecError
from usarmjx.base.files import read_bounded
from usarmjx.models.roads.network import (
    MAX_SPEED_MPH,
    MAX_WIDTH_FEET,
    Fault,
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

logger = logging.getLogger(__name__)
NUMBERED = re.compile(r"[0-9]{1,18}(\.[0-9]{1,18})*")
"""Pattern of the first word of a line without a keyword: 1.2.3, or a plain number."""
MAX_ROAD_FILE_BYTES = 16_000_000
"""Largest size of a file [bytes]."""
MAX_WARNINGS = 20
"""Largest number of warnings about one file."""
MAX_MESSAGE_LENGTH, MAX_QUOTE_LENGTH = 1000, 100
"""Largest lengths of an error and of a quotation in it [characters]."""
DETAILS = ("format_version", "creation_date")
"""Optional lines of both formats."""
COUNTS = ("num_segments", "num_zones")
"""Lines that announce the blocks of a route network."""


class RoadLines:
    """Reader of the lines of a file, without blank lines and comments, one after the other.

    Args:
        source: A path, or the text itself: a string with a line break.

    Attributes:
        fault_lines: Line of each item that a later check may refuse, by the key of `Fault`.
        warnings: Deviations from the format that were accepted, with file and line; they are logged too.

    Raises:
        SpecError: The file cannot be read, or a comment has no end.
    """

    def __init__(self, source: str | Path) -> None:
        self.file, text = "text", str(source)
        # A text of a network has many lines, the name of a file none.
        if isinstance(source, Path) or "\n" not in source:
            self.file = text
            data = read_bounded(Path(source), MAX_ROAD_FILE_BYTES)
            # Not splitlines, which breaks at form feeds too: numbers of lines would differ from an
            # editor's.
            text = data.decode("utf-8-sig", "replace").replace("\r\n", "\n").replace("\r", "\n")
        # Checks of the whole know items, not lines: this leads from one to the other.
        self.fault_lines: dict[tuple[object, ...], int] = {}
        self.warnings: list[str] = []
        text = _without_comments(text)
        lines = [(number, line.split()) for number, line in enumerate(text.split("\n"), 1)]
        self._lines = [(number, words) for number, words in lines if words]
        self._end = self._lines[-1][0] if self._lines else 1
        self._next = 0
        for number, words in self._lines:
            if any("/*" in word for word in words):
                raise self.fault("a comment without its end; expected */", number)

    @property
    def line(self) -> int:
        """Number of the next line; of the last one at the end."""
        return self._lines[self._next][0] if self._next < len(self._lines) else self._end

    @property
    def word(self) -> str:
        """First word of the next line in lower case, as keywords are; empty at the end."""
        return self._lines[self._next][1][0].lower() if self._next < len(self._lines) else ""

    @property
    def rest(self) -> set[str]:
        """First words of the lines to come."""
        return {words[0].lower() for _, words in self._lines[self._next :]}

    @property
    def numbered(self) -> bool:
        """Whether the next line begins with numbers instead of a keyword."""
        return bool(NUMBERED.fullmatch(self.word))

    def fault(self, text: str, line: int | None = None) -> SpecError:
        """Return an error at a line, by default the next one; quotations are made printable and cut short."""
        short = text if len(text) <= MAX_MESSAGE_LENGTH else f"{text[:MAX_MESSAGE_LENGTH]}..."
        # Files come from anywhere: control characters would reach the terminal.
        shown = "".join(letter if letter.isprintable() else "?" for letter in short)
        return SpecError(f"{self.file}:{self.line if line is None else line}: {shown}")

    def warn(self, text: str, line: int | None = None) -> None:
        """Note a deviation from the format at a line, by default the next one."""
        warning = str(self.fault(text, line))
        self.warnings.append(warning)
        if len(self.warnings) <= MAX_WARNINGS:
            logger.warning("%s", warning)
        # The list keeps all of them; a file of another kind would flood the log.
        elif len(self.warnings) == MAX_WARNINGS + 1:
            logger.warning("%s: more than %d warnings; the rest is left out", self.file, MAX_WARNINGS)

    def end(self, keyword: str, *outside: str) -> None:
        """Skip the end of a block; one that is missing before a line of the outer block is a warning.

        Args:
            keyword: The line that ends the block.
            outside: Keywords that may follow the block.

        Raises:
            SpecError: The next line is another one.
        """
        if self.word == keyword.lower():
            self.words(0)
        elif self.word in outside or not self.word:
            self.warn(f"{keyword} is missing")
        else:
            raise self.unexpected(keyword)

    def unexpected(self, *allowed: str) -> SpecError:
        """Return the error that the next line has none of the allowed keywords."""
        found = f"found {_short(self._lines[self._next][1][0])!r}" if self.word else "the file ends"
        return self.fault(f"{found}; allowed here: {', '.join(allowed)}")

    def words(self, count: int | None = None, meaning: str = "") -> list[str]:
        """Return the words after the first one of the next line, and advance.

        Args:
            count: Number of words that must follow; None: any number above zero.
            meaning: Description of the words, for the error.
        """
        first, *rest = self._lines[self._next][1]
        # Names may have blanks: without a count any number of words but none is right.
        if (not rest) if count is None else (len(rest) != count):
            found = _short(f"{first} {' '.join(rest)}".rstrip())
            raise self.fault(f"{found}; expected: {_short(first)} {meaning}".rstrip())
        self._next += 1
        return rest

    def text(self, keyword: str) -> str:
        """Return the text after a keyword which must be next."""
        if self.word != keyword.lower():
            raise self.unexpected(keyword)
        return " ".join(self.words(meaning="name"))

    def numbers(self, keyword: str, count: int = 1) -> tuple[int, ...]:
        """Return the numbers `1.2` after a keyword which must be next; `count` of them."""
        if self.word != keyword.lower():
            raise self.unexpected(keyword)
        line, (word,) = self.line, self.words(1, ".".join("MNP"[:count]))
        return self.parsed(word, count, line)

    def parsed(self, word: str, count: int, line: int) -> tuple[int, ...]:
        """Return the numbers of a word with dots; `count` of them."""
        numbers = tuple(int(part) for part in word.split(".")) if NUMBERED.fullmatch(word) else ()
        if len(numbers) != count:
            raise self.fault(
                f"{_short(word)!r}; expected {count} whole numbers, as {point_name((1,) * count)}", line
            )
        return numbers

    def named(self, keyword: str, *numbers: int) -> None:
        """Skip `perimeter 1.0`, whose numbers must be exactly the given ones."""
        line, found = self.line, self.numbers(keyword, len(numbers))
        if found != numbers:
            raise self.fault(f"{keyword} {point_name(found)}; expected {keyword} {point_name(numbers)}", line)

    def real(self, word: str, what: str, low: float, high: float, line: int) -> float:
        """Return a number within a range."""
        try:
            value = float(word)
        except ValueError:
            value = math.nan
        # In this form: comparisons with NaN are false, so it is refused as well.
        if not low <= value <= high:
            raise self.fault(f"{what} {_short(word)!r}; expected a number from {low:g} to {high:g}", line)
        return value

    def next_number(
        self, keyword: str, owner: tuple[int, ...], taken: Collection[int], most: int | None
    ) -> int:
        """Return the last number of `lane 1.2`, whose other numbers must be the owner's.

        Args:
            keyword: Keyword of the line.
            owner: The numbers before it.
            taken: Numbers of the blocks so far.
            most: Largest number; None: not announced.

        Raises:
            SpecError: Another owner, or a number that is taken or above the largest one.
        """
        line, found = self.line, self.numbers(keyword, len(owner) + 1)
        usual = len(taken) + 1
        if usual in taken:
            # With gaps before it, the number that is due is that of the first gap.
            usual = next(i for i in range(1, usual) if i not in taken)
        number = found[-1]
        if found[:-1] != owner or number < 1 or number in taken or (most is not None and number > most):
            raise self.fault(
                f"{keyword} {point_name(found)}; expected {keyword} {point_name((*owner, usual))}: "
                "numbers go up one by one",
                line,
            )
        if number != usual:
            self.warn(
                f"{keyword} {point_name(found)} is before {keyword} {point_name((*owner, usual))}", line
            )
        return number

    def point(self, owner: tuple[int, int], points: dict[int, LatLon]) -> None:
        """Read a line `1.2.3 34.5 -117.3` as the next point of its owner.

        Raises:
            SpecError: Its number is not the one after the last, or it is a point of another owner.
        """
        numbers = self.parsed(self.word, 3, self.line)
        usual = max(points) + 1 if points else numbers[2]
        if numbers != (*owner, usual):
            expected = (*owner, usual if points else 1)
            raise self.fault(f"{self.word}; expected {point_name(expected)}: numbers go up one by one")
        if not points and usual != 1:
            self.warn(f"points of {point_name(owner)} begin with {self.word} instead of 1")
        line, (north, east) = self.line, self.words(2, "latitude longitude")
        latitude = self.real(north, "latitude", -90.0, 90.0, line)
        points[usual] = latitude, self.real(east, "longitude", -180.0, 180.0, line)

    def count(self, found: int, expected: int | None, what: str, line: int | None = None) -> None:
        """Check a number of items against the announced one; None: none is announced."""
        if expected is not None and found != expected:
            raise self.fault(f"{found} {what}, but {expected} were announced", line)

    def header(self, keywords: Mapping[str, Callable[[], None]]) -> None:
        """Read lines with those keywords, in any order, until another line comes."""
        while read := keywords.get(self.word):
            read()

    def refuse(self, faults: list[Fault]) -> None:
        """Raise the first fault of a check of the whole, at its line."""
        for where, text in faults:
            raise self.fault(text, self.fault_lines.get(where, self._end))


def _without_comments(text: str) -> str:
    """Return a text with each comment replaced by a space or its line breaks; one without an end stays."""
    parts: list[str] = []
    at = 0
    while (start := text.find("/*", at)) >= 0 and (end := text.find("*/", start + 2)) >= 0:
        # Line breaks stay: errors name lines of the file. A blank keeps the words on both sides apart.
        parts += [text[at:start], "\n" * text.count("\n", start, end) or " "]
        at = end + 2
    return "".join([*parts, text[at:]])


def _short(text: str) -> str:
    return text if len(text) <= MAX_QUOTE_LENGTH else f"{text[:MAX_QUOTE_LENGTH]}..."


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
    # A missing end is only a warning, see `end`.
    if lines.word not in ("end_file", ""):
        raise lines.unexpected(*(key for key in readers if key not in needed), "end_file")
    lines.end("end_file")


def _checkpoints(lines: RoadLines, into: list[int]) -> None:
    lines.words(0)
    announced = _announced(lines, "num_checkpoints")
    before = len(into)
    while lines.numbered:
        (number,) = lines.parsed(lines.word, 1, lines.line)
        # The first line of a number: missions may visit a checkpoint several times.
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
        # The last line of a number: of two limits the later one is too many.
        lines.fault_lines["speed_limit", number] = line
        # The format states miles per hour.
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
        # Only at the end of the file: blocks may be in any order.
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
    # A wrong count of segments shows only here, behind the last one.
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
    # Zones go on with the numbers of the segments, so the largest one is known by both counts only.
    most = sum(counts.values()) if len(counts) == len(COUNTS) else None
    # Segments' numbers are taken too: `M` of a point M.N.P may be either's.
    number = lines.next_number("zone", (), {**segments, **zones}, most)
    lines.fault_lines["zone", number] = line
    own: dict[str, int] = {}
    text: dict[str, str] = {}
    around: list[_Head] = []
    spots: dict[int, Spot] = {}

    def perimeter() -> None:
        # The format numbers a zone's perimeter as its spot 0.
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
    # The mouth and the parking position: two points give a spot its direction.
    lines.count(len(head.points), 2, f"waypoints of {point_name(owner)}")
    lines.end("end_spot", "spot", "end_zone", "zone", "segment", "end_file")
    return Spot(
        waypoints=tuple(head.points.values()),
        width=head.width,
        checkpoints=tuple(head.marks["checkpoint"]),
        first=head.first,
    )
