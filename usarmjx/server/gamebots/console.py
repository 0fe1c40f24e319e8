"""The spectator's console (manual 5.1): `showlog`, `showdebug`, `editactor` and `pause`, as lines of text.

Pages that show a world offer it. A line is to be run by the thread that runs the world.
"""

import logging
import shlex
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from usarmjx.base.errors import UsageError, UsarmjxError
from usarmjx.base.transforms import angles_from_mat
from usarmjx.server.gamebots.edit_actor import USAGE, edit_actor
from usarmjx.server.protocol.grammar import clip, flip_wire_angles, flip_wire_vector, two_decimals_list
from usarmjx.server.worlds.served_world import ServedWorld

if TYPE_CHECKING:
    from usarmjx.view.controls import WorldControls


PACKAGE = "usarmjx"
"""Name of the logger above all of ours."""
MAX_LINES = 500
"""So many lines are kept."""
MAX_LOG_LINE = 400
"""Of a longer one the beginning is kept [characters]."""


class LogTail(logging.Handler):
    """Keeps the last lines of a log.

    Attributes:
        lines: The lines, the oldest first.
    """

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self.lines: deque[str] = deque(maxlen=MAX_LINES)
        self._times = logging.Formatter(datefmt="%H:%M:%S")

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a line: time of day, level and message."""
        message = " ".join(record.getMessage().splitlines())
        when = self._times.formatTime(record, self._times.datefmt)
        self.lines.append(f"{when} {record.levelname} {message}"[:MAX_LOG_LINE])


def keep_log() -> LogTail:
    """Keep the log of this package from now on, also what the error stream is not to show.

    Returns:
        What keeps it; the same one whenever this is called again.
    """
    package = logging.getLogger(PACKAGE)
    shown = package.getEffectiveLevel()
    tail = next((handler for handler in package.handlers if isinstance(handler, LogTail)), None)
    if tail is None:
        tail = LogTail()
        package.addHandler(tail)
    if shown > tail.level:
        for handler in logging.getLogger().handlers:
            if type(handler) is logging.StreamHandler:
                handler.setLevel(max(handler.level, shown))
        package.setLevel(tail.level)
    return tail


MAX_LINE = 500
"""A longer line is refused [characters]."""
SHOWN_LINES = 20
"""So many lines of the log `showlog` shows if no number is said."""
NOT_ALLOWED = "this is for those on the server's own machine, or who have said its token"


@dataclass(frozen=True)
class WatchingCamera:
    """From where a spectator looks.

    Attributes:
        pos: Position [m] (3,).
        mat: Orientation (3, 3).
        rate: Pictures per second, of late.
        about: What it shows, in words.
    """

    pos: np.ndarray
    mat: np.ndarray
    rate: float
    about: str = ""


class SpectatorConsole:
    """A console.

    Args:
        world: The served world.
        controls: What pauses it; None: nothing does.
        number: The world's number among those that `controls` knows.
        camera: Returns from where its spectator looks now; None: nobody looks.
        tail: The log; None: it is not kept.
        trusted: Whether more than looking is allowed.
        refusal: What is said where it is not.
    """

    def __init__(
        self,
        world: ServedWorld,
        controls: "WorldControls | None" = None,
        *,
        number: int = 0,
        camera: Callable[[], WatchingCamera | None] | None = None,
        tail: LogTail | None = None,
        trusted: bool = True,
        refusal: str = NOT_ALLOWED,
    ) -> None:
        self._world, self._controls, self._number = world, controls, number
        self._camera, self._tail, self._trusted, self._refusal = camera, tail, trusted, refusal
        self._commands: dict[str, tuple[Callable[[list[str]], str], str]] = {
            "showlog": (self._show_log, "showlog [LINES]: the last lines of the server's log"),
            "showdebug": (self._show_debug, "showdebug: where the camera is, and how fast pictures come"),
            "editactor": (self._edit_actor, f"{USAGE}: parameters of robots and sensors; none: show them"),
            "pause": (self._pause, "pause: let the world stand still, or go on"),
            "help": (self._help, "help: this"),
        }

    @property
    def commands(self) -> list[str]:
        """The commands, for completion."""
        return list(self._commands)

    def run(self, line: str) -> str:
        """Carry out a line; return what to show, which is the reason where it cannot be."""
        try:
            return self._run(line)
        except UsarmjxError as error:
            return str(error)

    def _run(self, line: str) -> str:
        if len(line) > MAX_LINE:
            raise UsageError(f"a line has at most {MAX_LINE} characters")
        try:
            head, *words = shlex.split(line) or [""]
        except ValueError as error:
            raise UsageError(f"{clip(line)}: {error}") from error
        if not head:
            return ""
        if head.lower() not in self._commands:
            raise UsageError(f"no command {clip(head)}; there are: {', '.join(self._commands)}")
        command, _ = self._commands[head.lower()]
        if not self._trusted and command not in (self._show_debug, self._help):
            raise UsageError(f"{head.lower()}: {self._refusal}")
        return command(words)

    def _help(self, words: list[str]) -> str:
        del words
        return "\n".join(about for _, about in self._commands.values())

    def _show_log(self, words: list[str]) -> str:
        count = words[0] if words else str(SHOWN_LINES)
        if len(words) > 1 or not (count.isdecimal() and len(count) <= len(str(MAX_LINE)) and int(count)):
            raise UsageError(f"showlog: {clip(' '.join(words))} is no number of lines")
        if self._tail is None:
            raise UsageError("showlog: this server does not keep its log")
        return "\n".join(list(self._tail.lines)[-int(count) :]) or "nothing has been logged yet"

    def _show_debug(self, words: list[str]) -> str:
        if words:
            raise UsageError("showdebug takes nothing")
        camera = None if self._camera is None else self._camera()
        lines: list[str] = []
        if camera is not None:
            place = two_decimals_list(flip_wire_vector(camera.pos.tolist()))
            turn = two_decimals_list(flip_wire_angles(angles_from_mat(camera.mat).tolist()))
            shown = f"{camera.about}, " if camera.about else ""
            lines = [f"camera: {{Location {place}}} {{Rotation {turn}}}"]
            lines += [f"{shown}{camera.rate:.1f} pictures a second"]
        world = self._world
        robots = ", ".join(f"{robot.name} ({robot.spec.name})" for _, robot in sorted(world.robots.items()))
        goes = ""
        if self._controls is not None:
            status = self._controls.status(self._number)
            goes = ", paused" if status.paused else f", real-time factor {status.realtime_factor:.2f}"
        return "\n".join(
            [*lines, f"{world.arena.name} at {world.time:.2f} s{goes}", f"robots: {robots or 'none'}"]
        )

    def _edit_actor(self, words: list[str]) -> str:
        return edit_actor(self._world, words)

    def _pause(self, words: list[str]) -> str:
        if words:
            raise UsageError("pause takes nothing")
        if self._controls is None:
            raise UsageError("pause: nothing here can make this world stand still")
        on = not self._controls.status(self._number).paused
        self._controls.pause(on)
        return "it stands still" if on else "it goes on"
