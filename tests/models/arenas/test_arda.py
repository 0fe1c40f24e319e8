"""DM-ARDA: its files, its roads on the ground and in the files, and cars that drive on them."""

import itertools
import math
import re
from collections import deque

import mujoco
import numpy as np
import pytest

from tests.rig import Rig
from tests.road_files import write_mdf, write_rndf
from tests.scripts import load
from tests.server.peers import Peer, serving
from usarmjx.models.arenas import ARENAS
from usarmjx.models.arenas.arda import ARDA, FILES, MISSIONS, NETWORK, ORIGIN, RADIUS, STARTS
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.standing import START_GAP
from usarmjx.models.roads.network import (
    METRES_PER_FOOT,
    METRES_PER_LATITUDE_DEGREE,
    METRES_PER_LONGITUDE_DEGREE,
    Lane,
    Zone,
    to_lat_lon,
    to_local_xy,
)
from usarmjx.models.roads.rndf import read_mdf, read_rndf
from usarmjx.models.roads.shapes import (
    KERB_WIDTH,
    LINE_WIDTH,
    STOP_LINE_WIDTH,
    WHITE,
    YELLOW,
    lane_path,
    lane_runs,
    lane_width,
)
from usarmjx.models.robots import ROBOTS
from usarmjx.sensors.gps import GpsSettings, largest_error
from usarmjx.server.worlds.dynamic_world import DynamicWorld
from usarmjx.sim.scene import build_scene, start_height

CARS = ("SnowStorm", "Hummer", "Sedan", "Cooper")
WIDEST = "Hummer"
FILE_ATOL = 2e-3  # m: degrees in the files have 8 decimals, 1.1 mm north and 0.7 mm east
LANES = [owner for owner, part in NETWORK.parts() if isinstance(part, Lane)]


client = load("usarsim_client")
lane_follow = load("lane_follow")


# --- files ------------------------------------------------------------------------------------


def test_the_shipped_files_are_those_of_the_roads():
    """Written anew with: for file, text in ...: file.write_text(text)."""
    texts = [write_rndf(NETWORK), *map(write_mdf, MISSIONS)]
    assert [file.name for file in FILES] == [
        "ARDA_RNDF.txt",
        "ARDA_MDF1.txt",
        "ARDA_MDF2.txt",
    ]  # manual 3.2.1.2
    assert [file.read_text(encoding="utf-8") for file in FILES] == texts
    assert read_rndf(FILES[0]) == NETWORK
    assert tuple(read_mdf(file, NETWORK) for file in FILES[1:]) == MISSIONS


def test_every_checkpoint_can_be_driven_to_from_every_other():
    """Along lanes and exits; within the car park freely, as zones are."""
    onwards = {point: set() for point in NETWORK.points()}
    for owner, part in NETWORK.parts():
        ids = [point for point in onwards if point[:2] == owner]
        if isinstance(part, Lane):
            for a, b in itertools.pairwise(ids):
                onwards[a].add(b)
        else:
            same = [point for point in onwards if point[0] == owner[0]]
            for a in ids:
                onwards[a] |= set(same)
        for point, entry in getattr(part, "exits", ()):
            onwards[(*owner, point)].add(entry)
    for start in NETWORK.checkpoints().values():
        seen, queue = {start}, deque([start])
        while queue:
            fresh = onwards[queue.popleft()] - seen
            seen |= fresh
            queue += fresh
        assert set(NETWORK.checkpoints().values()) <= seen


def test_exits_lead_ahead_or_round_a_corner_that_cars_can_drive():
    """The circle that leaves along one lane and arrives along the other is wider than the cars' smallest."""
    smallest = max(
        ROBOTS.get(car).wheel_base / math.tan(ROBOTS.get(car).drive.max_steering[0]) for car in CARS
    )
    points = NETWORK.points()

    def heading(point):
        path = lane_path(NETWORK.lane(*point[:2]), ORIGIN)
        i = min(point[2] - 1, len(path) - 2)
        return (path[i + 1] - path[i]) / np.linalg.norm(path[i + 1] - path[i])

    turns = 0
    for owner in LANES:
        for i, entry in NETWORK.lane(*owner).exits:
            if entry[1] == 0:
                continue  # into the car park, where there are no lanes
            out, way = heading((*owner, i)), np.subtract(
                to_local_xy(ORIGIN, points[entry]), to_local_xy(ORIGIN, points[(*owner, i)])
            )  # fmt: skip
            into = heading(entry)
            if out @ into > 0.9:
                assert abs(out[0] * way[1] - out[1] * way[0]) < FILE_ATOL, "straight on"
            else:
                turns += 1
                assert abs(out @ into) < 1e-3
                assert min(out @ way, into @ way) > smallest, "a quarter circle of that radius fits"
    assert turns == 4 * 2 + 4 * 2 + 4 * 2  # at the middle, off the loop, onto the loop


# --- on the ground ----------------------------------------------------------------------------


def test_the_arena_keeps_its_budget_and_engines_can_have_it():
    assert len(ARDA.shapes) <= 150
    assert len(ARDA.loose) <= 10
    assert {shape.kind for shape in (*ARDA.shapes, *(s for o in ARDA.loose for s in o.shapes))} == {"box"}
    assert ARENAS.get("road") is ARENAS.get("ARDA") is ARDA
    assert ARDA.robots == CARS


def ends(shape):
    """Both ends and the middle of a line of paint or a kerb, x, y [m] (3, 2)."""
    yaw, (x, y, _) = shape.rotation[2], shape.at
    along = shape.size[0] * np.array([math.cos(yaw), math.sin(yaw)])
    return np.array((x, y)) + np.outer((-1, 0, 1), along)


def sideways(path, points):
    """How far to the left of a straight way between two points others are [m], and how far along."""
    way = path[1] - path[0]
    length = np.linalg.norm(way)
    off = points - path[0]
    return (way[0] * off[..., 1] - way[1] * off[..., 0]) / length, off @ way / length


@pytest.mark.parametrize("owner", LANES)
def test_lines_and_kerbs_lie_beside_the_files_waypoints(owner):
    """Each piece of a lane in the file has its half of the double line, and a white line or a kerb."""
    network = read_rndf(FILES[0])
    lane = network.lane(*owner)
    half = lane_width(lane) / 2
    assert half == pytest.approx(6 * 0.3048)
    yellow = [s for s in ARDA.shapes if s.rgba == YELLOW]
    right = [
        s
        for s in ARDA.shapes
        if s.size[1] == (LINE_WIDTH if lane.right else KERB_WIDTH) / 2 and s.rgba != YELLOW
    ]
    expected = -half + LINE_WIDTH / 2 if lane.right else -half - KERB_WIDTH / 2
    pieces = 0
    for run in lane_runs(network, owner, ARDA.gps):
        for piece in itertools.pairwise(run):
            for lines, at in ((yellow, half - LINE_WIDTH), (right, expected)):
                middle = np.mean(piece, axis=0)
                offs = [sideways(piece, ends(line)) for line in lines]
                beside = [
                    np.abs(off - at).max()
                    for off, along in offs
                    if along.min() < np.linalg.norm(piece[1] - piece[0]) / 2 < along.max()
                ]
                assert min(beside) < FILE_ATOL, (owner, middle)
            pieces += 1
    assert pieces == {1: 24, 2: 2, 3: 2 if owner == (3, 1) else 3}[owner[0]]


def test_stop_signs_have_lines():
    lines = [s for s in ARDA.shapes if s.size[1] == STOP_LINE_WIDTH / 2]
    stops = [
        np.array(to_local_xy(ORIGIN, NETWORK.lane(*owner).waypoints[i - 1]))
        for owner in LANES
        for i in NETWORK.lane(*owner).stops
    ]
    assert len(lines) == len(stops) == 8
    for stop in stops:
        assert min(np.linalg.norm(np.subtract(line.at[:2], stop)) for line in lines) < FILE_ATOL


def test_curves_have_their_radius():
    path = lane_path(NETWORK.lane(1, 1), ORIGIN)[1:6]
    centre = (60.0 - RADIUS, -(45.0 - RADIUS))
    np.testing.assert_allclose(
        np.linalg.norm(path - centre, axis=1), RADIUS - 6 * METRES_PER_FOOT, atol=FILE_ATOL
    )


@pytest.fixture(scope="module")
def scene():
    return build_scene(ARDA, [WIDEST])


def touching(scene, data, x, y, yaw):
    """How many contacts a car has that starts there."""
    mujoco.mj_resetData(scene.model, data)
    root = data.joint("r0/root").qpos
    root[:3] = x, y, start_height(ARDA, ARDA.starts[0], ROBOTS.get(WIDEST)) + START_GAP
    root[3:] = math.cos(yaw / 2), 0, 0, math.sin(yaw / 2)
    mujoco.mj_kinematics(scene.model, data)
    mujoco.mj_comPos(scene.model, data)
    mujoco.mj_collision(scene.model, data)
    mine = [bool(scene.model.geom(int(g)).name.startswith("r0/")) for pair in data.contact.geom for g in pair]
    return sum(mine)


def test_nothing_stands_on_the_lanes(scene):
    """The widest car fits everywhere, across the junctions too."""
    data = mujoco.MjData(scene.model)
    for owner in LANES:
        for a, b in itertools.pairwise(lane_path(NETWORK.lane(*owner), ORIGIN)):
            yaw = math.atan2(b[1] - a[1], b[0] - a[0])
            for share in np.linspace(0, 1, max(2, int(np.linalg.norm(b - a)))):
                assert touching(scene, data, *(a + share * (b - a)), yaw) == 0, (owner, a, b)


def test_the_check_above_can_fail(scene):
    data = mujoco.MjData(scene.model)
    hummer = ROBOTS.get(WIDEST)
    on_kerb = 12 * METRES_PER_FOOT + KERB_WIDTH / 2 - hummer.wheel_separation / 2
    assert touching(scene, data, 35.0, -on_kerb, 0.0) > 0, "its right wheels in the kerb of Main Street"
    assert touching(scene, data, 20.0, 20.0, 0.0) > 0, "in a house"


def test_starts_are_on_lanes_in_their_direction_or_in_spots(scene):
    data = mujoco.MjData(scene.model)
    spots = [np.array(to_local_xy(ORIGIN, spot.waypoints[1])) for spot in NETWORK.zones[0].spots]
    assert len({start.tag for start in ARDA.starts}) == len(ARDA.starts) == len(STARTS)
    for start in ARDA.starts:
        assert start.at[2] == 0.188  # manual 5.3.5
        assert touching(scene, data, *start.at[:2], start.yaw) == 0
        if start.tag.startswith("Spot"):
            at = spots[int(start.tag[4:]) - 1]
            assert np.linalg.norm(start.at[:2] - at) < FILE_ATOL
            continue
        offs = []
        for owner in LANES:
            for piece in itertools.pairwise(lane_path(NETWORK.lane(*owner), ORIGIN)):
                off, along = sideways(np.array(piece), np.array(start.at[:2]))
                way = piece[1] - piece[0]
                if 0 < along < np.linalg.norm(way):
                    turn = math.remainder(math.atan2(way[1], way[0]) - start.yaw, math.tau)
                    offs.append((abs(off), abs(turn)))
        assert min(offs) < (FILE_ATOL, 1e-4), start


def test_spots_hold_a_car_between_their_lines():
    zone = NETWORK.zones[0]
    assert isinstance(zone, Zone)
    path = np.array([[to_local_xy(ORIGIN, at) for at in spot.waypoints] for spot in zone.spots])
    gaps = np.diff(path[:, 1, 0])
    np.testing.assert_allclose(gaps, 9 * METRES_PER_FOOT, atol=FILE_ATOL)
    assert max(ROBOTS.get(car).dimensions[1] for car in CARS) < 9 * METRES_PER_FOOT - LINE_WIDTH
    lines = [
        s
        for s in ARDA.shapes
        if s.rgba == WHITE and s.size == pytest.approx((2.75, LINE_WIDTH / 2, 0.002), abs=1e-3)
    ]
    assert len(lines) == len(zone.spots) + 1


# --- degrees ----------------------------------------------------------------------------------


def test_degrees_and_metres_are_each_others_inverse():
    assert to_lat_lon(
        (10.0, 20.0), (METRES_PER_LATITUDE_DEGREE, -METRES_PER_LONGITUDE_DEGREE)
    ) == pytest.approx((11.0, 21.0))
    for at in ((0.0, 0.0), (60.0, -45.0), (-1e3, 1e3)):
        assert to_local_xy(ORIGIN, to_lat_lon(ORIGIN, at)) == pytest.approx(at, abs=1e-6)


GPS = re.compile(
    r"{Latitude (\d+),([\d.]+),([NS])} {Longitude (\d+),([\d.]+),([EW])} {Fix 1} {Satellites (\d+)}"
)


@pytest.fixture(scope="module")
def port():
    world = DynamicWorld(ARDA, Physics(), 3)
    with serving(world) as (port, _):
        yield port


@pytest.mark.parametrize("point", [(1, 1, 8), (2, 1, 2), (3, 2, 5)])
def test_a_car_at_a_waypoint_reports_its_degrees(port, point):
    """The antenna is 0.8 m behind the car's middle; the largest error is that of the satellites it sees."""
    peer, (north, east) = Peer(port), NETWORK.points()[point]
    x, y = to_local_xy(ORIGIN, (north, east))
    peer.say(f"INIT {{ClassName USARBot.SnowStorm}} {{Name R1}} {{Location {x + 0.8},{-y},-0.8}}")
    for _ in range(5):
        line = peer.until(b"SEN {Type GPS}").decode()
        degree, minute, north_south, east_degree, east_minute, east_west, satellites = GPS.search(
            line
        ).groups()
        assert (north_south, east_west) == ("N", "W")
        found = int(degree) + float(minute) / 60, -int(east_degree) - float(east_minute) / 60
        # Minutes are cut after four decimals: 0.19 m of latitude; and the car settles on its springs.
        allowed = largest_error(GpsSettings(), int(satellites)) + 0.25
        assert np.abs(np.subtract(to_local_xy(ORIGIN, found), (x, y))).max() < allowed
    peer.close()


# --- driving ----------------------------------------------------------------------------------


def pose_of(rig):
    """Pose in the wire's axes, which the example steers in."""
    state = rig.state()
    w, _, _, z = (float(v) for v in state.quat)
    return float(state.pos[0]), -float(state.pos[1]), -2 * math.atan2(z, w)


@pytest.mark.every_run("Hummer-lane1-Outer1-7.0")
@pytest.mark.parametrize(
    ("car", "lane", "start", "top"), [("Sedan", (1, 1), "Loop1", 7.0), ("Hummer", (1, 2), "Outer1", 7.0)]
)
def test_a_car_keeps_its_lane_all_the_way_round_the_loop(car, lane, start, top):
    """By the example's pure pursuit, five times a second: both sides of the car stay half as far from the
    lines as they are in its middle, or more."""
    at = next(s for s in ARDA.starts if s.tag == start)
    rig = Rig(car, arena=ARDA, places=((*at.at[:2], at.yaw),))
    way, drive = lane_follow.lane_path(NETWORK, *lane), rig.robot.drive
    assert way.closed
    spare = (lane_width(NETWORK.lane(*lane)) - rig.robot.dimensions[1]) / 2
    done, speed, turned, offs = 0.0, 0.0, 0.0, []
    along, _ = way.nearest(pose_of(rig)[:2])
    yaw = pose_of(rig)[2]
    while done < way.length:
        speed, steer = lane_follow.pursue(way, pose_of(rig), speed, top, rig.robot.wheel_base)
        rig.tell(Speed=speed / drive.radius, FrontSteer=steer)
        rig.run(0.2)
        pose = pose_of(rig)
        here, off = way.nearest(pose[:2])
        done, along = done + math.remainder(here - along, way.length), here
        turned, yaw = turned + math.remainder(pose[2] - yaw, math.tau), pose[2]
        offs.append(off)
        assert rig.data.time < 120
    assert abs(turned) == pytest.approx(math.tau, abs=0.1), "once round"
    assert np.abs(offs).max() < spare / 2
