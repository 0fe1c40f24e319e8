"""Viewports, ties, MultiView and traces as values, without a world."""

import math

import numpy as np
import pytest

from usarmjx.base.errors import PeerError, SpecError
from usarmjx.server.protocol.commands import TRACE_COLORS, Trace
from usarmjx.server.protocol.viewports import MultiView, ViewBindings, Viewports, read_multi_view
from usarmjx.server.worlds.robot import COLORS, MAX_POINTS, MIN_DISTANCE, MIN_INTERVAL, RobotTrace, Traces

TALON = ["A", "B", "C", "D"]


def test_the_configuration_follows_from_the_number_of_cameras():
    """Manual 9.4: one for zero or one camera, otherwise four."""
    assert Viewports.of([]) == Viewports("SingleView", ["Disabled"] * 4)
    assert Viewports.of(["A"]) == Viewports("SingleView", ["A", *["Disabled"] * 3])
    assert Viewports.of(["A", "B"]) == Viewports("QuadView", ["A", "B", "Disabled", "Disabled"])
    assert Viewports.of([*TALON, "E"]) == Viewports("QuadView", TALON)


@pytest.mark.parametrize(
    ("word", "config"),
    [("0", "SingleView"), ("1", "QuadView"), ("singleview", "SingleView"), ("QUADVIEW", "QuadView")],
)
def test_configurations_by_number_and_name(word, config):
    for cameras in (["A"], TALON):
        ports = Viewports.of(cameras)
        assert ports.arrange(cameras, word, ()) == ("OK", ["OK"] * 4)
        assert ports.config == config


def test_an_unknown_configuration_fails_and_changes_nothing():
    ports = Viewports.of(["A"])
    assert ports.arrange(["A"], "2", ()) == ("Failed", ["OK"] * 4)
    assert ports.config == "SingleView"


def test_cameras_are_found_in_any_case_and_told_as_they_are_called():
    ports = Viewports.of(TALON)
    assert ports.arrange(TALON, "", [(1, "d"), (3, "disable"), (4, "Z")]) == (
        "OK",
        ["OK", "OK", "OK", "Failed"],
    )
    assert ports.shown == ["D", "B", "Disabled", "None"]


def test_where_viewports_are():
    """Manual 9.4: 1 is the only one, or top left; 2 top right; 3 bottom left; 4 bottom right."""
    ports = Viewports.of(TALON)
    assert ports.tiles() == (("A", 0, 0, 2), ("B", 1, 0, 2), ("C", 0, 1, 2), ("D", 1, 1, 2))
    ports.arrange(TALON, "", [(1, "Disable"), (2, "Z")])
    assert ports.tiles() == (("C", 0, 1, 2), ("D", 1, 1, 2))
    ports.arrange(TALON, "SingleView", [(1, "B")])
    assert ports.tiles() == (("B", 0, 0, 1),)


def test_ties():
    ties = ViewBindings(limit=2)
    assert ties.get("10.0.0.2", 5) is None
    ties.bind("10.0.0.2", "R1", "Camera")
    ties.bind("10.0.0.2:5", "R2", "")
    assert ties.get("10.0.0.2", 4) == ("R1", "Camera")
    assert ties.get("10.0.0.2", 5) == ("R2", "")
    ties.bind("10.0.0.2", "R3", "Camera")
    with pytest.raises(PeerError, match="2 views are tied already"):
        ties.bind("10.0.0.3", "R1", "Camera")
    ties.unbind("10.0.0.2")
    ties.unbind("10.0.0.2")
    assert ties.get("10.0.0.2", 4) is None


# MultiView, manual 3.2.6.3


def test_the_manuals_figures():
    """Four cameras 200 pixels wide in a 640 x 480 client: 160 wide in one row, 200 in a box."""
    wide = MultiView(camera_num=4, wide_mode=4, camera_x_res=200, camera_y_res=150)
    assert [wide.tile(n, (640, 480)) for n in range(4)] == [(160 * n, 0, 160, 120) for n in range(4)]
    box = MultiView(camera_num=4, wide_mode=0, camera_x_res=200, camera_y_res=150)
    assert [box.tile(n, (640, 480)) for n in range(4)] == [
        (0, 0, 200, 150),
        (200, 0, 200, 150),
        (0, 150, 200, 150),
        (200, 150, 200, 150),
    ]


def test_what_usarimage2ros_crops():
    """Four pictures of 320 x 240 in one row of 1280 x 240."""
    wide = MultiView(wide_mode=4)
    assert wide.size == (1280, 240)
    assert [wide.tile(n, wide.size)[0] for n in range(4)] == [0, 320, 640, 960]


@pytest.mark.parametrize("count", range(1, 17))
@pytest.mark.parametrize("wide", [0, 1, 3])
@pytest.mark.parametrize("size", [(640, 480), (320, 240), (100, 1000)])
def test_tiles_fit_do_not_overlap_and_keep_their_shape(count, wide, size):
    multi = MultiView(count, wide)
    covered = np.zeros(size[::-1], int)
    for number in range(count):
        left, top, width, height = multi.tile(number, size)
        assert left + width <= size[0]
        assert top + height <= size[1]
        covered[top : top + height, left : left + width] += 1
        # Both are cut to whole pixels, so the shape is right to a pixel of either.
        assert abs(width / height - 4 / 3) < (1 + 4 / 3) / height
    assert covered.max() == 1
    assert covered.sum() == count * width * height


def test_multi_view_is_read_from_ini_files(tmp_path):
    ini, other = tmp_path / "a.ini", tmp_path / "b.ini"
    ini.write_text(
        "[USARBot.P2AT]\nmsgTimer=0.2\n[USARBot.MultiView]\nCameraNum=6\nWideMode=3\nCameraXres=160\n"
        "CameraYres=120\nIsCameraLocked=false\n"
    )
    other.write_text("[USARBot.MultiView]\nWideMode=2\n")
    assert read_multi_view([]) == MultiView(4, 0, 320, 240)
    assert read_multi_view([ini]) == MultiView(6, 3, 160, 120)
    assert read_multi_view([ini, other]) == MultiView(6, 2, 160, 120)


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("CameraNum=0", "whole number from 1"),
        ("WideMode=-1", "whole number from 0"),
        ("CameraXres=1.5", "whole number"),
        ("CameraYres=yes", "a number"),
        ("CameraCount=2", "has no key CameraCount"),
        ("CameraNum=4096", "are too many"),
    ],
)
def test_a_wrong_multi_view_is_refused_by_name(tmp_path, line, says):
    ini = tmp_path / "a.ini"
    ini.write_text(f"[USARBot.MultiView]\n{line}\n")
    with pytest.raises(SpecError, match=says):
        read_multi_view([ini])


# Traces, manual 9.4


def walk(told, speed, seconds, step=0.02):
    """The points that a robot leaves which goes along x."""
    traces, trail = Traces(), RobotTrace(told)
    for count in range(round(seconds / step)):
        time = count * step
        if trail.due(time):
            traces.add_point(trail, (speed * time, 0.0, 0.1), time)
    return traces


def test_points_are_an_interval_apart():
    traces = walk(Trace(True, 0.5, "Green"), speed=1.0, seconds=3.0)
    places, colors = traces.sketch().start, traces.sketch().rgb
    np.testing.assert_allclose(places[:, 0], [0.0, 0.5, 1.0, 1.5, 2.0, 2.5], atol=1e-6)  # float32
    assert (colors == (0, 1, 0)).all()


def test_points_are_7_unreal_units_apart_however_slow_the_robot():
    places = walk(Trace(True), speed=0.01, seconds=20.0).sketch().start
    # A point comes at the first look, every 0.1 s, when it is far enough: at most a look's way further.
    assert (np.diff(places[:, 0]) > MIN_DISTANCE - 1e-6).all()
    assert (np.diff(places[:, 0]) <= MIN_DISTANCE + 0.01 * (MIN_INTERVAL + 0.02) + 1e-6).all()
    assert len(walk(Trace(True), speed=0.0, seconds=5.0).points) == 1


def test_off_leaves_nothing():
    assert walk(Trace(False), speed=1.0, seconds=3.0).points == []


def test_a_long_way_keeps_its_ends_and_never_more_than_the_limit():
    traces, trail = Traces(), RobotTrace(Trace(True))
    for count in range(5000):
        traces.add_point(trail, (float(count), 0.0, 0.0), float(count))
        assert len(traces.points) <= MAX_POINTS
    places = traces.sketch().start
    assert traces.stride == 16, "5000 points are more than 8 * 512, fewer than 16 * 512"
    assert places[0, 0] == 0
    assert (np.diff(places[:, 0]) == 16).all()
    assert places[-1, 0] > 4999 - 16


def test_every_colour_has_its_paint():
    assert tuple(COLORS) == TRACE_COLORS
    assert len(set(COLORS.values())) == 7
    assert all(math.isfinite(v) and 0 <= v <= 1 for color in COLORS.values() for v in color)
