"""What sensors draw into the pictures of cameras, so that one sees what they do (manual 10.9.2, 10.10.2)."""

from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp


class OverlayLines(struct.PyTreeNode, kw_only=True):
    """Straight lines; one that ends where it starts is a point.

    Attributes:
        start: Where they start [m] (lines, 3).
        end: Where they end [m] (lines, 3).
        rgb: Red, green and blue, 0 to 1 (lines, 3).
        shown: Which of them there are (lines,).
    """

    start: Array
    end: Array
    rgb: Array
    shown: Array


def no_overlay(count: int) -> OverlayLines:
    """Return an overlay with room for some lines, of which there is none."""
    nowhere = xp.zeros((count, 3))
    return OverlayLines(start=nowhere, end=nowhere, rgb=nowhere, shown=xp.zeros(count, bool))
