"""The drive of a robot's part-joint pairs and its `Wheels` lines (manual 12.18.2)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from usarmjx.models.drives import Drive, NoDrive, SkidSteer, Tracks
from usarmjx.models.drives.ackermann import Ackermann, Wheel
from usarmjx.models.drives.ground import OmniDrive
from usarmjx.models.ini.items import WarningLog
from usarmjx.models.ini.pairs import JointPair
from usarmjx.models.ini.parse import Line
from usarmjx.models.ini.read import as_name, as_struct, fail, number_of, reject_unknown
from usarmjx.models.types.robot import STEER_SUFFIX, Part, RobotSpec

POWER_TYPES = ("Holo_Powered", "Left_Powered", "Right_Powered", "Not_Powered")
"""Values of PowerType."""
STEER_TYPES = ("Holo_Steered", "Front_Steered", "Rear_Steered", "Not_Steered")
"""Values of SteerType. The manual has the Holo types and Not_Powered (12.18.2); the others are ours."""
MAX_STEER = 0.6
"""Default of MaxSteerAngle [rad] (chosen)."""
MIDDLE_TOLERANCE = 1e-3
"""Distance from the middle line within which a wheel is on neither side [m]."""


@dataclass(frozen=True)
class WheelRole:
    """The role of a wheel by its `Wheels` line; None: unspecified."""

    line: Line
    power: str | None
    steer: str | None
    max_steer: float | None

    @property
    def steers(self) -> bool:
        """Whether the wheel is to steer."""
        return self.steer not in (None, "Not_Steered")


def read_roles(lines: Sequence[Line]) -> dict[int, WheelRole]:
    """Return the roles of wheels, by their Number; a later line of a number replaces earlier ones.

    Raises:
        SpecError: An unknown field or type; names file and line.
    """
    roles: dict[int, WheelRole] = {}
    for line in lines:
        struct = as_struct(line)
        reject_unknown(line, struct, ("Number", "PowerType", "SteerType", "MaxSteerAngle"))
        number = int(number_of(line, struct, "Number", float(line.index or 0), above=-1.0))
        types: list[str | None] = []
        for field, allowed in (("PowerType", POWER_TYPES), ("SteerType", STEER_TYPES)):
            value = struct.get(field)
            spelt = {name.lower(): name for name in allowed}
            if value is not None and as_name(line, value, field).lower() not in spelt:
                fail(line, f"unknown {field} {value!r}", f"one of {', '.join(allowed)}")
            types.append(None if value is None else spelt[as_name(line, value, field).lower()])
        given = struct.get("MaxSteerAngle") is not None
        max_steer = number_of(line, struct, "MaxSteerAngle", above=0.0) if given else None
        roles[number] = WheelRole(line, types[0], types[1], max_steer)
    return roles


def drive_of(
    pairs: Sequence[JointPair], parts: Sequence[Part], roles: Mapping[int, WheelRole], notes: WarningLog
) -> tuple[tuple[Part, ...], Drive]:
    """Return the parts, undriven ones without their motor, and the drive of the others.

    Wheels of a Holo type make an OmniDrive, wheels that steer an Ackermann drive, others a SkidSteer with the
    robot's sides.

    Raises:
        SpecError: Wheels that none of these can drive; names file and line.
    """
    wheels = [pair for pair in pairs if pair.joint == "wheel"]
    _check_roles(wheels, roles)
    if not wheels:
        return tuple(parts), NoDrive()
    driven = {pair.name for pair in wheels if _is_driven(pair, roles, notes)}
    if not driven:
        fail(wheels[0].line, "no wheel is driven", "wheels beside the middle line, without Not_Powered")
    car = not _is_holonomic(roles) and any(_steers(pair, roles) for pair in wheels)
    braked = _braked(wheels, driven, notes, car=car)
    idle = {part.name for part in parts if part.is_wheel} - driven
    kept = tuple(_undriven(part, braked) if part.name in idle else part for part in parts)
    radii = {part.name: part.shapes[0].size[0] for part in kept if part.is_wheel}
    radius = radii[next(pair.name for pair in wheels if pair.name in driven)]
    motors = {part.name: part.motor for part in kept if part.name in driven and part.motor}
    spin = min(motor.max_speed * radii[name] / radius for name, motor in motors.items())
    if _is_holonomic(roles):
        return kept, _omni(wheels, driven, roles, spin, radius)
    if car:
        drive = _ackermann(wheels, driven, roles, spin, radius)
        both = (replace(wheel, brakes=wheel.joint in braked) for wheel in drive.wheels)
        return kept, replace(drive, wheels=tuple(both))
    return kept, _skid(wheels, driven, roles, radii, spin, radius)


def _braked(
    wheels: Sequence[JointPair], driven: set[str], notes: WarningLog, *, car: bool
) -> dict[str, float]:
    """Return the BrakeTorque of undriven wheels, by name [N m]: a car's can brake, others roll."""
    found: dict[str, float] = {}
    for pair in wheels:
        if pair.name in driven or not pair.brake:
            continue
        if car:
            found[pair.name] = pair.brake
        else:
            notes.add(pair.line, f"BrakeTorque is ignored: {pair.name} is not driven, and this is no car")
    return found


def _undriven(wheel: Part, braked: Mapping[str, float]) -> Part:
    """Return a wheel without its motor, or with its brake alone."""
    if wheel.motor is None or wheel.name not in braked:
        return replace(wheel, motor=None)
    return replace(wheel, motor=replace(wheel.motor, torque=braked[wheel.name]))


def change_wheels(robot: RobotSpec, roles: Mapping[int, WheelRole]) -> RobotSpec:
    """Return an omnidirectional robot with changed powers and steering of wheels (manual 12.18.2).

    Raises:
        SpecError: A robot with another drive, or a wheel without the needed motor; names the line.
    """
    drive, parts = robot.drive, {part.name: part for part in robot.parts}
    for number, role in roles.items():
        if not isinstance(drive, OmniDrive):
            fail(
                role.line, f"Wheels are for an OmniDrive, {robot.name} has {drive.steering}", "JointParts too"
            )
        powered = role.power not in (None, "Not_Powered")
        if number >= len(drive.wheels):  # wheels after the last driven one only roll
            if powered or role.steers:
                fail(role.line, f"{robot.name} drives no wheel {number}", f"0 to {len(drive.wheels) - 1}")
            continue
        wheel = drive.wheels[number]
        able = (wheel.powered or not powered) and (bool(wheel.steer) or not role.steers)
        if not able:
            fail(
                role.line, f"wheel {number} of {robot.name} has no motor for that", "Not_Powered, Not_Steered"
            )
        if not powered:
            parts[wheel.joint] = replace(parts[wheel.joint], motor=None)
        if role.steers and role.max_steer is not None:
            drive = replace(drive, max_steer=role.max_steer)
            lock = (-role.max_steer, role.max_steer)
            parts[wheel.steer] = replace(parts[wheel.steer], limits=lock)
        changed = replace(wheel, powered=powered, steer=wheel.steer if role.steers else "")
        drive = replace(
            drive, wheels=tuple(changed if i == number else w for i, w in enumerate(drive.wheels))
        )
    return replace(robot, parts=tuple(parts.values()), drive=drive)


def _is_holonomic(roles: Mapping[int, WheelRole]) -> bool:
    return any("Holo" in f"{role.power}{role.steer}" for role in roles.values())


def _check_roles(wheels: Sequence[JointPair], roles: Mapping[int, WheelRole]) -> None:
    numbers = {pair.number: pair for pair in wheels}
    for number, role in roles.items():
        if number not in numbers:
            known = ", ".join(f"{n} ({pair.name})" for n, pair in numbers.items()) or "none"
            fail(role.line, f"there is no wheel {number}", f"the number of a wheel's JointParts: {known}")
        if role.steers and not numbers[number].steers:
            fail(role.line, f"wheel {number} steers, but its joint is locked", "bSteeringLocked=False")


def _is_driven(pair: JointPair, roles: Mapping[int, WheelRole], notes: WarningLog) -> bool:
    role = roles.get(pair.number)
    if role is not None and role.power is not None:
        return role.power != "Not_Powered"
    if _is_holonomic(roles):
        return False
    aside = abs(pair.chassis_position[1]) > MIDDLE_TOLERANCE
    if not aside:
        notes.add(pair.line, f"wheel {pair.name} is in the middle and has no PowerType: it rolls freely")
    return aside


def _steers(pair: JointPair, roles: Mapping[int, WheelRole]) -> bool:
    role = roles.get(pair.number)
    if role is not None and role.power is not None and role.steer is None:
        return False
    return pair.steers and (role is None or role.steer != "Not_Steered")


def _steered(
    wheels: Sequence[JointPair], driven: set[str], roles: Mapping[int, WheelRole]
) -> tuple[Wheel, ...]:
    return tuple(
        Wheel(
            joint=pair.name,
            steer=pair.name + STEER_SUFFIX if _steers(pair, roles) else "",
            x=pair.chassis_position[0],
            y=pair.chassis_position[1],
            powered=pair.name in driven,
        )
        for pair in wheels
    )


def _largest(pairs: Sequence[JointPair], roles: Mapping[int, WheelRole]) -> float:
    """Return the largest steering angle of some wheels [rad]; 0 if none steers."""
    given = [roles[pair.number].max_steer if pair.number in roles else None for pair in pairs]
    angles = [a or MAX_STEER for a, pair in zip(given, pairs, strict=True) if _steers(pair, roles)]
    return max(angles, default=0.0)


def _omni(
    wheels: Sequence[JointPair], driven: set[str], roles: Mapping[int, WheelRole], spin: float, radius: float
) -> OmniDrive:
    if [pair.number for pair in wheels] != list(range(len(wheels))):
        fail(wheels[0].line, "DRIVE knows omni wheels by their numbers", "wheels as the first JointParts")
    return OmniDrive(
        wheels=_steered(wheels, driven, roles),
        max_spin=spin,
        radius=radius,
        max_steer=_largest(wheels, roles),
    )


def _ackermann(
    wheels: Sequence[JointPair], driven: set[str], roles: Mapping[int, WheelRole], spin: float, radius: float
) -> Ackermann:
    xs = [pair.chassis_position[0] for pair in wheels]
    middle = (min(xs) + max(xs)) / 2
    front = [pair for pair in wheels if pair.chassis_position[0] > middle]
    rear = [pair for pair in wheels if pair.chassis_position[0] < middle]
    if not front or not rear:
        fail(
            wheels[0].line,
            "steered wheels need an axle before or behind them",
            "wheels at two places along X",
        )
    return Ackermann(
        wheels=_steered(wheels, driven, roles),
        max_spin=spin,
        radius=radius,
        max_front_steer=_largest(front, roles),
        max_rear_steer=_largest(rear, roles),
    )


def _skid(
    wheels: Sequence[JointPair],
    driven: set[str],
    roles: Mapping[int, WheelRole],
    radii: Mapping[str, float],
    spin: float,
    radius: float,
) -> SkidSteer:
    def on_left(pair: JointPair) -> bool:
        role = roles.get(pair.number)
        if role is not None and role.power in ("Left_Powered", "Right_Powered"):
            return role.power == "Left_Powered"
        return pair.chassis_position[1] < 0

    left = tuple(pair.name for pair in wheels if pair.name in driven and on_left(pair))
    right = tuple(pair.name for pair in wheels if pair.name in driven and not on_left(pair))
    for side, names in (("left", left), ("right", right)):
        if not names:
            fail(wheels[0].line, f"no driven wheel is on the {side}", "some at either side, Y < 0 is left")
    ratios = tuple(radius / radii[name] for name in (*left, *right))
    if set(ratios) == {1.0}:
        return SkidSteer(left=left, right=right, max_spin=spin, radius=radius)
    return Tracks(left=left, right=right, max_spin=spin, radius=radius, ratios=ratios)
