"""Encodings of messages: JSON, JSON as a picture, CBOR, CBOR around ROS bytes; whole or in fragments."""

import base64
import io
import json
import math
from collections.abc import Iterator
from enum import StrEnum
from typing import Any, TypeAlias

from usarmjx.server.rosbridge.definitions import RosMessage, RosVersion
from usarmjx.server.rosbridge.serialization import FORMATS, MessageBytes, number_array, split_kind

TYPED_ARRAYS = {"int8": 72, "uint16": 69, "int32": 78, "uint32": 70, "float32": 85, "float64": 86}
"""CBOR tags of little-endian arrays of numbers (RFC 8746)."""
BridgeFrame: TypeAlias = str | bytes
"""One frame of the websocket: text or bytes."""


def cbor_values(version: RosVersion, kind: str, value: Any) -> Any:  # noqa: ANN401 - as `fields` say
    """Return a value of a type for CBOR: arrays of numbers as tagged bytes, uint8[] as bytes."""
    from cbor2 import CBORTag

    base, is_list, _ = split_kind(kind)
    if is_list and base in FORMATS:
        packed = number_array(base, value)
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
