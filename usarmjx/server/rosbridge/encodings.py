"""How messages travel: JSON, JSON as a picture, CBOR, CBOR around ROS's own bytes; whole or in fragments."""

import base64
import io
import json
import math
from collections.abc import Iterator
from enum import StrEnum
from typing import TypeAlias

from usarmjx.server.rosbridge.definitions import RosMessage, RosVersion
from usarmjx.server.rosbridge.serialisation import MessageBytes, cbor_values

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
