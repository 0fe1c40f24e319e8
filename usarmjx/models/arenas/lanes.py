"""Lanes: single elements between walls for robot tests, one for each test method for response robots.

Named after NIST's test methods, as published by ASTM (E2801, E2802, E2803, E2804, E2826, E2827, E2828, E2829)
and used by the RoboCup Rescue league. Known of these, without their text at hand, are the lane of 1.2 m,
slopes of 15 degrees of ramps, posts 10 cm wide, and the steps of 10 cm in which hurdles and gaps grow. Chosen
are lengths of lanes, turning areas of 2.4 m at both ends, rises of stairs, thicknesses, and friction, which
is that of all ground.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from usarmjx.base.registry import Registry
from usarmjx.models.arenas.pieces import (
    BARE,
    CELL,
    OCTAGON_APOTHEM,
    POST,
    RISE,
    STEEP,
    STEP_PIPE_DIAMETER,
    block,
    deck,
    finished,
    pipe,
    pipe_steps,
    ramps,
    slope,
    span,
    stairs,
    step_field,
)
from usarmjx.models.types.arena import START_ELEVATION, ArenaSpec, StartPose
from usarmjx.models.types.shapes import Position2D, Shape

LANE_PREFIX = "lane_"
"""Prefix of the names of lanes among those of arenas."""
END_LENGTH = 2 * CELL
"""Length and width of the areas at both ends [m]."""
MOUTH_DISTANCE = 0.5
"""Distance before a lane at which a robot is aligned with it [m]."""
HEIGHT = 1.2
"""Height of walls above the highest ground of a lane [m]."""
THICKNESS = 0.05


@dataclass(frozen=True, kw_only=True)
class MobilityLane:
    """A lane along x from zero on, with turning areas before and behind it.

    Attributes:
        method: Test method.
        arena: The lane.
        length: Length of the lane without its ends [m].
        round_trip: Whether a repetition is there and back; else each way counts.
    """

    method: str
    arena: ArenaSpec
    length: float
    round_trip: bool = False

    def way(self, back: bool) -> tuple[Position2D, ...]:
        """Return points from one end to the other [m]: both mouths of the lane, and the middle of the end."""
        # The last point takes the whole robot out of the lane, as a traverse that counts needs.
        out = (
            (-MOUTH_DISTANCE, 0.0),
            (self.length + MOUTH_DISTANCE, 0.0),
            (self.length + END_LENGTH / 2, 0.0),
        )
        return tuple((self.length - x, y) for x, y in out) if back else out


def hurdle(at: Position2D, height: float, *, yaw: float = 0.0, width: float = CELL) -> tuple[Shape, ...]:
    """Return a hurdle: a beam as wide as a pipe with a pipe on it, `height` above the ground [m].

    Its pipe does not turn, unlike that of ASTM E2802.
    """
    # No beam where the pipe alone is as high.
    beam = height - STEP_PIPE_DIAMETER * OCTAGON_APOTHEM
    top = pipe(at, width, diameter=STEP_PIPE_DIAMETER, z=beam, yaw=yaw + math.pi / 2)
    return (
        (block(at, (STEP_PIPE_DIAMETER * OCTAGON_APOTHEM, width, beam), yaw=yaw), *top) if beam > 0 else top
    )


def _walls(length: float, top: float) -> Iterable[Shape]:
    """Yield walls around a lane and its ends, a wall's height above the ground at each end."""
    low, high, half, side = -END_LENGTH, length + END_LENGTH, CELL / 2, END_LENGTH / 2
    for x0, x1, y, z in ((0.0, length, half, top), (low, 0.0, side, 0.0), (length, high, side, top)):
        yield span((x0, y, 0.0), (x1, y + THICKNESS, z + HEIGHT))
        yield span((x0, -y - THICKNESS, 0.0), (x1, -y, z + HEIGHT))
    for x0, x1 in ((-THICKNESS, 0.0), (length, length + THICKNESS)):
        yield span((x0, half, 0.0), (x1, side, top + HEIGHT))
        yield span((x0, -side, 0.0), (x1, -half, top + HEIGHT))
    yield span((low - THICKNESS, -side, 0.0), (low, side, HEIGHT))
    yield span((high, -side, 0.0), (high + THICKNESS, side, top + HEIGHT))


def lane_of(
    name: str, method: str, about: str, length: float, *shapes: Shape, top: float = 0.0, twice: bool = False
) -> MobilityLane:
    """Return a lane.

    Args:
        name: Its name.
        method: Test method.
        about: Description, without a full stop.
        length: Length of the lane without its ends [m].
        shapes: Elements of the lane, from x = 0 to `length`, 1.2 m wide.
        top: Height of its far end [m].
        twice: Whether there and back is one repetition.
    """
    # As thick as it is high: a deck on the floor, with no room below it.
    end = (
        (deck((length, -END_LENGTH / 2), (length + END_LENGTH, END_LENGTH / 2), top, thickness=top),)
        if top
        else ()
    )
    starts = (
        StartPose(tag="PlayerStart", at=(-END_LENGTH / 2, 0.0, START_ELEVATION)),
        StartPose(tag="FarEnd", at=(length + END_LENGTH / 2, 0.0, top + START_ELEVATION), yaw=math.pi),
    )
    arena = ArenaSpec(
        name=f"{LANE_PREFIX}{name}",
        about=f"{about} ({method}).",
        shapes=finished((*shapes, *end, *_walls(length, top)), BARE),
        starts=starts,
        extent=((-END_LENGTH, length + END_LENGTH), (-END_LENGTH / 2, END_LENGTH / 2)),
    )
    return MobilityLane(method=method, arena=arena, length=length, round_trip=twice)


def _ramped(angle: float, run: float) -> Shape:
    return slope((0.0, 0.0, 0.0), (run, 0.0, run * math.tan(angle)), CELL)


def _flight(angle: float, count: int = 7) -> tuple[float, float, tuple[Shape, ...]]:
    """Return run and rise of a flight of stairs, and its steps."""
    # The last rise ends at the deck of the far end: there is one tread less than rises.
    run = (count - 1) * RISE / math.tan(angle)
    return run, count * RISE, stairs((run, 0.0), 0.0, count, angle=angle)


def _stairs(name: str, degrees: float) -> MobilityLane:
    run, rise, steps = _flight(math.radians(degrees))
    about = f"Stairs of {degrees:.0f} degrees, 7 rises of {100 * RISE:.0f} cm"
    return lane_of(name, "ASTM E2804", about, run, *steps, top=rise, twice=True)


def _hurdles(height: float) -> MobilityLane:
    bars = [shape for x in (CELL, 3 * CELL) for shape in hurdle((x, 0.0), height)]
    about = f"Two hurdles of {100 * height:.0f} cm with a pipe on top"
    return lane_of(f"hurdles_{100 * height:.0f}", "ASTM E2802", about, 4 * CELL, *bars)


def _fields(name: str, about: str, unit: float) -> MobilityLane:
    patterns = ("flat", "hill", "diagonal", "flat")
    shapes = [
        shape
        for i, pattern in enumerate(patterns)
        for shape in step_field(((i + 0.5) * CELL, 0.0), pattern, unit=unit)
    ]
    return lane_of(name, "ASTM E2828", about, len(patterns) * CELL, *shapes)


def _gap(width: float, height: float = 0.3) -> MobilityLane:
    side, length = CELL / 2, 4 * CELL
    middle = length / 2
    ramp = CELL
    shapes = (
        slope((0.0, 0.0, 0.0), (ramp, 0.0, height), CELL),
        deck((ramp, -side), (middle - width / 2, side), height, thickness=height),
        deck((middle + width / 2, -side), (length - ramp, side), height, thickness=height),
        slope((length, 0.0, 0.0), (length - ramp, 0.0, height), CELL),
    )
    return lane_of(f"gap_{100 * width:.0f}", "ASTM E2801", f"A gap of {100 * width:.0f} cm", length, *shapes)


def _incline(degrees: float, run: float = 2 * CELL) -> MobilityLane:
    angle = math.radians(degrees)
    about = f"An inclined plane of {degrees:.0f} degrees"
    rise = run * math.tan(angle)
    return lane_of(
        f"incline_{degrees:.0f}", "ASTM E2803", about, run, _ramped(angle, run), top=rise, twice=True
    )


_STEPS_RUN = 2 * CELL
_CORNER = (0.0, -CELL / 2)

LANES: Registry[MobilityLane] = Registry("lane")
"""Lanes by name, with or without `LANE_PREFIX`."""
for _one in (
    lane_of("flat", "ASTM E2829", "A bare floor to drive fast on", 8 * CELL),
    lane_of("continuous", "ASTM E2826", "Continuous ramps of 15 degrees", 4 * CELL, *ramps("><><", _CORNER)),
    lane_of(
        "crossing",
        "ASTM E2827",
        "Crossing half ramps of 15 degrees",
        4 * CELL,
        *ramps(">^<v>^<v\nv>^<v>^<", _CORNER, side=CELL / 2),
    ),
    _fields("stepfield", "Half cubic step fields, posts of up to 20 cm", POST / 2),
    _fields("stepfield_cubic", "Cubic step fields, posts of up to 40 cm", POST),
    _incline(15),
    _incline(30),
    _stairs("stairs", math.degrees(STEEP)),
    _stairs("stairs_45", 45),
    _hurdles(0.1),
    _hurdles(0.2),
    lane_of(
        "pipe_steps",
        "RoboCup Rescue pipe steps, estimated",
        "Four steps of 20 cm with pipes for edges",
        _STEPS_RUN,
        *pipe_steps((0.0, 0.0), 0.0, 4),
        top=0.8,
        twice=True,
    ),
    _gap(0.2),
):
    LANES.add(_one.arena.name.removeprefix(LANE_PREFIX), _one, aliases=(_one.arena.name,))
