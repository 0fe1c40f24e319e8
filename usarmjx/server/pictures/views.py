"""Views of image clients: cameras of a served world and their tiles, rendered in a thread, with overlays.

Traces of robots and the findings of sensors are drawn so, after rendering: no ray has to hit a thin line.

The thread works for a part of the time only: the robots' reports have precedence.
"""

import asyncio
import logging
import math
import time
from collections.abc import Callable, Collection, Coroutine, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from usarmjx.sensors.cameras.lenses import MIRROR_DISTANCE, MIRROR_RIM_ANGLE
from usarmjx.sensors.cameras.picture import Picture, Viewpoint
from usarmjx.sensors.sketch import OverlayLines
from usarmjx.server.worlds.robot import Robot
from usarmjx.server.worlds.served_world import CameraRequest, ServedWorld, ViewpointRequest

BALL_RADIUS = 0.03
"""Radius of a ball (chosen) [m]."""
MIN_BALL_PIXELS = 0.75
"""Smallest radius of a ball [pixels], so that it always covers the middle of one."""
NEAR_CLIP = 0.05
"""Smallest drawn distance from the camera [m]."""
DEPTH_BIAS = 0.02
"""Distance up to which a surface in front of a line does not hide it: a line may end on a surface [m]."""


def draw_overlay(rgb: np.ndarray, depth: np.ndarray, viewpoint: Viewpoint, sketch: OverlayLines) -> None:
    """Draw lines and then balls into a picture; they have no shadow, and mirrors do not show them.

    Args:
        rgb: The picture, which is changed (height, width, 3) uint8.
        depth: Its depths; see `cameras.picture` (height, width) [m].
        viewpoint: Viewpoint of the picture, with its eye at its own position.
        sketch: Lines to draw; a line of length 0 becomes a ball.
    """
    shown = np.asarray(sketch.shown)
    start, end = np.asarray(sketch.start)[shown], np.asarray(sketch.end)[shown]
    colors = np.round(255 * np.asarray(sketch.rgb)[shown]).astype(np.uint8)
    # A line of no length stands for a ball.
    points = (start == end).all(-1)
    for line in zip(start[~points], end[~points], colors[~points], strict=True):
        _draw_line(rgb, depth, viewpoint, *line)
    _draw_balls(rgb, depth, viewpoint, start[points], colors[points])


def _draw_line(
    rgb: np.ndarray,
    depth: np.ndarray,
    viewpoint: Viewpoint,
    start: np.ndarray,
    end: np.ndarray,
    color: np.ndarray,
) -> None:
    """Draw a line of one pixel's width."""
    height, width = depth.shape
    length = float(np.linalg.norm(end - start))
    along = (end - start) / length
    foot = float((viewpoint.pos - start) @ along)
    # A line through the eye has no angles.
    aside = max(float(np.linalg.norm(start + foot * along - viewpoint.pos)), 1e-3)
    # Points at equal angles from the eye, denser than pixels anywhere in the picture.
    first, last = math.atan2(-foot, aside), math.atan2(length - foot, aside)
    count = math.ceil(2 * (last - first) * max(width, height) / math.tan(viewpoint.fov / 2)) + 2
    reach = np.clip(foot + aside * np.tan(np.linspace(first, last, count)), 0.0, length)
    right, down, away, _ = _project(viewpoint, start + reach[:, None] * along, width, height)
    in_view = (away > NEAR_CLIP) & (right >= 0) & (right < width) & (down >= 0) & (down < height)
    column, row, away = right[in_view].astype(int), down[in_view].astype(int), away[in_view]
    visible = depth[row, column] > away - DEPTH_BIAS
    rgb[row[visible], column[visible]] = color


def _draw_balls(
    rgb: np.ndarray, depth: np.ndarray, viewpoint: Viewpoint, points: np.ndarray, colors: np.ndarray
) -> None:
    """Draw balls, the far ones first."""
    height, width = depth.shape
    right, down, away, scale = _project(viewpoint, points, width, height)
    in_view = (away > NEAR_CLIP) & np.isfinite(right) & np.isfinite(down)
    for ball in sorted(np.flatnonzero(in_view), key=lambda ball: -away[ball]):
        radius = max(scale[ball] * BALL_RADIUS, MIN_BALL_PIXELS)
        first = [max(0, math.floor(center[ball] - radius)) for center in (right, down)]
        last = [max(0, math.ceil(center[ball] + radius)) for center in (right, down)]
        part = np.s_[first[1] : last[1], first[0] : last[0]]
        if not depth[part].size:
            continue
        # Middles of pixels: half a pixel off, a small ball would lean to the upper left.
        # Cut to the picture's shape: a slice may end beyond the picture, and mgrid knows no bounds.
        rows, columns = np.mgrid[part][:, : depth[part].shape[0], : depth[part].shape[1]] + 0.5
        inside = np.hypot(columns - right[ball], rows - down[ball]) <= radius
        # A ball on a surface may have its middle up to a radius behind what was rendered.
        rgb[part][inside & (depth[part] > away[ball] - BALL_RADIUS)] = colors[ball]


def _project(
    viewpoint: Viewpoint, points: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return column and row, depth [m] and pixels per metre of points (points, 3); nan: out of sight."""
    project = _project_mirror if viewpoint.lens == "omni" else _project_pinhole
    return project(viewpoint, (points - viewpoint.pos) @ viewpoint.mat, width, height)


def _project_pinhole(
    viewpoint: Viewpoint, along: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Project points in the eye's axes through a pinhole; see `_project`."""
    # The field of view is that of the width.
    focal = width / 2 / math.tan(viewpoint.fov / 2)
    away = along[:, 0]
    # Points behind the eye have a negative depth; they are left out later, and must not divide by 0 here.
    scale = focal / np.maximum(away, NEAR_CLIP)
    return width / 2 - scale * along[:, 1], height / 2 - scale * along[:, 2], away, scale


def _project_mirror(
    viewpoint: Viewpoint, along: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Project points in the eye's axes by a parabolic mirror; see `cameras.lenses.omni_rays`."""
    along = along - (MIRROR_DISTANCE, 0.0, 0.0)
    away = np.linalg.norm(along, axis=1)
    # Rounding may bring a cosine above 1.
    angle = np.arccos(np.clip(-along[:, 0] / np.maximum(away, 1e-9), -1.0, 1.0))
    zoom = math.tan(viewpoint.default_fov / 2) / math.tan(viewpoint.fov / 2)
    rim = min(width, height) / 2 * zoom
    radius = np.where(
        angle < MIRROR_RIM_ANGLE, rim * np.tan(angle / 2) / math.tan(MIRROR_RIM_ANGLE / 2), np.nan
    )
    aside = np.maximum(np.hypot(along[:, 1], along[:, 2]), 1e-9)
    # Derivative of the radius by the angle, of which a ball covers RADIUS / away to either side.
    scale = rim / math.tan(MIRROR_RIM_ANGLE / 2) / 2 / np.cos(angle / 2) ** 2 / np.maximum(away, NEAR_CLIP)
    right, up = -along[:, 1] / aside, along[:, 2] / aside
    return width / 2 + radius * right, height / 2 - radius * up, away, scale


@dataclass(frozen=True)
class CompositeView:
    """A picture made of pictures.

    Attributes:
        size: Width and height [pixels].
        tiles: Request, left and top of each part; pixels that no tile covers are black.
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
    """Return the present view of the image client at an address.

    If its view is bound to a camera, that camera's picture: black while the robot is absent. Else all
    robots with MultiView, or the viewports of the longest present robot with cameras.
    """
    binding = world.view_bindings.get(address, port)
    if binding is not None:
        name, camera = binding
        robot = next((r for r in world.robots.values() if r.name.lower() == name.lower()), None)
        # Black, not another robot's picture: the client has asked for this one.
        return CompositeView(size) if robot is None else robot_view(robot, camera, size)
    if world.multi_view is not None:
        return all_robots_view(world, size)
    robots = [robot for robot in world.robots.values() if robot.cameras]
    if not robots:
        return CompositeView(size)
    # Of robots that came in the same step the lower slot is first, so the picture does not flicker.
    return robot_view(min(robots, key=lambda robot: (robot.spawn_time, robot.slot)), "", size)


def robot_view(robot: Robot, camera: str, size: tuple[int, int]) -> CompositeView:
    """Return one camera's picture, or the robot's viewports."""
    tiles = ((camera, 0, 0, 1),) if camera else robot.viewports.tiles()
    requests: list[tuple[CameraRequest | ViewpointRequest, int, int]] = []
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
    """Return the MultiView: all robots' first cameras; black without one."""
    tiles: list[tuple[CameraRequest | ViewpointRequest, int, int]] = []
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

    They show the robots' traces and the sensors' overlays. The function may run in another thread, while
    the world goes on.
    """
    if not requests:
        return list
    # Before the overlays, in the loop's thread: both are of the same moment.
    render = world.snapshot(requests)
    sketches = [sketch for sketch in (world.traces.sketch(), *world.sketches()) if sketch.shown.any()]
    if not sketches:
        return lambda: [np.asarray(picture.rgb) for picture in render()]
    viewpoints = [world.viewpoint(request) for request in requests]

    def render_with_sketches() -> list[np.ndarray]:
        pictures = zip(render(), viewpoints, strict=True)
        return [_with_overlays(picture, viewpoint, sketches) for picture, viewpoint in pictures]

    return render_with_sketches


def _with_overlays(picture: Picture, viewpoint: Viewpoint, sketches: Sequence[OverlayLines]) -> np.ndarray:
    """Return a picture with its overlays, projected for each of its eyes."""
    # A copy: arrays from JAX are read-only.
    rgb, depth = np.array(picture.rgb), np.asarray(picture.depth)
    wide = rgb.shape[1] // len(viewpoint.eye_offsets)
    for number, offset in enumerate(viewpoint.eye_offsets):
        part = np.s_[:, number * wide : (number + 1) * wide]
        eye = viewpoint.replace(pos=viewpoint.pos + viewpoint.mat @ offset)
        for sketch in sketches:
            draw_overlay(rgb[part], depth[part], eye, sketch)
    return rgb


log = logging.getLogger(__name__)
MAX_TIME_SHARE = 0.6
"""Largest share of the time in which the thread works."""
MAX_PAUSE = 0.2
"""Longest pause after a picture, which may take seconds to compile or to render [s]."""
Made = TypeVar("Made")
ViewImages = Mapping[CompositeView, np.ndarray]
"""Pictures (height, width, 3) by their views."""


class RenderThread:
    """Renders for one service.

    Args:
        world: The served world.
    """

    def __init__(self, world: ServedWorld) -> None:
        self._world = world
        # One thread: `is_ready` lets no second job begin beside the first.
        self._executor = ThreadPoolExecutor(1, thread_name_prefix="pictures")
        self._job: asyncio.Task[None] | None = None
        self._rested = 0.0

    def is_ready(self, now: float) -> bool:
        """Return whether the last job and the pause after it are over at a time [s]."""
        return now >= self._rested and (self._job is None or self._job.done())

    def begin(self, job: Coroutine[None, None, None]) -> None:
        """Start a job, which calls `render`; its errors are logged."""
        self._job = asyncio.create_task(job)
        self._job.add_done_callback(_report)

    async def render(self, views: Collection[CompositeView], make: Callable[[ViewImages], Made]) -> Made:
        """Render views as they are now and return the result of `make`, both computed in the thread."""
        # A picture that several views show is rendered once.
        requests = list(dict.fromkeys(request for view in views for request, _, _ in view.tiles))
        # The snapshot is taken here, in the loop's thread: the other one must never see a world within a
        # step.
        job = _make, snapshot(self._world, requests), requests, set(views), make
        began = time.monotonic()
        made = await asyncio.get_running_loop().run_in_executor(self._executor, *job)
        ended = time.monotonic()
        # The pause makes the work `MAX_TIME_SHARE` of both together.
        self._rested = ended + min(MAX_PAUSE, (ended - began) * (1 - MAX_TIME_SHARE) / MAX_TIME_SHARE)
        return made

    def close(self) -> None:
        """Stop."""
        if self._job is not None:
            self._job.cancel()
        # Not awaited: a first picture may compile for seconds, and the server must end at once.
        self._executor.shutdown(wait=False, cancel_futures=True)


def _make(
    render: Callable[[], list[np.ndarray]],
    requests: Sequence[CameraRequest | ViewpointRequest],
    views: Collection[CompositeView],
    make: Callable[[ViewImages], Made],
) -> Made:
    pictures = dict(zip(requests, render(), strict=True))
    return make({view: view.compose(pictures) for view in views})


def _report(task: asyncio.Task[None]) -> None:
    """Log the error of a task whose result nothing awaits."""
    if not task.cancelled() and (error := task.exception()):
        log.error("no picture could be rendered", exc_info=error)
