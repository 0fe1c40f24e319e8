"""What sensors and the Trace command draw into pictures: lines to tags, hits of victim sensors, trails."""

from collections.abc import Sequence

import numpy as np

from usarmjx.sensors.sketch import OverlayLines
from usarmjx.view.drawing import Drawing, Frame
from usarmjx.view.layers.nodes import LineNode, NodeLayer, PointNode

HIT_SIZE, TRAIL_SIZE = 0.02, 0.035
"""Radii of the points of victim sensors and of trails [m]."""


NO_SKETCHES = np.zeros((0, 2, 3)), np.zeros((0, 3), np.uint8), np.zeros((0, 3)), np.zeros((0, 3), np.uint8)


def split_sketches(sketches: Sequence[OverlayLines]) -> tuple[np.ndarray, ...]:
    """Return lines and points of sketches.

    Returns:
        Where lines start and end [m] (lines, 2, 3), their colours, 0 to 255 (lines, 3), points [m]
        (points, 3), and their colours (points, 3).
    """
    if not sketches:
        return NO_SKETCHES
    shown = [np.asarray(one.shown, bool) for one in sketches]
    start, end, rgb = (
        np.concatenate(
            [
                np.zeros((0, 3)),
                *(np.asarray(getattr(one, name))[own] for one, own in zip(sketches, shown, strict=True)),
            ]
        )
        for name in ("start", "end", "rgb")
    )
    colors = (np.clip(rgb, 0.0, 1.0) * 255).astype(np.uint8)
    is_point = (start == end).all(-1)
    ends = np.stack([start, end], 1)
    return ends[~is_point], colors[~is_point], end[is_point], colors[is_point]


class RfidLayer(NodeLayer):
    """Lines from RFID sensors with bTraceRFIDs to tags."""

    name = "RFID lines"
    about = "lines to the tags near sensors with bTraceRFIDs: green strong, red weak, black out of reach"
    shown_at_first = True

    def draw(self, drawing: Drawing) -> None:
        """Nothing stays."""
        del drawing
        self._lines = LineNode(self.scene, f"{self.root}/lines", width=3.0)

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Show the lines of the last readings."""
        del drawing
        ends, rgb, _, _ = split_sketches(frame.overlays)
        self._lines.set(ends, rgb)


class VictimHitLayer(NodeLayer):
    """Where the rays of victim sensors with bShowResults ended."""

    name = "Victim hits"
    about = "where rays of victim sensors with bShowResults ended: green on a victim, yellow on a false alarm"
    shown_at_first = True

    def draw(self, drawing: Drawing) -> None:
        """Nothing stays."""
        del drawing
        self._points = PointNode(self.scene, f"{self.root}/points", HIT_SIZE)

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Show the points of the last readings."""
        del drawing
        _, _, points, rgb = split_sketches(frame.overlays)
        self._points.set(points, rgb)


class TrailLayer(NodeLayer):
    """The points that the Trace command lets robots leave behind."""

    name = "Trails"
    about = "the points that robots leave behind since Trace was sent, in its colour"
    shown_at_first = True

    def draw(self, drawing: Drawing) -> None:
        """Nothing stays."""
        del drawing
        self._points = PointNode(self.scene, f"{self.root}/points", TRAIL_SIZE)

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Show all points."""
        del drawing
        _, _, points, rgb = split_sketches(() if frame.trace is None else (frame.trace,))
        self._points.set(points, rgb)
