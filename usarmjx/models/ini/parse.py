"""Syntax of Unreal's ini files, USARSim's configuration: text in, frozen values out; independent of robots.

The files are USARBot.ini and USARMisPkg.ini (manual 10.x, 11.x, 12.1.2), BotAPI.ini (9.1) and Pyro's world
files (13.2.1). A line is `[Section]`, `key=value`, a comment (`;` or `//` in front) or blank; `;` also starts
a comment after a value, but not within quotes or brackets. There are no continuation lines. Names are
matched without case and keys may repeat, in order. A value is one of:

    `true`, `False`                 bool, in any case
    `1`, `-32768`                   int
    `0.2`, `.5`, `-3e2`, `0.2f`     float
    `0,4`                           float, but not within brackets: the slip of manual 11.2.2
    `class'USARBot.SonarSensor'`    `Reference`
    `(X=1, Y=-2)`, `()`             `Struct`
    `((X=1), (X=2))`, `(1, 2)`      tuple
    `"F 1"`, `'F 1'`                str without the quotes; a backslash is no escape
    anything else                   str without the spaces around it; "" if nothing is there

Unreal's array prefixes: `+key=` and `.key=` add a line, also to a list of another file or of the class itself
if the section has no bare `key=`. `-key=` removes every earlier line of the section with that key, index and
value (of the same type: 1 is not 1.0), and `!key=` every earlier line with that key and, if it has an index,
with that index. Both stay in `Section.removals`: readers of lists apply them to other files and to the class.
"""

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NoReturn, TypeAlias, Union

from usarmjx.base.errors import SpecError
from usarmjx.base.files import read_bounded
from usarmjx.base.registry import is_name
from usarmjx.base.transforms import Vec3

MAX_DEPTH = 32
"""Largest depth of brackets; the manual's deepest example has 3."""

# `Union`, so that `IniValue | None` can be evaluated: a quoted alias would be a plain str then.
IniValue: TypeAlias = Union[str, int, float, bool, "Struct", "Reference", tuple["IniValue", ...]]
"""Value of a key."""
MAX_DIGITS = 400
"""Largest length of an integer [characters]: more than the largest float has; Python reads at most 4300."""
_NAME = re.compile(r"[^\W\d]\w*")
_WORD = re.compile(r"[^,()\"'=]*")
_REFERENCE = re.compile(r"([^\W\d]\w*)\s*'([^']*)'")
_INTEGER = re.compile(r"[+-]?[0-9]+")
_NUMBER = re.compile(r"([+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)[fF]?")
_COMMA_DECIMAL = re.compile(r"[+-]?[0-9]+,[0-9]+")
_QUOTES = ("'", '"')
__all__ = ["IniFile", "IniValue", "Line", "Reference", "Section", "Struct", "parse_ini", "read_ini"]
_HEADER = re.compile(r"\[([^\[\]]*)\]")
_KEY = re.compile(r"([+.!-]?)\s*([^\W\d][\w.]*)\s*(?:\(\s*([0-9]{1,9})\s*\)|\[\s*([0-9]{1,9})\s*\])?")
_LINE_END = re.compile(r"\r\n|\r|\n")
_ADDS, _REMOVES = ("+", "."), ("-", "!")
UU_PER_METRE = 250.0
"""Unreal units per metre (manual 6.2). The excerpt of manual 12.1.2 has an older length, 52.5."""
MAX_INI_BYTES = 4_000_000
"""Largest size of an ini file [bytes]."""
MAX_LINES = 50_000
"""Largest number of lines, apart from blank ones and comments."""
MAX_NUMBER = 1e12
"""Largest number, whose cube is still usable."""
UU_PER_RADIAN = 32768 / math.pi
"""Unreal's angles per radian (manual 6.2)."""


@dataclass(frozen=True)
class Reference:
    """A named Unreal object such as `class'USARBot.SonarSensor'`.

    Attributes:
        kind: Kind of the object ("class", "StaticMesh"), as written.
        name: Its name, package included.
    """

    kind: str
    name: str


@dataclass(frozen=True)
class Struct:
    """The named values of one pair of brackets.

    Attributes:
        fields: (name, value), in order and as written.
    """

    fields: tuple[tuple[str, IniValue], ...]

    def get(self, name: str, default: IniValue | None = None) -> IniValue | None:
        """Return the last value of that name, case ignored, or the default."""
        wanted = name.lower()
        # The last one counts, as of repeated keys.
        return next((value for key, value in reversed(self.fields) if key.lower() == wanted), default)


class LineParser:
    """A recursive-descent parser with a position in one line.

    Args:
        text: The line.
        where: File and line number, for messages.
    """

    def __init__(self, text: str, where: str) -> None:
        self.text = text
        self.where = where
        self.pos = 0

    def fail(self, problem: str, expected: str) -> NoReturn:
        """Raise SpecError with the position, the error and the expected form."""
        raise SpecError(f"{self.where}: {problem}; expected {expected}")

    def end(self, after: str, expected: str = "the end of the line or a ; comment") -> None:
        """Require the end of the line, or a comment."""
        self._skip()
        if self._peek() not in ("", ";"):
            self.fail(f"{quote_short(self.text[self.pos :])} follows {after}", expected)

    def value(self) -> IniValue:
        """Read the value of a line, to the line's end."""
        self._skip()
        if self._peek() in ("(", *_QUOTES):
            value = self._item(depth=0)
            self.end("the value")
            return value
        # Bare text reaches to the end of the line: Unreal's texts have spaces and commas without quotes.
        text = self._bare_text()
        if found := _REFERENCE.fullmatch(text):
            return Reference(*found.groups())
        # Programs of some locales write 0,5.
        if _COMMA_DECIMAL.fullmatch(text):
            text = text.replace(",", ".")
        return self._scalar(text)

    def _peek(self) -> str:
        """Return the character here, "" at the end."""
        return self.text[self.pos : self.pos + 1]

    def _skip(self) -> None:
        while self._peek().isspace():
            self.pos += 1

    def _bare_text(self) -> str:
        """Read text up to a comment, stepping over quotes and brackets, which must be closed."""
        start, opened = self.pos, list[int]()
        while (here := self._peek()) and (opened or here != ";"):
            # Stepped over as a whole: a ';' in quotes starts no comment, and a bracket there opens nothing.
            if here in _QUOTES:
                self._quoted()
                continue
            if here == "(":
                opened.append(self.pos)
            elif here == ")" and not opened:
                self.fail(f"the ')' in column {self.pos + 1} closes nothing", "a '(' before it")
            elif here == ")":
                opened.pop()
            self.pos += 1
        if opened:
            self._unclosed(opened[-1])
        return self.text[start : self.pos].strip()

    def _item(self, depth: int) -> IniValue:
        """Read one value within brackets, or one that starts with a bracket or a quote."""
        if self._peek() == "(":
            return self._group(depth + 1)
        if self._peek() in _QUOTES:
            return self._quoted()
        word = self._word()
        # Only the single quote makes a reference: double quotes are a text's.
        if self._peek() != "'":
            return self._scalar(word)
        if not _NAME.fullmatch(word):
            self.fail(
                f"{quote_short(word)} stands before a quote", "a kind, as in class'USARBot.SonarSensor'"
            )
        return Reference(word, self._quoted())

    def _group(self, depth: int) -> IniValue:
        """Read a pair of brackets with its content."""
        opening = self.pos
        # Each bracket is a level of recursion: deeper ones would end in a RecursionError.
        if depth > MAX_DEPTH:
            self.fail(
                f"the '(' in column {opening + 1} is number {depth} within another", f"up to {MAX_DEPTH}"
            )
        self.pos += 1
        self._skip()
        if self._peek() == ")":
            self.pos += 1
            return Struct(())
        fields: list[tuple[str, IniValue]] = []
        values: list[IniValue] = []
        more = True
        while more:
            # Tried first: a word alone does not tell a name from a value, only the '=' behind it does.
            name = self._field_name()
            if name is not None:
                fields.append((name, self._item(depth)))
            elif self._peek() in (",", ")"):
                self.fail(f"nothing stands before the {self._peek()!r} in column {self.pos + 1}", "a value")
            else:
                values.append(self._item(depth))
            # A `Struct` has names and a tuple has none: a mixture would lose one or the other.
            if fields and values:
                self.fail("some values within brackets have names and some have not", "(A=1,B=2) or (1,2)")
            more = self._separator(opening) == ","
        return tuple(values) if values else Struct(tuple(fields))

    def _separator(self, opening: int) -> str:
        """Read the comma or the closing bracket after a value."""
        self._skip()
        found = self._peek()
        if not found:
            self._unclosed(opening)
        if found not in (",", ")"):
            self.fail(f"{quote_short(self.text[self.pos :])} follows a value within brackets", "',' or ')'")
        self.pos += 1
        self._skip()
        return found

    def _field_name(self) -> str | None:
        """Read `name=`, if that is next."""
        start = self.pos
        name = self._word()
        if self._peek() != "=":
            # It is a value: it is read again from its beginning.
            self.pos = start
            return None
        if not _NAME.fullmatch(name):
            self.fail(
                f"{quote_short(name)} is no name of a value", "one word before the '=', as in (X=1,Y=2)"
            )
        self.pos += 1
        self._skip()
        return name

    def _word(self) -> str:
        """Read the text up to a character with a meaning within brackets."""
        found = _WORD.match(self.text, self.pos)
        word = found.group() if found else ""
        self.pos += len(word)
        return word.strip()

    def _quoted(self) -> str:
        """Read a quoted text, which cannot contain its quote."""
        quote, start = self._peek(), self.pos + 1
        stop = self.text.find(quote, start)
        if stop < 0:
            hint = " (text with an apostrophe needs double quotes)" if quote == "'" else ""
            self.fail(f"the {quote} in column {start} is never closed", f"another {quote}{hint}")
        self.pos = stop + 1
        return self.text[start:stop]

    def _scalar(self, text: str) -> str | int | float | bool:
        """Return the value of unquoted text."""
        if text.lower() in ("true", "false"):
            return text.lower() == "true"
        found = _NUMBER.fullmatch(text)
        if not found:
            return text
        # `float` takes "1e999" as infinite without an error.
        number = float(found.group(1))
        if not math.isfinite(number):
            self.fail(f"{quote_short(text)} is too large for a number", "at most 1.8e308")
        if _INTEGER.fullmatch(text) and len(text) > MAX_DIGITS:
            self.fail(f"a whole number of {len(text)} characters", f"at most {MAX_DIGITS}")
        # Kept apart from a float: `-key=1` removes no line with 1.0.
        return int(text) if _INTEGER.fullmatch(text) else number

    def _unclosed(self, opening: int) -> NoReturn:
        self.fail(f"the '(' in column {opening + 1} is never closed", "a ')' on the same line")


def quote_short(text: str, limit: int = 60) -> str:
    """Return text of a file for a message: quoted and cut short."""
    return repr(text if len(text) <= limit else text[:limit] + "...")


@dataclass(frozen=True)
class Line:
    """One `key=value`, and its position.

    Attributes:
        key: As written, without prefix and index.
        value: The value after the `=`.
        file: The file, for messages.
        line: The line number in the file, from 1.
        index: 2 for `Wheels(2)=...` or `Wheels[2]=...`, None for `Wheels=...`.
        adds: Whether it is written with `+` or `.`: it adds to a list that stands elsewhere.
    """

    key: str
    value: IniValue
    file: str
    line: int
    index: int | None
    adds: bool = False


@dataclass(frozen=True)
class Removal:
    """One `-key=value` or `!key=`.

    Attributes:
        line: The line.
        clears: Whether it is written with `!`: it removes lines with any value.
        count: Number of lines of its section that it removed.
    """

    line: Line
    clears: bool
    count: int


@dataclass(frozen=True)
class Section:
    """The lines under one `[name]`, and the removals among them."""

    name: str
    lines: tuple[Line, ...]
    removals: tuple[Removal, ...] = ()

    def get_all(self, key: str) -> tuple[Line, ...]:
        """Return the lines with that key in order, with any index, case ignored."""
        wanted = key.lower()
        return tuple(line for line in self.lines if line.key.lower() == wanted)

    def last(self, key: str) -> Line | None:
        """Return the last line with that key, the effective one, or None; case ignored."""
        return next(reversed(self.get_all(key)), None)


@dataclass(frozen=True)
class IniFile:
    """A complete file.

    Attributes:
        path: Its path, for messages.
        sections: Sections in order, repetitions included.
        uu_per_metre: Length of a metre in its Unreal units.
    """

    path: str
    sections: tuple[Section, ...]
    uu_per_metre: float = UU_PER_METRE

    def section(self, name: str) -> Section:
        """Return all lines under that name in order, case ignored; no lines if there is no such section."""
        parts = self._by_name.get(name.lower(), [])
        # Messages show the spelling of the file, not that of the caller.
        written = parts[0].name if parts else name
        return Section(
            written,
            tuple(line for part in parts for line in part.lines),
            tuple(removal for part in parts for removal in part.removals),
        )

    @cached_property
    def _by_name(self) -> dict[str, list[Section]]:
        # Indexed once: a search for each name would be quadratic in a file of many sections.
        found: dict[str, list[Section]] = {}
        for part in self.sections:
            found.setdefault(part.name.lower(), []).append(part)
        return found


def read_ini(path: Path) -> IniFile:
    """Read a file in UTF-8, in UTF-16 with a byte order mark, as Unreal writes, or else in latin-1.

    Raises:
        SpecError: The file cannot be read, contradicts its byte order mark, or see `parse_ini`.
    """
    try:
        text = _decode(read_bounded(path, MAX_INI_BYTES))
    except UnicodeDecodeError as error:
        raise SpecError(f"{path}: is marked as {error.encoding} but is not: {error.reason}") from error
    return parse_ini(text, str(path))


def _decode(data: bytes) -> str:
    # Unreal writes its ini files in UTF-16 with a byte order mark.
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16")
    if data.startswith(b"\xef\xbb\xbf"):
        return data.decode("utf-8-sig")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        # Latin-1 takes any bytes, so no file is refused for its encoding.
        return data.decode("latin-1")


def parse_ini(text: str, path: str = "<text>") -> IniFile:
    """Parse the text of an ini file.

    Args:
        text: The whole file, with any line ends.
        path: Its path, for messages and for `Line.file`.

    Raises:
        SpecError: A line has none of the module's forms; the message names the file, the line's number, the
            error and the expected form.
    """
    blocks = _Blocks()
    count = 0
    # Not splitlines, which also splits at form feeds and Unicode's separators.
    for number, text_line in enumerate(_LINE_END.split(text.removeprefix("\ufeff")), start=1):
        bare = text_line.strip()
        # Before the count: a file may have any number of comments.
        if not bare or bare.startswith((";", "//")):
            continue
        cursor = LineParser(text_line, f"{path}:{number}")
        count += 1
        if count > MAX_LINES:
            cursor.fail(f"this is line {count} with something in it", f"at most {MAX_LINES}")
        if bare.startswith("["):
            blocks.begin(_header(cursor))
            continue
        if not blocks.begun:
            cursor.fail(f"{quote_short(bare)} stands before the first section", "a [Section] above it")
        prefix, key, index = _key(cursor)
        line = Line(key, cursor.value(), path, number, index, adds=prefix in _ADDS)
        if prefix in _REMOVES:
            blocks.remove(line, everything=prefix == "!")
        else:
            blocks.add(line)
    return IniFile(path, blocks.sections())


def _header(cursor: LineParser) -> str:
    """Read a whole `[Section]` line and return the name."""
    text = cursor.text.lstrip()
    found = _HEADER.match(text)
    # Unprintable letters are refused: names of sections stand in messages, which reach a terminal.
    if not found or not found.group(1).strip() or not found.group(1).strip().isprintable():
        cursor.fail(f"{quote_short(text)} is no section header", "[Name]")
    cursor.pos = len(cursor.text) - len(text) + found.end()
    cursor.end("the section header", "each key=value on a line of its own")
    return found.group(1).strip()


def _key(cursor: LineParser) -> tuple[str, str, int | None]:
    """Take `+key(index)=` and return prefix, key and index."""
    left, equals, _ = cursor.text.partition("=")
    if not equals:
        cursor.fail(f"{quote_short(left.strip())} has no '='", "key=value, [Section] or a ; comment")
    found = _KEY.fullmatch(left.strip())
    if not found:
        cursor.fail(
            f"{quote_short(left.strip())} is no key", "one word before the '=', as in +Sensors= or Wheels(0)="
        )
    cursor.pos = len(left) + 1
    prefix, key, round_index, square_index = found.groups()
    # Unreal's ini files write indices with either kind of brackets.
    index = round_index or square_index
    return prefix, key, int(index) if index else None


class _Blocks:
    """The sections of a file so far, with an index of their lines, so that removal needs no search."""

    def __init__(self) -> None:
        self._blocks: list[tuple[str, list[Line | None]]] = []
        self._removals: dict[int, list[Removal]] = {}
        # By section and key, then by index, then by repr of the value: positions of such lines.
        self._positions: dict[tuple[str, str], dict[int | None, dict[str, list[tuple[int, int]]]]] = {}

    @property
    def begun(self) -> bool:
        """Whether a section has begun."""
        return bool(self._blocks)

    def begin(self, name: str) -> None:
        """Begin a section."""
        self._blocks.append((name, []))

    def add(self, line: Line) -> None:
        """Add a line to the last section."""
        lines = self._blocks[-1][1]
        by_index = self._positions.setdefault(self._key(line), {})
        # In Python True == 1 == 1.0; their reprs differ.
        by_value = by_index.setdefault(line.index, {})
        by_value.setdefault(repr(line.value), []).append((len(self._blocks) - 1, len(lines)))
        lines.append(line)

    def remove(self, order: Line, *, everything: bool) -> None:
        """Remove the lines that a `-` or a `!` line names, from every block of its section."""
        by_index = self._positions.get(self._key(order), {})
        # Popped: no later line removes them once more.
        if everything:
            indices = list(by_index) if order.index is None else [order.index]
            found = [rows for index in indices for rows in by_index.pop(index, {}).values()]
        else:
            found = [by_index.get(order.index, {}).pop(repr(order.value), [])]
        removed = [one for rows in found for one in rows]
        for block, row in removed:
            # Emptied and not deleted: the positions of other lines stay valid.
            self._blocks[block][1][row] = None
        removal = Removal(order, clears=everything, count=len(removed))
        self._removals.setdefault(len(self._blocks) - 1, []).append(removal)

    def sections(self) -> tuple[Section, ...]:
        """Return the sections with their remaining lines."""
        return tuple(
            Section(name, tuple(filter(None, lines)), tuple(self._removals.get(number, ())))
            for number, (name, lines) in enumerate(self._blocks)
        )

    def _key(self, line: Line) -> tuple[str, str]:
        return self._blocks[-1][0].lower(), line.key.lower()


@dataclass(frozen=True)
class Units:
    """Units of positions and angles in a robot's section.

    Attributes:
        by_uu: bMountByUU: in Unreal units and Unreal's axes, z up; else in metres, radians and z down.
        uu_per_metre: Length of a metre in Unreal units.
    """

    by_uu: bool = False
    uu_per_metre: float = UU_PER_METRE

    def position(self, vector: Vec3) -> Vec3:
        """Convert a position to metres, z down."""
        if not self.by_uu:
            return vector
        x, y, z = (value / self.uu_per_metre for value in vector)
        # Not -z, which makes -0.0 of 0.
        return (x, y, 0.0 - z)

    def angles(self, vector: Vec3) -> Vec3:
        """Convert rotations about x, y, z to radians: roll, pitch, yaw, whose signs are Unreal's too."""
        if not self.by_uu:
            return vector
        x, y, z = (value / UU_PER_RADIAN for value in vector)
        return (x, y, z)


def fail(line: Line, problem: str, expected: str) -> NoReturn:
    """Raise SpecError with file and line, the error and the allowed values."""
    raise SpecError(f"{line.file}:{line.line}: {problem}; expected {expected}")


def key_text(line: Line) -> str:
    """Return a key in the notation of the file: `Wheels(2)`."""
    return line.key if line.index is None else f"{line.key}({line.index})"


def as_number(line: Line, value: IniValue | None, name: str, *, above: float = -math.inf) -> float:
    """Return a finite number, which must be greater than `above`."""
    # A bool is an int in Python: True would count as the length 1.
    if isinstance(value, bool) or not isinstance(value, int | float):
        fail(line, f"{name} is {_quoted(value)}", "a number")
    if not (abs(value) <= MAX_NUMBER and value > above):
        fail(
            line,
            f"{name} is {value:g}",
            f"a number above {max(above, -MAX_NUMBER):g}, at most {MAX_NUMBER:g}",
        )
    return float(value)


def as_whole(line: Line, least: int, most: int) -> int:
    """Return the integer of a line, within limits."""
    value = as_number(line, line.value, line.key)
    if value != int(value) or not least <= value <= most:
        fail(line, f"{line.key} is {line.value}", f"a whole number from {least} to {most}")
    return int(value)


def as_bool(line: Line, value: IniValue | None, name: str) -> bool:
    """Return a truth value; 1 and 0 are accepted."""
    if isinstance(value, bool) or (isinstance(value, int) and value in (0, 1)):
        return bool(value)
    return fail(line, f"{name} is {_quoted(value)}", "True or False")


def as_name(line: Line, value: IniValue | None, name: str) -> str:
    """Return a word: an item's or a part's name."""
    # The parser reads a name of digits as a number.
    if isinstance(value, int) and not isinstance(value, bool):
        return str(value)
    if not isinstance(value, str) or not is_name(value.strip()):
        fail(line, f"{name} is {_quoted(value)}", "a name: one word of printable ASCII without braces")
    return value.strip()


def as_class(line: Line, value: IniValue | None, name: str) -> str:
    """Return the name of a class without its package: SonarSensor of class'USARBot.SonarSensor'."""
    text = value.name if isinstance(value, Reference) else value
    if not isinstance(text, str) or not text.strip() or not text.strip().isprintable():
        fail(line, f"{name} is {_quoted(value)}", "a class, as in class'USARBot.SonarSensor'")
    return text.strip().rpartition(".")[2]


def as_struct(line: Line) -> Struct:
    """Return the value of a line that must be a struct."""
    if not isinstance(line.value, Struct) or not line.value.fields:
        fail(line, f"{key_text(line)} is {_quoted(line.value)}", "(Name=value,Name=value,...)")
    return line.value


def as_vector(line: Line, value: IniValue | None, name: str) -> Vec3:
    """Return (X, Y, Z); a missing axis is 0."""
    if not isinstance(value, Struct):
        fail(line, f"{name} is {_quoted(value)}", "(X=number,Y=number,Z=number)")
    axes = {key.lower(): as_number(line, part, f"{key} of {name}") for key, part in value.fields}
    if not axes.keys() <= {"x", "y", "z"}:
        fail(line, f"{name} has {', '.join(key for key, _ in value.fields)}", "X, Y and Z")
    return (axes.get("x", 0.0), axes.get("y", 0.0), axes.get("z", 0.0))


def vector_of(line: Line, struct: Struct, name: str, default: Vec3 = (0.0, 0.0, 0.0)) -> Vec3:
    """Return a vector of a struct, or the default if it is missing."""
    value = struct.get(name)
    return default if value is None else as_vector(line, value, name)


def number_of(
    line: Line, struct: Struct, name: str, default: float | None = None, *, above: float = -math.inf
) -> float:
    """Return a number of a struct, or the default unchecked; without a default it is required."""
    value = struct.get(name)
    if value is None and default is not None:
        return default
    if value is None:
        fail(line, f"{key_text(line)} has no {name}", f"{name}=number")
    return as_number(line, value, name, above=above)


def reject_unknown(line: Line, struct: Struct, allowed: Iterable[str]) -> None:
    """Raise SpecError for an unknown name within brackets."""
    known = list(allowed)
    lowered = {name.lower() for name in known}
    # A misspelt name would otherwise leave a default in force without a word.
    unknown = [key for key, _ in struct.fields if key.lower() not in lowered]
    if unknown:
        fail(line, f"{key_text(line)} has no {', '.join(unknown)}", f"some of {', '.join(known)}")


def _quoted(value: IniValue | None) -> str:
    """Return a value for a message."""
    return "not given" if value is None else quote_short(str(value))
