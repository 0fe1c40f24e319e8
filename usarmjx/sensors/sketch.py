"""Overlays that sensors draw into camera pictures (manual 10.9.2, 10.10.2)."""

from usarmjx.base.backend import Array, xp
from usarmjx.base.nodes import Node


class OverlayLines(Node, kw_only=True):
    """Straight lines; a line of zero length is a point.

    Attributes:
        start: Start points [m] (lines, 3).
        end: End points [m] (lines, 3).
        rgb: Red, green and blue, 0 to 1 (lines, 3).
        shown: Which lines exist (lines,).
    """

    start: Array
    end: Array
    rgb: Array
    shown: Array


def empty_overlay(count: int) -> OverlayLines:
    """Return an overlay of `count` hidden lines."""
    nowhere = xp.zeros((count, 3))
    return OverlayLines(start=nowhere, end=nowhere, rgb=nowhere, shown=xp.zeros(count, bool))
