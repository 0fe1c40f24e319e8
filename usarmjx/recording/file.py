"""An MCAP file that a thread writes, so that a recorded world does not wait for the disk; its index.

Data for a replay is always written. Frames, which only show a world, are left out while the thread is
behind, and the shapes for Foxglove are written in pieces when nothing else waits. So a process that is killed
loses about a second.

The index of the chunks is read from the file at its end. mcap's Writer keeps an entry for each chunk, with a
number for each of its channels: 15 MB an hour at two chunks a second.
"""

import json
import logging
import os
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from struct import Struct
from threading import Event, Thread
from typing import IO, Any, NamedTuple, cast

from mcap.opcode import Opcode
from mcap.records import ChunkIndex
from mcap.writer import CompressionType, Writer

from usarmjx.base.errors import UsageError
from usarmjx.base.files import disk_error, writing
from usarmjx.recording.foxglove import SCHEMAS, schema_text
from usarmjx.recording.values import pack

ENTRIES = "_Writer__chunk_indices"
"""Attribute of the writer: a list that it iterates at the end; private, so it may be missing."""
MAGIC = 8
"""Size of the magic number at the start of a file [bytes]."""
RECORD, TIMES, LENGTH, SIZE, CHANNEL = map(Struct, ("<BQ", "<QQQI", "<I", "<Q", "<H"))
"""Start of a record; of a chunk: times, size and CRC; length of a name; size of data; a channel."""
log = logging.getLogger(__name__)
WAKE, FLUSH = 0.1, 0.5
"""Interval at which the thread looks for jobs, and interval between two flushes to the disk [s]."""
MOST_LAG = 0.3
"""Age from which a frame of a served world is left out [s]."""
LOG_INTERVAL = 10.0
"""Interval between two log lines about frames that were left out [s]."""
CHANNEL_METADATA = "usarmjx channel"
"""Name of metadata that repeats a channel's number and fields outside of the parts."""
MOST_WAITING = 50_000
"""Most waiting jobs; with more, `put` blocks."""
PATIENCE = 5.0
"""Time without progress after which the disk counts as gone [s]."""
NANO = 10**9


class FileChunkIndex:
    """Entries of a file's chunks, in place of the writer's list.

    Args:
        stream: The file, which the writer also writes to.
    """

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream, self._count = stream, 0

    def append(self, entry: ChunkIndex) -> None:
        """Count an entry; it is not kept."""
        self._count += 1

    def __len__(self) -> int:
        """Return the number of chunks."""
        return self._count

    def __iter__(self) -> Iterator[ChunkIndex]:
        """Yield the entries, each read when it is due.

        Raises:
            OSError: The file cannot be read.
        """
        # The file is read through another descriptor, which does not see the buffer.
        self._stream.flush()
        with open(self._stream.name, "rb") as file:
            yield from _entries(file, os.fstat(file.fileno()).st_size)


def keep_index_in_file(writer: Writer, stream: IO[bytes]) -> None:
    """Let a writer read its chunks' index from the file at the end, where its version has such a list."""
    if getattr(writer, ENTRIES, None) == []:
        setattr(writer, ENTRIES, FileChunkIndex(stream))


def _entries(file: IO[bytes], end: int) -> Iterator[ChunkIndex]:
    """Yield an entry for each chunk of a file whose records end there [bytes]."""
    entry: ChunkIndex | None = None
    at = file.seek(MAGIC)
    while at < end:
        opcode, length = cast(tuple[int, int], RECORD.unpack(file.read(RECORD.size)))
        following = at + RECORD.size + length
        # Message indices follow their chunk: the entry is complete at the first other record.
        if opcode == Opcode.MESSAGE_INDEX and entry is not None:
            entry.message_index_offsets[CHANNEL.unpack(file.read(CHANNEL.size))[0]] = at
            entry.message_index_length += RECORD.size + length
        elif entry is not None:
            yield entry
            entry = None
        if opcode == Opcode.CHUNK:
            entry = _chunk_entry(file, at, RECORD.size + length)
        at = file.seek(following)
    if entry is not None:
        yield entry


def _chunk_entry(file: IO[bytes], at: int, length: int) -> ChunkIndex:
    """Return the entry of a chunk, whose record begins at an offset, without its messages."""
    start, end, unpacked, _ = TIMES.unpack(file.read(TIMES.size))
    # MCAP's strings have their length in front.
    compression = file.read(LENGTH.unpack(file.read(LENGTH.size))[0]).decode()
    return ChunkIndex(
        chunk_length=length,
        chunk_start_offset=at,
        compression=compression,
        compressed_size=SIZE.unpack(file.read(SIZE.size))[0],
        message_end_time=end,
        message_index_length=0,
        message_index_offsets={},
        message_start_time=start,
        uncompressed_size=unpacked,
    )


class ChannelName(NamedTuple):
    """A channel of a file.

    Attributes:
        world: Number of its world.
        kind: Kind of its messages: a key of `CHANNELS`.
        about: Subject in the world, such as the name of a robot; empty: the whole world.
    """

    world: int
    kind: str
    about: str = ""


CHANNELS = {
    **dict.fromkeys(("setup", "inputs", "states", "drawings", "frames", "readings"), ""),
    "lines": "usarmjx.Lines",
    "events": "usarmjx.Event",
    "score": "usarmjx.Score",
    "tf": "foxglove.FrameTransforms",
    "scene": "foxglove.SceneUpdate",
    "scan": "foxglove.LaserScan",
    "trail": "foxglove.PosesInFrame",
    "log": "foxglove.Log",
}
"""Kinds of channels and their schemas; those without one hold bytes of `values.pack`."""


def topic_of(channel: ChannelName, *, several: bool) -> str:
    """Return the topic of a channel in a file of one world, or of several."""
    where = f"/world{channel.world}" if several else ""
    own = "" if CHANNELS[channel.kind].startswith("foxglove.") else "/usarmjx"
    # A slash in a robot's name would make another level of the topic.
    parts = "/".join(part.replace("/", "_") for part in (channel.kind, channel.about) if part)
    return f"{where}{own}/{parts}"


Job = Callable[["RecordingFile"], None]
"""A write operation, carried out in the file's thread."""


class _Waiting(NamedTuple):
    """A job that waits, since when [s], and whether it is a frame."""

    since: float
    job: Job
    is_frame: bool


class RecordingFile:
    """A recording being written.

    Args:
        path: The file, which must not exist yet.
        about: Metadata of the file, texts by name.
        several: Whether there are several worlds: then topics begin with a world's number.
        max_lag: Age from which frames are left out [s]; None: all are written.

    Raises:
        WriteError: It cannot be written.
        UsageError: It exists already.
    """

    def __init__(
        self,
        path: Path,
        about: dict[str, str] | None = None,
        *,
        several: bool = False,
        max_lag: float | None = None,
    ) -> None:
        self.path, self._several, self._max_lag = Path(path), several, max_lag
        with writing(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            try:
                # "x" fails if the file exists: a check beforehand would race with another process.
                self._stream = self.path.open("xb")
            except FileExistsError as error:
                raise UsageError(f"{path}: is there already; record to another file") from error
        self._writer = Writer(self._stream, compression=CompressionType.ZSTD)
        keep_index_in_file(self._writer, self._stream)
        self._channels: dict[ChannelName, int] = {}
        self._schemas: dict[str, int] = {}
        self._jobs: deque[_Waiting] = deque()
        self._pieces: dict[ChannelName, Iterator[None]] = {}
        # The first loss is logged at once, also right after the machine has started.
        self._told = -LOG_INTERVAL
        self._stop, self._flushed, self._written = Event(), time.monotonic(), 0
        self.ended = False
        """Whether writing has ended."""
        self.left_out = 0
        """Number of frames that were left out."""
        with writing(self.path):
            self._writer.start(library="usarmjx")
            self._writer.add_metadata("usarmjx", about or {})
            # At once, so that a process that is killed leaves a file with its metadata.
            self._writer.flush()
        # A daemon: a program that forgets to close the file can end all the same.
        self._thread = Thread(target=self._run, name="recording", daemon=True)
        self._thread.start()

    @property
    def lag(self) -> float:
        """Age of the oldest job that waits [s]."""
        try:
            return max(0.0, time.monotonic() - self._jobs[0].since)
        except IndexError:  # the thread has just taken it
            return 0.0

    def put(self, job: Job, *, is_frame: bool = False) -> None:
        """Queue a write operation, after all that were queued before.

        Args:
            job: The operation.
            is_frame: Leave it out if it has to wait for too long.
        """
        # Never an error: a world must not stop because its recording has.
        if self.ended:
            return
        self._jobs.append(_Waiting(time.monotonic(), job, is_frame))
        if len(self._jobs) > MOST_WAITING:
            self._wait()

    def _wait(self) -> None:
        """Wait for the thread, as long as it makes progress."""
        before, since = self._written, time.monotonic()
        while len(self._jobs) > MOST_WAITING and not self.ended:
            time.sleep(WAKE)
            if self._written != before:
                before, since = self._written, time.monotonic()
            elif time.monotonic() > since + PATIENCE:
                self._end("the disk does not answer")

    def close(self) -> None:
        """Write waiting jobs and the index; then the file is complete."""
        self._stop.set()
        self._thread.join()

    # The methods below run in the thread.

    def write_in_pieces(self, channel: ChannelName, pieces: Iterator[None]) -> None:
        """Run an operation piece by piece when nothing else waits, in place of the one before.

        For jobs only; all pieces are run before the file ends.
        """
        # A newer scene replaces the rest of an older one, which nobody needs any more.
        self._pieces[channel] = pieces

    def write(self, channel: ChannelName, at: float, value: Any) -> None:  # noqa: ANN401 - as the channel has
        """Add a message to a channel; for jobs only.

        Args:
            channel: The channel.
            at: Simulated time [s].
            value: The message: a value of `pack` or JSON, by the channel's schema; bytes are JSON already.
        """
        # The writer counts channels from 1: no number is 0.
        number = self._channels.get(channel) or self._register(channel)
        if isinstance(value, bytes):
            data = value
        else:
            data = json.dumps(value).encode() if CHANNELS[channel.kind] else pack(value)
        # MCAP's log time is the simulated time, its publish time that of the recording.
        self._writer.add_message(number, round(at * NANO), data, time.time_ns())

    def _register(self, channel: ChannelName) -> int:
        schema = CHANNELS[channel.kind]
        name = schema or f"usarmjx.{channel.kind}"
        if name not in self._schemas:
            encoding = "jsonschema" if schema in SCHEMAS else ""
            self._schemas[name] = self._writer.register_schema(name, encoding, schema_text(schema))
        topic = topic_of(channel, several=self._several)
        fields = {"world": str(channel.world), "kind": channel.kind, "about": channel.about}
        number = self._channels[channel] = self._writer.register_channel(
            topic, "json" if schema else "msgpack", self._schemas[name], fields
        )
        # A file without its end has a channel only in the part that uses it first, which may be damaged.
        self._writer.add_metadata(CHANNEL_METADATA, {"id": str(number), **fields})
        return number

    def _run(self) -> None:
        try:
            # Polled: waking the thread for each of thousands of jobs would cost the world's thread more.
            while not self._stop.wait(WAKE):
                self._drain()
            self._drain()
            while self._pieces and not self.ended:
                self._run_piece()
            if not self.ended:
                self._writer.finish()
        except Exception as error:  # a full or failed disk must not stop the world that is recorded
            reason = disk_error(error) or (error.strerror if isinstance(error, OSError) else None)
            self._end(str(reason or error))
        finally:
            self.ended = True
            # Jobs hold whole worlds, whose memory an ended recording must not keep.
            self._jobs.clear()
            try:
                self._stream.close()
            except OSError as error:
                log.debug("%s: %s", self.path, error)

    def _drain(self) -> None:
        while (self._jobs or self._pieces) and not self.ended:
            if self._jobs:
                since, job, is_frame = self._jobs.popleft()
                if is_frame and self._is_late(since):
                    self.left_out += 1
                else:
                    job(self)
                # Progress is counted for `_wait`, which tells a slow disk from one that is gone.
                self._written += 1
            elif self._stop.is_set():
                break
            else:
                self._run_piece()
            if time.monotonic() > self._flushed + FLUSH:
                self._flush()
        if time.monotonic() > self._flushed + FLUSH:
            self._flush()

    def _is_late(self, since: float) -> bool:
        """Return whether a frame that has waited since then [s] is left out."""
        # Once the file is being closed no world waits any more: all frames are written.
        return (
            self._max_lag is not None and time.monotonic() > since + self._max_lag and not self._stop.is_set()
        )

    def _run_piece(self) -> None:
        channel, pieces = next(iter(self._pieces.items()))
        try:
            next(pieces)
        except StopIteration:
            # The piece itself may have queued a newer operation for its channel.
            if self._pieces.get(channel) is pieces:
                del self._pieces[channel]

    def _flush(self) -> None:
        if self.left_out and time.monotonic() > self._told + LOG_INTERVAL:
            self._told = time.monotonic()
            log.warning(
                "%s: %d frames so far are left out: writing them takes too long", self.path, self.left_out
            )
        self._writer.flush()
        self._flushed = time.monotonic()

    def _end(self, reason: str) -> None:
        if not self.ended:
            self.ended = True
            log.error("the recording ends here: cannot write %s: %s", self.path, reason)
