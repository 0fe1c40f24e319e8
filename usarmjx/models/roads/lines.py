"""Lines of keywords and numbers, as in DARPA's RNDF and MDF files, with the line number of every error."""

import logging
import math
import re
from collections.abc import Callable, Collection, Mapping
from pathlib import Path

from usarmjx.base.errors import SpecError
from usarmjx.base.files import read_bounded
from usarmjx.models.roads.network import Fault, LatLon, point_name

logger = logging.getLogger(__name__)

NUMBERED = re.compile(r"[0-9]{1,18}(\.[0-9]{1,18})*")
"""Pattern of the first word of a line without a keyword: 1.2.3, or a plain number."""
MAX_ROAD_FILE_BYTES = 16_000_000
"""Largest size of a file [bytes]."""
MAX_WARNINGS = 20
"""Largest number of warnings about one file."""
MAX_MESSAGE_LENGTH, MAX_QUOTE_LENGTH = 1000, 100
"""Largest lengths of an error and of a quotation in it [characters]."""


class RoadLines:
    """Reader of the lines of a file, without blank lines and comments, one after the other.

    Args:
        source: A path, or the text itself: a string with a line break.

    Attributes:
        fault_lines: Line of each item that a later check may refuse, by the key of `Fault`.
        warnings: Deviations from the format that were accepted, with file and line; they are logged too.

    Raises:
        SpecError: The file cannot be read, or a comment has no end.
    """

    def __init__(self, source: str | Path) -> None:
        self.file, text = "text", str(source)
        if isinstance(source, Path) or "\n" not in source:
            self.file = text
            data = read_bounded(Path(source), MAX_ROAD_FILE_BYTES)
            text = data.decode("utf-8-sig", "replace").replace("\r\n", "\n").replace("\r", "\n")
        self.fault_lines: dict[tuple[object, ...], int] = {}
        self.warnings: list[str] = []
        text = _without_comments(text)
        lines = [(number, line.split()) for number, line in enumerate(text.split("\n"), 1)]
        self._lines = [(number, words) for number, words in lines if words]
        self._end = self._lines[-1][0] if self._lines else 1
        self._next = 0
        for number, words in self._lines:
            if any("/*" in word for word in words):
                raise self.fault("a comment without its end; expected */", number)

    @property
    def line(self) -> int:
        """Number of the next line; of the last one at the end."""
        return self._lines[self._next][0] if self._next < len(self._lines) else self._end

    @property
    def word(self) -> str:
        """First word of the next line in lower case, as keywords are; empty at the end."""
        return self._lines[self._next][1][0].lower() if self._next < len(self._lines) else ""

    @property
    def rest(self) -> set[str]:
        """First words of the lines to come."""
        return {words[0].lower() for _, words in self._lines[self._next :]}

    @property
    def numbered(self) -> bool:
        """Whether the next line begins with numbers instead of a keyword."""
        return bool(NUMBERED.fullmatch(self.word))

    def fault(self, text: str, line: int | None = None) -> SpecError:
        """Return an error at a line, by default the next one; quotations are made printable and cut short."""
        short = text if len(text) <= MAX_MESSAGE_LENGTH else f"{text[:MAX_MESSAGE_LENGTH]}..."
        shown = "".join(letter if letter.isprintable() else "?" for letter in short)
        return SpecError(f"{self.file}:{self.line if line is None else line}: {shown}")

    def warn(self, text: str, line: int | None = None) -> None:
        """Note a deviation from the format at a line, by default the next one."""
        warning = str(self.fault(text, line))
        self.warnings.append(warning)
        if len(self.warnings) <= MAX_WARNINGS:
            logger.warning("%s", warning)
        elif len(self.warnings) == MAX_WARNINGS + 1:
            logger.warning("%s: more than %d warnings; the rest is left out", self.file, MAX_WARNINGS)

    def end(self, keyword: str, *outside: str) -> None:
        """Skip the end of a block; one that is missing before a line of the outer block is a warning.

        Args:
            keyword: The line that ends the block.
            outside: Keywords that may follow the block.

        Raises:
            SpecError: The next line is another one.
        """
        if self.word == keyword.lower():
            self.words(0)
        elif self.word in outside or not self.word:
            self.warn(f"{keyword} is missing")
        else:
            raise self.unexpected(keyword)

    def unexpected(self, *allowed: str) -> SpecError:
        """Return the error that the next line has none of the allowed keywords."""
        found = f"found {_short(self._lines[self._next][1][0])!r}" if self.word else "the file ends"
        return self.fault(f"{found}; allowed here: {', '.join(allowed)}")

    def words(self, count: int | None = None, meaning: str = "") -> list[str]:
        """Return the words after the first one of the next line, and advance.

        Args:
            count: Number of words that must follow; None: any number above zero.
            meaning: Description of the words, for the error.
        """
        first, *rest = self._lines[self._next][1]
        if (not rest) if count is None else (len(rest) != count):
            found = _short(f"{first} {' '.join(rest)}".rstrip())
            raise self.fault(f"{found}; expected: {_short(first)} {meaning}".rstrip())
        self._next += 1
        return rest

    def text(self, keyword: str) -> str:
        """Return the text after a keyword which must be next."""
        if self.word != keyword.lower():
            raise self.unexpected(keyword)
        return " ".join(self.words(meaning="name"))

    def numbers(self, keyword: str, count: int = 1) -> tuple[int, ...]:
        """Return the numbers `1.2` after a keyword which must be next; `count` of them."""
        if self.word != keyword.lower():
            raise self.unexpected(keyword)
        line, (word,) = self.line, self.words(1, ".".join("MNP"[:count]))
        return self.parsed(word, count, line)

    def parsed(self, word: str, count: int, line: int) -> tuple[int, ...]:
        """Return the numbers of a word with dots; `count` of them."""
        numbers = tuple(int(part) for part in word.split(".")) if NUMBERED.fullmatch(word) else ()
        if len(numbers) != count:
            raise self.fault(
                f"{_short(word)!r}; expected {count} whole numbers, as {point_name((1,) * count)}", line
            )
        return numbers

    def named(self, keyword: str, *numbers: int) -> None:
        """Skip `perimeter 1.0`, whose numbers must be exactly the given ones."""
        line, found = self.line, self.numbers(keyword, len(numbers))
        if found != numbers:
            raise self.fault(f"{keyword} {point_name(found)}; expected {keyword} {point_name(numbers)}", line)

    def real(self, word: str, what: str, low: float, high: float, line: int) -> float:
        """Return a number within a range."""
        try:
            value = float(word)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            raise self.fault(f"{what} {_short(word)!r}; expected a number from {low:g} to {high:g}", line)
        return value

    def next_number(
        self, keyword: str, owner: tuple[int, ...], taken: Collection[int], most: int | None
    ) -> int:
        """Return the last number of `lane 1.2`, whose other numbers must be the owner's.

        Args:
            keyword: Keyword of the line.
            owner: The numbers before it.
            taken: Numbers of the blocks so far.
            most: Largest number; None: not announced.

        Raises:
            SpecError: Another owner, or a number that is taken or above the largest one.
        """
        line, found = self.line, self.numbers(keyword, len(owner) + 1)
        usual = len(taken) + 1
        if usual in taken:
            usual = next(i for i in range(1, usual) if i not in taken)
        number = found[-1]
        if found[:-1] != owner or number < 1 or number in taken or (most is not None and number > most):
            raise self.fault(
                f"{keyword} {point_name(found)}; expected {keyword} {point_name((*owner, usual))}: "
                "numbers go up one by one",
                line,
            )
        if number != usual:
            self.warn(
                f"{keyword} {point_name(found)} is before {keyword} {point_name((*owner, usual))}", line
            )
        return number

    def point(self, owner: tuple[int, int], points: dict[int, LatLon]) -> None:
        """Read a line `1.2.3 34.5 -117.3` as the next point of its owner.

        Raises:
            SpecError: Its number is not the one after the last, or it is a point of another owner.
        """
        numbers = self.parsed(self.word, 3, self.line)
        usual = max(points) + 1 if points else numbers[2]
        if numbers != (*owner, usual):
            expected = (*owner, usual if points else 1)
            raise self.fault(f"{self.word}; expected {point_name(expected)}: numbers go up one by one")
        if not points and usual != 1:
            self.warn(f"points of {point_name(owner)} begin with {self.word} instead of 1")
        line, (north, east) = self.line, self.words(2, "latitude longitude")
        latitude = self.real(north, "latitude", -90.0, 90.0, line)
        points[usual] = latitude, self.real(east, "longitude", -180.0, 180.0, line)

    def count(self, found: int, expected: int | None, what: str, line: int | None = None) -> None:
        """Check a number of items against the announced one; None: none is announced."""
        if expected is not None and found != expected:
            raise self.fault(f"{found} {what}, but {expected} were announced", line)

    def header(self, keywords: Mapping[str, Callable[[], None]]) -> None:
        """Read lines with those keywords, in any order, until another line comes."""
        while read := keywords.get(self.word):
            read()

    def refuse(self, faults: list[Fault]) -> None:
        """Raise the first fault of a check of the whole, at its line."""
        for where, text in faults:
            raise self.fault(text, self.fault_lines.get(where, self._end))


def _without_comments(text: str) -> str:
    """Return a text with each comment replaced by a space or its line breaks; one without an end stays."""
    parts: list[str] = []
    at = 0
    while (start := text.find("/*", at)) >= 0 and (end := text.find("*/", start + 2)) >= 0:
        parts += [text[at:start], "\n" * text.count("\n", start, end) or " "]
        at = end + 2
    return "".join([*parts, text[at:]])


def _short(text: str) -> str:
    return text if len(text) <= MAX_QUOTE_LENGTH else f"{text[:MAX_QUOTE_LENGTH]}..."


Row = tuple[str | int | float | tuple[int, ...] | None, ...]
"""Values of a line to write; a line with None or an empty text is left out."""


def format_lines(rows: list[Row]) -> str:
    """Return the text of lines, with tabs between words.

    Raises:
        SpecError: A text that would not be read back unchanged: with line breaks, comment marks or white
            space
            other than single spaces.
    """
    shown = [row for row in rows if None not in row and "" not in row]
    return "".join("\t".join(map(_word, row)) + "\n" for row in shown)


def _word(value: str | int | float | tuple[int, ...] | None) -> str:
    if isinstance(value, tuple):
        return point_name(value)
    if isinstance(value, str):
        if " ".join(value.split()) != value or "/*" in value or "*/" in value:
            raise SpecError(f"the name {value!r}: a file holds words with single spaces, without /* or */")
        return value
    if isinstance(value, float):
        return str(int(value)) if value.is_integer() else repr(value)
    return str(value)
