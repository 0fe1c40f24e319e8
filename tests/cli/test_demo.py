"""The demonstration: how it judges a run, and the whole of it once."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from usarmjx.cli import demo_run as demo
from usarmjx.models.arenas.yellow import YELLOW
from usarmjx.models.types.arena import ArenaSpec, StartPose
from usarmjx.models.types.shapes import Shape

HALF = (0.5, 0.3)
BOX = np.array([[2.0, -1.0, 3.0, 1.0]])


@pytest.mark.parametrize(
    ("pose", "expected"),
    [
        ((0.0, 0.0, 0.0), 1.5),  # front against a side
        ((0.0, 0.0, math.pi / 2), 1.7),  # side against a side
        ((0.0, 0.0, math.pi / 4), 2 - 0.8 * math.sqrt(0.5)),  # a corner of the hull against a side
        ((1.0, 2.0, 0.0), math.hypot(0.5, 0.7)),  # corner against corner
        # A corner of the box against the hull's long side, which faces it.
        ((2 - 2 * math.sqrt(0.5), 1 + 2 * math.sqrt(0.5), math.pi / 4), 2 - 0.3),
        ((1.6, 0.0, 0.0), 0.0),
        ((2.5, 0.0, 0.3), 0.0),  # wholly inside: no corner of the box is in the hull
        ((2.5, 0.0, math.pi / 2), 0.0),
    ],
)
def test_clearance_of_a_hull_and_a_box(pose: tuple[float, float, float], expected: float):
    assert demo.clearance(np.array(pose), HALF, BOX) == pytest.approx(expected, abs=1e-9)


def test_crossed_rectangles_overlap_without_a_corner_inside():
    cross = np.array([[-0.1, -2.0, 0.1, 2.0]])
    assert demo.clearance(np.zeros(3), HALF, cross) == 0.0


def test_clearance_agrees_with_dense_sampling():
    """Oracle: the least distance of many points on both outlines, 5 mm apart."""
    rng = np.random.default_rng(3)
    side = np.linspace(-1, 1, 401)
    ones = np.ones_like(side)
    outline = np.concatenate(
        [np.column_stack(pair) for pair in ((side, ones), (side, -ones), (ones, side), (-ones, side))]
    )
    box = outline * (0.5, 1.0) + (2.5, 0.0)
    for pose in rng.uniform((-1, -3, -3), (1, 3, 3), (20, 3)):
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        hull = (outline * HALF) @ np.array([[cos, sin], [-sin, cos]]) + pose[:2]
        sampled = min(np.linalg.norm(box - point, axis=1).min() for point in hull)
        assert demo.clearance(pose, HALF, BOX) == pytest.approx(sampled, abs=5e-3)


def test_obstacles_are_what_a_robot_cannot_drive_over():
    boxes = demo.obstacles(YELLOW)
    low = [shape for shape in YELLOW.shapes if any(shape.rotation) or shape.size[2] < 0.05]
    assert len(boxes) == len(YELLOW.shapes) - len(low)
    assert len(low) == 6  # three ramps, two boards, one platform


def log_of(way: np.ndarray, seconds: float) -> dict:
    """A run along x, y, yaw of our axes, in the wire's (n, 3)."""
    track = [
        [100 + t, [x, -y, -yaw], [x - way[0, 0], -(y - way[0, 1]), 0.0], [x, -y, -yaw]]
        for t, (x, y, yaw) in zip(np.linspace(0, seconds, len(way)), way, strict=True)
    ]
    return {"track": track, "real_seconds": seconds / 4, "messages": {"STA": 3, "Sonar": 4}}


ROOM = ArenaSpec(
    name="Room",
    shapes=(Shape(kind="box", size=(0.1, 2.0, 0.5), at=(3.0, 0.0, 0.5), surface="wall"),),
    starts=(StartPose(tag="A", at=(0.0, 0.0, 0.2)),),
    extent=((-2.0, 4.0), (-2.0, 2.0)),
)


def line(to: float) -> np.ndarray:
    x = np.linspace(0, to, 11)
    return np.column_stack([x, 0 * x, 0 * x])


def test_account_of_a_straight_run():
    account = demo.report_of(ROOM, log_of(line(2.0), 8.0))
    assert account.distance == pytest.approx(2.0)
    assert account.clearance == pytest.approx(2.9 - 2.0 - 0.5238 / 2)
    assert account.simulated == pytest.approx(8.0)
    assert account.realtime_factor == pytest.approx(4.0)
    assert account.messages == 7
    assert account.odometry_error == pytest.approx(0.0, abs=1e-9)
    assert account.fast_enough
    assert not account.touched


def test_touching_and_idling_are_found():
    assert demo.report_of(ROOM, log_of(line(2.9 - 0.5238 / 2), 8.0)).touched
    assert not demo.report_of(ROOM, log_of(line(1.0), 8.0)).fast_enough


def test_touch_between_two_reports_is_found():
    """A corner passes the wall's end while both reports are clear of it."""
    way = np.array([[2.9, 2.6, 0.0], [2.9, 2.6, math.pi / 2 + 0.01], [2.9, 2.6, math.pi]])
    ends = min(demo.clearance(pose, (0.2619, 0.2484), demo.obstacles(ROOM)) for pose in way)
    assert demo.least_clearance(ROOM, way) < ends - 0.05


def test_run_without_poses_is_no_run():
    with pytest.raises(demo.DemoError, match="fewer than two"):
        demo.report_of(ROOM, {"track": [], "real_seconds": 1.0, "messages": {}})


def test_failing_controller_is_reported_and_the_server_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    script = tmp_path / "wander.py"
    script.write_text("import sys; sys.exit('no luck')")
    monkeypatch.setattr(demo, "CONTROLLER", script)
    with pytest.raises(demo.DemoError, match="status 1: no luck"):
        demo.run_demo(tmp_path, 5)


def test_demo_end_to_end(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Server of a batch, bundled client over TCP, judged by the true poses, and the picture."""
    assert demo.run_demo(tmp_path, 5.0) == 0
    log = json.loads((tmp_path / "wander.json").read_text())
    assert log["level"] == YELLOW.name
    account = demo.report_of(YELLOW, log)
    assert account.simulated >= 4.5
    assert account.distance > 0.75
    assert account.clearance > 0.1
    # The sonars' view of the clearance agrees with the truth, within their noise and blind angles.
    assert log["min_clearance"] == pytest.approx(account.clearance, abs=0.15)
    assert imread(tmp_path / "wander.png").shape[1] == 1074
    shown = capsys.readouterr().out
    assert "nothing touched" in shown
    assert f"{account.distance:.2f} m" in shown
