"""Which generated arenas are trained on, and which are kept from that: ranges of their seeds.

An arena's seed is the last part of its name (`DM-building-10x8-2968811710`), so that whoever is handed one
can tell where it belongs.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.registry import Registry
from usarmjx.models.spec.arena import ArenaSpec

GENERATED = "DM-"
"""How names of generated arenas begin."""
HELD_OUT_START, TEST_START, HELD_OUT_END = 4_000_000_000, 4_000_001_000, 4_000_010_000
"""Nobody trains on seeds from the first to the last; from the second on they are for tests."""


@dataclass(frozen=True, kw_only=True)
class Split:
    """Seeds of generated arenas that are used for one thing.

    Attributes:
        start: The first; those for training leave out what is held out.
        end: The one after the last.
        arenas: How many are tried, at least; 0: as many as a task has.
    """

    start: int
    end: int
    arenas: int = 0

    def seeds(self, seed: int | tuple[int, ...], count: int) -> np.ndarray:
        """Return the seeds of so many arenas (count,): drawn by `seed`, or of a held-out split the first.

        Args:
            seed: A number, or several.
            count: How many.

        Raises:
            UsageError: More than there are.
        """
        if not self.arenas:
            drawn = np.random.SeedSequence(seed).generate_state(count, np.uint32).astype(np.int64)
            kept = (drawn >= HELD_OUT_START) & (drawn < HELD_OUT_END)
            return np.where(kept, drawn - (HELD_OUT_END - HELD_OUT_START), drawn)
        if count > self.end - self.start:
            raise UsageError(f"{count} arenas of a held-out split, which has {self.end - self.start}")
        return np.arange(self.start, self.start + count)


SPLITS: Registry[Split] = Registry("split")
SPLITS.add("train", Split(start=0, end=2**32))
SPLITS.add("validation", Split(start=HELD_OUT_START, end=TEST_START, arenas=100))
SPLITS.add("test", Split(start=TEST_START, end=HELD_OUT_END, arenas=200))


def held_out(arenas: Iterable[ArenaSpec]) -> str | None:
    """Return the name of the split of the first of some arenas that nobody may train on; None: all may be."""
    for arena in arenas:
        seed = arena.name.rpartition("-")[2]
        if not (arena.name.startswith(GENERATED) and seed.isdecimal()):
            continue
        for name, split in SPLITS:
            if split.arenas and split.start <= int(seed) < split.end:
                return name
    return None
