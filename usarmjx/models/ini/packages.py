"""Mission packages of ini files: `[USARMisPkg.X]` sections, and the MisPkgs lines that mount them on robots.

The manual shows no section of USARMisPkg.ini, and the original's refers to classes of an Unreal package. Ours
gives the links of a package directly, close to the part-joint pairs of 14.4.2.4; see `docs/robots.md`.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from usarmjx.base.registry import Registry
from usarmjx.base.transforms import Vec3
from usarmjx.models.ini.items import LINK_IGNORED, WarningLog
from usarmjx.models.ini.parse import (
    IniFile,
    IniValue,
    Line,
    Struct,
    Units,
    as_bool,
    as_class,
    as_name,
    as_number,
    as_struct,
    as_vector,
    fail,
    number_of,
    reject_unknown,
    vector_of,
)
from usarmjx.models.robots.packages import PACKAGES, mount_package
from usarmjx.models.types.robot import Link, MissionPackage, RobotSpec
from usarmjx.models.types.shapes import ZERO, Shape

PREFIX = "usarmispkg."
"""Prefix of sections of packages."""
LINK_FIELDS = (
    "Number", "Parent", "Location", "Orientation", "MaxSpeed", "MaxTorque", "MinRange", "MaxRange",
    "JointType", "Mass", "Size",
)  # fmt: skip
"""Fields of a `Links` line."""
SYNONYMS = {"linknumber": "Number", "parentlinknumber": "Parent"}
"""The original's names of two fields (KRobot.uc)."""
MAX_LINKS = 200
"""Largest number of links of a package."""
JOINT_TYPES = ("Revolute", "Prismatic")
# Defaults of a link: captured values of CameraPanTilt; size and mass chosen.
DEFAULT_LINK = Link(
    number=0, parent=-1, location=ZERO, orientation=ZERO, max_speed=0.17, max_torque=20.0, min_range=1.0,
    max_range=0.0, shapes=(Shape(kind="box", size=(0.02, 0.02, 0.02), mass=0.2, surface="fixture"),),
)  # fmt: skip


@dataclass(frozen=True)
class LinkLine:
    """One `Links=` line: its number, the line, its fields, and their units."""

    number: int
    line: Line
    fields: Struct
    units: Units


@dataclass(frozen=True)
class Definition:
    """Definition of a package class by a file: links, none if it leaves them, and its tip [m]."""

    links: tuple[LinkLine, ...] = ()
    tip: Vec3 | None = None


Definitions = Mapping[str, Definition]
"""Definition of each package class, by its name in lower case."""


def read_packages(files: Sequence[IniFile], notes: WarningLog) -> Definitions:
    """Return the packages that `[USARMisPkg.X]` sections define; Links of a later file replace earlier ones.

    Raises:
        SpecError: An invalid link; names file and line.
    """
    found: dict[str, Definition] = {}
    for file in files:
        for name in dict.fromkeys(section.name.lower() for section in file.sections):
            if not name.startswith(PREFIX):
                continue
            section = file.section(name)
            by_uu = section.last("bMountByUU")
            units = Units(by_uu is not None and as_bool(by_uu, by_uu.value, "bMountByUU"), file.uu_per_metre)
            for line in section.lines:
                if line.key.lower() not in ("links", "bmountbyuu", "tipoffset"):
                    notes.add(line, f"unknown key {line.key}; a package has Links, bMountByUU and TipOffset")
            links = tuple(_link_line(line, units, notes) for line in section.get_all("Links"))
            _check_tree(links)
            offset = section.last("TipOffset")
            own, before = name.removeprefix(PREFIX), found.get(name.removeprefix(PREFIX), Definition())
            if links or offset is not None:
                tip = before.tip if offset is None else as_vector(offset, offset.value, "TipOffset")
                found[own] = Definition(links or before.links, tip)
    return found


def _link_line(line: Line, units: Units, notes: WarningLog) -> LinkLine:
    struct = as_struct(line)
    fields: list[tuple[str, IniValue]] = []
    for key, value in struct.fields:
        if reason := {name.lower(): text for name, text in LINK_IGNORED.items()}.get(key.lower()):
            notes.add(line, f"{key} is ignored: {reason}")
        else:
            fields.append((SYNONYMS.get(key.lower(), key), value))
    named = Struct(tuple(fields))
    reject_unknown(line, named, LINK_FIELDS)
    number = number_of(line, named, "Number")
    if number < 1 or number != int(number):
        fail(line, f"Number is {number:g}", "a whole number from 1")
    return LinkLine(int(number), line, named, units)


def _check_tree(links: Sequence[LinkLine]) -> None:
    """Refuse a link with a repeated number, or with a parent that is not defined before it."""
    known = {-1}
    for link in links:
        if len(known) > MAX_LINKS:
            fail(link.line, f"this is link {len(known)} of a package", f"at most {MAX_LINKS}")
        if link.number in known:
            fail(link.line, f"link {link.number} is there twice", "one line for each link")
        parent = link.fields.get("Parent")
        if parent is not None and int(as_number(link.line, parent, "Parent")) not in known:
            fail(link.line, f"Parent {parent} is no link before this one", f"one of {sorted(known)}")
        known.add(link.number)


def _shapes(link: LinkLine, before: Link) -> tuple[Shape, ...]:
    """Return the previous solids, or one box of the given Size and Mass."""
    if link.fields.get("Size") is None and link.fields.get("Mass") is None:
        return before.shapes
    mass = number_of(link.line, link.fields, "Mass", sum(shape.mass for shape in before.shapes), above=0.0)
    if link.fields.get("Size") is None:
        share = mass / sum(shape.mass for shape in before.shapes)
        return tuple(replace(shape, mass=shape.mass * share) for shape in before.shapes)
    x, y, z = (abs(edge) / 2 for edge in link.units.position(vector_of(link.line, link.fields, "Size")))
    return (Shape(kind="box", size=(x, y, z), mass=mass, surface="fixture", rgba=(0.1, 0.1, 0.1, 1.0)),)


def _link(link: LinkLine, before: Link | None, base: Vec3) -> Link:
    """Return a link with the changes of its line; `base` is the position of the package."""
    line, fields, units = link.line, link.fields, link.units
    parent = int(number_of(line, fields, "Parent", before.parent if before else -1))
    before = before or replace(DEFAULT_LINK, location=base if parent == -1 else ZERO)
    location = before.location
    if fields.get("Location") is not None:
        own = units.position(vector_of(line, fields, "Location"))
        location = _sum(base, own) if parent == -1 else own
    orientation = before.orientation
    if fields.get("Orientation") is not None:
        orientation = units.angles(vector_of(line, fields, "Orientation"))
    joint = as_name(line, fields.get("JointType", before.joint), "JointType").capitalize()
    if joint not in JOINT_TYPES:
        fail(line, f"JointType is {joint}", " or ".join(JOINT_TYPES))
    speed = number_of(line, fields, "MaxSpeed", before.max_speed, above=0.0)
    torque = number_of(line, fields, "MaxTorque", before.max_torque, above=0.0)
    motor = before.motor
    if motor is not None:
        if fields.get("MaxSpeed") is not None:
            motor = replace(motor, max_speed=speed)
        motor = replace(motor, torque=motor.torque * torque / before.max_torque)
    return Link(
        number=link.number,
        parent=parent,
        location=location,
        orientation=orientation,
        max_speed=speed,
        max_torque=torque,
        min_range=number_of(line, fields, "MinRange", before.min_range),
        max_range=number_of(line, fields, "MaxRange", before.max_range),
        shapes=_shapes(link, before),
        joint="Revolute" if joint == "Revolute" else "Prismatic",
        motor=motor,
        looks=before.looks if fields.get("Size") is None else (),
    )


def redefine(package: MissionPackage, definitions: Definitions) -> MissionPackage:
    """Return a package with the links of an ini file; fields without a value stay."""
    found = definitions.get(package.name.lower(), Definition())
    tip = package.tip if found.tip is None else found.tip
    if not found.links:
        return replace(package, tip=tip)
    base = base_of(package)
    before = {link.number: link for link in package.links}
    links = tuple(_link(line, before.get(line.number), base) for line in found.links)
    return replace(package, links=links, tip=tip)


def base_of(package: MissionPackage) -> Vec3:
    """Return the position of a package on the chassis, that of its first link."""
    return next((link.location for link in package.links if link.parent == -1), ZERO)


def _sum(first: Vec3, second: Vec3, sign: int = 1) -> Vec3:
    x, y, z = (a + sign * b for a, b in zip(first, second, strict=True))
    return (x, y, z)


def templates(packages: Iterable[MissionPackage], definitions: Definitions) -> dict[str, MissionPackage]:
    """Return packages by class name in lower case, with the ini files' changes, mounted at the origin."""
    found: dict[str, MissionPackage] = {}
    for package in packages:
        bare = mount_package(package, _sum(ZERO, base_of(package), -1))
        found[package.name.lower()] = redefine(bare, definitions)
    return found


def known_packages(robots: Registry[RobotSpec], definitions: Definitions) -> dict[str, MissionPackage]:
    """Return all packages: the robots', those of `PACKAGES`, and new ones of the ini files."""
    new = [MissionPackage(name=name, links=()) for name, found in definitions.items() if found.links]
    others = [package for _, robot in robots for package in robot.packages]
    return templates([*new, *others, *(package for _, package in PACKAGES)], definitions)


def read_package(line: Line, known: Mapping[str, MissionPackage]) -> MissionPackage:
    """Return the package that a MisPkgs line mounts (manual 10.15.2).

    Location is in metres and z down regardless of bMountByUU (KRobot.uc).

    Raises:
        SpecError: No such package class; names file and line, and the known classes.
    """
    struct = as_struct(line)
    reject_unknown(line, struct, ("PkgName", "Location", "PkgClass"))
    name = as_name(line, struct.get("PkgName"), "PkgName")
    kind = as_class(line, struct.get("PkgClass", name), "PkgClass")
    if kind.lower() not in known:
        names = sorted({package.name for package in known.values()})
        fail(line, f"unknown PkgClass {kind!r}", f"one of {', '.join(names)}")
    return mount_package(known[kind.lower()], vector_of(line, struct, "Location"), name)
