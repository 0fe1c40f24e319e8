"""Item classes that ini files derive from known ones (manual 10): `[USARBot.MyScanner]` with a BaseClass.

The manual derives sensor classes in Unreal Script; here a section does that (ours): `BaseClass` names the
class that the new one is like, the other keys are the defaults of the new one. On the wire its items are of
the type of the base, as an inherited ItemType is.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from usarmjx.models.ini.items import Settings, WarningLog, kind_of, merged, read_settings
from usarmjx.models.ini.parse import IniFile, Line, Section
from usarmjx.models.ini.read import as_class, fail
from usarmjx.models.spec.robot import Options

PREFIX = "usarbot."
BASE_KEY = "BaseClass"
MOST_ROUNDS = 32
"""Item classes of a file that are based on each other in a row."""


class ItemClass(NamedTuple):
    """An item class of an ini file.

    Attributes:
        kind: Type of its items.
        options: Its defaults, which come before those of the class that it is derived from.
    """

    kind: str
    options: Options


ItemClasses = Mapping[str, ItemClass]
"""Item classes of ini files, by their names in lower case."""


def read_classes(
    files: Sequence[IniFile], robots: Iterable[str], settings: Settings | None, notes: WarningLog
) -> dict[str, ItemClass]:
    """Return the item classes that sections derive from others, in whatever order they stand.

    Args:
        files: The ini files; of a section in several of them a later one overrides.
        robots: Names of the robot classes: sections of these are about robots.
        settings: What there is to set.
        notes: Takes the warnings.

    Raises:
        SpecError: A value of the wrong kind; names file and line.
    """
    taken = {name.lower() for name in robots}
    waiting = {name: parts for name, parts in _based(files).items() if name not in taken}
    found: dict[str, ItemClass] = {}
    # Round by round: those whose base is known by now. What is left over has another base, or none.
    rounds = 0
    while ready := {name: base for name in waiting if (base := _base(waiting[name], found, settings))}:
        rounds += 1
        if rounds > MOST_ROUNDS:
            line = _base_line(waiting[next(iter(ready))])
            assert line is not None
            fail(line, f"item classes are based on each other {rounds} in a row", f"at most {MOST_ROUNDS}")
        for name, base in ready.items():
            own = _options(base.kind, waiting.pop(name), settings, notes)
            found[name] = ItemClass(base.kind, merged(base.options, own))
    return found


def _based(files: Sequence[IniFile]) -> dict[str, list[Section]]:
    """Return the sections in which a BaseClass stands, all files' together, by name in lower case."""
    found: dict[str, list[Section]] = {}
    for file in files:
        for name in dict.fromkeys(section.name.lower() for section in file.sections):
            if name.startswith(PREFIX):
                found.setdefault(name.removeprefix(PREFIX), []).append(file.section(name))
    return {name: parts for name, parts in found.items() if _base_line(parts) is not None}


def _base_line(parts: Sequence[Section]) -> Line | None:
    lines = [line for part in parts if (line := part.last(BASE_KEY)) is not None]
    return lines[-1] if lines else None


def _base(parts: Sequence[Section], found: ItemClasses, settings: Settings | None) -> ItemClass | None:
    """Return the item class that sections are based on, None if that is none, or none yet."""
    line = _base_line(parts)
    if line is None:
        return None
    name = as_class(line, line.value, BASE_KEY)
    kind = kind_of(name, settings)
    return found.get(name.lower()) if kind is None else ItemClass(kind, ())


def _options(kind: str, parts: Sequence[Section], settings: Settings | None, notes: WarningLog) -> Options:
    lines = [line for part in parts for line in part.lines if line.key.lower() != BASE_KEY.lower()]
    return read_settings(kind, [(line.key, line, line.value) for line in lines], settings, notes)
