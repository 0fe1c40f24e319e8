"""Values of an ini file: the text after a `=`, and its recursive-descent parser."""

import math
import re
from dataclasses import dataclass
from typing import NoReturn, TypeAlias, Union

from usarmjx.base.errors import SpecError

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
        text = self._bare_text()
        if found := _REFERENCE.fullmatch(text):
            return Reference(*found.groups())
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
            name = self._field_name()
            if name is not None:
                fields.append((name, self._item(depth)))
            elif self._peek() in (",", ")"):
                self.fail(f"nothing stands before the {self._peek()!r} in column {self.pos + 1}", "a value")
            else:
                values.append(self._item(depth))
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
        number = float(found.group(1))
        if not math.isfinite(number):
            self.fail(f"{quote_short(text)} is too large for a number", "at most 1.8e308")
        if _INTEGER.fullmatch(text) and len(text) > MAX_DIGITS:
            self.fail(f"a whole number of {len(text)} characters", f"at most {MAX_DIGITS}")
        return int(text) if _INTEGER.fullmatch(text) else number

    def _unclosed(self, opening: int) -> NoReturn:
        self.fail(f"the '(' in column {opening + 1} is never closed", "a ')' on the same line")


def quote_short(text: str, limit: int = 60) -> str:
    """Return text of a file for a message: quoted and cut short."""
    return repr(text if len(text) <= limit else text[:limit] + "...")
