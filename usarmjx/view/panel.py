"""Panels of the page: controls and figures beside the picture."""

from typing import Protocol

from usarmjx.view.drawing import Drawing, Frame


class Panel(Protocol):
    """Part of the page's sidebar."""

    def begin(self, drawing: Drawing) -> None:
        """Start with a new drawing: another world, or the robots in it are others."""
        ...

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Show the world as it is now."""
        ...
