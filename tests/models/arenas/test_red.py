"""DM-USAR_red: rubble, step fields and slabs, which tracks with flippers cross and wheels do not."""

import itertools
import math

import mujoco
import numpy as np
import pytest

from tests.climb import FOLDED, flippers
from tests.rig import Rig
from tests.terrain import deepest, follow, heights, loose_qpos, loose_speeds, on_starts, roots
from usarmjx.base.transforms import flip_vector
from usarmjx.models.arenas import ARENAS
from usarmjx.models.arenas.pieces import POST, STEP_FIELDS
from usarmjx.models.arenas.red import LANE, PLANE_X, PLANE_Y, PLATFORM, RED, cell
from usarmjx.models.check import check_arena
from usarmjx.models.compile.victims import victim_table
from usarmjx.models.robots import ROBOTS

TABLE_2 = (0.76, 2.3, 1.8)  # manual, Table 2: start position in the red arena, wire axes
ATOL = 1e-9  # m: rays in double precision
LEVEL = 0.9999  # a P2AT that leans by less than 0.8 degrees
STILL = 1e-3  # m/s


# Starts


def test_the_names_of_the_arena():
    assert ARENAS.get("red") is ARENAS.get("DM-USAR_red") is RED


def test_the_manuals_start_position_is_just_above_the_ground():
    first, (x, y, z) = RED.starts[0], flip_vector(TABLE_2)
    assert first.tag == "PlayerStart"
    assert first.at[:2] == pytest.approx((x, y))
    ground = RED.floor + heights(RED, [(x, y)])[0]
    assert 0.0 <= z - ROBOTS.get("P2AT").origin_height - ground <= 0.05


def test_starts_are_at_the_editors_height_above_the_ground_and_apart():
    assert len(RED.starts) >= 12
    spots = [start.at for start in RED.starts]
    found = heights(RED, [spot[:2] for spot in spots])
    np.testing.assert_allclose(found, [spot[2] - 0.188 for spot in spots], atol=ATOL)  # manual 5.3.5
    assert min(math.dist(a, b) for a, b in itertools.combinations(spots, 2)) >= 1.0


def test_a_p2at_stands_clear_and_level_on_every_start():
    rig = on_starts(RED)
    assert deepest(rig) < 0.002
    before = roots(rig)
    rig.run(1.5)
    assert np.abs(roots(rig)[:, :3] - before[:, :3]).max() < 0.05
    assert rig.up.min() > LEVEL


def test_there_is_a_way_around_the_obstacles_to_every_start():
    assert [problem for problem in check_arena(RED) if "start" in problem] == []


# Step fields


def test_the_step_fields_of_the_lane_are_cubic():
    for column, row, pattern in LANE:
        drawn = np.array([[int(digit) for digit in line] for line in STEP_FIELDS[pattern].split()])
        offsets = POST * (np.arange(12) - 5.5)
        # The lane's walls stand on the outermost posts' edges.
        points = [np.add(cell(column, row), (x, y)) for y in offsets[::-1] for x in offsets]
        np.testing.assert_allclose(heights(RED, points).reshape(12, 12), 0.10 * drawn, atol=ATOL)


ENTRY, WAY = cell(2, 3), [cell(column, 3) for column in (3, 4, 5, 6)]


def crawl(pitch):
    """Flippers of a Kenaf: its nose up ahead; as the robot climbs, flat in front and pressed down behind."""
    climb = min(max(pitch, 0.0), 0.6)
    return flippers(-0.6 + climb, -0.8 * climb)


def in_the_lane(name, pose, aside=0.0):
    """A robot before the step fields, `aside` from their middle, with its joints in a pose."""
    rig = Rig(name, arena=RED, places=[(ENTRY[0], ENTRY[1] + aside, 0.0)])
    rig.move(pose).run(1.0)
    return rig


@pytest.mark.every_run("0.0")
@pytest.mark.parametrize("aside", [0.0, 0.05])
def test_a_kenaf_crosses_the_step_fields_with_its_flippers(aside):
    """Measured: 12 to 15 s."""
    rig = in_the_lane("Kenaf", crawl(0.0), aside)
    way = [*WAY, WAY[-1] + np.array([0.25, 0.0])]  # until no part of it is above the last field
    count, worst = follow(rig, way, 1.0, 25.0, crawl)
    assert count == len(way)
    assert worst > math.cos(math.radians(60))
    rig.tell(Left=0, Right=0).move(flippers(-0.6, 0.0)).run(1.0)
    height = roots(rig)[0, 2] - RED.floor
    assert height == pytest.approx(ROBOTS.get("Kenaf").origin_height, abs=0.02), "on the floor behind them"


def test_a_kenaf_with_its_flippers_folded_does_not():
    count, _ = follow(in_the_lane("Kenaf", FOLDED), WAY, 1.0, 20.0)
    assert count < len(WAY)


@pytest.mark.every_run("1.0")
@pytest.mark.parametrize("share", [0.5, 1.0])
def test_a_p2at_does_not_get_onto_the_step_fields(share):
    rig = in_the_lane("P2AT", {})
    assert follow(rig, WAY, share, 12.0)[0] == 0
    assert roots(rig)[0, 0] < cell(3, 3)[0]


# What else there is


def test_the_inclined_plane_rises_at_30_degrees_to_the_platform():
    share = np.array([0.001, 0.5, 0.999])
    points = [(PLANE_X, PLANE_Y - 0.6 + 1.2 * s) for s in share]
    np.testing.assert_allclose(heights(RED, points), 1.2 * share * math.tan(math.radians(30)), atol=ATOL)
    assert heights(RED, [(PLANE_X, PLANE_Y + 1.0)]) == pytest.approx([1.2 * math.tan(math.radians(30))])


def test_a_talon_drives_up_the_inclined_plane():
    rig = Rig("Talon", arena=RED, places=[(*cell(8, 1), math.pi / 2)])
    assert follow(rig, [(PLANE_X, PLANE_Y + 1.1)], 0.5, 15.0)[0] == 1
    rig.tell(Left=0, Right=0).run(1.0)
    standing = RED.floor + PLATFORM + ROBOTS.get("Talon").origin_height
    assert roots(rig)[0, 2] == pytest.approx(standing, abs=0.005)


def test_rubble_and_slabs_are_what_robots_must_climb_or_go_around():
    found = heights(RED, [cell(1.15, 6.35), cell(4.7, 5.1), cell(6.6, 0.5)])
    assert (found > (0.5, 0.3, 0.35)).all()
    tilted = [shape for shape in RED.shapes if shape.rotation[0] or shape.rotation[1]]
    assert len(tilted) > 40


def test_loose_objects_stay_where_they_are_put():
    rig = Rig("P2AT", arena=RED, places=[(0.76, -2.3, 0.0)])
    mujoco.mj_kinematics(rig.model, rig.data)
    before = loose_qpos(rig)
    rig.run(3.0)
    fastest = 0.0
    for _ in range(25):
        rig.step()
        fastest = max(fastest, loose_speeds(rig).max())
    assert fastest < STILL
    np.testing.assert_allclose(loose_qpos(rig), before, atol=1e-3)  # m: they sink in by as much


def test_it_is_within_its_budget_and_says_so():
    assert f"{len(RED.shapes)} fixed solids, {len(RED.loose)} loose objects" in RED.about
    assert len(RED.shapes) <= 150
    assert len(RED.loose) <= 16
    assert {shape.kind for shape in RED.shapes} == {"box"}, "every engine runs it"


def test_victims_are_built_and_two_lie_in_voids():
    table = victim_table(RED.victims, RED.false_alarms)
    assert len(table.at) == len(RED.victims) == 4
    for name in ("Pancake", "LeanTo"):
        x, y, _ = next(v for v in RED.victims if v.name == name).at
        assert heights(RED, [(x, y)])[0] > 0.5, "a roof over it"
        assert heights(RED, [(x, y)], high=0.35)[0] == pytest.approx(0.0), "room for it"
    x, y, z = next(v for v in RED.victims if v.name == "Waving").at
    assert z > heights(RED, [(x, y)])[0] == pytest.approx(PLATFORM)


def test_everything_is_inside():
    (x0, x1), (y0, y1) = RED.extent
    things = [*RED.starts, *RED.victims, *RED.false_alarms, *RED.tags, *RED.loose, *RED.lights]
    assert all(x0 < thing.at[0] < x1 and y0 < thing.at[1] < y1 for thing in things)
    assert all(0.0 < tag.at[2] - heights(RED, [tag.at[:2]])[0] < 0.05 for tag in RED.tags)
