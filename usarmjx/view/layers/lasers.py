"""What laser scanners see: fans, and points where their beams end."""

import numpy as np

from usarmjx.sensors.ranging import RangeScanner, fan_directions
from usarmjx.sensors.scanners import Scanner3DSettings, grid_directions
from usarmjx.view.drawing import Drawing, Frame
from usarmjx.view.layers.colors import robot_colors
from usarmjx.view.layers.mounts import DrawnSensor, Held, sensors_of
from usarmjx.view.layers.nodes import MeshNode, NodeLayer, PointNode

LONGEST_BEAM = 20.0
"""Beams that meet nothing are drawn no longer than this [m]; scanners see up to a kilometre far."""
FAN_RGB, FAN_OPACITY = (255, 84, 48), 0.16
POINT_SIZE = 0.05
"""Of the points where beams end [m]."""


def beam_directions_of(sensor: DrawnSensor) -> np.ndarray:
    """Return the unit directions of a scanner's beams about its x axis (beams, 3)."""
    settings = sensor.settings[0]
    if isinstance(settings, Scanner3DSettings):
        return grid_directions(settings).reshape(-1, 3)
    return fan_directions(settings)


def fan_faces(beams: int) -> np.ndarray:
    """Return the triangles of a fan (beams - 1, 3): corner 0 is its tip, the others are the beams' ends."""
    first = np.arange(1, beams)
    return np.stack([np.zeros_like(first), first, first + 1], -1)


class _Scan:
    """The corners of one scanner's scan: where it was, then where its beams ended."""

    def __init__(self, sensor: DrawnSensor) -> None:
        self.slot = sensor.slot
        self.directions = beam_directions_of(sensor)
        self.is_flat = not isinstance(sensor.settings[0], Scanner3DSettings)
        self._max_range = sensor.settings[0].max_range
        self._held = Held(sensor, self._corners)
        self.hit = np.zeros(len(self.directions), bool)

    def _corners(self, reading: np.ndarray, pos: np.ndarray, mat: np.ndarray) -> np.ndarray:
        ranges = reading.reshape(-1)
        self.hit = (ranges > 0) & (ranges < self._max_range)
        drawn = np.where(self.hit, ranges, np.minimum(ranges, LONGEST_BEAM))
        ends = pos + drawn[:, None] * (self.directions @ mat[0].T)
        return np.concatenate([pos, ends]).astype(np.float32)

    def at(self, frame: Frame) -> np.ndarray | None:
        return self._held.at(frame)


class LaserLayer(NodeLayer):
    """Fans of RangeScanner and IRScanner, and where beams end, also those of RangeScanner3D."""

    name = "Laser fans"
    about = "what laser scanners swept at their last scan, with a point where a beam met something"
    shown_at_first = True

    def draw(self, drawing: Drawing) -> None:
        """Look which scanners there are."""
        self._scans = [_Scan(sensor) for sensor in sensors_of(drawing, RangeScanner)]
        self._fans = MeshNode(self.scene, f"{self.root}/fans", FAN_RGB, FAN_OPACITY)
        self._points = PointNode(self.scene, f"{self.root}/points", POINT_SIZE)

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Show each scan where it was taken."""
        del drawing
        corners, faces, points, colors, count = [], [], [], [], 0
        for scan in self._scans:
            own = scan.at(frame)
            if own is None:
                continue
            points.append(own[1:][scan.hit])
            colors.append(np.broadcast_to(robot_colors(np.array(scan.slot)), points[-1].shape))
            if scan.is_flat:
                corners.append(own)
                faces.append(fan_faces(len(own) - 1) + count)
                count += len(own)
        none, no_rgb = np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8)
        self._fans.set(np.concatenate([none, *corners]), np.concatenate([np.zeros((0, 3), int), *faces]))
        self._points.set(np.concatenate([none, *points]), np.concatenate([no_rgb, *colors]))
