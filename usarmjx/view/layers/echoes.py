"""What sonars hear and infrared sensors see: cones and lines as long as what they told."""

import math
from collections import defaultdict

import numpy as np

from usarmjx.sensors.ranging import Ir, Sonar
from usarmjx.view.drawing import Drawing, Frame
from usarmjx.view.layers.colors import robot_colors
from usarmjx.view.layers.mounts import DrawnSensor, Held, quats_of, sensors_of
from usarmjx.view.layers.nodes import InstanceNode, LineNode, NodeLayer, PointNode

CONE_OPACITY = 0.22
CONE_SIDES, CAP_RINGS = 16, 3
IR_RGB = np.array((230, 0, 180), np.uint8)
IR_POINT_SIZE = 0.06
"""Of the points where infrared lines end [m]."""


def sound_cone(angle: float) -> tuple[np.ndarray, np.ndarray]:
    """Return corners (corners, 3) and triangles (triangles, 3) of a cone about the x axis.

    Its tip is corner 0, and all other corners are 1 away from it, on rings around the axis, as sound is.

    Args:
        angle: Full angle of the cone [rad].
    """
    around = 2 * math.pi * np.arange(CONE_SIDES) / CONE_SIDES
    corners, faces = [np.zeros((1, 3))], list[np.ndarray]()
    this = np.arange(CONE_SIDES)
    following = (this + 1) % CONE_SIDES
    for ring in range(CAP_RINGS):
        tilt = angle / 2 * (CAP_RINGS - ring) / CAP_RINGS
        circle = np.stack([np.cos(around), np.sin(around)], -1) * math.sin(tilt)
        corners.append(np.column_stack([np.full(CONE_SIDES, math.cos(tilt)), circle]))
        inner, outer = 1 + ring * CONE_SIDES, 1 + (ring - 1) * CONE_SIDES
        if ring == 0:
            faces.append(np.stack([0 * this, inner + following, inner + this], -1))
        else:
            faces.append(np.stack([outer + this, outer + following, inner + following], -1))
            faces.append(np.stack([outer + this, inner + following, inner + this], -1))
    corners.append(np.array([[1.0, 0.0, 0.0]]))
    last = 1 + (CAP_RINGS - 1) * CONE_SIDES
    faces.append(np.stack([last + this, last + following, np.full(CONE_SIDES, last + CONE_SIDES)], -1))
    return np.concatenate(corners), np.concatenate(faces)


def _rows(reading: np.ndarray, pos: np.ndarray, mat: np.ndarray) -> np.ndarray:
    """Return range, position and orientation, w first, of each mount (mounts, 8)."""
    quat = quats_of(mat)
    return np.concatenate([reading.reshape(-1, 1), pos, quat], -1)


class SonarLayer(NodeLayer):
    """Cones of sonars."""

    name = "Sonar cones"
    about = "the cones of sonars, as long as what they told last"
    shown_at_first = False

    def draw(self, drawing: Drawing) -> None:
        """Look which sonars there are; those with the same angle are instances of one cone."""
        self._held = [Held(sensor, _rows) for sensor in sensors_of(drawing, Sonar)]
        self._cones: dict[float, InstanceNode] = {}

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Show each cone where its range was taken."""
        del drawing
        rows: dict[float, list[np.ndarray]] = defaultdict(list)
        colors: dict[float, list[np.ndarray]] = defaultdict(list)
        for held in self._held:
            own = held.at(frame)
            if own is None:
                continue
            angles = np.array([settings.beam_angle for settings in held.sensor.settings])
            for angle in np.unique(angles):
                same = own[(angles == angle) & (own[:, 0] > 0)]
                rows[angle].append(same)
                color = robot_colors(np.array(held.sensor.slot))
                colors[angle].append(np.broadcast_to(color, (len(same), 3)))
        for angle in self._cones.keys() | rows.keys():
            if angle not in self._cones:
                name = f"{self.root}/{math.degrees(angle):.1f}".replace(".", "_")
                self._cones[angle] = InstanceNode(self.scene, name, sound_cone(angle), opacity=CONE_OPACITY)
            whole = np.concatenate([np.zeros((0, 8)), *rows[angle]])
            rgb = np.concatenate([np.zeros((0, 3), np.uint8), *colors[angle]])
            self._cones[angle].set(whole[:, 1:4], whole[:, 4:], whole[:, 0], rgb)


def _line(reading: np.ndarray, pos: np.ndarray, mat: np.ndarray) -> np.ndarray:
    """Return where each mount's line starts and ends (mounts, 2, 3)."""
    return np.stack([pos, pos + reading.reshape(-1, 1) * mat[:, :, 0]], 1)


class InfraredLayer(NodeLayer):
    """Lines of infrared sensors."""

    name = "Infrared lines"
    about = "the lines of infrared range sensors, as long as what they told last"
    shown_at_first = False

    def draw(self, drawing: Drawing) -> None:
        """Look which sensors there are."""
        self._held = [Held(sensor, _line) for sensor in sensors_of(drawing, Ir)]
        self._lines = LineNode(self.scene, f"{self.root}/lines")
        self._points = PointNode(self.scene, f"{self.root}/points", IR_POINT_SIZE)

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Show each line where its range was taken."""
        del drawing
        made = [(held.sensor, held.at(frame)) for held in self._held]
        ends = np.concatenate([np.zeros((0, 2, 3)), *(own for _, own in made if own is not None)])
        hits = [_hits(sensor, own) for sensor, own in made if own is not None]
        points = np.concatenate([np.zeros((0, 3)), *hits])
        self._lines.set(ends, IR_RGB)
        self._points.set(points, np.broadcast_to(IR_RGB, points.shape))


def _hits(sensor: DrawnSensor, ends: np.ndarray) -> np.ndarray:
    """Return where lines end that met something (hits, 3)."""
    farthest = np.array([settings.max_range for settings in sensor.settings])
    return ends[np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1) < farthest - 1e-4, 1]
