"""What an image client sees: which cameras of a served world, where in its picture, what is drawn there."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from usarmjx.cameras.picture import Picture, Viewpoint
from usarmjx.sensors.sketch import OverlayLines
from usarmjx.server.pictures.dots import draw_sketch
from usarmjx.server.worlds.host import CameraRequest, Robot, ServedWorld, ViewpointRequest


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
        for shot, left, top in self.tiles:
            part = pictures[shot]
            whole[top : top + part.shape[0], left : left + part.shape[1]] = part
        return whole


def client_view(world: ServedWorld, address: str, port: int, size: tuple[int, int]) -> CompositeView:
    """Return what the image client at an address sees now.

    If its view is tied to a camera, that one's picture: nothing while the robot is not there. Else all robots
    with MultiView, or the viewports of the robot that has been there longest of those with cameras.
    """
    tied = world.view_bindings.get(address, port)
    if tied is not None:
        robot = next((r for r in world.robots.values() if r.name.lower() == tied[0].lower()), None)
        return CompositeView(size) if robot is None else robot_view(robot, tied[1], size)
    if world.multi_view is not None:
        return all_robots_view(world, size)
    robots = [robot for robot in world.robots.values() if robot.cameras]
    if not robots:
        return CompositeView(size)
    return robot_view(min(robots, key=lambda robot: (robot.spawn_time, robot.slot)), "", size)


def robot_view(robot: Robot, camera: str, size: tuple[int, int]) -> CompositeView:
    """Return one camera's picture, or the robot's viewports."""
    tiles = ((camera, 0, 0, 1),) if camera else robot.viewports.tiles()
    found = []
    for name, column, row, parts in tiles:
        number = robot.camera_index(name)
        if number is not None:
            width, height = size[0] // parts, size[1] // parts
            if (shot := _camera_request(robot, number, width, height)) is not None:
                found.append((shot, column * width, row * height))
    return CompositeView(size, tuple(found))


def _camera_request(robot: Robot, camera: int, width: int, height: int) -> CameraRequest | None:
    """Return a shot of that size, a pixel narrower if two eyes have to share it; None if nothing is left."""
    width -= width % len(robot.cameras[camera].eye_offsets)
    return CameraRequest(robot, camera, width, height) if width and height else None


def all_robots_view(world: ServedWorld, size: tuple[int, int]) -> CompositeView:
    """Return the MultiView: all robots' first cameras; nothing without one."""
    tiles = []
    for _, robot in sorted(world.robots.items()):
        if world.multi_view is not None and robot.tile >= 0:
            left, top, width, height = world.multi_view.tile(robot.tile, size)
            if (shot := _camera_request(robot, 0, width, height)) is not None:
                tiles.append((shot, left, top))
    return CompositeView(size, tuple(tiles))


def snapshot(
    world: ServedWorld, shots: Sequence[CameraRequest | ViewpointRequest]
) -> Callable[[], list[np.ndarray]]:
    """Hold the world still; return what then takes pictures (height, width, 3).

    They show the robots' traces and what sensors draw. The second half may run in another thread, while the
    world goes on.
    """
    if not shots:
        return list
    take = world.snapshot(shots)
    sketches = [sketch for sketch in (world.traces.sketch(), *world.sketches()) if sketch.shown.any()]
    if not sketches:
        return lambda: [picture.rgb for picture in take()]
    eyes = [world.viewpoint(shot) for shot in shots]

    def develop() -> list[np.ndarray]:
        return [_drawn(picture, eye, sketches) for picture, eye in zip(take(), eyes, strict=True)]

    return develop


def _drawn(picture: Picture, eye: Viewpoint, sketches: Sequence[OverlayLines]) -> np.ndarray:
    """Return a picture with what is to be drawn into it, seen by each of its eyes."""
    rgb, depth = np.array(picture.rgb), np.asarray(picture.depth)
    wide = rgb.shape[1] // len(eye.eye_offsets)
    for number, offset in enumerate(eye.eye_offsets):
        part = np.s_[:, number * wide : (number + 1) * wide]
        for sketch in sketches:
            draw_sketch(rgb[part], depth[part], eye.replace(pos=eye.pos + eye.mat @ offset), sketch)
    return rgb
