"""Pictures of the image server in a terminal: two pixels in each character, and files of them."""

import asyncio
import io
import struct
from collections.abc import AsyncIterator
from pathlib import Path

from PIL import Image

from usarmjx.base.errors import UsageError, WriteError
from usarmjx.cli.console.client import TIMEOUT, failure_of
from usarmjx.server.network.access import AUTH

# Type and length of a picture, then width and height of a raw one. The manual states no byte order:
# big-endian is that of later versions.
HEADER = struct.Struct(">BI")
RAW_SIZE = struct.Struct(">HH")
MAX_SIZE = 64 << 20
"""Longest picture that is taken [bytes]."""
HALF_BLOCK = "\N{UPPER HALF BLOCK}"
"""Its upper half has the character's colour, the lower one that of its background."""

Pixel = tuple[int, int, int]
HalfBlocks = list[list[tuple[Pixel, Pixel]]]
"""Characters of a picture, row by row: the colours of their upper and lower halves."""


class PictureStream:
    """A client of the image server.

    Args:
        host: The server.
        port: Its port for pictures.
        token: Line that it expects first; empty: it does not.
        fps: Most pictures per second.

    Attributes:
        address: Name that the server has for it, for `SET {Type Camera} {Client ...}`.
    """

    def __init__(self, host: str, port: int, token: str = "", fps: float = 5.0) -> None:
        self._host, self._port, self._token, self._period = host, port, token, 1 / fps
        self.address = ""

    async def pictures(self) -> AsyncIterator[Image.Image]:
        """Yield pictures until the server hangs up.

        Raises:
            UsageError: There is no such server, or it sends no pictures.
        """
        try:
            async with asyncio.timeout(TIMEOUT):
                reader, writer = await asyncio.open_connection(self._host, self._port)
        except (OSError, TimeoutError) as error:
            reason = failure_of(error)
            raise UsageError(f"no pictures from {self._host}:{self._port}: {reason}") from error
        # The server knows its clients by the address that they connect from.
        self.address = "{}:{}".format(*writer.get_extra_info("sockname")[:2])
        if self._token:
            writer.write(f"{AUTH} {{Token {self._token}}}\r\n".encode("latin-1"))
        loop = asyncio.get_running_loop()
        try:
            while True:
                # The period includes the transfer: slow networks do not slow the pace any further.
                began = loop.time()
                number, size = HEADER.unpack(await reader.readexactly(HEADER.size))
                # Bytes of another kind of server read as any size.
                if size > MAX_SIZE:
                    raise UsageError(f"{self._host}:{self._port} is no image server")
                yield decode(number, await reader.readexactly(size))
                await asyncio.sleep(max(0.0, began + self._period - loop.time()))
                # A picture comes for each OK, so the pace is this client's.
                writer.write(b"OK")
        except (ConnectionError, asyncio.IncompleteReadError):
            return
        finally:
            writer.close()

    async def save_all(self, files: "PictureFiles") -> None:
        """Save pictures until the server hangs up; raises what `pictures` and `PictureFiles.save` do."""
        async for picture in self.pictures():
            files.save(picture)


def decode(number: int, data: bytes) -> Image.Image:
    """Return a picture of one of the server's types.

    Raises:
        UsageError: It is none.
    """
    try:
        # Type 0 is raw, 1 to 5 are JPEG of falling quality (manual 14.5.3).
        if number:
            # Bytes of a peer reach this one decoder only, not all that the library has.
            with Image.open(io.BytesIO(data), formats=("JPEG",)) as image:
                return image.convert("RGB")
        size = RAW_SIZE.unpack_from(data)
        return Image.frombytes("RGB", size, data[RAW_SIZE.size :])
    except (OSError, ValueError, struct.error, Image.DecompressionBombError) as error:
        raise UsageError(f"a picture that cannot be read: {' '.join(str(error).split())}") from error


def half_blocks(image: Image.Image, width: int, height: int) -> HalfBlocks:
    """Return a picture as characters, in proportion and as large as fits into the given columns and rows."""
    # A character is about twice as high as wide, and shows two pixels.
    scale = min(width / image.width, 2 * height / image.height)
    columns = max(1, min(width, round(image.width * scale)))
    rows = max(1, min(height, round(image.height * scale / 2)))
    # Each pixel is the mean of those that it covers: single ones would flicker.
    pixels = list(image.resize((columns, 2 * rows), Image.Resampling.BOX).tobytes())
    colors = [(pixels[i], pixels[i + 1], pixels[i + 2]) for i in range(0, len(pixels), 3)]
    lines = [colors[i : i + columns] for i in range(0, len(colors), columns)]
    return [list(zip(*lines[i : i + 2], strict=True)) for i in range(0, 2 * rows, 2)]


class PictureFiles:
    """A folder that pictures are put into.

    Args:
        folder: The folder, which is made.

    Raises:
        WriteError: It cannot be made.
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self._count = folder, 0
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise WriteError(f"--save-pictures: cannot make {folder}: {error.strerror}") from error

    def save(self, image: Image.Image) -> Path:
        """Save a picture under the next free number.

        Raises:
            WriteError: It cannot be written.
        """
        # A folder may hold the pictures of an earlier session, which must stay.
        while (path := self._folder / f"picture-{self._count:06d}.png").exists():
            self._count += 1
        try:
            image.save(path)
        except OSError as error:
            raise WriteError(f"--save-pictures: cannot write {path}: {error.strerror}") from error
        return path
