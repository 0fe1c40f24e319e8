"""Recordings as messages: complete, truncated anywhere, or with damaged chunks, which are left out."""

import json
import math
import os
from bisect import bisect_right
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import IO, Any, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, Message, Metadata
from mcap.stream_reader import breakup_chunk

from usarmjx.base.errors import UsageError
from usarmjx.recording.file import CHANNELS, NANO, ChannelName
from usarmjx.recording.inputs import WorldSetup
from usarmjx.recording.values import unpack

MAGIC_SIZE, HEAD_SIZE = 8, 9
"""Sizes of a file's magic bytes, and of a record's opcode and length [bytes]."""
MOST_OPCODE = 0x0F
"""Largest opcode of MCAP."""
CHUNK_FIELDS = 28
"""Size of a chunk's times, size and checksum, before the name of its compression [bytes]."""
COMPRESSION = b"\x04\x00\x00\x00zstd"
"""Name of the compression of our chunks, after its length."""
MOST_BYTES = 1 << 28
"""Largest chunk that is read [bytes]; the writer makes chunks of half a second."""
CACHED_CHUNKS = 16
"""Number of decoded chunks that are kept in memory."""


class RecordedMessage(NamedTuple):
    """A message of a recording.

    Attributes:
        time: Simulated time [s].
        channel: Its channel.
        value: Its content.
    """

    time: float
    channel: ChannelName
    value: Any


@dataclass(frozen=True)
class _Part:
    """A chunk of a file: its times [ns], its offset [bytes], and the ids of its channels."""

    start: int
    end: int
    offset: int
    channels: frozenset[int]


class Recording:
    """A recording that is read.

    Args:
        path: The file.

    Attributes:
        path: The file.
        is_complete: Whether it was closed; otherwise its end is missing.
        about: Metadata of the file, texts by name.
        start: Time of its first chunk [s].
        end: Time of its last chunk [s].
        damaged: From when to when [s] chunks are left out as damaged; of a complete file those read so far.

    Raises:
        UsageError: It cannot be read, or is no recording of ours.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        try:
            self._stream: IO[bytes] = self.path.open("rb")
        except OSError as error:
            raise UsageError(f"{path}: cannot be read: {error.strerror}") from error
        self._channels: dict[int, ChannelName] = {}
        self.about: dict[str, str] = {}
        self.damaged: list[tuple[float, float]] = []
        self._parts: list[_Part] = []
        self.is_complete = self._read_summary()
        if not self.is_complete:
            self._scan()
        if not self._channels or not self._parts:
            self.close()
            raise UsageError(f"{path}: is no recording of usarmjx, or nothing is left of it")
        self.start = min(part.start for part in self._parts) / NANO
        self.end = max(part.end for part in self._parts) / NANO
        self._records = lru_cache(maxsize=CACHED_CHUNKS)(self._read_part)

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def _read_summary(self) -> bool:
        """Read the summary at the end of a complete file; return whether there is one."""
        try:
            reader = SeekingReader(self._stream, record_size_limit=MOST_BYTES)
            summary = reader.get_summary()
            if summary is None:
                return False
            for metadata in reader.iter_metadata():
                self._take_metadata(metadata)
        except Exception:  # the MCAP library raises any error on the cut end of a file
            return False
        for channel in summary.channels.values():
            self._take_channel(channel)
        self._parts = [
            _Part(
                index.message_start_time,
                index.message_end_time,
                index.chunk_start_offset,
                frozenset(index.message_index_offsets),
            )
            for index in summary.chunk_indexes
        ]
        return True

    def _scan(self) -> None:
        """Read a file from its beginning; leave out what is damaged, and end where the rest is missing."""
        self._parts, self._channels = [], {}
        size = self._stream.seek(0, os.SEEK_END)
        gaps: list[int] = []
        offset = MAGIC_SIZE
        while offset < size:
            end = self._end_of_record(offset, size)
            if end is not None and self._take_record(offset, end):
                offset = end
                continue
            # A record whose content alone is damaged is followed by a sound one; else its length is wrong.
            if end is not None and end < size and self._end_of_record(end, size) is not None:
                following: int | None = end
            else:
                following = self._find_chunk(offset + 1)
            if following is None:
                break  # cut off: the rest of the file is missing
            gaps.append(len(self._parts))
            offset = following
        for index in dict.fromkeys(gaps):
            before = self._parts[index - 1].end / NANO if index else 0.0
            after = self._parts[index].start / NANO if index < len(self._parts) else math.inf
            self._note_damage(before, after)

    def _end_of_record(self, offset: int, size: int) -> int | None:
        """Return where a record ends, by its head; None: there is no record."""
        self._stream.seek(offset)
        head = self._stream.read(HEAD_SIZE)
        end = offset + HEAD_SIZE + int.from_bytes(head[1:], "little")
        sound = len(head) == HEAD_SIZE and 0 < head[0] <= MOST_OPCODE and end <= size
        return end if sound else None

    def _take_record(self, offset: int, end: int) -> bool:
        """Note what is in a record; return whether it is intact."""
        self._stream.seek(offset)
        kind = self._stream.read(HEAD_SIZE)[0]
        if kind not in (Opcode.CHUNK, Opcode.METADATA):
            return True
        try:
            content = ReadDataStream(BytesIO(self._stream.read(end - offset - HEAD_SIZE)))
            if kind == Opcode.METADATA:
                self._take_metadata(Metadata.read(content))
                return True
            record = Chunk.read(content)
            inside = _records_of(record)
        except Exception:  # the MCAP library raises any error on damaged bytes
            return False
        for one in inside:
            if isinstance(one, Channel):
                self._take_channel(one)
        used = frozenset(one.channel_id for one in inside if isinstance(one, Message))
        self._parts.append(_Part(record.message_start_time, record.message_end_time, offset, used))
        return True

    def _find_chunk(self, offset: int) -> int | None:
        """Return where the next chunk begins, by the name of its compression; None: there is none."""
        self._stream.seek(offset)
        rest = self._stream.read()
        place = -1
        while (place := rest.find(COMPRESSION, place + 1)) >= 0:
            start = place - CHUNK_FIELDS - HEAD_SIZE
            if start >= 0 and rest[start] == Opcode.CHUNK:
                return offset + start
        return None

    def _note_damage(self, start: float, end: float) -> None:
        if (start, end) not in self.damaged:
            self.damaged.append((start, end))

    def _take_metadata(self, metadata: Metadata) -> None:
        if metadata.name == "usarmjx":
            self.about |= metadata.metadata

    def _take_channel(self, channel: Channel) -> None:
        fields = channel.metadata
        if fields.get("kind") in CHANNELS and fields.get("world", "").isdecimal():
            name = ChannelName(int(fields["world"]), fields["kind"], fields.get("about", ""))
            self._channels[channel.id] = name

    def _read_part(self, part: _Part) -> tuple[Message, ...]:
        try:
            self._stream.seek(part.offset + 9)  # behind the record's opcode (1 byte) and length (8 bytes)
            records = _records_of(Chunk.read(ReadDataStream(self._stream)))
        except Exception:  # the MCAP library raises any error on damaged bytes
            self._note_damage(part.start / NANO, part.end / NANO)
            return ()
        return tuple(record for record in records if isinstance(record, Message))

    @property
    def damage_report(self) -> str:
        """Time spans that are left out as damaged, in a line; empty if there are none."""
        spans = [
            f"{start:.2f} to {end:.2f} s" if math.isfinite(end) else f"{start:.2f} s to the end"
            for start, end in sorted(self.damaged)
        ]
        return f"damaged, left out: {', '.join(spans)}" if spans else ""

    @property
    def worlds(self) -> tuple[int, ...]:
        """Numbers of the worlds in it."""
        return tuple(sorted({channel.world for channel in self._channels.values()}))

    @property
    def channels(self) -> tuple[ChannelName, ...]:
        """The channels in it."""
        return tuple(self._channels.values())

    def messages(
        self, kinds: Collection[str], world: int | None = None, since: float | None = None
    ) -> Iterator[RecordedMessage]:
        """Yield messages in the order in which they were written.

        Args:
            kinds: Kinds of channels.
            world: Number of the world; None for all.
            since: Time before which messages are left out [s].

        Raises:
            UsageError: The file is broken.
        """
        first = 0 if since is None else round(since * NANO)
        wanted = self._wanted(kinds, world)
        for part in self._parts:
            if part.end >= first and not wanted.isdisjoint(part.channels):
                for message in self._records(part):
                    if message.log_time >= first and message.channel_id in wanted:
                        yield self._decoded(message)

    def last(self, kind: str, world: int, time: float) -> RecordedMessage | None:
        """Return the last message of a kind up to a time [s]; None without one."""
        wanted, latest = self._wanted([kind], world), round(time * NANO)
        end = bisect_right(self._parts, latest, key=lambda part: part.start)
        for part in reversed(self._parts[:end]):
            if not wanted.isdisjoint(part.channels):
                for message in reversed(self._records(part)):
                    if message.log_time <= latest and message.channel_id in wanted:
                        return self._decoded(message)
        return None

    def following(self, kind: str, world: int, time: float) -> RecordedMessage | None:
        """Return the first message of a kind after a time [s]; None without one."""
        wanted, first = self._wanted([kind], world), round(time * NANO)
        for part in self._parts:
            if part.end > first and not wanted.isdisjoint(part.channels):
                for message in self._records(part):
                    if message.log_time > first and message.channel_id in wanted:
                        return self._decoded(message)
        return None

    def setup(self, world: int) -> WorldSetup:
        """Return the initial inputs of a world.

        Raises:
            UsageError: The file has none.
        """
        found = next(self.messages(["setup"], world), None)
        if found is None or not isinstance(found.value, WorldSetup):
            raise UsageError(f"{self.path}: does not say what world {world} was made of")
        return found.value

    def _wanted(self, kinds: Collection[str], world: int | None) -> frozenset[int]:
        return frozenset(
            number
            for number, channel in self._channels.items()
            if channel.kind in kinds and world in (None, channel.world)
        )

    def _decoded(self, message: Message) -> RecordedMessage:
        channel = self._channels[message.channel_id]
        try:
            value = json.loads(message.data) if CHANNELS[channel.kind] else unpack(message.data)
        except (ValueError, UsageError) as error:
            raise UsageError(f"{self.path}: at {message.log_time / NANO:.2f} s: {error}") from error
        return RecordedMessage(message.log_time / NANO, channel, value)


def _records_of(chunk: Chunk) -> list[Any]:
    """Return the records of a chunk.

    Raises:
        ValueError: It is larger than the writer's chunks.
    """
    if chunk.uncompressed_size > MOST_BYTES:
        raise ValueError(f"a part of {chunk.uncompressed_size} bytes; at most {MOST_BYTES}")
    return breakup_chunk(chunk, validate_crc=True)
