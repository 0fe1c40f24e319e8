"""What a robot is made of: frozen values, no code. Its solids are in `spec.shapes`, arenas in `spec.arena`.

Robot descriptions are written in USARSim's axes (x forward, y right, z down; roll, pitch, yaw applied
as ZYX), so that a line can be compared with the manual's tables; `models.build.compose` converts them once.
Lengths are metres, angles radians, masses kilograms.
"""

from dataclasses import dataclass, fields
from typing import Any, Literal

from usarmjx.base.transforms import Vec3
from usarmjx.models.drives import Drive
from usarmjx.models.types.shapes import ZERO, Shape

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


STALL_SPEED = 2.0
"""Speed up to which a motor with a stall torque has more than its torque [rad/s or m/s]."""


@dataclass(frozen=True, kw_only=True)
class Motor:
    """A joint's servo: MuJoCo's integrated-velocity actuator, which holds at zero speed.

    Attributes:
        max_speed: Highest speed [rad/s or m/s].
        torque: Most it can exert [N m or N].
        stiffness: Gain on the joint's position [N m/rad or N/m].
        damping: Gain on its velocity [N m s/rad or N s/m].
        armature: Inertia of the motor seen at the joint [kg m2 or kg].
        brake: Most it can exert to stand still, told the speed 0; None: its torque [N m or N].
        stall_torque: Most it can exert at standstill, falling to its torque at `STALL_SPEED`; None: no
            more than that [N m or N].
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
        """The most it can exert, moving or standing still [N m or N]."""
        return max(self.torque, self.brake or 0.0, self.stall_torque or 0.0)


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
        looks: What it is drawn as instead of its solids, to which contacts and range sensors keep; empty: as
            these. In the same axes, opaque; mass and surface mean nothing.
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
    looks: tuple[Shape, ...] = ()
    is_wheel: bool = False


@dataclass(frozen=True, kw_only=True)
class Link:
    """One part of a mission package, in the manual's GEO and CONF terms (9.3).

    Location and orientation are the link frame's in its parent's frame; the joint turns about (or
    slides along) the link frame's z axis. `min_range` above `max_range` means no limits. `max_torque` is
    what CONF reports, in the original's units; `motor` says what the joint can do, and None makes it a
    servo for parts of some 0.5 kg with the reported limits. `looks` are as a `Part`'s. `part` is the name of
    its part and joint if it is not `<Package>_Link<number>`.
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
        options: Settings that are this mount's own, by the manual's ini keys.
        defaults: Settings of its class where they differ from the type's: captured figures, or what a
            section of an ini file says of the class instead. Options override them.
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
        """Defaults and options; of a key that stands twice the last counts."""
        return (*self.defaults, *self.options)


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
        looks: What the chassis is drawn as; see `Part`.
        parts: What hangs on it by joints, parents first.
        drive: How DRIVE moves it.
        packages: Mission packages.
        sensors: Sensors, in the order in which they report.
        cameras: Cameras.
        effecters: Effecters.
        wheel_radius: Radius of the driven wheels; 0 without wheels.
        wheel_separation: Lateral distance of the wheels (what odometry divides by).
        wheel_base: Distance of the axles.
        max_torque: What CONF reports, in Unreal units.
        battery_life: [s].
        msg_timer: Time between two reports [s].
        absolute_camera: Whether angles of CAMERA are absolute, not steps.
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
        """Return the hash of all that it says, worked out once: what is resolved of it is looked up by it."""
        known = vars(self).get("_hash")
        if known is None:
            known = hash(tuple(getattr(self, one.name) for one in fields(self)))
            object.__setattr__(self, "_hash", known)
        return known

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled: not the hash, which is another one in each process."""
        return {name: value for name, value in vars(self).items() if name != "_hash"}

    @property
    def wheels(self) -> tuple[Part, ...]:
        """The parts that roll."""
        return tuple(part for part in self.parts if part.is_wheel)
