"""Parsers of a client's messages (manual 9.4): one function per head, and their registry.

`parse_command` has three outcomes: a command, `Ignored` with a reason for the log, or PeerError
for an argument that has not its form (`arguments`) or is not finite. The original answers neither of the
last two and keeps the connection, so then the robot keeps its present command, and nothing is sent but the
`Failed` of a SET.
"""

from collections.abc import Callable
from typing import TypeAlias

from usarmjx.base.errors import PeerError
from usarmjx.base.registry import Registry
from usarmjx.base.settings import SHARE, Parameters
from usarmjx.server.protocol.arguments import check_arguments, read_parameters
from usarmjx.server.protocol.commands import (
    DRIVE_KEYS,
    TRACE_COLORS,
    Command,
    Control,
    DriveJoint,
    DriveRobot,
    DriveWheels,
    GetConf,
    GetGeo,
    GetStartPoses,
    Ignored,
    Init,
    LinkCommand,
    MisPkg,
    MultiDrive,
    PathOptions,
    Set,
    SetFov,
    SetJoint,
    SetStiffness,
    SetView,
    SetViewports,
    Trace,
    TurnCamera,
    WheelCommand,
)
from usarmjx.server.protocol.grammar import (
    Message,
    Segment,
    Vector,
    clip,
    is_number,
    to_bool,
    to_float,
    to_int,
    to_vector,
)

_CLASS_PREFIX = "usarbot."
_SPELLINGS = {key.lower(): key for key in DRIVE_KEYS}
_WHEEL_KEYS = ("wheelnumber", "wheelspeed", "wheelsteer")
_LINK_KEYS = ("link", "value", "order")
# The relative ones are not in the manual; all six are in KRobot.uc, each also as its number.
_OPCODES = {"angle": 0, "velocity": 1, "torque": 2, "relangle": 10, "relvelocity": 11, "reltorque": 12}
_JOINT_ORDERS = _OPCODES | {str(order): order for order in _OPCODES.values()}
_JOINT_PARAMETERS = Parameters(0, 2)
_STIFFNESS_PARAMETERS = Parameters(1, 1, SHARE)
_VIEWPORTS = ("Viewport1", "Viewport2", "Viewport3", "Viewport4")
MOST_COMPONENTS = 4
"""Most numbers of a location or rotation; six are three with decimal commas."""
_NOTHING_TO_DO = Ignored("DRIVE without anything to do")

CommandParser: TypeAlias = Callable[[Message], Command | Ignored]

COMMANDS = Registry[CommandParser]("command")


def parse_command(message: Message) -> Command | Ignored:
    """Return the command of a message.

    Raises:
        PeerError: An argument has not its form, or is a number that is not finite.
    """
    if message.kind not in COMMANDS:
        return Ignored(f"{clip(message.kind)} is not supported")
    check_arguments(message)
    return COMMANDS.get(message.kind)(message)


def _init(message: Message) -> Command | Ignored:
    class_name = message.get("ClassName")
    # The manual writes USARBot.P2AT (9.4): Unreal's package, which names no class here.
    if class_name.lower().startswith(_CLASS_PREFIX):
        class_name = class_name[len(_CLASS_PREFIX) :]
    if not class_name:
        return Ignored("INIT without a ClassName")
    location, rotation = _vector(message.get("Location")), _vector(message.get("Rotation"))
    return Init(class_name, message.get("Name"), location, rotation, message.get("Start"))


def _vector(text: str) -> Vector | None:
    # Missing components are 0 and a fourth is dropped; the manual itself prints one (5.3.3).
    numbers = to_vector(text)
    if len(numbers) > MOST_COMPONENTS:
        raise PeerError(f"{clip(text)} has {len(numbers)} numbers, expected 3")
    x, y, z, *_ = (*numbers, 0.0, 0.0, 0.0)
    return (x, y, z) if text else None


def _get_start_poses(message: Message) -> Command | Ignored:
    del message  # it has no arguments
    return GetStartPoses()


def _drive(message: Message) -> Command | Ignored:
    light = message.get("Light")
    normalized, flip = to_bool(message.get("Normalized")), to_bool(message.get("Flip"))
    # An absent Light is not False: it keeps the headlight as it is.
    switches = (normalized, to_bool(light) if light else None, flip)
    if any(message.all("WheelNumber")):
        return _drive_wheels(message, switches)
    values = {
        _SPELLINGS[key]: to_float(value)
        for key, (_, value) in _firsts(message).items()
        if value and key in _SPELLINGS
    }
    # After the keys of a robot's drive: a DRIVE with both is one of the robot, as in KRobot.uc.
    if message.get("Name") and not values:
        return _drive_joint(message)
    command = DriveRobot(tuple(values.items()), *switches)
    # `Normalized` alone says how to read numbers, and there are none.
    return _NOTHING_TO_DO if command == DriveRobot(normalized=normalized) else command


def _firsts(message: Message) -> dict[str, Segment]:
    """Return the first segment of each key, by its lower case: the original finds no other (GetArgVal)."""
    firsts: dict[str, Segment] = {}
    for key, value in message.segments:
        firsts.setdefault(key.lower(), (key, value))
    return firsts


def _drive_wheels(message: Message, switches: tuple[bool, bool | None, bool]) -> Command | Ignored:
    groups = _groups(message, _WHEEL_KEYS)
    if not all(group.get("wheelnumber") for group in groups):
        return Ignored("DRIVE with a WheelSpeed or WheelSteer that belongs to no WheelNumber")
    _, light, flip = switches
    if light is None and not flip and not any(g.get("wheelspeed") or g.get("wheelsteer") for g in groups):
        return _NOTHING_TO_DO
    return DriveWheels(tuple(_wheel(group) for group in groups), *switches)


def _wheel(group: dict[str, str]) -> WheelCommand:
    speed, steer = group.get("wheelspeed", ""), group.get("wheelsteer", "")
    return WheelCommand(to_int(group["wheelnumber"]), _number(speed), _number(steer))


def _drive_joint(message: Message) -> Command:
    order, steer = to_int(message.get("Order")), _number(message.get("Steer"))
    value = _number(message.get("Value"))
    # Without numbers the value counts as 0, as atof has it; None would leave nothing to do.
    if value is None and steer is None:
        value = 0.0
    return DriveJoint(message.get("Name"), order, value, steer)


def _number(text: str) -> float | None:
    return to_float(text) if text else None


def _multi_drive(message: Message) -> Command | Ignored:
    joints = tuple((name, to_float(value)) for name, value in _firsts(message).values() if value)
    return MultiDrive(joints) if joints else Ignored("MULTIDRIVE without anything to do")


def _groups(message: Message, keys: tuple[str, ...]) -> list[dict[str, str]]:
    # The segments of one item come in any order, so only a repeated key marks the start of the next item.
    groups: list[dict[str, str]] = [{}]
    for key, value in message.segments:
        field = key.lower()
        if field in keys:
            if field in groups[-1]:
                groups.append({})
            groups[-1][field] = value
    return groups


def _mis_pkg(message: Message) -> Command | Ignored:
    name = message.get("Name")
    if not name:
        return Ignored("MISPKG without a Name")
    # A line with both is of the present form: its links count.
    if not message.all("Link") and message.get("Rotation"):
        return _mis_pkg_rotation(message, name)
    groups, gripper = _groups(message, _LINK_KEYS), message.get("Gripper")
    # A Gripper alone moves no link: the later versions send it so, as ACT.
    if any("link" not in group for group in groups):
        if any(groups) or not gripper:
            return Ignored("MISPKG with no Link, or a Value or Order that belongs to none")
        return MisPkg(name, (), to_int(gripper))
    return MisPkg(name, tuple(_link(group) for group in groups), to_int(gripper) if gripper else None)


def _mis_pkg_rotation(message: Message, name: str) -> Command:
    """Read the form from before links had numbers, `{Rotation 0,pan,tilt}`, which Player and SPQR still send.

    Its pan is positive to the right, as yaw is on the wire; that of a camera's link 1 to the left.
    """
    _, pan, tilt = _vector(message.get("Rotation")) or (0.0, 0.0, 0.0)
    order = to_int(message.get("Order"))
    return MisPkg(name, (LinkCommand(1, -pan, order), LinkCommand(2, tilt, order)))


def _link(group: dict[str, str]) -> LinkCommand:
    value, order = group.get("value", ""), group.get("order", "")
    return LinkCommand(to_int(group["link"]), to_float(value), to_int(order))


def _set(message: Message) -> Command | Ignored:
    item_type = message.get("Type")
    keys = {key.lower() for key, _ in message.segments}
    if not item_type and "typeviewports" in keys:  # a missing space in one of the manual's examples (9.4)
        item_type = "Viewports"
    if not item_type:
        return Ignored("SET without a Type")
    if item_type.lower() == "joint":
        return _set_joint(message)
    if item_type.lower() == "viewports":
        return _set_viewports(message)
    if item_type.lower() == "camera":
        # Checked before the field of view: a viewpoint command of an image client must not zoom.
        if keys & {"client", "robot"}:
            return _set_view(message)
        if "fov" in keys:
            return _set_fov(message)
    # Params stay text: their form depends on the opcode, and only the item knows its opcodes.
    return Set(item_type, message.get("Name"), message.get("Opcode"), _params(message))


def _params(message: Message) -> str:
    params = message.get("Params")
    if params or message.get("Opcode").lower() != "zoom":
        return params
    # `{Opcode Zoom} {0.5}`: some clients send the number as a segment of its own, without the key Params.
    return next((key for key, value in message.segments if key[0] in "+-.0123456789" and not value), "")


def _set_viewports(message: Message) -> Command:
    cameras = tuple(
        (number, message.get(key)) for number, key in enumerate(_VIEWPORTS, 1) if message.all(key)
    )
    return SetViewports(message.get("Config"), cameras)


def _set_view(message: Message) -> Command | Ignored:
    client, robot = message.get("Client"), message.get("Robot")
    if not client:
        return Ignored("SET of a viewpoint without a Client")
    # Without a robot the view is unbound, and the name of a camera means nothing.
    return SetView(client, robot, message.get("Name") if robot else "")


def _set_fov(message: Message) -> Command | Ignored:
    groups = _groups(message, ("name", "fov"))
    if not all(group.get("name") and group.get("fov") for group in groups):
        return Ignored("SET of a camera with a Name or a FOV that lacks the other")
    return SetFov(tuple((group["name"], _fov(group["fov"])) for group in groups))


def _fov(text: str) -> float | None:
    """Return a field of view; None for what is none: the other cameras of the line zoom all the same."""
    try:
        return to_float(text) if is_number(text) else None
    except PeerError:
        return None


def _trace(message: Message) -> Command:
    color = message.get("Color")
    # By name or by number, as the manual's examples have either.
    # An unknown colour is no fault: the trace is left in the first one.
    names = {name.lower(): name for name in TRACE_COLORS} | {
        str(n): name for n, name in enumerate(TRACE_COLORS)
    }
    interval = max(0.0, to_float(message.get("Interval") or "0"))
    return Trace(to_bool(message.get("On")), interval, names.get(color.lower(), TRACE_COLORS[0]))


def _set_joint(message: Message) -> Command | Ignored:
    name, opcode = message.get("Name"), message.get("Opcode")
    if not name:
        return Ignored("SET of a joint without a Name")
    if opcode.lower() == "stiffness":
        (share,) = read_parameters(message.get("Params"), _STIFFNESS_PARAMETERS)
        return SetStiffness(name, share)
    order = _JOINT_ORDERS.get(opcode.lower())
    if order is None:
        known = ", ".join([*_JOINT_ORDERS, "stiffness"])
        return Ignored(f"SET of a joint with the opcode {clip(opcode)}; known: {known}")
    value, *more = read_parameters(message.get("Params"), _JOINT_PARAMETERS) or (0.0,)
    return SetJoint(name, order, value, more[0] if more else None)


def _camera(message: Message) -> Command | Ignored:
    rotation, fov = _vector(message.get("Rotation")), _number(message.get("Zoom"))
    if rotation is None and fov is None:
        return Ignored("CAMERA without a Rotation or a Zoom")
    return TurnCamera(rotation, to_int(message.get("Order")), fov)


def _get_geo(message: Message) -> Command | Ignored:
    item_type = message.get("Type")
    return GetGeo(item_type, message.get("Name")) if item_type else Ignored("GETGEO without a Type")


def _get_conf(message: Message) -> Command | Ignored:
    item_type = message.get("Type")
    if not item_type:
        return Ignored("GETCONF without a Type")
    return GetConf(item_type, message.get("Name"))


def _control(message: Message) -> Command | Ignored:
    location, rotation = _vector(message.get("Location")), _vector(message.get("Rotation"))
    kind, name = message.get("Type"), message.get("Name")
    if not kind:
        return Ignored("CONTROL without a Type")
    # Speed has another form with each of these types, so they are read before the common keys.
    if kind.lower() in ("setwp", "addwp"):
        return Control(kind, name, path=_path(message))
    if kind.lower() == "rotate":
        return Control(kind, name, spin=_three(message, "Speed"))
    if kind.lower() == "conveyor":
        return Control(kind, name, share=_one(message, "Speed"))
    low, high = _vector(message.get("MinPos")), _vector(message.get("MaxPos"))
    return Control(
        *(kind, name, message.get("ClassName"), location, rotation),
        start=message.get("Start"),
        scale=_vector(message.get("Scale")),
        physics=message.get("Physics"),
        permanent=to_bool(message.get("Permanent")),
        # One corner alone bounds no box.
        corners=None if low is None or high is None else (low, high),
    )


def _three(message: Message, key: str) -> Vector | None:
    """Return the three numbers of a key that has one number in other commands; None without a value.

    Raises:
        PeerError: They are not three.
    """
    text = message.get(key)
    if text and len(to_vector(text)) != 3:
        raise PeerError(f"{key} is {clip(text)}; expected three numbers")
    return _vector(text)


def _one(message: Message, key: str) -> float | None:
    """Return the number of a key that has three numbers in other commands; see `_three`."""
    text = message.get(key)
    if text and not is_number(text):
        raise PeerError(f"{key} is {clip(text)}; expected a number")
    return _number(text)


def _path(message: Message) -> PathOptions:
    """Return waypoints and options.

    Raises:
        PeerError: The speed is not one number.
    """
    points = [_vector(text.strip()) for text in message.get("WP").split(";") if text.strip()]
    # Absent options are None, not False: WorldController.uc leaves what a line does not name.
    move, loop, align, reset = (
        to_bool(text) if text else None
        for text in map(message.get, ("Move", "Loop", "Autoalign", "ResetOnClear"))
    )
    return PathOptions(
        points=tuple(point for point in points if point is not None),
        speed=_one(message, "Speed") or 0.0,
        time=_number(message.get("Time")) or 0.0,
        move=move,
        loop=loop,
        align=align,
        reset=reset,
    )


COMMANDS.add("INIT", _init)
COMMANDS.add("GETSTARTPOSES", _get_start_poses)
COMMANDS.add("DRIVE", _drive)
COMMANDS.add("MULTIDRIVE", _multi_drive)
COMMANDS.add("MISPKG", _mis_pkg, aliases=("MISPGK",))  # the manual's heading has it wrong
COMMANDS.add("SET", _set)
COMMANDS.add("TRACE", _trace)
COMMANDS.add("CAMERA", _camera)
COMMANDS.add("GETGEO", _get_geo)
COMMANDS.add("GETCONF", _get_conf)
COMMANDS.add("CONTROL", _control)
