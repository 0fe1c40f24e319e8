"""The picture of a run: its axes, and that what it draws is in the file."""

import math
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.image import imread

from usarmjx.models.arenas.yellow import YELLOW
from usarmjx.models.types.arena import ArenaSpec, StartPose
from usarmjx.models.types.shapes import Shape
from usarmjx.plots import picture
from usarmjx.plots.style import PAGE

ROOM = ArenaSpec(
    name="Room",
    shapes=(Shape(kind="box", size=(0.1, 2.0, 0.5), at=(3.0, 0.0, 0.5), surface="wall"),),
    starts=(StartPose(tag="A", at=(0.0, 0.0, 0.2)),),
    extent=((-2.0, 4.0), (-2.0, 2.0)),
)


def straight(yaw: float = 0.0) -> list:
    """A metre from (1, 1) of the wire along a wire yaw; odometry starts at zero, the INS is 0.2 off."""
    track = []
    for i in range(11):
        way = 0.1 * i
        ahead = [1 + way * math.cos(yaw), 1 + way * math.sin(yaw)]
        ins = [ahead[0] + 0.2, ahead[1], yaw]
        track.append([100 + 0.2 * i, [*ahead, yaw], [way, 0.0, 0.0], ins])
    return track


def coloured(image: np.ndarray, colour: str) -> np.ndarray:
    """Return (row, column) of the pixels of a colour (pixels, 2)."""
    return np.argwhere(np.abs(image[..., :3] - to_rgb(colour)).max(-1) < 0.02)


def wall_of_room(image: np.ndarray) -> tuple[int, int, int, int]:
    """Return top, bottom, left and right pixel of the room's wall; letters have dark pixels too."""
    dark = np.abs(image[..., :3] - to_rgb(picture.WALL)).max(-1) < 0.02
    columns = np.flatnonzero(dark.sum(0) > 500)
    rows = np.flatnonzero(dark[:, columns[len(columns) // 2]])
    return rows[0], rows[-1], columns[0], columns[-1]


@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.0])
def test_estimates_are_laid_on_the_true_start(yaw: float):
    paths = picture.tracked_poses({"track": straight(yaw)})
    expected = (1 + math.cos(yaw), -1 - math.sin(yaw), -yaw)
    for name in ("truth", "odometry", "ins"):
        assert paths[name][0] == pytest.approx((1.0, -1.0, -yaw)), name
        assert paths[name][-1] == pytest.approx(expected), name


def test_scan_in_a_known_room():
    """At (1, 1) of the wire, facing right (wire +90 degrees, ours -90): right of it is -x, left +x."""
    scan = {
        "ranges": [1.0, 2.0, 3.0, 20.0, 4.0],
        "fov": math.pi,
        "at": (0.5, 0.0, 0.0),
        "pose": (1.0, 1.0, math.pi / 2),
    }
    points = picture.scan_points(scan)
    half = math.sqrt(0.5)
    expected = [
        (1 - 1, -1.5),
        (1 - 2 * half, -1.5 - 2 * half),
        (1, -1.5 - 3),
        (1 + 4, -1.5),  # the fourth beam met nothing
    ]
    np.testing.assert_allclose(points, expected, atol=1e-9)


def test_file_is_a_png_that_shows_paths_and_scan(tmp_path: Path):
    scan = {"ranges": [1.0] * 181, "fov": math.pi, "at": (0.1, 0.0, 0.0), "pose": (1.5, 1.0, 0.0)}
    track = straight()
    for i, row in enumerate(track):  # apart from the truth, so that no line hides another
        row[2] = [0.1 * i, 0.03 * i, 0.0]
        row[3] = [row[3][0], row[3][1] - 0.03 * i, 0.0]
    path = tmp_path / "run.png"
    picture.run_picture(ROOM, {"track": track, "scan": scan}, path)
    assert path.read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    image = imread(path)
    assert image.shape[1] == round(PAGE * 150)  # pixels per inch of the style
    top, bottom, *_ = wall_of_room(image)
    plan = image[top:bottom]  # without the legend, which shows each colour anyway
    for colour, least in (
        (picture.TRUTH, 300),
        (picture.ODOMETRY, 100),
        (picture.INS, 40),
        (picture.SCAN, 500),
    ):
        assert len(coloured(plan, colour)) > least, colour


def test_parts_lie_where_they_belong(tmp_path: Path):
    """One scale for everything: the wall at x 2.9 to 3.1, the true path from x 1 to 2 at y -1."""
    path = tmp_path / "run.png"
    picture.run_picture(ROOM, {"track": straight(), "scan": {}}, path)
    image = imread(path)
    top, bottom, left, right = wall_of_room(image)
    scale = (bottom - top) / 4.0
    assert (right - left) / scale == pytest.approx(0.2, abs=0.02)  # within a line's width
    path_pixels = coloured(image[top:bottom], picture.INS)  # drawn last, over the truth
    x = 3.0 + (path_pixels[:, 1] - (left + right) / 2) / scale
    y = ((bottom - top) / 2 - path_pixels[:, 0]) / scale
    assert 0.98 < x.min() < 1.2  # the start's marker covers the first decimetre
    assert 1.7 < x.max() < 2.02
    np.testing.assert_allclose(y, -1.0, atol=0.02)


def test_empty_run_is_drawn(tmp_path: Path):
    path = tmp_path / "run.png"
    unplaced = {"ranges": [1.0], "fov": 1.0, "at": (0.0, 0.0, 0.0), "pose": None}
    picture.run_picture(YELLOW, {"track": [], "scan": unplaced}, path)
    assert len(coloured(imread(path), picture.WALL)) > 5000


def test_styles_of_solids():
    box = {"kind": "box", "size": (1.0, 1.0, 0.1)}
    for style, given in (
        ("ground", {}),
        ("wall", {"surface": "wall"}),
        ("paint", {"surface": "fixture"}),
        ("glass", {"surface": "wall", "material": "glass"}),
        ("overhead", {"surface": "wall", "at": (0.0, 0.0, 2.31)}),
        ("wall", {"surface": "wall", "at": (0.0, 0.0, 2.29)}),
        ("sky", {"material": "sky", "at": (0.0, 0.0, 9.0)}),
    ):
        assert picture._sort(Shape(**box, **{"surface": "ground", **given}), 2.2) == style
