"""QR codes in pictures, read by a reader of ISO/IEC 18004 (version 1) that shares no line with the shader."""

import math

import numpy as np
import pytest

from tests.viewpoints import viewpoint_at
from usarmjx.models.arenas.league_hall import wall_sign
from usarmjx.models.types.arena import ArenaSpec, StartPose
from usarmjx.models.types.shapes import SIGNS
from usarmjx.sensors.cameras.shading import QR_CELLS
from usarmjx.server.worlds.dynamic_world import DynamicWorld

SIDE, CODEWORDS, CHECKS = 21, 26, 17  # of version 1 with error correction H
LETTERS = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZ $%*+-./:"
MASKS = (
    lambda i, j: (i + j) % 2,
    lambda i, j: i % 2,
    lambda i, j: j % 3,
    lambda i, j: (i + j) % 3,
    lambda i, j: (i // 2 + j // 3) % 2,
    lambda i, j: i * j % 2 + i * j % 3,
    lambda i, j: (i * j % 2 + i * j % 3) % 2,
    lambda i, j: ((i + j) % 2 + i * j % 3) % 2,
)


def bits_of(values):
    return int("".join(str(int(value)) for value in values), 2)


def data_cells():
    """Where bits of codewords are: in pairs of columns from the right, up and down in turn."""
    right, upward = SIDE - 1, True
    while right > 0:
        right -= right == 6  # the vertical timing pattern
        for step in range(SIDE):
            i = SIDE - 1 - step if upward else step
            for j in (right, right - 1):
                corner = (i < 9 and (j < 9 or j >= SIDE - 8)) or (i >= SIDE - 8 and j < 9)
                if not corner and i != 6:
                    yield i, j
        right, upward = right - 2, not upward


def syndromes(codewords):
    """Of a Reed-Solomon code over GF(256) by x^8 + x^4 + x^3 + x^2 + 1: all zero where nothing is wrong."""
    power, log = [1], {}
    for _ in range(254):
        power.append((power[-1] << 1) ^ (0x11D if power[-1] & 0x80 else 0))
    log = {value: k for k, value in enumerate(power)}
    found = []
    for root in range(CHECKS):
        value = 0
        for word in codewords:
            value = (power[(log[value] + root) % 255] if value else 0) ^ word
        found.append(value)
    return found


def text_of(dark):
    """The text of a code's cells, dark as True (21, 21)."""
    finder = np.ones((7, 7), bool)
    finder[1:6, 1:6], finder[2:5, 2:5] = False, True
    for i, j in ((0, 0), (0, SIDE - 7), (SIDE - 7, 0)):
        np.testing.assert_array_equal(dark[i : i + 7, j : j + 7], finder)
    np.testing.assert_array_equal(dark[6, 8:13], [True, False, True, False, True])
    np.testing.assert_array_equal(dark[8:13, 6], [True, False, True, False, True])
    form = bits_of([*dark[8, :6], *dark[8, 7:9], dark[7, 8], *dark[5::-1, 8]]) ^ 0b101010000010010
    assert form >> 13 == 0b10, "error correction H"
    mask = MASKS[form >> 10 & 7]
    bits = [dark[i, j] ^ (mask(i, j) == 0) for i, j in data_cells()]
    codewords = [bits_of(bits[8 * k : 8 * k + 8]) for k in range(CODEWORDS)]
    assert syndromes(codewords) == [0] * CHECKS
    assert bits_of(bits[:4]) == 0b0010, "letters"
    count, text = bits_of(bits[4:13]), ""
    for k in range(count // 2):
        pair = bits_of(bits[13 + 11 * k : 24 + 11 * k])
        text += LETTERS[pair // 45] + LETTERS[pair % 45]
    last = 13 + 11 * (count // 2)
    return text + (LETTERS[bits_of(bits[last : last + 6])] if count % 2 else "")


@pytest.mark.oracle
def test_every_code_says_its_number():
    assert [text_of(cells) for cells in QR_CELLS] == [f"USARMJX {n}" for n in range(SIGNS["qr"] + 1)]


@pytest.mark.oracle
def test_a_picture_from_a_metre_away_has_a_code_that_reads():
    arena = ArenaSpec(
        name="hall",
        shapes=(wall_sign((-1.0, 0.0), 0.0, "qr:7", z=1.0),),
        starts=(StartPose(tag="A", at=(0.0, -3.0, 0.188)),),
        extent=((-4.0, 4.0), (-4.0, 4.0)),
    )
    world, size = DynamicWorld(arena), 200
    view = viewpoint_at(np.array([0.0, 0.0, 1.0]), math.pi, 0.0).replace(fov=np.float32(0.5))
    picture = world._single.sight().render(world._single.render_scene(), view, size, size)
    focal, cells = size / 2 / math.tan(0.25), 0.15 * (2 * (np.arange(SIDE) + 4.5) / (SIDE + 8) - 1)
    places = (size / 2 + focal * cells / 0.995 - 0.5).round().astype(int)
    seen = np.asarray(picture.rgb)[np.ix_(places, places)].mean(-1)
    assert text_of(seen < 100) == "USARMJX 7"
