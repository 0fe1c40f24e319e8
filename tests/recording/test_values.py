"""Values as bytes: all that recordings hold comes back, and nothing else is made of them."""

from dataclasses import replace
from pathlib import Path

import msgpack
import numpy as np
import pytest

from usarmjx.base.errors import UsageError
from usarmjx.models.arenas import ARENAS
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.shapes import Mesh
from usarmjx.recording.values import ARRAY, KIND, pack, unpack


@pytest.mark.parametrize("name", ROBOTS.names())
def test_robots_come_back(name):
    assert unpack(pack(ROBOTS.get(name))) == ROBOTS.get(name)


@pytest.mark.parametrize("name", ARENAS.names())
def test_arenas_come_back(name):
    arena = ARENAS.get(name)
    again = unpack(pack(arena))
    # Meshes and terrains are equal to none but themselves; their numbers are compared.
    for before, after in zip(arena.shapes, again.shapes, strict=True):
        for content in ("mesh", "heights"):
            solid = getattr(before, content)
            for field, values in vars(solid).items() if solid is not None else ():
                np.testing.assert_array_equal(getattr(getattr(after, content), field), values)
    bare = [tuple(replace(s, mesh=None, heights=None) for s in one.shapes) for one in (arena, again)]
    assert replace(again, shapes=()) == replace(arena, shapes=())
    assert bare[0] == bare[1]


@pytest.mark.parametrize("dtype", [np.float64, np.float32, np.int32, bool])
def test_arrays_keep_every_bit(dtype):
    values = np.array([[0.1, -0.0, 3.0], [-7.5, 1e-30, 0.0]]).astype(dtype)
    again = unpack(pack({"a": values}))["a"]
    assert (again.dtype, again.shape) == (np.dtype(dtype), (2, 3))
    assert again.tobytes() == values.tobytes()


def test_numbers_may_be_keys_and_texts_may_be_arrays():
    again = unpack(pack({3: ("a", None), 1: np.array(["glass", "sky"], object)}))
    assert again[3] == ("a", None)
    assert again[1].tolist() == ["glass", "sky"]


def test_what_is_not_ours_is_not_kept():
    with pytest.raises(UsageError, match="Path cannot be recorded"):
        pack({"a": Path("/")})


@pytest.mark.parametrize(
    "data",
    [
        msgpack.packb({KIND: "Popen", "args": ["true"]}),
        msgpack.packb({KIND: "Mesh", "vertices": 3, "more": 1})[:-3],
        msgpack.packb(msgpack.ExtType(ARRAY, msgpack.packb(((1,), "O", bytes(8))))),
        msgpack.packb(msgpack.ExtType(ARRAY, msgpack.packb(((5,), "<f8", bytes(8))))),
        msgpack.packb(msgpack.ExtType(7, b"")),
        b"\xc1",
        b"",
    ],
)
def test_strange_bytes_are_refused(data):
    with pytest.raises(UsageError):
        unpack(data)


def test_what_a_newer_version_adds_is_left_out():
    packed = msgpack.unpackb(pack(Mesh(np.zeros((4, 3)))))
    assert unpack(msgpack.packb({**packed, "roughness": 0.5})).vertices.shape == (4, 3)
