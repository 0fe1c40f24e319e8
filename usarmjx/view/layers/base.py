"""Interface of layers: a class for each kind of overlay of a world."""

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np
import viser

from usarmjx.view.drawing import Drawing, Frame

ROBOT_COLORS = np.array(
    [
        (0, 180, 255),
        (255, 75, 105),
        (165, 255, 0),
        (105, 0, 240),
        (240, 180, 105),
        (105, 75, 0),
        (240, 195, 240),
        (135, 135, 0),
        (195, 90, 195),
        (60, 75, 120),
        (120, 255, 180),
        (135, 45, 60),
        (105, 105, 255),
        (150, 195, 0),
        (255, 120, 165),
        (120, 30, 180),
    ],
    np.uint8,
)
"""Red, green and blue of robots by slot, repeated after the last.

They were searched for, so that any two are far apart for people with normal, protanopic, deuteranopic and
tritanopic sight.
"""
SCALE = np.array([(213, 94, 0), (240, 228, 66), (0, 158, 115)], float)
"""Colours from bad over fair to good, distinct for the colour-blind, too (Okabe and Ito's colours)."""


def robot_colors(slots: np.ndarray) -> np.ndarray:
    """Return the colours of robots by slot, 0 to 255 (..., 3)."""
    return ROBOT_COLORS[np.asarray(slots, int) % len(ROBOT_COLORS)]


def scale_colors(share: np.ndarray) -> np.ndarray:
    """Return colours of shares from 0, bad, to 1, good (...,), 0 to 255 (..., 3)."""
    stops = np.linspace(0.0, 1.0, len(SCALE))
    columns = [np.interp(share, stops, SCALE[:, channel]) for channel in range(3)]
    return np.stack(columns, -1).astype(np.uint8)


class Layer(ABC):
    """An overlay of a world that users may hide.

    Attributes:
        name: Name of its switch.
        about: Description in one line.
        shown_at_first: Whether it is on when the page opens.
        alone: Whether no other world is shown beside its own.
    """

    name: ClassVar[str]
    about: ClassVar[str]
    shown_at_first: ClassVar[bool]
    alone: bool = True

    @abstractmethod
    def begin(self, scene: viser.SceneApi, drawing: Drawing, prefix: str) -> None:
        """Start with a new drawing: another world, or other robots.

        Args:
            scene: Scene of viser.
            drawing: Drawing of the world.
            prefix: Root path of the layer's nodes; it moves with the world.
        """

    @abstractmethod
    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Show the present frame of the world; called only while the layer is on."""

    @abstractmethod
    def show(self, on: bool) -> None:
        """Show or hide its nodes."""

    @abstractmethod
    def end(self) -> None:
        """Remove its nodes."""
