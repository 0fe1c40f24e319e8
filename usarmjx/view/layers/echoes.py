"""Last readings of range sensors: laser fans, sonar cones and infrared lines."""

import math

import numpy as np
import viser

from usarmjx.base.backend import numpy_backend
from usarmjx.base.rotations import mat_from_quat
from usarmjx.sensors.ranging import (
    Ir,
    RangeScanner,
    Scanner3DSettings,
    Sonar,
    fan_directions,
    grid_directions,
)
from usarmjx.view.drawing import Drawing, Frame
from usarmjx.view.layers.base import InstanceNode, LineNode, MeshNode, NodeLayer, PointNode, robot_colors
from usarmjx.view.layers.bodies import DrawnSensor, ReadingPoses, sensors_of

LONGEST_BEAM = 8.0
"""Longest drawn beam without an echo [m]; scanners reach up to a kilometre."""
FAN_OPACITY = 0.16
POINT_SIZE = 0.03
"""Radius of the points at the beams' ends [m]."""
CONE_OPACITY = 0.22
CONE_SIDES, CAP_RINGS = 16, 3
IR_RGB = np.array((230, 0, 180), np.uint8)
IR_POINT_SIZE = 0.03
"""Radius of the points at the ends of infrared lines [m]."""


def beam_directions_of(sensor: DrawnSensor) -> np.ndarray:
    """Return the unit directions of a scanner's beams about its x axis (beams, 3)."""
    settings = sensor.settings[0]
    if isinstance(settings, Scanner3DSettings):
        return grid_directions(settings).reshape(-1, 3)
    return fan_directions(settings)


def fan_faces(beams: int) -> np.ndarray:
    """Return the triangles of a fan (beams - 1, 3): corner 0 is its tip, the others are the beams' ends."""
    first = np.arange(1, beams)
    # A beam has no triangle with the first one again: a scan of less than a full turn stays open.
    return np.stack([np.zeros_like(first), first, first + 1], -1)


class LaserLayer(NodeLayer):
    """Fans of RangeScanner and IRScanner, and the beams' ends, also those of RangeScanner3D.

    Each scanner has nodes of its own: scans come one after the other, and only new ones are sent.
    """

    name = "Laser fans"
    about = "what laser scanners swept at their last scan, with a point where a beam met something"
    shown_at_first = True

    def draw(self, drawing: Drawing) -> None:
        """Collect the scanners."""
        self._held = ReadingPoses(sensors_of(drawing, RangeScanner))
        self._scans = [
            _Scan(self.scene, f"{self.root}/{number}", sensor)
            for number, sensor in enumerate(self._held.sensors)
        ]

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Show each scan at the pose of its scanner then."""
        del drawing
        held = self._held
        for number in held.update(frame):
            rows = held.rows[number]
            self._scans[number].show(held.pos[rows], held.mat[rows.start], held.readings[number])


class _Scan:
    """Scan of one scanner.

    Args:
        scene: Scene of viser.
        path: Path of its nodes.
        sensor: The scanner.
    """

    def __init__(self, scene: viser.SceneApi, path: str, sensor: DrawnSensor) -> None:
        settings = sensor.settings[0]
        self._directions, self._max_range = beam_directions_of(sensor), settings.max_range
        self._rgb = np.array(robot_colors(np.array(sensor.slot)))
        self._points = PointNode(scene, f"{path}/points", POINT_SIZE)
        self._fan: MeshNode | None = None
        if not isinstance(settings, Scanner3DSettings):  # the fan of a 3D scanner would fill the room
            self._fan = MeshNode(scene, f"{path}/fan", tuple(self._rgb.tolist()), FAN_OPACITY)
        self._faces = fan_faces(len(self._directions)).astype(np.uint32)

    def show(self, start: np.ndarray, mat: np.ndarray, ranges: np.ndarray) -> None:
        """Show the beams' ends: from `start` [m] (1, 3), turned (3, 3), with ranges [m]: all or none."""
        if not len(ranges):
            self._points.set(start[:0], self._rgb)
            if self._fan is not None:
                self._fan.set(start[:0], self._faces[:0])
            return
        # A beam without an echo reports its largest range.
        hit = (ranges > 0) & (ranges < self._max_range)
        # Beams without an echo are cut short, or the fan would cover the whole arena.
        drawn = np.where(hit, ranges, np.minimum(ranges, LONGEST_BEAM))
        ends = start + drawn[:, None] * (self._directions @ mat.T)
        self._points.set(ends[hit], self._rgb)
        if self._fan is not None:
            self._fan.set(np.concatenate([start, ends]), self._faces)


def sound_cone(angle: float) -> tuple[np.ndarray, np.ndarray]:
    """Return corners (corners, 3) and triangles (triangles, 3) of a cone about the x axis.

    Its tip is corner 0; all other corners are at distance 1 from it, on rings around the axis, like a wave
    front.

    Args:
        angle: Full angle of the cone [rad].
    """
    around = 2 * math.pi * np.arange(CONE_SIDES) / CONE_SIDES
    corners, faces = [np.zeros((1, 3))], list[np.ndarray]()
    this = np.arange(CONE_SIDES)
    following = (this + 1) % CONE_SIDES
    for ring in range(CAP_RINGS):
        # Rings shrink towards the axis, so the last corner closes the cap.
        tilt = angle / 2 * (CAP_RINGS - ring) / CAP_RINGS
        circle = np.stack([np.cos(around), np.sin(around)], -1) * math.sin(tilt)
        corners.append(np.column_stack([np.full(CONE_SIDES, math.cos(tilt)), circle]))
        inner, outer = 1 + ring * CONE_SIDES, 1 + (ring - 1) * CONE_SIDES
        # The outermost ring meets the tip; each other one meets the ring around it.
        if ring == 0:
            faces.append(np.stack([0 * this, inner + following, inner + this], -1))
        else:
            faces.append(np.stack([outer + this, outer + following, inner + following], -1))
            faces.append(np.stack([outer + this, inner + following, inner + this], -1))
    # The middle of the cap, on the axis.
    corners.append(np.array([[1.0, 0.0, 0.0]]))
    last = 1 + (CAP_RINGS - 1) * CONE_SIDES
    faces.append(np.stack([last + this, last + following, np.full(CONE_SIDES, last + CONE_SIDES)], -1))
    return np.concatenate(corners), np.concatenate(faces)


class SonarLayer(NodeLayer):
    """Cones of sonars."""

    name = "Sonar cones"
    about = "the cones of sonars, as long as what they told last"
    shown_at_first = False

    def draw(self, drawing: Drawing) -> None:
        """Collect the sonars; those with the same angle are instances of one cone."""
        self._held = ReadingPoses(sensors_of(drawing, Sonar))
        angles = np.array([one.beam_angle for sensor in self._held.sensors for one in sensor.settings])
        self._cones = [
            (
                np.flatnonzero(angles == angle),
                InstanceNode(self.scene, f"{self.root}/{n}", sound_cone(angle), opacity=CONE_OPACITY),
            )
            for n, angle in enumerate(np.unique(angles).tolist())
        ]
        self._rgb = robot_colors(_slots(self._held))

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Show each cone at the pose of its sonar then."""
        del drawing
        if not self._held.update(frame):
            return
        ranges = _ranges(self._held)
        for same, node in self._cones:
            # A scale of 0 would send a cone that no one sees.
            rows = same[ranges[same] > 0]
            # A cone of length 1, scaled to the range.
            node.set(self._held.pos[rows], self._held.quat[rows], ranges[rows], self._rgb[rows])


class InfraredLayer(NodeLayer):
    """Lines of infrared sensors."""

    name = "Infrared lines"
    about = "the lines of infrared range sensors, as long as what they told last"
    shown_at_first = False

    def draw(self, drawing: Drawing) -> None:
        """Collect the sensors."""
        self._held = ReadingPoses(sensors_of(drawing, Ir))
        settings = [one for sensor in self._held.sensors for one in sensor.settings]
        self._max_range = np.array([one.max_range for one in settings], np.float32)
        self._lines = LineNode(self.scene, f"{self.root}/lines")
        self._points = PointNode(self.scene, f"{self.root}/points", IR_POINT_SIZE)

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Show each line at the pose of its sensor then."""
        del drawing
        if not self._held.update(frame):
            return
        ranges = _ranges(self._held)
        with numpy_backend():
            ahead = np.asarray(mat_from_quat(self._held.quat))[:, :, 0]
        ends = np.stack([self._held.pos, self._held.pos + ranges[:, None] * ahead], 1)
        # A line that ends at its full range has met nothing, and has no point there.
        points = ends[(ranges > 0) & (ranges < self._max_range), 1]
        self._lines.set(ends[ranges > 0], IR_RGB)
        self._points.set(points, np.broadcast_to(IR_RGB, points.shape))


def _slots(held: ReadingPoses) -> np.ndarray:
    """Return the slot of each mount's robot (mounts,)."""
    return np.array([sensor.slot for sensor in held.sensors for _ in sensor.settings], int)


def _ranges(held: ReadingPoses) -> np.ndarray:
    """Return each mount's range [m], 0 while its robot is absent (mounts,)."""
    ranges = np.zeros(len(held.pos), np.float32)
    for rows, reading in zip(held.rows, held.readings, strict=True):
        if len(reading):
            ranges[rows] = reading
    return ranges
