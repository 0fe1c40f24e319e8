"""Simulated time in step with the clock, and what the log hears of it when it is not."""

import logging
import math

log = logging.getLogger(__name__)

MAX_LAG = 0.5
"""What is further behind the clock than this gives up catching up [s]."""
RECOVERY = 2.0
"""What is in time so long after giving up has caught its breath [s]."""


class Pace:
    """Says when to make the next control step.

    A world that cannot keep up with the clock makes its steps one right after the other. Whenever it is
    `MAX_LAG` behind, it lets that time go: else it would run ahead of the clock when it could again. The log
    gets a line when that begins, and one with the total when it ends.

    Args:
        period: Length of a control step [s of simulated time].
        factor: Simulated seconds per second; 0: as fast as it can.
        now: When the first step is made [s].
    """

    def __init__(self, period: float, factor: float, now: float) -> None:
        self._period = period / factor if factor > 0 else 0.0
        self._deadline = now
        self._fell_behind = self._gave_up = math.nan
        self._lost = 0.0

    def pause(self, now: float) -> float:
        """Return how long to wait for the next control step, after one that ended at a time [s]."""
        if self._period <= 0.0:
            return 0.0
        self._deadline += self._period
        behind = now - self._deadline
        if behind > MAX_LAG:
            self._give_up(now, behind)
        elif behind <= 0.0 and now >= self._gave_up + RECOVERY:
            self.finish(now)
        return max(0.0, -behind)

    def _give_up(self, now: float, behind: float) -> None:
        if math.isnan(self._fell_behind):
            self._fell_behind = now
            log.warning("%.2f s behind the clock: simulated time falls back", behind)
        self._gave_up = self._deadline = now
        self._lost += behind

    def finish(self, now: float) -> None:
        """Log how much time was lost, if any was since that was logged last, at a time [s]."""
        if not math.isnan(self._fell_behind):
            lasted = now - self._fell_behind
            log.warning("no longer behind the clock: %.2f s lost in %.1f s", self._lost, lasted)
        self._fell_behind = self._gave_up = math.nan
        self._lost = 0.0
