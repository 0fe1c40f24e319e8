"""Signs over the robots of a film: laser scans, rings, trails, and names."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from usarmjx.plots.films.raster import Canvas
from usarmjx.plots.films.views import FilmView
from usarmjx.sensors.ranging import RangeScanner, Scanner3DSettings
from usarmjx.view.drawing import Drawing, Frame
from usarmjx.view.layers.base import robot_colors
from usarmjx.view.layers.bodies import ReadingPoses, sensors_of
from usarmjx.view.layers.echoes import LONGEST_BEAM, beam_directions_of, fan_faces
from usarmjx.view.layers.marks import RING_GAP, RING_SHARE, heading_ring

FAN_OPACITY, SIGN_OPACITY = 0.13, 0.92
DOT_RADIUS, LEAST_DOT = 0.025, 1.1
"""Radius of dots where beams end [m], and its least value on the screen [pixels]."""
DOT_LIFT = 0.02
"""Distance by which dots are nearer to the camera than what they lie on [m]."""
TRAIL_STEP, TRAIL_LENGTH, TRAIL_LIFT = 0.08, 250, 0.03
"""Distance between two dots of a trail [m], their greatest number, and their height above the ground [m]."""


@dataclass(frozen=True, eq=False)
class Overlay:
    """Triangles of plain colours.

    Attributes:
        corners: Corners [m] (n, 3, 3).
        rgb: Colours, 0 to 255 (n, 3).
        opacity: In [0, 1].
    """

    corners: np.ndarray
    rgb: np.ndarray
    opacity: float

    def mix(self, rgb: np.ndarray, canvas: Canvas, view: FilmView) -> None:
        """Mix them into a picture where nothing is nearer.

        Args:
            rgb: Colours, 0 to 255 uint8 (pixels, 3); changed in place.
            canvas: What is there.
            view: The view.
        """
        if not len(self.corners):
            return
        own = Canvas(view.width, view.height)
        view.draw(own, self.corners, np.arange(len(self.corners)))
        triangle, nearness = own.surface()
        pixels = np.flatnonzero((triangle >= 0) & (nearness > canvas.surface().nearness))
        colours = self.rgb[triangle[pixels]]
        mixed = rgb[pixels] + self.opacity * (colours - rgb[pixels].astype(np.float32))
        rgb[pixels] = np.floor(mixed + 0.5).astype(np.uint8)


class Signs:
    """Signs over the robots of a drawing, frame by frame.

    Args:
        drawing: The drawing.
    """

    def __init__(self, drawing: Drawing) -> None:
        self._drawing = drawing
        self._scans = ReadingPoses(sensors_of(drawing, RangeScanner))
        self._directions = [beam_directions_of(sensor) for sensor in self._scans.sensors]
        self._trails: dict[int, deque[np.ndarray]] = {}

    def overlays(self, frame: Frame, view: FilmView) -> list[Overlay]:
        """Return the signs of a frame: fans below, dots and rings above."""
        self._scans.update(frame)
        fans, fan_rgb, dots, dot_rgb = (
            list[np.ndarray](),
            list[np.ndarray](),
            list[np.ndarray](),
            list[np.ndarray](),
        )
        for number, sensor in enumerate(self._scans.sensors):
            ranges, rows = self._scans.readings[number], self._scans.rows[number]
            if not len(ranges):
                continue
            start, mat = self._scans.pos[rows][:1], self._scans.mat[rows.start]
            settings, colour = sensor.settings[0], robot_colors(np.array(sensor.slot))
            hit = (ranges > 0) & (ranges < settings.max_range)
            drawn = np.where(hit, ranges, np.minimum(ranges, LONGEST_BEAM))
            ends = start + drawn[:, None] * (self._directions[number] @ mat.T)
            dots.append(ends[hit])
            dot_rgb.append(np.tile(colour, (int(hit.sum()), 1)))
            if not isinstance(settings, Scanner3DSettings):
                fans.append(np.concatenate([start, ends])[fan_faces(len(ends))])
                fan_rgb.append(np.tile(colour, (len(fans[-1]), 1)))
        rings, ring_rgb = self._rings(frame)
        trail, trail_rgb = self._trail(frame)
        points = np.concatenate([np.zeros((0, 3)), *dots, *trail])
        rgb = np.concatenate([np.zeros((0, 3)), *dot_rgb, *trail_rgb])
        return [
            Overlay(
                np.concatenate([np.zeros((0, 3, 3)), *fans]),
                np.concatenate([np.zeros((0, 3)), *fan_rgb]),
                FAN_OPACITY,
            ),
            Overlay(
                np.concatenate([_diamonds(points, view), *rings]),
                np.concatenate([np.repeat(rgb, 2, 0), *ring_rgb]),
                SIGN_OPACITY,
            ),
        ]

    def _rings(self, frame: Frame) -> tuple[list[np.ndarray], list[np.ndarray]]:
        vertices, faces = heading_ring()
        shapes, colours = list[np.ndarray](), list[np.ndarray]()
        for slot in frame.robots.keys() & self._drawing.robots.keys():
            robot, size = frame.robots[slot], self._drawing.robots[slot].dimensions
            radius = RING_SHARE * size[:2] / 2 + RING_GAP
            w, x, y, z = robot.quat.tolist()
            yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
            turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
            own = vertices * [*radius, radius.max()] @ turn.T + robot.pos
            shapes.append(own[faces])
            colours.append(np.tile(robot_colors(np.array(slot)), (len(faces), 1)))
        return shapes, colours

    def _trail(self, frame: Frame) -> tuple[list[np.ndarray], list[np.ndarray]]:
        points, colours = list[np.ndarray](), list[np.ndarray]()
        for slot, robot in frame.robots.items():
            if slot not in self._drawing.robots:
                continue
            trail = self._trails.setdefault(slot, deque(maxlen=TRAIL_LENGTH))
            below = float(self._drawing.robots[slot].dimensions[2]) / 2 - TRAIL_LIFT
            here = np.asarray(robot.pos, float) - (0.0, 0.0, below)
            if not trail or np.linalg.norm(here - trail[-1]) > TRAIL_STEP:
                trail.append(here)
            points.append(np.array(trail))
            colours.append(np.tile(robot_colors(np.array(slot)), (len(trail), 1)))
        return points, colours


def _diamonds(points: np.ndarray, view: FilmView) -> np.ndarray:
    """Return squares on their tips that face a view, two triangles for each point (2 * n, 3, 3)."""
    way = view.eye - points
    distance = np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), 1e-6)
    middle = points + np.minimum(DOT_LIFT, distance / 2) * way / distance
    _, depth = view.project(middle)
    radius = np.maximum(DOT_RADIUS, LEAST_DOT * np.maximum(depth, 0.0) / view.focal)[:, None]
    right, up = radius * view.axes[:, 0], radius * view.axes[:, 1]
    tips = np.stack([middle + right, middle + up, middle - right, middle - up], 1)
    return tips[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 3)
