"""Digests of values by all that is in them: equal digests mean equal values, in another process too."""

import hashlib
import struct
import sys
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cached_property, partial
from types import BuiltinFunctionType, EllipsisType, FunctionType, MappingProxyType, MethodType
from typing import Any, cast

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

MUJOCO = cast("Any", mujoco)  # whose stubs lack what follows
OURS = "usarmjx"
KNOWN_PACKAGES = frozenset({OURS, "jax", "jaxlib", "mujoco", "numpy", "flax", *sys.stdlib_module_names})
"""Whose classes and functions are as their name and the version say; ours, as the sources of the package."""
PLAIN = (bool, int, float, complex, str, bytes, type(None), EllipsisType, np.dtype)


class FingerprintError(TypeError):
    """A value holds something that has no digest: a function or class of someone else's, for instance."""


def fingerprint(*values: object) -> str:
    """Return a digest of values: of their types and of all that they hold, to the last bit.

    Args:
        values: Numbers, texts, arrays, models of MuJoCo, functions and classes of `KNOWN_PACKAGES`, and
            collections, dataclasses and other objects of these. Cached properties are left out, as what
            they are made from is in it.

    Raises:
        FingerprintError: They hold something else.
    """
    return _Digests().of(values).hex()


def name_of(thing: object) -> str:
    """Return the full name of a class or function of `KNOWN_PACKAGES`.

    Raises:
        FingerprintError: It is someone else's, or has no name by which it could be found.
    """
    module, name = str(getattr(thing, "__module__", "")), str(getattr(thing, "__qualname__", ""))
    if module.partition(".")[0] not in KNOWN_PACKAGES or not name or "<" in name:
        raise FingerprintError(f"{module}.{name} is not known by its name")
    return f"{module}.{name}"


class _Digests:
    """Digests of objects, each worked out once."""

    def __init__(self) -> None:
        self._known: dict[int, tuple[bytes, object]] = {}  # the objects, too: else their numbers are reused

    def of(self, value: object) -> bytes:
        """Return the digest of a value."""
        known = self._known.get(id(value))
        if known is None:
            known = self._digest(value), value
            self._known[id(value)] = known
        return known[0]

    def _digest(self, value: object) -> bytes:
        found = hashlib.blake2b(name_of(type(value)).encode() + b"\0", digest_size=20)
        parts = _leaf_parts(value)
        for part in self._inner_parts(value) if parts is None else parts:
            found.update(struct.pack("<q", len(part)))
            found.update(part)
        return found.digest()

    def _inner_parts(self, value: Any) -> list[bytes]:  # noqa: ANN401 - anything
        """Return the digests of what tells a value from others of its type."""
        match value:
            case list() | tuple():
                return self._all(cast("Iterable[object]", value))
            case set() | frozenset():
                return sorted(self._all(cast("Iterable[object]", value)))
            case dict() | MappingProxyType():
                pairs = cast("Mapping[object, object]", value).items()
                return self._all(one for pair in pairs for one in pair)
            case partial():
                whole = cast("partial[Any]", value)
                return self._all((whole.func, whole.args, whole.keywords))
            case MethodType():
                return self._all((value.__func__, value.__self__))
            case _ if is_dataclass(value):
                return self._named({one.name: getattr(value, one.name) for one in fields(value)})
            case _:
                return self._named(_attributes(value))

    def _all(self, values: Iterable[object]) -> list[bytes]:
        return [self.of(one) for one in values]

    def _named(self, values: Mapping[str, object]) -> list[bytes]:
        return [part for name, inner in values.items() for part in (name.encode(), self.of(inner))]


def _attributes(value: object) -> dict[str, object]:
    """Return the attributes of an object of ours, but for cached properties."""
    # What is written in another language may hold more than it shows.
    if type(value).__module__.partition(".")[0] != OURS:
        raise FingerprintError(f"nothing tells one {type(value).__name__} from another")
    return {
        name: inner
        for name, inner in vars(value).items()
        if not isinstance(getattr(type(value), name, None), cached_property)
    }


def _leaf_parts(value: object) -> list[bytes] | None:
    """Return what tells a value from others of its type; None: it is made of other objects."""
    if isinstance(value, Enum):
        return [value.name.encode()]
    if isinstance(value, np.ndarray | np.generic):
        return _array_parts(np.asarray(cast("Any", value)))
    if isinstance(value, PLAIN):
        return [repr(cast("object", value)).encode()]
    if isinstance(value, jax.Array):
        is_key = jnp.issubdtype(value.dtype, jax.dtypes.prng_key)
        held = jax.random.key_data(value) if is_key else value
        return [f"{value.dtype} {jax.typeof(held).weak_type}".encode(), *_array_parts(np.asarray(held))]
    if isinstance(value, mujoco.MjModel):
        data = np.zeros(MUJOCO.mj_sizeModel(value), np.uint8)
        MUJOCO.mj_saveModel(value, None, data)
        return [data.tobytes()]
    if isinstance(value, type | FunctionType | BuiltinFunctionType):
        return [name_of(value).encode()]
    return None


def _array_parts(value: np.ndarray) -> list[bytes]:
    if value.dtype.hasobject:
        raise FingerprintError("an array of objects has no digest")
    return [repr((value.dtype.descr, value.shape)).encode(), np.ascontiguousarray(value).tobytes()]
