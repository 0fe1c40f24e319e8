"""Console at the live page (manual 5.1), one for each user."""

import html
import time
from collections import deque
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import viser
from scipy.spatial.transform import Rotation

from usarmjx.server.gamebots.console import NOT_ALLOWED, SpectatorCamera, SpectatorConsole
from usarmjx.server.runtime.logs import LogTail
from usarmjx.server.worlds.served_world import ServedWorld
from usarmjx.view.controls import ControlLock
from usarmjx.view.drawing import Drawing, Frame

if TYPE_CHECKING:
    from usarmjx.view.page import ViewerPage

MAX_SHOWN = 8000
"""Longest text of answers that stays [characters]."""
MANY_UPDATES = 20
"""Number of the last updates from which the frame rate is computed."""
TAKE_THEM = "take the controls first"
SOMEBODY_ELSE = "this is for who has the controls, and that is somebody else"
STYLE = "font-size:.75em;margin:0 1em .5em;max-height:16em;overflow:auto;white-space:pre-wrap"


class ConsolePanel:
    """A `view.page.Panel`: a console for each user of the page.

    The user with the controls may use all of it, the others may look: see `console.SpectatorConsole`.

    Args:
        page: The page.
        worlds: The worlds of the page, by number.
        seat: Lock of the controls.
        tail: Last lines of the log; None when it is not kept.
    """

    def __init__(
        self,
        page: "ViewerPage",
        worlds: Sequence[ServedWorld],
        lock: ControlLock,
        tail: LogTail | None = None,
    ) -> None:
        self._page, self._worlds, self._lock, self._tail = page, worlds, lock, tail
        self._people: dict[int, UserConsole] = {}
        self._updates: deque[float] = deque(maxlen=MANY_UPDATES)

    def begin(self, drawing: Drawing) -> None:
        """Do nothing: the console does not depend on the drawing."""

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Give new users a console."""
        self._updates.append(time.monotonic())
        viewers = self._page.viewers
        for number in self._people.keys() - viewers.keys():
            del self._people[number]
        for number, viewer in viewers.items():
            if number not in self._people:
                self._people[number] = UserConsole(
                    viewer.client, partial(self.run, viewer.client), self._page
                )

    def run(self, client: viser.ClientHandle, line: str) -> str:
        """Carry out a user's line, in the thread that runs the worlds; return the text to show."""
        page = self._page
        console = SpectatorConsole(
            self._worlds[page.world],
            page.controls,
            number=page.world,
            camera=partial(self._camera, client),
            tail=self._tail,
            trusted=self._lock.allowed and self._lock.holder == client.client_id,
            refusal=self._refusal(),
        )
        return console.run(line)

    def _refusal(self) -> str:
        if not self._lock.allowed:
            return NOT_ALLOWED
        return SOMEBODY_ELSE if self._lock.holder is not None else TAKE_THEM

    def _camera(self, client: viser.ClientHandle) -> SpectatorCamera | None:
        """Return a user's viewpoint; None where worlds stand side by side."""
        if self._page.wall:
            return None
        spent = self._updates[-1] - self._updates[0] if self._updates else 0.0
        rate = (len(self._updates) - 1) / spent if spent else 0.0
        w, x, y, z = client.camera.wxyz
        # A camera of viser's looks along its z axis, and its y axis points down.
        right, down, ahead = Rotation.from_quat([x, y, z, w]).as_matrix().T
        return SpectatorCamera(np.array(client.camera.position), np.stack([ahead, -right, -down], 1), rate)


class UserConsole:
    """Console of one user."""

    def __init__(self, client: viser.ClientHandle, run: partial[str], page: "ViewerPage") -> None:
        self._run, self._page, self._text = run, page, ""
        gui = client.gui
        with gui.add_folder("Console", expand_by_default=False, order=1000):
            self._line = gui.add_text("Line", "help", hint="help, showlog, showdebug, editactor, pause")
            gui.add_button("Run").on_click(lambda _: page.post(self.enter))
            self._shown = gui.add_html("")

    def enter(self) -> None:
        """Carry out the line."""
        line = self._line.value.strip()
        self._text = f"{self._text}> {line}\n{self._run(line)}\n"[-MAX_SHOWN:]
        self._shown.content = f'<pre style="{STYLE}">{html.escape(self._text)}</pre>'
