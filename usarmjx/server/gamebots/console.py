"""The spectator's console (manual 5.1): `showlog`, `showdebug`, `editactor` and `pause`, as lines of text.

Pages that show a world offer it. The thread that runs the world runs the lines, too.
"""

import shlex
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from usarmjx.base.errors import UsageError, UsarmjxError
from usarmjx.base.transforms import angles_from_mat
from usarmjx.server.gamebots.edit_actor import USAGE, edit_actor
from usarmjx.server.protocol.frames import flip_wire_angles, flip_wire_vector
from usarmjx.server.protocol.grammar import clip, two_decimals_list
from usarmjx.server.runtime.logs import MAX_KEPT_LINES, LogTail
from usarmjx.server.worlds.served_world import ServedWorld

if TYPE_CHECKING:
    from usarmjx.view.controls import WorldControls

MAX_LINE = 500
"""Longest line that is accepted [characters]."""
SHOWN_LINES = 20
"""Lines of the log that `showlog` shows by default."""
NOT_ALLOWED = "this is for clients on the server's own machine, or with its token"
"""Refusal of a command of a peer without permission."""


@dataclass(frozen=True)
class SpectatorCamera:
    """Viewpoint of a spectator.

    Attributes:
        pos: Position [m] (3,).
        mat: Orientation (3, 3).
        rate: Recent frame rate [Hz].
        about: Description of the view.
    """

    pos: np.ndarray
    mat: np.ndarray
    rate: float
    about: str = ""


class SpectatorConsole:
    """Console of one spectator.

    Args:
        world: The served world.
        controls: Controls that pause it; None without any.
        number: Number of the world among those of `controls`.
        camera: Returns the spectator's present viewpoint; None without one.
        tail: Last lines of the log; None when it is not kept.
        trusted: Whether more than looking is allowed.
        refusal: Answer to a command that is not allowed.
    """

    def __init__(
        self,
        world: ServedWorld,
        controls: "WorldControls | None" = None,
        *,
        number: int = 0,
        camera: Callable[[], SpectatorCamera | None] | None = None,
        tail: LogTail | None = None,
        trusted: bool = True,
        refusal: str = NOT_ALLOWED,
    ) -> None:
        self._world, self._controls, self._number = world, controls, number
        self._camera, self._tail, self._trusted, self._refusal = camera, tail, trusted, refusal
        self._commands: dict[str, tuple[Callable[[list[str]], str], str]] = {
            "showlog": (self._show_log, "showlog [LINES]: the last lines of the server's log"),
            "showdebug": (self._show_debug, "showdebug: place of the camera, and rate of pictures"),
            "editactor": (self._edit_actor, f"{USAGE}: parameters of robots and sensors; none: show them"),
            "pause": (self._pause, "pause: let the world stand still, or go on"),
            "help": (self._help, "help: this"),
        }

    @property
    def commands(self) -> list[str]:
        """Names of the commands, for completion."""
        return list(self._commands)

    def run(self, line: str) -> str:
        """Carry out a line; return the text to show, which is the reason of a refusal."""
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
            raise UsageError(f"no command {clip(head)}; known: {', '.join(self._commands)}")
        command, _ = self._commands[head.lower()]
        if not self._trusted and command not in (self._show_debug, self._help):
            raise UsageError(f"{head.lower()}: {self._refusal}")
        return command(words)

    def _help(self, words: list[str]) -> str:
        del words
        return "\n".join(about for _, about in self._commands.values())

    def _show_log(self, words: list[str]) -> str:
        count = words[0] if words else str(SHOWN_LINES)
        if len(words) > 1 or not (
            count.isdecimal() and len(count) <= len(str(MAX_KEPT_LINES)) and int(count)
        ):
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
            location = two_decimals_list(flip_wire_vector(camera.pos.tolist()))
            turn = two_decimals_list(flip_wire_angles(angles_from_mat(camera.mat).tolist()))
            shown = f"{camera.about}, " if camera.about else ""
            lines = [f"camera: {{Location {location}}} {{Rotation {turn}}}"]
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
