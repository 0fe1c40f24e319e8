"""The index of an MCAP file's chunks, read from the file at its end instead of kept in memory.

mcap's Writer keeps an entry for each chunk, with a number for each of its channels: 15 MB an hour at
two chunks a second. All of it also lies in the file.
"""

import os
from collections.abc import Iterator
from struct import Struct
from typing import IO, cast

from mcap.opcode import Opcode
from mcap.records import ChunkIndex
from mcap.writer import Writer

ENTRIES = "_Writer__chunk_indices"
"""Attribute of the writer: a list that it iterates at the end; private, so it may be missing."""
MAGIC = 8
"""Size of the magic number at the start of a file [bytes]."""
RECORD, TIMES, LENGTH, SIZE, CHANNEL = map(Struct, ("<BQ", "<QQQI", "<I", "<Q", "<H"))
"""Start of a record; of a chunk: times, size and CRC; length of a name; size of data; a channel."""


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
