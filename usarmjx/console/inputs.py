"""The parts of the console that take something: the command line and the pad that drives."""

from collections.abc import Callable, Sequence
from typing import ClassVar

from textual import events
from textual.binding import Binding, BindingType
from textual.message import Message as Event
from textual.widgets import Input, Static

from usarmjx.console.completion import common_beginning

COLUMNS_PER_STEP, ROWS_PER_STEP = 4, 2
"""So far the mouse goes for a step of the camera [characters]."""
DRIVING_KEYS = {
    **{"up": "forward", "down": "backward", "left": "left", "right": "right"},
    **{"w": "forward", "s": "backward", "a": "left", "d": "right", "space": "stop", "x": "straight"},
    **{"plus": "faster", "equals_sign": "faster", "minus": "slower"},
    **{"pageup": "up", "pagedown": "down", "home": "level"},
    **{"i": "tilt_up", "k": "tilt_down", "j": "pan_left", "l": "pan_right", "o": "zoom_in", "u": "zoom_out"},
    **{"h": "light", "t": "trace", "f": "flip"},
}
"""What keys do while the pad is in use."""


class CommandLine(Input):
    """The command that is being typed: Tab completes it, the arrows bring back what was sent.

    Args:
        complete: Returns what a line may become.
        offer: Shows what it may become, if that is more than one line.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("tab", "complete", "complete", priority=True),
        Binding("up", "recall(-1)", show=False),
        Binding("down", "recall(1)", show=False),
    ]

    def __init__(self, complete: Callable[[str], list[str]], offer: Callable[[Sequence[str]], None]) -> None:
        super().__init__(id="command", placeholder="a command; Tab completes, F2 drives")
        self._complete, self._offer = complete, offer
        self._sent: list[str] = []
        self._recalled = 0
        self._offered: list[str] = []
        self._begun = ""  # what the lines that are shown have in common

    def action_complete(self) -> None:
        """Write what all completions have in common; then one after the other."""
        if self.value in self._offered:
            self._put(self._offered[(self._offered.index(self.value) + 1) % len(self._offered)])
            return
        found = self._complete(self.value)
        common = common_beginning(found)
        self._offered = [] if len(found) < 2 or len(common) > len(self.value) else found
        self._begun = common if len(found) > 1 else ""
        self._offer(found if len(found) > 1 else ())
        if self._offered:
            self._put(self._offered[0])
        elif found:
            self._put(common)

    def on_input_changed(self) -> None:
        """What was offered is for another line."""
        if self.value not in (*self._offered, self._begun):
            self._offered, self._begun = [], ""
            self._offer(())

    def remember(self, line: str) -> None:
        """Take a line that was sent, and begin anew."""
        self._sent.append(line)
        self._recalled, self.value = len(self._sent), ""

    def action_recall(self, step: int) -> None:
        """Bring back a line that was sent."""
        self._recalled = min(max(self._recalled + step, 0), len(self._sent))
        self._put(self._sent[self._recalled] if self._recalled < len(self._sent) else "")

    def _put(self, line: str) -> None:
        self.value = line
        self.cursor_position = len(line)


class KeyPad(Static, can_focus=True):
    """Drives while it is in use: by keys, and the mouse turns the camera (manual 5.2.1)."""

    class Pressed(Event):
        """Something shall be done.

        Attributes:
            action: One of `driving.ACTIONS`.
        """

        def __init__(self, action: str) -> None:
            super().__init__()
            self.action = action

    class Left(Event):
        """The pad is in use no more."""

    def __init__(self) -> None:
        super().__init__("", id="pad")
        self._mouse: tuple[int, int] | None = None

    def on_key(self, event: events.Key) -> None:
        """Drive, or go back to the command line."""
        if event.key == "escape":
            self.post_message(self.Left())
        elif event.key in DRIVING_KEYS:
            self.post_message(self.Pressed(DRIVING_KEYS[event.key]))
        else:
            return
        event.stop()

    def on_mouse_down(self, event: events.MouseDown) -> None:
        """The right button ends driving."""
        if event.button == 3:
            self.post_message(self.Left())

    def on_mouse_move(self, event: events.MouseMove) -> None:
        """Turn the camera by a step for so many characters."""
        if not self.has_focus:
            return
        if self._mouse is None:
            self._mouse = event.x, event.y
        right, down = event.x - self._mouse[0], event.y - self._mouse[1]
        if abs(right) >= COLUMNS_PER_STEP:
            self.post_message(self.Pressed("pan_right" if right > 0 else "pan_left"))
            self._mouse = event.x, self._mouse[1]
        if abs(down) >= ROWS_PER_STEP:
            self.post_message(self.Pressed("tilt_down" if down > 0 else "tilt_up"))
            self._mouse = self._mouse[0], event.y

    def on_leave(self) -> None:
        """The mouse has gone elsewhere."""
        self._mouse = None
