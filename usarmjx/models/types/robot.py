"""Robot descriptions: frozen values. Solids are in `types.shapes`, arenas in `types.arena`.

Axes are USARSim's (x forward, y right, z down; roll, pitch, yaw applied as ZYX), so that a line can be
compared with the manual's tables; `models.compile.compose` converts them once. Lengths are metres, angles
radians, masses kilograms.

A field declares its limits by notes, as `Annotated[float, POSITIVE]`, and the manual's key where it does not
follow from the field's name: `Annotated[float, Setting(manual_key="dBmTXPower")]`. Conditions between two
settings are in the method `problem` of the settings.
"""

import math
import re
from dataclasses import dataclass, fields
from functools import cache
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from usarmjx.base.settings import Setting, describe
from usarmjx.base.transforms import Vec3
from usarmjx.models.drives import Drive
from usarmjx.models.types.shapes import ZERO, BodyInertia, Shape

if TYPE_CHECKING:
    from usarmjx.base.settings.reader import Reader


LEFT: Vec3 = (0.0, -1.0, 0.0)
"""Joint axis of wheels and flippers: a positive angle rolls forward, and turns a front flipper down."""
UP: Vec3 = (0.0, 0.0, -1.0)
"""Joint axis of turntables and steered wheels: a positive angle turns to the left."""
CHASSIS = "HARD"
"""Parent name of an item mounted on the chassis, as on the wire (captured GEO lines)."""
STEER_SUFFIX, SUSPENSION_SUFFIX = "_Steer", "_Suspension"
"""Suffixes of the joints that steer and spring a wheel, after its name: the manual's car-wheel joint
(14.4.2.4) is one joint for all three."""
HOLD_SUFFIX = "/hold"
"""Suffix of the actuator that holds a joint, after the joint's name; see `compose`."""
Options = tuple[tuple[str, object], ...]
"""Ini-style settings: pairs of key and value."""
T = TypeVar("T")
ANGLE_STEP = Setting(ge=1e-5)
"""Limits of an angle between neighbouring rays, or of two ticks [rad]."""
HALF_TURN = Setting(ge=0, le=math.pi + 1e-5)
"""Limits of an angle up to half a turn [rad]; a little more, for 3.1416 in place of 3.1415927."""
TURN = Setting(gt=0, le=2 * math.pi + 1e-5)
"""Limits of an angle up to a full turn [rad]."""


def options(**keys: object) -> Options:
    """Return ini-style settings of a mount, as `options(MaxRange=20.0)`."""
    return tuple(keys.items())


STALL_SPEED = 2.0
"""Speed above which a motor has no more than its torque, whatever its stall torque [rad/s or m/s]."""


@dataclass(frozen=True, kw_only=True)
class Motor:
    """A joint's servo: MuJoCo's integrated-velocity actuator, which holds at zero speed.

    Attributes:
        max_speed: Highest speed [rad/s or m/s].
        torque: Largest torque or force [N m or N].
        stiffness: Gain on the joint's position [N m/rad or N/m].
        damping: Gain on its velocity [N m s/rad or N s/m].
        armature: Inertia of the motor seen at the joint [kg m2 or kg].
        brake: Largest torque or force at speed 0; None: `torque` [N m or N].
        stall_torque: Largest torque or force at standstill, which falls to `torque` at `STALL_SPEED`; None:
            `torque` [N m or N].
    """

    max_speed: float
    torque: float
    stiffness: float = 100.0
    damping: float = 5.0
    armature: float = 0.1
    brake: float | None = None
    stall_torque: float | None = None

    @property
    def strongest(self) -> float:
        """Largest torque or force, moving or standing still [N m or N]."""
        # MuJoCo has one range of force for a joint's actuators, which must allow each of the three.
        return max(self.torque, self.brake or 0.0, self.stall_torque or 0.0)


@dataclass(frozen=True, kw_only=True)
class Spring:
    """A suspension: spring and damper of a joint without a motor.

    Attributes:
        stiffness: [N/m or N m/rad].
        damping: [N s/m or N m s/rad].
        load: Load in the position that the description shows [N or N m].
    """

    stiffness: float
    damping: float
    load: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Part:
    """A part and the one joint that connects it to its parent: the manual's part-joint pair (14.4.2.4).

    Attributes:
        name: Name of part and joint, unique within the robot.
        parent: `HARD`, or the name of a part.
        at: Position of the joint on its parent.
        rotation: Roll, pitch, yaw of the part on its parent at joint position 0.
        axis: Unit vector of the joint, in the part's axes: axis of rotation, or direction of sliding.
        joint: Kind of joint.
        motor: Servo of the joint; None: it moves freely, or on its spring.
        limits: Lowest and highest position; None: no limits. Servos keep their targets within; MuJoCo stops
            joints without a motor.
        spring: Spring and damper.
        geared: Part to whose joint this one is geared: its position follows that one's.
        gear_ratio: Its position over the other one's.
        gear_offset: Its position where the other one's is 0 [rad or m].
        shapes: Its solids; together they need a mass, unless it has an `inertia`.
        inertia: Its mass and inertia; None: those of its solids.
        looks: Visuals: the solids of pictures, instead of `shapes`, which contacts and range sensors use;
            empty: as `shapes`. In the same axes, opaque; mass and surface have no effect.
        is_wheel: Whether DRIVE stops it by speed 0 instead of holding an angle.
    """

    name: str
    parent: str = CHASSIS
    at: Vec3 = ZERO
    rotation: Vec3 = ZERO
    axis: Vec3 = LEFT
    joint: Literal["hinge", "slide"] = "hinge"
    motor: Motor | None = None
    limits: tuple[float, float] | None = None
    spring: Spring | None = None
    geared: str | None = None
    gear_ratio: float = 1.0
    gear_offset: float = 0.0
    shapes: tuple[Shape, ...] = ()
    inertia: BodyInertia | None = None
    looks: tuple[Shape, ...] = ()
    is_wheel: bool = False


@dataclass(frozen=True, kw_only=True)
class Link:
    """One part of a mission package, in the manual's GEO and CONF terms (9.3).

    Location and orientation are the link frame's in its parent's frame; the joint turns about (or slides
    along) the link frame's z axis. `min_range` above `max_range` means no limits. CONF reports `max_torque`,
    in the original's units; the joint itself uses `motor`, and None makes it a servo for parts of about 0.5
    kg with the reported limits. `looks` are as a `Part`'s. `part` names its part and joint if not
    `<Package>_Link<number>`.
    """

    number: int
    parent: int
    location: Vec3
    orientation: Vec3
    max_speed: float
    max_torque: float
    min_range: float
    max_range: float
    shapes: tuple[Shape, ...]
    joint: Literal["Revolute", "Prismatic"] = "Revolute"
    motor: Motor | None = None
    looks: tuple[Shape, ...] = ()
    part: str = ""


@dataclass(frozen=True, kw_only=True)
class MissionPackage:
    """Parts and joints that work together for a purpose other than driving (manual 7).

    Attributes:
        name: Its name.
        links: Its links; a parent is before its children.
        tip: Point of the last link that its user aims, in that link's frame [m]; later versions report it.
    """

    name: str
    links: tuple[Link, ...]
    tip: Vec3 = ZERO


@dataclass(frozen=True, kw_only=True)
class Mount:
    """A sensor, camera or effecter on a robot.

    Attributes:
        kind: Type as on the wire (Sonar, RangeScanner, Gripper).
        name: Item name (F1, Scanner1).
        at: Position on its parent.
        direction: Roll, pitch, yaw on its parent.
        parent: `HARD`, a part's name, or `<Package>_Link<number>`.
        options: Settings of this mount alone, by the manual's ini keys.
        defaults: Settings of its class where they differ from the type's: captured values, or those of the
            class's section of an ini file. Options override them.
    """

    kind: str
    name: str
    at: Vec3 = ZERO
    direction: Vec3 = ZERO
    parent: str = CHASSIS
    options: Options = ()
    defaults: Options = ()

    @property
    def all_options(self) -> Options:
        """Defaults, then options; the last value of a key counts."""
        return (*self.defaults, *self.options)


@dataclass(frozen=True, kw_only=True)
class RobotSpec:
    """A robot class.

    Attributes:
        name: Class name without `USARBot.`.
        dimensions: Length, width, height as GETGEO reports them.
        mass: Total mass as GETCONF reports it.
        payload: Largest load.
        origin_height: Chassis origin above flat ground (manual 5.3.6).
        chassis: Solids of the chassis.
        inertia: Mass and inertia of the chassis; None: those of its solids.
        looks: Visuals of the chassis; see `Part`.
        parts: Parts with joints, parents first.
        drive: Locomotion: the keys of DRIVE and their effect.
        packages: Mission packages.
        sensors: Sensors, in the order of their reports.
        cameras: Cameras.
        effecters: Effecters.
        wheel_radius: Radius of the driven wheels; 0 without wheels.
        wheel_separation: Lateral distance of the wheels, the divisor of odometry.
        wheel_base: Distance of the axles.
        max_torque: Torque that CONF reports, in Unreal units.
        battery_life: Battery life [s].
        msg_timer: Time between two reports [s].
        absolute_camera: Whether angles of CAMERA are absolute, not steps.
        reported_joints: Joints whose positions STA reports (flippers).
        antenna: Position of the radio's antenna on the chassis; None: half its height above the origin.
        sources: Sources of its numbers: (field, `manual 12.x`, `captured`, `data sheet` or `chosen`).
    """

    name: str
    dimensions: Vec3
    mass: float
    payload: float = 0.0
    origin_height: float
    chassis: tuple[Shape, ...]
    inertia: BodyInertia | None = None
    looks: tuple[Shape, ...] = ()
    parts: tuple[Part, ...] = ()
    drive: Drive
    packages: tuple[MissionPackage, ...] = ()
    sensors: tuple[Mount, ...] = ()
    cameras: tuple[Mount, ...] = ()
    effecters: tuple[Mount, ...] = ()
    wheel_radius: float = 0.0
    wheel_separation: float = 0.0
    wheel_base: float = 0.0
    max_torque: float = 60.0
    battery_life: float = 1200.0
    msg_timer: float = 0.2
    absolute_camera: bool = False
    reported_joints: tuple[str, ...] = ()
    antenna: Vec3 | None = None
    sources: tuple[tuple[str, str], ...] = ()

    def __hash__(self) -> int:
        """Return the hash of all fields, computed once: caches of robots look it up at every call."""
        known = vars(self).get("_hash")
        if known is None:
            known = hash(tuple(getattr(self, one.name) for one in fields(self)))
            # The class is frozen; the field is none of those that are compared.
            object.__setattr__(self, "_hash", known)
        return known

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields to pickle, without the hash, which differs between processes."""
        return {name: value for name, value in vars(self).items() if name != "_hash"}

    @property
    def wheels(self) -> tuple[Part, ...]:
        """Parts that roll."""
        return tuple(part for part in self.parts if part.is_wheel)


def field_name(key: str) -> str:
    """Return the field for an ini key: `MaxRange` -> `max_range`, `bWithTimeStamp` -> `with_time_stamp`."""
    # UnrealScript's names of flags begin with a b.
    bare = re.sub(r"^b(?=[A-Z])", "", key)
    # Words begin at a capital after a small letter, and at the last capital of an abbreviation.
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", bare).lower()


def camel_case(field: str) -> str:
    """Return the key of a field, without the b of a flag: `max_range` -> `MaxRange`."""
    return "".join(part[:1].upper() + part[1:] for part in field.split("_"))


@cache
def manual_keys(kind: type[Any]) -> dict[str, str]:
    """Return the manual's keys of settings by field: the declared ones, or `camel_case` of the fields' names.

    Derived keys of flags begin with a b: `with_time_stamp` -> `bWithTimeStamp`.
    """
    flags = {one.name: "b" if isinstance(one.default, bool) else "" for one in describe(kind)}
    return {one.name: one.note.manual_key or flags[one.name] + camel_case(one.name) for one in describe(kind)}


@cache
def field_names(kind: type[Any]) -> dict[str, str]:
    """Return the fields of settings by the `field_name` of their keys."""
    return {field_name(one.note.manual_key) or one.name: one.name for one in describe(kind)}


@cache
def _reader() -> "Reader":
    from usarmjx.base.settings.reader import Reader  # pydantic-core takes 40 ms to import

    return Reader(spelling=field_name)


def _last_of_each(kind: type, overrides: Options) -> dict[str, object]:
    """Return overrides by key; of two spellings of a field the last one counts."""
    names = _reader().names(kind)
    # Keys of no field stay as they are: the reader refuses them by the spelling of the file.
    last = {names.get(field_name(key), key): (key, value) for key, value in overrides}
    return dict(last.values())


def checked(kind: type, overrides: Options, owner: str) -> dict[str, Any]:
    """Return a mount's overrides by field, each checked alone.

    Raises:
        UnknownNameError: The item has no such key; the message lists its keys.
        SpecError: A value of another type than the setting's, or beyond its limits.
    """
    return _reader().values(kind, _last_of_each(kind, overrides), where=owner)


def resolve_settings(kind: type[T], overrides: Options, owner: str) -> T:
    """Return the settings of `kind` (a dataclass) with a mount's overrides applied.

    Raises:
        UnknownNameError: See `checked`.
        SpecError: See `checked`; or settings that contradict each other (`problem`).
    """
    return _reader().from_data(kind, _last_of_each(kind, overrides), where=owner)
