"""A line on the error stream where a program waits for compilations without a word from us.

Commands say what they do, see `cli.startup_messages`; a script that calls `make` or `Batch` would wait half a
minute in silence. The line comes once in a process. The environment variable `USARMJX_QUIET` keeps it away.
"""

import contextlib
import multiprocessing
import os
import sys
import threading
import time
from collections.abc import Callable, Generator, MutableMapping

from usarmjx.base.compilation import COMPILE_EVENT_PREFIX

QUIET = "USARMJX_QUIET"
"""Environment variable that keeps the line away; any value but nothing and 0."""
AFTER, POLL, IDLE = 0.5, 0.1, 2.0
"""Length of work that is worth the line, interval of looks at it, and pause after which nobody looks [s]."""


def is_compiling(thread: int) -> bool:
    """Return whether a thread is in JAX's compiler, by its stack."""
    frame = sys._current_frames().get(thread)  # pyright: ignore[reportPrivateUsage]
    while frame is not None:
        if frame.f_code.co_filename.replace(os.sep, "/").endswith("jax/_src/compiler.py"):
            return True
        frame = frame.f_back
    return False


def write_line(text: str) -> None:
    """Write a line to the error stream, if there is one that takes it."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        print(f"usarmjx: {text}", file=sys.stderr, flush=True)


class CompileNotice:
    """Says once what is being built or compiled, when that has taken `AFTER`.

    Args:
        write: Takes the line.
        at_work: Whether a thread, by number, compiles just now.
    """

    def __init__(
        self, write: Callable[[str], None] = write_line, at_work: Callable[[int], bool] = is_compiling
    ) -> None:
        self._write, self._at_work = write, at_work
        self._lock = threading.Lock()
        self._subject = ""
        self._building = 0
        self._heard: set[int] = set()  # threads with an event since the last look
        self._compiling: set[int] = set()  # threads that had one
        self._watched = self._listens = self.shown = False

    def expect(self, subject: str) -> None:
        """Note what compilations from now on are for.

        Args:
            subject: A few words. While something is being built, its subject stays.
        """
        if self.shown or self._building:
            return
        self._subject = subject
        if not self._listens:
            self._listens = True
            from jax import monitoring

            monitoring.register_event_duration_secs_listener(self._hear)

    @contextlib.contextmanager
    def building(self, subject: str) -> Generator[None]:
        """Count the context as work.

        Args:
            subject: A few words for the object that is built.
        """
        if self.shown:
            yield
            return
        self.expect(subject)
        with self._lock:
            self._building += 1
            self._watch()
        try:
            yield
        finally:
            with self._lock:
                self._building -= 1

    def _hear(self, event: str, duration_secs: float, **_: object) -> None:
        del duration_secs
        if self.shown or not event.startswith(COMPILE_EVENT_PREFIX):
            return
        with self._lock:
            self._heard.add(threading.get_ident())
            self._watch()

    def _watch(self) -> None:
        if not (self._watched or self.shown):
            self._watched = True
            threading.Thread(target=self._look, name="compile notice", daemon=True).start()

    def _look(self) -> None:
        busy = idle = 0.0
        while True:
            time.sleep(POLL)
            with self._lock:
                works = bool(self._heard) or self._building > 0
                self._compiling |= self._heard
                self._heard.clear()
            works = works or any(map(self._at_work, self._compiling))
            busy, idle = (busy + POLL, 0.0) if works else (busy, idle + POLL)
            with self._lock:
                if self.shown or idle >= IDLE:
                    self._watched = False
                    return
                self.shown = busy >= AFTER
            if self.shown:
                self._write(
                    f"building and compiling {self._subject}; later starts take less time "
                    f"({QUIET}=1 hides this line)"
                )


def silence(environment: MutableMapping[str, str] = os.environ) -> None:
    """Keep the line away from this process and its children, which report in another way or not at all."""
    environment.setdefault(QUIET, "1")
    NOTICE.shown = True


def _is_quiet() -> bool:
    """Return whether the user or the parent asks for silence, or nobody reads what this process writes."""
    asked = os.environ.get(QUIET, "").strip()
    return asked not in ("", "0") or multiprocessing.parent_process() is not None


NOTICE = CompileNotice()
"""The notice of this process."""
NOTICE.shown = _is_quiet()
