"""Rate-limited progress lines for files and pipes, which show no progress bar."""

import time
from collections.abc import Callable

PERIOD = 30.0
"""Time between two lines [s]."""


class RateLimitedLog:
    """Callable that passes on at most one line per period, the first one after one period.

    Args:
        tell: Takes a line.
        period: Time between two lines [s].
        clock: Returns the time [s].
    """

    def __init__(
        self,
        tell: Callable[[str], None],
        period: float = PERIOD,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._tell, self._period, self._clock = tell, period, clock
        self._next = clock() + period

    def __call__(self, text: str) -> None:
        """Pass on a line if one is due."""
        now = self._clock()
        if now >= self._next:
            self._next = now + self._period
            self._tell(text)
