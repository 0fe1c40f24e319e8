"""Distances of robots from what stands around them: closed forms, and the demonstration's own function."""

import numpy as np
import pytest

from tests.train.views import placed
from tests.train.views import view_of as start_of
from usarmjx.cli.demo_run import clearance as demo_clearance
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import ArenaSpec, StartPose
from usarmjx.models.types.shapes import Shape
from usarmjx.sim.scene import build_scene
from usarmjx.train.tasks.clearance import NO_OBSTACLE, Boxes, bounding_box_of, box_distance, clearance

STARTS = tuple(StartPose(tag=f"S{i}", at=(x, 0.0, 0.188)) for i, x in enumerate((0.0, 5.0)))
HALF_LENGTH, HALF_WIDTH = 0.276, 0.2484
"""Of a P2AT: its body reaches past its wheels; the outer faces of its tyres."""


def boxes(rows):
    """Upright boxes from x, y, half lengths and yaw (n, 5)."""
    rows = np.asarray(rows, np.float32)
    return Boxes(
        centre=rows[..., :2], half=rows[..., 2:4], yaw=rows[..., 4], low=0 * rows[..., 0], high=rows[..., 0]
    )


def solid(kind, size, at, rotation=(0.0, 0.0, 0.0)):
    return Shape(kind=kind, size=size, at=at, rotation=rotation, surface="wall")


def view_of(*shapes, poses=((0.0, 0.0, 0.26, 0.0),), parked=False):
    """P2ATs at x, y, z and yaw among solids."""
    arena = ArenaSpec(name="here", shapes=shapes, starts=STARTS, extent=((-9, 9), (-9, 9)), floor=0.0)
    scene = build_scene(arena, ["P2AT"] * len(poses))
    view = placed(start_of(None, scene), *((x, y, z, 0.0, 0.0, yaw) for x, y, z, yaw in poses))
    if not parked:
        return view
    team = view.world.groups[0]
    return view.replace(world=view.world.with_group(0, team.replace(active=team.active.at[1].set(False))))


@pytest.mark.oracle
def test_rectangles_are_as_far_apart_as_the_demonstration_says():
    draw = np.random.default_rng(0)
    for _ in range(20):
        rows = draw.uniform((-2, -2, 0.05, 0.05, 0.0), (2, 2, 0.8, 0.8, 0.0), (6, 5))
        pose, half = draw.uniform((-1, -1, -3), (1, 1, 3)), (0.3, 0.2)
        corners = np.column_stack([rows[:, :2] - rows[:, 2:4], rows[:, :2] + rows[:, 2:4]])
        hull = boxes((*pose[:2], *half, pose[2]))
        assert float(box_distance(hull, boxes(rows)).min()) == pytest.approx(
            demo_clearance(pose, half, corners), abs=1e-5
        )


def test_turned_rectangles_meet_corner_to_face_and_cross_without_corners():
    square = boxes((0, 0, 0.5, 0.5, 0))
    beside = boxes([(1 + np.sqrt(0.5), 0, 0.5, 0.5, np.pi / 4), (0.6, 0.2, 2.0, 0.01, np.pi / 2)])
    np.testing.assert_allclose(box_distance(square, beside), [0.5, 0.09], atol=1e-6)
    # A cross: neither has a corner in the other.
    np.testing.assert_array_equal(box_distance(square, boxes([(0, 0, 3, 0.1, 0.3)])), [0.0])


def test_a_hull_is_what_the_robot_reaches_to():
    low, high = bounding_box_of(ROBOTS.get("P2AT"))
    np.testing.assert_allclose(high[:2], (HALF_LENGTH, HALF_WIDTH), atol=1e-4)
    np.testing.assert_allclose(low, (-HALF_LENGTH, -HALF_WIDTH, -0.26), atol=1e-4)


def test_walls_count_by_what_is_in_the_robots_height():
    wall = solid("box", (0.05, 1.0, 0.5), (1.0, 0.0, 0.5))
    view = view_of(wall)
    assert float(clearance(view)[0][0]) == pytest.approx(0.95 - HALF_LENGTH, abs=1e-4)
    turned = view_of(wall, poses=((0.0, 0.0, 0.26, np.pi / 2),))
    assert float(clearance(turned)[0][0]) == pytest.approx(0.95 - HALF_WIDTH, abs=1e-4)
    board = solid("box", (0.05, 1.0, 0.04), (1.0, 0.0, 0.04))
    roof = solid("box", (2.0, 2.0, 0.05), (0.0, 0.0, 1.0))
    ramp = solid("box", (0.5, 0.5, 0.05), (0.5, 0.0, 0.1), rotation=(0.0, -0.3, 0.0))
    assert float(clearance(view_of(board, roof, ramp))[0][0]) == NO_OBSTACLE
    pillar = solid("cylinder", (0.2, 0.5), (0.0, 2.0, 0.5))
    assert float(clearance(view_of(pillar))[0][0]) == pytest.approx(1.8 - HALF_WIDTH, abs=1e-4)


def test_robots_are_obstacles_to_each_other_unless_parked():
    poses = ((0.0, 0.0, 0.26, 0.0), (1.5, 0.0, 0.26, 0.0))
    np.testing.assert_allclose(clearance(view_of(poses=poses))[0], 1.5 - 2 * HALF_LENGTH, atol=1e-4)
    assert float(clearance(view_of(poses=poses, parked=True))[0][0]) == NO_OBSTACLE
