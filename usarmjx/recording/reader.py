"""Recordings, complete or truncated anywhere: messages, frames for the page, pictures and maps at a time."""

import logging
from bisect import bisect_right
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, Message, Metadata
from mcap.stream_reader import StreamReader, breakup_chunk

from usarmjx.base.errors import UsageError
from usarmjx.base.settings.json_file import parse_json
from usarmjx.base.tables import facts_line, facts_table
from usarmjx.models.compile.raster import floor_map
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.recording.file import CHANNEL_METADATA, CHANNELS, NANO, ChannelName
from usarmjx.recording.foxglove import WORLD, stamp
from usarmjx.recording.inputs import WorldSetup
from usarmjx.recording.values import unpack

log = logging.getLogger(__name__)

MOST_BYTES = 1 << 28
"""Largest chunk that is read [bytes]; the writer makes chunks of half a second."""
USUAL_GAP = 100_000_000
"""Longest time between two chunks without a loss [ns]."""
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

    Raises:
        UsageError: It cannot be read, or is no recording of ours.
    """

    def __repr__(self) -> str:
        """Return a short line: the file and how long it lasts."""
        return facts_line("Recording", self.facts)

    def _repr_html_(self) -> str:
        return facts_table("Recording", self.facts)

    @property
    def facts(self) -> dict[str, object]:
        """Facts of the recording by name, for display."""
        length = f"{self.end - self.start:.1f} s" + ("" if self.is_complete else ", its end is missing")
        return {"file": self.path, "length": length, **self.about}

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        try:
            self._stream: IO[bytes] = self.path.open("rb")
        except OSError as error:
            raise UsageError(f"{path}: cannot be read: {error.strerror}") from error
        self._channels: dict[int, ChannelName] = {}
        self.about: dict[str, str] = {}
        self._parts: list[_Part] = []
        self._skipped, self._unread = 0, set[int]()
        # The summary has channels and chunks at one place; without it the whole file must be read.
        self.is_complete = self._read_summary()
        if not self.is_complete:
            self._scan()
        if not self._channels or not self._parts:
            # The caller gets no object that it could close.
            self.close()
            raise UsageError(f"{path}: is no recording of usarmjx, or nothing is left of it")
        self.start = min(part.start for part in self._parts) / NANO
        self.end = max(part.end for part in self._parts) / NANO
        if self._skipped:
            log.warning("%s: %s", self.path, self._losses())
        # On the instance: on the method the cache would keep closed recordings alive.
        self._records = lru_cache(maxsize=CACHED_CHUNKS)(self._read_part)

    @property
    def damaged(self) -> int:
        """Number of chunks, of half a second or more, that are damaged and left out.

        Those of a complete file are found when they are read.
        """
        return self._skipped + len(self._unread)

    def _losses(self) -> str:
        """Return the time that damaged chunks have left empty, in a line."""
        spans = sorted((part.start, part.end) for part in self._parts)
        gaps = [later[0] - earlier[1] for earlier, later in pairwise(spans)]
        missing = sum(gap for gap in gaps if gap > USUAL_GAP) / NANO
        lost = f", {missing:.1f} s of the recording" if missing else ""  # none at beginning and end
        return f"{self._skipped} parts are damaged and left out{lost}"

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
            self._take_channel(channel.id, channel.metadata)
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
        """Read a file from its beginning, as far as it is intact."""
        self._stream.seek(0)
        # A summary may have been half read before it failed.
        self._parts, self._channels = [], {}
        offset, records = 8, self._records_from_here(is_start=True)
        while True:
            try:
                # The first record follows 8 magic bytes, which the reader consumes only with it.
                offset = max(self._stream.tell(), 8)
                record = next(records, None)
                if record is None:
                    return
                if isinstance(record, Metadata):
                    self._take_metadata(record)
                elif isinstance(record, Chunk):
                    inside = _records_of(record)
                    for one in inside:
                        if isinstance(one, Channel):
                            self._take_channel(one.id, one.metadata)
                    used = frozenset(one.channel_id for one in inside if isinstance(one, Message))
                    times = record.message_start_time, record.message_end_time
                    self._parts.append(_Part(*times, offset, used))
            except Exception:  # a damaged record, or a cut one, after which the rest of the file is missing
                if not self._skip_record(offset):
                    return
                self._skipped += 1
                # An iterator that has raised is exhausted: reading goes on with a new one.
                records = self._records_from_here(is_start=False)

    def _records_from_here(self, *, is_start: bool) -> Iterator[Any]:
        return StreamReader(
            self._stream, skip_magic=not is_start, emit_chunks=True, record_size_limit=MOST_BYTES
        ).records

    def _skip_record(self, offset: int) -> bool:
        """Go to the end of a record that does not read; return whether it is a chunk with an end."""
        self._stream.seek(offset)
        head = self._stream.read(9)
        if len(head) < 9 or head[0] != Opcode.CHUNK:
            return False
        end = offset + 9 + int.from_bytes(head[1:], "little")
        # A length beyond the end is itself damaged, or the file is cut here.
        if end > self.path.stat().st_size:
            return False
        self._stream.seek(end)
        return True

    def _take_metadata(self, metadata: Metadata) -> None:
        if metadata.name == "usarmjx":
            self.about |= metadata.metadata
        elif metadata.name == CHANNEL_METADATA and metadata.metadata.get("id", "").isdecimal():
            self._take_channel(int(metadata.metadata["id"]), metadata.metadata)

    def _take_channel(self, number: int, fields: Mapping[str, str]) -> None:
        # Channels of other programs may stand in the file, and are not read.
        if fields.get("kind") in CHANNELS and fields.get("world", "").isdecimal():
            name = ChannelName(int(fields["world"]), fields["kind"], fields.get("about", ""))
            self._channels[number] = name

    def _read_part(self, part: _Part) -> tuple[Message, ...]:
        try:
            self._stream.seek(part.offset + 9)  # behind the record's opcode (1 byte) and length (8 bytes)
            records = _records_of(Chunk.read(ReadDataStream(self._stream)))
        except Exception as error:  # as in `_scan`: a damaged part costs that part only
            # Said once: only some parts stay in the cache, so a damaged one may be read again.
            if part.offset not in self._unread:
                self._unread.add(part.offset)
                span = part.start / NANO, part.end / NANO
                log.warning("%s: %.2f to %.2f s are damaged and left out: %s", self.path, *span, error)
            return ()
        return tuple(record for record in records if isinstance(record, Message))

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
            UsageError: A message does not read.
        """
        first = 0 if since is None else round(since * NANO)
        wanted = self._wanted(kinds, world)
        for part in self._parts:
            # Chunks without a wanted channel are not even decompressed.
            if part.end >= first and not wanted.isdisjoint(part.channels):
                for message in self._records(part):
                    if message.log_time >= first and message.channel_id in wanted:
                        yield self._decoded(message)

    def last(self, kind: str, world: int, time: float) -> RecordedMessage | None:
        """Return the last message of a kind up to a time [s]; None without one."""
        wanted, latest = self._wanted([kind], world), round(time * NANO)
        # Chunks are written in order of time, so the last one that begins in time is found by bisection.
        end = bisect_right(self._parts, latest, key=lambda part: part.start)
        # Back to front: rare kinds of messages may be many chunks ago.
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
            raise UsageError(f"{self.path}: has no setup of world {world}")
        return found.value

    def _wanted(self, kinds: Collection[str], world: int | None) -> frozenset[int]:
        return frozenset(
            number
            for number, channel in self._channels.items()
            if channel.kind in kinds and world in (None, channel.world)
        )

    def _decoded(self, message: Message) -> RecordedMessage:
        channel = self._channels[message.channel_id]
        where = f"{self.path}: at {message.log_time / NANO:.2f} s"
        if CHANNELS[channel.kind]:
            value = parse_json(message.data, where, UsageError)
        else:
            try:
                value = unpack(message.data)
            except UsageError as error:
                raise UsageError(f"{where}: {error}") from error
        return RecordedMessage(message.log_time / NANO, channel, value)


def _records_of(chunk: Chunk) -> list[Any]:
    """Return the records of a chunk.

    Raises:
        ValueError: It is larger than the writer's chunks.
    """
    if chunk.uncompressed_size > MOST_BYTES:
        raise ValueError(f"a part of {chunk.uncompressed_size} bytes; at most {MOST_BYTES}")
    # Without the check a flipped bit in a compressed chunk could pass for data.
    return breakup_chunk(chunk, validate_crc=True)


UINT8 = 1
"""Foxglove's number of the type."""
OCCUPIED = 100
"""Value of an occupied square [percent]."""


@dataclass(frozen=True, eq=False)
class CameraShot:
    """A picture of a robot's camera.

    Attributes:
        time: Its time [s].
        world: Number of its world in the recording.
        robot: Name of the robot.
        camera: Name of the camera.
        pos: Position of the camera in the world [m] (3,).
        quat: Orientation of its optical frame, w first (4,): x to the right in the picture, y down, z ahead.
        fov: Horizontal field of view [rad].
        size: Width and height of the picture [pixels].
        jpeg: The picture as a JPEG.
    """

    time: float
    world: int
    robot: str
    camera: str
    pos: np.ndarray
    quat: np.ndarray
    fov: float
    size: tuple[int, int]
    jpeg: bytes

    @property
    def frame(self) -> str:
        """Name of its optical frame."""
        return f"{self.robot}/{self.camera}_optical"


def shot_messages(shot: CameraShot) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Yield kind of topic, Foxglove's schema and value of the messages of a picture."""
    now = stamp(shot.time)
    (x, y, z), (w, i, j, k) = shot.pos.tolist(), shot.quat.tolist()
    transform = {
        "timestamp": now,
        "parent_frame_id": WORLD,
        "child_frame_id": shot.frame,
        "translation": {"x": x, "y": y, "z": z},
        "rotation": {"x": i, "y": j, "z": k, "w": w},
    }
    yield "tf", "foxglove.FrameTransforms", {"transforms": [transform]}
    picture = {"timestamp": now, "frame_id": shot.frame, "data": shot.jpeg, "format": "jpeg"}
    yield f"camera/{shot.robot}_{shot.camera}", "foxglove.CompressedImage", picture


def recorded_arena(recording: Recording, world: int) -> ArenaSpec | None:
    """Return the arena of a recorded world; None if there are several, or the recording has it not."""
    try:
        arenas = recording.setup(world).arenas
    except UsageError:
        return None
    return arenas[0] if len(arenas) == 1 else None


def grid_message(arena: ArenaSpec, time: float) -> dict[str, Any]:
    """Return the map of an arena as `foxglove.Grid`: rows along x, from the lowest y on."""
    grid, filled = floor_map(arena)
    columns, _ = grid.shape
    x, y = grid.low
    return {
        "timestamp": stamp(time),
        "frame_id": WORLD,
        "pose": {
            "position": {"x": x, "y": y, "z": float(arena.floor)},
            "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
        },
        "column_count": columns,
        "cell_size": {"x": grid.cell, "y": grid.cell},
        "row_stride": columns,
        "cell_stride": 1,
        "fields": [{"name": "occupancy", "offset": 0, "type": UINT8}],
        "data": (filled.T.astype(np.uint8) * OCCUPIED).tobytes(),
    }
