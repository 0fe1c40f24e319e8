"""What laser scanners see: fans, and points where their beams end."""

import numpy as np

from usarmjx.sensors.ranging import RangeScanner, fan_directions
from usarmjx.sensors.scanners import Scanner3DSettings, grid_directions
from usarmjx.view.drawing import Drawing, Frame
from usarmjx.view.layers.colors import robot_colors
from usarmjx.view.layers.mounts import DrawnSensor, HeldMounts, sensors_of
from usarmjx.view.layers.nodes import MeshNode, NodeLayer, PointNode

LONGEST_BEAM = 8.0
"""Beams that meet nothing are drawn no longer than this [m]; scanners see up to a kilometre far."""
FAN_RGB, FAN_OPACITY = (255, 84, 48), 0.14
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
    """Fans of RangeScanner and IRScanner, and where beams end, also those of RangeScanner3D."""

    name = "Laser fans"
    about = "what laser scanners swept at their last scan, with a point where a beam met something"
    shown_at_first = True

    def draw(self, drawing: Drawing) -> None:
        """Look which scanners there are."""
        self._held = HeldMounts(sensors_of(drawing, RangeScanner))
        self._directions = [beam_directions_of(sensor) for sensor in self._held.sensors]
        nothing = np.zeros((0, 3), np.float32)
        self._corners = [nothing for _ in self._held.sensors]
        self._hits = [nothing for _ in self._held.sensors]
        self._fans = MeshNode(self.scene, f"{self.root}/fans", FAN_RGB, FAN_OPACITY)
        self._points = PointNode(self.scene, f"{self.root}/points", POINT_SIZE)

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Show each scan where it was taken."""
        del drawing
        new = self._held.look(frame)
        if not new:
            return
        for number in new:
            self._take(number)
        flat = [len(self._corners[number]) for number in self._flat]
        starts = np.cumsum([0, *flat])[:-1].tolist()
        faces = [fan_faces(n - 1) + start for n, start in zip(flat, starts, strict=True)]
        corners = [self._corners[number] for number in self._flat]
        self._fans.set(_joined(corners), np.concatenate([np.zeros((0, 3), int), *faces]))
        slots = [sensor.slot for sensor in self._held.sensors]
        self._points.set(_joined(self._hits), robot_colors(np.repeat(slots, list(map(len, self._hits)))))

    @property
    def _flat(self) -> list[int]:
        """The scanners whose beams lie in a plane."""
        sensors = enumerate(self._held.sensors)
        return [n for n, sensor in sensors if not isinstance(sensor.settings[0], Scanner3DSettings)]

    def _take(self, number: int) -> None:
        """Work out where the beams of a scan ended."""
        held, ranges = self._held, self._held.readings[number]
        if not len(ranges):
            self._corners[number] = self._hits[number] = self._corners[number][:0]
            return
        hit = (ranges > 0) & (ranges < held.sensors[number].settings[0].max_range)
        drawn = np.where(hit, ranges, np.minimum(ranges, LONGEST_BEAM))
        start = held.pos[held.rows[number]]
        ends = start + drawn[:, None] * (self._directions[number] @ held.mat(number).T)
        self._corners[number] = np.concatenate([start, ends]).astype(np.float32)
        self._hits[number] = self._corners[number][1:][hit]


def _joined(parts: list[np.ndarray]) -> np.ndarray:
    return np.concatenate([np.zeros((0, 3), np.float32), *parts])
