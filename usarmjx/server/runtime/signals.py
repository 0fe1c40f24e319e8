"""SIGINT and SIGTERM end the process within a second, even while it compiles, as does a parent that ends."""

import contextlib
import logging
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Sequence
from types import FrameType, TracebackType
from typing import Self

from usarmjx.base.progress import CLEAR, is_status_shown

PARENT_PIPE = "USARMJX_PARENT_PIPE"
"""Environment variable with the file descriptor of a pipe to the parent process."""


class ParentPipe:
    """The parent's side of a pipe: its child ends when this process ends, for any reason.

    The context is the child's lifetime: its exit ends the child. On Windows, where processes inherit no
    descriptors, it has no effect.

    Attributes:
        settings: Part of the child's environment.
        inherited: Descriptors that the child keeps open.
    """

    def __init__(self) -> None:
        self._ends: list[int] = []
        self.settings: dict[str, str] = {}
        self.inherited: tuple[int, ...] = ()
        if os.name == "nt":
            return
        theirs, ours = os.pipe()
        self._ends += [ours, theirs]
        self.settings, self.inherited = {PARENT_PIPE: str(theirs)}, (theirs,)

    def __enter__(self) -> Self:
        """Begin the child's lifetime."""
        return self

    def started(self) -> None:
        """Close the child's end in this process, after the start of the child."""
        if self._ends:
            os.close(self._ends.pop())

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the child."""
        while self._ends:
            os.close(self._ends.pop())


def end_with_parent() -> None:
    """End this process as by SIGTERM when no process holds the other end of its pipe, if it has one.

    Its own child processes do not inherit the pipe.
    """
    # Removed, so that a grandchild does not take the descriptor's number for its own.
    pipe = os.environ.pop(PARENT_PIPE, None)
    if pipe is not None:
        threading.Thread(target=_outlive_nobody, args=(int(pipe),), daemon=True).start()


def _outlive_nobody(pipe: int) -> None:
    """End this process when the one at the other end of a pipe has ended."""
    with contextlib.suppress(OSError):
        # Returns at the end of file, which the system makes when the last writer has ended, even by SIGKILL.
        os.read(pipe, 1)
    # By the signal, not by an exit: its handlers complete the files first.
    os.kill(os.getpid(), signal.SIGTERM)


STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)
END_TIME = 1.0
"""Time from a signal to the forced end of the process [s]."""
FILES_TIME = 10.0
"""Additional time for completing files [s]: a disk may be slow, or a machine busy."""
FLUSH_TIME = 0.2
"""Time for writing buffered output at the end [s]: its reader may be gone."""


def heard_signals() -> tuple[signal.Signals, ...]:
    """Return the stop signals that this process does not ignore; a shell's `&` makes it ignore SIGINT."""
    return tuple(number for number in STOP_SIGNALS if signal.getsignal(number) is not signal.SIG_IGN)


class StopSignals:
    """Ends the process on a signal: in order, if that takes at most `END_TIME`, else at once.

    A thread in which JAX compiles a picture cannot be stopped, and Python would wait for it for minutes; nor
    does a signal's handler run while the main thread compiles. So a thread of its own watches for signals.

    A context for the main thread; in others it does nothing. Before `on_stop` is called a signal ends
    the process with the exit code that shells give for it, or, with files to complete, raises SystemExit in
    the main thread.

    Args:
        numbers: The signals; others keep their handlers.

    Attributes:
        number: The signal that came, 0 before.
    """

    def __init__(self, numbers: Sequence[signal.Signals] = STOP_SIGNALS) -> None:
        self._numbers = numbers
        self.number = 0
        self._stop: Callable[[], None] | None = None
        self._finish: Callable[[], None] | None = None
        self._undo = contextlib.ExitStack()

    def on_stop(self, stop: Callable[[], None]) -> None:
        """Set the function that a signal calls from now on, in a thread; the exit code is 0 then."""
        self._stop = stop
        # A signal that came before this call has found no function to call.
        if self.number:
            stop()

    def finish_files(self, finish: Callable[[], None]) -> None:
        """Set the function that completes files: the process waits for it, for `FILES_TIME` at most."""
        self._finish = finish

    def __enter__(self) -> "StopSignals":
        """Watch for signals from now on."""
        if threading.current_thread() is threading.main_thread():
            heard, wakeup = socket.socketpair()
            # set_wakeup_fd demands it: the C handler must not wait.
            wakeup.setblocking(False)
            before = signal.set_wakeup_fd(wakeup.fileno(), warn_on_full_buffer=False)
            # Callbacks run in reverse: handlers first, and the socket last, when no signal writes to it any
            # more.
            self._undo.callback(wakeup.close)  # which ends the thread
            self._undo.callback(signal.set_wakeup_fd, before)
            for number in self._numbers:
                self._undo.callback(signal.signal, number, signal.signal(number, self._interrupt))
            threading.Thread(target=self._watch, args=(heard,), name="signals", daemon=True).start()
            end_with_parent()
        return self

    def __exit__(self, *error: object) -> None:
        """Restore the former handlers; a process that has received a signal ends all the same."""
        self._undo.close()

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        del frame
        if self._stop is not None:
            return
        if self._finish is not None:
            raise SystemExit(128 + number)
        # An exception would be printed, and lost, wherever a library calls Python: in a compilation, for one.
        _end_unfinished(number)

    def _watch(self, heard: socket.socket) -> None:
        """Wait for a signal, whose number Python writes into the socket; then end the process."""
        with heard:
            # Python writes every signal with a handler into the socket, not only these.
            while self.number not in self._numbers:
                data = heard.recv(1)
                if not data:
                    return
                self.number = data[0]
            # The socket stays open: Python writes later signals there, too.
            stop = self._stop
            if stop is not None:
                stop()
            # An orderly end takes this daemon thread along before the sleep is over.
            time.sleep(END_TIME)
            if self._finish is not None:
                finishing = threading.Thread(target=self._finish, daemon=True)
                finishing.start()
                # Bounded and in a daemon thread: a disk that hangs must not keep the process.
                finishing.join(FILES_TIME)
            if stop is None:
                _end_unfinished(self.number)
            exit_now(0)


def _end_unfinished(number: int) -> None:
    """End the process before it serves: with a line, and the status that shells give for the signal."""
    with contextlib.suppress(OSError):
        start = CLEAR if is_status_shown() else ""
        os.write(2, f"{start}usarmjx: stopped by {signal.Signals(number).name}\n".encode())
    exit_now(128 + number)


def exit_now(code: int) -> None:
    """End the process without waiting for its threads; buffered output is written if possible."""
    flush = threading.Thread(target=_flush, daemon=True)
    with contextlib.suppress(RuntimeError):  # the interpreter is at its end, and starts no more threads
        flush.start()
        flush.join(FLUSH_TIME)
    # sys.exit would join threads, among them one of JAX that compiles.
    os._exit(code)


def _flush() -> None:
    logging.shutdown()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
