"""Arena descriptions: frozen values without behaviour.

Axes are MuJoCo's (z up, x forward, y left; roll, pitch, yaw applied as ZYX), with the floor at height zero;
`ArenaSpec.floor` is the height of that floor in the world. Lengths are metres, angles radians, masses
kilograms. Solids are `types.shapes.Shape`, as robots' are.
"""

from dataclasses import dataclass
from typing import Annotated

from usarmjx.base.settings import NOT_NEGATIVE, POSITIVE, Setting
from usarmjx.base.transforms import Vec3
from usarmjx.models.types.shapes import ZERO, BodyInertia, Rgba, Shape


@dataclass(frozen=True, kw_only=True)
class LooseObject:
    """A loose object of an arena, which robots push, climb, grip and carry.

    Attributes:
        name: Unique within the arena.
        at: Initial position of its origin, in the arena's axes.
        rotation: Roll, pitch, yaw [rad].
        shapes: Its solids; together they need a mass, unless it has an `inertia`.
        inertia: Mass and inertia, in its own axes; None: those of its solids.
    """

    name: str
    at: Vec3
    rotation: Vec3 = ZERO
    shapes: tuple[Shape, ...]
    inertia: BodyInertia | None = None


@dataclass(frozen=True, kw_only=True)
class Door:
    """A door on a hinge, which robots push open; the radio counts it at its present angle.

    Attributes:
        name: Unique within the arena.
        at: Foot of the hinge, in the arena's axes.
        yaw: Direction from the hinge along the closed door [rad].
        size: Width, thickness and height [m].
        limits: Lowest and highest angle [rad]; 0 is closed, positive counter-clockwise seen from above.
        mass: Mass [kg].
        friction: Damping of the hinge [N m s/rad].
        rgba: Colour.
    """

    name: str
    at: Vec3
    yaw: float = 0.0
    size: Annotated[Vec3, POSITIVE] = (0.9, 0.04, 1.2)
    limits: tuple[float, float] = (-1.6, 1.6)
    mass: Annotated[float, POSITIVE] = 8.0
    friction: Annotated[float, NOT_NEGATIVE] = 2.0
    rgba: Rgba = (0.5, 0.35, 0.2, 1.0)


@dataclass(frozen=True, kw_only=True)
class Water:
    """A box of water: lower and upper corner, in the arena's axes; `high[2]` is the surface."""

    low: Vec3
    high: Vec3


START_ELEVATION = 0.188
"""Height of a start pose above the ground under it [m] (manual 5.3.5)."""


def start_tag(number: int) -> str:
    """Return the tag of a start pose: the first of an arena is PlayerStart, as in any map (manual 5.3.2).

    Args:
        number: Its number, from 0.
    """
    return f"Start{number}" if number else "PlayerStart"


@dataclass(frozen=True, kw_only=True)
class StartPose:
    """A named start pose (manual 5.3.2).

    Attributes:
        tag: Its name.
        at: Position, `START_ELEVATION` above the ground [m].
        yaw: Heading, counter-clockwise [rad].
        pitch: Pitch, nose down, on a slope [rad]; robots of a batch begin upright.
        roll: Roll to the right [rad].
    """

    tag: str
    at: Vec3
    yaw: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0

    @property
    def angles(self) -> Vec3:
        """Roll, pitch and yaw [rad]."""
        return (self.roll, self.pitch, self.yaw)


@dataclass(frozen=True, kw_only=True)
class SegmentMotion:
    """The motion of one segment of a victim's body (manual 14.1.3).

    Its joint turns from the first pose to the last one at the given rates and back again, without end (a
    waving hand); a rate of zero keeps that angle at its initial value.

    Attributes:
        name: A bone of `victims.BONES`, as LeftArm.
        initial: First pitch, yaw and roll on its parent bone [rad].
        final: Last pitch, yaw and roll [rad].
        rates: Pitch, yaw and roll rate at `Victim.anim_timer` 1 [rad/s].
        scale: Size of the bone and of its descendants; 0 hides them.
    """

    name: str
    initial: Vec3 = ZERO
    final: Vec3 = ZERO
    rates: Vec3 = ZERO
    scale: float = 1.0


@dataclass(frozen=True, kw_only=True)
class HelpSound:
    """The cries of a victim (manual 10.11, 14.1.3).

    Attributes:
        loudness: Loudness at 1 m.
        duration: Duration of a cry [s].
        pause: Time between two cries [s].
    """

    loudness: float = 1.0
    duration: float = 2.0
    pause: float = 3.0


@dataclass(frozen=True, kw_only=True)
class Victim:
    """A victim (manual 14.1.3).

    Attributes:
        name: Unique within the arena.
        at: Centre of its pelvis, in the arena's axes.
        rotation: Roll, pitch and yaw of its pelvis [rad]; all zero stands upright and looks along x.
        posture: A key of `victims.POSTURES`: the angles of segments without a pose of their own.
        segments: At most 8 segments with poses and motions of their own.
        anim_timer: Factor on the rates of the segments; 0 keeps them still.
        help_sound: Its cries; None: silent.
        breathes: Whether it breathes out CO2.
        state: Condition in words for people: still, moving, hidden behind a board, in a void.
    """

    name: str
    at: Vec3
    rotation: Vec3 = ZERO
    posture: str = "lying"
    segments: tuple[SegmentMotion, ...] = ()
    anim_timer: float = 1.0
    help_sound: HelpSound | None = None
    breathes: bool = True
    state: str = "still"


@dataclass(frozen=True, kw_only=True)
class FalseAlarm:
    """A loose body part that a victim sensor mistakes for one of a victim (manual 10.10).

    Attributes:
        part: A bone of `victims.BONES`.
        at: Its centre, in the arena's axes.
        rotation: Roll, pitch, yaw [rad].
        scale: Size relative to a victim's part.
    """

    part: str
    at: Vec3
    rotation: Vec3 = ZERO
    scale: float = 1.0


AUTOMATIC_TAG_ID = -1
"""ID of a tag that gets the next free one above 1000, which releasers never use (manual 10.9, 11.2)."""


@dataclass(frozen=True, kw_only=True)
class Tag:
    """An RFID tag that lies in the arena from the start (manual 10.9).

    Attributes:
        at: Position, in the arena's axes.
        id: Its ID, above 1000, or `AUTOMATIC_TAG_ID`.
        memory: Text stored on it.
        single_shot: Whether it answers only once.
    """

    at: Vec3
    id: int = AUTOMATIC_TAG_ID
    memory: str = ""
    single_shot: bool = False


@dataclass(frozen=True, kw_only=True)
class Light:
    """A lamp; an arena without any is lit by daylight.

    Attributes:
        at: Position, in the arena's axes.
        brightness: Brightness at 1 m, 1 being a lit white wall.
        rgb: Colour.
    """

    at: Vec3
    brightness: Annotated[float, NOT_NEGATIVE] = 1.0
    rgb: Vec3 = (1.0, 1.0, 1.0)


GpsOrigin = tuple[Annotated[float, Setting(ge=-90, le=90)], Annotated[float, Setting(ge=-180, le=180)]]
"""Latitude and longitude [degrees]."""


@dataclass(frozen=True, kw_only=True)
class ArenaSpec:
    """An arena: a floor and solids on it.

    Attributes:
        name: Level name as the greeting reports it (DM-USAR_yellow).
        aliases: Short names.
        about: Description, in one sentence.
        floor: Height of the floor in the world, z up [m].
        has_floor: Whether an unbounded floor lies at height zero; without it, objects fall for ever.
        shapes: Fixed solids.
        starts: Start poses, in the order in which robots without a pose of their own take them.
        extent: x and y limits of the floor plan ((x0, x1), (y0, y1)), for pictures and random positions.
        loose: Loose objects.
        doors: Doors.
        waters: Volumes of water.
        victims: Victims.
        false_alarms: Loose body parts.
        tags: RFID tags.
        lights: Lamps.
        gps: Latitude and longitude of its origin [degrees], north and east positive; None: unknown.
        robots: Recommended robot classes.
    """

    name: str
    aliases: tuple[str, ...] = ()
    about: str = ""
    floor: float = 0.0
    has_floor: bool = True
    shapes: tuple[Shape, ...] = ()
    starts: tuple[StartPose, ...]
    extent: tuple[tuple[float, float], tuple[float, float]]
    loose: tuple[LooseObject, ...] = ()
    doors: tuple[Door, ...] = ()
    waters: tuple[Water, ...] = ()
    victims: tuple[Victim, ...] = ()
    false_alarms: tuple[FalseAlarm, ...] = ()
    tags: tuple[Tag, ...] = ()
    lights: tuple[Light, ...] = ()
    gps: GpsOrigin | None = None
    robots: tuple[str, ...] = ()
