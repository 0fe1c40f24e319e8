"""Encodings of messages: JSON, JSON as a picture, CBOR, CBOR around ROS bytes; whole or in fragments."""

import base64
import io
import json
import math
import struct
from collections.abc import Iterator
from enum import StrEnum
from typing import Any, TypeAlias

import numpy as np

from usarmjx.server.rosbridge.definitions import RosMessage, RosVersion

FORMATS = {
    "bool": "?",
    "int8": "b",
    "uint8": "B",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "float32": "f",
    "float64": "d",
}
"""Format characters of numbers for `struct` and NumPy."""
CDR_HEADER = b"\x00\x01\x00\x00"
"""CDR encapsulation: plain CDR, little-endian."""
TYPED_ARRAYS = {"int8": 72, "uint16": 69, "int32": 78, "uint32": 70, "float32": 85, "float64": 86}
"""CBOR tags of little-endian arrays of numbers (RFC 8746)."""
BridgeFrame: TypeAlias = str | bytes
"""One frame of the websocket: text or bytes."""


def number_array(base: str, values: Any) -> bytes:  # noqa: ANN401 - a list of numbers, or bytes
    """Return numbers of a type one after the other, little-endian."""
    if isinstance(values, bytes):
        return values
    return np.asarray(values, np.dtype(FORMATS[base]).newbyteorder("<")).tobytes()


class MessageBytes:
    """Serialized bytes of one message.

    Args:
        version: ROS 1's form, or CDR, in which a number begins at a multiple of its size.
    """

    def __init__(self, version: RosVersion) -> None:
        self._version, self._aligned = version, version == RosVersion.ROS2
        self._bytes = bytearray()

    def whole(self, kind: str, message: RosMessage) -> bytes:
        """Return a message of a type, by its short name."""
        self._put(kind, message)
        return (CDR_HEADER if self._aligned else b"") + bytes(self._bytes)

    def _put(self, kind: str, value: Any) -> None:  # noqa: ANN401 - as `fields` say
        base, _, length = kind.partition("[")
        if length:
            self._put_all(base, value, counted=length == "]")
        elif base == "string":
            text = value.encode() + (b"\0" if self._aligned else b"")
            self._number("uint32", len(text))
            self._bytes += text
        elif base in FORMATS:
            self._number(base, float("nan") if value is None else value)
        else:
            for name, its in self._version.fields(base).items():
                self._put(its, value[name])

    def _put_all(self, base: str, values: Any, *, counted: bool) -> None:  # noqa: ANN401 - a list or bytes
        if counted:
            self._number("uint32", len(values))
        if base not in FORMATS:
            for value in values:
                self._put(base, value)
        elif len(values):
            self._align(struct.calcsize(FORMATS[base]))
            self._bytes += number_array(base, values)

    def _number(self, base: str, value: float) -> None:
        packed = struct.pack(f"<{FORMATS[base]}", value)
        self._align(len(packed))
        self._bytes += packed

    def _align(self, size: int) -> None:
        # Offsets count from behind the header of 4 bytes, which `whole` adds last.
        if self._aligned:
            self._bytes += bytes(-len(self._bytes) % size)


def cbor_values(version: RosVersion, kind: str, value: Any) -> Any:  # noqa: ANN401 - as `fields` say
    """Return a value of a type for CBOR: arrays of numbers as tagged bytes, uint8[] as bytes."""
    from cbor2 import CBORTag

    base, _, length = kind.partition("[")
    if length and base in FORMATS:
        packed = number_array(base, value)
        return packed if base == "uint8" else CBORTag(TYPED_ARRAYS[base], packed)
    if length:
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
    return dumps({**head, "msg": {**RosVersion.ROS1.stamp(now), "bytes": whole}})


def png_of_text(text: str) -> RosMessage:
    """Return a text as a PNG of three bytes per pixel, padded with line feeds."""
    from PIL import Image

    data = text.encode()
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
