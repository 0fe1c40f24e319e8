"""Construction of one robot class, and of its drive, from its ini section."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from usarmjx.base.errors import SpecError, UsageError, quoted
from usarmjx.base.registry import Registry
from usarmjx.models.compile.kinematic_tree import with_measurements
from usarmjx.models.compile.parts import parts_of
from usarmjx.models.drives import Drive, NoDrive, SkidSteer, Tracks, YieldingSkidSteer
from usarmjx.models.drives.ground import Ackermann, OmniDrive, Wheel
from usarmjx.models.ini.items import (
    ITEM_LISTS,
    ItemClasses,
    Settings,
    WarningLog,
    kind_of,
    read_mount,
    resolve_parent,
)
from usarmjx.models.ini.pairs import Definitions, JointPair, build_parts, read_package, read_pairs, templates
from usarmjx.models.ini.parameters import apply_parameters, with_stereo
from usarmjx.models.ini.parse import (
    Line,
    Units,
    as_class,
    as_name,
    as_number,
    as_struct,
    as_vector,
    fail,
    number_of,
    reject_unknown,
)
from usarmjx.models.robots.kit import mass_of
from usarmjx.models.types.robot import CHASSIS, STEER_SUFFIX, MissionPackage, Mount, Part, RobotSpec
from usarmjx.models.types.shapes import Shape

POWER_TYPES = ("Holo_Powered", "Left_Powered", "Right_Powered", "Not_Powered")
"""Values of PowerType."""
STEER_TYPES = ("Holo_Steered", "Front_Steered", "Rear_Steered", "Not_Steered")
"""Values of SteerType. The manual has the Holo types and Not_Powered (12.18.2); the others are ours."""
MAX_STEER = 0.6
"""Default of MaxSteerAngle [rad] (chosen)."""
MIDDLE_TOLERANCE = 1e-3
"""Distance from the middle line within which a wheel is on neither side [m]."""
LOCATED_MESSAGE = re.compile(r".+:\d+: ")
"""Pattern of a message that begins with file and line."""
PAINT = (0.2, 0.35, 0.6, 1.0)
"""Colour of new chassis."""


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
        # The index of the line, as in Wheels(2), counts where Number is missing.
        number = int(number_of(line, struct, "Number", float(line.index or 0), above=-1.0))
        types: list[str | None] = []
        for key, allowed in (("PowerType", POWER_TYPES), ("SteerType", STEER_TYPES)):
            value = struct.get(key)
            spelt = {name.lower(): name for name in allowed}
            if value is not None and as_name(line, value, key).lower() not in spelt:
                fail(line, f"unknown {key} {value!r}", f"one of {', '.join(allowed)}")
            types.append(None if value is None else spelt[as_name(line, value, key).lower()])
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
    # One Holo wheel makes all of it an OmniDrive, though its wheels may steer too.
    car = not _is_holonomic(roles) and any(_steers(pair, roles) for pair in wheels)
    braked = _braked(wheels, driven, notes, car=car)
    idle = {part.name for part in parts if part.is_wheel} - driven
    kept = tuple(_undriven(part, braked) if part.name in idle else part for part in parts)
    # The first size of every round solid is its radius [m].
    radii = {part.name: part.shapes[0].size[0] for part in kept if part.is_wheel}
    # Radius and speed are those of the first driven wheel: commands in rad/s refer to it.
    radius = radii[next(pair.name for pair in wheels if pair.name in driven)]
    motors = {part.name: part.motor for part in kept if part.name in driven and part.motor}
    # The slowest wheel bounds all: wheels of several radii share a speed over ground.
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
            # A motor holds its wheel at speed 0; without one the wheel rolls.
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
    # A skid steer turns by the difference of its sides: a wheel in the middle is on neither.
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
    # DRIVE has one list of numbers for wheels, without gaps for other joints.
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
    # Exact equality: ratios of equal radii are 1 without rounding.
    if set(ratios) == {1.0}:
        return SkidSteer(left=left, right=right, max_spin=spin, radius=radius)
    return Tracks(left=left, right=right, max_spin=spin, radius=radius, ratios=ratios)


@dataclass
class RobotSection:
    """Contents of all files' sections of one robot class.

    Attributes:
        name: Its name.
        first: The first line about it, for messages.
        units: Units of positions in the last file.
        figures: Keys of one value, by their names in lower case.
        lists: Lines of the keys of lists, with their units.
        joints: Part-joint pairs by number.
        drops: Lines with `-` about the class' own items, by key.
    """

    name: str
    first: Line
    units: Units = field(default_factory=Units)
    figures: dict[str, Line] = field(default_factory=dict[str, Line])
    lists: dict[str, list[tuple[Line, Units]]] = field(default_factory=dict[str, list[tuple[Line, Units]]])
    joints: dict[int, tuple[Line, Units]] = field(default_factory=dict[int, tuple[Line, Units]])
    drops: dict[str, list[Line]] = field(default_factory=dict[str, list[Line]])

    def drop(self, key: str, line: Line) -> None:
        """Take an item away from the lists of earlier files; from the class' own if these have it not."""
        gone = 0
        for listed in (key, f"Add{key}"):
            before = self.lists.get(listed, [])
            kept = [(other, units) for other, units in before if not is_same_item(line, other)]
            gone += len(before) - len(kept)
            if before:
                self.lists[listed] = kept
        # With a list of the files' own, the class' items are gone anyway.
        if not gone and key not in self.lists:
            self.drops.setdefault(key, []).append(line)

    @property
    def where(self) -> str:
        """File and line of the section, for messages."""
        return f"{self.first.file}:{self.first.line}"


@dataclass(frozen=True)
class BuildContext:
    """Context of robots under construction.

    Attributes:
        robots: Existing robot classes.
        definitions: Mission packages of the ini files.
        packages: All mission packages, with those definitions.
        settings: Settings of each type of item.
        warnings: Log of warnings.
        classes: Item classes of the ini files.
    """

    robots: Registry[RobotSpec]
    definitions: Definitions
    packages: Mapping[str, MissionPackage]
    settings: Settings | None
    warnings: WarningLog
    classes: ItemClasses


def item_name(line: Line) -> tuple[str, str]:
    """Return class, as its type, and name of a line of a list, in lower case; a class left out is empty."""
    struct = as_struct(line)
    # A mission package has no ItemClass: its name alone identifies it.
    package = struct.get("PkgName")
    if package is not None:
        return "", as_name(line, package, "PkgName").lower()
    written = struct.get("ItemClass")
    kind = "" if written is None else as_class(line, written, "ItemClass")
    return (kind_of(kind, None) or kind).lower(), as_name(line, struct.get("ItemName"), "ItemName").lower()


def is_same_item(line: Line, other: Line) -> bool:
    """Return whether a line with `-` means the item of another line."""
    (kind, name), (its_kind, its_name) = item_name(line), item_name(other)
    return name == its_name and kind in ("", its_kind)


def build_robot(section: RobotSection, base: RobotSpec | None, sources: BuildContext) -> RobotSpec:
    """Return the class of a section.

    Args:
        section: The section.
        base: The previous class, or the base of a new one; None: none.
        sources: Context of the build.

    Raises:
        SpecError: A value that is wrong, or a robot that cannot be built; names file and line.
    """
    pairs = read_pairs(section.joints, sources.warnings)
    if base is None:
        robot = _new_robot(section, pairs, sources)
    else:
        # The section's spelling may differ from the class' in case.
        name = base.name if section.name in sources.robots else section.name
        robot = _changed_robot(section, replace(base, name=name), pairs, sources)
    # A new robot's chassis already has the rest of its Weight.
    used = {"weight"} if base is None else set[str]()
    robot = apply_parameters(robot, section.figures, section.units, sources.warnings, used)
    # Before items: these may sit on the links of packages.
    robot = _with_packages(section, robot, sources)
    try:
        robot = _with_items(section, robot, {pair.name: pair for pair in pairs}, sources)
        robot = with_stereo(robot, section.figures, section.units, sources.warnings)
        # For its errors, which would otherwise come when a world is built.
        parts_of(robot)
        return replace(with_measurements(robot), mass=robot.mass) if pairs else robot
    except UsageError as error:
        if LOCATED_MESSAGE.match(str(error)):
            raise
        raise SpecError(f"{section.where}: {error}") from error
    except ValueError as error:  # MuJoCo's, for masses and sizes that it refuses
        raise SpecError(f"{section.where}: {robot.name} cannot be built: {quoted(error)}") from error


def _changed_robot(
    orders: RobotSection, base: RobotSpec, pairs: Sequence[JointPair], sources: BuildContext
) -> RobotSpec:
    """Return an existing class with the given parts, if any, on its own chassis."""
    if (line := orders.figures.get("dimensions")) is not None:
        sources.warnings.add(
            line, "Dimensions are ignored: they are for a new class, whose chassis they are of"
        )
    roles = read_roles([line for line, _ in orders.lists.get("Wheels", ())])
    if not pairs:
        return change_wheels(base, roles)
    parts = build_parts(pairs, base.mass, sources.robots)
    parts, drive = drive_of(pairs, parts, roles, sources.warnings)
    if isinstance(drive, SkidSteer) and isinstance(base.drive, SkidSteer):  # its controller stays
        if isinstance(base.drive, YieldingSkidSteer) and type(drive) is SkidSteer:  # and so do its tyres
            drive = YieldingSkidSteer(**vars(drive), ease=base.drive.ease)
        drive = replace(drive, max_turn=base.drive.max_turn, lever=base.drive.lever)
    return replace(base, parts=parts, drive=drive, reported_joints=())


def _new_robot(orders: RobotSection, pairs: Sequence[JointPair], sources: BuildContext) -> RobotSpec:
    """Return a robot of parts on a box of the given Dimensions; the chassis has the rest of Weight."""
    line, weight_line = _required(orders, "Dimensions"), _required(orders, "Weight")
    weight = as_number(weight_line, weight_line.value, "Weight", above=0.0)
    size = orders.units.position(as_vector(line, line.value, "Dimensions"))
    # The conversion to z down makes the height negative; a length has no sign.
    x, y, z = (abs(edge) / 2 for edge in size)
    if min(x, y, z) == 0:
        fail(line, "Dimensions have an edge of no length", "length, width and height of the chassis")
    parts = build_parts(pairs, weight, sources.robots)
    roles = read_roles([line for line, _ in orders.lists.get("Wheels", ())])
    parts, drive = drive_of(pairs, parts, roles, sources.warnings)
    # Weight is that of the whole robot in Unreal, wheels included.
    rest = weight - mass_of(parts)
    if rest <= 0:
        fail(weight_line, f"Weight is {weight:g}, the parts alone have {mass_of(parts):g}", "more than that")
    return RobotSpec(
        name=orders.name,
        dimensions=(2 * x, 2 * y, 2 * z),
        mass=weight,
        origin_height=0.0,
        chassis=(Shape(kind="box", size=(x, y, z), mass=rest, rgba=PAINT),),
        parts=parts,
        drive=drive,
        sources=(("all", "chosen"),),
    )


def _required(orders: RobotSection, key: str) -> Line:
    if key.lower() not in orders.figures:
        expected = {
            "Dimensions": "Dimensions=(X=,Y=,Z=) of its chassis",
            "Weight": "Weight= of all of it [kg]",
        }
        fail(orders.first, f"new robot {orders.name} has no {key}", expected[key])
    return orders.figures[key.lower()]


def _with_packages(orders: RobotSection, robot: RobotSpec, sources: BuildContext) -> RobotSpec:
    listed, added = orders.lists.get("MisPkgs"), orders.lists.get("AddMisPkgs", [])
    if listed is None and not added and "MisPkgs" not in orders.drops:
        return robot
    own = sources.robots.get(robot.name).packages if robot.name in sources.robots else robot.packages
    known = {**sources.packages, **templates(own, sources.definitions)}
    # `MisPkgs` replaces the list, `AddMisPkgs` adds to it.
    packages = {} if listed is not None else {package.name: package for package in robot.packages}
    for line in orders.drops.get("MisPkgs", ()):
        gone = [name for name in packages if name.lower() == item_name(line)[1]]
        if not gone:
            sources.warnings.add(line, f"-{line.key} removes nothing: {robot.name} has no such package")
        packages = {name: package for name, package in packages.items() if name not in gone}
    for line, _ in (*(listed or ()), *added):
        package = read_package(line, known)
        if package.name in packages:
            fail(line, f"there is a package {package.name} already", "another PkgName")
        packages[package.name] = package
    return replace(robot, packages=tuple(packages.values()))


def _mounts(orders: RobotSection, key: str, sources: BuildContext) -> list[tuple[Line, Mount]]:
    """Return the items of a key, with their lines; without those that are not built."""
    read = [
        (line, read_mount(line, units, sources.settings, sources.warnings, sources.classes))
        for line, units in (*orders.lists.get(key, ()), *orders.lists.get(f"Add{key}", ()))
    ]
    return [(line, mount) for line, mount in read if mount is not None]


def _with_items(
    orders: RobotSection, robot: RobotSpec, pairs: Mapping[str, JointPair], sources: BuildContext
) -> RobotSpec:
    """Return a robot with its items: effecters first, since others may be mounted on their parts."""
    read = {key: _mounts(orders, key, sources) for key in ITEM_LISTS}
    for key in ("Effecters", "Sensors", "Cameras"):
        items = () if key in orders.lists else getattr(robot, ITEM_LISTS[key])
        # Effecters sit on the robot's own parts, not on each other's.
        others = replace(robot, effecters=()) if key == "Effecters" else robot
        names = [CHASSIS, *(part.name for part in parts_of(others))]
        for item in items:
            if item.parent not in names:
                raise SpecError(
                    f"robot {robot.name}: {item.kind} {item.name} sits on {item.parent}, which is gone; list "
                    f"its {key} anew, on: {', '.join(names)}"
                )
        mounts = {(item.kind.lower(), item.name.lower()): item for item in items}
        for line in orders.drops.get(key, ()):
            kind, name = item_name(line)
            gone = [item for item in mounts if item[1] == name and kind in ("", item[0])]
            if not gone:
                sources.warnings.add(line, f"-{line.key} removes nothing: {robot.name} has no such item")
            mounts = {item: mount for item, mount in mounts.items() if item not in gone}
        fresh: set[tuple[str, str]] = set()
        for line, mount in read[key]:
            item = (mount.kind.lower(), mount.name.lower())
            # Twice in the files is a slip; once replaces the class' own item of that name.
            if item in fresh:
                fail(line, f"there is a {mount.kind} {mount.name} already", "another ItemName")
            fresh.add(item)
            settled = resolve_parent(mount, line, names, sources.warnings)
            mounts[item] = _shifted(settled, pairs)
        robot = replace(robot, **{ITEM_LISTS[key]: tuple(mounts.values())})
    return robot


def _shifted(mount: Mount, pairs: Mapping[str, JointPair]) -> Mount:
    """Return a mount relative to its part's joint; the ini's origin is the part's middle (14.4.2.5)."""
    if mount.parent not in pairs:
        return mount
    x, y, z = (a + b for a, b in zip(mount.at, pairs[mount.parent].middle, strict=True))
    return replace(mount, at=(x, y, z))
