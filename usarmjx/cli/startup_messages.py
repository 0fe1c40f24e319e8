"""Messages of a command while it starts and compiles, on the standard error stream, terminal or not."""

import os
import sys
import threading
import time
from collections.abc import Callable, Collection
from contextlib import suppress
from pathlib import Path

import typer

from usarmjx.base.compilation import (
    COMPILE_EVENT_PREFIX,
    JAX_FOLDER,
    disable_optimization,
    enable_compilation_cache,
    is_compiling,
    silence,
    warn_once_of_broken_entries,
)
from usarmjx.base.errors import one_line
from usarmjx.base.process import fit_pool_to_cores
from usarmjx.base.progress import clear_status

FIRST, INTERVAL = 3.0, 10.0
"""Time after which a compilation is reported, and interval of further reports [s]."""
GAP = 5.0
"""Longest pause between compilations that belong together [s]."""
NEEDS_POOL = {"jax", "auto"}
"""The engine that deadlocks in a small pool of threads, and what stands for it in a batch on a CPU."""
LOWERED, COMPILED = "jaxpr_to_mlir_module_duration", "backend_compile_duration"


class CompilationWatch:
    """Says now and then that JAX is compiling, and when it is over.

    JAX tells of each part of a compilation when it ends: that a function was traced, lowered, compiled.
    Between the last two XLA is at work, for minutes perhaps.

    Args:
        say: Takes a line.
        at_work: Whether a thread, by number, compiles just now: what is lowered need not be compiled.
        interval: Interval of reports [s]
    """

    def __init__(
        self, say: Callable[[str], None], at_work: Callable[[int], bool], interval: float = INTERVAL
    ) -> None:
        self._say, self._at_work, self._interval = say, at_work, interval
        self._compiling: set[int] = set()  # threads in which XLA may be at work
        self._begun, self._last, self._next = 0.0, -1e9, FIRST
        self._is_over = False  # an end was reported
        self._lock = threading.Lock()

    def heard(self, event: str, duration: float, now: float, thread: int = 0) -> None:
        """Take note of an event of JAX's.

        Args:
            event: Its name.
            duration: Duration so far [s].
            now: The time [s].
            thread: Place of that.
        """
        if not event.startswith(COMPILE_EVENT_PREFIX):
            return
        with self._lock:
            if not self._busy() and (self._is_over or now - duration - self._last > GAP):
                # The new interval begins after the last reported event, even if its tracing began earlier.
                self._begun, self._next = max(now - duration, self._last), FIRST
            self._last, self._is_over = now, False
            self._compiling.discard(thread)
            if event.endswith(LOWERED):
                self._compiling.add(thread)

    def _busy(self) -> bool:
        return any(map(self._at_work, self._compiling))

    def look(self, now: float) -> None:
        """Report compilations that are due at a time [s]."""
        with self._lock:
            busy = self._busy()
            length = (now if busy else self._last) - self._begun
            if busy or now - self._last <= GAP:
                if length >= self._next:
                    self._say(f"compiling ... {length:.0f} s")
                    self._next = length - length % self._interval + self._interval
            elif self._next > FIRST:
                self._say(f"compiled, {length:.0f} s")
                self._next, self._is_over = FIRST, True


def say(text: str) -> None:
    """Write a line to the standard error stream; unheard where that is a file and the disk is full."""
    with suppress(OSError):
        clear_status()
        typer.echo(f"usarmjx: {text}", err=True)


def announce(
    text: str,
    *,
    keep: bool = True,
    aloud: bool = True,
    quickly: bool = False,
    interval: float = INTERVAL,
    engines: Collection[str] = ("auto",),
) -> None:
    """Say what takes a while, and go on saying so while it compiles; what is compiled is kept.

    The first line comes before JAX is imported, which takes a second or two. Nothing happens in a process
    that has it behind itself: it compiles, and keeps what it compiles, as it likes.

    Args:
        text: The step begun.
        keep: Whether compilations are kept, and those of before used.
        aloud: Whether to report; of several processes that do the same, one is enough.
        quickly: Whether to compile without optimisation.
        interval: Interval of reports about compilation [s].
        engines: Those that may be built; without `NEEDS_POOL` JAX's pool has a thread for each core.
    """
    if "jax" in sys.modules:
        return
    silence()
    tell = say if aloud else _say_nothing
    tell(one_line(text))
    if NEEDS_POOL.isdisjoint(name.strip().lower() for name in engines):
        fit_pool_to_cores()
    if quickly:
        disable_optimization()
    if keep:
        if complaint := enable_compilation_cache():
            tell(f"note: {complaint}")
        if folder := os.environ.get(JAX_FOLDER):
            warn_once_of_broken_entries(tell, Path(folder))
    threading.Thread(target=_watch, args=(tell, interval), name="compilations", daemon=True).start()


def tried_on(engine: str) -> str:
    """Return the engine of policies that are trained or tried on a CPU: `auto` is c, see `choose_engine`."""
    return "c" if engine.lower() == "auto" else engine


def _say_nothing(text: str) -> None:
    del text


def _watch(tell: Callable[[str], None], interval: float) -> None:
    """Tell of compilations from the moment on that somebody imports JAX."""
    while "jax" not in sys.modules:
        time.sleep(0.1)
    from jax import monitoring

    watch = CompilationWatch(tell, is_compiling, interval)

    def hear(event: str, duration_secs: float, **_: object) -> None:
        watch.heard(event, duration_secs, time.monotonic(), threading.get_ident())

    monitoring.register_event_duration_secs_listener(hear)
    while True:
        time.sleep(0.5)
        watch.look(time.monotonic())
