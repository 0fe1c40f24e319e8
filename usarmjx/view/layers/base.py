"""What can be switched on and off in the page: a class for each kind of thing that is drawn over a world."""

from abc import ABC, abstractmethod
from typing import ClassVar

import viser

from usarmjx.view.drawing import Drawing, Frame


class Layer(ABC):
    """Something drawn over a world that people may switch off.

    Attributes:
        name: What its switch is called.
        about: One line on what it shows.
        shown_at_first: Whether it is on when the page opens.
        alone: Whether no other world is shown beside the one that it is drawn over.
    """

    name: ClassVar[str]
    about: ClassVar[str]
    shown_at_first: ClassVar[bool]
    alone: bool = True

    @abstractmethod
    def begin(self, scene: viser.SceneApi, drawing: Drawing, prefix: str) -> None:
        """Start with a new drawing: another world, or the robots in it are others.

        Args:
            scene: Where to draw.
            drawing: What stays of the world's looks.
            prefix: Path in the scene below which the layer's nodes go; moves with the world.
        """

    @abstractmethod
    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Show the world as it is now; called only while the layer is on."""

    @abstractmethod
    def show(self, on: bool) -> None:
        """Show or hide its nodes."""

    @abstractmethod
    def end(self) -> None:
        """Remove its nodes."""
