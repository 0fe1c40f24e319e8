"""Simulated time as an integer count of control steps: a duration does not depend on the age of the world."""

from fractions import Fraction
from functools import lru_cache
from types import ModuleType

import numpy as np
from flax import struct

from usarmjx.base.backend import Array, ArrayLike, xp
from usarmjx.base.nodes import Node

LONGEST_INTERVAL = 2**30
"""Longest interval of a schedule [control steps]."""
FINEST_DENOMINATOR = 10_000
"""Largest denominator of an interval in control steps."""


class Clock(Node, kw_only=True):
    """A moment of a world.

    Counts are 32-bit and wrap around; differences of counts up to 2^31 apart are exact. Seconds in single
    precision are not: their resolution is 8 ms after a day.

    Attributes:
        step: Control steps since the last reset (...,).
        period: Length of a control step [s].
    """

    step: Array
    period: float = struct.field(pytree_node=False)

    @property
    def seconds(self) -> Array:
        """Simulated time in single precision [s] (...,); for display. Use `since` for durations."""
        return xp.asarray(self.step, xp.float32) * self.period

    def since(self, step: ArrayLike) -> Array:
        """Return the time since a count of control steps [s]."""
        return (self.step - xp.asarray(step)).astype(xp.float32) * self.period


def wrapped_step(count: ArrayLike) -> np.ndarray:
    """Return a count of control steps as the 32-bit count that a clock has then."""
    # NumPy wraps 64-bit counts silently where it casts them; a Python int beyond 32 bits would raise.
    return np.asarray(np.asarray(count, np.int64).astype(np.int32))


def clock_at(seconds: ArrayLike, period: float) -> Clock:
    """Return the clock of the control step nearest to a time [s]."""
    return Clock(step=wrapped_step(np.rint(np.asarray(seconds, np.float64) / period)), period=period)


Time = ArrayLike | Clock
"""Simulated time: seconds, or a clock."""


def cycle_share(time: Time, frequency: Array, dims: int, xp: ModuleType) -> Array:
    """Return which share of its cycle a periodic motion has done, in [0, 1).

    The share at a clock is a 32-bit fixed-point number that wraps around. It moves evenly in a world of any
    age, and its frequency is right to 1e-7.

    Args:
        time: Simulated time [s] or clock (...,).
        frequency: Cycles per second, broadcast against the time with further axes.
        dims: Number of these axes.
        xp: Array module.
    """
    further = (..., *[None] * dims)
    if not isinstance(time, Clock):
        return xp.mod(xp.asarray(time)[further] * frequency, 1.0)
    # Whole cycles within a step do not change the phase.
    turns = xp.mod(xp.asarray(frequency, xp.float32) * xp.float32(time.period), 1.0)
    # The largest float32 below 1 is below 2^32 after the scaling, so that the conversion is defined.
    increment = (turns * xp.float32(2.0**32)).astype(xp.uint32)
    # Overflow is wanted: modulo 2**32 is modulo a whole cycle.
    phase = xp.asarray(time.step)[further].astype(xp.uint32) * increment
    # 24 bits are exact in single precision, so the share never rounds up to 1.
    return (phase >> np.uint32(8)).astype(xp.float32) * xp.float32(2.0**-24)


@lru_cache(maxsize=256)
def intervals_in_steps(intervals: tuple[float, ...], period: float) -> tuple[np.ndarray, np.ndarray]:
    """Return intervals [s] as fractions of control steps: numerators and denominators (intervals,)."""
    steps: list[Fraction] = []
    for interval in intervals:
        # Longer intervals would overflow 32 bits; at 0.02 s this one is 248 days.
        ratio = min(interval / period, LONGEST_INTERVAL)
        # A quotient of floats such as 0.2 / 0.02 is not exactly 10: the nearest simple fraction is meant.
        step = Fraction(ratio).limit_denominator(FINEST_DENOMINATOR)
        # A numerator beyond 32 bits belongs to an interval of days, of which no fraction of a step matters.
        steps.append(step if step.numerator <= LONGEST_INTERVAL else Fraction(round(ratio)))
    return np.array([s.numerator for s in steps], np.int32), np.array(
        [s.denominator for s in steps], np.int32
    )


def next_due(
    step: Array, due: Array, lead: Array, intervals: tuple[np.ndarray, np.ndarray]
) -> tuple[Array, Array]:
    """Return when periodic work is due again after it was done, in integers: the mean rate is exact.

    The next time follows the schedule, not the time of the work. Work that missed a whole interval restarts
    its schedule, instead of being done repeatedly to catch up.

    Args:
        step: Present control step ().
        due: Control step from which the work was due (...,).
        lead: By how much that is after its exact time, in parts of a control step (...,).
        intervals: The intervals as `intervals_in_steps` returns them (...,).

    Returns:
        The next `due` and `lead` (...,).
    """
    whole, parts = intervals
    # Division of the negative number rounds up.
    missed = step - due >= -((lead - whole) // parts)
    start, lead = xp.where(missed, step, due), xp.where(missed, 0, lead)
    gap = -((lead - whole) // parts)  # up to the first step not before the exact time
    return (start + gap).astype(xp.int32), (gap * parts - (whole - lead)).astype(xp.int32)
