"""Mounted items of an ini file: Sensors, Effecters and Cameras, and the defaults of their classes."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from usarmjx.base.errors import SpecError, UnknownNameError, UsageError
from usarmjx.models.ini.keys import ITEM_CLASSES, ITEM_IGNORED, OLD_PARTS, SETTINGS_IGNORED, UU_ANGLES
from usarmjx.models.ini.parse import IniValue, Line, Struct
from usarmjx.models.ini.read import (
    UU_PER_RADIAN,
    Units,
    as_class,
    as_name,
    as_number,
    as_struct,
    fail,
    vector_of,
)
from usarmjx.models.spec.robot import CHASSIS, Mount, Options, RobotSpec
from usarmjx.models.spec.settings import checked, field_name

ITEM_LISTS = {"Sensors": "sensors", "Effecters": "effecters", "Cameras": "cameras"}
"""Keys that list items, and the fields of RobotSpec that hold them."""
ITEM_FIELDS = ("ItemClass", "ItemName", "Parent", "Position", "Direction", *ITEM_IGNORED)
SHOWN = 3
"""So many examples a warning gives."""

Settings = Mapping[str, type]
"""The settings of each type of item, by type: dataclasses with fields named after ini keys."""


@dataclass
class WarningLog:
    """Warnings, in the order in which they arose, each once."""

    texts: list[str] = field(default_factory=list)

    def add(self, line: Line, text: str) -> None:
        """Add a warning about a line."""
        warning = f"{line.file}:{line.line}: {text}"
        if warning not in self.texts:
            self.texts.append(warning)


def kind_of(name: str, settings: Settings | None) -> str | None:
    """Return the type of an item class, case ignored, or None: one of the manual's or one with settings."""
    kinds = {known.lower(): kind for known, kind in ITEM_CLASSES.items()}
    kinds |= {kind.lower(): kind for kind in settings or ()}
    return kinds.get(name.lower())


def read_setting(kind: str, key: str, line: Line, value: IniValue, settings: Settings | None) -> Options:
    """Return one key of an item as the option it stands for.

    Args:
        kind: Type of the item.
        key: The key.
        line: Where it stands.
        value: What it is set to.
        settings: What there is to set; None checks nothing here.

    Raises:
        UnknownNameError: The type has no such key.
        SpecError: A value of the wrong kind.
    """
    option = ((key, _setting_value(line, key, value)),)
    if settings is not None and kind in settings:
        try:
            checked(settings[kind], option, kind)
        except UnknownNameError:
            raise
        except UsageError as error:
            raise SpecError(f"{line.file}:{line.line}: {error}") from error
    return option


def _setting_value(line: Line, key: str, value: IniValue) -> object:
    """Return a value as settings have it: curves as points, other structs as options, angles in radians."""
    if isinstance(value, Struct) and (points := value.get("Points")) is not None:
        return tuple(_point(line, point) for point in (points if isinstance(points, tuple) else ()))
    if isinstance(value, Struct):
        return value.fields
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
    """Return keys of an item as options; those that it does not have become warnings."""
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

    Names within the brackets that are not of the manual's structure are settings of this one item (ours).
    None, with a warning, for a class that is known but not built.

    Args:
        line: The line.
        units: Of its Position and Direction.
        settings: What there is to set.
        notes: Takes the warnings.
        classes: Type and defaults of the item classes of the files' own, by name in lower case.

    Raises:
        SpecError: Something is missing or wrong; names file and line.
    """
    struct = as_struct(line)
    written = as_class(line, struct.get("ItemClass"), "ItemClass")
    kind, inherited = classes.get(written.lower(), (kind_of(written, settings), ()))
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
    """Return options of which those that come after override those before."""
    if not before:
        return after
    named = {field_name(key): (key, value) for key, value in (*before, *after)}
    return tuple(named.values())


def _is_field(key: str) -> bool:
    return key.lower() in {name.lower() for name in ITEM_FIELDS}


def _parent(line: Line, struct: Struct) -> str:
    """Return the part an item is mounted on; none, `None` and `HARD` mean the chassis (KRobot.uc)."""
    value = struct.get("Parent")
    if value is None or value == "":
        return CHASSIS
    name = as_name(line, value, "Parent")
    return CHASSIS if name.lower() in ("none", CHASSIS.lower()) else name


def resolve_parent(mount: Mount, line: Line, names: Sequence[str], notes: WarningLog) -> Mount:
    """Return a mount with its parent spelt as the robot does, older names replaced.

    Raises:
        SpecError: The robot has no such part; lists those it has.
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
    """Return a robot whose items have what sections say of their classes, unless their own options differ.

    Args:
        robot: The robot.
        defaults: Options by type of item.
        kept: Takes down, by type and key, which items kept their own.
    """

    def filled(mount: Mount) -> Mount:
        given = defaults.get(mount.kind, ())
        own = {field_name(key) for key, _ in mount.options}
        for key, _ in given:
            if field_name(key) in own:
                kept.setdefault((mount.kind, key), []).append(f"{robot.name} {mount.name}")
        given = tuple((key, value) for key, value in given if field_name(key) not in own)
        return replace(mount, defaults=merged(mount.defaults, given)) if given else mount

    fields = {name: tuple(filled(mount) for mount in getattr(robot, name)) for name in ITEM_LISTS.values()}
    return replace(robot, **fields)


def examples(names: Sequence[str]) -> str:
    """Return the first names of a list, and how many more there are."""
    more = len(names) - SHOWN
    return ", ".join(names[:SHOWN]) + (f" and {more} more" if more > 0 else "")
