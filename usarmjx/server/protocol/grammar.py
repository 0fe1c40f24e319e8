"""The Gamebots grammar: bytes to lines, one line <-> one `Message`, and the numbers in it both ways.

A line is a head and segments in braces, `DRIVE {Left 1.0} {Right 1.0}` (manual 9.2). `format_message`
writes exactly that form. `parse_message` also takes the lines of real controllers that the original servers
took: any case, missing or extra spaces, and a last segment without its `}`.
"""

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeAlias

from usarmjx.base.errors import PeerError, UsageError
from usarmjx.base.registry import is_name

Vector: TypeAlias = tuple[float, float, float]
Segment: TypeAlias = tuple[str, str]

DEFAULT_LIMIT = 8192
"""Longest line [bytes].

The longest line of a known client is a few hundred bytes, and the largest line buffer seen in one (Player's
drivers) is 4096 bytes. Twice that leaves room and stays a small allocation.
"""
# Controllers end lines with CR LF, LF CR, LF or CR. Any run of them is one end, which also drops
# blank lines.
_END = re.compile(rb"[\r\n]+")
# The first line of any HTTP request, whatever its method, and the header that browsers send next.
_HTTP = re.compile(r"[a-z-]+ +[^ {}]+ +HTTP/[0-9]|Host:", re.IGNORECASE)
# Only these separate words. Python's own idea of white space would also split at the latin-1
# characters 0x85 and 0xA0, so that a message read back could differ from the one written.
_SPACE = " \t"
_GAP = re.compile(r"[ \t]+")
_HEAD = re.compile(r"[^ \t\r\n{}]*")
_WORD = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_KEY = re.compile(r"[^ \t\r\n{}]+")
_VALUE = re.compile(r"[^\r\n{}]*")
# The form of every valid message, if no key has a space and there are as many braces as segments.
_LINE = re.compile(
    r"[A-Za-z][A-Za-z0-9_]*"
    r"(?: \{[^ \t\r\n{}]+(?: [^ \t\r\n{}](?:[^\r\n{}]*[^ \t\r\n{}])?)?\})*"
)
# The longest prefix that C's atof reads. Hexadecimal numbers are left out: the C library of the
# original's Windows servers did not know them either.
_NUMBER_FORM = r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
_NUMBER = re.compile(rf"\s*({_NUMBER_FORM})")
# NaN and infinity count as numbers: `to_float` refuses them with a reason of their own.
_WHOLE_NUMBER = re.compile(rf"{_NUMBER_FORM}|[+-]?(?:nan|inf)\S*", re.IGNORECASE)
_NOT_FINITE = re.compile(r"\s*[+-]?(?:nan|inf)", re.IGNORECASE)
# Cut at its comma as atof does, 2,5 would be another number.
_DECIMAL_COMMA = re.compile(r"\s*[+-]?[0-9]*,[0-9]")
_BYTE_ORDER_MARK = "\u00ef\u00bb\u00bf"  # of UTF-8, read as latin-1
# The original's floats were of single precision, and so are the simulation's.
_LARGEST = 3.4e38
# A number less than a hundredth of the last place short of a printable one is taken as that one.
# 0.29 * 10000 can be just under 2900, and a float32 0.13 from the simulation is 0.12999999523;
# cut blindly they would read 0.2899 and 0.1299. The original computed in float32 throughout, where
# the product itself rounds. The margin covers float32 up to 32 (scanners reach 20 m).
_CUT_MARGIN = 0.01
# As many numbers take less time as an array.
_MANY = 24


class HttpRequestError(PeerError):
    """A peer speaks HTTP: it may be a browser in which a foreign page sends our commands."""


def refuse_http(line: str) -> None:
    """Do nothing unless a line is of an HTTP request.

    Raises:
        HttpRequestError: It is; hang up before any later line is carried out.
    """
    if _HTTP.match(line):
        raise HttpRequestError("it speaks HTTP, and this port is not for browsers")


class LineBuffer:
    """Collects bytes until a line is complete; holds at most `limit` of them.

    A line over the limit is counted and skipped up to its end instead of ending the connection:
    the original servers ignore unusable lines and stay connected, and a skipped line costs
    no memory however long it is. Bytes are read as latin-1, in which every byte is a character. A byte-order
    mark before the first line is skipped.

    Args:
        limit: Longest line accepted, its end not counted [bytes].
    """

    def __init__(self, limit: int = DEFAULT_LIMIT) -> None:
        self.limit = limit
        self._pending = bytearray()
        self._skipping = False
        self._too_long = 0
        self._is_first = True

    def feed(self, data: bytes) -> list[str]:
        """Return the lines that `data` completes, without their ends; blank ones are left out.

        Raises:
            HttpRequestError: One of them is of an HTTP request; none of them counts.
        """
        # The rest begins a line whose end has not come; it may be empty.
        *complete, rest = _END.split(data)
        lines: list[str] = []
        for piece in complete:
            self._append(piece)
            lines.extend(self.end())
        # All lines first: none of a request's body may be carried out before its first line is recognised.
        for line in lines:
            refuse_http(line)
        self._append(rest)
        return lines

    def end(self) -> list[str]:
        """End the present line, for a peer that sends no line end before it closes.

        Returns:
            The line, or nothing if it is blank or was skipped.
        """
        text = "" if self._skipping else self._pending.decode("latin-1")
        if self._is_first:
            text = text.removeprefix(_BYTE_ORDER_MARK)
        self._is_first = False
        self._pending.clear()
        self._skipping = False
        return [text] if text.strip() else []

    def take_too_long(self) -> int:
        """Return the number of over-long lines since the last call."""
        count, self._too_long = self._too_long, 0
        return count

    def _append(self, piece: bytes) -> None:
        if self._skipping:
            return
        if len(self._pending) + len(piece) > self.limit:
            self._pending.clear()
            self._skipping = True
            self._too_long += 1
        else:
            self._pending += piece


@dataclass(frozen=True, slots=True)
class Message:
    """One line of the protocol, sent or received.

    Attributes:
        kind: The head, such as "DRIVE" or "SEN"; `parse_message` makes it upper case.
        segments: (key, value) per pair of braces, where the value is all that follows the first
            word. Order and repeats are part of the protocol: one line may carry ten `{Name ...}`.
    """

    kind: str
    segments: tuple[Segment, ...] = ()

    def get(self, key: str) -> str:
        """Return the first value under `key`, case ignored, or "" when there is none."""
        return next(iter(self.all(key)), "")

    def all(self, key: str) -> tuple[str, ...]:
        """Return every value under `key` in order, case ignored."""
        wanted = key.lower()
        return tuple(value for name, value in self.segments if name.lower() == wanted)


def parse_message(line: str) -> Message:
    """Return the message that a line means; text outside the braces is ignored.

    Raises:
        PeerError: The head is missing or is no word, there is a line end inside, or the braces
            make no sense: a `}` that closes nothing, or a `{` inside a segment (only the last `}`
            may be missing).
    """
    line = line.strip(" \t\r\n")
    if "\r" in line or "\n" in line:
        raise PeerError("a line end inside a line")
    found = _HEAD.match(line)
    head = found.group() if found else ""
    if not _WORD.fullmatch(head):
        raise PeerError(f"the line starts with {clip(head)}, which is no command word")
    before, *opened = line[len(head) :].split("{")
    if "}" in before:
        raise PeerError("a '}' comes before the first '{'")
    segments: list[Segment] = []
    for index, text in enumerate(opened):
        inside, closing, after = text.partition("}")
        if not closing and index < len(opened) - 1:
            raise PeerError(f"a '{{' opens inside the segment {clip(inside)}")
        if "}" in after:
            raise PeerError(f"a second '}}' follows the segment {clip(inside)}")
        words = _GAP.split(inside.strip(_SPACE), maxsplit=1)
        if words[0]:  # an empty pair of braces is ignored
            segments.append((words[0], words[1] if len(words) > 1 else ""))
    return Message(head.upper(), tuple(segments))


def format_message(message: Message) -> str:
    """Return the line, without its end, that `parse_message` reads back as the same message.

    Raises:
        UsageError: The kind, a key or a value holds what the grammar cannot carry.
    """
    # One regular expression accepts the usual message; the slow check only names the culprit.
    parts = [f"{{{key} {value}}}" if value else f"{{{key}}}" for key, value in message.segments]
    line = " ".join([message.kind, *parts])
    # A key with a space would read back as a key and a value, in a line that the expression accepts.
    spaced = " " in "".join([key for key, _ in message.segments])
    if spaced or line.count("{") != len(parts) or not _LINE.fullmatch(line):
        _check_message(message)
    return line


def _check_message(message: Message) -> None:
    """Raise the error of a message that the grammar cannot carry; see `format_message`."""
    if not _WORD.fullmatch(message.kind):
        raise UsageError(f"{message.kind!r} cannot be the head of a message")
    for key, value in message.segments:
        if not _KEY.fullmatch(key):
            raise UsageError(f"{message.kind}: {key!r} cannot be a segment's key")
        if not _VALUE.fullmatch(value) or value != value.strip(_SPACE):
            raise UsageError(f"{message.kind}: {value!r} cannot be the value of {key!r}")


AUTH = "AUTH"
"""Head of the line with the token that a server may require."""
# Both forms of a token: the line AUTH on sockets, and the query in a page's address.
_SECRET = re.compile(rf"(\b{AUTH}\b[\s{{]*(?:Token\b\s*)?|\btoken=)[^\s{{}};&'\"\\]+", re.IGNORECASE)


def is_auth(line: str) -> bool:
    """Return whether a line says a token."""
    # One character more than the word itself: AUTHOR begins with it, too.
    return line.lstrip()[: len(AUTH) + 1].rstrip(" {\t").upper() == AUTH


def redact(text: str) -> str:
    """Return a text without the tokens in it, of lines `AUTH ...` and of addresses `?token=...`."""
    return _SECRET.sub(r"\1...", text)


def clip(text: str, limit: int = 60) -> str:
    """Return text of a peer fit for a log line: quoted, control characters escaped, cut short."""
    return repr(text if len(text) <= limit else text[:limit] + "...")


def is_number(text: str) -> bool:
    """Return whether a text is one number and nothing else."""
    return _WHOLE_NUMBER.fullmatch(text.strip(_SPACE)) is not None


def to_float(text: str) -> float:
    """Return the number at the start of a text, as C's atof does; garbage is 0.

    The original cut "2,5" to 2. Here a decimal comma is refused: a client on a machine with such a locale
    would drive at another speed than it meant.

    Raises:
        PeerError: NaN, infinity, a number too large for a float, or one with a decimal comma.
    """
    if _DECIMAL_COMMA.match(text):
        raise PeerError(f"{clip(text)} has a decimal comma, expected a point")
    found = _NUMBER.match(text)
    value = float(found.group(1)) if found else 0.0
    if _NOT_FINITE.match(text) or not abs(value) <= _LARGEST:
        raise PeerError(f"{clip(text)} is not a finite number")
    return value


def to_int(text: str) -> int:
    """Return `to_float` cut toward zero; "0.5" is 0.

    Raises:
        PeerError: NaN, infinity, or a number too large for a float.
    """
    return int(to_float(text))


def to_bool(text: str) -> bool:
    """Return whether a text is true, in any case, or starts with a number other than 0.

    Raises:
        PeerError: NaN, infinity, or a number too large for a float.
    """
    return text.strip(_SPACE).lower() == "true" or to_float(text) != 0.0


def split_vector(text: str) -> list[str]:
    """Return the parts of a vector, as many as there are.

    They are split at spaces if the text contains one and at commas otherwise, as GameBots does:
    "4.5,1.9,1.8", "4.5, 1.9, 1.8" and "4.5 1.9 1.8" are the same, and "1,50 2,00 0,00" has three parts
    with decimal commas.
    """
    text = text.strip(_SPACE)
    parts = _GAP.split(text)
    if len(parts) == 1:
        return text.split(",") if text else []
    bare = (part.strip(",") for part in parts)  # "4.5 , 1.9 , 1.8" leaves commas of their own
    return [part for part in bare if part]


def to_vector(text: str) -> tuple[float, ...]:
    """Return the numbers of a vector, split by `split_vector`.

    Raises:
        PeerError: One of them is not finite or has a decimal comma.
    """
    return tuple(map(to_float, split_vector(text)))


def four_decimals(value: float) -> str:
    """Return 4 decimals cut toward zero, "-0.0000" included: the form of most numbers.

    Raises:
        UsageError: The value is not finite.
    """
    _require_finite(value)
    return f"{math.copysign(int(abs(value) * 10_000 + _CUT_MARGIN) / 10_000, value):.4f}"


def two_decimals(value: float) -> str:
    """Return 2 decimals, rounded, as UnrealScript prints a float.

    Captures have STA at 5609.45 beside a sensor at 5609.4467, so these are not cut.

    Raises:
        UsageError: The value is not finite.
    """
    _require_finite(value)
    return f"{value:.2f}"


def four_decimals_list(values: Iterable[float]) -> str:
    """Return numbers of the form `four_decimals`, separated by commas only."""
    numbers, signed = [*values], math.copysign
    # One test of the sum spares a test per number; an overflow of the sum alone passes the tests below.
    if not math.isfinite(sum(numbers)):
        for value in numbers:
            _require_finite(value)
    if len(numbers) < _MANY:
        cut = [signed(int(abs(value) * 10_000 + _CUT_MARGIN) / 10_000, value) for value in numbers]
    else:
        import numpy as np  # the console starts without it

        array = np.array(numbers, np.float64)
        whole = np.trunc(np.abs(array) * 10_000 + _CUT_MARGIN)
        cut = np.copysign(whole / 10_000, array).tolist()
    return _four_decimals_form(len(cut)) % tuple(cut)


# Kept by count: the scans of a sensor all have the same number of beams.
@lru_cache(maxsize=4096)
def _four_decimals_form(count: int) -> str:
    return ",".join(["%.4f"] * count)


def two_decimals_list(values: Iterable[float]) -> str:
    """Return numbers of the form `two_decimals`, separated by commas only."""
    return ",".join([two_decimals(value) for value in values])


# Kept: the same few names stand in every report.
@lru_cache(maxsize=4096)
def check_word(text: str) -> str:
    """Return `text` if it can stand among the pairs of a segment such as `{Name F1 Range 1.0}`.

    Raises:
        UsageError: It is no name (manual 9.2): a space, for instance, would shift the pairs after it.
    """
    if not is_name(text):
        raise UsageError(
            f"{text!r} must be one word of printable ASCII without braces to stand inside a segment"
        )
    return text


def _require_finite(value: float) -> None:
    if not math.isfinite(value):
        raise UsageError(f"{value} cannot be reported: mask it before it gets here")
