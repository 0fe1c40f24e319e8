"""From where the page looks: what fills the picture, robots' cameras, and which robot a click means."""

import contextlib
import math
from types import SimpleNamespace

import numpy as np
import pytest

from tests.view.scenery import seers
from tests.view.simple_worlds import CAMERA_AT, drawing_of, frame_of
from usarmjx.base.backend import numpy_backend
from usarmjx.sensors.cameras.mounts import cameras_of
from usarmjx.sensors.cameras.picture import camera_viewpoint
from usarmjx.view.viewpoint import (
    FILL_SHARE,
    FOV,
    MAX_FRAMED,
    UP,
    Chase,
    Viewer,
    ViewMode,
    Walls,
    bounds_of,
    camera_pose,
    chase_pose,
    fit_box,
    robot_on_ray,
)

LOW, HIGH = np.array([-10.0, -6.0, 0.0]), np.array([10.0, 6.0, 1.5])


@pytest.mark.parametrize("aspect", [0.5, 1.0, 1.6, 2.4])
def test_a_box_fills_the_picture_and_all_of_it_is_seen(aspect):
    pose = fit_box(LOW, HIGH, aspect)
    ahead = (pose.look_at - pose.pos) / np.linalg.norm(pose.look_at - pose.pos)
    right = np.cross(ahead, pose.up) / np.linalg.norm(np.cross(ahead, pose.up))
    corners = np.array(np.meshgrid(*zip(LOW, HIGH, strict=True))).reshape(3, -1).T - pose.pos
    half = math.tan(FOV / 2)
    up = corners @ np.cross(right, ahead) / (corners @ ahead) / half
    aside = corners @ right / (corners @ ahead) / half / aspect
    assert (corners @ ahead > 0).all()
    fullest = max(np.abs(up).max(), np.abs(aside).max())
    assert FILL_SHARE - 0.08 <= fullest <= 1.0


@pytest.mark.parametrize("aspect", [1.0, 1.2, 1.6, 2.4])
def test_a_box_leaves_a_corner_of_the_picture_free_and_stays_in_the_rest(aspect):
    corner = (0.25, 0.38)
    pose = fit_box(LOW, HIGH, aspect, corner)
    ahead = (pose.look_at - pose.pos) / np.linalg.norm(pose.look_at - pose.pos)
    right = np.cross(ahead, UP) / np.linalg.norm(np.cross(ahead, UP))
    share = np.linspace(0.0, 1.0, 101)
    corners = np.array(np.meshgrid(*zip(LOW, HIGH, strict=True))).reshape(3, -1).T
    # Points all over the box's surface are its hull in the picture.
    points = (
        corners[:, None, None] + share[:, None] * (corners[None] - corners[:, None])[:, :, None]
    ) - pose.pos
    points = points.reshape(-1, 3)
    half = math.tan(FOV / 2)
    up = points @ np.cross(right, ahead) / (points @ ahead) / half
    aside = points @ right / (points @ ahead) / half / aspect
    assert max(np.abs(up).max(), np.abs(aside).max()) <= 1.0
    assert not ((aside < 2 * corner[0] - 1) & (up > 1 - 2 * corner[1])).any()
    assert max(np.ptp(up), np.ptp(aside)) > 1.2, "and it is no smaller than it must"


def test_what_stands_in_a_world_is_in_its_bounds():
    low, high = bounds_of(drawing_of(floor=2.0))
    assert low.tolist() == [-5.0, -4.0, 2.0]
    assert high.tolist() == [5.0, 4.0, 3.0]
    tall = drawing_of()
    tall.shapes["arena"].size[1, 2] = 7.0
    try:
        assert bounds_of(tall)[1].tolist() == [5.0, 4.0, 7.0]
    finally:
        tall.shapes["arena"].size[1, 2] = 1.0


def test_a_view_through_a_camera_is_the_raycasters():
    world, source = seers((1.0, 0.5, 0.8))
    drawing, frame = source.drawing(0), source.frame(0)
    robot = world.robots[0]
    with numpy_backend():
        eye = camera_viewpoint(cameras_of(robot.spec)[0], world.bodies(robot), np.array(0), np.array(1.0))
    pose = camera_pose(drawing.robots[0], frame, 0)
    assert pose.pos == pytest.approx(np.asarray(eye.pos), abs=1e-5)
    assert pose.look_at - pose.pos == pytest.approx(np.asarray(eye.mat)[:, 0], abs=1e-5)
    assert pose.up == pytest.approx(np.asarray(eye.mat)[:, 2], abs=1e-5)


def test_over_a_robot_one_is_behind_and_above_it_whichever_way_it_leans():
    drawing = drawing_of(robots=1)
    frame = frame_of(drawing)
    half = math.sqrt(0.5)
    for quat in ((half, 0, 0, half), (0, half, half, 0)):  # to the left; and so, but on its back
        frame.quat[1:] = quat
        pose = chase_pose(drawing.robots[0], frame)
        assert pose.pos[1] < frame.pos[1, 1] - 1.0
        assert pose.pos[2] > frame.pos[1, 2] + 0.5
        assert pose.look_at[1] > frame.pos[1, 1]
        assert (pose.up == [0.0, 0.0, 1.0]).all()


def test_over_a_robot_one_looks_from_where_no_wall_hides_it():
    drawing = drawing_of(robots=1)
    frame = frame_of(drawing)
    robot, walls = drawing.robots[0], Walls(drawing)
    client = SimpleNamespace(atomic=contextlib.nullcontext, camera=SimpleNamespace(fov=FOV))
    viewer = Viewer(client, robot=0, mode=ViewMode.OVER)
    turn = {"away from the wall": (0.7071, 0, 0, 0.7071), "along it": (1.0, 0, 0, 0)}
    frame.pos[1:4] = (-2.0, 0.4, 0.2)  # the wall is along the x axis, 2 m high, in reach of the view
    heights = {}
    for name, quat in turn.items():
        frame.quat[1:4] = quat
        viewer.attach(0)
        viewer.update(drawing, frame, np.zeros(3))
        heights[name] = client.camera.position[2]
        assert not walls.occluded(frame.pos[1] + [0, 0, 0.1], client.camera.position[None])[0]
    assert heights["along it"] == pytest.approx(chase_pose(robot, frame).pos[2])
    assert heights["away from the wall"] > heights["along it"] + 0.5
    assert walls.occluded(frame.pos[1] + [0, 0, 0.1], np.array([[-2.0, -1.0, 0.5]]))[0]
    frame.quat[1:4] = turn["away from the wall"]
    viewer.update(drawing, frame, np.zeros(3))
    assert client.camera.position[2] < heights["away from the wall"], "not at one leap"
    for _ in range(20):
        viewer.update(drawing, frame, np.zeros(3))
    assert client.camera.position[2] == pytest.approx(heights["away from the wall"])


@pytest.mark.parametrize(
    ("start", "ray", "robot"),
    [
        ((0.0, 0.0, 5.0), (0.0, 0.0, -1.0), 0),
        ((1.0, 0.0, 5.0), (0.0, 0.0, -1.0), 1),
        ((5.0, 0.0, 0.2), (-1.0, 0.0, 0.0), 1),
        ((-5.0, 0.0, 0.2), (1.0, 0.0, 0.0), 0),
        ((-5.0, 0.0, 0.2), (-1.0, 0.0, 0.0), None),
        ((0.5, 2.0, 5.0), (0.0, 0.0, -1.0), None),
    ],
)
def test_a_click_means_the_nearest_robot_on_its_ray(start, ray, robot):
    drawing = drawing_of(robots=2)
    assert robot_on_ray(drawing, frame_of(drawing), np.array(start), np.array(ray)) == robot


class Camera:
    """What viser tells of somebody's view, and lets us set."""

    def __init__(self):
        self.fov, self.aspect = FOV, 1.6
        self.position = self.look_at = self.up_direction = np.zeros(3)


class Client:
    """Somebody at the page."""

    def __init__(self):
        self.camera = Camera()

    def atomic(self):
        return contextlib.nullcontext()


def test_robots_follow_one_another_and_c_goes_from_the_camera_over_it():
    drawing = drawing_of(robots=3)
    frame, viewer = frame_of(drawing), Viewer(Client())
    seen = []
    for _ in range(4):
        viewer.attach_next(drawing, frame)
        seen.append(viewer.robot)
    assert seen == [0, 1, 2, 0]
    assert viewer.mode is ViewMode.CAMERA
    viewer.update(drawing, frame, np.array([100.0, 0.0, 0.0]))
    assert viewer.client.camera.position == pytest.approx(np.add(CAMERA_AT, (100.0, 0.0, 0.2)))
    # The page's picture is as wide as the camera's: its field of view is vertical, a robot's horizontal.
    wide = 1.6 * math.tan(viewer.client.camera.fov / 2)
    assert 2 * math.atan(wide) == pytest.approx(frame.robots[0].fovs[0])
    viewer.client.camera.aspect = 0.8
    viewer.update(drawing, frame, np.zeros(3))
    assert 2 * math.atan(0.8 * math.tan(viewer.client.camera.fov / 2)) == pytest.approx(1.0)
    viewer.toggle()
    viewer.update(drawing, frame, np.zeros(3))
    assert viewer.client.camera.position == pytest.approx(chase_pose(drawing.robots[0], frame).pos)
    assert viewer.client.camera.fov == FOV
    viewer.attach_next(drawing, frame, step=-1)
    assert (viewer.robot, viewer.mode) == (2, ViewMode.OVER)
    viewer.free()
    assert (viewer.robot, viewer.mode) == (None, ViewMode.FREE)


def test_a_view_is_untouched_until_somebody_moves_it_and_while_the_browser_tells_an_earlier_place():
    viewer, first = Viewer(Client()), fit_box(LOW, HIGH, 1.6)
    viewer.frame(first, 1.6)
    viewer.frame(fit_box(LOW, HIGH, 1.0), 1.0)
    assert viewer.is_untouched
    assert viewer.is_fitted
    viewer.client.camera.position = first.pos
    assert viewer.is_untouched
    assert not viewer.is_fitted
    viewer.client.camera.position = first.pos * 1.05
    assert not viewer.is_untouched
    viewer.client.camera.position = first.pos
    viewer.attach(0)
    assert not viewer.is_untouched


def test_a_view_that_is_put_back_again_and_again_stays_untouched():
    viewer, first, fitted = Viewer(Client()), fit_box(LOW, HIGH, 1.6), fit_box(LOW, HIGH, 1.0)
    viewer.frame(first, 1.6)
    for _ in range(2 * MAX_FRAMED):
        viewer.frame(fitted, 1.0)
        viewer.client.camera.position = first.pos
        assert viewer.is_untouched


def test_who_is_with_a_robot_that_leaves_looks_freely():
    viewer = Viewer(Client())
    viewer.attach(1)
    viewer.update(drawing_of(robots=1), frame_of(drawing_of(robots=1)), np.zeros(3))
    assert viewer.robot is None


def test_a_view_over_a_robot_that_turns_at_a_wall_never_ends_inside_or_behind_it():
    drawing = drawing_of(robots=1)
    frame = frame_of(drawing)
    frame.pos[1:4] = (-2.0, 0.4, 0.2)
    robot, walls = drawing.robots[0], Walls(drawing)
    chase, near = Chase(drawing), []
    for yaw in np.linspace(0.0, 2 * math.pi, 25):
        frame.quat[1:4] = (math.cos(yaw / 2), 0, 0, math.sin(yaw / 2))
        pose = chase.pose(robot, frame)
        top = frame.pos[1] + [0, 0, 0.1]
        assert not walls.occluded(top, pose.pos[None])[0]
        near.append(np.linalg.norm(pose.pos - top))
    assert min(near) < 0.7 * max(near)  # the elevation rises gradually: the view came closer meanwhile
