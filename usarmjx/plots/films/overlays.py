"""Signs on the pictures of a film: laser scans, rings, trails, names, and a line with time and score."""

from collections import deque
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from usarmjx.plots.films.raster import Canvas, FilmView
from usarmjx.sensors.ranging import RangeScanner, Scanner3DSettings
from usarmjx.view.drawing import Drawing, Frame
from usarmjx.view.layers.base import robot_colors
from usarmjx.view.layers.bodies import ReadingPoses, sensors_of
from usarmjx.view.layers.echoes import LONGEST_BEAM, beam_directions_of, fan_faces
from usarmjx.view.layers.marks import NAME_GAP, RING_GAP, RING_SHARE, heading_ring

FAN_OPACITY, SIGN_OPACITY = 0.13, 0.92
DOT_RADIUS, LEAST_DOT = 0.025, 1.1
"""Radius of dots where beams end [m], and its least value on the screen [pixels]."""
DOT_LIFT = 0.02
"""Distance by which dots are nearer to the camera than what they lie on [m]."""
TRAIL_STEP, TRAIL_LENGTH, TRAIL_LIFT = 0.08, 250, 0.03
"""Distance between two dots of a trail [m], their greatest number, and their height above the ground [m]."""
NAME_SHARE, LINE_SHARE, LEAST_TEXT = 0.026, 0.034, 11
"""Heights of names and of the line, as shares of the picture's height, and the least height [pixels]."""
PLATE, INK = (20, 24, 30, 190), (255, 255, 255, 255)
"""Colours behind texts and of texts, red, green, blue and opacity."""


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
            canvas: The solids drawn so far.
            view: The view.
        """
        if not len(self.corners):
            return
        # On a canvas of its own: within an overlay the nearest sign counts, and the opacity once.
        own = Canvas(view.width, view.height)
        view.draw(own, self.corners, np.arange(len(self.corners)))
        triangle, nearness = own.surface()
        pixels = np.flatnonzero((triangle >= 0) & (nearness > canvas.surface().nearness))
        colours = self.rgb[triangle[pixels]]
        mixed = rgb[pixels] + self.opacity * (colours - rgb[pixels].astype(np.float32))
        # Rounded: a cast to integers cuts, and several overlays would darken the picture.
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
        # An empty first part: a frame may have neither dots nor trails.
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
                # Each point is a diamond of two triangles.
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
            # The heading alone: rings lie flat however their robot leans.
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
            # A robot's position is that of its middle.
            below = float(self._drawing.robots[slot].dimensions[2]) / 2 - TRAIL_LIFT
            here = np.asarray(robot.pos, float) - (0.0, 0.0, below)
            # By distance and not by time, so that a standing robot does not push out its trail.
            if not trail or np.linalg.norm(here - trail[-1]) > TRAIL_STEP:
                trail.append(here)
            points.append(np.array(trail))
            colours.append(np.tile(robot_colors(np.array(slot)), (len(trail), 1)))
        return points, colours


def _diamonds(points: np.ndarray, view: FilmView) -> np.ndarray:
    """Return squares on their tips that face a view, two triangles for each point (2 * n, 3, 3)."""
    way = view.eye - points
    distance = np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), 1e-6)
    # Half way at most, or a dot before the eye would get behind it.
    middle = points + np.minimum(DOT_LIFT, distance / 2) * way / distance
    _, depth = view.project(middle)
    radius = np.maximum(DOT_RADIUS, LEAST_DOT * np.maximum(depth, 0.0) / view.focal)[:, None]
    right, up = radius * view.axes[:, 0], radius * view.axes[:, 1]
    tips = np.stack([middle + right, middle + up, middle - right, middle - up], 1)
    return tips[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 3)


@lru_cache(maxsize=8)
def _font(height: int, bold: bool) -> ImageFont.FreeTypeFont:
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    # Matplotlib brings this font; a system may have none.
    return ImageFont.truetype(str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / name), height)


def write_captions(
    picture: np.ndarray, drawing: Drawing, frame: Frame, view: FilmView, line: str
) -> np.ndarray:
    """Return a picture (height, width, 3) with names over robots and a line in a corner.

    Args:
        picture: Colours, 0 to 255 uint8 (height, width, 3).
        drawing: Drawing of the world.
        frame: The frame.
        view: The view.
        line: Text of the line; empty: none.
    """
    sheet = Image.fromarray(picture).convert("RGBA")
    # On a sheet of its own: Pillow's pen replaces pixels, it does not mix them.
    plates = Image.new("RGBA", sheet.size, (0, 0, 0, 0))
    pen = ImageDraw.Draw(plates)
    small, large = (max(LEAST_TEXT, round(share * view.height)) for share in (NAME_SHARE, LINE_SHARE))
    for slot, robot in sorted(frame.robots.items()):
        if slot not in drawing.robots:
            continue
        drawn = drawing.robots[slot]
        above = np.add(robot.pos, (0.0, 0.0, drawn.dimensions[2] / 2 + NAME_GAP))
        (x, y), depth = view.project(above)
        if depth > 0 and 0 <= x < view.width and 0 <= y < view.height:
            _plate(pen, (float(x), float(y)), drawn.name, small, tuple(robot_colors(np.array(slot)).tolist()))
    if line:
        margin = large // 2
        font = _font(large, True)
        box = pen.textbbox((2 * margin, 2 * margin), line, font=font)
        pen.rounded_rectangle(
            (box[0] - margin, box[1] - margin, box[2] + margin, box[3] + margin), margin, fill=PLATE
        )
        pen.text((2 * margin, 2 * margin), line, font=font, fill=INK)
    return np.asarray(Image.alpha_composite(sheet, plates).convert("RGB"))


def _plate(
    pen: ImageDraw.ImageDraw, at: tuple[float, float], text: str, height: int, rgb: tuple[int, ...]
) -> None:
    """Write a name whose plate ends at a point [pixels], with a line of the robot's colour below it."""
    font, gap = _font(height, False), height // 3
    x, y = at[0], at[1] - gap
    # Anchor "ms": the point is the middle of the baseline.
    left, top, right, bottom = pen.textbbox((x, y), text, font=font, anchor="ms")
    pen.rectangle((left - gap, top - gap, right + gap, bottom + gap), fill=PLATE)
    pen.rectangle((left - gap, bottom + gap, right + gap, bottom + 2 * gap), fill=(*rgb, 255))
    pen.text((x, y), text, font=font, anchor="ms", fill=INK)
