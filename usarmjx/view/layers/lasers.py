"""What laser scanners see: fans, and points where their beams end."""

import numpy as np
import viser

from usarmjx.sensors.ranging import RangeScanner, fan_directions
from usarmjx.sensors.scanners import Scanner3DSettings, grid_directions
from usarmjx.view.drawing import Drawing, Frame
from usarmjx.view.layers.colors import robot_colors
from usarmjx.view.layers.mounts import DrawnSensor, HeldMounts, sensors_of
from usarmjx.view.layers.nodes import MeshNode, NodeLayer, PointNode

LONGEST_BEAM = 8.0
"""Beams that meet nothing are drawn no longer than this [m]; scanners see up to a kilometre far."""
FAN_OPACITY = 0.16
POINT_SIZE = 0.03
"""Radius of the points where beams end [m]."""


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


class LaserLayer(NodeLayer):
    """Fans of RangeScanner and IRScanner, and where beams end, also those of RangeScanner3D.

    Each scanner has nodes of its own: scans come one after the other, and only what is new is sent.
    """

    name = "Laser fans"
    about = "what laser scanners swept at their last scan, with a point where a beam met something"
    shown_at_first = True

    def draw(self, drawing: Drawing) -> None:
        """Look which scanners there are."""
        self._held = HeldMounts(sensors_of(drawing, RangeScanner))
        self._scans = [
            _Scan(self.scene, f"{self.root}/{number}", sensor)
            for number, sensor in enumerate(self._held.sensors)
        ]

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Show each scan where it was taken."""
        del drawing
        held = self._held
        for number in held.look(frame):
            rows = held.rows[number]
            self._scans[number].show(held.pos[rows], held.mat[rows.start], held.readings[number])


class _Scan:
    """One scanner's scan.

    Args:
        scene: Where to draw.
        path: Of its nodes.
        sensor: The scanner.
    """

    def __init__(self, scene: viser.SceneApi, path: str, sensor: DrawnSensor) -> None:
        settings = sensor.settings[0]
        self._directions, self._max_range = beam_directions_of(sensor), settings.max_range
        self._rgb = np.array(robot_colors(np.array(sensor.slot)))
        self._points = PointNode(scene, f"{path}/points", POINT_SIZE)
        self._fan: MeshNode | None = None
        if not isinstance(settings, Scanner3DSettings):  # whose beams fill a room
            self._fan = MeshNode(scene, f"{path}/fan", tuple(self._rgb.tolist()), FAN_OPACITY)
        self._faces = fan_faces(len(self._directions)).astype(np.uint32)

    def show(self, start: np.ndarray, mat: np.ndarray, ranges: np.ndarray) -> None:
        """Show where beams ended: from `start` [m] (1, 3), turned (3, 3), with ranges [m]: all or none."""
        if not len(ranges):
            self._points.set(start[:0], self._rgb)
            if self._fan is not None:
                self._fan.set(start[:0], self._faces[:0])
            return
        hit = (ranges > 0) & (ranges < self._max_range)
        drawn = np.where(hit, ranges, np.minimum(ranges, LONGEST_BEAM))
        ends = start + drawn[:, None] * (self._directions @ mat.T)
        self._points.set(ends[hit], self._rgb)
        if self._fan is not None:
            self._fan.set(np.concatenate([start, ends]), self._faces)
