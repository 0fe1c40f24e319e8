"""Values of the package as MessagePack, and back: arrays, and dataclasses of a known list.

Reading creates nothing but these, whatever the file contains: no name of a module or function is looked up.
"""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from importlib import import_module
from typing import Any, cast

import msgpack
import numpy as np

from usarmjx.base.errors import UsageError

MODULES = (
    *("comms.attenuation", "comms.links", "comms.mail"),
    *("models.compile.physics", "models.compile.randomization"),
    *("models.drives.base", "models.drives.fluid"),
    *("models.drives.ground", "models.types.arena", "models.types.robot", "models.types.shapes"),
    *("recording.inputs", "sensors.sketch", "sim.control", "sim.scene", "view.drawing"),
)
"""Modules with the dataclasses that files may contain."""
KIND, WORDS = "$kind", "$words"
"""Keys that mark dataclasses, and arrays of texts."""
ARRAY = 1
"""MessagePack's extension code of an array: its shape, its dtype and its bytes."""
NUMBERS = "biuf"
"""Kinds of dtypes of arrays."""


@cache
def _kinds() -> dict[str, type[Any]]:
    """Return the dataclasses that files may contain, by name."""
    modules = [import_module(f"usarmjx.{name}") for name in MODULES]
    return {
        kind.__name__: kind
        for module in modules
        for kind in vars(module).values()
        # By module: names that a module only imports are listed under their own.
        if isinstance(kind, type) and is_dataclass(kind) and kind.__module__ == module.__name__
    }


@cache
def _names(kind: type[Any]) -> tuple[str, ...]:
    return tuple(field.name for field in fields(kind))


def pack(value: Any) -> bytes:  # noqa: ANN401 - any of the values
    """Return a value as bytes.

    Raises:
        UsageError: A part of it cannot be recorded; names its type.
    """
    # Strict: subclasses of dict, list or int go through `_plain`, which knows the values of usarmjx.
    packed = msgpack.packb(value, default=_plain, strict_types=True)
    assert packed is not None  # only a Packer that collects returns nothing
    return packed


def _plain(value: Any) -> Any:  # noqa: ANN401
    """Convert a value that MessagePack does not support to one that it supports."""
    if isinstance(value, tuple):
        return [*cast(tuple[object, ...], value)]
    if isinstance(value, np.ndarray):
        array = cast(np.ndarray[Any, Any], value)
        # The bytes of an object array are addresses, which mean nothing in a file.
        if array.dtype == object:
            return {WORDS: [str(item) for item in array.tolist()]}
        if array.dtype.kind in NUMBERS:
            # The text of the dtype has the byte order: any machine reads the same numbers.
            return msgpack.ExtType(ARRAY, pack((array.shape, array.dtype.str, array.tobytes())))
    if isinstance(value, np.generic):
        return cast("np.generic[Any]", value).item()
    if isinstance(value, str | int):  # a class of texts, an enumeration
        return str(value) if isinstance(value, str) else int(value)
    if isinstance(value, Mapping):
        return dict(cast(Mapping[str, object], value))
    record = cast(object, value)
    kind = type(record)
    if _kinds().get(kind.__name__) is not kind:
        raise UsageError(f"a {kind.__name__} cannot be recorded, as only usarmjx's own values can")
    # Not `asdict`, which would turn inner dataclasses into mappings without their kinds.
    return {KIND: kind.__name__, **{name: getattr(record, name) for name in _names(kind)}}


def unpack(data: bytes) -> Any:  # noqa: ANN401 - any of the values
    """Return the value in bytes that `pack` made; lists are tuples, and arrays cannot be written to.

    Raises:
        UsageError: The bytes are something else.
    """
    try:
        # Slots are numbers, and MessagePack allows only texts as keys unless it is asked.
        return msgpack.unpackb(
            data, object_hook=_value, ext_hook=_array, use_list=False, strict_map_key=False
        )
    # `_value` and `_array` name their fault already: the clause below would hide it in another text.
    except UsageError:
        raise
    except Exception as error:  # MessagePack, NumPy and constructors raise any error on broken bytes
        raise UsageError(f"a message that does not read: {error}") from error


def _array(code: int, data: bytes) -> np.ndarray:
    if code != ARRAY:
        raise UsageError(f"a value of the unknown kind {code}")
    shape, dtype, content = msgpack.unpackb(data)
    # The dtype is a text of the file: an object array would be made of addresses.
    if np.dtype(dtype).kind not in NUMBERS:
        raise UsageError(f"an array of {dtype}")
    # A view of the bytes, without a copy, and therefore read-only.
    return np.frombuffer(content, dtype).reshape(shape)


def _value(plain: dict[str, Any]) -> Any:  # noqa: ANN401
    if WORDS in plain:
        return np.array(plain[WORDS], object)
    if KIND not in plain:
        return plain
    kind = _kinds().get(plain[KIND])
    if kind is None:
        raise UsageError(f"a {plain[KIND]!r}, which this version of usarmjx does not know")
    # Fields that a later version has dropped are ignored, new ones keep their defaults.
    return kind(**{name: plain[name] for name in _names(kind) if name in plain})
