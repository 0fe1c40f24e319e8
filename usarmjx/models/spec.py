"""What a robot and an arena are made of: frozen values, no code.

Robot descriptions are written in USARSim's axes (x forward, y right, z down; roll, pitch, yaw applied
as ZYX), so that a line can be compared with the manual's tables; `models.compose` converts them once.
Arena descriptions are written in MuJoCo's axes (z up) with the floor at height zero, and say where
that floor lies in the world. Lengths are metres, angles radians, masses kilograms.
"""

from dataclasses import dataclass
from typing import Literal

from usarmjx.transforms import Vec3

ZERO: Vec3 = (0.0, 0.0, 0.0)
CHASSIS = "HARD"
"""The wire's name for 'mounted on the chassis' (captured GEO lines)."""

Options = tuple[tuple[str, object], ...]


def options(**keys: object) -> Options:
    """Return ini-style settings of a mount, as `options(MaxRange=20.0)`."""
    return tuple(keys.items())


@dataclass(frozen=True)
class Surface:
    """How a kind of surface touches others.

    Attributes:
        friction: Sliding friction coefficient.
        priority: MuJoCo's: of two touching surfaces the one with the higher priority sets the friction.
        contype: MuJoCo's collision type bits.
        conaffinity: MuJoCo's collision affinity bits.
    """

    friction: float
    priority: int
    contype: int
    conaffinity: int


HULL, WHEEL, FIXED = 1, 2, 4
"""Collision bits. Fixed things do not touch each other; nor do wheels: a robot's hull covers its wheels, and
cylinder against cylinder is the least reliable pair of MJX-JAX."""

# Friction 0.8 holds a robot on slopes up to 38 degrees. Walls are slick and have the last word, so that
# a robot that pushes one spins its wheels instead of climbing it.
SURFACES = {
    "ground": Surface(friction=0.8, priority=0, contype=FIXED, conaffinity=HULL | WHEEL),
    "wall": Surface(friction=0.3, priority=2, contype=FIXED, conaffinity=HULL | WHEEL),
    "hull": Surface(friction=0.3, priority=0, contype=HULL, conaffinity=HULL | WHEEL | FIXED),
    "wheel": Surface(friction=0.8, priority=0, contype=WHEEL, conaffinity=HULL | FIXED),
    "caster": Surface(friction=0.01, priority=1, contype=WHEEL, conaffinity=HULL | FIXED),
    "fixture": Surface(friction=0.3, priority=0, contype=0, conaffinity=0),  # seen, but never touched
}


@dataclass(frozen=True, kw_only=True)
class Shape:
    """One solid, seen by contacts and by rays.

    Attributes:
        kind: MuJoCo geom type.
        size: MuJoCo's size numbers: half lengths of a box; radius; radius and half length.
        at: Centre, in the axes of the description that holds it.
        rotation: Roll, pitch, yaw.
        mass: Mass; 0 leaves the body's mass to its other shapes.
        surface: A key of `SURFACES`.
        rgba: Colour, for pictures.
    """

    kind: Literal["box", "sphere", "capsule", "cylinder"]
    size: tuple[float, ...]
    at: Vec3 = ZERO
    rotation: Vec3 = ZERO
    mass: float = 0.0
    surface: str = "hull"
    rgba: tuple[float, float, float, float] = (0.7, 0.7, 0.7, 1.0)


@dataclass(frozen=True, kw_only=True)
class Wheel:
    """A powered wheel; `name` is USARSim's joint name, `side` the DRIVE key that turns it."""

    name: str
    at: Vec3
    radius: float
    width: float
    mass: float
    side: Literal["left", "right"]


@dataclass(frozen=True, kw_only=True)
class SkidSteer:
    """Left and right wheels driven against each other (also two wheels and a caster).

    The motors are MuJoCo's integrated-velocity servos: they hold a slope at zero speed, which a plain
    velocity servo does not.

    Attributes:
        max_speed: Highest wheel speed [rad/s].
        torque: Most torque a wheel can exert [N m], near what its tyre can put on the ground.
        stiffness: Servo gain on the wheel's angle [N m/rad].
        damping: Servo gain on the wheel's speed [N m s/rad].
        armature: Motor inertia seen at the wheel [kg m2].
    """

    max_speed: float
    torque: float
    stiffness: float = 100.0
    damping: float = 5.0
    armature: float = 0.1


@dataclass(frozen=True, kw_only=True)
class Link:
    """One part of a mission package, in the manual's GEO and CONF terms (9.3).

    Location and orientation are the link frame's in its parent's frame; the joint turns about (or
    slides along) the link frame's z axis. `min_range` above `max_range` means no limits.
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


@dataclass(frozen=True, kw_only=True)
class MissionPackage:
    """Parts and joints that work together for something else than driving (manual 7)."""

    name: str
    links: tuple[Link, ...]


@dataclass(frozen=True, kw_only=True)
class Mount:
    """A sensor or camera on a robot.

    Attributes:
        kind: Sensor type as on the wire (Sonar, RangeScanner).
        name: Item name (F1, Scanner1).
        at: Position on its parent.
        direction: Roll, pitch, yaw on its parent.
        parent: `HARD`, a wheel's name, or `<Package>_Link<number>`.
        options: Settings that differ from the sensor type's defaults, by the manual's ini keys.
    """

    kind: str
    name: str
    at: Vec3 = ZERO
    direction: Vec3 = ZERO
    parent: str = CHASSIS
    options: Options = ()


@dataclass(frozen=True, kw_only=True)
class RobotSpec:
    """A robot class.

    Attributes:
        name: Class name without `USARBot.`.
        dimensions: Length, width, height as GETGEO reports them.
        mass: Total mass.
        payload: What it can carry.
        origin_height: Chassis origin above flat ground (manual 5.3.6).
        cog: Centre of gravity as GETGEO reports it.
        wheel_radius: Radius of the driven wheels.
        wheel_separation: Lateral distance of the wheels (what odometry divides by).
        wheel_base: Distance of the axles.
        max_torque: What CONF reports, in Unreal units.
        battery_life: [s].
        msg_timer: Time between two reports [s].
    """

    name: str
    dimensions: Vec3
    mass: float
    payload: float
    origin_height: float
    chassis: tuple[Shape, ...]
    wheels: tuple[Wheel, ...]
    drive: SkidSteer
    packages: tuple[MissionPackage, ...]
    sensors: tuple[Mount, ...]
    cameras: tuple[Mount, ...]
    wheel_radius: float
    wheel_separation: float
    wheel_base: float
    cog: Vec3 = ZERO
    max_torque: float = 60.0
    battery_life: float = 1200.0
    msg_timer: float = 0.2
    vehicle: str = "GroundVehicle"
    steering: str = "SkidSteered"


@dataclass(frozen=True, kw_only=True)
class StartPose:
    """A named place to start from; `at` is above the floor, `yaw` counter-clockwise."""

    tag: str
    at: Vec3
    yaw: float = 0.0


@dataclass(frozen=True, kw_only=True)
class ArenaSpec:
    """An arena: a floor and solids on it.

    Attributes:
        name: Level name as the greeting reports it (DM-USAR_yellow).
        aliases: Short names.
        floor: Height of the floor in the world, z up.
        shapes: Fixed solids, with the floor at height zero.
        starts: Start poses, in the order in which robots without a pose of their own take them.
        extent: x and y limits of the floor plan ((x0, x1), (y0, y1)), for pictures and random places.
    """

    name: str
    aliases: tuple[str, ...] = ()
    floor: float = 0.0
    shapes: tuple[Shape, ...] = ()
    starts: tuple[StartPose, ...]
    extent: tuple[tuple[float, float], tuple[float, float]]
