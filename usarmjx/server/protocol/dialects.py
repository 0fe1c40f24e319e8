"""Vocabulary of a server: the manual's, or that of the later versions on UDK.

A dialect stands between lines and commands. `understand` converts a client's message to the manual's,
`translate` a message of the manual to those that the client receives. The differences of UDK's version:

    ASTA {Time 62.01} {Name CameraPanTilt} {Link 1} {Value 0.2000}     MISSTA, without Torque
    ACT {Name CameraPanTilt} {Link 0} {Value 0.2}                      MISPKG; links count from 0 in it alone
    ACT {Name TalonArm} {Gripper 1}, EFF {Type Gripper} {Status ...}   SET and RES of a Gripper
    GETCONF {Type Actuator}, GETGEO {Type Actuator}                    beside MisPkg, with other keys
    GEO ... {Mount CameraPanTilt} {MountLink 2}                        Mount CameraPanTilt_Link2
    SEN {Time 62.0100} {Type Sonar} {Name F1} {Range 2.5098}           a line for each sonar, not one for all
    SEN {Time 62.0100} {Type Encoder} {Name W1} {Tick 4}               of an encoder whose name has W1 in it
    SEN {Time 62.0100} {Type IMU} {Name I} {XYZAcceleration 0,0,0} ... Type AHRS; also in GETGEO and GETCONF
    GEO ... {Mount P3AT}                                               Mount HARD: the class that INIT named
    GEO {Type GroundVehicle} {Name P3AT} ..., also in CONF             Name P2AT
    CONF {Type Camera} {Name Camera} {CameraDefFov 0.8727} ...         a single camera has a name, too
    CONF {Type RangeScanner} ... {Panning True} {Tilting False}        Paning
    DRIVE {RotationalVelocity 20}                                      degrees a second, not radians
    SET {Type Camera} {Name Camera} {Opcode FOV} {Params 0.5}          Opcode Zoom
    INIT {ClassName USARBot.P3AT} {Start Start1}                       its Pioneer, which is our P2AT
    INIT {ClassName USARBot.WorldController}, CONTROL {Type GetSTA}    a client that moves things
"""

import math
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

from usarmjx.base.errors import UsageError
from usarmjx.server.protocol.grammar import Message, Segment, is_number, to_bool, to_float, to_int
from usarmjx.server.protocol.reports import VEHICLES

PACKAGE_TYPE, ACTUATOR_TYPE = "MisPkg", "Actuator"
"""Type of mission packages in the manual and in UDK's version."""
LATER_TYPES = {"AHRS": "IMU"}
"""Types of sensors with another name in UDK's version, where our IMU is none."""
ENCODER_TYPE, BATTERY_TYPE = "Encoder", "Battery"
GROUPED_TYPES = ("Sonar", "IR", "Touch", ENCODER_TYPE)
"""Sensor types that share one line in the manual's version."""
LATER_CLASSES = {"p3at": "P2AT"}
"""Robot classes of the later versions, lower case, and their names here; both dialects take both."""
GRIPPER_TYPE, SCANNER_TYPE = "Gripper", "RangeScanner"
GRIPPER_OPERATIONS = (
    *(("Opcode", "Grip"), ("MaxVal", "1"), ("MinVal", "0")),
    *(("Opcode", "Close"), ("Opcode", "Open")),
)
"""CONF of a gripper in UDK's version (Gripper.uc)."""
LATER_OPCODES = {("joint", "target"): "Angle", ("camera", "fov"): "Zoom"}
"""Opcodes of SET in UDK's version by type and name in lower case, and their names in the manual's."""
LINK_KEYS = {"ParentLink": "Parent", "MinRange": "MinValue", "MaxRange": "MaxValue"}
"""Keys of GEO and CONF of packages, and their names in UDK's version."""
CHASSIS_MOUNT = "HARD"
"""Mount of items on the chassis in the manual's version."""
_LINK_PART = re.compile(r"(.+)_Link([0-9]+)")
_WHEEL_NUMBER = re.compile(r"W\d")
_ORIGIN = "0.0000,0.0000,0.0000"


@dataclass(frozen=True)
class Dialect:
    """Vocabulary of a server.

    Attributes:
        name: Its name.
        understand: Converts a client's message to the manual's.
        translate: Converts a message of the manual to those that the client receives, given the class of
            its robot as its INIT named it.
        is_stamped: Whether every reading has its time, regardless of the sensor's setting.
        package_types: Types that ask for mission packages, lower case.
        has_binary_grippers: Whether grippers are open or closed, and report that.
        has_camera_names: Whether CONF names a single camera, as it names several.
        has_world_controllers: Whether a client may control the world in place of a robot.
        all_joints: Names in SET that mean all joints but wheels, lower case.
        max_connections: Most clients at once, unless a setting says otherwise.
    """

    name: str
    understand: Callable[[Message], Message]
    translate: Callable[[Message, str], Iterable[Message]]
    is_stamped: bool = False
    package_types: frozenset[str] = frozenset({PACKAGE_TYPE.lower()})
    has_binary_grippers: bool = False
    has_camera_names: bool = False
    has_world_controllers: bool = False
    all_joints: frozenset[str] = frozenset()
    max_connections: int = 16


def told_class(asked: str, ours: str) -> str:
    """Return the class of a robot as the later versions tell it, whatever the case of its INIT.

    Args:
        asked: The class that INIT named.
        ours: Its name here.
    """
    return asked.upper() if asked.lower() in LATER_CLASSES else ours


def _understand_udk(message: Message) -> Message:
    if message.kind == "ACT":
        # No package here has a sequence, so it is left out as the later server does (Actuator.uc).
        said = (segment for segment in message.segments if segment[0].lower() != "sequence")
        return Message("MISPKG", tuple(map(_count_from_one, said)))
    if message.kind == "SET":
        opcode = LATER_OPCODES.get((message.get("Type").lower(), message.get("Opcode").lower()))
        renamed = (
            (key, opcode if opcode and key.lower() == "opcode" else value) for key, value in message.segments
        )
        return replace(message, segments=tuple(renamed))
    # Normalized values are percent in both dialects.
    if message.kind == "DRIVE" and not to_bool(message.get("Normalized")):
        return replace(message, segments=tuple(map(_turn_in_radians, message.segments)))
    return message


def _turn_in_radians(segment: Segment) -> Segment:
    """Return the manual's turning rate of a flying robot [rad/s] for the later versions' in degrees."""
    key, value = segment
    is_turn = key.lower() == "rotationalvelocity" and is_number(value)
    return (key, str(math.radians(to_float(value)))) if is_turn else segment


def _count_from_one(segment: Segment) -> Segment:
    key, value = segment
    is_link = key.lower() == "link" and is_number(value)
    return (key, str(to_int(value) + 1)) if is_link else segment  # a word stays what it is, to be refused


def _translate_udk(message: Message, robot_class: str = "") -> Iterator[Message]:
    if message.kind == "MISSTA":
        yield Message("ASTA", tuple(segment for segment in message.segments if segment[0] != "Torque"))
    elif message.kind in ("GEO", "CONF") and message.get("Type").lower() == ACTUATOR_TYPE.lower():
        yield Message(message.kind, tuple(_actuator(message, robot_class or CHASSIS_MOUNT)))
    elif message.kind in ("GEO", "CONF") and message.get("Type") in VEHICLES:
        yield replace(message, segments=tuple(_named(message.segments, robot_class)))
    elif message.kind == "CONF" and message.get("Type").lower() == GRIPPER_TYPE.lower():
        yield Message(message.kind, tuple(_binary(message)))
    elif message.kind == "CONF" and message.get("Type").lower() == SCANNER_TYPE.lower():
        yield replace(message, segments=tuple(map(_spelled, message.segments)))
    elif message.kind == "SEN" and message.get("Type") == BATTERY_TYPE:
        return  # Battery.uc sends nothing: the time is in STA
    elif message.kind == "SEN" and message.get("Type") in GROUPED_TYPES:
        yield from _one_by_one(message)
    elif message.kind == "SEN":
        yield replace(message, segments=tuple(_typed(_split(message.segments))))
    elif message.kind == "GEO":
        segments = _split(message.segments)
        yield replace(message, segments=tuple(_mounted(segments, robot_class or CHASSIS_MOUNT)))
    else:
        yield message


def _spelled(segment: Segment) -> Segment:
    """Spell a key of CONF of a range scanner as RangeScanner.uc does; IRScanner.uc has the manual's word."""
    key, value = segment
    return ("Panning" if key == "Paning" else key, value)


def _typed(segments: Iterable[Segment]) -> Iterator[Segment]:
    """Give a type its name in the later versions."""
    for key, value in segments:
        yield (key, LATER_TYPES.get(value, value) if key == "Type" else value)


def _named(segments: tuple[Segment, ...], robot_class: str) -> Iterator[Segment]:
    """Name a robot by the class that its INIT named; an echo of what is not there keeps its name."""
    # An echo of what is not there has no more than type and name.
    is_there = len(segments) > 2
    for key, value in segments:
        yield (key, robot_class if key == "Name" and is_there and robot_class else value)


def _split(segments: Iterable[Segment]) -> Iterator[Segment]:
    """Give each pair of `{Name F1 Range 2.5}` braces of its own."""
    for key, value in segments:
        words = value.split()
        if key == "Name" and len(words) > 1:
            yield (key, words[0])
            # Strict: a key without a value would be a fault of ours, and must not lose a reading in silence.
            yield from zip(words[1::2], words[2::2], strict=True)
        else:
            yield (key, value)


def _mounted(segments: Iterable[Segment], chassis: str) -> Iterator[Segment]:
    """Name the package and its link that carry an item, or the chassis by its robot's class."""
    for key, value in segments:
        if key == "Mount" and value == CHASSIS_MOUNT:
            yield (key, chassis)
            continue
        link = _LINK_PART.fullmatch(value) if key == "Mount" else None
        if link is not None:
            yield (key, link[1])
            yield ("MountLink", link[2])
        else:
            yield (key, value)


def _one_by_one(message: Message) -> Iterator[Message]:
    """Return one message per item of a message about several."""
    segments = list(_split(message.segments))
    names = [index for index, (key, _) in enumerate(segments) if key == "Name"]
    for start, end in pairwise([*names, len(segments)]):
        own = segments[start:end]
        if message.get("Type") == ENCODER_TYPE and (wheel := _WHEEL_NUMBER.search(own[0][1])):
            own[0] = ("Name", wheel[0])
        yield Message(message.kind, (*segments[: names[0]], *own))


def _actuator(message: Message, chassis: str) -> Iterator[Segment]:
    """Return UDK's form of packages: the pose and the tip of each, and its links from the base, link 0."""
    # An echo of what is not there has no links, and so gets no pose.
    has_pose = message.kind == "GEO" and bool(message.all("Link"))
    has_tips = bool(message.all("Tip"))
    tip = [("Tip", _ORIGIN)] if has_pose and not has_tips else []
    # The tip of a package follows its links, so it comes before the next name, and once more at the end.
    names = 0
    for key, value in message.segments:
        if key == "Name":
            yield from tip if names else ()
            names += 1
        if key == "ParentLink":
            # Links hang on the base, link 0, in UDK; the manual has -1 for the chassis.
            yield (LINK_KEYS[key], str(max(to_int(value), 0)))
        else:
            yield (LINK_KEYS.get(key, key), value)
        if key == "Name" and has_pose:
            yield from (("Location", _ORIGIN), ("Orientation", _ORIGIN), ("Mount", chassis))
    yield from tip


def _binary(message: Message) -> Iterator[Segment]:
    """Return UDK's form of grippers: the operations of one that is open or closed."""
    # An echo of what is not there has no opcodes, and stays an echo.
    is_there = bool(message.all("Opcode"))
    for key, value in message.segments:
        if key in ("Type", "Name"):
            yield (key, value)
        if key == "Name" and is_there:
            yield from GRIPPER_OPERATIONS


def _as_it_is(message: Message, robot_class: str = "") -> Iterable[Message]:
    del robot_class
    return (message,)


MANUAL = Dialect("manual", lambda message: message, _as_it_is)
"""Version 3.1.3, on Unreal Tournament 2004: the manual's own."""
UDK = Dialect(
    "udk",
    _understand_udk,
    _translate_udk,
    is_stamped=True,
    package_types=frozenset({PACKAGE_TYPE.lower(), ACTUATOR_TYPE.lower()}),
    has_binary_grippers=True,
    has_camera_names=True,
    has_world_controllers=True,
    all_joints=frozenset({"allangles", "alljoints"}),
    max_connections=64,
)
"""The versions on the Unreal Development Kit, which most ROS nodes support."""
DIALECTS = {dialect.name: dialect for dialect in (MANUAL, UDK)}


def find_dialect(name: str) -> Dialect:
    """Return the dialect of a name.

    Raises:
        UsageError: There is no such dialect; lists them.
    """
    if name not in DIALECTS:
        raise UsageError(f"unknown dialect {name!r}; known: {', '.join(DIALECTS)}")
    return DIALECTS[name]
