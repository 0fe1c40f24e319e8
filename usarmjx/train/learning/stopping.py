"""Ctrl-C and SIGTERM as a request: a training writes a checkpoint before it ends."""

import signal
import threading
from collections.abc import Callable
from types import FrameType, TracebackType

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class StopRequest:
    """Request to end a training after the iteration at work, made by a signal.

    Signals before `arm` act as usual, since there is nothing to keep; so does a second one. Only the main
    thread of a process gets signals, elsewhere none is caught.

    Args:
        say: Receives a line when the request is made.
        on_arm: Called before the first signal is caught, as to end another handling of signals.

    Attributes:
        number: Number of the signal; 0 without a request.
    """

    def __init__(self, say: Callable[[str], None], on_arm: Callable[[], None] | None = None) -> None:
        self._say, self._on_arm = say, on_arm
        self._before: dict[int, object] = {}
        self.number = 0

    def __enter__(self) -> "StopRequest":
        """Begin; `arm` catches signals."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Let signals act as before."""
        self._restore()

    def arm(self) -> None:
        """Catch signals from now on, except those that are ignored, as under `nohup`."""
        if self._before or self.number or threading.current_thread() is not threading.main_thread():
            return
        if self._on_arm is not None:
            self._on_arm()
        for number in SIGNALS:
            if signal.getsignal(number) is not signal.SIG_IGN:
                self._before[number] = signal.signal(number, self._request)

    def _request(self, number: int, frame: FrameType | None) -> None:
        del frame
        self._restore()
        self.number = number
        name = signal.Signals(number).name
        self._say(f"{name}: ending with a checkpoint after this iteration; a second one ends at once")

    def _restore(self) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)  # pyright: ignore[reportArgumentType]
        self._before = {}

    @property
    def requested(self) -> bool:
        """Whether the training is requested to end."""
        return self.number != 0
