"""What JAX compiles while a test listens; the listeners of others stay."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import jax

from usarmjx.base.compilation import COMPILE_EVENT_PREFIX

COMPILED = "backend_compile_duration"
"""How the names of events end that tell of a program which XLA has compiled."""


@contextmanager
def compilations(ending: str = "") -> Iterator[list[str]]:
    """A list of what JAX traces and compiles inside, by the names of its events that end so."""
    events: list[str] = []

    def note(event: str, seconds: float, **more: Any) -> None:
        del seconds, more
        if event.startswith(COMPILE_EVENT_PREFIX) and event.endswith(ending):
            events.append(event)

    jax.monitoring.register_event_duration_secs_listener(note)
    try:
        yield events
    finally:
        jax.monitoring.unregister_event_duration_listener(note)
