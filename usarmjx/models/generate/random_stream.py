"""Random streams that are the same on every machine and with every version of numpy.

NumPy guarantees the bits of its bit generators, but not the output of its `Generator`; so the integers here
are made of the bits directly.
"""

from collections.abc import Sequence
from typing import TypeVar
from zlib import crc32

import numpy as np

T = TypeVar("T")

POOL_SIZE = 512
"""Number of draws that are made at once."""


class RandomStream:
    """A stream of random integers.

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
        for i in range(len(mixed) - 1, 0, -1):
            j = self.randint(i + 1)
            mixed[i], mixed[j] = mixed[j], mixed[i]
        return mixed
