"""Signals before a command runs: they end the process in one line, not in a traceback.

Imports and the parser of the command line take seconds on a busy machine.
"""

import os
import signal
from collections.abc import Callable
from types import FrameType
from typing import Any

EARLY_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_usual: dict[signal.Signals, Any] = {}
"""Handlers before `catch_signals`, until a command runs."""


def end_early(number: int, frame: FrameType | None) -> None:
    """Write a line and end the process, with the status that shells give for the signal."""
    del frame
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
        signal.signal(*_usual.popitem())


def with_usual_signals(run: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return a command's `invoke` that restores the signals first."""

    def invoke(context: Any) -> Any:  # noqa: ANN401 - click's, or typer's own copy
        restore_signals()
        return run(context)

    return invoke
