"""How messages travel: JSON, JSON as a picture, CBOR, CBOR around ROS's own bytes; whole or in fragments."""

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
"""What `struct` calls numbers, and NumPy too."""
CDR_HEADER = b"\x00\x01\x00\x00"
"""Says: plain CDR, little end first."""
TYPED_ARRAYS = {"int8": 72, "uint16": 69, "int32": 78, "uint32": 70, "float32": 85, "float64": 86}
"""Tags that CBOR has for arrays of numbers, little end first (RFC 8746)."""


def number_array(base: str, values: Any) -> bytes:  # noqa: ANN401 - a list of numbers, or bytes
    """Return numbers of a type one after the other, little end first."""
    if isinstance(values, bytes):
        return values
    return np.asarray(values, np.dtype(FORMATS[base]).newbyteorder("<")).tobytes()


class MessageBytes:
    """Bytes of one message.

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
        if self._aligned:
            self._bytes += bytes(-len(self._bytes) % size)


def cbor_values(version: RosVersion, kind: str, value: Any) -> Any:  # noqa: ANN401 - as `fields` say
    """Return a value of a type as CBOR has it: numbers in a row as bytes with a tag, uint8[] as bytes."""
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


BridgeFrame: TypeAlias = str | bytes
"""What goes over a websocket at once: a text, or bytes."""


class Compression(StrEnum):
    """What a subscription may ask for."""

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
    """Return what tells a subscriber of a message.

    Args:
        topic: Its topic.
        kind: Its type, in short.
        message: The message.
        version: In whose names it is.
        compression: How it travels.
        now: The simulated time [s], which `cbor-raw` tells beside the bytes.

    Raises:
        ValueError: It is to be JSON, and a number is not finite.
    """
    told: RosMessage = {"op": "publish", "topic": topic}
    if compression in (Compression.NONE, Compression.PNG):
        text = as_json({**told, "msg": message})
        return text if compression == Compression.NONE else as_json(png_of_text(text))
    from cbor2 import dumps

    if compression == Compression.CBOR:
        return dumps({**told, "msg": cbor_values(version, kind, message)})
    whole = MessageBytes(version).whole(kind, message)
    return dumps({**told, "msg": {**RosVersion.ROS1.stamp(now), "bytes": whole}})


def png_of_text(text: str) -> RosMessage:
    """Return a text as pixels of a picture, three bytes each, filled up with line feeds."""
    from PIL import Image

    data = text.encode()
    width = max(1, math.isqrt(len(data) // 3))
    height = -(-len(data) // (3 * width))
    file = io.BytesIO()
    Image.frombytes("RGB", (width, height), data.ljust(3 * width * height, b"\n")).save(file, "PNG")
    return {"op": "png", "data": file.getvalue()}


def fragments(text: str, size: int, name: str) -> Iterator[str]:
    """Yield a text in parts of so many characters; as it is if it is no longer."""
    count = -(-len(text) // size)
    if count <= 1:
        yield text
        return
    for number in range(count):
        part = text[number * size : (number + 1) * size]
        yield json.dumps({"op": "fragment", "id": name, "data": part, "num": number, "total": count})
