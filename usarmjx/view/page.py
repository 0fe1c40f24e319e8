"""The live page: worlds in three dimensions in a browser, by viser."""

import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, TypeAlias

import viser

from usarmjx.view.drawing import Drawing, Frame, FrameSource
from usarmjx.view.panel import Panel

if TYPE_CHECKING:
    from usarmjx.view.controls import WorldControls

UPDATE_PERIOD = 1 / 20
"""The page is brought up to date so often at most [s]."""
PanelMaker: TypeAlias = Callable[["ViewerPage"], Panel]
"""Makes a panel of a page."""


class ViewerPage:
    """A page that shows worlds as they are; several people may look at it at once.

    Args:
        source: Where drawings and frames come from.
        host: Address to listen on.
        port: Port to listen on; 0: a free one.
        title: What stands over the page.
        controls: What may be done to the worlds; None: they are only shown.
        panels: What stands beside the picture.
        server: Who serves it; None: a server of its own.

    Attributes:
        server: Viser's server.
        source: Where drawings and frames come from.
        controls: What may be done to the worlds.
        world: The world that is looked at.
        drawing: Its drawing.
        frame: Its last frame.
        robot: Slot of the robot that was chosen last, by whom ever.
    """

    def __init__(
        self,
        source: FrameSource,
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        title: str = "",
        controls: "WorldControls | None" = None,
        panels: Sequence[PanelMaker] = (),
        server: viser.ViserServer | None = None,
    ) -> None:
        self.server = server or viser.ViserServer(host, port, label=title or None, verbose=False)
        self.source, self.controls, self.world = source, controls, 0
        self.robot: int | None = None
        self.drawing: Drawing = source.drawing(self.world)
        self.frame: Frame = source.frame(self.world)
        self.panels = [make(self) for make in panels]
        self._next_update = 0.0

    def update(self) -> None:
        """Show the worlds as they are; does nothing sooner than `UPDATE_PERIOD` after the last time."""
        now = time.monotonic()
        if now < self._next_update:
            return
        self._next_update = now + UPDATE_PERIOD
        self.drawing, self.frame = self.source.drawing(self.world), self.source.frame(self.world)
        for panel in self.panels:
            panel.update(self.drawing, self.frame)

    def close(self) -> None:
        """Hang up on everybody and free the port."""
        self.server.stop()
