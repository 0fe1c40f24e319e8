"""NumPy with the conventions of `jax.numpy` that our functions rely on: single precision throughout.

All other functions are NumPy's own. Only `backend` imports this module.
"""

from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

NumPyArray = np.ndarray[Any, np.dtype[Any]]
SINGLE: dict[Any, type[np.generic]] = {np.dtype(np.float64): np.float32, np.dtype(np.int64): np.int32}
"""Single-precision type of each double-precision one."""


def __getattr__(name: str) -> Any:  # noqa: ANN401 - whatever NumPy has
    """Return NumPy's function of that name and cache it in this module."""
    return globals().setdefault(name, getattr(np, name))


def single(values: ArrayLike, dtype: DTypeLike | None = None) -> NumPyArray:
    """Return an array in the precision that JAX would use: no double precision."""
    made: NumPyArray = np.asarray(values, dtype)
    return made.astype(SINGLE[made.dtype]) if dtype is None and made.dtype in SINGLE else made


def asarray(values: ArrayLike, dtype: DTypeLike | None = None) -> NumPyArray:
    """As `jnp.asarray`."""
    return single(values, dtype)


def array(values: ArrayLike, dtype: DTypeLike | None = None) -> NumPyArray:
    """As `jnp.array`."""
    made: NumPyArray = np.array(values, dtype)
    return single(made) if dtype is None else made


def zeros(shape: Any, dtype: DTypeLike = np.float32) -> NumPyArray:  # noqa: ANN401 - shapes
    """As `jnp.zeros`."""
    return np.zeros(shape, dtype)


def ones(shape: Any, dtype: DTypeLike = np.float32) -> NumPyArray:  # noqa: ANN401 - shapes
    """As `jnp.ones`."""
    return np.ones(shape, dtype)


def full(shape: Any, fill_value: ArrayLike, dtype: DTypeLike | None = None) -> NumPyArray:  # noqa: ANN401 - shapes
    """As `jnp.full`."""
    if dtype is None:
        # A Python float is single precision in JAX, whatever its value.
        dtype = np.float32 if isinstance(fill_value, float) else single(fill_value).dtype
    return np.full(shape, fill_value, dtype)


def eye(n: int, dtype: DTypeLike = np.float32) -> NumPyArray:
    """As `jnp.eye`."""
    return np.eye(n, dtype=dtype)


def arange(*bounds: Any, dtype: DTypeLike | None = None) -> NumPyArray:  # noqa: ANN401 - whole numbers
    """As `jnp.arange`."""
    return single(cast(NumPyArray, np.arange(*bounds)), dtype)


def where(condition: ArrayLike, yes: Any, no: Any) -> NumPyArray:  # noqa: ANN401 - numbers or arrays
    """As `jnp.where`."""
    made = cast(NumPyArray, np.where(condition, yes, no))
    # Served worlds call it thousands of times a second: the letter of a type is found sooner than its entry.
    return made.astype(SINGLE[made.dtype]) if made.dtype.char in "dlq" else made


def clip(values: ArrayLike, low: ArrayLike, high: ArrayLike) -> NumPyArray:
    """As `jnp.clip` with both bounds, in a third of the time of `np.clip`."""
    return np.minimum(np.maximum(values, low), high)


def broadcast_to(values: ArrayLike, shape: Any) -> NumPyArray:  # noqa: ANN401 - shapes
    """As `jnp.broadcast_to`, but a copy, in a quarter of the time of NumPy's view."""
    given = single(values)
    made = np.empty(shape, given.dtype)
    made[...] = given
    return made


def stack(arrays: Sequence[ArrayLike], axis: int = 0) -> NumPyArray:
    """As `jnp.stack`, in half the time of `np.stack` for a first or last axis."""
    if axis == 0:
        return np.array(arrays)
    if axis != -1:
        return np.stack(arrays, axis)
    first, dtype = np.asarray(arrays[0]), np.result_type(*arrays)
    made = np.empty((*first.shape, len(arrays)), dtype)
    for i, values in enumerate(arrays):
        made[..., i] = values
    return made


def cumsum(values: ArrayLike, axis: int | None = None) -> NumPyArray:
    """As `jnp.cumsum`."""
    return single(np.cumsum(values, axis))


def interp(x: Any, xs: Any, ys: Any, left: float | None = None, right: float | None = None) -> NumPyArray:  # noqa: ANN401
    """As `jnp.interp`."""
    return single(cast(NumPyArray, np.interp(x, xs, ys, left, right)))


def cross(a: ArrayLike, b: ArrayLike) -> NumPyArray:
    """As `jnp.cross` of vectors (..., 3), in a tenth of the time of `np.cross`."""
    x, y = np.asarray(a), np.asarray(b)
    ax, ay, az = x[..., 0], x[..., 1], x[..., 2]
    bx, by, bz = y[..., 0], y[..., 1], y[..., 2]
    return stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], -1)


def append(values: ArrayLike, more: ArrayLike) -> NumPyArray:
    """As `jnp.append` of flat arrays."""
    return np.concatenate([np.atleast_1d(single(values)), np.atleast_1d(single(more))])
