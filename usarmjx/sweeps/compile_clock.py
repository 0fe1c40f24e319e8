"""How long JAX compiles in this process: tracing, lowering and XLA, as JAX tells of them when they end."""

import time
from collections.abc import Iterable
from functools import cache

from jax import monitoring

from usarmjx.base.compilation import COMPILATION

CompileSpan = tuple[float, float]
"""Begin and end [s]."""


def covered(spans: Iterable[CompileSpan]) -> float:
    """Return how long at least one of the spans lasts [s]: what is traced within a trace counts once."""
    whole, until = 0.0, -float("inf")
    for begin, end in sorted(spans):
        whole += max(0.0, end - max(begin, until))
        until = max(until, end)
    return whole


class CompileClock:
    """Hears of all compilations of this process."""

    def __init__(self) -> None:
        self._spans: list[CompileSpan] = []

    def hear(self, event: str, duration_secs: float, **_: object) -> None:
        """Take note of what has just ended and how long it took [s]; JAX calls it."""
        if event.startswith(COMPILATION):
            now = time.monotonic()
            self._spans.append((now - duration_secs, now))

    def taken(self) -> float:
        """Return how long was compiled since the last call [s]."""
        spans, self._spans = self._spans, []
        return covered(spans)


@cache
def compile_clock() -> CompileClock:
    """Return the clock of this process; it hears what is compiled from the first call on."""
    clock = CompileClock()
    monitoring.register_event_duration_secs_listener(clock.hear)
    return clock
