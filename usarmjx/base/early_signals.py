"""Signals before a command runs: they end the process in one line, not in a traceback.

Python, the imports and the parser of the command line take seconds on a busy machine. `usarmjx/__init__.py`
imports this module before all others, so it imports little.
"""

import os
import signal
import sys
from itertools import pairwise
from types import FrameType

EARLY_SIGNALS = (signal.SIGINT, signal.SIGTERM)
COMMAND = "usarmjx"
_usual: dict[signal.Signals, object] = {}
"""Handlers before `catch_signals`, until a command runs."""


def is_command() -> bool:
    """Return whether this process was started as `usarmjx` or by `python -m usarmjx`.

    A worker that Python's multiprocessing has started is none, though its `sys.argv` is that of its parent.
    """
    first = getattr(sys, "argv", [""])[0]
    words = sys.orig_argv
    # `-m` stands there until Python has found the module.
    if first == "-m":
        return ("-m", COMMAND) in pairwise(words)
    return first in words and os.path.splitext(os.path.basename(first))[0] == COMMAND


def end_early(number: int, frame: FrameType | None) -> None:
    """Write a line and end the process, with the status that shells give for the signal."""
    del frame
    # Neither buffers nor handlers of the exit: the signal may come in the middle of an import.
    os.write(2, f"usarmjx: stopped by {signal.Signals(number).name}\n".encode())
    os._exit(128 + number)


def catch_signals() -> None:
    """Let signals end the process by `end_early` until `restore_signals`."""
    for number in EARLY_SIGNALS:
        handler = signal.getsignal(number)
        # Others are a program's own, or ignore the signal, as `nohup` and shells set it in the background.
        if handler in (signal.SIG_DFL, signal.default_int_handler):
            _usual[number] = handler
            signal.signal(number, end_early)


def restore_signals() -> None:
    """Let signals mean what they did before `catch_signals`."""
    while _usual:
        number, handler = _usual.popitem()
        signal.signal(number, handler)  # type: ignore[arg-type]
