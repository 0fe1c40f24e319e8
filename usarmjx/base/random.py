"""Random numbers by key, the same on JAX and on NumPy (see `backend`).

On JAX they are `jax.random`'s: Threefry-2x32 with 20 rounds (Salmon and others, "Parallel random numbers: as
easy as 1, 2, 3", SC 2011), in counter mode. On NumPy a key is its two words, and uniform numbers and keys are
the same to the bit; normal numbers within a few units in the last place, as their logarithm is another.
"""

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import on_numpy

PARITY = 0x1BD11BDA
ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))
MASK = 0xFFFFFFFF
SMALL = 4
"""Up to so many blocks are faster with Python's integers than with NumPy's arrays."""
# Giles, "Approximating the erfinv function" (GPU Computing Gems, 2011), single precision.
NEAR = (
    2.81022636e-08,
    3.43273939e-07,
    -3.5233877e-06,
    -4.39150654e-06,
    0.00021858087,
    -0.00125372503,
    -0.00417768164,
    0.246640727,
    1.50140941,
)
FAR = (
    -0.000200214257,
    0.000100950558,
    0.00134934322,
    -0.00367342844,
    0.00573950773,
    -0.0076224613,
    0.00943887047,
    1.00167406,
    2.83297682,
)


def key(seed: int) -> Any:  # noqa: ANN401 - a key of the library in force
    """Return the key of a seed."""
    if not on_numpy():
        return jax.random.key(seed)
    return np.array([(seed >> 32) & MASK, seed & MASK], np.uint32)


def fold_in(of: Any, data: Any) -> Any:  # noqa: ANN401 - keys and whole numbers of the library in force
    """Return a key made of a key and a whole number."""
    if not on_numpy():
        return jax.random.fold_in(of, data)
    return np.array(_block(int(of[0]), int(of[1]), 0, int(data) & MASK), np.uint32)


def split(of: Any, num: int = 2) -> Any:  # noqa: ANN401 - keys of the library in force
    """Return new keys (num,)."""
    if not on_numpy():
        return jax.random.split(of, num)
    return np.stack(_blocks(of, num), -1)


def uniform(of: Any, shape: Sequence[int] = (), minval: Any = 0.0, maxval: Any = 1.0) -> Any:  # noqa: ANN401
    """Return uniform numbers of a shape in [minval, maxval)."""
    if not on_numpy():
        return jax.random.uniform(of, tuple(shape), minval=minval, maxval=maxval)
    low, high = np.float32(minval), np.float32(maxval)
    first, second = _blocks(of, int(np.prod(shape)))
    share = ((first ^ second) >> np.uint32(9) | np.uint32(0x3F800000)).view(np.float32) - np.float32(1)
    return np.maximum(low, share * (high - low) + low).reshape(tuple(shape))


def normal(of: Any, shape: Sequence[int] = ()) -> Any:  # noqa: ANN401 - a key and an array of the library in force
    """Return numbers of a shape from the standard normal distribution."""
    if not on_numpy():
        return jax.random.normal(of, tuple(shape))
    low = np.nextafter(np.float32(-1), np.float32(0))
    return np.float32(np.sqrt(2)) * _erf_inv(uniform(of, shape, low, 1.0))


def _erf_inv(x: Array) -> np.ndarray:
    """Return the inverse error function of numbers in (-1, 1), single precision."""
    x = np.asarray(x)
    w = -np.log1p(-x * x)
    near = w < 5
    at = np.where(near, w - np.float32(2.5), np.sqrt(np.maximum(w, 0)) - np.float32(3))
    value = np.zeros_like(x)
    for low, high in zip(NEAR, FAR, strict=True):
        value = np.where(near, np.float32(low), np.float32(high)) + value * at
    return value * x


def _blocks(of: Any, count: int) -> tuple[np.ndarray, np.ndarray]:  # noqa: ANN401 - a key
    """Return both words of the first blocks of a key's sequence (count,) each."""
    k0, k1 = int(of[0]), int(of[1])
    if count <= SMALL:
        pairs = [_block(k0, k1, 0, i) for i in range(count)]
        return tuple(np.array([pair[i] for pair in pairs], np.uint32) for i in (0, 1))  # type: ignore - two
    keys = [np.uint32(k) for k in (k0, k1, k0 ^ k1 ^ PARITY)]
    x0 = np.full(count, keys[0])
    x1 = np.arange(count, dtype=np.uint32) + keys[1]
    with np.errstate(over="ignore"):
        for turn in range(5):
            for distance in ROTATIONS[turn % 2]:
                x0 += x1
                x1 = (x1 << np.uint32(distance)) | (x1 >> np.uint32(32 - distance))
                x1 ^= x0
            x0 += keys[(turn + 1) % 3]
            x1 += keys[(turn + 2) % 3] + np.uint32(turn + 1)
    return x0, x1


def _block(k0: int, k1: int, x0: int, x1: int) -> tuple[int, int]:
    """Return Threefry-2x32 of one block."""
    keys = (k0, k1, k0 ^ k1 ^ PARITY)
    x0, x1 = (x0 + k0) & MASK, (x1 + k1) & MASK
    for turn in range(5):
        for distance in ROTATIONS[turn % 2]:
            x0 = (x0 + x1) & MASK
            x1 = ((x1 << distance) | (x1 >> (32 - distance))) & MASK ^ x0
        x0 = (x0 + keys[(turn + 1) % 3]) & MASK
        x1 = (x1 + keys[(turn + 2) % 3] + turn + 1) & MASK
    return x0, x1
