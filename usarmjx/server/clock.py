"""The worlds' clock while they are served: pause, single steps, and how fast simulated time goes."""

import math
import threading

from usarmjx.base.errors import UsageError
from usarmjx.server.pace import Pace

IDLE_PERIOD = 0.02
"""Worlds that stand still are attended to so often [s]."""
MAX_STEPS = 1000
"""Most single steps that may wait."""
MAX_FACTOR = 1000.0
"""Largest factor that can be asked for."""


class StepClock:
    """Says when worlds make their next control step, and whether they make it.

    Whoever steps them asks `takes_step` before each and `wait` after it; `pause`, `step` and `set_factor` may
    be called from any thread.

    Args:
        factor: Simulated seconds per second; 0: as many as there can be.
    """

    def __init__(self, factor: float = 1.0) -> None:
        self._factor, self._paused, self._steps = factor, False, 0
        self._pace: Pace | None = None
        self._period = 0.0
        self._lock = threading.Lock()

    @property
    def factor(self) -> float:
        """Simulated seconds per second that are wanted; 0: as many as there can be."""
        return self._factor

    @property
    def paused(self) -> bool:
        """Whether the worlds stand still."""
        return self._paused

    def pause(self, on: bool) -> None:
        """Let the worlds stand still, or go on."""
        with self._lock:
            self._paused, self._steps = on, 0

    def step(self, steps: int = 1) -> None:
        """Let the worlds make so many more control steps, and stand still then.

        Raises:
            UsageError: That many cannot be asked for.
        """
        if not 1 <= steps <= MAX_STEPS:
            raise UsageError(f"{steps} single steps cannot be asked for: 1 to {MAX_STEPS}")
        with self._lock:
            self._paused, self._steps = True, min(self._steps + steps, MAX_STEPS)

    def set_factor(self, factor: float) -> None:
        """Set how many simulated seconds a second shall have.

        Raises:
            UsageError: It is no such number.
        """
        if not (math.isfinite(factor) and 0.0 <= factor <= MAX_FACTOR):
            raise UsageError(f"a real-time factor of {factor:g} is not possible: 0 to {MAX_FACTOR:g}")
        with self._lock:
            self._factor, self._pace = factor, None

    def takes_step(self) -> bool:
        """Return whether the worlds make a control step now; a single step is used up by that."""
        with self._lock:
            if self._paused and not self._steps:
                return False
            self._steps -= self._paused
            return True

    def wait(self, period: float, now: float) -> float:
        """Return how long to wait after a time [s]: for the next control step, or the next look.

        Args:
            period: Length of a control step [s of simulated time].
            now: When the last one ended [s].
        """
        with self._lock:
            if self._paused:
                self._pace = None
                return IDLE_PERIOD
            if self._pace is None:
                self._pace = Pace(period, self._factor, now)
            return self._pace.pause(now)

    def finish(self, now: float) -> None:
        """Log how much time was lost, if any was since that was logged last, at a time [s]."""
        with self._lock:
            if self._pace is not None:
                self._pace.finish(now)
