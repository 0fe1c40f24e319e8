"""The example that follows a lane: its geometry against closed forms, and itself in a served DM-ARDA."""

import json
import math
import socket
import sys

import numpy as np
import pytest

from tests.scripts import load
from tests.server.peers import serving
from usarmjx.models.arenas.arda import ARDA, NETWORK
from usarmjx.models.compile.physics import Physics
from usarmjx.models.roads.network import METRES_PER_FOOT
from usarmjx.models.robots.cars import SNOWSTORM
from usarmjx.server.worlds.dynamic_world import DynamicWorld

SPARE = (
    12 * METRES_PER_FOOT - SNOWSTORM.dimensions[1]
) / 2  # m on both sides of a car in the middle of its lane


client = load("usarsim_client")
lane_follow = load("lane_follow")
SQUARE = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)]


def test_a_way_is_measured_along_its_pieces():
    way = lane_follow.Way(SQUARE, closed=False)
    assert way.length == 30.0
    assert way.at(15.0) == (10.0, 5.0)
    assert way.at(-1.0) == (0.0, 0.0)
    assert way.at(31.0) == (0.0, 10.0)
    assert way.nearest((4.0, 1.0)) == pytest.approx((4.0, 1.0)), "right of the first piece, whose y is right"
    assert way.nearest((11.0, 5.0)) == pytest.approx((15.0, -1.0))


def test_a_closed_way_goes_on_where_it_began():
    way = lane_follow.Way(SQUARE, closed=True)
    assert way.length == 40.0
    assert way.at(37.0) == (0.0, 3.0)
    assert way.at(42.0) == (2.0, 0.0)
    assert way.bend(35.0, 10.0) == pytest.approx(math.pi / 2 / 10)


def test_lanes_of_the_loop_are_closed_and_streets_are_not():
    """The loop of 120 m by 90 m and curves of 15 m: its lanes are half a width inside and outside of that."""
    for lane, side in ((1, -1), (2, 1)):
        way = lane_follow.lane_path(NETWORK, 1, lane)
        assert way.closed
        radius = 15 + side * 6 * METRES_PER_FOOT
        chords = 16 * 2 * radius * math.sin(math.pi / 16)
        assert way.length == pytest.approx(2 * 90 + 2 * 60 + chords, abs=0.02)  # 56 points, 1 mm each
    assert not lane_follow.lane_path(NETWORK, 2, 1).closed


@pytest.mark.parametrize("radius", [8.0, -20.0])
def test_on_a_circle_it_steers_for_that_circle(radius):
    """Positive radius: to the right, clockwise, so FrontSteer is negative; the bicycle's tan a = base / r."""
    base, turns = 2.5, np.linspace(0, 1.5 * math.pi, 2000)
    circle = [(abs(radius) * math.sin(t), radius - radius * math.cos(t)) for t in turns]
    way = lane_follow.Way(circle, closed=False)
    # The rear axle's middle is on the circle, along which the car heads.
    pose = (base / 2, 0.0, 0.0)
    speed, steer = lane_follow.pursue(way, pose, 0.0, 10.0, base)
    assert math.tan(steer) == pytest.approx(-base / radius, rel=1e-3)
    assert speed == pytest.approx(math.sqrt(lane_follow.SIDEWAYS * abs(radius)), rel=1e-2)
    assert lane_follow.pursue(way, pose, 0.0, 2.0, base)[0] == 2.0


def test_it_reckons_by_wheels_alone_and_lets_gps_set_it_right():
    start = (5.0, -3.0, 0.5)
    reckoner = lane_follow.Reckoner(start, (-0.8, 0.3))
    heading = math.radians(10) + start[2]  # it is turned by ten degrees from where it believes to look
    cos, sin = math.cos(heading), math.sin(heading)
    for i in range(300):
        reckoner.odometry((1.0 * i, 0.0, 0.0))
        x, y = start[0] + 1.0 * i * cos, start[1] + 1.0 * i * sin
        if i:
            reckoner.gps((x - 0.8 * cos - 0.3 * sin, y - 0.8 * sin + 0.3 * cos))
        if i == 1:
            first = math.dist(reckoner.pose[:2], (x, y))
    assert first > 0.1
    assert reckoner.pose == pytest.approx((x, y, heading), abs=1e-3)


@pytest.mark.parametrize(
    ("text", "value"), [("34,35.2200,N", 34.587), ("117,22.0200,W", -117.367), ("0,30.0000,S", -0.5)]
)
def test_degrees_of_a_gps_message(text, value):
    assert lane_follow.degrees(text) == pytest.approx(value)


@pytest.fixture(scope="module")
def port():
    world = DynamicWorld(ARDA, Physics(), 5)
    with serving(world) as (port, _):
        yield port


@pytest.mark.parametrize(("by", "allowed"), [("truth", SPARE / 2), ("gps", SPARE)])
def test_a_car_follows_its_lane_round_a_corner(port, tmp_path, monkeypatch, capsys, by, allowed):
    """GPS errs by up to 0.75 m and more: with it the wheels stay in the lane, without they stay well off."""
    file = tmp_path / "log.json"
    told = ["lane_follow.py", "--port", str(port), "--by", by, "--seconds", "12", "--json", str(file)]
    monkeypatch.setattr(sys, "argv", told)
    assert lane_follow.main() == 0
    log = json.loads(file.read_text(encoding="utf-8"))
    assert log["lane"] == pytest.approx([382.2, 12 * METRES_PER_FOOT], abs=0.1)
    truth = np.array([pose for _, pose, _ in log["track"]])
    assert truth[-1, 2] - truth[0, 2] == pytest.approx(math.pi / 2, abs=0.15), "east, then south"
    assert np.linalg.norm(np.diff(truth[:, :2], axis=0), axis=1).sum() > 40.0
    assert max(map(abs, log["sideways"])) < allowed
    assert f"by {by}: at most" in capsys.readouterr().out


def test_without_a_server_and_with_an_unknown_start_it_says_so(port, monkeypatch, capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        closed = taken.getsockname()[1]
    monkeypatch.setattr(sys, "argv", ["lane_follow.py", "--port", str(closed)])
    assert lane_follow.main() == 1
    assert capsys.readouterr().err.startswith(f"lane_follow: 127.0.0.1:{closed}: ")
    monkeypatch.setattr(sys, "argv", ["lane_follow.py", "--port", str(port), "--start", "Moon"])
    assert lane_follow.main() == 1
    assert "no start Moon; known: Loop1, Loop2" in capsys.readouterr().err
