"""DM-USAR_orange: two levels, the ways between them, and what lies about; by C MuJoCo."""

import itertools
import math

import mujoco
import numpy as np
import pytest

from tests.rig import Rig
from tests.terrain import deepest, follow, heights, loose_qpos, loose_speeds, on_starts, roots
from usarmjx.base.transforms import flip_vector
from usarmjx.models.arenas import ARENAS
from usarmjx.models.arenas.orange import (
    NORTH,
    ORANGE,
    ORIGIN,
    RAMP_RUN,
    RAMP_Y,
    SOUTH,
    STAIRS_Y,
    STEEPER_X,
    UPPER,
    WEST,
    cell,
)
from usarmjx.models.check import check_arena
from usarmjx.models.compile.victims import victim_table
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.shapes import GLASS

TABLE_2 = (1.2, -2.3, 1.16)  # manual, Table 2: start position in the orange arena, wire axes
ATOL = 1e-9  # m: rays in double precision
LEVEL = 0.9999  # a P2AT that leans by less than 0.8 degrees
STILL = 1e-3  # m/s


def standing(name):
    """How high above the ground the origin of a robot is [m]."""
    return ROBOTS.get(name).origin_height


def reached(rig):
    """Place of the first robot in the arena's axes [m]."""
    x, y, z = roots(rig)[0, :3]
    return x, y, z - ORANGE.floor


# Starts


def test_the_names_of_the_arena():
    assert ARENAS.get("orange") is ARENAS.get("DM-USAR_orange") is ORANGE


def test_the_manuals_start_position_is_just_above_the_ground():
    first, (x, y, z) = ORANGE.starts[0], flip_vector(TABLE_2)
    assert first.tag == "PlayerStart"
    assert first.at[:2] == pytest.approx((x, y))
    ground = ORANGE.floor + heights(ORANGE, [(x, y)])[0]
    assert 0.0 <= z - standing("P2AT") - ground <= 0.05


def test_starts_are_at_the_editors_height_above_the_ground_and_apart():
    assert len(ORANGE.starts) >= 12
    spots = [start.at for start in ORANGE.starts]
    np.testing.assert_allclose(
        heights(ORANGE, [spot[:2] for spot in spots[:-2]], high=1.1),
        [z - 0.188 for *_, z in spots[:-2]],
        atol=ATOL,
    )  # manual 5.3.5; from under the upper floor
    np.testing.assert_allclose(heights(ORANGE, [spot[:2] for spot in spots[-2:]]), UPPER, atol=ATOL)
    assert min(math.dist(a, b) for a, b in itertools.combinations(spots, 2)) >= 1.0


def test_a_p2at_stands_clear_and_level_on_every_start():
    rig = on_starts(ORANGE)
    assert deepest(rig) < 0.002
    before = roots(rig)
    rig.run(1.5)
    assert np.abs(roots(rig)[:, :3] - before[:, :3]).max() < 0.05
    assert rig.up.min() > LEVEL


def test_a_p2at_can_get_to_every_start_and_victim():
    assert check_arena(ORANGE) == []


def test_the_check_of_starts_can_fail():
    rig = Rig("P2AT", arena=ORANGE, places=[(*cell(4, 4.5), 0.0)])  # in the wall beside the stairs
    assert deepest(rig) > 0.002


# Two levels


def test_the_upper_floor_is_7_steps_high_and_has_room_under_it():
    points = [cell(6, 4), cell(9, 6), cell(7, 7)]
    assert pytest.approx(7 * 0.18) == UPPER
    np.testing.assert_allclose(heights(ORANGE, points), UPPER, atol=ATOL)
    np.testing.assert_allclose(heights(ORANGE, points, high=1.15), 0.0, atol=ATOL)


@pytest.mark.parametrize(
    ("degrees", "head", "back"),
    [(35.0, (WEST, STAIRS_Y), (-1.0, 0.0)), (40.0, (STEEPER_X, SOUTH), (0.0, -1.0))],
)
def test_stairs_lead_to_it(degrees, head, back):
    going = 0.18 / math.tan(math.radians(degrees))
    middles = np.array(head) + np.outer(going * (np.arange(8) - 0.5), back)
    expected = [UPPER, *(0.18 * n for n in range(6, 0, -1)), 0.0]
    np.testing.assert_allclose(heights(ORANGE, middles), expected, atol=ATOL)


def test_a_ramp_of_15_degrees_leads_to_it():
    share = np.array([0.001, 0.3, 0.6, 0.999])
    points = [(WEST - RAMP_RUN * (1 - s), RAMP_Y) for s in share]
    np.testing.assert_allclose(heights(ORANGE, points), UPPER * share, atol=ATOL)
    assert math.degrees(math.atan2(UPPER, RAMP_RUN)) == pytest.approx(15.0)


@pytest.mark.every_run("1.0")
@pytest.mark.parametrize("share", [0.5, 1.0])
def test_a_talon_climbs_the_stairs_of_35_degrees_and_comes_down_again(share):
    rig = Rig("Talon", arena=ORANGE, places=[(*cell(3, 4), 0.0)])
    landing = (WEST + 1.2, STAIRS_Y)
    count, worst = follow(rig, [(WEST + 0.3, STAIRS_Y), landing], share, 10.0 / share)
    assert count == 2
    rig.tell(Left=0, Right=0).run(1.0)
    assert reached(rig)[2] == pytest.approx(UPPER + standing("Talon"), abs=0.005)
    assert worst > math.cos(math.radians(55)), "upright all the way"
    down = Rig("Talon", arena=ORANGE, places=[(WEST + 0.8, STAIRS_Y, math.pi, UPPER)])
    count, worst = follow(down, [cell(3, 4)], share, 6.0 / share)
    assert count == 1
    down.tell(Left=0, Right=0).run(1.0)
    assert reached(down)[2] == pytest.approx(standing("Talon"), abs=0.005)
    assert worst > math.cos(math.radians(55))


def test_a_p2at_does_not_climb_the_stairs():
    rig = Rig("P2AT", arena=ORANGE, places=[(*cell(3, 4), 0.0)])
    assert follow(rig, [(WEST + 0.3, STAIRS_Y)], 1.0, 8.0)[0] == 0
    assert reached(rig)[2] < standing("P2AT") + 0.18


@pytest.mark.every_run("1.0")
@pytest.mark.parametrize("share", [0.5, 1.0])
def test_a_p2at_drives_up_the_ramp_and_down_again(share):
    rig = Rig("P2AT", arena=ORANGE, places=[(*cell(1, 7), 0.0)])
    count, worst = follow(rig, [(WEST + 0.3, RAMP_Y), (WEST + 1.2, RAMP_Y)], share, 12.0 / share)
    assert count == 2
    assert reached(rig)[2] == pytest.approx(UPPER + standing("P2AT"), abs=0.005)
    assert worst > math.cos(math.radians(20))
    down = Rig("P2AT", arena=ORANGE, places=[(WEST + 0.8, RAMP_Y, math.pi, UPPER)])
    count, worst = follow(down, [cell(1, 7)], share, 12.0 / share)
    assert count == 1
    assert reached(down)[2] == pytest.approx(standing("P2AT"), abs=0.005)
    assert worst > math.cos(math.radians(20))


# What lies about


def test_loose_objects_stay_where_they_are_put():
    rig = Rig("P2AT", arena=ORANGE, places=[(1.2, 2.3, 0.0)])
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
    assert f"{len(ORANGE.shapes)} fixed solids, {len(ORANGE.loose)} loose objects" in ORANGE.about
    assert len(ORANGE.shapes) <= 150
    assert len(ORANGE.loose) <= 16
    assert {shape.kind for shape in ORANGE.shapes} == {"box"}, "every engine runs it"


def ray(start, end):
    """Share of the way from a point to another that is free, and the name of what is there; glass counts."""
    rig = Rig("P2AT", arena=ORANGE, places=[(1.2, 2.3, 0.0)])
    mujoco.mj_kinematics(rig.model, rig.data)
    lift = np.array([0.0, 0.0, ORANGE.floor])
    way = np.subtract(end, start)
    hit = np.zeros(1, np.int32)
    fixed = np.array([1, 0, 0, 0, 0, 0], np.uint8)
    share = mujoco.mj_ray(rig.model, rig.data, np.array(start) + lift, way, fixed, 1, -1, hit)
    return share, rig.model.geom(hit[0]).name


def victim(name):
    return next(v for v in ORANGE.victims if v.name == name)


def test_victims_are_built_and_lie_sit_and_wave():
    table = victim_table(ORANGE.victims, ORANGE.false_alarms)
    assert len(table.at) == len(ORANGE.victims) == 4
    assert any(segment.rates != (0.0, 0.0, 0.0) for segment in victim("Waving").segments)
    assert {v.posture for v in ORANGE.victims} == {"lying", "sitting", "crouched"}


def test_one_victim_is_behind_a_board_one_in_a_void_and_one_behind_glass():
    x, y, _ = victim("BehindBoard").at
    board = ORIGIN[1] + 0.95
    share, _ = ray((x, y + 1.2, 0.5), (x, y, 0.5))
    assert y + 1.2 * (1 - share) == pytest.approx(board, abs=0.02)
    x, y, _ = victim("UnderRamp").at
    roof = heights(ORANGE, [(x, y)])[0]
    assert 0.5 < roof - 0.1 < UPPER
    assert heights(ORANGE, [(x, y)], high=0.5)[0] == pytest.approx(0.0), "room for it"
    x, y, _ = victim("UnderFloor").at
    _, hit = ray((x, SOUTH - 0.6, 0.4), (x, y, 0.4))
    assert ORANGE.shapes[int(hit.split("/")[1])].material == GLASS


def test_tags_lie_on_the_ground_of_either_level():
    for tag in ORANGE.tags:
        ground = heights(ORANGE, [tag.at[:2]], high=tag.at[2] + 0.4)[0]
        assert 0.0 < tag.at[2] - ground < 0.05, tag


def test_everything_is_inside():
    (x0, x1), (y0, y1) = ORANGE.extent
    assert (y0, y1) == (ORIGIN[1], NORTH)
    things = [
        *ORANGE.starts,
        *ORANGE.victims,
        *ORANGE.false_alarms,
        *ORANGE.tags,
        *ORANGE.loose,
        *ORANGE.lights,
    ]
    assert all(x0 < thing.at[0] < x1 and y0 < thing.at[1] < y1 for thing in things)
