"""The index of a recording's chunks: the same as the library's, without entries in memory."""

from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from usarmjx.recording.file import ENTRIES, keep_index_in_file

CHUNKS, CHANNELS = 40, 7


def _write(path: Path, prepare: Callable[[Writer, object], None]) -> bytes:
    """Write a file of `CHUNKS` chunks, channels and metadata between them; return its content."""
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        prepare(writer, stream)
        writer.start(library="test")
        schema = writer.register_schema("one", "", b"")
        channels: list[int] = []
        for chunk in range(CHUNKS):
            if chunk < CHANNELS:
                channels.append(writer.register_channel(f"/{chunk}", "msgpack", schema))
                writer.add_metadata("channel", {"id": str(chunk)})
            for i, channel in enumerate(channels):
                writer.add_message(channel, 1000 * chunk + i, bytes([i] * chunk), 0)
            writer.flush()
        writer.flush()
        writer.finish()
    return path.read_bytes()


def test_the_index_is_the_librarys_to_the_byte_and_readers_find_all(tmp_path: Path) -> None:
    wanted = _write(tmp_path / "plain.mcap", lambda writer, stream: None)
    found = _write(tmp_path / "own.mcap", keep_index_in_file)
    assert found == wanted
    with (tmp_path / "own.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert len(summary.chunk_indexes) == CHUNKS
    assert len(summary.chunk_indexes[-1].message_index_offsets) == CHANNELS


def test_entries_are_counted_and_not_kept(tmp_path: Path) -> None:
    """An hour has 7,200 chunks, each with a number for each channel."""

    def prepare(writer: Writer, stream: object) -> None:
        keep_index_in_file(writer, stream)
        held.append(getattr(writer, ENTRIES))

    held: list[object] = []
    _write(tmp_path / "own.mcap", prepare)
    [entries] = held
    assert len(entries) == CHUNKS
    assert set(vars(entries)) == {"_stream", "_count"}


def test_another_writer_keeps_its_own_list(tmp_path: Path) -> None:
    class OtherWriter:
        """A version without that attribute."""

    other = OtherWriter()
    keep_index_in_file(other, None)
    assert not vars(other)


@pytest.mark.parametrize("chunks", [0, 1])
def test_small_files(tmp_path: Path, chunks: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.recording.test_chunk_index.CHUNKS", chunks)
    assert _write(tmp_path / "a.mcap", keep_index_in_file) == _write(tmp_path / "b.mcap", lambda *_: None)
