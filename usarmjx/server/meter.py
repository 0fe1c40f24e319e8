"""How regularly a served world is stepped: a few additions in each control step."""

import time
from bisect import bisect_left
from collections import deque

from usarmjx.server.net import BotServer

GAP_BOUNDS = (0.005, 0.01, 0.015, 0.025, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
"""Gaps between two control steps are counted up to each of these [s]; one is due after 0.02 s."""
WINDOW, SAMPLE = 5.0, 0.5
"""The real-time factor is that of the last seconds, looked at so often [s]."""


class StepMeter:
    """A `net.Service` that measures the control steps of a world.

    Args:
        server: The world's server.

    Attributes:
        server: The world's server.
        gaps: How many gaps between two control steps were up to each bound, and how many above the last.
        gap_sum: Their sum [s].
    """

    def __init__(self, server: BotServer) -> None:
        self.server = server
        self.gaps = [0] * (len(GAP_BOUNDS) + 1)
        self.gap_sum = 0.0
        self._last = self._next_sample = 0.0
        self._samples: deque[tuple[float, float]] = deque(maxlen=round(WINDOW / SAMPLE) + 1)

    async def start(self) -> list[str]:
        """Begin; there is nothing to say."""
        return []

    def tick(self) -> None:
        """The world has made a control step."""
        self.count(time.perf_counter())

    def count(self, now: float) -> None:
        """Count a control step that was made at a time [s]."""
        if self._last:
            gap = now - self._last
            self.gaps[bisect_left(GAP_BOUNDS, gap)] += 1
            self.gap_sum += gap
        self._last = now
        if now >= self._next_sample:
            self._next_sample = now + SAMPLE
            self._samples.append((now, self.server.world.time))

    def stop(self) -> None:
        """Nothing to do."""

    def realtime_factor(self, now: float) -> float:
        """Return simulated seconds per second of late, as seen at a time [s]; 0 while there is no telling."""
        if not self._samples or now <= self._samples[0][0]:
            return 0.0
        began, start = self._samples[0]
        return (self.server.world.time - start) / (now - began)
