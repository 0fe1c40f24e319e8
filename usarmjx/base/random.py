"""Random numbers by key, identical on JAX and on NumPy (see `backend`).

On JAX they are `jax.random`'s: Threefry-2x32 with 20 rounds (Salmon et al., "Parallel random numbers: as easy
as 1, 2, 3", SC 2011) in counter mode. On NumPy a key is its two words; uniform numbers and keys agree to the
bit, normal numbers within a few units in the last place because the logarithm differs.

`RandomStream` draws what generated arenas are made of, the same with every version of NumPy.
"""

import math
import operator
from collections.abc import Sequence
from functools import cache, partial
from typing import Any, SupportsIndex, TypeVar
from zlib import crc32

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.backend import Array, Key, on_numpy
from usarmjx.base.errors import UsageError

T = TypeVar("T")
THREEFRY_PARITY = 0x1BD11BDA
"""Key schedule constant of Threefry-2x32."""
ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))
"""Rotation distances of Threefry-2x32, alternating by round group [bits]."""
MASK = 0xFFFFFFFF
"""Mask of a 32-bit word."""
LANE_BITS = 64
"""Width of a lane [bits]: 32-bit numbers packed into one Python integer, with room for carries."""
MAX_LANES = 256
"""Largest number of blocks for which packed lanes are faster than NumPy arrays."""
# Coefficients of Giles, "Approximating the erfinv function" (GPU Computing Gems, 2011), single precision.
ERFINV_CENTRAL = (
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
ERFINV_TAIL = (
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
SQRT_2 = np.float32(math.sqrt(2))
INFINITY = np.float32(math.inf)


def checked_seed(seed: SupportsIndex) -> int:
    """Return a seed as an integer.

    Raises:
        UsageError: It is no whole number from 0 to 2^64 - 1: a key has no place for more.
    """
    try:
        number = operator.index(seed)
    except TypeError:
        number = -1
    if not 0 <= number < 2**64:
        raise UsageError(f"seed {seed!r}, expected a whole number from 0 to 2^64 - 1")
    return number


def key(seed: SupportsIndex | jax.Array) -> Any:  # noqa: ANN401 - a key of the library in force
    """Return the key of a seed; different seeds have different keys.

    Args:
        seed: From 0 to 2^64 - 1; an array, which may be traced, of 32 bits; or a key, which is returned.

    Raises:
        UsageError: Another number.
    """
    if isinstance(seed, jax.Array) and not on_numpy():
        return seed if jnp.issubdtype(seed.dtype, jax.dtypes.prng_key) else jax.random.key(seed)
    number = checked_seed(seed)
    words = np.array([number >> 32, number & MASK], np.uint32)
    if on_numpy():
        return words
    # `jax.random.key` would cut the seed to its lower word.
    wrap: Any = jax.random.wrap_key_data  # which JAX leaves half typed
    return wrap(words, impl="threefry2x32") if number >> 32 else jax.random.key(number)


def fold_in(of: Any, data: Any) -> Any:  # noqa: ANN401 - keys and whole numbers of the library in force
    """Return a key made of a key and an integer; of keys (...,) and integers (n,), keys (..., n)."""
    many = np.ndim(data) > 0
    if not on_numpy():
        if of.ndim:
            return jax.vmap(partial(fold_in, data=data))(of)
        # The same numbers as on NumPy, which is what served worlds and batches have in common.
        return jax.vmap(partial(jax.random.fold_in, of))(data) if many else jax.random.fold_in(of, data)
    # The usual case, without arrays: a dozen of them would cost more than the hash.
    if not many and of.ndim == 1:
        return np.array(_threefry(int(of[0]), int(of[1]), int(data) & MASK), np.uint32)
    numbers = np.asarray(data)
    lanes = _packed(np.tile(numbers, math.prod(of.shape[:-1])))
    return _new_keys(of, lanes, numbers.size).reshape(*of.shape[:-1], *numbers.shape, 2)


def split(of: Any, num: int = 2) -> Any:  # noqa: ANN401 - keys of the library in force
    """Return new keys (num,); on NumPy of keys (...,) new keys (num, ...)."""
    if not on_numpy():
        return jax.random.split(of, num)
    _, numbers = _counting(num, math.prod(of.shape[:-1]))
    return np.moveaxis(_new_keys(of, numbers, num).reshape(*of.shape[:-1], num, 2), -2, 0)


def axes(of: Any) -> int:  # noqa: ANN401 - keys of the library in force
    """Return the number of axes of keys; a single key has none."""
    return of.ndim - 1 if on_numpy() else of.ndim


def uniform(of: Any, shape: Sequence[int] = (), minval: Any = 0.0, maxval: Any = 1.0) -> Any:  # noqa: ANN401
    """Return uniform numbers of a shape in [minval, maxval).

    Args:
        of: A key; or keys (n,), one for each row of the shape (n, ...); on NumPy they may have more axes.
        shape: The shape.
        minval: A bound, or bounds that broadcast to the shape.
        maxval: The same.
    """
    shape = tuple(shape)
    if on_numpy():
        low, high = np.asarray(minval, np.float32), np.asarray(maxval, np.float32)
        bits = _random_bits(of, math.prod(shape[of.ndim - 1 :])).reshape(shape)
        # 23 random mantissa bits with the exponent of [1, 2), minus 1: the construction of
        # `jax.random.uniform`.
        share = ((bits >> np.uint32(9)) | np.uint32(0x3F800000)).view(np.float32) - np.float32(1)
        # As `jax.random.uniform`: rounding of the product may fall below the lower bound.
        return np.maximum(low, share * (high - low) + low)
    if not of.ndim:
        return jax.random.uniform(of, shape, minval=minval, maxval=maxval)

    def of_row(of: Key, low: Array, high: Array) -> Array:
        return jax.random.uniform(of, shape[1:], minval=low, maxval=high)

    return jax.vmap(of_row)(of, jnp.broadcast_to(minval, shape), jnp.broadcast_to(maxval, shape))


def normal(of: Any, shape: Sequence[int] = ()) -> Any:  # noqa: ANN401 - keys and an array of the library in force
    """Return numbers of a shape from the standard normal distribution; keys as of `uniform`."""
    if on_numpy():
        # As `jax.random.normal`: -1 itself would be minus infinity.
        low = np.nextafter(np.float32(-1), np.float32(0))
        return SQRT_2 * _erf_inv(uniform(of, shape, low, 1.0))
    if not of.ndim:
        return jax.random.normal(of, tuple(shape))
    return jax.vmap(partial(jax.random.normal, shape=tuple(shape[1:])))(of)


def truncated_normal(of: Any, low: float, high: float, shape: Sequence[int] = ()) -> Any:  # noqa: ANN401
    """Return samples of a shape from the normal distribution truncated to [low, high]; one key."""
    if not on_numpy():
        return jax.random.truncated_normal(of, low, high, tuple(shape))
    drawn = uniform(of, shape, math.erf(low / math.sqrt(2)), math.erf(high / math.sqrt(2)))
    # The bounds themselves are left out, as in JAX.
    first, last = np.nextafter(np.float32(low), INFINITY), np.nextafter(np.float32(high), -INFINITY)
    return np.minimum(np.maximum(SQRT_2 * _erf_inv(drawn), first), last)


def randint(of: Any, low: int, high: int) -> Any:  # noqa: ANN401 - a key and a number of the library in force
    """Return an integer in [low, high); one key."""
    if not on_numpy():
        return jax.random.randint(of, (), low, high)
    first, second = (int(_random_bits(own, 1)[0]) for own in split(of))
    span = high - low
    # The first word is the upper half of a 64-bit number; as in JAX, products are truncated to 32 bits.
    share = (((1 << 16) % span) ** 2 & MASK) % span
    return np.array(low + ((first % span * share + second % span) & MASK) % span, np.int32)


def permutation(of: Any, values: Array) -> Any:  # noqa: ANN401 - a key and an array of the library in force
    """Return values (n,) in a random order."""
    if not on_numpy():
        return jax.random.permutation(of, values)
    mixed = np.asarray(values)
    # JAX sorts by random words, repeatedly if two of them might be equal.
    for _ in range(math.ceil(3 * math.log(max(1, len(mixed))) / math.log(MASK))):
        of, own = split(of)
        mixed = mixed[np.argsort(_random_bits(own, len(mixed)), stable=True)]
    return mixed


def _erf_inv(x: np.ndarray) -> np.ndarray:
    """Return the inverse error function of numbers in (-1, 1), single precision."""
    # log1p keeps the digits of small x.
    w = -np.log1p(-x * x)
    value = _polynomial(ERFINV_CENTRAL, w - np.float32(2.5))
    if (w >= 5).any():
        value = np.where(w < 5, value, _polynomial(ERFINV_TAIL, np.sqrt(w) - np.float32(3)))
    return value * x


def _polynomial(coefficients: Sequence[float], x: np.ndarray) -> np.ndarray:
    """Return a polynomial of numbers, its highest coefficient first."""
    value: Any = coefficients[0]
    for coefficient in coefficients[1:]:
        value = coefficient + value * x
    return value


def _random_bits(of: np.ndarray, count: int) -> np.ndarray:
    """Return `count` words of a key's sequence, or of each of keys (n,), concatenated."""
    keys = of.reshape(-1, 2)
    if len(keys) * count > MAX_LANES:
        k0, k1 = np.repeat(keys, count, axis=0).T
        return np.bitwise_xor(
            *_threefry_of_arrays(k0, k1, np.tile(np.arange(count, dtype=np.uint32), len(keys)))
        )
    _, numbers = _counting(count, len(keys))
    x0, x1 = _lanes(keys, numbers, count)
    return np.frombuffer((x0 ^ x1).to_bytes(LANE_BITS // 8 * count * len(keys), "little"), "<u4")[::2]


def _new_keys(of: np.ndarray, numbers: int, count: int) -> np.ndarray:
    """Return the keys (n * count, 2) derived from keys (n,) and `count` packed integers for each."""
    keys = of.reshape(-1, 2)
    return _as_keys(_lanes(keys, numbers, count), len(keys) * count)


def _lanes(keys: np.ndarray, numbers: int, count: int) -> tuple[int, int]:
    """Return the packed Threefry blocks of `count` integers for each of keys (n, 2), key by key."""
    ones, _ = _counting(count, len(keys))
    if len(keys) == 1:
        return _threefry(int(keys[0, 0]) * ones, int(keys[0, 1]) * ones, numbers, ones)
    k0, k1 = (_packed(np.repeat(keys[:, i], count)) for i in (0, 1))
    return _threefry(k0, k1, numbers, ones)


def _packed(words: np.ndarray) -> int:
    """Return integers packed into lanes."""
    return int.from_bytes((words.astype("<u8") & np.uint64(MASK)).tobytes(), "little")


@cache
def _counting(count: int, times: int) -> tuple[int, int]:
    """Return packed ones and packed 0 to `count` - 1, each repeated `times` times."""
    lanes = range(count * times)
    return sum(1 << LANE_BITS * i for i in lanes), sum((i % count) << LANE_BITS * i for i in lanes)


def _as_keys(words: tuple[int, int], count: int) -> np.ndarray:
    """Return packed blocks as keys (count, 2)."""
    # The second word goes to the upper half of its lane, which `_threefry` leaves empty.
    both = words[0] | words[1] << 32
    return np.frombuffer(both.to_bytes(LANE_BITS // 8 * count, "little"), "<u4").reshape(count, 2)


def _threefry(k0: int, k1: int, number: int, ones: int = 1) -> tuple[int, int]:
    """Return the Threefry blocks of packed integers; `ones` has a 1 in each lane used."""
    mask = ones * MASK
    keys = (k0, k1, k0 ^ k1 ^ ones * THREEFRY_PARITY)
    x0, x1 = k0, (number + k1) & mask
    for group in range(5):
        for distance in ROTATIONS[group % 2]:
            x0 = (x0 + x1) & mask
            # Bits shifted out of a lane end in the upper half of its neighbour, which the mask clears.
            x1 = ((x1 << distance) | (x1 >> (32 - distance))) & mask ^ x0
        x0 = (x0 + keys[(group + 1) % 3]) & mask
        x1 = (x1 + keys[(group + 2) % 3] + ones * (group + 1)) & mask
    return x0, x1


def _threefry_of_arrays(k0: np.ndarray, k1: np.ndarray, number: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As `_threefry`, of arrays (...)."""
    keys = (k0, k1, k0 ^ k1 ^ np.uint32(THREEFRY_PARITY))
    # A copy: the rounds below work in place.
    x0, x1 = np.array(k0), number + k1
    high = np.empty_like(x1)
    for group in range(5):
        for distance in ROTATIONS[group % 2]:
            x0 += x1
            np.left_shift(x1, np.uint32(distance), out=high)
            x1 >>= np.uint32(32 - distance)
            x1 |= high
            x1 ^= x0
        x0 += keys[(group + 1) % 3]
        x1 += keys[(group + 2) % 3] + np.uint32(group + 1)
    return x0, x1


POOL_SIZE = 512
"""Number of draws that are made at once."""


class RandomStream:
    """A stream of random integers, the same on every machine and with every version of NumPy.

    NumPy guarantees the bits of its bit generators, but not the output of its `Generator`; so the integers
    here are made of the bits directly.

    Args:
        seed: The arena's seed, not negative.
        purpose: Purpose of the draws: streams of different purposes do not disturb each other.
    """

    def __init__(self, seed: int, purpose: str) -> None:
        # crc32, as Python's own hash of a text differs between processes.
        self._bits = np.random.PCG64(np.random.SeedSequence([seed, crc32(purpose.encode())]))
        self._pool: list[int] = []

    def randint(self, count: int) -> int:
        """Return an integer from 0 to below `count`."""
        if not self._pool:
            self._pool = self._bits.random_raw(POOL_SIZE).tolist()
        return self._pool.pop() % count  # the bias of the remainder is below count / 2**64

    def randint_between(self, low: int, high: int) -> int:
        """Return an integer from `low` to `high`, both included."""
        return low + self.randint(high - low + 1)

    def choice(self, options: Sequence[T]) -> T:
        """Return one of the options."""
        return options[self.randint(len(options))]

    def shuffled(self, items: Sequence[T]) -> list[T]:
        """Return the items in a random order."""
        mixed = list(items)
        # Fisher and Yates, written out: NumPy's own order of draws may change with its version.
        for i in range(len(mixed) - 1, 0, -1):
            j = self.randint(i + 1)
            mixed[i], mixed[j] = mixed[j], mixed[i]
        return mixed
