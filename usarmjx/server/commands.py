"""What a client can ask, as values; numbers stay in the wire's frame and units (manual 9.4).

`parse_command` has three outcomes: a command, `Ignored` with a reason for the log, or PeerError
for a number that is not finite. The original answers neither of the last two and keeps the
connection, so then nothing is sent and the robot goes on doing what it was told before.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from usarmjx.registry import Registry
from usarmjx.server.grammar import (
    Message,
    Vector,
    clip,
    to_bool,
    to_float,
    to_int,
    to_vector,
)

_CLASS_PREFIX = "usarbot."
# Keys that mark the other forms of DRIVE in manual 9.4, and the form that each belongs to.
_OTHER_DRIVES = {
    "speed": "Ackermann",
    "frontsteer": "Ackermann",
    "rearsteer": "Ackermann",
    "propeller": "underwater",
    "rudder": "underwater",
    "sternplane": "underwater",
    "altitudevelocity": "aerial",
    "linearvelocity": "aerial",
    "lateralvelocity": "aerial",
    "rotationalvelocity": "aerial",
    "wheelnumber": "omnidirectional",
    "name": "joint",
}


@dataclass(frozen=True, slots=True)
class Init:
    """Add the client's robot to the world.

    Attributes:
        class_name: Robot class without the `USARBot.` in front, as the client spelled it.
        name: Robot name, "" when the simulator shall choose one.
        location: Where to put it in the wire's frame [m], None when not given.
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
class Drive:
    """Drive a skid-steered robot, switch its headlight, put it back on its wheels.

    Attributes:
        left: Spin of the left wheels, positive is forward [rad/s, or percent of the top speed if
            `normalized`]; None keeps what it was.
        right: The same for the right wheels.
        normalized: Whether the speeds are -100 to 100.
        light: Headlight on or off, None keeps it.
        flip: Whether to turn the robot over.
    """

    left: float | None = None
    right: float | None = None
    normalized: bool = False
    light: bool | None = None
    flip: bool = False


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
    """Move links of the mission package called `name`."""

    name: str
    links: tuple[LinkCommand, ...]


@dataclass(frozen=True, slots=True)
class Set:
    """Give a sensor or an effecter an operation; `params` is as sent, "" when absent."""

    type: str
    name: str
    opcode: str
    params: str = ""


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
class Ignored:
    """A line that has no effect and no answer; `reason` is for the log."""

    reason: str


Command: TypeAlias = Init | GetStartPoses | Drive | MisPkg | Set | GetGeo | GetConf
CommandParser: TypeAlias = Callable[[Message], Command | Ignored]

COMMANDS = Registry[CommandParser]("command")


def parse_command(message: Message) -> Command | Ignored:
    """Return what the message asks for.

    Raises:
        PeerError: It holds a number that is not finite.
    """
    if message.kind not in COMMANDS:
        return Ignored(f"{clip(message.kind)} is not supported")
    return COMMANDS.get(message.kind)(message)


def _init(message: Message) -> Command | Ignored:
    class_name = message.get("ClassName")
    if class_name.lower().startswith(_CLASS_PREFIX):
        class_name = class_name[len(_CLASS_PREFIX) :]
    if not class_name:
        return Ignored("INIT without a ClassName")
    location, rotation = _vector(message.get("Location")), _vector(message.get("Rotation"))
    return Init(class_name, message.get("Name"), location, rotation, message.get("Start"))


def _vector(text: str) -> Vector | None:
    # Missing components are 0 and a fourth is dropped; the manual itself prints one (5.3.3).
    x, y, z, *_ = (*to_vector(text), 0.0, 0.0, 0.0)
    return (x, y, z) if text else None


def _get_start_poses(message: Message) -> Command | Ignored:
    del message  # it has no arguments
    return GetStartPoses()


def _drive(message: Message) -> Command | Ignored:
    left, right, light = (message.get(key) for key in ("Left", "Right", "Light"))
    if not (left or right):
        for key, _ in message.segments:
            if key.lower() in _OTHER_DRIVES:
                return Ignored(f"{_OTHER_DRIVES[key.lower()]} DRIVE is not supported")
    command = Drive(
        left=to_float(left) if left else None,
        right=to_float(right) if right else None,
        normalized=to_bool(message.get("Normalized")),
        light=to_bool(light) if light else None,
        flip=to_bool(message.get("Flip")),
    )
    if command == Drive(normalized=command.normalized):
        return Ignored("DRIVE without anything to do")
    return command


def _mis_pkg(message: Message) -> Command | Ignored:
    name = message.get("Name")
    if not name:
        return Ignored("MISPKG without a Name")
    # A link's segments come in any order, so a key that repeats is what starts the next link.
    groups: list[dict[str, str]] = [{}]
    for key, value in message.segments:
        field = key.lower()
        if field in ("link", "value", "order"):
            if field in groups[-1]:
                groups.append({})
            groups[-1][field] = value
    if any("link" not in group for group in groups):
        return Ignored("MISPKG with no Link, or a Value or Order that belongs to none")
    return MisPkg(name, tuple(_link(group) for group in groups))


def _link(group: dict[str, str]) -> LinkCommand:
    value, order = group.get("value", ""), group.get("order", "")
    return LinkCommand(to_int(group["link"]), to_float(value), to_int(order))


def _set(message: Message) -> Command | Ignored:
    item_type = message.get("Type")
    keys = {key.lower() for key, _ in message.segments}
    if not item_type:
        return Ignored("SET without a Type")
    if item_type.lower() in ("joint", "viewports"):
        return Ignored(f"SET of type {clip(item_type)} is not supported")
    # Checked before the field of view: a viewpoint command of an image client must not zoom.
    if keys & {"client", "robot"}:
        return Ignored("SET of a viewpoint is not supported")
    if "fov" in keys:
        return Ignored("SET of a field of view is not supported")
    return Set(item_type, message.get("Name"), message.get("Opcode"), message.get("Params"))


def _get_geo(message: Message) -> Command | Ignored:
    item_type = message.get("Type")
    return GetGeo(item_type, message.get("Name")) if item_type else Ignored("GETGEO without a Type")


def _get_conf(message: Message) -> Command | Ignored:
    item_type = message.get("Type")
    if not item_type:
        return Ignored("GETCONF without a Type")
    return GetConf(item_type, message.get("Name"))


COMMANDS.add("INIT", _init)
COMMANDS.add("GETSTARTPOSES", _get_start_poses)
COMMANDS.add("DRIVE", _drive)
COMMANDS.add("MISPKG", _mis_pkg, aliases=("MISPGK",))  # the manual's heading has it wrong
COMMANDS.add("SET", _set)
COMMANDS.add("GETGEO", _get_geo)
COMMANDS.add("GETCONF", _get_conf)
