"""Robots from USARBot.ini and USARMisPkg.ini (manual 12.1.2, 14.4.2): changed and new classes.

Files are read in order; the last value of a key counts. A list (Sensors, Effecters, Cameras, MisPkgs,
JointParts, Wheels) of one file replaces the class's own or an earlier file's, as Unreal's arrays do.
AddSensors, AddEffecters, AddCameras and AddMisPkgs (ours) add to it instead, and so do Sensors, Effecters,
Cameras and MisPkgs whose lines in that file all have a `+`. `-Sensors=` takes an item of that name and class
away, `!Sensors=` all of them, whether the class or an earlier file has them.

Files of USARSim's later versions, on the Unreal Development Kit, are put in the terms of the manual's first.
Their `DefaultUSAR.ini` has sensors in sections `[USARSensor.X]`, mounts all items by `AddParts`, and has
other classes of robots and sections of the game. Names with the same meaning are renamed; of the rest each
class is named once, with the reason.
"""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from usarmjx.base.errors import SpecError, UsageError
from usarmjx.base.registry import Registry
from usarmjx.models.ini.items import (
    ITEM_LISTS,
    KNOWN_IGNORED,
    LATER_ITEM_CLASSES,
    MAX_BASE_CLASSES,
    ROBOT_PREFIX,
    SECTIONS_ELSEWHERE,
    ItemClasses,
    Settings,
    WarningLog,
    examples,
    kind_of,
    read_classes,
    read_settings,
    with_defaults,
)
from usarmjx.models.ini.pairs import PACKAGE_PREFIX, known_packages, read_packages, redefine
from usarmjx.models.ini.parameters import LENGTHS, SETTERS, STEREO_KEYS, TRACKS, read_tracks
from usarmjx.models.ini.parse import (
    UU_PER_METRE,
    IniFile,
    IniValue,
    Line,
    Reference,
    Section,
    Struct,
    Units,
    as_bool,
    as_class,
    as_number,
    fail,
    read_ini,
)
from usarmjx.models.ini.spec import BuildContext, RobotSection, build_robot
from usarmjx.models.types.robot import Options, RobotSpec

ITEM_PACKAGES = ("usarsensor.", "usaractuator.", "usareffector.", "usareffecter.", "usarcamera.")
"""Packages of items in the later versions."""
LATER_ROBOTS = {"p3at": "P2AT"}
"""Robots of the later versions with another name."""
LATER_ITEMS = {
    "odometry": "OdometrySensor",
    "encoder": "EncoderSensor",
    "gpssensor_fixed": "GPSSensor",
    "touch": "TouchSensor",
    "ir2sensor": "IRSensor",
    "imu": "AHRS",
    "battery": "Battery",
    "magneticcompass": "MagneticCompass",
    "kinectdepth": "Kinect",
    "rotatingpointcloudscanner": "PCL",
}
"""Classes of items of the later versions with another name."""
OWN_KINDS = (
    *("AHRS", "Battery", "MagneticCompass", "Tachometer", "AltitudeSensor", "MissionTime"),
    *("LineLaser", "Kinect", "ObjectSensor", "PCL"),
)
"""Types that the manual has no class of."""

WHEELS = {"P2AT": ("RightFWheel", "LeftFWheel", "RightRWheel", "LeftRWheel")}
"""Wheels of a class in the order of their numbers in the later versions (P3AT.uc)."""
ACROSS = Struct((("X", 0.0), ("Y", 0.0), ("Z", -math.pi / 2)))
"""Direction of an encoder that counts a wheel's way ahead: along its axle to the left."""
_WHEEL_NUMBER = re.compile(r"W(\d)")
SENT = "the dialect of the connection decides which keys a reading has"
LATER_IGNORED = {
    "bwithtimestamp": SENT,
    "busegroup": SENT,
    "bsendrange": SENT,
    "hiddensensor": "robots look as their solids do: there are no Unreal meshes to hide",
    "numberofcones": "a sonar's rays fill its cone",
    "tracespercone": "a sonar's rays fill its cone",
    "mass": "weights of items are for the payload only; Weight is the manual's key",
    "scanrate": "a point cloud scanner measures a row for each message: ScanInterval",
    "drifting": "INS drifts as Sigma and Mean say",
    "squaresize": "pictures show a laser's points as balls",
    "linespace": "pictures show a laser's points as balls",
    "ispointonlinevariance": "pictures show a laser's points as balls",
}
"""Keys of items of the later versions without effect, with the reason."""
BATTERY, BATTERY_FIGURES = "battery", {"maxenergy": 1e6, "currentenergy": 1e6, "batterylife": 1200.0}
"""The later versions' class of batteries in lower case, and its figures in DefaultUSAR.ini [J, J, s]."""
LATER_KEYS = {("sonarsensor", "maxangleofincidence"): "MaxIncidence", ("linelaser", "resolution"): "Beams"}
"""Keys of items of the later versions with another name, by class and key in lower case."""
FOREIGN = {
    "usarbotapi.": "the server's settings are options of `usarmjx serve`",
    "botapi.": "the server's settings are options of `usarmjx serve`",
    "usarutility.": "units and axes of the wire are fixed: metres, radians, z down",
    "utgame.": "it is about the Unreal game",
    "engine.": "it is about the Unreal engine",
}
"""Reasons for sections that are not about robots, by their package."""


def reason_of_section(name: str) -> str:
    """Return the reason why a section is ignored; empty: it is not about robots."""
    return next((why for prefix, why in FOREIGN.items() if name.lower().startswith(prefix)), "")


def translated(files: Sequence[IniFile], robots: Sequence[str], notes: WarningLog) -> tuple[IniFile, ...]:
    """Return the files with the later versions' names in the manual's terms; others are unchanged.

    Args:
        files: The files.
        robots: Names of robot classes that exist.
        notes: Log of warnings.
    """
    return tuple(_Translation(file, robots, notes).file() for file in files)


class _Translation:
    """Translation of one file.

    Args:
        file: The file.
        robots: Names of robot classes that exist.
        notes: Log of warnings.
    """

    def __init__(self, file: IniFile, robots: Sequence[str], notes: WarningLog) -> None:
        self._file, self._notes = file, notes
        self._robots = {name.lower() for name in robots}
        self._left_out: dict[str, tuple[Line, int]] = {}
        self._derived: dict[str, Line] = {}
        self._battery = _battery_life(file)

    def file(self) -> IniFile:
        """Return the file in the manual's terms."""
        sections = [part for section in self._file.sections if (part := self._section(section)) is not None]
        # A class of the file's own needs a base: here the later versions' class of the same name.
        for name, line in self._derived.items():
            # At the section's line, to which messages point.
            base = replace(line, key="BaseClass", value=name, adds=False, index=None)
            sections.append(Section(f"USARBot.{name}", (base,)))
        for name, (line, count) in self._left_out.items():
            times = f", {count} lines" if count > 1 else ""
            self._notes.add(line, f"{name} is left out{times}: usarmjx has no such class")
        return replace(self._file, sections=tuple(sections))

    def _section(self, section: Section) -> Section | None:
        """Return a section in the manual's terms; None: it is left out."""
        package, _, name = section.name.lower().partition(".")
        if f"{package}." in ITEM_PACKAGES:
            return self._item_section(section, name)
        if package != "usarbot":
            return section
        name = section.name.partition(".")[2]
        ours = LATER_ROBOTS.get(name.lower(), name)
        lines = tuple(self._part(line, ours) for line in section.lines)
        lines = tuple(line for line in lines if line is not None)
        has_own = any(line.key.lower() == "batterylife" for line in lines)
        if self._battery is not None and not has_own and any(map(_is_battery, lines)):
            lines = (*lines, self._battery)
        # A robot of the user's own by the later name is meant itself.
        if ours != name and name.lower() not in self._robots and lines:
            self._notes.add(lines[0], f"{name} is the later versions' name of {ours}")
            return replace(section, name=f"USARBot.{ours}", lines=lines)
        return replace(section, lines=lines)

    def _item_section(self, section: Section, name: str) -> Section | None:
        if not section.lines:
            return None
        if name == "sensor":
            self._notes.add(
                section.lines[0], f"[{section.name}] is left out: each class of sensors has its own defaults"
            )
            return None
        ours = self._class(section.name.partition(".")[2])
        if ours is None:
            self._note_left_out(section.name, section.lines[0])
            return None
        lines: list[Line] = []
        for line in section.lines:
            key = line.key.lower()
            if name == BATTERY and key in BATTERY_FIGURES:
                continue  # read by `_battery_life`
            if key in LATER_IGNORED:
                self._notes.add(line, f"{line.key} is ignored: {LATER_IGNORED[key]}")
            else:
                lines.append(replace(line, key=LATER_KEYS.get((name, key), line.key)))
        if name in LATER_ITEM_CLASSES:
            self._derived.setdefault(ours, section.lines[0])
        return replace(section, name=f"USARBot.{ours}", lines=tuple(lines))

    def _class(self, name: str) -> str | None:
        """Return our class of a later version's class of items; None: there is none."""
        lowered = name.lower()
        if lowered in LATER_ITEMS:
            return LATER_ITEMS[lowered]
        own = lowered in LATER_ITEM_CLASSES or lowered in map(str.lower, OWN_KINDS)
        return name if own or kind_of(name, None) is not None else None

    def _part(self, line: Line, robot: str) -> Line | None:
        """Return a line with a list of a robot's items in our terms; None: its class is left out."""
        if line.key.lower() != "addparts" or not isinstance(line.value, Struct):
            return line
        written = line.value.get("ItemClass")
        full = written.name if isinstance(written, Reference) else str(written)
        package, _, name = full.rpartition(".")
        # Without a package, `package` is empty, which the single point stands for.
        ours = self._class(name) if f"{package.lower()}." in (*ITEM_PACKAGES, "usarbot.", ".") else None
        parent = line.value.get("Parent")
        if ours is None or (isinstance(parent, str) and parent.lower().startswith("usarmispkg.")):
            self._note_left_out(full if ours is None else f"{full} on {parent}", line)
            return None
        kept: list[tuple[str, IniValue]] = [("ItemClass", ours)]
        for key, value in line.value.fields:
            # The robot itself is the parent by default.
            on_robot = key.lower() == "parent" and str(value).lower().startswith("usarbot.")
            if key.lower() != "itemclass" and not on_robot:
                kept.append((key, value))
        # Readers of items demand a name; the later versions go without.
        if line.value.get("ItemName") is None:
            kept.append(("ItemName", name))
        if ours == LATER_ITEMS["encoder"] and package.lower() == "usarsensor":
            wheel = _wheel_of(robot, str(line.value.get("ItemName", "")))
            if wheel is None:
                self._note_left_out(f"{full} of no known wheel", line)
                return None
            own = ("parent", "position", "direction")
            kept = [(key, value) for key, value in kept if key.lower() not in own]
            kept += [("Parent", wheel), ("Direction", ACROSS)]
        return replace(line, key=_list_of(ours), value=Struct(tuple(kept)), adds=False)

    def _note_left_out(self, name: str, line: Line) -> None:
        first, count = self._left_out.get(name, (line, 0))
        self._left_out[name] = first, count + 1


def _battery_life(file: IniFile) -> Line | None:
    """Return the line of a robot's section that means the same as a file's batteries; None: it has none.

    A battery loses its full energy in its life, so one that begins with less lasts less (Battery.uc).
    """
    lines = {line.key.lower(): line for line in file.section(f"{ITEM_PACKAGES[0]}{BATTERY}").lines}
    lines = {key: line for key, line in lines.items() if key in BATTERY_FIGURES}
    if not lines:
        return None
    figures = {key: as_number(line, line.value, line.key, above=0.0) for key, line in lines.items()}
    # In the order of BATTERY_FIGURES, which an update keeps.
    full, present, life = (BATTERY_FIGURES | figures).values()
    *_, last = lines.values()
    return replace(last, key="batteryLife", value=life * min(present / full, 1.0), adds=False, index=None)


def _is_battery(line: Line) -> bool:
    """Return whether a line, in our terms, mounts a battery."""
    return isinstance(line.value, Struct) and line.value.get("ItemClass") == LATER_ITEMS[BATTERY]


def _wheel_of(robot: str, name: str) -> str | None:
    """Return the wheel whose number is in an encoder's name, such as EncTestW1 (Encoder.uc); None: none."""
    found, wheels = _WHEEL_NUMBER.search(name), WHEELS.get(robot, ())
    number = int(found[1]) if found else len(wheels)
    return wheels[number] if number < len(wheels) else None


def _list_of(item: str) -> str:
    """Return the key that adds items of a class to a robot."""
    kind = kind_of(item, None)
    if kind == "Camera":
        return "AddCameras"
    return "AddEffecters" if kind in ("Gripper", "RFIDReleaser", "RollerTable", "Vacuum") else "AddSensors"


LISTS = (*ITEM_LISTS, "MisPkgs", "Wheels")
"""Keys that replace a list."""
ADDS = tuple(f"Add{name}" for name in (*ITEM_LISTS, "MisPkgs"))
"""Keys that add to a list."""
JOINT_KEYS = ("JointParts", "JointPart")
"""Spellings of the key of part-joint pairs."""
OTHER_KEYS = ("BaseClass", "Dimensions", "CenterOfMass", "bMountByUU", "bAbsoluteCamera")
"""Further keys of one value."""


@dataclass
class SortedSections:
    """The sections of all files, by their subject.

    Attributes:
        robots: Sections of each robot class, by its name in lower case.
        defaults: Options of each type of item.
        lines: Line of each default, by type and key.
        tracks: Lines with the number of tires, by robot, then by end.
    """

    robots: dict[str, RobotSection] = field(default_factory=dict[str, RobotSection])
    defaults: dict[str, Options] = field(default_factory=dict[str, Options])
    lines: dict[tuple[str, str], Line] = field(default_factory=dict[tuple[str, str], Line])
    tracks: dict[str, dict[str, Line]] = field(default_factory=dict[str, dict[str, Line]])


def sort_sections(
    files: Sequence[IniFile],
    robots: Registry[RobotSpec],
    settings: Settings | None,
    notes: WarningLog,
    classes: ItemClasses,
) -> SortedSections:
    """Return the contents of the files, in order; unknown sections and keys become warnings.

    The sections of item classes of the files' own are left out.

    Raises:
        SpecError: A value of the wrong kind; names file and line.
    """
    found = SortedSections()
    for file in files:
        for name in dict.fromkeys(section.name.lower() for section in file.sections):
            # All repetitions of a section as one: the last value of a key counts, wherever it stands.
            section = file.section(name)
            some = section.lines or section.removals
            if name.startswith(PACKAGE_PREFIX) or not some or name.removeprefix(ROBOT_PREFIX) in classes:
                continue
            if name in map(str.lower, SECTIONS_ELSEWHERE):
                continue
            if name.startswith(ROBOT_PREFIX):
                _take_section(found, section, robots, settings, Units(uu_per_metre=file.uu_per_metre), notes)
            else:
                # A section may consist of removals alone.
                line = (section.lines or [section.removals[0].line])[0]
                why = reason_of_section(section.name) or "ignored"
                notes.add(line, f"section [{section.name}] is not about robots: {why}")
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
    # Before all others: they need a first line to point at.
    if not section.lines and name not in robots:
        notes.add(section.removals[0].line, f"section [{section.name}] removes nothing")
    elif name in robots:
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
    """Return the robot and the end of a name like `TarantulaFrontTrack`; empty if it is none."""
    for end in TRACKS:
        owner = name.lower().removesuffix(f"{end}track")
        # Without that ending the name itself comes back.
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
    # A later file overrides single keys, not the whole section.
    merged = dict(found.defaults.get(kind, ())) | dict(given)
    found.defaults[kind] = tuple(merged.items())
    found.lines |= {(kind, line.key): line for line in lines}


def _take_orders(found: SortedSections, name: str, section: Section, units: Units, notes: WarningLog) -> None:
    """Add one file's lines about one robot class."""
    first = section.lines[0] if section.lines else section.removals[0].line
    orders = found.robots.setdefault(name.lower(), RobotSection(name=name, first=first, units=units))
    # Each file has its own scale; `bMountByUU` goes on from file to file.
    orders.units = replace(orders.units, uu_per_metre=units.uu_per_metre)
    if (by_uu := section.last("bMountByUU")) is not None:
        orders.units = replace(orders.units, by_uu=as_bool(by_uu, by_uu.value, "bMountByUU"))
    # First: a file that clears a list fills it anew with its own lines.
    _take_removals(orders, section, notes)
    _take_lists(orders, section)
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


def _take_removals(orders: RobotSection, section: Section, notes: WarningLog) -> None:
    """Apply `!` and `-` of one file to the lists of earlier files, and keep them for the class' own."""
    for removal in section.removals:
        line = removal.line
        key = next((name for name in (*ITEM_LISTS, "MisPkgs") if name.lower() == line.key.lower()), "")
        if not key or line.index is not None:
            if not removal.count:
                sign = "!" if removal.clears else "-"
                notes.add(line, f"{sign}{line.key} removes nothing: no line before has that")
            continue
        if removal.clears:
            orders.lists[key] = []
            orders.lists.pop(f"Add{key}", None)
        elif not removal.count:
            orders.drop(key, line)


def _take_lists(orders: RobotSection, section: Section) -> None:
    """Add one file's lists; a list whose lines all have `+` adds to the present one."""
    for key in LISTS:
        lines = section.get_all(key)
        # One line without a plus begins the list anew.
        if lines and f"Add{key}" in ADDS and all(line.adds for line in lines):
            orders.lists.setdefault(f"Add{key}", []).extend((line, orders.units) for line in lines)
        elif lines:
            orders.lists[key] = [(line, orders.units) for line in lines]
            # A list that begins anew replaces the class' own, so nothing of that is left to drop.
            orders.drops.pop(key, None)
    for key in ADDS:
        orders.lists.setdefault(key, []).extend((line, orders.units) for line in section.get_all(key))


def _numbered(lines: Sequence[Line], units: Units) -> dict[int, tuple[Line, Units]]:
    """Return lines by their index; a line without one takes the next number."""
    found: dict[int, tuple[Line, Units]] = {}
    for line in lines:
        number = line.index if line.index is not None else max(found, default=-1) + 1
        found[number] = (line, units)
    return found


@dataclass(frozen=True)
class LoadedRobots:
    """Contents of ini files, ready to be applied.

    Attributes:
        robots: Changed and new robot classes.
        defaults: Defaults of item classes: type and options.
        warnings: Unknown keys, and known ones without effect and the reason, each with file and line.
        source_lines: First line about each robot class: name, file and line.
    """

    robots: tuple[RobotSpec, ...] = ()
    defaults: tuple[tuple[str, Options], ...] = ()
    warnings: tuple[str, ...] = ()
    source_lines: tuple[tuple[str, str], ...] = ()

    def apply(self, robots: Registry[RobotSpec]) -> None:
        """Put the robot classes into a registry, replacing those of the same name."""
        for robot in self.robots:
            robots.replace(robot.name, robot)


def load_robots(
    paths: Iterable[str | Path],
    robots: Registry[RobotSpec],
    uu_per_metre: float = UU_PER_METRE,
    settings: Settings | None = None,
) -> LoadedRobots:
    """Read ini files without applying them.

    Args:
        paths: USARBot.ini and USARMisPkg.ini files, in any order; a later one overrides.
        robots: Existing robot classes, whose wheels and packages new ones may use.
        uu_per_metre: Length of a metre in Unreal units; 52.5 reads the excerpt of manual 12.1.2.
        settings: Settings of each type of item, from `usarmjx.sim.configure.settings_by_kind`; None accepts
            any key, and building the robot's sensors then fails on unknown ones.

    Raises:
        SpecError: A file that does not read, a value that is wrong, or a robot that cannot be built; the
            message names file and line, what was wrong and what is allowed.
        UsageError: A scale that is not above 0.
    """
    return build_robots(read_files(paths, uu_per_metre), robots, settings)


def read_files(paths: Iterable[str | Path], uu_per_metre: float = UU_PER_METRE) -> tuple[IniFile, ...]:
    """Read ini files whose Unreal units have that scale.

    Raises:
        SpecError: An invalid file; names file and line.
        UsageError: A scale that is not above 0.
    """
    # In this form: NaN is refused as well.
    if not uu_per_metre > 0:
        raise UsageError(f"Unreal units per metre are {uu_per_metre:g}, expected a number above 0")
    return tuple(replace(read_ini(Path(path)), uu_per_metre=uu_per_metre) for path in paths)


def build_robots(
    files: Sequence[IniFile], robots: Registry[RobotSpec], settings: Settings | None = None
) -> LoadedRobots:
    """Return the changed and new robot classes of ini files; see `load_robots`."""
    notes = WarningLog()
    # First of all: what follows knows the manual's names only.
    files = translated(files, robots.names(), notes)
    definitions = read_packages(files, notes)
    classes = read_classes(files, robots.names(), settings, notes)
    found = sort_sections(files, robots, settings, notes, classes)
    sources = BuildContext(
        robots=robots,
        definitions=definitions,
        packages=known_packages(robots, definitions),
        settings=settings,
        warnings=notes,
        classes=classes,
    )
    _leave_out_unknown(found, sources)
    builder = _Builder(found.robots, sources)
    # Before tracks: their robots may be among those built here.
    built = {name: builder.build(name) for name in found.robots}
    for name, counts in found.tracks.items():
        before = built.get(name.lower()) or robots.get(name)
        built[name.lower()] = read_tracks(before, counts)
    kept: dict[tuple[str, str], list[str]] = {}
    changed: list[RobotSpec] = []
    for name in dict.fromkeys([*(name.lower() for name in robots.names()), *built]):
        before = robots.get(name) if name in robots else None
        # Robots without a section count too: a file may redefine a package that they carry.
        robot = built.get(name) or _with_packages(robots.get(name), sources)
        robot = with_defaults(robot, found.defaults, kept)
        if robot != before:
            changed.append(robot)
    for (kind, key), items in kept.items():
        notes.add(found.lines[kind, key], f"{key} leaves alone those that have their own: {examples(items)}")
    positions = tuple((built[key].name, orders.where) for key, orders in found.robots.items())
    return LoadedRobots(tuple(changed), tuple(found.defaults.items()), tuple(notes.texts), positions)


def _leave_out_unknown(found: SortedSections, sources: BuildContext) -> None:
    """Leave out classes that are not known, with a warning, beside others that are.

    Files about unknown classes only are refused later: their names are likely to be misspelt.
    """
    known = set[str](name.lower() for name in sources.robots.names())
    waiting = {name: orders for name, orders in found.robots.items() if name not in known}
    # Until nothing changes: a class may be based on one that stands further down.
    while ready := [name for name, orders in waiting.items() if orders.joints or _base_name(orders) in known]:
        known |= set(ready)
        waiting = {name: orders for name, orders in waiting.items() if name not in known}
    # A chain that leads back to itself is a mistake of another kind.
    lost: dict[str, None] = {}
    while more := [
        n for n, o in waiting.items() if n not in lost and _base_name(o) not in waiting.keys() - lost
    ]:
        lost |= dict.fromkeys(more)
    if len(waiting) == len(found.robots) and not (found.defaults or found.tracks or sources.definitions):
        return
    for name in lost:
        orders = found.robots.pop(name)
        sources.warnings.add(
            orders.first,
            f"[USARBot.{orders.name}] is left out: no robot and no item of usarmjx has that class",
        )


def _base_name(orders: RobotSection) -> str:
    line = orders.figures.get("baseclass")
    return "" if line is None else as_class(line, line.value, "BaseClass").lower()


def _with_packages(robot: RobotSpec, sources: BuildContext) -> RobotSpec:
    packages = tuple(redefine(package, sources.definitions) for package in robot.packages)
    return replace(robot, packages=packages)


class _Builder:
    """Builds the classes that have a section, bases first, each once.

    Args:
        orders: Section of each class, by its name in lower case.
        sources: Context of the build.
    """

    def __init__(self, orders: Mapping[str, RobotSection], sources: BuildContext) -> None:
        self.orders, self.sources = orders, sources
        self.built: dict[str, RobotSpec] = {}

    def build(self, name: str, waiting: tuple[str, ...] = ()) -> RobotSpec:
        """Return a class by its name in lower case; `waiting` are the classes based on it."""
        if name not in self.built:
            order = self.orders[name]
            base = self._base(order, (*waiting, name))
            self.built[name] = build_robot(order, base, self.sources)
        return self.built[name]

    def _base(self, order: RobotSection, waiting: tuple[str, ...]) -> RobotSpec | None:
        """Return the previous class, or the base of a new one; None for a robot made of parts."""
        robots, line = self.sources.robots, order.figures.get("baseclass")
        if order.name in robots and line is not None:
            fail(line, f"{order.name} exists already", "BaseClass in a new class' section only")
        if order.name in robots:
            return _with_packages(robots.get(order.name), self.sources)
        known = ", ".join(robots.names())
        if line is not None:
            name = as_class(line, line.value, "BaseClass")
            # Before it is looked up: the recursion would not end.
            if name.lower() in waiting:
                fail(line, f"{name} is based on itself", "another class")
            if len(waiting) > MAX_BASE_CLASSES:
                fail(
                    line,
                    f"{name} is the base of {len(waiting)} classes in a row",
                    f"at most {MAX_BASE_CLASSES}",
                )
            if name.lower() in self.orders:
                return self.build(name.lower(), waiting)
            if name not in robots:
                fail(line, f"unknown BaseClass {name!r}", f"one of {known}, or an item class")
            return _with_packages(robots.get(name), self.sources)
        if not order.joints:
            raise SpecError(
                f"{order.where}: [USARBot.{order.name}] is neither a robot nor an item class; a new robot "
                f"needs JointParts or a BaseClass; expected one of {known}, or an item class"
            )
        return None
