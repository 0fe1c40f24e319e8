"""GEO and CONF: the answers about robots and their parts (manual 9.3).

Inputs are plain numbers already in the wire's axes and units. As in `reports`, lines captured
from UT2004 servers win over the manual where they differ: `Mount HARD`, 2 decimals for links.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from usarmjx.base.errors import UsageError
from usarmjx.base.registry import is_name
from usarmjx.server.protocol.grammar import (
    Message,
    Segment,
    Vector,
    check_word,
    four_decimals,
    four_decimals_list,
    two_decimals,
)
from usarmjx.server.protocol.reports import check_vehicle

ConfField: TypeAlias = tuple[str, str | bool | int | float]

_TWO_DECIMAL_FIELDS = {("gps", "scaninterval"), ("ins", "scaninterval"), ("groundtruth", "scaninterval")}
"""Configuration values that UT2004 servers print with 2 decimals, although others have 4."""


@dataclass(frozen=True, slots=True)
class RobotGeometry:
    """Numbers of a robot's GEO.

    Attributes:
        kind: "GroundVehicle", "LeggedRobot", "NauticVehicle" or "AerialVehicle".
        name: Name of the robot's class (not of the robot: UsarCommander looks for the model here).
        dimensions: Length, width, height [m].
        cog: Centre of gravity from the chassis origin [m].
        wheel_radius: [m]; this and the next two are of ground vehicles only, which must have them.
        wheel_separation: Lateral distance between wheels [m]. The manual's text swaps this and the
            next; the captured numbers do not (P2AT 0.4712 and 0.2884).
        wheel_base: Distance between axles [m].
    """

    kind: str
    name: str
    dimensions: Vector
    cog: Vector
    wheel_radius: float | None = None
    wheel_separation: float | None = None
    wheel_base: float | None = None


def geo_robot(geometry: RobotGeometry) -> Message:
    """Return the answer to `GETGEO {Type Robot}`.

    Raises:
        UsageError: There is no such kind, or a ground vehicle lacks a number of its wheels.
    """
    segments: list[Segment] = [
        ("Type", check_vehicle(geometry.kind)),
        ("Name", geometry.name),
        ("Dimensions", four_decimals_list(geometry.dimensions)),
        ("COG", four_decimals_list(geometry.cog)),
    ]
    if geometry.kind == "GroundVehicle":
        for key, value in (
            ("WheelRadius", geometry.wheel_radius),
            ("WheelSeparation", geometry.wheel_separation),
            ("WheelBase", geometry.wheel_base),
        ):
            if value is None:
                raise UsageError(f"the ground vehicle {geometry.name!r} needs a number for {key}")
            segments.append((key, four_decimals(value)))
    return Message("GEO", tuple(segments))


@dataclass(frozen=True, slots=True)
class RobotConfiguration:
    """Numbers of a robot's CONF.

    Attributes:
        kind: "GroundVehicle", "LeggedRobot", "NauticVehicle" or "AerialVehicle".
        name: Name of the robot's class.
        steering: "SkidSteered", "AckermanSteered" or "OmniDrive" on the ground; "TwoLegs" or
            "FourLegs"; "VariableDepth" (the manual's example has "Underwater"); "RotaryWing".
        mass: [kg].
        max_speed: Largest wheel spin [rad/s]; this and the next three are of ground vehicles only.
        max_torque: Largest wheel torque, in the original's own units.
        max_front_steer: [rad], 0 for skid-steered robots.
        max_rear_steer: [rad], 0 for skid-steered robots.
    """

    kind: str
    name: str
    steering: str
    mass: float
    max_speed: float = 0.0
    max_torque: float = 0.0
    max_front_steer: float = 0.0
    max_rear_steer: float = 0.0


def conf_robot(configuration: RobotConfiguration) -> Message:
    """Return the answer to `GETCONF {Type Robot}`.

    Raises:
        UsageError: There is no such kind.
    """
    segments: list[Segment] = [
        ("Type", check_vehicle(configuration.kind)),
        ("Name", configuration.name),
        ("SteeringType", configuration.steering),
        ("Mass", four_decimals(configuration.mass)),
    ]
    # The lines of the other vehicles end here (manual 9.3).
    if configuration.kind == "GroundVehicle":
        segments += [
            ("MaxSpeed", four_decimals(configuration.max_speed)),
            ("MaxTorque", four_decimals(configuration.max_torque)),
            ("MaxFrontSteer", four_decimals(configuration.max_front_steer)),
            ("MaxRearSteer", four_decimals(configuration.max_rear_steer)),
        ]
    return Message("CONF", tuple(segments))


def geo_items(type_name: str, items: Iterable[tuple[str, Vector, Vector, str]]) -> Message:
    """Return the poses of the sensors or effecters of a type on the robot.

    Args:
        type_name: The type asked for.
        items: Name, location [m] and orientation [rad] relative to the mount, and the mount: "HARD"
            for the chassis, else the part's name.

    Raises:
        UsageError: A name or a mount is not one word.
    """
    segments = [
        (
            "Name",
            f"{check_word(name)} Location {four_decimals_list(location)}"
            f" Orientation {four_decimals_list(orientation)} Mount {check_word(mount)}",
        )
        for name, location, orientation, mount in items
    ]
    return Message("GEO", (("Type", type_name), *segments))


def conf_items(type_name: str, items: Iterable[Sequence[ConfField]]) -> Message:
    """Return the options of the sensors or effecters of a type, one item after the other.

    Args:
        type_name: The type asked for.
        items: Per item its (key, value) pairs, starting with ("Name", ...) where the type has
            names; floats get the decimals that the servers use for them, text is sent as it is.
    """
    segments = [(key, _field(type_name, key, value)) for fields in items for key, value in fields]
    return Message("CONF", (("Type", type_name), *segments))


def conf_effecters(
    effecters: Iterable[tuple[str, Sequence[tuple[str, float, float]]]], type_name: str = "Effecter"
) -> Message:
    """Return the operations of effecters, all in one line (manual 9.3).

    Args:
        effecters: Name of each, and per operation its opcode, largest and smallest value.
        type_name: The type asked for.
    """
    segments: list[Segment] = [("Type", type_name)]
    for name, operations in effecters:
        segments.append(("Name", name))
        for opcode, largest, smallest in operations:
            segments += [
                ("Opcode", opcode),
                ("MaxVal", four_decimals(largest)),
                ("MinVal", four_decimals(smallest)),
            ]
    return Message("CONF", tuple(segments))


def _field(type_name: str, key: str, value: str | bool | int | float) -> str:
    # Whole numbers, True and False have no decimals on the wire.
    if isinstance(value, float):
        short = (type_name.lower(), key.lower()) in _TWO_DECIMAL_FIELDS
        return two_decimals(value) if short else four_decimals(value)
    return str(value)


@dataclass(frozen=True, slots=True)
class LinkGeometry:
    """One link of a mission package for GEO.

    Attributes:
        link: Its number.
        parent: Number of the link it hangs on, -1 for the chassis.
        location: Relative to the parent [m].
        orientation: Relative to the parent [rad].
    """

    link: int
    parent: int
    location: Vector
    orientation: Vector


NO_TIPS: Mapping[str, Vector] = {}


def geo_mispkg(
    packages: Iterable[tuple[str, Sequence[LinkGeometry]]],
    type_name: str = "MisPkg",
    tips: Mapping[str, Vector] = NO_TIPS,
) -> Message:
    """Return the geometry of mission packages, (name, links) of each, all in one line of that type.

    Args:
        packages: The packages.
        type_name: The type.
        tips: Tips of packages by name [m]; the manual's line has none.
    """
    segments: list[Segment] = [("Type", type_name)]
    for name, links in packages:
        segments.append(("Name", name))
        for link in links:
            segments += [
                ("Link", str(link.link)),
                ("ParentLink", str(link.parent)),
                ("Location", four_decimals_list(link.location)),
                ("Orientation", four_decimals_list(link.orientation)),
            ]
        if name in tips:
            segments.append(("Tip", four_decimals_list(tips[name])))
    return Message("GEO", tuple(segments))


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkConfiguration:
    """One link of a mission package for CONF.

    Attributes:
        link: Its number.
        joint: "Revolute" or "Prismatic".
        max_speed: [rad/s] or [m/s].
        max_torque: In the original's own units.
        min_range: Lower limit [rad] or [m]; above `max_range` when the joint has no limits.
        max_range: Upper limit [rad] or [m].
    """

    link: int
    joint: str
    max_speed: float
    max_torque: float
    min_range: float
    max_range: float


def conf_mispkg(
    packages: Iterable[tuple[str, Sequence[LinkConfiguration]]], type_name: str = "MisPkg"
) -> Message:
    """Return the joints of mission packages, (name, links) of each, all in one line of that type."""
    segments: list[Segment] = [("Type", type_name)]
    for name, links in packages:
        segments.append(("Name", name))
        for link in links:
            segments += [
                ("Link", str(link.link)),
                ("JointType", link.joint),
                # Two decimals for all numbers of a link, as captured lines have them.
                ("MaxSpeed", two_decimals(link.max_speed)),
                ("MaxTorque", two_decimals(link.max_torque)),
                ("MinRange", two_decimals(link.min_range)),
                ("MaxRange", two_decimals(link.max_range)),
            ]
    return Message("CONF", tuple(segments))


def geo_nothing(type_name: str, name: str = "") -> Message:
    """Return the answer to a GETGEO that nothing matches: an echo, which MOAST waits for."""
    return Message("GEO", _echo(type_name, name))


def conf_nothing(type_name: str, name: str = "") -> Message:
    """Return the answer to a GETCONF that nothing matches: an echo, which MOAST waits for."""
    return Message("CONF", _echo(type_name, name))


def _echo(type_name: str, name: str) -> tuple[Segment, ...]:
    """Return type and name as asked, and nothing else: what exists tells more of itself.

    A value that is no single word is left out: it would shift the pairs behind it.
    """
    return tuple((key, word) for key, word in (("Type", type_name), ("Name", name)) if is_name(word))
