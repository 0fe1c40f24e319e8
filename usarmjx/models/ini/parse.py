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

import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from usarmjx.base.errors import SpecError
from usarmjx.base.files import read_bounded
from usarmjx.models.ini.values import IniValue, LineParser, Reference, Struct, quote_short

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
        written = parts[0].name if parts else name
        return Section(
            written,
            tuple(line for part in parts for line in part.lines),
            tuple(removal for part in parts for removal in part.removals),
        )

    @cached_property
    def _by_name(self) -> dict[str, list[Section]]:
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
    for number, text_line in enumerate(_LINE_END.split(text.removeprefix("\ufeff")), start=1):
        bare = text_line.strip()
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
        if everything:
            indices = list(by_index) if order.index is None else [order.index]
            found = [rows for index in indices for rows in by_index.pop(index, {}).values()]
        else:
            found = [by_index.get(order.index, {}).pop(repr(order.value), [])]
        removed = [one for rows in found for one in rows]
        for block, row in removed:
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
