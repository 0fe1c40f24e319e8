"""Construction of one robot class from its ini section."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from usarmjx.base.errors import SpecError, UsageError, quoted
from usarmjx.base.registry import Registry
from usarmjx.models.compile.measure import with_measurements
from usarmjx.models.compile.parts import parts_of
from usarmjx.models.drives import SkidSteer, YieldingSkidSteer
from usarmjx.models.ini.drive import change_wheels, drive_of, read_roles
from usarmjx.models.ini.items import (
    ITEM_LISTS,
    ItemClasses,
    Settings,
    WarningLog,
    kind_of,
    read_mount,
    resolve_parent,
)
from usarmjx.models.ini.packages import Definitions, read_package, templates
from usarmjx.models.ini.pairs import JointPair, build_parts, read_pairs
from usarmjx.models.ini.parameters import apply_parameters, with_stereo
from usarmjx.models.ini.parse import Line
from usarmjx.models.ini.read import Units, as_class, as_name, as_number, as_struct, as_vector, fail
from usarmjx.models.robots.track_kit import mass_of
from usarmjx.models.types.robot import CHASSIS, MissionPackage, Mount, RobotSpec
from usarmjx.models.types.shapes import Shape

LOCATED_MESSAGE = re.compile(r".+:\d+: ")
"""Pattern of a message that begins with file and line."""
PAINT = (0.2, 0.35, 0.6, 1.0)
"""Colour of new chassis."""


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
        name = base.name if section.name in sources.robots else section.name
        robot = _changed_robot(section, replace(base, name=name), pairs, sources)
    used = {"weight"} if base is None else set[str]()
    robot = apply_parameters(robot, section.figures, section.units, sources.warnings, used)
    robot = _with_packages(section, robot, sources)
    try:
        robot = _with_items(section, robot, {pair.name: pair for pair in pairs}, sources)
        robot = with_stereo(robot, section.figures, section.units, sources.warnings)
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
    x, y, z = (abs(edge) / 2 for edge in size)
    if min(x, y, z) == 0:
        fail(line, "Dimensions have an edge of no length", "length, width and height of the chassis")
    parts = build_parts(pairs, weight, sources.robots)
    roles = read_roles([line for line, _ in orders.lists.get("Wheels", ())])
    parts, drive = drive_of(pairs, parts, roles, sources.warnings)
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
