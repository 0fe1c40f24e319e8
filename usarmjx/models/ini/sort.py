"""The sections of ini files, sorted by what they are about: robots, classes of items, tracks."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from usarmjx.base.registry import Registry
from usarmjx.models.ini.classes import ItemClasses
from usarmjx.models.ini.figures import LENGTHS, SETTERS
from usarmjx.models.ini.items import ITEM_LISTS, Settings, WarningLog, kind_of, read_settings
from usarmjx.models.ini.keys import KNOWN_IGNORED, SECTIONS_ELSEWHERE
from usarmjx.models.ini.packages import PREFIX
from usarmjx.models.ini.parse import IniFile, Line, Section
from usarmjx.models.ini.read import Units, as_bool
from usarmjx.models.ini.spec import RobotSection
from usarmjx.models.ini.stereo import STEREO_KEYS
from usarmjx.models.ini.tracks import TRACKS
from usarmjx.models.spec.robot import Options, RobotSpec

ROBOT_PREFIX = "usarbot."
LISTS = (*ITEM_LISTS, "MisPkgs", "Wheels")
ADDS = tuple(f"Add{name}" for name in (*ITEM_LISTS, "MisPkgs"))
JOINT_KEYS = ("JointParts", "JointPart")
OTHER_KEYS = ("BaseClass", "Dimensions", "CenterOfMass", "bMountByUU", "bAbsoluteCamera")


@dataclass
class SortedSections:
    """The sections of all files, by what they are about.

    Attributes:
        robots: What each robot class is told, by its name in lower case.
        defaults: Options of each type of item.
        lines: Where a default stands, by type and key.
        tracks: Lines with the number of tires, by robot, then by end.
    """

    robots: dict[str, RobotSection] = field(default_factory=dict)
    defaults: dict[str, Options] = field(default_factory=dict)
    lines: dict[tuple[str, str], Line] = field(default_factory=dict)
    tracks: dict[str, dict[str, Line]] = field(default_factory=dict)


def sort_sections(
    files: Sequence[IniFile],
    robots: Registry[RobotSpec],
    settings: Settings | None,
    notes: WarningLog,
    classes: ItemClasses,
) -> SortedSections:
    """Return what the files say, in order; sections and keys that mean nothing become warnings.

    The sections of item classes of the files' own are left out.

    Raises:
        SpecError: A value of the wrong kind; names file and line.
    """
    found = SortedSections()
    for file in files:
        for name in dict.fromkeys(section.name.lower() for section in file.sections):
            section = file.section(name)
            if name.startswith(PREFIX) or not section.lines or name.removeprefix(ROBOT_PREFIX) in classes:
                continue
            if name in map(str.lower, SECTIONS_ELSEWHERE):
                continue
            if name.startswith(ROBOT_PREFIX):
                _take_section(found, section, robots, settings, Units(uu_per_metre=file.uu_per_metre), notes)
            else:
                notes.add(section.lines[0], f"section [{section.name}] is not about robots: ignored")
    return found


def _take_section(
    found: SortedSections,
    section: Section,
    robots: Registry[RobotSpec],
    settings: Settings | None,
    units: Units,
    notes: WarningLog,
) -> None:
    name = section.name[len(ROBOT_PREFIX) :]
    robot, end = _track_of(name, robots)
    if name in robots:
        _take_orders(found, name, section, units, notes)
    elif (kind := kind_of(name, settings)) is not None:
        _take_defaults(found, kind, section.lines, settings, notes)
    elif robot:
        _take_track(found.tracks.setdefault(robot, {}), end, section, notes)
    else:
        _take_orders(found, name, section, units, notes)


def _take_track(tracks: dict[str, Line], end: str, section: Section, notes: WarningLog) -> None:
    for line in section.lines:
        if line.key.lower() == "numtires":
            tracks[end] = line
        else:
            notes.add(line, f"unknown key {line.key}; a track has NumTires (ours)")


def _track_of(name: str, robots: Registry[RobotSpec]) -> tuple[str, str]:
    """Return the robot and the end that `TarantulaFrontTrack` names; nothing if it names none."""
    for end in TRACKS:
        owner = name.lower().removesuffix(f"{end}track")
        if owner != name.lower() and owner in robots:
            return robots.get(owner).name, end
    return "", ""


def _take_defaults(
    found: SortedSections, kind: str, lines: Sequence[Line], settings: Settings | None, notes: WarningLog
) -> None:
    if settings is not None and kind not in settings:
        notes.add(lines[0], f"there is no {kind} yet: its settings are ignored")
        return
    given = read_settings(kind, [(line.key, line, line.value) for line in lines], settings, notes)
    merged = dict(found.defaults.get(kind, ())) | dict(given)
    found.defaults[kind] = tuple(merged.items())
    found.lines |= {(kind, line.key): line for line in lines}


def _take_orders(found: SortedSections, name: str, section: Section, units: Units, notes: WarningLog) -> None:
    """Take one file's lines about one robot class."""
    orders = found.robots.setdefault(
        name.lower(), RobotSection(name=name, first=section.lines[0], units=units)
    )
    orders.units = replace(orders.units, uu_per_metre=units.uu_per_metre)
    if (by_uu := section.last("bMountByUU")) is not None:
        orders.units = replace(orders.units, by_uu=as_bool(by_uu, by_uu.value, "bMountByUU"))
    for key in LISTS:
        if lines := section.get_all(key):
            orders.lists[key] = [(line, orders.units) for line in lines]
    for key in ADDS:
        orders.lists.setdefault(key, []).extend((line, orders.units) for line in section.get_all(key))
    joints = [line for line in section.lines if line.key.lower() in map(str.lower, JOINT_KEYS)]
    if joints:
        orders.joints = _numbered(joints, orders.units)
    single = {key.lower() for key in (*SETTERS, *LENGTHS, *STEREO_KEYS, *OTHER_KEYS)}
    listed = {key.lower() for key in (*LISTS, *ADDS, *JOINT_KEYS)}
    ignored = {key.lower(): reason for key, reason in KNOWN_IGNORED.items()}
    for line in section.lines:
        key = line.key.lower()
        if key in single:
            orders.figures[key] = line
        elif key in ignored:
            notes.add(line, f"{line.key} is ignored: {ignored[key]}")
        elif key not in listed:
            notes.add(line, f"unknown key {line.key}")


def _numbered(lines: Sequence[Line], units: Units) -> dict[int, tuple[Line, Units]]:
    """Return lines by their index; one without takes the next number."""
    found: dict[int, tuple[Line, Units]] = {}
    for line in lines:
        number = line.index if line.index is not None else max(found, default=-1) + 1
        found[number] = (line, units)
    return found
