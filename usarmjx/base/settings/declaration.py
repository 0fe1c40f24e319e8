"""Declaration of settings: limits, unit, help and names of the fields of a dataclass.

A field declares its setting once, as a note of its annotation:

    radius: Annotated[float, Setting(gt=0, unit="m", help="Distance at which a goal counts.")] = 0.5

A field without a note is a setting too: its type is checked and its numbers are finite. Its help is then its
entry in the class docstring's `Attributes` section, and its unit the first `[unit]` of that entry.
"""

import dataclasses
import inspect
import math
import re
import types
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, Union, cast, get_args, get_origin, get_type_hints

Choices = tuple[str, ...] | Callable[[], Iterable[str]]
SEQUENCES = (tuple, list, Sequence)
"""Types that a list is read as."""
MAPPINGS = (dict, Mapping)
"""Types that a mapping of any keys is read as."""
_NUMBERS = {float: ("a number", "numbers"), int: ("a whole number", "whole numbers")}
_WORDS = {bool: "true or false", str: "a text", type(None): "none", Path: "a path", Any: "anything"}
# With a letter or % at least: numbers in brackets are no unit.
_UNIT = re.compile(r"\[([A-Za-z%/^*. 0-9-]*[A-Za-z%][A-Za-z%/^*. 0-9-]*)\]")
_ENTRY = re.compile(r"(\w+(?:, \w+)*): *(.*)")


class RenamedSettingWarning(DeprecationWarning):
    """Use of a setting's name of the version before."""


class UncheckedSettingWarning(UserWarning):
    """Field whose type is imported for type checkers only, so that its values are taken unchecked."""


@dataclass(frozen=True)
class Unresolved:
    """Type hint with a name that does not exist at run time.

    Attributes:
        source: The hint as written.
    """

    source: str

    @property
    def __name__(self) -> str:
        """The hint as written, for texts."""
        return self.source


@dataclass(frozen=True, kw_only=True)
class Setting:
    """Limits and texts of a setting, a note of its annotation; of several notes, later ones have priority.

    Limits of a list or a mapping hold for each of its numbers; its items may have notes of their own.

    Attributes:
        gt: Numbers are above this.
        ge: Numbers are at least this.
        lt: Numbers are below this.
        le: Numbers are at most this.
        finite: Refuse infinity. NaN is always refused.
        choices: Words that a text may be, case ignored; a function where they are registered later.
        min_length: Fewest items of a list or a mapping, or characters of a text.
        max_length: Most of them.
        unit: Unit, as `m` or `rad`; texts may name it or a multiple of it (`text.UNITS`).
        help: One line on what it sets; the docstring's entry if empty.
        manual_key: Key of the manual of USARSim, if it has one.
        aliases: Names that it had in the version before; they are accepted with a warning.
    """

    gt: float | None = None
    ge: float | None = None
    lt: float | None = None
    le: float | None = None
    finite: bool = True
    choices: Choices = ()
    min_length: int | None = None
    max_length: int | None = None
    unit: str = ""
    help: str = ""
    manual_key: str = ""
    aliases: tuple[str, ...] = ()

    def over(self, other: "Setting") -> "Setting":
        """Return the other note with what this one sets; a bound takes the place of both it may be."""
        own = {one.name: getattr(self, one.name) for one in dataclasses.fields(self)}
        # A note sets nothing that it leaves at its default.
        own = {name: value for name, value in own.items() if value != getattr(NO_NOTE, name)}
        for pair in (("gt", "ge"), ("lt", "le")):
            if own.keys() & set(pair):
                # A bound may replace an inclusive one by an exclusive one: the pair goes together.
                own = {**dict.fromkeys(pair), **own}
        return dataclasses.replace(other, **own)

    @property
    def words(self) -> tuple[str, ...]:
        """Words that a text may be; empty: any."""
        return tuple(self.choices() if callable(self.choices) else self.choices)

    @property
    def of_items(self) -> "Setting":
        """The part of the note that holds for the items of a list."""
        # Lengths are those of the list itself; the other limits hold for each item.
        return dataclasses.replace(self, min_length=None, max_length=None)

    @property
    def limits(self) -> str:
        """The limits of a number in words, with a blank before; empty: none."""
        low = f" above {self.gt:g}" if self.gt is not None else ""
        low += f" from {self.ge:g}" if self.ge is not None else ""
        high = f" to {self.le:g}" if self.le is not None else ""
        high += f" below {self.lt:g}" if self.lt is not None else ""
        high = f" up{high}" if not low and self.le is not None else high
        return (
            low + ("," if low and self.lt is not None else "") + high + (" or inf" if not self.finite else "")
        )

    @property
    def limits_and_unit(self) -> str:
        """The limits of a number in words and its unit in brackets, each with a blank before."""
        return self.limits + (f" [{self.unit}]" if self.unit else "")

    def admits(self, number: float) -> bool:
        """Return whether a number is within the limits."""
        return (
            (self.gt is None or number > self.gt)
            and (self.ge is None or number >= self.ge)
            and (self.lt is None or number < self.lt)
            and (self.le is None or number <= self.le)
        )


NO_NOTE = Setting()
POSITIVE = Setting(gt=0)
"""Limits of numbers above 0."""
NOT_NEGATIVE = Setting(ge=0)
"""Limits of numbers that may be 0."""
SHARE = Setting(ge=0, le=1)
"""Limits of shares, from 0 to 1."""
AT_LEAST_ONE = Setting(ge=1)
"""Limits of counts from 1."""


@dataclass(frozen=True, kw_only=True)
class SettingField:
    """A field of a dataclass with all that its declaration says.

    Attributes:
        name: Name of the field.
        hint: Its type, without the notes.
        note: Its notes, with help and unit from the docstring.
        default: Its value if none is given; MISSING of dataclasses: it must be given.
        expects: Type and limits in words, as `a number above 0 [m]`.
    """

    name: str
    hint: Any
    note: Setting
    default: Any
    expects: str

    @property
    def required(self) -> bool:
        """Whether it must be given."""
        return self.default is MISSING

    @property
    def choices(self) -> tuple[str, ...]:
        """Words that it may be, for completion; empty: too many to list."""
        return choices_of(self.hint, self.note)

    @property
    def nested(self) -> type | None:
        """The dataclass that holds settings of its own, if the type names one."""
        # The arguments too: an optional dataclass is a union with None.
        members = [one for one in (self.hint, *get_args(self.hint)) if is_record(one)]
        return members[0] if len(members) == 1 and get_origin(self.hint) not in SEQUENCES else None


@cache
def describe(kind: type) -> tuple[SettingField, ...]:
    """Return the settings of a dataclass, in order, for `--help`, tables, schemas and completion."""
    hints, notes, texts = type_hints(kind), notes_of(kind), docstring_entries(kind)
    found: list[SettingField] = []
    for field in dataclasses.fields(kind):
        # The constructor does not take such a field: it is computed, and no setting.
        if not field.init:
            continue
        note = notes.get(field.name, NO_NOTE)
        text = note.help or texts.get(field.name, "")
        unit = _UNIT.search(text)
        note = dataclasses.replace(note, help=text, unit=note.unit or (unit[1] if unit else ""))
        hint = bare(hints[field.name])
        default = field.default if field.default_factory is MISSING else field.default_factory()
        expects = expectation(hint, note)
        if isinstance(hint, Unresolved):
            text = f"{kind.__name__}.{field.name} is not checked: its type {hint.source!r} is not imported"
            warnings.warn(text, UncheckedSettingWarning, stacklevel=2)
            # After the words about it, which name the type as it is written.
            hint = Any
        found.append(SettingField(name=field.name, hint=hint, note=note, default=default, expects=expects))
    return tuple(found)


@cache
def type_hints(kind: type) -> dict[str, Any]:
    """Return the type hints of a class, notes and all; `Unresolved` where a name is missing at run time."""
    try:
        return get_type_hints(kind, include_extras=True)
    except NameError:  # a type that the module imports for type checkers only
        found: dict[str, Any] = {}
        for base in reversed(kind.__mro__):
            for name, source in inspect.get_annotations(base).items():
                # One field at a time: a single missing name must not hide the types of the others.
                alone = type(
                    base.__name__, (), {"__annotations__": {name: source}, "__module__": base.__module__}
                )
                try:
                    found |= get_type_hints(alone, include_extras=True)
                except NameError:
                    found[name] = Unresolved(str(source))
        return found


def bare(hint: Any) -> Any:  # noqa: ANN401 - a type hint
    """Return a type hint without the notes around it."""
    return get_args(hint)[0] if get_origin(hint) is Annotated else hint


def note_of(hint: Any, outer: Setting = NO_NOTE) -> Setting:  # noqa: ANN401 - a type hint
    """Return the notes of a type hint, over those of what it is an item of."""
    for note in get_args(hint)[1:] if get_origin(hint) is Annotated else ():
        if isinstance(note, Setting):
            outer = note.over(outer)
    return outer


@cache
def notes_of(kind: type) -> dict[str, Setting]:
    """Return the notes of the fields of a dataclass.

    A class that gives a field another default keeps the notes of the class that it is derived from.
    """
    found: dict[str, Setting] = {}
    for base in reversed(kind.__mro__):
        names = inspect.get_annotations(base)
        hints = type_hints(base) if names else {}
        for name in names:
            note = note_of(hints[name], found.get(name, NO_NOTE))
            if note != NO_NOTE:
                found[name] = note
    return found


@cache
def docstring_entries(kind: type) -> dict[str, str]:
    """Return the entries of the docstring's `Attributes` section by name, those of base classes too."""
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        text = inspect.cleandoc(base.__dict__.get("__doc__") or "")
        names: list[str] = []
        for line in text.partition("Attributes:\n")[2].splitlines():
            if line and not line.startswith("    "):
                break
            # A line that is indented further goes on with the entry before it.
            entry = _ENTRY.fullmatch(line[4:]) if line[4:5].strip() else None
            names = entry[1].split(", ") if entry else names
            more = {name: entry[2] if entry else f"{found[name]} {line.strip()}" for name in names}
            found |= {name: words.strip() for name, words in more.items()}
    return found


def is_record(hint: object) -> bool:
    """Return whether a type hint is a dataclass."""
    return isinstance(hint, type) and dataclasses.is_dataclass(hint)


def is_named_tuple(hint: Any) -> bool:  # noqa: ANN401 - a type hint
    """Return whether a type hint is a tuple whose items have names."""
    return (
        isinstance(hint, type) and issubclass(hint, tuple) and bool(getattr(cast(Any, hint), "_fields", ()))
    )


def members_of(hint: Any) -> tuple[Any, ...]:  # noqa: ANN401 - type hints
    """Return the types of a union, notes and all; of another type hint none."""
    return get_args(hint) if get_origin(hint) in (Union, types.UnionType) else ()


def choices_of(hint: Any, note: Setting) -> tuple[str, ...]:  # noqa: ANN401 - a type hint
    """Return the words that a value may be; empty: too many to list."""
    if members := members_of(hint):
        listed = [choices_of(bare(one), note_of(one, note)) for one in members]
        return tuple(dict.fromkeys(word for words in listed for word in words))
    if get_origin(hint) is Literal:
        return tuple(str(word) for word in get_args(hint))
    if isinstance(hint, type) and issubclass(hint, Enum):
        return tuple(str(one.value) for one in hint)
    if hint is bool:
        return ("true", "false")
    if hint is type(None):
        return ("none",)
    return note.words if hint is str else ()


def expectation(hint: Any, note: Setting, *, plural: bool = False) -> str:  # noqa: ANN401 - a type hint
    """Return in words which values a type hint and a note allow, as `a number above 0 [m]`."""
    hint, note = bare(hint), note_of(hint, note)
    if hint in _NUMBERS:
        return _NUMBERS[hint][plural] + note.limits_and_unit
    if plural:
        one = expectation(hint, note)
        return "texts" if one == "a text" else f"items, each {one}"
    if members := members_of(hint):
        words = [expectation(one, note) for one in members if one is not type(None)]
        return " or ".join(dict.fromkeys([*words, *(["none"] if type(None) in members else [])]))
    origin = get_origin(hint) or hint
    if hint is not bool and (words := choices_of(hint, note)) and hint is not type(None):
        return f"one of {', '.join(words)}"
    if origin in SEQUENCES:
        return _list_in_words(hint, note)
    if origin in MAPPINGS:
        value = get_args(hint)[1] if get_args(hint) else Any
        return f"a mapping of names to {expectation(value, note.of_items, plural=True)}"
    if hint in _WORDS:
        return _WORDS[hint] + (_count(note, "characters", " of ") if hint is str else "")
    if is_named_tuple(hint):
        kinds = get_type_hints(hint, include_extras=True).items()
        return f"a list of {', '.join(f'{name} ({expectation(one, note)})' for name, one in kinds)}"
    name = getattr(hint, "__name__", str(hint))
    return f"settings of {name}" if is_record(hint) else f"a value of type {name}"


def _list_in_words(hint: Any, note: Setting) -> str:  # noqa: ANN401 - a type hint
    inner = get_args(hint) or (Any, ...)
    item = expectation(inner[0], note.of_items, plural=True)
    if get_origin(hint) is not tuple or inner[-1] is Ellipsis:
        return f"a list of {_count(note, '', '')}{item}"
    if len(set(inner)) == 1:
        return f"a list of {len(inner)} {item}"
    return f"a list of {', '.join(expectation(one, note.of_items) for one in inner)}"


def _count(note: Setting, things: str, start: str) -> str:
    least, most = note.min_length, note.max_length
    if least is None and most is None:
        return ""
    number = f"{least} to {most}" if least is not None and most is not None else ""
    number = str(least) if least == most else number
    number = number or (f"at least {least}" if most is None else f"at most {most}")
    return f"{start}{number} {things}"


SMALLEST, LARGEST = 2.0**-126, (2 - 2.0**-23) * 2.0**127
"""Normal numbers of single precision: some devices take smaller ones for 0, all take larger ones for inf."""


def single_precision(number: float) -> bool:
    """Return whether single precision holds a number as one that is neither subnormal nor too large."""
    return number == 0 or math.isinf(number) or SMALLEST <= abs(number) <= LARGEST


_NO_LIMITS = Setting()


@dataclass(frozen=True, slots=True)
class Parameters:
    """Form of the parameters of an operation.

    Attributes:
        fewest: Fewest numbers.
        most: Most numbers.
        note: Their limits and unit.
    """

    fewest: int = 0
    most: int = 1
    note: Setting = _NO_LIMITS

    @property
    def expects(self) -> str:
        """The form in words."""
        if self.most == 1:
            return f"{'a' if self.fewest else 'at most one'} number{self.note.limits_and_unit}"
        counts = str(self.most) if self.fewest == self.most else f"{self.fewest} to {self.most}"
        return f"{counts} numbers{self.note.limits_and_unit}"


ANY_PARAMETERS = Parameters(0, 64)
"""Form of an operation that declares none."""
