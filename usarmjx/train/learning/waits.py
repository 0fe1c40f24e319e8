"""Waits of a training's host: seconds of each iteration, by their reason."""

import time
from collections.abc import Generator
from contextlib import contextmanager
from typing import Literal, TypeAlias, get_args

Reason: TypeAlias = Literal["arenas", "device", "checkpoint", "log"]
"""New arenas and their transfer; results of the device; checkpoints and scores; metrics and watchers."""


class Waits:
    """Sums of the seconds that the host has waited, by reason."""

    def __init__(self) -> None:
        self._seconds = dict.fromkeys(get_args(Reason), 0.0)

    @contextmanager
    def timed(self, reason: Reason) -> Generator[None]:
        """Add the duration of a block."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self._seconds[reason] += time.perf_counter() - began

    def take(self) -> dict[str, float]:
        """Return the sums since the last call [s]."""
        taken, self._seconds = self._seconds, dict.fromkeys(self._seconds, 0.0)
        return {reason: round(seconds, 6) for reason, seconds in taken.items()}
