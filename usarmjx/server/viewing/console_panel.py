"""The spectator's console on the live page: a line to type, for whoever has the controls."""

import html
import time
from collections import deque
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import viser
from scipy.spatial.transform import Rotation

from usarmjx.server.console import NOT_ALLOWED, SpectatorConsole, WatchingCamera
from usarmjx.server.log_tail import LogTail
from usarmjx.server.worlds.served_world import ServedWorld
from usarmjx.view.controls import ControlSeat
from usarmjx.view.drawing import Drawing, Frame

if TYPE_CHECKING:
    from usarmjx.view.page import ViewerPage

MAX_SHOWN = 8000
"""So much of what the console has answered stays [characters]."""
MANY_UPDATES = 20
"""How many updates a second there are is told of the last so many."""
TAKE_THEM = "take the controls first"
SOMEBODY_ELSE = "this is for who has the controls, and that is somebody else"
STYLE = "font-size:.75em;margin:0 1em .5em;max-height:16em;overflow:auto;white-space:pre-wrap"


class ConsolePanel:
    """A `view.panel.Panel`: a console for each person at the page.

    Who has the controls may use all of it, the others may look: see `console.SpectatorConsole`.

    Args:
        page: The page.
        worlds: What it shows, by number.
        seat: Who has the controls.
        tail: The log; None: it is not kept.
    """

    def __init__(
        self,
        page: "ViewerPage",
        worlds: Sequence[ServedWorld],
        seat: ControlSeat,
        tail: LogTail | None = None,
    ) -> None:
        self._page, self._worlds, self._seat, self._tail = page, worlds, seat, tail
        self._people: dict[int, PersonConsole] = {}
        self._updates: deque[float] = deque(maxlen=MANY_UPDATES)

    def begin(self, drawing: Drawing) -> None:
        """What is shown makes no difference."""

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Give those who have come a console."""
        self._updates.append(time.monotonic())
        onlookers = self._page.onlookers
        for number in self._people.keys() - onlookers.keys():
            del self._people[number]
        for number, onlooker in onlookers.items():
            if number not in self._people:
                self._people[number] = PersonConsole(
                    onlooker.client, partial(self.run, onlooker.client), self._page
                )

    def run(self, client: viser.ClientHandle, line: str) -> str:
        """Carry out a person's line, in the thread that runs the worlds; return what to show."""
        page = self._page
        console = SpectatorConsole(
            self._worlds[page.world],
            page.controls,
            number=page.world,
            camera=partial(self._camera, client),
            tail=self._tail,
            trusted=self._seat.allowed and self._seat.holder == client.client_id,
            refusal=self._refusal(),
        )
        return console.run(line)

    def _refusal(self) -> str:
        if not self._seat.allowed:
            return NOT_ALLOWED
        return SOMEBODY_ELSE if self._seat.holder is not None else TAKE_THEM

    def _camera(self, client: viser.ClientHandle) -> WatchingCamera | None:
        """Return from where a person looks; None where worlds stand side by side."""
        if self._page.wall:
            return None
        spent = self._updates[-1] - self._updates[0] if self._updates else 0.0
        rate = (len(self._updates) - 1) / spent if spent else 0.0
        w, x, y, z = client.camera.wxyz
        # A camera of viser's looks along its z axis, and its y axis points down.
        right, down, ahead = Rotation.from_quat([x, y, z, w]).as_matrix().T
        return WatchingCamera(np.array(client.camera.position), np.stack([ahead, -right, -down], 1), rate)


class PersonConsole:
    """One person's console."""

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
