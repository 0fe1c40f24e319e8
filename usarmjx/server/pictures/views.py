"""What an image client sees: which cameras of a served world, where in its picture, what is drawn there."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from usarmjx.sensors.cameras.lenses import MIRROR_DISTANCE, MIRROR_RIM_ANGLE
from usarmjx.sensors.cameras.picture import Picture, Viewpoint
from usarmjx.sensors.sketch import OverlayLines
from usarmjx.server.worlds.robot import Robot
from usarmjx.server.worlds.served_world import CameraRequest, ServedWorld, ViewpointRequest

BALL_RADIUS = 0.03
"""Of a ball (chosen) [m]."""
MIN_BALL_PIXELS = 0.75
"""Pixels that a ball's radius is at least, so that it always has one's middle in it."""
NEAR_CLIP = 0.05
"""Nothing nearer to the camera than this is drawn [m]."""
DEPTH_BIAS = 0.02
"""What is so close in front of a line does not hide it: it may end on a surface [m]."""


def draw_sketch(rgb: np.ndarray, depth: np.ndarray, viewpoint: Viewpoint, sketch: OverlayLines) -> None:
    """Draw lines and then balls into a picture; they have no shadow, and mirrors do not show them.

    Args:
        rgb: The picture, which is changed (height, width, 3) uint8.
        depth: Its depths; see `cameras.picture` (height, width) [m].
        viewpoint: From where it was taken; its eye is where it is itself.
        sketch: What to draw; points become balls.
    """
    start, end, colors = (np.asarray(rows)[sketch.shown] for rows in (sketch.start, sketch.end, sketch.rgb))
    colors, points = np.round(255 * colors).astype(np.uint8), (start == end).all(-1)
    for line in zip(start[~points], end[~points], colors[~points], strict=True):
        _line(rgb, depth, viewpoint, *line)
    _balls(rgb, depth, viewpoint, start[points], colors[points])


def _line(
    rgb: np.ndarray,
    depth: np.ndarray,
    viewpoint: Viewpoint,
    start: np.ndarray,
    end: np.ndarray,
    color: np.ndarray,
) -> None:
    """Draw a line that is a pixel wide."""
    height, width = depth.shape
    length = float(np.linalg.norm(end - start))
    along = (end - start) / length
    foot = float((viewpoint.pos - start) @ along)
    aside = max(float(np.linalg.norm(start + foot * along - viewpoint.pos)), 1e-3)
    # Points that are evenly apart as the eye sees them, closer than pixels anywhere in the picture.
    first, last = math.atan2(-foot, aside), math.atan2(length - foot, aside)
    count = math.ceil(2 * (last - first) * max(width, height) / math.tan(viewpoint.fov / 2)) + 2
    way = np.clip(foot + aside * np.tan(np.linspace(first, last, count)), 0.0, length)
    right, down, away, _ = _project(viewpoint, start + way[:, None] * along, width, height)
    seen = (away > NEAR_CLIP) & (right >= 0) & (right < width) & (down >= 0) & (down < height)
    column, row, away = right[seen].astype(int), down[seen].astype(int), away[seen]
    clear = depth[row, column] > away - DEPTH_BIAS
    rgb[row[clear], column[clear]] = color


def _balls(
    rgb: np.ndarray, depth: np.ndarray, viewpoint: Viewpoint, points: np.ndarray, colors: np.ndarray
) -> None:
    """Draw balls, the far ones first."""
    height, width = depth.shape
    right, down, away, scale = _project(viewpoint, points, width, height)
    seen = (away > NEAR_CLIP) & np.isfinite(right) & np.isfinite(down)
    for ball in sorted(np.flatnonzero(seen), key=lambda ball: -away[ball]):
        radius = max(scale[ball] * BALL_RADIUS, MIN_BALL_PIXELS)
        first = [max(0, math.floor(middle[ball] - radius)) for middle in (right, down)]
        last = [max(0, math.ceil(middle[ball] + radius)) for middle in (right, down)]
        part = np.s_[first[1] : last[1], first[0] : last[0]]
        if not depth[part].size:
            continue
        rows, columns = np.mgrid[part][:, : depth[part].shape[0], : depth[part].shape[1]] + 0.5
        inside = np.hypot(columns - right[ball], rows - down[ball]) <= radius
        rgb[part][inside & (depth[part] > away[ball] - BALL_RADIUS)] = colors[ball]


def _project(
    viewpoint: Viewpoint, points: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return column and row, depth [m] and pixels per metre of points (points, 3); nan: not seen."""
    project = _omni if viewpoint.lens == "omni" else _pinhole
    return project(viewpoint, (points - viewpoint.pos) @ viewpoint.mat, width, height)


def _pinhole(
    viewpoint: Viewpoint, along: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return that of points in the eye's axes."""
    focal = width / 2 / math.tan(viewpoint.fov / 2)
    away = along[:, 0]
    scale = focal / np.maximum(away, NEAR_CLIP)
    return width / 2 - scale * along[:, 1], height / 2 - scale * along[:, 2], away, scale


def _omni(
    viewpoint: Viewpoint, along: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the same in a parabolic mirror; see `cameras.lenses.omni_rays`."""
    along = along - (MIRROR_DISTANCE, 0.0, 0.0)
    away = np.linalg.norm(along, axis=1)
    angle = np.arccos(np.clip(-along[:, 0] / np.maximum(away, 1e-9), -1.0, 1.0))
    zoom = math.tan(viewpoint.default_fov / 2) / math.tan(viewpoint.fov / 2)
    rim = min(width, height) / 2 * zoom
    radius = np.where(
        angle < MIRROR_RIM_ANGLE, rim * np.tan(angle / 2) / math.tan(MIRROR_RIM_ANGLE / 2), np.nan
    )
    aside = np.maximum(np.hypot(along[:, 1], along[:, 2]), 1e-9)
    # How fast the radius grows with the angle, which a ball fills from RADIUS / away to either side.
    scale = rim / math.tan(MIRROR_RIM_ANGLE / 2) / 2 / np.cos(angle / 2) ** 2 / np.maximum(away, NEAR_CLIP)
    right, up = -along[:, 1] / aside, along[:, 2] / aside
    return width / 2 + radius * right, height / 2 - radius * up, away, scale


@dataclass(frozen=True)
class CompositeView:
    """A picture made of pictures.

    Attributes:
        size: Width and height [pixels].
        tiles: What is where: left, top. What no tile covers is black.
    """

    size: tuple[int, int]
    tiles: tuple[tuple[CameraRequest | ViewpointRequest, int, int], ...] = ()

    def compose(self, pictures: Mapping[CameraRequest | ViewpointRequest, np.ndarray]) -> np.ndarray:
        """Return the whole (height, width, 3) from the pictures of its tiles."""
        width, height = self.size
        whole = np.zeros((height, width, 3), np.uint8)
        for request, left, top in self.tiles:
            part = pictures[request]
            whole[top : top + part.shape[0], left : left + part.shape[1]] = part
        return whole


def client_view(world: ServedWorld, address: str, port: int, size: tuple[int, int]) -> CompositeView:
    """Return what the image client at an address sees now.

    If its view is bound to a camera, that one's picture: nothing while the robot is not there. Else all
    robots with MultiView, or the viewports of the robot that has been there longest of those with cameras.
    """
    binding = world.view_bindings.get(address, port)
    if binding is not None:
        name, camera = binding
        robot = next((r for r in world.robots.values() if r.name.lower() == name.lower()), None)
        return CompositeView(size) if robot is None else robot_view(robot, camera, size)
    if world.multi_view is not None:
        return all_robots_view(world, size)
    robots = [robot for robot in world.robots.values() if robot.cameras]
    if not robots:
        return CompositeView(size)
    return robot_view(min(robots, key=lambda robot: (robot.spawn_time, robot.slot)), "", size)


def robot_view(robot: Robot, camera: str, size: tuple[int, int]) -> CompositeView:
    """Return one camera's picture, or the robot's viewports."""
    tiles = ((camera, 0, 0, 1),) if camera else robot.viewports.tiles()
    requests = []
    for name, column, row, parts in tiles:
        index = robot.camera_index(name)
        if index is not None:
            width, height = size[0] // parts, size[1] // parts
            if (request := _camera_request(robot, index, width, height)) is not None:
                requests.append((request, column * width, row * height))
    return CompositeView(size, tuple(requests))


def _camera_request(robot: Robot, camera: int, width: int, height: int) -> CameraRequest | None:
    """Return a request of that size, a pixel narrower if two eyes share it; None if nothing is left."""
    width -= width % len(robot.cameras[camera].eye_offsets)
    return CameraRequest(robot, camera, width, height) if width and height else None


def all_robots_view(world: ServedWorld, size: tuple[int, int]) -> CompositeView:
    """Return the MultiView: all robots' first cameras; nothing without one."""
    tiles = []
    for _, robot in sorted(world.robots.items()):
        if world.multi_view is not None and robot.tile >= 0:
            left, top, width, height = world.multi_view.tile(robot.tile, size)
            if (request := _camera_request(robot, 0, width, height)) is not None:
                tiles.append((request, left, top))
    return CompositeView(size, tuple(tiles))


def snapshot(
    world: ServedWorld, requests: Sequence[CameraRequest | ViewpointRequest]
) -> Callable[[], list[np.ndarray]]:
    """Take a snapshot of the world; return a function that renders pictures (height, width, 3).

    They show the robots' traces and what sensors draw. The function may run in another thread, while
    the world goes on.
    """
    if not requests:
        return list
    render = world.snapshot(requests)
    sketches = [sketch for sketch in (world.traces.sketch(), *world.sketches()) if sketch.shown.any()]
    if not sketches:
        return lambda: [np.asarray(picture.rgb) for picture in render()]
    viewpoints = [world.viewpoint(request) for request in requests]

    def render_with_sketches() -> list[np.ndarray]:
        pictures = zip(render(), viewpoints, strict=True)
        return [_drawn(picture, viewpoint, sketches) for picture, viewpoint in pictures]

    return render_with_sketches


def _drawn(picture: Picture, viewpoint: Viewpoint, sketches: Sequence[OverlayLines]) -> np.ndarray:
    """Return a picture with what is to be drawn into it, seen by each of its eyes."""
    rgb, depth = np.array(picture.rgb), np.asarray(picture.depth)
    wide = rgb.shape[1] // len(viewpoint.eye_offsets)
    for number, offset in enumerate(viewpoint.eye_offsets):
        part = np.s_[:, number * wide : (number + 1) * wide]
        eye = viewpoint.replace(pos=viewpoint.pos + viewpoint.mat @ offset)
        for sketch in sketches:
            draw_sketch(rgb[part], depth[part], eye, sketch)
    return rgb
