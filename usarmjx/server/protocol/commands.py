"""Commands of a client as values (manual 9.4), and the phases of a dialogue in which each is legal.

Numbers stay in the wire's axes and units; `command_parsers` makes these values of messages.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import TypeAlias, get_args

from usarmjx.server.protocol.grammar import Message, Vector

DRIVE_KEYS = (
    *("Left", "Right"),  # skid-steered
    *("Speed", "FrontSteer", "RearSteer"),  # Ackermann-steered
    *("Propeller", "Rudder", "SternPlane"),  # underwater
    *("AltitudeVelocity", "LinearVelocity", "LateralVelocity", "RotationalVelocity"),  # aerial
    *("XZAngle", "ThrustPropeller", "TailPropeller"),  # Passarola
)
"""Keys of a `DriveRobot` in the spelling of manual 9.4 and, for Passarola, 12.21.3."""
TRACE_COLORS = ("Red", "Yellow", "Green", "Cyan", "White", "Blue", "Purple")
"""Colours of a trace in the order of their numbers (manual 9.4)."""


@dataclass(frozen=True, slots=True)
class Init:
    """Add the client's robot to the world.

    Attributes:
        class_name: Robot class without the `USARBot.` in front, as the client spelled it.
        name: Robot name, "" for one that the simulator chooses.
        location: Position in the wire's frame [m], None when not given.
        rotation: Roll, pitch, yaw in the wire's frame [rad], None when not given.
        start: Tag of a start pose, "" when not given; it overrides the location (an extension of
            newer servers that clients already send).
    """

    class_name: str
    name: str = ""
    location: Vector | None = None
    rotation: Vector | None = None
    start: str = ""


@dataclass(frozen=True, slots=True)
class GetStartPoses:
    """List the arena's start poses (manual 5.3.3)."""


@dataclass(frozen=True, slots=True)
class DriveRobot:
    """Drive a robot as a whole, switch its headlight, turn it upright.

    Attributes:
        values: Those of `DRIVE_KEYS` that the client sent, with their numbers, in its order; a key
            that is absent keeps its value. Left, Right, Speed, Propeller, RotationalVelocity,
            TailPropeller [rad/s]; FrontSteer, RearSteer, Rudder, SternPlane, XZAngle [rad]; the
            others [m/s]. Signs are the wire's own: FrontSteer and TailPropeller are positive to the
            left, Rudder to the right (manual 9.4, 12.21.3).
        normalized: Whether the numbers are -100 to 100, percents of each one's maximum.
        light: Headlight on or off, None keeps it.
        flip: Whether to turn the robot over.
    """

    values: tuple[tuple[str, float], ...] = ()
    normalized: bool = False
    light: bool | None = None
    flip: bool = False


@dataclass(frozen=True, slots=True)
class WheelCommand:
    """One wheel of a `DriveWheels`.

    Attributes:
        number: Number of the wheel, from 0.
        speed: Spin [rad/s], None keeps it.
        steer: Steering angle [rad], None keeps it.
    """

    number: int
    speed: float | None
    steer: float | None


@dataclass(frozen=True, slots=True)
class DriveWheels:
    """Drive an OmniDrive robot wheel by wheel; the rest is as in `DriveRobot`."""

    wheels: tuple[WheelCommand, ...]
    normalized: bool = False
    light: bool | None = None
    flip: bool = False


@dataclass(frozen=True, slots=True)
class DriveJoint:
    """Move the joint called `name` (the sixth kind of DRIVE).

    Attributes:
        name: Name of the joint, as the client spelled it.
        order: 0 for an angle, 1 for a speed, 2 for a torque; servers also knew 3 (brake) and
            10 to 12 (the same as 0 to 2, relative).
        value: Angle [rad], speed [rad/s] or torque; None keeps the joint's command and only steers
            it, as in the manual's `{Name LeftFWheel} {Steer 1.57}`.
        steer: Steering angle of a wheel [rad], None keeps it.
    """

    name: str
    order: int = 0
    value: float | None = 0.0
    steer: float | None = None


@dataclass(frozen=True, slots=True)
class MultiDrive:
    """Move joints to absolute angles: (name as spelled, angle [rad]) in the client's order."""

    joints: tuple[tuple[str, float], ...]


@dataclass(frozen=True, slots=True)
class LinkCommand:
    """One link of a `MisPkg`.

    Attributes:
        link: Number of the link, from 1.
        value: Angle [rad] or distance [m] for order 0, speed for 1, torque for 2.
        order: 0, 1 or 2; servers also knew 3 (brake) and 10 to 12 (the same, relative).
    """

    link: int
    value: float = 0.0
    order: int = 0


@dataclass(frozen=True, slots=True)
class MisPkg:
    """Move links of the mission package called `name`.

    Attributes:
        name: Its name, as the client spelled it.
        links: The links.
        gripper: Whether grippers on it close (not 0) or open (0); None keeps them. The later versions' key.
    """

    name: str
    links: tuple[LinkCommand, ...]
    gripper: int | None = None


@dataclass(frozen=True, slots=True)
class Set:
    """Operate a sensor or an effecter; `params` is as sent, "" when absent."""

    type: str
    name: str
    opcode: str
    params: str = ""


@dataclass(frozen=True, slots=True)
class SetJoint:
    """Move a joint by SET; unlike the SET of a sensor it is never answered with a RES (KRobot.uc).

    Attributes:
        name: Name of the joint, as the client spelled it.
        order: 0 to 2 or 10 to 12, as in `DriveJoint`. For 0 the manual's text has an angle to add
            to the present one, KRobot.uc the same absolute angle as DRIVE.
        value: Angle [rad], speed [rad/s] or torque.
        steer: Steering angle of a wheel [rad], None keeps it.
    """

    name: str
    order: int
    value: float
    steer: float | None


@dataclass(frozen=True, slots=True)
class SetStiffness:
    """Soften a joint's servo by SET; as `SetJoint`, it has no answer if it succeeds (LeggedRobot.uc).

    Attributes:
        name: Name of the joint, as the client spelled it.
        share: Share of the servo's gains and torque, 0 to 1.
    """

    name: str
    share: float


@dataclass(frozen=True, slots=True)
class SetFov:
    """Zoom cameras: (name as spelled, field of view [rad]) in the client's order.

    A field of view of 0 is the default one, None is what was no number.
    """

    cameras: tuple[tuple[str, float | None], ...]


@dataclass(frozen=True, slots=True)
class InvalidSet:
    """SET that cannot be carried out as it stands; its answer is `Failed`, and its reason is a fault.

    Attributes:
        type: Type as sent.
        name: Name as sent, "" when absent.
    """

    type: str
    name: str = ""


@dataclass(frozen=True, slots=True)
class SetViewports:
    """Arrange the pictures of the robot's cameras.

    Attributes:
        config: "SingleView", "QuadView", either's number, or anything else as sent; "" keeps it.
        cameras: Number of the viewport, from 1, and name of the camera or "Disable"; others are kept.
    """

    config: str = ""
    cameras: tuple[tuple[int, str], ...] = ()


@dataclass(frozen=True, slots=True)
class SetView:
    """Bind the view of an image client to a camera, or unbind it.

    Attributes:
        client: The client's IP address as sent; with `:port` behind it, only its connection from there.
        robot: Name of a robot; "" unbinds.
        name: Name of its camera; "" means its viewports.
    """

    client: str
    robot: str = ""
    name: str = ""


@dataclass(frozen=True, slots=True)
class Trace:
    """Start or stop a trace of coloured points behind the robot.

    Attributes:
        on: Whether to leave points.
        interval: Time between two points [s].
        color: One of `TRACE_COLORS`.
    """

    on: bool
    interval: float = 0.0
    color: str = TRACE_COLORS[0]


@dataclass(frozen=True, slots=True)
class TurnCamera:
    """Turn the robot's first camera and zoom: CAMERA (manual 12.1.2, 14.4.3), as SimpleUI sends it.

    Attributes:
        rotation: Roll, tilt and pan in the wire's frame [rad], or their rates or torques; None keeps them.
        order: Quantity of `rotation`, as in MISPKG.
        fov: Field of view [rad], 0 for the default; None keeps it.
    """

    rotation: Vector | None = None
    order: int = 0
    fov: float | None = None


@dataclass(frozen=True, slots=True)
class GetGeo:
    """Ask for the geometry of all items of a type, or of the one called `name` if not ""."""

    type: str
    name: str = ""


@dataclass(frozen=True, slots=True)
class GetConf:
    """Ask for the configuration of all items of a type, or of the one called `name` if not ""."""

    type: str
    name: str = ""


@dataclass(frozen=True, slots=True)
class PathOptions:
    """Waypoints of an object and how it moves along them (WorldController.uc); None: unchanged.

    Attributes:
        points: Waypoints in the wire's frame [m].
        speed: Speed [m/s]; 0 when not given.
        time: Time for the whole path [s]; 0 when not given.
        move: Whether it moves.
        loop: Whether the path is closed.
        align: Whether the object points along it.
        reset: Whether it returns to its first pose when the points are cleared.
    """

    points: tuple[Vector, ...] = ()
    speed: float = 0.0
    time: float = 0.0
    move: bool | None = None
    loop: bool | None = None
    align: bool | None = None
    reset: bool | None = None


@dataclass(frozen=True, slots=True)
class Control:
    """Control the world: CONTROL of the later versions, for a world controller (WorldController.uc).

    Attributes:
        type: GetSTA, AbsMove, RelMove, Create, Kill, KillAll, SetWP, AddWP, ClearWP, Rotate, Conveyor, or
            anything else as sent.
        name: Name of an object or a robot, "" when absent.
        class_name: Class of objects, "" when absent.
        location: Position or its change in the wire's frame [m], None when not given.
        rotation: Roll, pitch and yaw or their changes [rad], None when not given.
        start: Tag of a start pose for a new object, "" when absent.
        scale: Factors of the lengths of a new object, None when not given.
        physics: Physics of a new object as sent, "" when absent.
        permanent: Whether KillAll leaves a new object.
        corners: Lower and upper corner of what KillAll clears, in the wire's frame [m]; None for all.
        spin: Changes of roll, pitch and yaw [rad/s], None when not given.
        path: Waypoints and how to move along them.
        share: Speed of a conveyor as a share of its own, None when not given.
    """

    type: str
    name: str = ""
    class_name: str = ""
    location: Vector | None = None
    rotation: Vector | None = None
    start: str = ""
    scale: Vector | None = None
    physics: str = ""
    permanent: bool = False
    corners: tuple[Vector, Vector] | None = None
    spin: Vector | None = None
    path: PathOptions = PathOptions()
    share: float | None = None


@dataclass(frozen=True, slots=True)
class OwnCommand:
    """Command beyond the manual's (14.4.3), registered with `adapter.add_command`.

    Attributes:
        action: Function of the world, the robot and the message; returns the answer.
        message: The client's message.
    """

    action: Callable[..., Message | None]
    message: Message


@dataclass(frozen=True, slots=True)
class Ignored:
    """A line that has no effect and no answer; `reason` is for the log."""

    reason: str


Command: TypeAlias = (
    Init
    | GetStartPoses
    | DriveRobot
    | DriveWheels
    | DriveJoint
    | MultiDrive
    | MisPkg
    | Set
    | SetJoint
    | SetStiffness
    | InvalidSet
    | SetFov
    | SetViewports
    | SetView
    | Trace
    | TurnCamera
    | GetGeo
    | GetConf
    | Control
    | OwnCommand
)


class SessionPhase(Enum):
    """Phase of a client's dialogue."""

    GREETED = "greeted"
    ACTIVE = "active"
    CLOSED = "closed"


# The original ignores an illegal command silently; here its reason goes to the log. A second INIT is illegal:
# servers disagree (one adds a robot and forgets the first, another ignores the line), and one robot per
# connection is the rule.
LEGAL_COMMANDS: dict[SessionPhase, frozenset[type[Command]]] = {
    SessionPhase.GREETED: frozenset({Init, GetStartPoses, SetView}),
    SessionPhase.ACTIVE: frozenset(kind for kind in get_args(Command) if kind is not Init),
    SessionPhase.CLOSED: frozenset(),
}
"""Commands that each phase accepts; a new one of `Command` is legal once the client has a robot.

An accepted Init leads to ACTIVE, `RobotSession.close` to CLOSED; nothing else changes the phase.
"""
