"""Views of image clients: cameras of a served world, and their tiles in a client's picture."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from usarmjx.sensors.cameras.picture import Picture, Viewpoint
from usarmjx.sensors.sketch import OverlayLines
from usarmjx.server.pictures.overlay import draw_overlay
from usarmjx.server.worlds.robot import Robot
from usarmjx.server.worlds.served_world import CameraRequest, ServedWorld, ViewpointRequest


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
    rgb, depth = np.array(picture.rgb), np.asarray(picture.depth)
    wide = rgb.shape[1] // len(viewpoint.eye_offsets)
    for number, offset in enumerate(viewpoint.eye_offsets):
        part = np.s_[:, number * wide : (number + 1) * wide]
        eye = viewpoint.replace(pos=viewpoint.pos + viewpoint.mat @ offset)
        for sketch in sketches:
            draw_overlay(rgb[part], depth[part], eye, sketch)
    return rgb
