"""Encodings of messages: ROS 1 bytes, CDR of ROS 2, JSON, JSON as a picture, CBOR; whole or in fragments."""

import base64
import io
import json
import math
import struct
from collections.abc import Callable, Iterator, Mapping
from enum import StrEnum
from functools import cache
from typing import Any, NoReturn, TypeAlias

import numpy as np

from usarmjx.base.errors import PeerError
from usarmjx.server.rosbridge.definitions import RosMessage, RosVersion

FORMATS = {
    "bool": "?",
    "int8": "b",
    "uint8": "B",
    "byte": "B",
    "char": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
"""Format characters of numbers for `struct` and NumPy."""
BYTES = ("uint8", "byte", "char")
"""Numbers whose lists are bytes."""
CDR_HEADER = b"\x00\x01\x00\x00"
"""CDR encapsulation: plain CDR, little-endian."""
MOST_NESTED = 16
"""Deepest nesting of types that is read."""
_Putter: TypeAlias = "Callable[[bytearray, Any], None]"
"""Appends a value to bytes."""
TYPED_ARRAYS = {"int8": 72, "uint16": 69, "int32": 78, "uint32": 70, "float32": 85, "float64": 86}
"""CBOR tags of little-endian arrays of numbers (RFC 8746)."""
BridgeFrame: TypeAlias = str | bytes
"""One frame of the websocket: text or bytes."""


def split_kind(kind: str) -> tuple[str, bool, int]:
    """Return the parts of a field's type: of its items, whether it is a list, and its fixed length or 0.

    Bounds such as `string<=256` and `[<=1]` do not change bytes, and are left out.
    """
    base, bracket, length = kind.partition("[")
    size = length[:-1]
    return base.partition("<")[0], bool(bracket), int(size) if size.isdecimal() else 0


def number_array(base: str, values: Any) -> bytes:  # noqa: ANN401 - a list of numbers, or bytes
    """Return numbers of a type one after the other, little-endian."""
    # Pictures are bytes already, and have no list of a million numbers in between.
    if isinstance(values, bytes):
        return values
    return np.asarray(values, np.dtype(FORMATS[base]).newbyteorder("<")).tobytes()


class MessageBytes:
    """Serialized bytes of messages.

    Args:
        version: ROS 1's form, or CDR, in which a number begins at a multiple of its size.
    """

    def __init__(self, version: RosVersion) -> None:
        self._version = version

    def whole(self, kind: str, message: RosMessage) -> bytes:
        """Return a message of a type, by its short name."""
        out = bytearray()
        _putter(self._version, kind)(out, message)
        # Offsets count from behind the header of 4 bytes, which therefore comes last.
        return (CDR_HEADER if self._version == RosVersion.ROS2 else b"") + bytes(out)


# Kept by type: to make one walks through the fields of all types in it.
@cache
def _putter(version: RosVersion, kind: str) -> _Putter:
    """Return what appends values of a type; numbers of one size in a row are packed at once."""
    base, is_list, length = split_kind(kind)
    aligned = version == RosVersion.ROS2
    if is_list:
        return _list_putter(version, base, counted=not length)
    if base == "string":
        return _cdr_text if aligned else _plain_text
    if base in FORMATS:
        return _run(FORMATS[base], ((),), aligned)
    steps = tuple(_steps(version, base, aligned))

    def put(out: bytearray, value: RosMessage) -> None:
        for step in steps:
            step(out, value)

    return steps[0] if len(steps) == 1 else put


def _steps(version: RosVersion, kind: str, aligned: bool) -> Iterator[_Putter]:
    codes, paths = "", list[tuple[str, ...]]()
    # Nested messages are flattened: alignment in CDR depends on single numbers, not on structures.
    for path, its in _leaves(version, kind, ()):
        base, is_list, _ = split_kind(its)
        code = "" if is_list else FORMATS.get(base, "")
        # A run has numbers of one size, so its start alone needs alignment.
        if codes and (not code or struct.calcsize(code) != struct.calcsize(codes[0])):
            yield _run(codes, tuple(paths), aligned)
            codes, paths = "", []
        if code:
            codes += code
            paths.append(path)
        else:
            yield _at(path, _putter(version, its))
    if codes:
        yield _run(codes, tuple(paths), aligned)


def _leaves(version: RosVersion, kind: str, above: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], str]]:
    for name, its in version.fields(kind).items():
        base, is_list, _ = split_kind(its)
        if is_list or base == "string" or base in FORMATS:
            yield (*above, name), its
        else:
            yield from _leaves(version, base, (*above, name))


def _at(path: tuple[str, ...], put: _Putter) -> _Putter:
    def put_field(out: bytearray, value: RosMessage) -> None:
        found: Any = value
        for name in path:
            found = found[name]
        put(out, found)

    return put_field


def _run(codes: str, paths: tuple[tuple[str, ...], ...], aligned: bool) -> _Putter:
    """Return what appends numbers of one size; a number that is None is not known: NaN."""
    pack, size = struct.Struct(f"<{codes}").pack, struct.calcsize(codes[0]) if aligned else 1
    # An expression is three times as quick as a loop over the paths: transforms come by the thousand.
    items = "".join("v" + "".join(f"[{name!r}]" for name in path) + ", " for path in paths)
    # Safe: names come from `definitions`, none from a client.
    numbers: Callable[[Any], tuple[Any, ...]] = eval(f"lambda v: ({items})")

    def put(out: bytearray, value: Any) -> None:  # noqa: ANN401 - as `fields` say
        out += bytes(-len(out) % size)
        found = numbers(value)
        if None in found:
            found = tuple(float("nan") if one is None else one for one in found)
        out += pack(*found)

    return put


def _cdr_text(out: bytearray, value: str) -> None:
    text = value.encode() + b"\0"
    out += bytes(-len(out) % 4)
    out += len(text).to_bytes(4, "little")
    out += text


def _plain_text(out: bytearray, value: str) -> None:
    text = value.encode()
    out += len(text).to_bytes(4, "little")
    out += text


def _list_putter(version: RosVersion, base: str, *, counted: bool) -> _Putter:
    aligned = version == RosVersion.ROS2
    size = struct.calcsize(FORMATS[base]) if base in FORMATS and aligned else 1
    # Looked up at the first value: a type may come before those that it contains.
    each: list[_Putter] = []

    def put(out: bytearray, values: Any) -> None:  # noqa: ANN401 - a list or bytes
        if counted:
            out += bytes(-len(out) % (4 if aligned else 1))
            out += len(values).to_bytes(4, "little")
        if not len(values):
            return
        if base in FORMATS:
            # After the count, and only if there are items: CDR does not pad in front of an empty list.
            out += bytes(-len(out) % size)
            out += number_array(base, values)
            return
        if not each:
            each.append(_putter(version, base))
        for value in values:
            each[0](out, value)

    return put


class CdrReader:
    """Reader of one message in CDR, of either byte order.

    Args:
        data: The bytes, with their header of 4.
        skip: Bytes behind the header that are no part of the message; a multiple of 8.

    Raises:
        PeerError: It is no plain CDR.
    """

    def __init__(self, data: bytes, skip: int = 0) -> None:
        # 0 is big-endian, 1 little-endian; larger numbers are lists of parameters and later versions of CDR.
        if len(data) < 4 or data[0] != 0 or data[1] not in (0, 1):
            raise PeerError(f"no plain CDR: it begins with {data[:4].hex() or 'nothing'}")
        self._order = "<" if data[1] else ">"
        # Alignment counts from behind the header of 4 bytes: it is cut off, so that offsets need no shift.
        self._data, self._at = data[4:], skip

    def message(self, kind: str) -> RosMessage:
        """Return the message of a type, by its short name; lists of bytes as bytes.

        Raises:
            PeerError: There is less of it than its type has.
        """
        try:
            return self._value(kind, 0)
        except (struct.error, UnicodeDecodeError) as error:
            raise PeerError(f"a {kind} that does not read: {error}") from error

    def _value(self, kind: str, depth: int) -> Any:  # noqa: ANN401 - as `fields` say
        base, is_list, length = split_kind(kind)
        if depth > MOST_NESTED:
            self._fail("it is nested too deeply")
        if is_list:
            return self._list(base, length or self._number("I"), depth)
        if base == "string":
            size = self._number("I")
            # CDR counts the terminating zero with the text.
            return self._take(size).rstrip(b"\0").decode()
        if base in FORMATS:
            return self._number(FORMATS[base])
        fields: Mapping[str, str] = RosVersion.ROS2.fields(base)
        return {name: self._value(its, depth + 1) for name, its in fields.items()}

    def _list(self, base: str, length: int, depth: int) -> Any:  # noqa: ANN401 - a list or bytes
        if base in BYTES:
            return self._take(length)
        if base not in FORMATS:
            # Every item has a byte at least: a short message must not announce a list that fills the memory.
            if length > len(self._data) - self._at:
                self._fail(f"{length} items are announced")
            return [self._value(base, depth + 1) for _ in range(length)]
        if not length:
            # No alignment for an empty list, as in writing.
            return []
        size = struct.calcsize(FORMATS[base])
        self._at += -self._at % size
        return list(struct.unpack(f"{self._order}{length}{FORMATS[base]}", self._take(length * size)))

    def _number(self, code: str) -> Any:  # noqa: ANN401 - int, float or bool
        size = struct.calcsize(code)
        self._at += -self._at % size
        return struct.unpack(self._order + code, self._take(size))[0]

    def _take(self, size: int) -> bytes:
        if size > len(self._data) - self._at:
            self._fail(f"{size} bytes are announced, {max(0, len(self._data) - self._at)} are left")
        self._at += size
        return self._data[self._at - size : self._at]

    @staticmethod
    def _fail(why: str) -> NoReturn:
        raise PeerError(f"a message that does not read: {why}")


def cbor_values(version: RosVersion, kind: str, value: Any) -> Any:  # noqa: ANN401 - as `fields` say
    """Return a value of a type for CBOR: arrays of numbers as tagged bytes, uint8[] as bytes."""
    from cbor2 import CBORTag

    base, is_list, _ = split_kind(kind)
    if is_list and base in FORMATS:
        packed = number_array(base, value)
        # The protocol has uint8[] as a plain byte string; only other numbers have tags.
        return packed if base == "uint8" else CBORTag(TYPED_ARRAYS[base], packed)
    if is_list:
        return [cbor_values(version, base, one) for one in value]
    if base in FORMATS or base == "string":
        return float("nan") if value is None else value
    return {name: cbor_values(version, its, value[name]) for name, its in version.fields(base).items()}


class Compression(StrEnum):
    """Compression of a subscription."""

    NONE = "none"
    PNG = "png"
    CBOR = "cbor"
    CBOR_RAW = "cbor-raw"


def as_json(message: RosMessage) -> str:
    """Return a message as JSON, uint8[] as base64.

    Raises:
        ValueError: A number is not finite.
    """
    # Python would write NaN, which is no JSON: browsers refuse the whole message.
    return json.dumps(message, allow_nan=False, default=_text_of_bytes)


def _text_of_bytes(data: object) -> str:
    if not isinstance(data, bytes):
        raise TypeError(f"{type(data).__name__} is nothing that messages have")
    return base64.b64encode(data).decode()


def publication(
    topic: str, kind: str, message: RosMessage, version: RosVersion, compression: Compression, now: float
) -> BridgeFrame:
    """Return the frame that publishes a message to a subscriber.

    Args:
        topic: Its topic.
        kind: Its short type.
        message: The message.
        version: Version of its field names.
        compression: Its encoding.
        now: The simulated time [s], which `cbor-raw` sends beside the bytes.

    Raises:
        ValueError: JSON is requested, and a number is not finite.
    """
    head: RosMessage = {"op": "publish", "topic": topic}
    if compression in (Compression.NONE, Compression.PNG):
        text = as_json({**head, "msg": message})
        return text if compression == Compression.NONE else as_json(png_of_text(text))
    from cbor2 import dumps

    if compression == Compression.CBOR:
        return dumps({**head, "msg": cbor_values(version, kind, message)})
    whole = MessageBytes(version).whole(kind, message)
    # The stamp has ROS 1's names whatever the version: rosbridge's own form of cbor-raw.
    return dumps({**head, "msg": {**RosVersion.ROS1.stamp(now), "bytes": whole}})


def png_of_text(text: str) -> RosMessage:
    """Return a text as a PNG of three bytes per pixel, padded with line feeds."""
    from PIL import Image

    data = text.encode()
    # About as wide as high, as rosbridge's own; readers take the bytes of all rows together.
    width = max(1, math.isqrt(len(data) // 3))
    height = -(-len(data) // (3 * width))
    file = io.BytesIO()
    Image.frombytes("RGB", (width, height), data.ljust(3 * width * height, b"\n")).save(file, "PNG")
    return {"op": "png", "data": file.getvalue()}


def fragments(text: str, size: int, name: str) -> Iterator[str]:
    """Yield a text in fragments of `size` characters; unchanged if it is no longer."""
    count = -(-len(text) // size)
    if count <= 1:
        yield text
        return
    for number in range(count):
        part = text[number * size : (number + 1) * size]
        yield json.dumps({"op": "fragment", "id": name, "data": part, "num": number, "total": count})
