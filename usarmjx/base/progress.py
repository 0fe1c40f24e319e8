"""How far something is, in a line now and then: for files and pipes, where no bar can be shown."""

import time
from collections.abc import Callable

PERIOD = 30.0
"""Time between two lines [s]."""


class RateLimitedLog:
    """Passes on what it is told, once in a while; the first line only after a while, too.

    Args:
        tell: Takes a line.
        period: Time between two lines [s].
        clock: Tells the time [s].
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
        """Take a line, and tell it if it is time."""
        now = self._clock()
        if now >= self._next:
            self._next = now + self._period
            self._tell(text)
