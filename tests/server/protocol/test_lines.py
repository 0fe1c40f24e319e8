"""Bytes in any chunking -> lines."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from usarmjx.server.protocol.grammar import DEFAULT_LIMIT, LineBuffer


def feed_all(buffer, chunks):
    return [line for chunk in chunks for line in buffer.feed(chunk)]


@st.composite
def chunked(draw, data):
    """Return some bytes and a way to cut them."""
    content = draw(data)
    cuts = sorted(draw(st.lists(st.integers(0, len(content)), max_size=12)))
    edges = [0, *cuts, len(content)]
    return content, [content[a:b] for a, b in pairwise(edges)]


@pytest.mark.parametrize("end", [b"\r\n", b"\n\r", b"\n", b"\r", b"\r\n\r\n", b"\n \n\t\r"])
@pytest.mark.parametrize("whole", [True, False])
def test_every_line_end_in_use(end, whole):
    data = b"A {x 1}" + end + b"B" + end
    chunks = [data] if whole else [data[i : i + 1] for i in range(len(data))]
    assert feed_all(LineBuffer(), chunks) == ["A {x 1}", "B"]


def test_an_unfinished_line_waits():
    buffer = LineBuffer()
    assert buffer.feed(b"DRIVE {Left 1") == []
    assert buffer.feed(b".5}") == []
    assert buffer.feed(b"\n") == ["DRIVE {Left 1.5}"]


def test_end_gives_the_last_line_without_its_end():
    buffer = LineBuffer()
    assert buffer.feed(b"A\r\nGETSTARTPOSES") == ["A"]
    assert buffer.end() == ["GETSTARTPOSES"]
    assert buffer.end() == []


def test_every_byte_is_a_character():
    junk = bytes(byte for byte in range(256) if byte not in b"\r\n")
    assert LineBuffer().feed(junk + b"\n") == [junk.decode("latin-1")]


def test_a_line_at_the_limit_passes_and_one_byte_more_does_not():
    buffer = LineBuffer(limit=5)
    assert buffer.feed(b"12345\n123456\n1234\n") == ["12345", "1234"]
    assert buffer.take_too_long() == 1
    assert buffer.take_too_long() == 0


def test_an_endless_line_is_reported_at_once_and_holds_no_memory():
    buffer = LineBuffer()
    for _ in range(100):
        assert buffer.feed(b"x" * 1000) == []
    assert buffer.take_too_long() == 1
    assert len(buffer._pending) == 0
    assert buffer.feed(b"xxx\r\nGETSTARTPOSES\r\n") == ["GETSTARTPOSES"]
    assert buffer.take_too_long() == 0


def test_what_follows_an_unfinished_long_line_at_the_end_is_nothing():
    buffer = LineBuffer(limit=3)
    buffer.feed(b"1234")
    assert buffer.end() == []
    assert buffer.feed(b"12\n") == ["12"]


def test_the_default_limit_is_twice_the_largest_buffer_of_a_known_client():
    assert DEFAULT_LIMIT == 2 * 4096


@given(chunked(st.binary(max_size=60)))
def test_chunking_does_not_matter_for_any_bytes(case):
    content, chunks = case
    whole, parts = LineBuffer(limit=7), LineBuffer(limit=7)
    assert feed_all(parts, chunks) == whole.feed(content)
    assert parts.take_too_long() == whole.take_too_long()
    assert parts.end() == whole.end()


@given(chunked(st.text("ab \r\n", max_size=60).map(str.encode)))
def test_lines_are_those_of_a_plain_split(case):
    content, chunks = case
    texts = content.decode().replace("\r", "\n").split("\n")
    long = [text for text in texts if len(text) > 7]
    buffer = LineBuffer(limit=7)
    lines = feed_all(buffer, chunks) + buffer.end()
    assert lines == [text for text in texts if text.strip() and len(text) <= 7]
    assert buffer.take_too_long() == len(long)


def test_a_byte_order_mark_before_the_first_line_is_skipped():
    mark = "\ufeff".encode()
    chunks = [mark[:1], mark[1:] + b"INIT {ClassName P2AT}", b"\r\n" + mark + b"DRIVE\n"]
    assert feed_all(LineBuffer(), chunks) == ["INIT {ClassName P2AT}", mark.decode("latin-1") + "DRIVE"]
