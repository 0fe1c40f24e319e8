"""The image server's protocol (manual 14.5.3): pictures out, acknowledgements in; it knows no socket.

A frame is the type (1 byte), the length of the data (4 bytes) and the data. The manual states no byte order;
the length is big-endian as in the image server of later versions, and so are the width and height (2 bytes
each) in front of a raw picture's rows.
"""

import io
import math
import struct
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from PIL import Image

from usarmjx.base.errors import UsageError
from usarmjx.server.protocol.grammar import AUTH, LineBuffer

FORMATS = ("raw", "super", "good", "normal", "average", "bad")
"""Names of the picture types, in the order of their numbers."""
JPEG_QUALITY = (100, 75, 50, 25, 10)
"""JPEG quality of types 1 to 5: the meaning of their names in FreeImage, the original's library."""
MAX_IMAGE_SIDE = 4096
"""Largest side of a picture [pixels]."""
MAX_AUTH_LINE = 192
"""Longest line with a token that is skipped [bytes]."""
FIRST_FRAME_DELAY = 0.1
"""Delay of the first picture when no client request comes [s].

Some clients ask for the first picture, others wait for it.
"""
RECTANGLE = struct.Struct(">4I")
"""Wire form of a region: left, top, width, height."""

Region: TypeAlias = tuple[int, int, int, int]


def format_number(text: str) -> int:
    """Return the number of a picture type by its name or its number.

    Raises:
        UsageError: It is neither; lists those known.
    """
    names = {name: number for number, name in enumerate(FORMATS)}
    number = names.get(text.lower(), int(text) if text.isdecimal() else -1)
    if not 0 <= number < len(FORMATS):
        known = ", ".join(f"{name} ({number})" for name, number in names.items())
        raise UsageError(f"no picture format {text!r}; known: {known}")
    return number


def parse_size(text: str) -> tuple[int, int]:
    """Return width and height of a text such as `320x240`.

    Raises:
        UsageError: It is not of that form, or too large.
    """
    parts = text.lower().split("x")
    if len(parts) == 2 and all(part.isdecimal() and 1 <= int(part) <= MAX_IMAGE_SIDE for part in parts):
        return int(parts[0]), int(parts[1])
    raise UsageError(f"picture size {text!r} is not of the form 320x240, each from 1 to {MAX_IMAGE_SIDE}")


def encode_frame(number: int, pixels: np.ndarray) -> bytes:
    """Return the frame of a picture.

    Args:
        number: Picture type, 0 to 5.
        pixels: Red, green and blue, rows from the top (height, width, 3) uint8.
    """
    if number == 0:
        height, width = pixels.shape[:2]
        data = struct.pack(">HH", width, height) + pixels.tobytes()
    else:
        data = jpeg(number, pixels)
    return struct.pack(">BI", number, len(data)) + data


def jpeg(number: int, pixels: np.ndarray) -> bytes:
    """Return a picture (height, width, 3) uint8 as a JPEG of one of the types 1 to 5."""
    out, quality = io.BytesIO(), JPEG_QUALITY[number - 1]
    # Pillow's default stores colours at half the resolution; the best quality keeps them all.
    image = Image.fromarray(np.ascontiguousarray(pixels))
    image.save(out, "JPEG", quality=quality, subsampling=0 if number == 1 else 2)
    return out.getvalue()


@dataclass
class ImageSession:
    """Dialogue of one image client.

    Attributes:
        size: Width and height of the pictures [pixels].
        period: Time between two pictures [s].
        began: Time at which the client connected [s].
        region: Requested part of the picture: left, top, width, height; None without a request.
    """

    size: tuple[int, int]
    period: float
    began: float

    def __post_init__(self) -> None:
        """Request the first picture."""
        self.region: Region | None = (0, 0, *self.size)
        self._asked = self._sent = False
        self._due = self.began + FIRST_FRAME_DELAY
        self._pending = b""
        self._text = LineBuffer()

    def receive_data(self, data: bytes) -> None:
        """Take bytes: `OK` asks for the next picture, `U` and four numbers of 4 bytes for a part of it.

        Any other byte is skipped. A second request before the picture is sent counts as one. A part is an
        extension of the image server of later versions; one outside the picture is not answered.

        Raises:
            HttpRequestError: The peer speaks HTTP; hang up.
        """
        self._text.feed(data)  # only for its refusal of HTTP: acknowledgements have no lines
        data = self._after_auth(self._pending + data)
        at = 0
        while at < len(data):
            head = data[at : at + 1]
            # TCP may cut a request anywhere: an incomplete one waits for its rest.
            length = {b"O": 2, b"U": 1 + RECTANGLE.size}.get(head, 1)
            piece = data[at : at + length]
            if len(piece) < length:
                self._pending = piece
                return
            if head == b"O" and piece != b"OK":
                # Not OK after all: only the O is skipped, as the next byte may begin a request.
                length = 1
            elif head == b"O":
                self._ask((0, 0, *self.size))
            elif head == b"U":
                self._ask(self._overlap(*RECTANGLE.unpack(piece[1:])))
            at += length

    def _after_auth(self, data: bytes) -> bytes:
        """Return bytes without a line AUTH at their beginning, which may not be complete yet.

        No request begins as it does; the `U` in it would be the beginning of one.
        """
        self._pending = b""
        head = data.lstrip(b"\r\n")
        if head[: len(AUTH)].upper() != AUTH.encode()[: len(head)] or not head:
            return data
        ends = [place for place in map(head.find, (b"\r", b"\n")) if place >= 0]
        if ends:
            # The line end stays in front: it begins no request, so `receive_data` skips it.
            return head[min(ends) :]
        # A line without an end is not kept: it would grow with every byte of the peer.
        if len(head) > MAX_AUTH_LINE:
            return b""
        self._pending = head
        return b""

    def wants(self, now: float) -> bool:
        """Whether a picture is due."""
        # The first picture goes out on request; later ones wait for the period, or clients would set the
        # rate.
        return self.region is not None and (now >= self._due or (self._asked and not self._sent))

    def sent(self, now: float) -> None:
        """Record that the picture due at `now` [s] is on its way; the next is due whole periods later."""
        if self._sent:
            # Whole periods from the first picture on, so that a late one does not lower the rate.
            self._due += self.period * (1 + math.floor((now - self._due) / self.period))
        else:
            # The rate counts from the first picture, whenever that is.
            self._due = now + self.period
        self.region, self._asked, self._sent = None, False, True

    def _ask(self, region: Region | None) -> None:
        if region is not None and not self._asked:
            self.region, self._asked = region, True

    def _overlap(self, left: int, top: int, width: int, height: int) -> Region | None:
        right, bottom = min(left + width, self.size[0]), min(top + height, self.size[1])
        return (left, top, right - left, bottom - top) if left < right and top < bottom else None
