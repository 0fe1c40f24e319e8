"""Entry point of `usarmjx`: a signal during the imports ends the process in one line, not in a traceback."""

import os
import signal
from types import FrameType

EARLY_SIGNALS = (signal.SIGINT, signal.SIGTERM)


def end_early(number: int, frame: FrameType | None) -> None:
    """Write a line and end the process, with the status that shells give for the signal."""
    del frame
    os.write(2, f"usarmjx: stopped by {signal.Signals(number).name}\n".encode())
    os._exit(128 + number)


def main() -> None:
    """Import the command line and run it."""
    usual = {number: signal.getsignal(number) for number in EARLY_SIGNALS}
    for number, handler in usual.items():
        if handler is not signal.SIG_IGN:  # as `nohup` and shells set it for what runs in the background
            signal.signal(number, end_early)
    from usarmjx.cli.app import app

    for number, handler in usual.items():
        signal.signal(number, handler)
    app()
