"""A pipe between a process and its child: the child ends as by SIGTERM when its parent has ended."""

import contextlib
import os
import signal
import threading
from types import TracebackType
from typing import Self

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
    pipe = os.environ.pop(PARENT_PIPE, None)
    if pipe is not None:
        threading.Thread(target=_outlive_nobody, args=(int(pipe),), daemon=True).start()


def _outlive_nobody(pipe: int) -> None:
    """End this process when the one at the other end of a pipe has ended."""
    with contextlib.suppress(OSError):
        os.read(pipe, 1)
    os.kill(os.getpid(), signal.SIGTERM)
