"""Mounted items of ini files: Sensors, Effecters and Cameras, their classes and defaults; ignored keys."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import NamedTuple

from usarmjx.base.errors import SpecError, UnknownNameError, UsageError
from usarmjx.models.ini.parse import (
    UU_PER_RADIAN,
    IniFile,
    IniValue,
    Line,
    Section,
    Struct,
    Units,
    as_class,
    as_name,
    as_number,
    as_struct,
    fail,
    vector_of,
)
from usarmjx.models.types.robot import CHASSIS, Mount, Options, RobotSpec, checked, field_name, options

ITEM_CLASSES = {
    "SonarSensor": "Sonar",
    "IRSensor": "IR",
    "RangeScanner": "RangeScanner",
    "IRScanner": "IRScanner",
    "RangeScanner3D": "RangeScanner3D",
    "OdometrySensor": "Odometry",
    "GPSSensor": "GPS",
    "INS": "INS",
    "INSSensor": "INS",
    "INU": "INU",
    "INUSensor": "INU",
    "EncoderSensor": "Encoder",
    "TouchSensor": "Touch",
    "RFIDSensor": "RFID",
    "VictSensor": "VictSensor",
    "SoundSensor": "Sound",
    "HumanMotionSensor": "HumanMotion",
    "CO2Sensor": "CO2Sensor",
    "GroundTruth": "GroundTruth",
    "GroundTruthSensor": "GroundTruth",
    "RobotCamera": "Camera",
    "USARCamera": "Camera",
    "Gripper": "Gripper",
    "RFIDReleaser": "RFIDReleaser",
    "RollerTable": "RollerTable",
    "Vacuum": "Vacuum",
}
"""Type on the wire and in `Mount.kind` of each class of items (manual 10 and 11)."""


class ItemClass(NamedTuple):
    """An item class of an ini file.

    Attributes:
        kind: Type of its items.
        options: Its defaults, merged with those of its base class.
    """

    kind: str
    options: Options


LATER_ITEM_CLASSES: Mapping[str, ItemClass] = {
    "sick": ItemClass("RangeScanner", options(MaxRange=20.0, ScanFov=3.14159, Resolution=0.01745)),
    "hokuyourg04lx": ItemClass(
        "RangeScanner",
        options(MaxRange=4.0, ScanFov=4.189, Resolution=0.0184086914, ScanInterval=0.3),
    ),
}
"""Item classes of the later versions in lower case: type and settings (their DefaultUSAR.ini)."""

UU_ANGLES = ("Resolution", "ScanFov")
"""Angles that the manual gives in whole Unreal units (10.3.2); a number with a point is in radians."""

OLD_PARTS = {"cameratilt": "CameraPanTilt_Link2", "camerapan": "CameraPanTilt_Link1"}
"""Captured part names of names before V3.0, which the excerpt of manual 12.1.2 still has."""

_NO_MESHES = "robots look as their solids do: there are no Unreal meshes and textures"
_SERVO = "servos go to their target at full speed and hold it as a spring does: no gap within which they slow"

KNOWN_IGNORED = {
    "StaticMesh": _NO_MESHES,
    "DrawScale": _NO_MESHES,
    "DrawScale3D": _NO_MESHES,
    "RobotSkins": _NO_MESHES,
    "KParams": "it names a Karma object inside an Unreal package; CenterOfMass (ours) moves the mass",
    "ConverterClass": "units and axes of the wire are fixed: metres, radians, z down",
    "HingePropGap": _SERVO,
    "SteerPropGap": _SERVO,
    "TireAdhesion": "contacts push and rub, and never pull: nothing sticks to anything",
    "TorqueCurve": "motors have one torque at all speeds",
    "SafeForce": "joints do not stall under overload",
    "ProtectTime": "joints do not stall under overload",
    "FlipTorque": "DRIVE {Flip} turns a robot with a torque that follows from its weight and length",
    "FlipTime": "DRIVE {Flip} lasts 3 s, the original's default, for every robot",
    "HeadLights": "every robot has one headlight, at its front",
    "CamTexActors": "an omnidirectional camera needs no second camera behind a texture",
    "logging_period": "usarmjx writes no position log of its own",
    "bDebug": "there is no Unreal log",
    "bBarCode": "it drew into the Unreal client's window",
    "bDisplayTeamBeacon": "it drew into the Unreal client's window",
}
"""Keys of a robot's section (manual 12.1.2, 14.4.2.3, KRobot.uc) without effect, with the reason."""

JOINT_IGNORED = {
    "DrawScale3D": _NO_MESHES,
}
"""The same for a part-joint pair (14.4.2.4)."""

ITEM_IGNORED = {"uuDirection": "it is the original's own note of Direction in Unreal units"}
"""The same for a mounted item (14.4.2.5)."""

_WHEELS = (
    "an INS has no wheels: the manual's 10.6.2 describes the key, which comes from 10.4.2, without showing it"
)
SETTINGS_IGNORED = {("INS", "righttire"): _WHEELS, ("INS", "lefttire"): _WHEELS}
"""The same for settings of a type of item, by type and key in lower case."""

SECTIONS_ELSEWHERE = ("USARBot.MultiView", "BotAPI.BotServer", "USARBotAPI.BotServer")
"""Sections that other readers use: the image server, the Gamebots server."""

LINK_IGNORED = {
    name: "it refers to a class of an Unreal package; Location, Orientation and the limits are given directly"
    for name in ("LinkClass", "ParentMount", "SelfMount", "DrawScale3D")
}
"""Fields of the original's Links (KRobot.uc) with direct equivalents here."""


ITEM_LISTS = {"Sensors": "sensors", "Effecters": "effecters", "Cameras": "cameras"}
"""Keys that list items, and their fields of RobotSpec."""
ITEM_FIELDS = ("ItemClass", "ItemName", "Parent", "Position", "Direction", *ITEM_IGNORED)
"""Fields of an item's line that are no settings."""
MAX_EXAMPLES = 3
"""Number of examples in a warning."""

Settings = Mapping[str, type]
"""Dataclass of the settings of each type of item, with fields named after ini keys."""

ROBOT_PREFIX = "usarbot."
"""Prefix of sections of robots and items."""

BASE_KEY = "BaseClass"
"""Key of the base class of a section."""

MAX_BASE_CLASSES = 32
"""Largest length of a chain of base classes."""


@dataclass
class WarningLog:
    """Warnings in the order of their occurrence; one that several lines of a file cause is one text."""

    _lines: dict[tuple[str, str], list[int]] = field(default_factory=dict[tuple[str, str], list[int]])

    @property
    def texts(self) -> list[str]:
        """The warnings, each with its file, its first line and the others behind it."""
        return [f"{file}:{lines[0]}: {text}{_also(lines[1:])}" for (file, text), lines in self._lines.items()]

    def add(self, line: Line, text: str) -> None:
        """Add a warning about a line."""
        # By text, not by line: one wrong key in fifty sections is one warning.
        lines = self._lines.setdefault((line.file, text), [])
        if line.line not in lines:
            lines.append(line.line)


def _also(lines: Sequence[int]) -> str:
    if not lines:
        return ""
    return f" (also in line{'s' * (len(lines) > 1)} {', '.join(map(str, lines))})"


def kind_of(name: str, settings: Settings | None) -> str | None:
    """Return the type of an item class, case ignored, or None if it is unknown."""
    kinds = {known.lower(): kind for known, kind in ITEM_CLASSES.items()}
    # Types of sensors by themselves count too: files of the later versions have no class for some of them.
    kinds |= {kind.lower(): kind for kind in settings or ()}
    return kinds.get(name.lower())


def read_setting(kind: str, key: str, line: Line, value: IniValue, settings: Settings | None) -> Options:
    """Return one key of an item as an option.

    Args:
        kind: Type of the item.
        key: The key.
        line: Its line.
        value: Its value.
        settings: Settings by type; None skips the check.

    Raises:
        UnknownNameError: The type has no such key.
        SpecError: A value of the wrong kind.
    """
    option = ((key, _setting_value(line, key, value)),)
    if settings is not None and kind in settings:
        try:
            checked(settings[kind], option, kind)
        # Unknown keys are warnings further up, wrong values are errors.
        except UnknownNameError:
            raise
        except UsageError as error:
            raise SpecError(f"{line.file}:{line.line}: {error}") from error
    return option


def _setting_value(line: Line, key: str, value: IniValue) -> object:
    """Convert a value to a setting: curves to points, other structs to options, angles to radians."""
    if isinstance(value, Struct) and (points := value.get("Points")) is not None:
        return tuple(_point(line, point) for point in (points if isinstance(points, tuple) else ()))
    if isinstance(value, Struct):
        return value.fields
    # The point in the text decides, so the type of the number that was read does.
    if field_name(key) in map(field_name, UU_ANGLES) and isinstance(value, int):
        return as_number(line, value, key, above=0.0) / UU_PER_RADIAN
    return value


def _point(line: Line, point: IniValue) -> tuple[float, float]:
    if not isinstance(point, Struct):
        fail(line, f"a point of {line.key} is {point!r}", "(InVal=number,OutVal=number)")
    first, second = (as_number(line, point.get(name), name) for name in ("InVal", "OutVal"))
    return first, second


def read_settings(
    kind: str, pairs: Iterable[tuple[str, Line, IniValue]], settings: Settings | None, notes: WarningLog
) -> Options:
    """Return keys of an item as options; unknown ones become warnings."""
    # A list, not a mapping: the last of several spellings of a key counts, as the reader of settings decides.
    found: list[tuple[str, object]] = []
    for key, line, value in pairs:
        reason = SETTINGS_IGNORED.get((kind, key.lower()))
        if reason is not None:
            notes.add(line, f"{key} is ignored: {reason}")
            continue
        try:
            found += read_setting(kind, key, line, value, settings)
        except UnknownNameError as error:
            notes.add(line, f"unknown key: {error}")
    return tuple(found)


def read_mount(
    line: Line,
    units: Units,
    settings: Settings | None,
    notes: WarningLog,
    classes: Mapping[str, tuple[str, Options]] = MappingProxyType({}),
) -> Mount | None:
    """Return the item that a line of Sensors, Effecters or Cameras mounts (manual 12.1.2, 14.4.2.5).

    Names within the brackets beyond the manual's structure are settings of this one item (ours). None, with a
    warning, for a class that is known but not built.

    Args:
        line: The line.
        units: Units of its Position and Direction.
        settings: Settings by type.
        notes: Log of warnings.
        classes: Type and defaults of the files' own item classes, by name in lower case.

    Raises:
        SpecError: Something is missing or wrong; names file and line.
    """
    struct = as_struct(line)
    written = as_class(line, struct.get("ItemClass"), "ItemClass")
    # A class of the files' own goes before one of the later versions by that name.
    known = {**LATER_ITEM_CLASSES, **classes}
    kind, inherited = known.get(written.lower(), (kind_of(written, settings), ()))
    if kind is None:
        fail(line, f"unknown ItemClass {written!r}", f"one of {', '.join((*ITEM_CLASSES, *classes))}")
    name = as_name(line, struct.get("ItemName"), "ItemName")
    if settings is not None and kind not in settings:
        notes.add(line, f"{name} is left out: there is no {kind} yet")
        return None
    for key, _ in struct.fields:
        if key.lower() in {ignored.lower() for ignored in ITEM_IGNORED}:
            notes.add(line, f"{key} is ignored: {ITEM_IGNORED['uuDirection']}")
    own = [(key, line, value) for key, value in struct.fields if not _is_field(key)]
    return Mount(
        kind=kind,
        name=name,
        at=units.position(vector_of(line, struct, "Position")),
        direction=units.angles(vector_of(line, struct, "Direction")),
        parent=_parent(line, struct),
        options=merged(inherited, read_settings(kind, own, settings, notes)),
    )


def merged(before: Options, after: Options) -> Options:
    """Return options, of which later ones override earlier ones."""
    if not before:
        return after
    # By field: keys may be spelt in several ways.
    named = {field_name(key): (key, value) for key, value in (*before, *after)}
    return tuple(named.values())


def _is_field(key: str) -> bool:
    return key.lower() in {name.lower() for name in ITEM_FIELDS}


def _parent(line: Line, struct: Struct) -> str:
    """Return the parent part of an item; none, `None` and `HARD` mean the chassis (KRobot.uc)."""
    value = struct.get("Parent")
    if value is None or value == "":
        return CHASSIS
    name = as_name(line, value, "Parent")
    return CHASSIS if name.lower() in ("none", CHASSIS.lower()) else name


def resolve_parent(mount: Mount, line: Line, names: Sequence[str], notes: WarningLog) -> Mount:
    """Return a mount with its parent in the robot's spelling, older names replaced.

    Raises:
        SpecError: The robot has no such part; lists its parts.
    """
    spelt = {name.lower(): name for name in names}
    wanted = mount.parent.lower()
    if wanted not in spelt and OLD_PARTS.get(wanted, "").lower() in spelt:
        notes.add(line, f"Parent {mount.parent} is the older name of {OLD_PARTS[wanted]}")
        wanted = OLD_PARTS[wanted].lower()
    if wanted not in spelt:
        fail(line, f"{mount.name} has an unknown Parent {mount.parent!r}", f"one of {', '.join(names)}")
    return replace(mount, parent=spelt[wanted])


def with_defaults(
    robot: RobotSpec, defaults: Mapping[str, Options], kept: dict[tuple[str, str], list[str]]
) -> RobotSpec:
    """Return a robot whose items have the defaults of their classes' sections, unless their options differ.

    Args:
        robot: The robot.
        defaults: Options by type of item.
        kept: Output: names of the items with options of their own, by type and key.
    """

    def filled(mount: Mount) -> Mount:
        given = defaults.get(mount.kind, ())
        # Options of a single item override the defaults of its class, whichever file comes last.
        own = {field_name(key) for key, _ in mount.options}
        for key, _ in given:
            if field_name(key) in own:
                kept.setdefault((mount.kind, key), []).append(f"{robot.name} {mount.name}")
        given = tuple((key, value) for key, value in given if field_name(key) not in own)
        return replace(mount, defaults=merged(mount.defaults, given)) if given else mount

    fields = {name: tuple(filled(mount) for mount in getattr(robot, name)) for name in ITEM_LISTS.values()}
    return replace(robot, **fields)


def examples(names: Sequence[str]) -> str:
    """Return the first names of a list, and the number of the others."""
    more = len(names) - MAX_EXAMPLES
    return ", ".join(names[:MAX_EXAMPLES]) + (f" and {more} more" if more > 0 else "")


ItemClasses = Mapping[str, ItemClass]
"""Item classes of ini files, by their names in lower case."""


def read_classes(
    files: Sequence[IniFile], robots: Iterable[str], settings: Settings | None, notes: WarningLog
) -> dict[str, ItemClass]:
    """Return the item classes that sections derive from others, in any order.

    Args:
        files: The ini files; of a section in several of them a later one overrides.
        robots: Names of the robot classes, whose sections are skipped.
        settings: Settings by type.
        notes: Log of warnings.

    Raises:
        SpecError: A value of the wrong kind; names file and line.
    """
    taken = {name.lower() for name in robots}
    waiting = {name: parts for name, parts in _based(files).items() if name not in taken}
    found: dict[str, ItemClass] = {}
    # Each round resolves the classes whose base is known by then. The rest has an unknown base, or none.
    rounds = 0
    while ready := {name: base for name in waiting if (base := _base(name, waiting, found, settings))}:
        rounds += 1
        if rounds > MAX_BASE_CLASSES:
            line = _base_line(waiting[next(iter(ready))])
            assert line is not None
            fail(
                line, f"item classes are based on each other {rounds} in a row", f"at most {MAX_BASE_CLASSES}"
            )
        for name, base in ready.items():
            own = _options(base.kind, waiting.pop(name), settings, notes)
            found[name] = ItemClass(base.kind, merged(base.options, own))
    return found


def _based(files: Sequence[IniFile]) -> dict[str, list[Section]]:
    """Return the sections with a BaseClass, all files' together, by name in lower case."""
    found: dict[str, list[Section]] = {}
    for file in files:
        for name in dict.fromkeys(section.name.lower() for section in file.sections):
            if name.startswith(ROBOT_PREFIX):
                found.setdefault(name.removeprefix(ROBOT_PREFIX), []).append(file.section(name))
    return {name: parts for name, parts in found.items() if _base_line(parts) is not None}


def _base_line(parts: Sequence[Section]) -> Line | None:
    lines = [line for part in parts if (line := part.last(BASE_KEY)) is not None]
    return lines[-1] if lines else None


def _base(
    name: str, waiting: Mapping[str, Sequence[Section]], found: ItemClasses, settings: Settings | None
) -> ItemClass | None:
    """Return the item class on which a waiting one is based, None if there is none, or none yet.

    A section about a class of the later versions is based on that class itself.
    """
    line = _base_line(waiting[name])
    if line is None:
        return None
    written = as_class(line, line.value, BASE_KEY)
    kind, base = kind_of(written, settings), written.lower()
    if kind is not None:
        return ItemClass(kind, ())
    # A later round resolves it, when its base is known.
    if base in waiting and base != name:
        return None
    return found.get(base) or LATER_ITEM_CLASSES.get(base)


def _options(kind: str, parts: Sequence[Section], settings: Settings | None, notes: WarningLog) -> Options:
    lines = [line for part in parts for line in part.lines if line.key.lower() != BASE_KEY.lower()]
    return read_settings(kind, [(line.key, line, line.value) for line in lines], settings, notes)
