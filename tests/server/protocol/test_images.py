"""The image server's protocol without sockets: frames byte by byte, acknowledgements, the frame rate."""

import io
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from usarmjx.base.errors import UsageError
from usarmjx.server.protocol.images import (
    FIRST_FRAME_DELAY,
    FORMATS,
    ImageSession,
    encode_frame,
    format_number,
    parse_size,
)

PIXELS = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
PERIOD = 0.1


def test_a_raw_frame_byte_by_byte():
    """Manual 14.5.3: type, length of the data, width, height, then RGB from left to right, from the top."""
    head = b"\x00" + b"\x00\x00\x00\x16" + b"\x00\x03" + b"\x00\x02"  # 22 = 4 + 3 * 2 * 3
    assert encode_frame(0, PIXELS) == head + bytes(range(18))


def test_a_picture_without_a_pixel_row_end_in_a_word_is_not_padded():
    """Hook.dll padded rows to 4 bytes (manual 14.5.2); the image server's description has no such thing."""
    assert len(encode_frame(0, np.zeros((5, 1, 3), np.uint8))) == 5 + 4 + 15


def scene():
    """A smooth picture with an edge, as rooms have them (240, 320, 3)."""
    y, x = np.mgrid[0:240, 0:320]
    left = np.stack([60 + x / 4, 90 + y / 4, 120 + (x + y) / 8], -1)
    return np.where((x < 200)[..., None], left, (200, 180, 40)).astype(np.uint8)


# JPEG rounds the 64 frequencies of each 8 x 8 block to multiples of its table, which for the quality q has at
# most 99 * 50 / q (q below 50) or 99 * (2 - q / 50); the root mean square error of a uniform rounding is that
# divided by sqrt(12) if all frequencies are there. A room has few, so this bounds it with room to spare, but
# for "super", whose table is all ones: there rounding the colours themselves counts, under 1 each way.
BOUNDS = {1: 1.0, 2: 99 * 0.5 / 12**0.5, 3: 99 / 12**0.5, 4: 198 / 12**0.5, 5: 495 / 12**0.5}


@pytest.mark.parametrize("number", BOUNDS)
def test_a_jpeg_frame_decodes_to_nearly_the_picture(number):
    data = encode_frame(number, scene())
    kind, length = struct.unpack(">BI", data[:5])
    assert (kind, length) == (number, len(data) - 5)
    decoded = Image.open(io.BytesIO(data[5:]))
    assert decoded.format == "JPEG"
    error = np.asarray(decoded, float) - scene()
    assert np.sqrt((error**2).mean()) < BOUNDS[number]
    assert abs(error.mean()) < 2.0, "the mean colour is kept"


def test_better_qualities_are_larger_and_truer():
    frames = [encode_frame(number, scene()) for number in range(6)]
    errors = [
        np.abs(np.asarray(Image.open(io.BytesIO(data[5:])), float) - scene()).mean() for data in frames[1:]
    ]
    assert sorted(map(len, frames), reverse=True) == [len(data) for data in frames]
    assert sorted(errors) == errors


@pytest.mark.parametrize(("text", "number"), [*zip(FORMATS, range(6), strict=True), ("5", 5), ("Raw", 0)])
def test_formats_by_name_and_number(text, number):
    assert format_number(text) == number


@pytest.mark.parametrize("text", ["6", "png", "", "-1"])
def test_an_unknown_format_is_refused_by_name(text):
    with pytest.raises(UsageError, match=r"no picture format .*raw \(0\), super \(1\).*bad \(5\)"):
        format_number(text)


def test_sizes():
    assert parse_size("320x240") == (320, 240)
    assert parse_size("1X4096") == (1, 4096)
    for wrong in ("320", "0x240", "320x", "axb", "320x4097", "320x240x3", "-1x2"):
        with pytest.raises(UsageError, match="not of the form 320x240"):
            parse_size(wrong)


def session(began=0.0, size=(320, 240)):
    return ImageSession(size, PERIOD, began)


def test_the_first_picture_comes_unasked():
    """Manual 14.5.3, step 1."""
    here = session(5.0)
    assert not here.wants(5.0)
    assert here.wants(5.0 + FIRST_FRAME_DELAY)
    here.sent(5.0 + FIRST_FRAME_DELAY)
    assert not here.wants(1000.0), "step 2: it waits for the acknowledgement"


def test_who_asks_for_the_first_picture_gets_it_at_once_and_only_once():
    """usarimage2ros sends OK when it connects, and cannot read two pictures at a time."""
    here = session()
    here.receive_data(b"OK\r\n")
    assert here.wants(0.0)
    here.sent(0.0)
    assert not here.wants(1000.0)


def test_the_next_picture_waits_for_its_time():
    """Manual 14.5.3, step 3: times are triggered by the frame rate, whenever the OK comes."""
    here = session()
    here.receive_data(b"OK")
    here.sent(0.0)
    here.receive_data(b"OK")
    assert not here.wants(0.099)
    assert here.wants(0.1)
    here.sent(0.13)  # somewhat late: the next is due at 0.2 all the same
    here.receive_data(b"OK")
    assert not here.wants(0.199)
    assert here.wants(0.2)
    here.sent(0.57)  # very late: what was missed is not made up for
    here.receive_data(b"OK")
    assert not here.wants(0.599)
    assert here.wants(0.601)


def test_two_acknowledgements_are_one_picture():
    here = session()
    here.receive_data(b"OKOKOKOK")
    here.sent(0.0)
    assert not here.wants(1000.0)


@pytest.mark.parametrize("text", [b"OK", b"xxOKyy", b"\r\n\x00OK", b"OOK", b"OOOOOK", b"o OK"])
def test_an_acknowledgement_among_other_bytes(text):
    here = session()
    here.receive_data(b"OK")
    here.sent(0.0)
    for byte in text:
        here.receive_data(bytes([byte]))
    assert here.region == (0, 0, 320, 240)


@pytest.mark.parametrize("text", [b"", b"O", b"K", b"KO", b"O K", b"ok", b"\xff" * 1000])
def test_what_is_no_acknowledgement(text):
    here = session()
    here.receive_data(b"OK")
    here.sent(0.0)
    here.receive_data(text)
    assert here.region is None


@pytest.mark.parametrize(
    ("asked", "answered"),
    [
        ((10, 20, 30, 40), (10, 20, 30, 40)),
        ((300, 0, 100, 240), (300, 0, 20, 240)),
        ((0, 0, 2**32 - 1, 2**32 - 1), (0, 0, 320, 240)),
        ((320, 0, 10, 10), None),
        ((0, 0, 0, 10), None),
    ],
)
def test_a_part_of_the_picture(asked, answered):
    """The U request of the later versions' image server."""
    here = session()
    here.receive_data(b"OK")
    here.sent(0.0)
    data = b"U" + struct.pack(">4I", *asked)
    here.receive_data(data[:7])
    assert here.region is None
    here.receive_data(data[7:])
    assert here.region == answered


@given(st.lists(st.binary(max_size=40), max_size=20))
def test_whatever_comes_it_remembers_no_more_than_one_request(pieces):
    whole, cut = session(), session()
    whole.receive_data(b"".join(pieces))
    for piece in pieces:
        cut.receive_data(piece)
        assert len(cut._pending) < 17
    assert whole == cut, "the chunking does not matter"
