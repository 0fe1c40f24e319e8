"""What an arena is made of: frozen values, no code.

Arena descriptions are written in MuJoCo's axes (z up, x forward, y left; roll, pitch, yaw applied as ZYX)
with the floor at height zero, and say where that floor lies in the world. Lengths are metres, angles
radians, masses kilograms. Solids are `spec.Shape`, as robots' are.
"""

from dataclasses import dataclass

from usarmjx.base.transforms import Vec3
from usarmjx.models.types.shapes import ZERO, Rgba, Shape


@dataclass(frozen=True, kw_only=True)
class LooseObject:
    """A loose object of an arena: what robots push, climb, grip and carry.

    Attributes:
        name: Unique within the arena.
        at: Where its origin starts, in the arena's axes.
        rotation: Roll, pitch, yaw.
        shapes: Its solids; together they need a mass.
    """

    name: str
    at: Vec3
    rotation: Vec3 = ZERO
    shapes: tuple[Shape, ...]


@dataclass(frozen=True, kw_only=True)
class Door:
    """A door on a hinge, which robots push open; the radio counts it where it stands.

    Attributes:
        name: Unique within the arena.
        at: Foot of the hinge, in the arena's axes.
        yaw: Direction from the hinge along the closed door.
        size: Width, thickness and height.
        limits: Lowest and highest angle; 0 is closed, positive counter-clockwise seen from above.
        mass: Mass.
        friction: What the hinge holds against [N m s/rad].
        rgba: Colour.
    """

    name: str
    at: Vec3
    yaw: float = 0.0
    size: Vec3 = (0.9, 0.04, 1.2)
    limits: tuple[float, float] = (-1.6, 1.6)
    mass: float = 8.0
    friction: float = 2.0
    rgba: Rgba = (0.5, 0.35, 0.2, 1.0)


@dataclass(frozen=True, kw_only=True)
class Water:
    """A box of water: lower and upper corner, in the arena's axes; `high[2]` is the surface."""

    low: Vec3
    high: Vec3


START_ELEVATION = 0.188
"""How high above the ground under it a start pose is given [m] (manual 5.3.5)."""


@dataclass(frozen=True, kw_only=True)
class StartPose:
    """A named place to start from (manual 5.3.2).

    Attributes:
        tag: Its name.
        at: `START_ELEVATION` above the ground there [m].
        yaw: Heading, counter-clockwise [rad].
        pitch: How far the nose is down, on a slope [rad]; robots of a batch begin upright.
        roll: How far it leans to its right [rad].
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
    """How one segment of a victim's body moves (manual 14.1.3).

    Its joint turns from the first pose to the last one at the given rates and back again, over and over
    (a waving hand); a rate of zero keeps that angle where it began.

    Attributes:
        name: A bone of `victims.BONES`, as LeftArm.
        initial: First pitch, yaw and roll on its parent bone.
        final: Last pitch, yaw and roll.
        rates: Pitch, yaw and roll rate at `Victim.anim_timer` 1 [rad/s].
        scale: Size of the bone and of all that hangs on it; 0 hides them.
    """

    name: str
    initial: Vec3 = ZERO
    final: Vec3 = ZERO
    rates: Vec3 = ZERO
    scale: float = 1.0


@dataclass(frozen=True, kw_only=True)
class HelpSound:
    """What a victim is heard by (manual 10.11, 14.1.3).

    Attributes:
        loudness: Loudness at 1 m.
        duration: How long each cry lasts [s].
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
        rotation: Roll, pitch and yaw of its pelvis; all zero stands upright and looks along x.
        posture: A key of `victims.POSTURES`: where the segments are that have no pose of their own.
        segments: At most 8 segments with poses and motions of their own.
        anim_timer: How fast they move; 0 keeps them still.
        help_sound: What is heard of it; None: nothing.
        breathes: Whether it breathes out CO2.
        state: In words for people: still, moving, hidden behind a board, in a void.
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
        rotation: Roll, pitch, yaw.
        scale: Its size beside a victim's.
    """

    part: str
    at: Vec3
    rotation: Vec3 = ZERO
    scale: float = 1.0


AUTOMATIC_TAG_ID = -1
"""A tag with this ID takes the next free one above 1000, which releasers do not give (manual 10.9, 11.2)."""


@dataclass(frozen=True, kw_only=True)
class Tag:
    """An RFID tag that lies in the arena from the start (manual 10.9).

    Attributes:
        at: Where it is, in the arena's axes.
        id: Its ID, above 1000, or `AUTOMATIC_TAG_ID`.
        memory: What is written on it.
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
        at: Where it is, in the arena's axes.
        brightness: Brightness at 1 m, 1 being a lit white wall.
        rgb: Colour.
    """

    at: Vec3
    brightness: float = 1.0
    rgb: Vec3 = (1.0, 1.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class ArenaSpec:
    """An arena: a floor and solids on it.

    Attributes:
        name: Level name as the greeting reports it (DM-USAR_yellow).
        aliases: Short names.
        about: What it is, in a sentence.
        floor: Height of the floor in the world, z up.
        has_floor: Whether there is an unbounded floor at height zero; without it, what falls falls.
        shapes: Fixed solids.
        starts: Start poses, in the order in which robots without a pose of their own take them.
        extent: x and y limits of the floor plan ((x0, x1), (y0, y1)), for pictures and random places.
        loose: Loose objects.
        doors: Doors.
        waters: Volumes of water.
        victims: Victims.
        false_alarms: Body parts that lie about.
        tags: RFID tags.
        lights: Lamps.
        gps: Latitude and longitude of its origin [degrees], north and east positive; None: not known.
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
    gps: tuple[float, float] | None = None
    robots: tuple[str, ...] = ()
