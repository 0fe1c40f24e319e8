"""What a robot is made of: frozen values, no code. What an arena is made of is in `arena_spec`.

Robot descriptions are written in USARSim's axes (x forward, y right, z down; roll, pitch, yaw applied
as ZYX), so that a line can be compared with the manual's tables; `models.build.compose` converts them once.
Lengths are metres, angles radians, masses kilograms.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from usarmjx.base.transforms import Vec3
from usarmjx.models.drives import Drive

ZERO: Vec3 = (0.0, 0.0, 0.0)
LEFT: Vec3 = (0.0, -1.0, 0.0)
"""Axis of wheels and flippers: a positive angle rolls forward, and turns a front flipper down."""
UP: Vec3 = (0.0, 0.0, -1.0)
CHASSIS = "HARD"
"""The wire's name for 'mounted on the chassis' (captured GEO lines)."""

STEER_SUFFIX, SUSPENSION_SUFFIX = "_Steer", "_Suspension"
"""What follows a wheel's name in the names of the joints that steer and spring it: the manual's car-wheel
joint (14.4.2.4) is one joint for all three."""

HOLD_SUFFIX = "/hold"
"""What follows a joint's name in the name of the actuator that holds it; see `compose`."""

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
        solref: MuJoCo's: time in which a contact settles [s], and its damping ratio.
        solimp: MuJoCo's: share of the force that a contact takes up where it begins and at a depth [m].
    """

    friction: float
    priority: int
    contype: int
    conaffinity: int
    solref: tuple[float, float] = (0.02, 1.0)
    solimp: tuple[float, float, float] = (0.9, 0.95, 0.001)


HULL_BIT, WHEEL_BIT, FIXED_BIT = 1, 2, 4
"""Collision bits. Fixed things do not touch each other; nor do wheels: a robot's hull covers its wheels, and
cylinder against cylinder is the least reliable pair of MJX-JAX."""

# Friction 0.8 holds a robot on slopes up to 38 degrees. Walls are slick and have the last word, so that
# a robot that pushes one spins its wheels instead of climbing it.
SURFACES = {
    "ground": Surface(friction=0.8, priority=0, contype=FIXED_BIT, conaffinity=HULL_BIT | WHEEL_BIT),
    "wall": Surface(friction=0.3, priority=2, contype=FIXED_BIT, conaffinity=HULL_BIT | WHEEL_BIT),
    "hull": Surface(friction=0.3, priority=0, contype=HULL_BIT, conaffinity=HULL_BIT | WHEEL_BIT | FIXED_BIT),
    "wheel": Surface(friction=0.8, priority=0, contype=WHEEL_BIT, conaffinity=HULL_BIT | FIXED_BIT),
    # With 0.8 a Talon hangs between its wheels on stairs of 35 degrees; rubber cleats have more (chosen).
    "track": Surface(friction=1.2, priority=0, contype=WHEEL_BIT, conaffinity=HULL_BIT | FIXED_BIT),
    "caster": Surface(friction=0.01, priority=1, contype=WHEEL_BIT, conaffinity=HULL_BIT | FIXED_BIT),
    # Under a steady load a soft contact creeps, by 0.5 mm/s with MuJoCo's own figures: a brick would be lost
    # after a minute. These make it 0.2 mm/s; still harder ones need more iterations than the solver has.
    "finger": Surface(
        friction=1.5,
        priority=3,
        contype=HULL_BIT,
        conaffinity=HULL_BIT | WHEEL_BIT | FIXED_BIT,
        solref=(0.01, 1.0),
        solimp=(0.95, 0.98, 0.001),
    ),
    "loose": Surface(
        friction=0.6, priority=0, contype=HULL_BIT, conaffinity=HULL_BIT | WHEEL_BIT | FIXED_BIT
    ),
    "fixture": Surface(friction=0.3, priority=0, contype=0, conaffinity=0),  # seen, but never touched
}


OPAQUE, GLASS, MIRROR, FENDER, SKY = "opaque", "glass", "mirror", "fender", "sky"
MATERIALS = (OPAQUE, GLASS, MIRROR, FENDER, SKY)
"""What a solid does to rays (manual 14.1.2), beside stopping them: glass lets infrared and light through,
not sound; a mirror reflects light; a grid fender lets every ray through that meets one of its holes; the sky
lets everything but light through, is never touched, and is no wall to the radio."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """A convex solid: its corners [m] (vertices, 3), of which MuJoCo takes the convex hull."""

    vertices: np.ndarray


@dataclass(frozen=True, eq=False)
class HeightField:
    """Terrain: heights above the shape's place on a regular grid, none below zero [m] (rows, columns).

    Rows run along y, columns along x, from the corner with the lowest of both; the shape's size is half the
    lengths along x and y, and the thickness of the ground below the lowest point.
    """

    heights: np.ndarray


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
        material: What it does to rays; one of `MATERIALS`. Fenders are boxes.
        mesh: The solid of kind mesh.
        heights: The terrain of kind hfield.
        rgba: Colour, for pictures.
    """

    kind: Literal["box", "sphere", "capsule", "cylinder", "ellipsoid", "mesh", "hfield"]
    size: tuple[float, ...] = ()
    at: Vec3 = ZERO
    rotation: Vec3 = ZERO
    mass: float = 0.0
    surface: str = "hull"
    material: str = OPAQUE
    mesh: Mesh | None = None
    heights: HeightField | None = None
    rgba: tuple[float, float, float, float] = (0.7, 0.7, 0.7, 1.0)


@dataclass(frozen=True, kw_only=True)
class Motor:
    """A joint's servo: MuJoCo's integrated-velocity actuator, which holds at zero speed.

    Attributes:
        max_speed: Highest speed [rad/s or m/s].
        torque: Most it can exert [N m or N].
        stiffness: Gain on the joint's position [N m/rad or N/m].
        damping: Gain on its velocity [N m s/rad or N s/m].
        armature: Inertia of the motor seen at the joint [kg m2 or kg].
    """

    max_speed: float
    torque: float
    stiffness: float = 100.0
    damping: float = 5.0
    armature: float = 0.1


@dataclass(frozen=True, kw_only=True)
class Spring:
    """A suspension: spring and damper of a joint without a motor.

    Attributes:
        stiffness: [N/m or N m/rad].
        damping: [N s/m or N m s/rad].
        load: What it carries in the position that the description shows [N or N m].
    """

    stiffness: float
    damping: float
    load: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Part:
    """A part and the one joint that connects it to its parent: the manual's part-joint pair (14.4.2.4).

    Attributes:
        name: Name of part and joint, unique within the robot.
        parent: `HARD`, or the name of a part that hangs on it in turn.
        at: Where the joint is on its parent.
        rotation: Roll, pitch, yaw of the part on its parent at joint position 0.
        axis: Unit vector that the joint turns about or slides along, in the part's axes.
        joint: Kind of joint.
        motor: What moves it; None: it moves freely, or on its spring.
        limits: Lowest and highest position; None: no limits. Servos stay within; joints without a motor
            are stopped by MuJoCo.
        spring: Spring and damper.
        geared: Part whose joint this one's is geared to: both have the same position.
        shapes: Its solids; together they need a mass.
        is_wheel: Whether it is a wheel, which DRIVE stops by zero speed rather than holding an angle.
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
    shapes: tuple[Shape, ...] = ()
    is_wheel: bool = False


@dataclass(frozen=True, kw_only=True)
class Link:
    """One part of a mission package, in the manual's GEO and CONF terms (9.3).

    Location and orientation are the link frame's in its parent's frame; the joint turns about (or
    slides along) the link frame's z axis. `min_range` above `max_range` means no limits. `max_torque` is
    what CONF reports, in the original's units; `motor` says what the joint can do, and None makes it a
    servo for parts of some 0.5 kg with the reported limits.
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


@dataclass(frozen=True, kw_only=True)
class MissionPackage:
    """Parts and joints that work together for something else than driving (manual 7)."""

    name: str
    links: tuple[Link, ...]


@dataclass(frozen=True, kw_only=True)
class Mount:
    """A sensor, camera or effecter on a robot.

    Attributes:
        kind: Type as on the wire (Sonar, RangeScanner, Gripper).
        name: Item name (F1, Scanner1).
        at: Position on its parent.
        direction: Roll, pitch, yaw on its parent.
        parent: `HARD`, a part's name, or `<Package>_Link<number>`.
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
        mass: Total mass as GETCONF reports it.
        payload: What it can carry.
        origin_height: Chassis origin above flat ground (manual 5.3.6).
        chassis: Solids of the chassis.
        parts: What hangs on it by joints, parents first.
        drive: How DRIVE moves it.
        packages: Mission packages.
        sensors: Sensors, in the order in which they report.
        cameras: Cameras.
        effecters: Effecters.
        wheel_radius: Radius of the driven wheels; 0 without wheels.
        wheel_separation: Lateral distance of the wheels (what odometry divides by).
        wheel_base: Distance of the axles.
        cog: Centre of gravity as GETGEO reports it.
        max_torque: What CONF reports, in Unreal units.
        battery_life: [s].
        msg_timer: Time between two reports [s].
        reported_joints: Joints whose positions STA reports (flippers).
        antenna: Where its radio's antenna is on the chassis; None: half its height above the origin.
        sources: Where its figures are from: (field, `manual 12.x`, `captured`, `data sheet` or `chosen`).
    """

    name: str
    dimensions: Vec3
    mass: float
    payload: float = 0.0
    origin_height: float
    chassis: tuple[Shape, ...]
    parts: tuple[Part, ...] = ()
    drive: Drive
    packages: tuple[MissionPackage, ...] = ()
    sensors: tuple[Mount, ...] = ()
    cameras: tuple[Mount, ...] = ()
    effecters: tuple[Mount, ...] = ()
    wheel_radius: float = 0.0
    wheel_separation: float = 0.0
    wheel_base: float = 0.0
    cog: Vec3 = ZERO
    max_torque: float = 60.0
    battery_life: float = 1200.0
    msg_timer: float = 0.2
    reported_joints: tuple[str, ...] = ()
    antenna: Vec3 | None = None
    sources: tuple[tuple[str, str], ...] = ()

    @property
    def wheels(self) -> tuple[Part, ...]:
        """The parts that roll."""
        return tuple(part for part in self.parts if part.is_wheel)
